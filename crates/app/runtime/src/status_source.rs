//! What the status says, and its way to the bus: of a run and of a served machine alike.

use evolvent_bus::{CoreBus, EventKind, Feedback, Status};
use evolvent_motion::State;

use crate::due_setpoint::DueSetpoint;
use crate::periphery::Periphery;
use crate::publish_report::PublishReport;
use crate::spindle_status::SpindleStatus;
use crate::stop_watch::StopWatch;

/// What the status says, and who receives the drives' feedback.
pub(crate) trait StatusSource {
    /// The bus is open, and nothing has left.
    fn begin(&mut self, port: &mut StatusPort<'_>);

    /// A setpoint has left. `is_switched`: the periphery has changed with it.
    fn follow(
        &mut self,
        port: &mut StatusPort<'_>,
        due: &DueSetpoint,
        message: &evolvent_bus::Setpoint,
        is_switched: bool,
    );

    /// The drives have answered.
    fn receive(&mut self, feedback: &Feedback);

    /// At every look at the queues.
    fn look(&mut self, port: &mut StatusPort<'_>);

    /// Now and then, and at the end.
    fn refresh(&mut self, port: &mut StatusPort<'_>);

    /// Whether nothing will report on the machine any more.
    fn is_over(&self) -> bool;
}

/// The way of the status to the bus, and what the publisher knows itself.
pub(crate) struct StatusPort<'a> {
    pub bus: &'a mut CoreBus,
    pub stops: Option<&'a mut StopWatch>,
    pub report: &'a PublishReport,
    /// With the setpoint that has left last.
    pub periphery: &'a Periphery,
    /// The spindles with that setpoint.
    pub spindles: SpindleStatus<'a>,
}

impl StatusPort<'_> {
    /// Sends a status. One that does not leave is replaced by the next.
    pub(crate) fn publish(&mut self, status: &mut Status) {
        if let Some(stops) = &mut self.stops {
            stops.fill(status);
        }
        self.spindles.fill(self.periphery, status);
        let _lost = self.bus.publish_status(status);
    }

    /// Wakes those who wait, after the status that explains why.
    pub(crate) fn notify(&mut self, event: EventKind) {
        let _lost = self.bus.notify(event);
    }

    /// Readers of setpoints that are connected.
    pub(crate) fn subscribers(&self) -> usize {
        self.bus.setpoint_subscribers()
    }
}

/// What those receive who wait for a change from one state of motion to another.
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
