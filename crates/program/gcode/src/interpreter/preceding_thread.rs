//! A thread that the lines before a restart have started.

use crate::Action;

/// The thread to which the last command belongs, if it is one.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct PrecedingThread {
    /// Spindle, angle and first line.
    section: Option<(u32, f64, u32)>,
}

impl PrecedingThread {
    pub(crate) fn is_open(&self) -> bool {
        self.section.is_some()
    }

    /// Observes the next command. Returns the first line of the thread that it continues.
    pub(crate) fn observe(&mut self, action: &Action, line: u32) -> Option<u32> {
        let before = self.section.take();
        let Action::Thread {
            spindle,
            start_degrees,
            ..
        } = *action
        else {
            return None;
        };
        let first = before
            .filter(|(of, degrees, _)| (*of, *degrees) == (spindle, start_degrees))
            .map(|(.., first)| first);
        self.section = Some((spindle, start_degrees, first.unwrap_or(line)));
        first
    }
}
