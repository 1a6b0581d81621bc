//! The status of a served machine, made by the control thread, and the drives' feedback to cycle and control
//! thread.

use evolvent_bus::{EventKind, Feedback, Setpoint, Status};
use rtrb::{Consumer, Producer};

use crate::due_setpoint::DueSetpoint;
use crate::publish_report::PublishReport;
use crate::status_source::{StatusPort, StatusSource};

/// A snapshot to be published, with its event.
pub(crate) struct Snapshot {
    pub status: Status,
    pub event: Option<EventKind>,
    /// Lines of its job that the operator has not written.
    pub lines_before: u32,
}

/// The publisher's ends of the queues to control thread and cycle.
pub(crate) struct ServedStatus {
    pub snapshots: Consumer<Snapshot>,
    /// To the cycle.
    pub feedback: Producer<Feedback>,
    /// To the control thread: all feedback, in order.
    pub answers: Producer<Feedback>,
    /// To the control thread: late and failed setpoints so far, and subscribers.
    pub counts: Producer<(PublishReport, usize)>,
}

impl StatusSource for ServedStatus {
    fn begin(&mut self, _: &mut StatusPort<'_>) {}

    fn follow(&mut self, _: &mut StatusPort<'_>, _: &DueSetpoint, _: &Setpoint, _: bool) {}

    fn receive(&mut self, feedback: &Feedback) {
        // Feedback that the cycle does not take in time is older than what it has. Its watch reports values
        // that are not finite; no other part sees them.
        let _full = self.feedback.push(*feedback);
        if feedback.is_finite() {
            let _full = self.answers.push(*feedback);
        }
    }

    fn poll(&mut self, port: &mut StatusPort<'_>) {
        while let Ok(mut snapshot) = self.snapshots.pop() {
            port.publish(&mut snapshot.status, snapshot.lines_before);
            if let Some(event) = snapshot.event {
                port.notify(event);
            }
        }
    }

    fn refresh(&mut self, port: &mut StatusPort<'_>) {
        let _full = self.counts.push((*port.report, port.subscribers()));
    }

    fn is_over(&self) -> bool {
        self.snapshots.is_abandoned()
    }
}
