//! The feed word of every block, found by interpreting the program a second time alongside its plan.
//!
//! Setpoints arrive in block order, so one pass is sufficient, and the memory does not grow with the program.

use std::iter::Peekable;
use std::path::Path;

use evolvent_gcode::{Action, Move, MoveKind};
use evolvent_runtime::{Commands, ProgramError, Setup};

/// Follows a plan block by block.
pub struct FeedWords {
    commands: Peekable<Commands>,
    most: Option<f64>,
    /// Blocks interpreted so far, and their length with that of the parts of the last one, mm.
    next: u32,
    path_mm: f64,
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
            commands: Commands::open(program, setup)?.peekable(),
            most: setup.machine.max_feed_mm_s,
            next: 0,
            path_mm: 0.0,
            feed: None,
            over: false,
        })
    }

    /// Feed word in mm/s, limited to the machine's maximum feed; `None` on rapids. `path_mm` is the
    /// programmed length so far: a move in G95 with G96 has a feed word for each of its parts. Neither it nor
    /// the block number may decrease.
    pub fn at(&mut self, block: u32, path_mm: f64) -> Option<f64> {
        while !self.over && (self.next <= block || self.path_mm < path_mm && self.part_follows()) {
            // Errors of the program are reported by the run.
            match self.commands.next() {
                Some(Ok(command)) => {
                    if let Action::Move(motion) = &command.action {
                        self.feed = feed_word(motion, self.most);
                        self.path_mm += motion.curve.length();
                        self.next += u32::from(!command.continues);
                    }
                }
                _ => (self.over, self.feed) = (true, None),
            }
        }
        self.feed
    }

    /// Whether the next command is a further part of the present move.
    fn part_follows(&mut self) -> bool {
        matches!(self.commands.peek(), Some(Ok(command)) if command.continues)
    }
}

/// Feed word of a move in mm/s, limited to `most`; `None` on rapids.
pub(crate) fn feed_word(motion: &Move, most: Option<f64>) -> Option<f64> {
    let feed = most.map_or(motion.feed_mm_s, |most| motion.feed_mm_s.min(most));
    (motion.kind == MoveKind::Feed && feed.is_finite() && feed > 0.0).then_some(feed)
}
