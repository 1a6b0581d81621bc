//! Steps of a recorded run, computed again.

use crate::path_executor::PathExecutor;
use crate::queue::PlanConsumer;
use crate::setpoint::{Inputs, Setpoint};

/// What a recorded step met of the planner. In real time that depends on how fast the planner was.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PlannerLag {
    /// Number, within the step, of the first look at the plan that found something not finished: the axes
    /// stood, or took a tail. 255 stands for all from there on.
    pub failed_look: Option<u8>,
    /// It met an answer that came to nothing: the planner found no plan, or was too late with it.
    pub refused: bool,
}

impl PathExecutor {
    /// As [`step`](Self::step), where the planner was as late as the recorded step has met it: whatever it
    /// has finished by now is taken as not finished, or as refused.
    pub fn replay_step(&mut self, inputs: &Inputs, queue: &mut PlanConsumer, lag: PlannerLag) -> Setpoint {
        self.step_with(inputs, queue, lag)
    }
}
