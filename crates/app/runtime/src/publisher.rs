//! The publisher's thread: owns the ports of the bus.

use std::sync::Arc;
use std::sync::mpsc::Sender;
use std::time::{Duration, Instant};

use evolvent_bus::{BusConfig, BusError, CoreBus, EventKind, Status};
use evolvent_drive::{BridgeState, InputFault};
use evolvent_motion::State;
use evolvent_path::{AXES, Axes};
use rtrb::Consumer;

use crate::due_setpoint::DueSetpoint;
use crate::job::Clock;
use crate::pacing::wake_interval_ns;
use crate::periphery_track::PeripheryTrack;
use crate::rt::MonotonicClock;
use crate::shared::Controls;
use crate::signal_port::SignalPort;
use crate::stop_watch::StopWatch;

/// Time between two status snapshots.
const STATUS_EVERY_NS: u64 = 50_000_000;
/// How long to wait for subscribers that were asked for.
const SUBSCRIBER_TIMEOUT: Duration = Duration::from_secs(10);
/// How often a stop is looked for meanwhile.
const SUBSCRIBER_POLL: Duration = Duration::from_millis(50);
/// Longest sleep between two looks at the queue.
const LONGEST_SLEEP_NS: u64 = 1_000_000;

/// What the publisher needs to know.
pub(crate) struct Publishing {
    pub config: BusConfig,
    pub lead_cycles: u32,
    pub clock: Clock,
    pub increments: Axes,
    pub axes_mask: u32,
    pub program: String,
    pub wait_for_subscribers: usize,
    /// Where the axes stand before the first setpoint.
    pub home: Axes,
    pub controls: Arc<Controls>,
}

/// What the publisher counted.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct PublishReport {
    /// Setpoints that left after they were due.
    pub late: u64,
    /// Setpoints that did not leave.
    pub failed: u64,
    /// Readers of setpoints and bridges that were connected at the same time, at most.
    pub listeners: usize,
    /// Messages of inputs that were refused, and what was wrong with the last.
    pub refused_inputs: Option<(u64, InputFault)>,
}

impl PublishReport {
    /// What became of messages of inputs that were refused.
    pub(crate) fn refusal_note(&self) -> Option<String> {
        let (count, fault) = self.refused_inputs?;
        Some(format!(
            "{count} messages of inputs were refused, the last because {fault}: see the bridge that sends them"
        ))
    }

    pub(crate) fn see_listeners(&mut self, bus: &CoreBus) {
        self.listeners = self.listeners.max(bus.setpoint_subscribers());
    }
}

impl Publishing {
    /// Opens the bus, tells `ready` how that went, and publishes until the queue is abandoned and empty.
    pub(crate) fn run(
        self,
        mut queue: Consumer<DueSetpoint>,
        mut track: PeripheryTrack,
        mut signals: Option<SignalPort>,
        mut stops: Option<StopWatch>,
        ready: &Sender<Result<usize, BusError>>,
    ) -> PublishReport {
        let mut report = PublishReport::default();
        let mut bus = match CoreBus::open(&self.config) {
            Ok(bus) => bus,
            Err(error) => {
                let _gone = ready.send(Err(error));
                return report;
            }
        };
        let subscribers = self.await_subscribers(&bus);
        report.see_listeners(&bus);
        let _gone = ready.send(Ok(subscribers));
        let nap = (wake_interval_ns(self.config.period_ns, self.lead_cycles) / 2).min(LONGEST_SLEEP_NS);
        let mut status = Status::default();
        status.set_program(&self.program);
        status.tool = track.now().tool;
        let mut last = evolvent_bus::Setpoint {
            period_ns: self.config.period_ns,
            position: self.home.into(),
            override_ratio: self.controls.feed_override(),
            ..evolvent_bus::Setpoint::default()
        };
        let mut next_status = 0;
        let mut state = State::Idle;
        // A status or an event that does not leave is replaced by the next.
        self.fill(&mut status, &last, MonotonicClock::now_ns(), &bus, &report);
        let _lost = bus.publish_status(&status);
        let mut started = false;
        loop {
            let over = queue.is_abandoned();
            while let Ok(due) = queue.pop() {
                if !started {
                    started = true;
                    let _lost = bus.notify(EventKind::Started);
                }
                let now = MonotonicClock::now_ns();
                let switched = track.follow(&due);
                if let Some(signals) = &mut signals {
                    signals.follow(&mut bus, &due, switched.then(|| track.now()));
                }
                let message = self.message(&due);
                if self.clock == Clock::Realtime && now > due.due_time_ns {
                    report.late += 1;
                }
                if bus.publish_setpoint(&message).is_err() {
                    report.failed += 1;
                }
                last = message;
                if let Some(stops) = &mut stops {
                    stops.follow(&due);
                }
                if switched {
                    let now = track.now();
                    status.spindle_rpm = now.outputs.signed_rpm();
                    status.coolant = now.coolant_bits();
                    status.tool = now.tool;
                    (status.tool_change, status.tool_wanted) = now.change_numbers();
                }
                if due.setpoint.state != state || switched {
                    let event = event_of(state, due.setpoint.state);
                    state = due.setpoint.state;
                    // Whoever is woken finds the reason in the status.
                    self.fill(&mut status, &last, now, &bus, &report);
                    let _lost = bus.publish_status(&status);
                    let _lost = bus.notify(event);
                }
            }
            if let Some(signals) = &mut signals {
                signals.take_inputs(&mut bus, MonotonicClock::now_ns());
                self.controls.see_chain(signals.is_chain_closed());
            }
            // Each counts as a reading, the newest is what the cycle sees.
            while let Ok(Some(load)) = bus.load() {
                self.controls.see_load(load.value, load.range_max);
            }
            // Nobody looks at what they say: see the note of the run.
            while let Ok(Some(feedback)) = bus.unchecked_feedback() {
                let follow = feedback.bridge_state == BridgeState::Following.number();
                self.controls.see_drives(follow);
                report.listeners = report.listeners.max(1);
            }
            let now = MonotonicClock::now_ns();
            if now >= next_status || over {
                next_status = now + STATUS_EVERY_NS;
                report.see_listeners(&bus);
                if let Some(stops) = &mut stops {
                    stops.fill(&mut status);
                }
                self.fill(&mut status, &last, now, &bus, &report);
                let _lost = bus.publish_status(&status);
                if let Some(signals) = &mut signals {
                    signals.send(&mut bus);
                }
                bus.admit_readers();
            }
            if over && queue.is_empty() {
                break;
            }
            let _late = MonotonicClock::sleep_until(now + nap);
        }
        report.refused_inputs = signals.and_then(|signals| signals.refused());
        report
    }

