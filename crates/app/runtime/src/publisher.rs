//! The publisher's thread of a run and of a served machine; it owns the ports of the bus.
//!
//! It sends setpoints and outputs, and receives feedback, inputs and loads. A [`StatusSource`] makes the
//! status and receives the drives' feedback.

use std::sync::mpsc::{self, Receiver, Sender};

use evolvent_bus::{BusError, CoreBus};
use evolvent_drive::PowerRequest;
use evolvent_motion::MotionState;
use rtrb::Consumer;

use crate::due_setpoint::DueSetpoint;
use crate::job::Clock;
use crate::pacing::wake_interval_ns;
use crate::periphery_track::PeripheryTrack;
use crate::publish_report::PublishReport;
use crate::publishing::Publishing;
use crate::rt::{MonotonicClock, RealtimeRequest, apply_to_this_thread};
use crate::signal_port::SignalPort;
use crate::spindle_command::SpindleCommands;
use crate::spindle_status::SpindleStatus;
use crate::start_error::{BUS_TIMEOUT, StartError};
use crate::status_source::{StatusPort, StatusSource};
use crate::stop_watch::StopWatch;

/// Interval of checks for new readers, and of status snapshots while nothing changes.
const REFRESH_EVERY_NS: u64 = 50_000_000;
/// Maximum poll interval of the queues.
const LONGEST_SLEEP_NS: u64 = 1_000_000;

/// A bus that the publisher's thread is opening.
pub(crate) struct Opening(Receiver<Result<usize, BusError>>);

impl Opening {
    /// Waits until the bus is open. Returns the number of requested subscribers that have come.
    ///
    /// # Errors
    /// The bus cannot be opened, or not in time.
    pub(crate) fn wait(self) -> Result<usize, StartError> {
        match self.0.recv_timeout(BUS_TIMEOUT) {
            Ok(Ok(subscribers)) => Ok(subscribers),
            Ok(Err(error)) => Err(StartError::Bus(error)),
            Err(_) => Err(StartError::BusTimeout),
        }
    }
}

/// Everything that the thread owns; built before it starts.
pub(crate) struct Publisher<S> {
    pub publishing: Publishing,
    pub setpoints: Consumer<DueSetpoint>,
    pub periphery: PeripheryTrack,
    pub spindles: SpindleCommands,
    /// Spindles whose override is off with the last published setpoint.
    pub override_off_mask: u32,
    /// Outputs and inputs, if the machine has any.
    pub signals: Option<SignalPort>,
    pub stops: Option<StopWatch>,
    pub status: S,
}

impl<S: StatusSource> Publisher<S> {
    /// Returns the body of the thread, which requests this priority, and the pending result of opening the
    /// bus.
    pub(crate) fn prepare(
        self,
        request: Option<RealtimeRequest>,
    ) -> (impl FnOnce() -> PublishReport, Opening) {
        let (ready, opening) = mpsc::channel();
        let body = move || {
            if let Some(request) = request {
                // The cycle's thread requests the same and more, and reports the result.
                let _granted = apply_to_this_thread(&request);
            }
            self.run(&ready)
        };
        (body, Opening(opening))
    }

