//! The program at a line and around it.

use std::collections::VecDeque;
use std::io::{self, BufRead, BufReader};
use std::path::Path;

use evolvent_gcode::{Action, Move, MoveKind, PathMode};
use evolvent_path::Curve;
use evolvent_runtime::{Commands, ProgramError, Setup};
use serde::Serialize;

use crate::feed_words::feed_word;

/// Moves on each side whose lengths are considered.
const CHAIN: usize = 20;
/// Maximum length of the source line shown, characters.
const SHOWN: usize = 120;

/// The path mode at a corner.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Corner {
    /// G61: the exact path.
    Exact,
    /// G61.1: a stop after every move.
    Stop,
    /// G64 P with the programmed tolerance.
    Within(f64),
    /// G64 without P: the tolerance of the machine file.
    WithinDefault(f64),
}

impl Corner {
    /// The path mode of the corner between a move of this mode and one of the mode `next`, as the planner
    /// chooses it: a stop belongs to the preceding move, and both must permit rounding.
    fn before(self, next: Self) -> Self {
        match (self.tolerance_mm(), next.tolerance_mm()) {
            (Some(own), Some(other)) if other < own => next,
            (Some(_), None) => Self::Exact,
            _ => self,
        }
    }

    fn tolerance_mm(self) -> Option<f64> {
        match self {
            Self::Exact | Self::Stop => None,
            Self::Within(mm) | Self::WithinDefault(mm) => Some(mm),
        }
    }
}

/// One move of the program.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Block {
    pub(crate) line: u32,
    /// "rapid", "line", "arc" ...
    pub(crate) kind: &'static str,
    pub(crate) length_mm: f64,
    /// Programmed feed, limited to the machine's maximum; `None` on rapids.
    pub(crate) feed_mm_min: Option<f64>,
    pub(crate) corner_after: Corner,
}

/// The move before or after.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Neighbour {
    #[serde(flatten)]
    pub(crate) block: Block,
    /// The path mode of the corner between the two moves.
    pub(crate) corner: Corner,
    /// Angle between the two moves; `None` if X, Y and Z do not move.
    pub(crate) corner_degrees: Option<f64>,
    /// Action at rest between the moves, and its line.
    pub(crate) rest: Option<(u32, String)>,
    /// Mean length of up to 20 moves on that side.
    pub(crate) mean_length_mm: f64,
}

/// A program line and its surroundings.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Surroundings {
    /// The source text.
    pub(crate) text: String,
    /// Number of lines of the program.
    pub(crate) lines: u32,
    /// The moves of the line in its first pass.
    pub(crate) moves: Vec<Block>,
    pub(crate) before: Option<Neighbour>,
    pub(crate) after: Option<Neighbour>,
    /// Nearest lines with motion.
    pub(crate) nearest: (Option<u32>, Option<u32>),
}

impl Surroundings {
    /// The path modes of the corners at both ends of the line and within it.
    pub(crate) fn corners(&self) -> impl Iterator<Item = Corner> {
        let within = self.moves.split_last().map_or(&[][..], |(_, before)| before);
        let ends = self.before.iter().chain(&self.after).map(|side| side.corner);
        ends.chain(within.iter().map(|block| block.corner_after))
    }

    pub(crate) fn read(program: &Path, setup: &Setup, line: u32) -> Result<Self, ProgramError> {
        let mut found = Self::default();
        (found.text, found.lines) = source(program, line).map_err(|source| ProgramError::Read {
            file: program.display().to_string(),
            source,
        })?;
        let mut walk = Walk {
            line,
            default_mm: setup.machine.path.blend_tolerance_mm,
            max: setup.machine.max_feed_mm_s,
            ..Walk::default()
        };
        for command in Commands::open(program, setup)? {
            // Errors of the program are reported by the run.
            let Ok(command) = command else {
                break;
            };
            match &command.action {
                Action::Move(motion) => walk.step(&mut found, command.line, motion),
                other => {
                    if let Some(text) = at_rest(other) {
                        walk.rest.get_or_insert((command.line, text));
                    }
                }
            }
        }
        walk.end(&mut found);
        Ok(found)
    }
}

#[derive(Default)]
struct Walk {
    line: u32,
    default_mm: f64,
    max: Option<f64>,
    before: VecDeque<f64>,
    last: Option<(Block, Curve)>,
    rest: Option<(u32, String)>,
    after: Vec<f64>,
    /// The first pass of the line has ended.
    over: bool,
}

