//! A turning cycle that finds its passes, between two steps of a plan.
//!
//! The plan stands still meanwhile: the cycle begins and ends at the place where the plan goes on.

use evolvent_path::{Axes, AxisLetter, Jet};
use evolvent_turning::{AxisPoint, TurningController, TurningInputs, TurningOutput, TurningState};
use evolvent_wire::flags;

use crate::path_executor::PathExecutor;
use crate::queue::PlanConsumer;
use crate::setpoint::{Inputs, Setpoint};
use crate::state::State;

/// Where the cut lies in the machine: places along it and heights above the final size to coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TurningFrame {
    /// Where the tool stands before and after, machine coordinates.
    pub start: Axes,
    /// The axis along the cut, its coordinate at place 0, and 1 or -1: which way places count.
    pub along: (AxisLetter, f64, f64),
    /// The axis across it, its coordinate at the final size, and 1 or -1: which way heights count.
    pub out: (AxisLetter, f64, f64),
}

impl TurningFrame {
    /// Place along the cut and height at the start, mm.
    #[must_use]
    pub fn start_mm(&self) -> (f64, f64) {
        let of = |(axis, origin, sign): (AxisLetter, f64, f64)| sign * (self.start[axis.index()] - origin);
        (of(self.along), of(self.out))
    }

    /// Machine coordinates of a place and a height. Real-time safe.
    #[must_use]
    pub fn position(&self, along_mm: f64, out_mm: f64) -> Axes {
        let mut position = self.start;
        for ((axis, origin, sign), value) in [(self.along, along_mm), (self.out, out_mm)] {
            position[axis.index()] = origin + sign * value;
        }
        position
    }

    fn jet(&self, along: &AxisPoint, out: &AxisPoint) -> Jet {
        let mut jet = Jet::at_rest(self.position(along.position, out.position));
        for ((axis, _, sign), point) in [(self.along, along), (self.out, out)] {
            let i = axis.index();
            jet.first[i] = sign * point.velocity;
            jet.second[i] = sign * point.acceleration;
            jet.third[i] = sign * point.jerk;
        }
        jet
    }
}

/// A controller, and where it works. Built outside the cycle and handed over in a box by a
/// [`TurningSender`](crate::TurningSender), before the plan's [`Step::Turning`](evolvent_planner::Step::Turning).
#[derive(Clone, Debug)]
pub struct Turning {
    controller: TurningController,
    frame: TurningFrame,
}

impl Turning {
    /// A controller that starts, and ends, at the frame's start.
    #[must_use]
    pub fn new(controller: TurningController, frame: TurningFrame) -> Self {
        Self { controller, frame }
    }

    /// Whether nothing moves. Real-time safe.
    pub(crate) fn is_at_rest(&self) -> bool {
        self.controller.is_at_rest()
    }

    fn advance(&mut self, inputs: &TurningInputs) -> (Jet, TurningOutput) {
        let output = self.controller.step(inputs);
        let mut jet = self.frame.jet(&output.along, &output.out);
        if self.is_done() {
            // To the last bit: the plan goes on here.
            jet.position = self.frame.start;
        }
        (jet, output)
    }

    fn is_done(&self) -> bool {
        self.controller.state() == TurningState::Done && self.controller.is_at_rest()
    }
}

impl PathExecutor {
    /// One setpoint of the turning cycle.
    pub(crate) fn turn(&mut self, inputs: &Inputs, queue: &mut PlanConsumer) -> Setpoint {
        let Some(turning) = &mut self.turning else {
            return self.step_quick_stop();
        };
        let (jet, output) = turning.advance(&TurningInputs {
            load: inputs.load,
            start: true,
            hold: inputs.hold || self.stop,
            feed_override: self.feed_override,
        });
        self.turned = Some(output);
        let (at_rest, is_done) = (turning.is_at_rest(), turning.is_done());
        if let Err(violation) = self.guard.check(&jet.position, false, false) {
            self.fault.get_or_insert(violation);
            self.start_quick_stop();
            return self.step_quick_stop();
        }
        if let (TurningState::Fault, Some(change)) = (output.state, output.transition) {
            self.turning_fault = Some(change.reason);
        }
        self.guard.publish(&jet.position, false);
        self.last = jet;
        let stands = inputs.hold && !self.stop;
        self.cursor.turns = false;
        self.cursor.state = match output.state {
            TurningState::Fault => State::Fault,
            _ if self.stop && at_rest => State::Stopped,
            _ if self.stop => State::Stopping,
            _ if stands && at_rest => State::Held,
            _ if stands => State::Holding,
            _ => State::Running,
        };
        if is_done && !self.stop {
            self.cursor.pass_rest();
            if let Some(turning) = self.turning.take() {
                queue.return_turning(turning);
            }
        }
        let mut bits = 0;
        for (set, bit) in [
            (stands, flags::HOLD),
            (self.fault.is_some(), flags::GUARD),
            (self.is_over(), flags::LAST),
        ] {
            if set {
                bits |= bit;
            }
        }
        self.setpoint(jet, self.cursor.path(), bits)
    }
}
