//! The feed word of every block, found by interpreting the program a second time alongside its plan.
//!
//! Setpoints arrive in block order, so one pass is sufficient, and the memory does not grow with the program.

use std::path::Path;

use evolvent_gcode::{Action, Move, MoveKind};
use evolvent_runtime::{Commands, ProgramError, Setup};

/// Follows a plan block by block.
pub struct FeedWords {
    commands: Commands,
    most: Option<f64>,
    /// Moves interpreted so far.
    next: u32,
    feed: Option<f64>,
    over: bool,
}

impl FeedWords {
    /// Opens the program a second time.
    ///
    /// # Errors
    /// The program cannot be opened.
    pub fn open(program: &Path, setup: &Setup) -> Result<Self, ProgramError> {
        Ok(Self {
            commands: Commands::open(program, setup)?,
            most: setup.machine.max_feed_mm_s,
            next: 0,
            feed: None,
            over: false,
        })
    }

    /// Feed word of a block in mm/s, limited to the machine's maximum feed; `None` on rapids. The block
    /// number must not decrease.
    pub fn of_block(&mut self, block: u32) -> Option<f64> {
        while self.next <= block && !self.over {
            // Errors of the program are reported by the run.
            match self.commands.next() {
                Some(Ok(command)) => {
                    if let Action::Move(motion) = &command.action {
                        self.feed = feed_word(motion, self.most);
                        self.next += 1;
                    }
                }
                _ => (self.over, self.feed) = (true, None),
            }
        }
        self.feed
    }
}

/// Feed word of a move in mm/s, limited to `most`; `None` on rapids.
pub(crate) fn feed_word(motion: &Move, most: Option<f64>) -> Option<f64> {
    let feed = most.map_or(motion.feed_mm_s, |most| motion.feed_mm_s.min(most));
    (motion.kind == MoveKind::Feed && feed.is_finite() && feed > 0.0).then_some(feed)
}
