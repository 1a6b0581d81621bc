//! Saves a plan, so that another can be made from any position on it.

use crate::optimizer::Optimizer;
use crate::warm_start::WarmStart;

/// A saved plan of an [`Optimizer`].
///
/// A plan from motion starts at a state on the last plan. To replan from an earlier position after further
/// plans, restore the plan of that position first.
#[derive(Clone, Debug, Default)]
pub struct PlanSnapshot(WarmStart);

impl Optimizer {
    /// Saves the last plan into `snapshot`, reusing its memory.
    pub fn save(&self, snapshot: &mut PlanSnapshot) {
        snapshot.0.copy_from(&self.last_plan);
    }

    /// Scales the last plan in time: it is executed `rate` times as fast, `0 < rate <= 1`, which keeps every
    /// limit. A plan from motion can then start at a state of it. Not real-time safe.
    pub fn slow_down(&mut self, rate: f64) {
        self.last_plan.slow_down(rate);
    }

    /// Restores a saved plan as the last one.
    pub fn restore(&mut self, snapshot: &PlanSnapshot) {
        self.last_plan.copy_from(&snapshot.0);
    }
}
