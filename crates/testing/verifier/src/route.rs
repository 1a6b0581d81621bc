//! The programmed path.

use std::io::BufRead;

use evolvent_gcode::{Action, CanonicalCommand, Diagnostic, Interpreter, Move, PathMode, Settings};
use evolvent_machine::Machine;
use evolvent_path::{Axes, FeedMetric};
use thiserror::Error;

use crate::block::VerifiedMove;
use crate::measure::distance;
use crate::piece::Piece;

/// Directions that differ by less than this, per unit length, count as tangent, as in programs with rounded
/// coordinates.
const TANGENT: f64 = 0.02;
/// Maximum distance between the end of a move and the start of the next, mm or degrees.
const GAP: f64 = 1e-9;

/// Errors of reading a route.
#[derive(Debug, Error)]
pub enum RouteError {
    /// The program has an error.
    #[error("line {}: {}; correct the program first", .diagnostic.line, .diagnostic.message)]
    Program {
        /// The message and its position.
        diagnostic: Box<Diagnostic>,
    },
    /// The path is not in the program.
    #[error("line {line}: the passes of this cycle are found from the cutting load, not programmed")]
    Finds {
        /// Program line.
        line: u32,
    },
    /// The following blocks may depend on the value of an input.
    #[error("line {line}: what follows depends on an input (M66)")]
    ReadsInput {
        /// Program line.
        line: u32,
    },
    /// The axes follow the spindle, and corners are rounded by its speed.
    #[error("line {line}: the axes follow the angle of the spindle, whose speed is not in the program")]
    FollowsSpindle {
        /// Program line.
        line: u32,
    },
    /// A move does not start at the end of the previous one.
    #[error(
        "line {line}: the move starts {distance} mm or degrees from where the last one ended; report this \
         program"
    )]
    Gap {
        /// Program line.
        line: u32,
        /// Distance between them, mm or degrees.
        distance: f64,
    },
}

/// All blocks of a program in order, and the position of the machine before the first.
#[derive(Clone, Debug)]
pub struct Route {
    start: Axes,
    pub(crate) blocks: Vec<VerifiedMove>,
}

impl Route {
    /// Reads a program as the machine would. `settings` contains its position and modes before the first
    /// line.
    ///
    /// # Errors
    /// [`RouteError`] for the first wrong line.
    pub fn read(input: impl BufRead, settings: Settings, machine: &Machine) -> Result<Self, RouteError> {
        let start = settings.start;
        Self::of(Interpreter::new(input, settings), start, machine)
    }

    /// Reads the commands of a program that begins at `start`.
    ///
    /// # Errors
    /// [`RouteError`] for the first wrong command.
    pub fn of(
        commands: impl IntoIterator<Item = Result<CanonicalCommand, Diagnostic>>,
        start: Axes,
        machine: &Machine,
    ) -> Result<Self, RouteError> {
        let mut route = Self {
            start,
            blocks: Vec::new(),
        };
        for command in commands {
            let command = command.map_err(|diagnostic| RouteError::Program {
                diagnostic: Box::new(diagnostic),
            })?;
            match command.action {
                Action::Move(motion) => route.push(&motion, command.line, machine)?,
                Action::SelectTool(_)
                | Action::Message(_)
                | Action::Warning(_)
                | Action::Print(_)
                | Action::Log(_)
                | Action::ProgramStop { optional: true, .. }
                | Action::Output {
                    synchronised: true, ..
                }
                | Action::AnalogOutput {
                    synchronised: true, ..
                }
                | Action::Overrides { cycle: None, .. } => {}
                // The end of a probing move is known only on the machine.
                Action::WaitInput { .. } | Action::Probe { .. } => {
                    return Err(RouteError::ReadsInput { line: command.line });
                }
                Action::Thread { .. } | Action::RigidTap { .. } => {
                    return Err(RouteError::FollowsSpindle { line: command.line });
                }
                Action::ProgramEnd => break,
                Action::Turning(_) => return Err(RouteError::Finds { line: command.line }),
                // All other actions take effect at rest.
                _ => route.rest(),
            }
        }
        route.rest();
        route.find_joints();
        Ok(route)
    }

    /// The blocks.
    #[must_use]
    pub fn blocks(&self) -> &[VerifiedMove] {
        &self.blocks
    }

    /// Position of the machine before the first block.
    #[must_use]
    pub fn start(&self) -> Axes {
        self.start
    }

    /// Required position of the machine at the end.
    #[must_use]
    pub fn end(&self) -> Axes {
        self.blocks.last().map_or(self.start, |block| block.end)
    }

    /// Programmed length in the feed metric, mm (degrees for blocks in which only rotary axes move).
    #[must_use]
    pub fn length_mm(&self) -> f64 {
        self.blocks.iter().map(|block| block.path_length).sum()
    }

    fn push(&mut self, motion: &Move, line: u32, machine: &Machine) -> Result<(), RouteError> {
        let off = distance(&motion.curve.start(), &self.end());
        if !(off <= GAP) {
            return Err(RouteError::Gap { line, distance: off });
        }
        let piece = Piece::of(&motion.curve);
        let length = piece.length();
        let max_feed = machine.max_feed_mm_s.unwrap_or(f64::INFINITY);
        let (tolerance, rest) = match motion.path_mode {
            PathMode::ExactPath => (0.0, false),
            PathMode::ExactStop => (0.0, true),
            PathMode::Blend { tolerance_mm, .. } => {
                (tolerance_mm.unwrap_or(machine.path.blend_tolerance_mm), false)
            }
        };
        let middle = piece.tangent(0.5 * length);
        // A move without any motion is skipped.
        if let (Some(metric), true) = (FeedMetric::of(&middle), length > 0.0) {
            self.blocks.push(VerifiedMove {
                end: motion.curve.end(),
                piece,
                length,
                line,
                feed: if motion.feed_mm_s.is_finite() {
                    motion.feed_mm_s.min(max_feed)
                } else {
                    motion.feed_mm_s
                },
                tolerance,
                path_length: motion.curve.length(),
                metric,
                rest,
                joint: false,
            });
        }
        Ok(())
    }

    fn rest(&mut self) {
        if let Some(last) = self.blocks.last_mut() {
            last.rest = true;
        }
    }

    fn find_joints(&mut self) {
        for i in 1..self.blocks.len() {
            let (before, after) = (&self.blocks[i - 1], &self.blocks[i]);
            let curved = !(before.piece.is_straight() && after.piece.is_straight());
            let exact = before.tolerance == 0.0;
            let (a, b) = (before.piece.tangent(before.length), after.piece.tangent(0.0));
            let (sizes, product) = (a.norm() * b.norm(), a.dot(&b));
            // |sin| and the sense at once.
            let tangent = sizes == 0.0 || product >= sizes * (1.0 - 0.5 * TANGENT * TANGENT);
            self.blocks[i - 1].joint = curved && exact && tangent && !before.rest;
        }
    }
}
