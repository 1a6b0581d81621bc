//! Runs without an observer.

use evolvent_runtime::{Controls, Notice, RunObserver};

/// Discards the events of a run.
pub(crate) struct Unobserved;

impl RunObserver for Unobserved {
    fn progress(&mut self, _: &Controls) {}
    fn notice(&mut self, _: &Notice) {}
    fn note(&mut self, _: &str) {}
}
