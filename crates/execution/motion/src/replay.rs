//! Recomputes steps of a recorded run.

use crate::path_executor::PathExecutor;
use crate::queue::PlanConsumer;
use crate::setpoint::{Inputs, Setpoint};

/// The lag of the planner in a recorded step. In real time it depends on the speed of the planner.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PlannerLag {
    /// Number, within the step, of the first look at the plan that found something unfinished: the axes
    /// stayed at rest, or entered a tail. 255 stands for all larger numbers.
    pub failed_lookup: Option<u8>,
    /// A request failed: the planner found no plan, or was too late.
    pub refused: bool,
}

impl PathExecutor {
    /// As [`step`](Self::step), with the planner as late as in the recorded step: steps that it has finished
    /// by now count as unfinished, or as refused.
    pub fn replay_step(&mut self, inputs: &Inputs, queue: &mut PlanConsumer, lag: PlannerLag) -> Setpoint {
        self.step_with(inputs, queue, lag)
    }
}
