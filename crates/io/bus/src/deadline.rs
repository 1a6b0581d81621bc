//! Time limits of waits.

use core::time::Duration;
use std::time::Instant;

/// Begin and length of a wait, from one reading of the clock: an error never reports a shorter wait than the
/// one that was configured.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Deadline {
    begin: Instant,
    wait: Duration,
}

impl Deadline {
    /// This long from now.
    pub(crate) fn after(wait: Duration) -> Self {
        Self {
            begin: Instant::now(),
            wait,
        }
    }

    pub(crate) fn has_passed(self) -> bool {
        self.begin.elapsed() >= self.wait
    }

    pub(crate) fn waited_ms(self) -> u64 {
        self.begin.elapsed().as_millis() as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_has_passed_was_waited_for() {
        for wait_ms in [0, 1, 7] {
            let deadline = Deadline::after(Duration::from_millis(wait_ms));
            while !deadline.has_passed() {}
            assert!(deadline.waited_ms() >= wait_ms);
        }
    }
}
