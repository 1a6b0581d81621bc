//! The feed word of every block, by interpreting the program once more beside its plan.
//!
//! Setpoints come in the order of blocks, so one pass that follows them is enough, and a program of any length needs
//! no memory.

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
    /// Opens the program once more.
    ///
    /// # Errors
    /// As a run: the program cannot be opened.
    pub fn open(program: &Path, setup: &Setup) -> Result<Self, ProgramError> {
        Ok(Self {
            commands: Commands::open(program, setup)?,
            most: setup.machine.max_feed_mm_s,
            next: 0,
            feed: None,
            over: false,
        })
    }

    /// Feed word of a block in mm/s, at most the machine's greatest feed; none on rapids. Blocks must not go back.
    pub fn of_block(&mut self, block: u32) -> Option<f64> {
        while self.next <= block && !self.over {
            // What is wrong with the program is reported by the run.
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

/// Feed word of a move in mm/s, at most `most`; none on rapids.
pub(crate) fn feed_word(motion: &Move, most: Option<f64>) -> Option<f64> {
    let feed = most.map_or(motion.feed, |most| motion.feed.min(most));
    (motion.kind == MoveKind::Feed && feed.is_finite() && feed > 0.0).then_some(feed)
}
