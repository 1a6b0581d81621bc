//! A plan set aside, so that another can be made from any place on it.

use crate::optimizer::Optimizer;
use crate::warm_start::WarmStart;

/// A plan of an [`Optimizer`] as it was when it was remembered.
///
/// A moving plan starts from a state on the last plan. Who has planned on since, and wants to plan anew from an
/// earlier place, recalls the plan of that place first.
#[derive(Clone, Debug, Default)]
pub struct Memory(WarmStart);

impl Optimizer {
    /// Sets the last plan aside; what `memory` held is overwritten, its space used again.
    pub fn remember(&self, memory: &mut Memory) {
        memory.0.copy_from(&self.kept);
    }

    /// Takes the last plan as driven `rate` times as fast, `0 < rate <= 1`, which keeps every limit: a moving plan can then start
    /// from a state on that. Cycle: no.
    pub fn slow_down(&mut self, rate: f64) {
        self.kept.slow_down(rate);
    }

    /// Makes a plan the last one again.
    pub fn recall(&mut self, memory: &Memory) {
        self.kept.copy_from(&memory.0);
    }
}
