//! Motion that a process determines cycle by cycle, between two steps of a plan.
//!
//! Meanwhile the plan does not advance: the motion begins and ends at the position at which the plan
//! continues.

use std::any::Any;
use std::fmt::Debug;

use evolvent_machine::LoadSample;
use evolvent_path::Jet;

use crate::path_executor::PathExecutor;
use crate::queue::PlanConsumer;
use crate::setpoint::{Inputs, Setpoint};
use crate::state::MotionState;

/// Inputs of a process cycle in one period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProcessInputs {
    /// The newest reading of the cutting load, repeated if there is no newer one.
    pub load: Option<LoadSample>,
    /// Decelerate and stay at rest while this is set.
    pub hold: bool,
    /// Feed override, 1 at 100 %.
    pub feed_override: f64,
}

/// The status of a process cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProcessStatus {
    /// It moves, or is held.
    Running,
    /// At rest exactly where it began: the plan continues.
    Done,
    /// It has failed: the axes stop and the run ends.
    Failed,
}

/// Motion that a process determines, for example a turning cycle that adapts its passes to the cutting load.
///
/// It is built outside the cycle and passed in a box by a [`ProcessSender`](crate::ProcessSender), before the
/// plan's [`Step::Turning`](evolvent_planner::Step::Turning). The real-time cycle calls its methods: they do
/// not allocate, lock or wait, and their work is bounded. The guard checks every position. As [`Any`], the
/// value of [`PathExecutor::process`] can be downcast to the type that was passed.
pub trait ProcessCycle: Any + Debug + Send {
    /// Position and derivatives one period later, and the status.
    fn step(&mut self, inputs: &ProcessInputs) -> (Jet, ProcessStatus);

    /// Whether nothing moves.
    fn is_at_rest(&self) -> bool;
}

/// The process cycle of an executor, if any.
#[derive(Debug, Default)]
pub(crate) struct ProcessSlot {
    /// The process cycle that moves the axes or has ended the run.
    active: Option<Box<dyn ProcessCycle>>,
    /// The process cycle that was done in the last step; the next step returns it.
    done: Option<Box<dyn ProcessCycle>>,
    has_moved: bool,
    has_failed: bool,
}

impl ProcessSlot {
    pub(crate) fn begin(&mut self, process: Option<Box<dyn ProcessCycle>>) {
        self.active = process;
    }

    /// Returns a completed process cycle before a step.
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
            ProcessStatus::Failed => MotionState::Fault,
            _ => self.takeover_state(is_held, is_at_rest),
        };
        if status == ProcessStatus::Done && !self.stop {
            self.cursor.pass_rest();
            self.process.done = self.process.active.take();
        }
        self.takeover_setpoint(jet, is_held)
    }
}
