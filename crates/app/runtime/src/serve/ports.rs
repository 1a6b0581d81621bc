//! The publisher's thread of a machine that is served: setpoints and status out, feedback and loads in.

use std::sync::mpsc::Sender;

use evolvent_bus::{BusError, CoreBus, EventKind, Feedback, Status};
use rtrb::{Consumer, Producer};

use crate::due_setpoint::DueSetpoint;
use crate::pacing::wake_interval_ns;
use crate::periphery_track::PeripheryTrack;
use crate::publisher::{PublishReport, Publishing};
use crate::rt::MonotonicClock;
use crate::signal_port::SignalPort;
use crate::stop_watch::StopWatch;

/// Longest sleep between two looks at the queue.
const LONGEST_SLEEP_NS: u64 = 1_000_000;
/// Time between two looks for readers that have joined.
const ADMIT_EVERY_NS: u64 = 50_000_000;

/// A snapshot on its way out, and what it explains.
pub(crate) struct Snapshot {
    pub status: Status,
    pub event: Option<EventKind>,
}

/// Queues of the publisher.
pub(crate) struct Ports {
    pub setpoints: Consumer<DueSetpoint>,
    pub snapshots: Consumer<Snapshot>,
    /// To the cycle.
    pub feedback: Producer<Feedback>,
    /// To control: every one, in order.
    pub answers: Producer<Feedback>,
    /// Outputs and inputs of the machine, where it has any.
    pub signals: Option<SignalPort>,
    pub periphery: PeripheryTrack,
    pub stops: Option<StopWatch>,
    /// To control: late and failed setpoints so far, subscribers.
    pub counts: Producer<(PublishReport, usize)>,
}

impl Ports {
    /// Opens the bus, tells `ready` how that went, and serves it until the cycle has gone.
    pub(crate) fn run(
        mut self,
        publishing: &Publishing,
        ready: &Sender<Result<(), BusError>>,
    ) -> PublishReport {
        let mut report = PublishReport::default();
        let mut bus = match CoreBus::open(&publishing.config) {
            Ok(bus) => bus,
            Err(error) => {
                let _gone = ready.send(Err(error));
                return report;
            }
        };
        let _gone = ready.send(Ok(()));
        let nap =
            (wake_interval_ns(publishing.config.period_ns, publishing.lead_cycles) / 2).min(LONGEST_SLEEP_NS);
        let mut next_admission = 0;
        loop {
            let over = self.setpoints.is_abandoned() && self.snapshots.is_abandoned();
            while let Ok(due) = self.setpoints.pop() {
                let is_switched = self.periphery.follow(&due);
                if let Some(signals) = &mut self.signals {
                    signals.follow(&mut bus, &due, is_switched.then(|| self.periphery.now()));
                }
                let message = publishing.message(&due);
                if MonotonicClock::now_ns() > due.due_time_ns {
                    report.late += 1;
                }
                if bus.publish_setpoint(&message).is_err() {
                    report.failed += 1;
                }
                if let Some(stops) = &mut self.stops {
                    stops.follow(&due);
                }
            }
            // A bridge of another version is as good as none.
            while let Ok(Some(feedback)) = bus.unchecked_feedback() {
                report.listeners = report.listeners.max(1);
                // What the cycle does not take in time is older than what it has. Its watch names what is no number;
                // nobody else sees it.
                let _full = self.feedback.push(feedback);
                if feedback.is_finite() {
                    let _full = self.answers.push(feedback);
                }
            }
            if let Some(signals) = &mut self.signals {
                signals.take_inputs(&mut bus, MonotonicClock::now_ns());
            }
            while let Ok(Some(load)) = bus.load() {
                publishing.controls.see_load(load.value, load.range_max);
            }
            while let Ok(mut snapshot) = self.snapshots.pop() {
                if let Some(stops) = &mut self.stops {
                    stops.fill(&mut snapshot.status);
                }
                // A status or an event that does not leave is replaced by the next.
                let _lost = bus.publish_status(&snapshot.status);
                if let Some(event) = snapshot.event {
                    let _lost = bus.notify(event);
                }
            }
            let now = MonotonicClock::now_ns();
            if now >= next_admission {
                next_admission = now + ADMIT_EVERY_NS;
                bus.admit_readers();
                report.see_listeners(&bus);
                if let Some(signals) = &mut self.signals {
                    // Who has joined, and who has lost one, needs the outputs in force.
                    signals.send(&mut bus);
                    report.refused_inputs = signals.refused();
                }
                let _full = self.counts.push((report, bus.setpoint_subscribers()));
            }
            if over && self.setpoints.is_empty() && self.snapshots.is_empty() {
                return report;
            }
            let _late = MonotonicClock::sleep_until(now + nap);
        }
    }
}