    /// Waits for as many subscribers as were asked for, not beyond a stop.
    fn await_subscribers(&self, bus: &CoreBus) -> usize {
        let deadline = Instant::now() + SUBSCRIBER_TIMEOUT;
        loop {
            let found = bus.wait_for_setpoint_subscribers(self.wait_for_subscribers, SUBSCRIBER_POLL);
            let enough = found >= self.wait_for_subscribers;
            if enough || self.controls.is_stopping() || Instant::now() >= deadline {
                return found;
            }
        }
    }

    pub(crate) fn message(&self, due: &DueSetpoint) -> evolvent_bus::Setpoint {
        let setpoint = &due.setpoint;
        let mut increments = [0; AXES];
        for i in 0..AXES {
            // The guard has checked the travel, so this fits by far.
            increments[i] = (setpoint.position[i] * self.increments[i]).round() as i64;
        }
        evolvent_bus::Setpoint {
            sequence: setpoint.sequence,
            due_time_ns: due.due_time_ns,
            period_ns: self.config.period_ns,
            position: setpoint.position.into(),
            velocity: setpoint.velocity.into(),
            acceleration: setpoint.acceleration.into(),
            position_increments: increments,
            state: setpoint.state as u32,
            flags: setpoint.flags,
            line: setpoint.line,
            axes_mask: self.axes_mask,
            feed_mm_s: setpoint.feed_mm_s,
            override_ratio: setpoint.feed_override,
            path_mm: setpoint.path_mm,
            power_request: due.drive.power.number(),
            fault_reset: due.drive.fault_reset,
            datum: due.drive.datum,
            ..evolvent_bus::Setpoint::default()
        }
    }

    fn fill(
        &self,
        status: &mut Status,
        setpoint: &evolvent_bus::Setpoint,
        now: u64,
        bus: &CoreBus,
        report: &PublishReport,
    ) {
        status.sequence += 1;
        status.time_ns = now;
        status.cycles = self.controls.progress().cycles;
        status.period_ns = setpoint.period_ns;
        status.machine_state = 2;
        status.activity = 1;
        status.power = 1;
        status.axes_mask = self.axes_mask;
        status.follow(setpoint);
        status.rapid_override_ratio = 1.0;
        status.spindle_override_ratio = 1.0;
        status.late_cycles = report.late;
        status.dropped_setpoints = report.failed;
        status.setpoint_subscribers = bus.setpoint_subscribers() as u32;
        let alarm = self.controls.alarm();
        if alarm != 0 && status.alarm_count == 0 {
            status.push_alarm(alarm);
        }
    }
}

pub(crate) fn event_of(before: State, now: State) -> EventKind {
    match (before, now) {
        (_, State::Holding | State::Held) => EventKind::Hold,
        (State::Holding | State::Held, State::Running) => EventKind::Resumed,
        (_, State::Stopped) => EventKind::Stopped,
        (_, State::Done) => EventKind::Done,
        (_, State::Fault) => EventKind::Fault,
        _ => EventKind::StatusChanged,
    }
}