impl Walk {
    fn step(&mut self, found: &mut Surroundings, line: u32, motion: &Move) {
        let (below, above) = &mut found.nearest;
        if line < self.line {
            *below = Some(below.map_or(line, |known| known.max(line)));
        } else if line > self.line {
            *above = Some(above.map_or(line, |known| known.min(line)));
        }
        let block = self.block(line, motion);
        let rest = self.rest.take();
        let length = block.length_mm;
        if line == self.line && !self.over {
            if found.moves.is_empty() {
                found.before = self.last.take().map(|(before, curve)| Neighbour {
                    corner: before.corner_after.before(block.corner_after),
                    block: before,
                    corner_degrees: corner(&curve, &motion.curve),
                    rest,
                    mean_length_mm: mean(self.before.iter()),
                });
            }
            found.moves.push(block.clone());
        } else if !found.moves.is_empty() {
            if !self.over {
                found.after = self.last.as_ref().map(|(last, curve)| Neighbour {
                    corner: last.corner_after.before(block.corner_after),
                    block: block.clone(),
                    corner_degrees: corner(curve, &motion.curve),
                    rest,
                    mean_length_mm: 0.0,
                });
            }
            self.over = true;
            if self.after.len() < CHAIN {
                self.after.push(length);
            }
        }
        if self.before.len() == CHAIN {
            self.before.pop_front();
        }
        self.before.push_back(length);
        self.last = Some((block, motion.curve));
    }

    fn end(self, found: &mut Surroundings) {
        if let Some(after) = &mut found.after {
            after.mean_length_mm = mean(self.after.iter());
        }
    }

    fn block(&self, line: u32, motion: &Move) -> Block {
        Block {
            line,
            kind: match (motion.kind, &motion.curve) {
                (MoveKind::Rapid, _) => "rapid",
                (_, Curve::Line(_)) => "line",
                (_, Curve::Arc(_)) => "arc",
                (_, Curve::Involute(_)) => "involute",
                _ => "curve",
            },
            length_mm: motion.curve.length(),
            feed_mm_min: feed_word(motion, self.max).map(|feed| 60.0 * feed),
            corner_after: match motion.path_mode {
                PathMode::ExactPath => Corner::Exact,
                PathMode::ExactStop => Corner::Stop,
                PathMode::Blend { tolerance_mm, .. } => {
                    tolerance_mm.map_or(Corner::WithinDefault(self.default_mm), Corner::Within)
                }
            },
        }
    }
}

fn mean<'a>(values: impl Iterator<Item = &'a f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    if count > 0.0 { sum / count } else { 0.0 }
}

/// Angle between the end of one curve and the start of the next, degrees.
fn corner(left: &Curve, right: &Curve) -> Option<f64> {
    let (a, b) = (left.tangent(left.length()), right.tangent(0.0));
    if !(a.norm() > 0.5 && b.norm() > 0.5) {
        return None;
    }
    Some(a.cross(&b).norm().atan2(a.dot(&b)).to_degrees())
}

/// The action for which the axes must be at rest.
fn at_rest(action: &Action) -> Option<String> {
    Some(match action {
        Action::Dwell { seconds } => format!("a dwell of {seconds} s"),
        Action::BeginToolChange(tool) | Action::ChangeTool(tool) => format!("the change to tool {tool}"),
        Action::Spindle { .. } => "a spindle command".to_owned(),
        Action::Coolant { .. } => "a coolant command".to_owned(),
        Action::ProgramStop { optional: false, .. } => "a program stop".to_owned(),
        _ => return None,
    })
}

/// The text of a line, and the number of lines.
fn source(program: &Path, line: u32) -> io::Result<(String, u32)> {
    let mut reader = BufReader::with_capacity(256 * 1024, evolvent_config::open_regular(program)?);
    let (mut text, mut lines, mut fresh) = (Vec::new(), 0_u32, true);
    loop {
        let chunk = reader.fill_buf()?;
        if chunk.is_empty() {
            break;
        }
        // A line can be as long as the file: only its beginning is kept.
        let end = chunk.iter().position(|byte| *byte == b'\n');
        let used = end.map_or(chunk.len(), |end| end + 1);
        if fresh {
            lines = lines.saturating_add(1);
        }
        if lines == line && text.len() < 4 * SHOWN {
            text.extend(chunk.iter().take(used).take(4 * SHOWN));
        }
        fresh = end.is_some();
        reader.consume(used);
    }
    let text = String::from_utf8_lossy(&text);
    let mut shown: String = text
        .trim()
        .chars()
        .filter(|c| !c.is_control())
        .take(SHOWN)
        .collect();
    if text.trim().chars().count() > SHOWN {
        shown.push('\u{2026}');
    }
    Ok((shown, lines))
}

#[cfg(test)]
mod tests {
    use super::Corner::{Exact, Stop, Within, WithinDefault};

    #[test]
    fn a_corner_takes_the_stricter_mode_of_its_two_moves() {
        for (own, next, taken) in [
            (Within(0.05), Exact, Exact),
            (Within(0.05), Stop, Exact),
            (WithinDefault(0.05), Exact, Exact),
            (Exact, Within(0.05), Exact),
            (Stop, Within(0.05), Stop),
            (Stop, Exact, Stop),
            (Within(0.05), Within(0.02), Within(0.02)),
            (Within(0.01), WithinDefault(0.02), Within(0.01)),
            (Within(0.05), WithinDefault(0.02), WithinDefault(0.02)),
        ] {
            assert_eq!(own.before(next), taken, "{own:?} before {next:?}");
        }
    }
}