    /// Opens the bus, sends the result and the number of subscribers to `ready`, and publishes until cycle
    /// and status have ended.
    fn run(mut self, ready: &Sender<Result<usize, BusError>>) -> PublishReport {
        let mut report = PublishReport::default();
        let publishing = &self.publishing;
        let mut bus = match CoreBus::open(&publishing.config) {
            Ok(bus) => bus,
            Err(error) => {
                let _gone = ready.send(Err(error));
                return report;
            }
        };
        let subscribers = publishing.await_subscribers(&bus);
        report.observe_listeners(publishing.listeners(&bus));
        let _gone = ready.send(Ok(subscribers));
        let nap_ns =
            (wake_interval_ns(publishing.config.period_ns, publishing.lead_cycles) / 2).min(LONGEST_SLEEP_NS);
        let mut next_refresh_ns = 0;
        self.tell(&mut bus, &report, S::begin);
        loop {
            let is_over = self.setpoints.is_abandoned() && self.status.is_over();
            while let Ok(due) = self.setpoints.pop() {
                self.publish(&mut bus, &mut report, &due);
            }
            self.take_in(&mut bus, &mut report);
            self.tell(&mut bus, &report, S::poll);
            let now_ns = MonotonicClock::now_ns();
            if now_ns >= next_refresh_ns || is_over {
                next_refresh_ns = now_ns + REFRESH_EVERY_NS;
                bus.admit_readers();
                report.observe_listeners(self.publishing.listeners(&bus));
                if let Some(signals) = &mut self.signals {
                    // A new reader, and one that lost a message, needs the present outputs.
                    signals.send(&mut bus);
                    report.refused_inputs = signals.refused();
                    report.refused_spindles = signals.refused_spindles();
                }
                self.tell(&mut bus, &report, S::refresh);
            }
            if is_over && self.setpoints.is_empty() {
                return report;
            }
            let _late = MonotonicClock::sleep_until(now_ns + nap_ns);
        }
    }

    /// Publishes a setpoint, after the outputs that change with it.
    fn publish(&mut self, bus: &mut CoreBus, report: &mut PublishReport, due: &DueSetpoint) {
        let is_switched = self.periphery.follow(due);
        let outputs = &self.periphery.now().outputs;
        let x_mm = due.setpoint.position[0];
        self.override_off_mask = due.override_off_mask;
        self.spindles
            .follow(outputs, x_mm, &due.spindle_overrides, is_switched);
        if due.setpoint.state == MotionState::Fault || due.drive.power != PowerRequest::On {
            self.spindles.end_ramps();
        }
        self.publishing
            .controls
            .report_ramps(due.setpoint.sequence, self.spindles.ramps_turn());
        if let Some(signals) = &mut self.signals {
            let periphery = is_switched.then(|| self.periphery.now());
            signals.follow(bus, due, periphery, &self.spindles.now());
        }
        let message = self.publishing.message(due);
        let is_realtime = self.publishing.clock == Clock::Realtime;
        report.late += u64::from(is_realtime && MonotonicClock::now_ns() > due.due_time_ns);
        report.failed += u64::from(bus.publish_setpoint(&message).is_err());
        if let Some(stops) = &mut self.stops {
            stops.follow(due);
        }
        self.tell(bus, report, |status, port| {
            status.follow(port, due, &message, is_switched);
        });
    }

    /// Receives the messages of bridges and sensors.
    fn take_in(&mut self, bus: &mut CoreBus, report: &mut PublishReport) {
        // A bridge of another version counts as none.
        while let Ok(Some(feedback)) = bus.unchecked_feedback() {
            report.listeners = report.listeners.max(1);
            self.status.receive(&feedback);
            if let Some(signals) = &mut self.signals {
                signals.observe_feedback(&feedback);
            }
        }
        let controls = &self.publishing.controls;
        if let Some(signals) = &mut self.signals {
            signals.take_inputs(bus, MonotonicClock::now_ns());
            controls.set_chain_closed(signals.is_chain_closed());
        }
        // Each message counts as a reading; the cycle uses the newest.
        while let Ok(Some(load)) = bus.load() {
            controls.set_load(load.value, load.range_max);
        }
    }

    fn tell(
        &mut self,
        bus: &mut CoreBus,
        report: &PublishReport,
        what: impl FnOnce(&mut S, &mut StatusPort<'_>),
    ) {
        let mut port = StatusPort {
            bus,
            stops: self.stops.as_mut(),
            report,
            periphery: self.periphery.now(),
            spindles: SpindleStatus {
                commands: &self.spindles,
                signals: self.signals.as_ref(),
                override_off_mask: self.override_off_mask,
                now_ns: MonotonicClock::now_ns(),
            },
        };
        what(&mut self.status, &mut port);
    }
}
