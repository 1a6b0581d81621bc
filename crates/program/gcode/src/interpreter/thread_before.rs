//! A thread that the lines before a restart have begun.

use crate::Action;

/// The thread to which the last command belongs, if it is one.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ThreadBefore {
    /// Spindle, angle and first line.
    open: Option<(u32, f64, u32)>,
}

impl ThreadBefore {
    pub(crate) fn is_open(&self) -> bool {
        self.open.is_some()
    }

    /// Observes the next command. Returns the first line of the thread that it continues.
    pub(crate) fn note(&mut self, action: &Action, line: u32) -> Option<u32> {
        let before = self.open.take();
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
        self.open = Some((spindle, start_degrees, first.unwrap_or(line)));
        first
    }
}
