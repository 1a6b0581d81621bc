//! Runs that nobody watches.

use evolvent_runtime::{Controls, Notice, RunObserver};

/// Drops what a run tells.
pub(crate) struct Unobserved;

impl RunObserver for Unobserved {
    fn progress(&mut self, _: &Controls) {}
    fn notice(&mut self, _: &Notice) {}
    fn note(&mut self, _: &str) {}
}
