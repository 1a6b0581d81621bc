//! The status of a run or of a served machine, and its publication.

use evolvent_bus::{CoreBus, EventKind, Feedback, Status};
use evolvent_drive::DriveState;
use evolvent_gcode::Modal;
use evolvent_motion::MotionState;
use evolvent_path::{Axes, AxisMask};

use crate::due_setpoint::DueSetpoint;
use crate::periphery::Periphery;
use crate::publish_report::PublishReport;
use crate::spindle_status::SpindleStatus;
use crate::stop_watch::StopWatch;

/// Makes the status, and receives the drives' feedback.
pub(crate) trait StatusSource {
    /// The bus is open; nothing was published yet.
    fn begin(&mut self, port: &mut StatusPort<'_>);

    /// A setpoint was published. `is_switched`: the periphery has changed with it.
    fn follow(
        &mut self,
        port: &mut StatusPort<'_>,
        due: &DueSetpoint,
        message: &evolvent_bus::Setpoint,
        is_switched: bool,
    );

    /// Feedback of the drives has arrived.
    fn receive(&mut self, feedback: &Feedback);

    /// Called on every poll of the queues.
    fn poll(&mut self, port: &mut StatusPort<'_>);

    /// Called periodically, and at the end.
    fn refresh(&mut self, port: &mut StatusPort<'_>);

    /// Whether no thread will report on the machine any more.
    fn is_over(&self) -> bool;
}

/// Writes the drives' newest feedback into a status.
pub(crate) fn show_feedback(status: &mut Status, feedback: &Feedback, now_ns: u64) {
    status.feedback_age_ns = now_ns.saturating_sub(feedback.time_ns);
    status.position_actual = feedback.position;
    status.following_error = feedback.following_error;
    status.enabled_mask = 0;
    for axis in AxisMask::from_bits(feedback.axes_mask).axes() {
        let state = DriveState::decode((feedback.status_word[axis] & 0xFFFF) as u16);
        status.enabled_mask |= AxisMask::one_if(axis, state == Some(DriveState::OperationEnabled)).bits();
    }
}

/// Writes the modes in force, and a position of the machine in work coordinates.
pub(crate) fn show_modal(status: &mut Status, modal: &Modal, machine: Axes) {
    status.work_system = modal.work_system;
    status.work_offset = modal.work_offset.into();
    status.tool_offset = modal.tool_offset.into();
    status.modal = modal.codes;
    status.position_work = modal.work_position(machine).into();
}

/// Publishes the status, and adds what the publisher itself knows.
pub(crate) struct StatusPort<'a> {
    pub bus: &'a mut CoreBus,
    pub stops: Option<&'a mut StopWatch>,
    pub report: &'a PublishReport,
    /// State with the last published setpoint.
    pub periphery: &'a Periphery,
    /// The spindles with that setpoint.
    pub spindles: SpindleStatus<'a>,
}

impl StatusPort<'_> {
    /// Publishes a status. One that cannot be sent is superseded by the next. `lines_before`: lines of its job
    /// that the operator has not written.
    pub(crate) fn publish(&mut self, status: &mut Status, lines_before: u32) {
        if let Some(stops) = &mut self.stops {
            stops.fill(status, lines_before);
        }
        self.spindles.fill(self.periphery, status);
        let _lost = self.bus.publish_status(status);
    }

    /// Wakes waiting readers, after the status that gives the reason.
    pub(crate) fn notify(&mut self, event: EventKind) {
        let _lost = self.bus.notify(event);
    }

    /// Number of connected readers of setpoints.
    pub(crate) fn subscribers(&self) -> usize {
        self.bus.setpoint_subscribers()
    }
}

/// The event for a change from one state of motion to another.
pub(crate) fn event_of(before: MotionState, now: MotionState) -> EventKind {
    match (before, now) {
        (_, MotionState::Holding | MotionState::Held) => EventKind::Hold,
        (MotionState::Holding | MotionState::Held, MotionState::Running) => EventKind::Resumed,
        (_, MotionState::Stopped) => EventKind::Stopped,
        (_, MotionState::Done) => EventKind::Done,
        (_, MotionState::Fault) => EventKind::Fault,
        _ => EventKind::StatusChanged,
    }
}
