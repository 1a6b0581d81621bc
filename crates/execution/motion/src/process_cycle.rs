//! Motion that a process finds cycle by cycle, between two steps of a plan.
//!
//! The plan does not advance meanwhile: the motion begins and ends at the position where the plan goes on.

use std::any::Any;
use std::fmt::Debug;

use evolvent_machine::LoadSample;
use evolvent_path::Jet;

use crate::path_executor::PathExecutor;
use crate::queue::PlanConsumer;
use crate::setpoint::{Inputs, Setpoint};
use crate::state::State;

/// What a process cycle goes by in one period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProcessInputs {
    /// The newest reading of the cutting load, the same again where there is no newer one.
    pub load: Option<LoadSample>,
    /// Decelerate and stay at rest while this is set.
    pub hold: bool,
    /// Feed override, 1 at 100 %.
    pub feed_override: f64,
}

/// What a process cycle has come to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProcessStatus {
    /// It moves, or is held.
    Running,
    /// At rest where it began, to the last bit: the plan goes on.
    Done,
    /// It has given up: the axes stop, and the run with them.
    Failed,
}

/// Motion that a process finds: a turning cycle that takes its passes from the cutting load, for one.
///
/// It is built outside the cycle and handed over in a box by a [`ProcessSender`](crate::ProcessSender),
/// before the plan's [`Step::Turning`](evolvent_planner::Step::Turning). Its methods are called by the
/// real-time cycle: they do not allocate, lock or wait, and their work is bounded. The guard checks every
/// position. As [`Any`], [`PathExecutor::process`] is read by the type that was handed over.
pub trait ProcessCycle: Any + Debug + Send {
    /// Position and derivatives one period later, and what the cycle has come to.
    fn step(&mut self, inputs: &ProcessInputs) -> (Jet, ProcessStatus);

    /// Whether nothing moves.
    fn is_at_rest(&self) -> bool;
}

/// The process cycle of an executor, if any.
#[derive(Debug, Default)]
pub(crate) struct ProcessSlot {
    /// It moves the axes, or has ended the run.
    active: Option<Box<dyn ProcessCycle>>,
    /// It was done in the last step, and is handed back in the next.
    done: Option<Box<dyn ProcessCycle>>,
    has_moved: bool,
    has_failed: bool,
}

impl ProcessSlot {
    pub(crate) fn begin(&mut self, process: Option<Box<dyn ProcessCycle>>) {
        self.active = process;
    }

    /// Before a step: what is over is handed back.
    pub(crate) fn hand_back(&mut self, queue: &mut PlanConsumer) {
        self.has_moved = false;
        if let Some(done) = self.done.take() {
            queue.processes.give_back(done);
        }
    }

    pub(crate) fn is_active(&self) -> bool {
        self.active.is_some()
    }

    pub(crate) fn is_at_rest(&self) -> bool {
        self.active.as_ref().is_none_or(|process| process.is_at_rest())
    }

    fn step(&mut self, inputs: &ProcessInputs) -> Option<(Jet, ProcessStatus)> {
        let (jet, status) = self.active.as_mut()?.step(inputs);
        self.has_moved = true;
        Some((jet, status))
    }
}

impl PathExecutor {
    /// The process cycle that moved the axes in the last step.
    #[must_use]
    pub fn process(&self) -> Option<&dyn ProcessCycle> {
        let process = self.process.active.as_deref().or(self.process.done.as_deref());
        process.filter(|_| self.process.has_moved)
    }

    /// The process cycle that has ended the run.
    #[must_use]
    pub fn failed_process(&self) -> Option<&dyn ProcessCycle> {
        self.process.active.as_deref().filter(|_| self.process.has_failed)
    }

    /// One setpoint of the process cycle.
    pub(crate) fn step_process(&mut self, inputs: &Inputs) -> Setpoint {
        let stepped = self.process.step(&ProcessInputs {
            load: inputs.load,
            hold: inputs.hold || self.stop,
            feed_override: self.feed_override,
        });
        let Some((jet, status)) = stepped else {
            return self.step_quick_stop();
        };
        let is_at_rest = self.process.is_at_rest();
        if !self.accept(&jet) {
            return self.step_quick_stop();
        }
        self.process.has_failed |= status == ProcessStatus::Failed;
        let is_held = inputs.hold && !self.stop;
        self.cursor.state = match status {
            ProcessStatus::Failed => State::Fault,
            _ => self.takeover_state(is_held, is_at_rest),
        };
        if status == ProcessStatus::Done && !self.stop {
            self.cursor.pass_rest();
            self.process.done = self.process.active.take();
        }
        self.takeover_setpoint(jet, is_held)
    }
}
