//! What an operator switches while a program is being read: it counts for the lines that are still to be read.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Switches of one program, for its planner. Read line by line.
#[derive(Debug)]
pub(crate) struct Switches {
    single_step: AtomicBool,
    optional_stop: AtomicBool,
    block_delete: AtomicBool,
    rapid_override: AtomicU64,
}

impl Switches {
    /// Single step off; share of the axes' speed that rapids may use, 0 to 1.
    pub(crate) fn new(optional_stop: bool, block_delete: bool, rapid_override: f64) -> Self {
        Self {
            single_step: AtomicBool::new(false),
            optional_stop: AtomicBool::new(optional_stop),
            block_delete: AtomicBool::new(block_delete),
            rapid_override: AtomicU64::new(rapid_override.to_bits()),
        }
    }

    /// Stop behind each line that moves.
    pub(crate) fn set_single_step(&self, on: bool) {
        self.single_step.store(on, Ordering::Relaxed);
    }

    pub(crate) fn is_single_step(&self) -> bool {
        self.single_step.load(Ordering::Relaxed)
    }

    /// Stop at M1.
    pub(crate) fn set_optional_stop(&self, on: bool) {
        self.optional_stop.store(on, Ordering::Relaxed);
    }

    pub(crate) fn is_optional_stop(&self) -> bool {
        self.optional_stop.load(Ordering::Relaxed)
    }

    /// Leave out lines that begin with `/`.
    pub(crate) fn set_block_delete(&self, on: bool) {
        self.block_delete.store(on, Ordering::Relaxed);
    }

    pub(crate) fn is_block_delete(&self) -> bool {
        self.block_delete.load(Ordering::Relaxed)
    }

    /// Share of the axes' speed that rapids may use, 0 to 1.
    pub(crate) fn set_rapid_override(&self, ratio: f64) {
        self.rapid_override.store(ratio.to_bits(), Ordering::Relaxed);
    }

    pub(crate) fn rapid_override(&self) -> f64 {
        f64::from_bits(self.rapid_override.load(Ordering::Relaxed))
    }
}
