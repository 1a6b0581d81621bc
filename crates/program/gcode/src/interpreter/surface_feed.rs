//! Feed per revolution (G95) while the spindle's speed follows the radius (G96): a move becomes pieces of nearly one speed.

use evolvent_path::{Axes, Curve, MoveKind, PathMode, SpindleSpeed};

use crate::{Action, Command};

/// The spindle's speed changes by no more than this along a piece, so that the feed per revolution is right to half of it.
const MOST_CHANGE: f64 = 1.02;
/// No piece is shorter, mm: at the centre the speed of the surface would ask for any number of them.
const SHORTEST_MM: f64 = 0.005;

/// Divides moves on their way out, behind cutter compensation and cycles.
#[derive(Debug, Default)]
pub(crate) struct SurfaceFeed {
    /// The spindle's speed, where it follows the radius.
    speed: Option<SpindleSpeed>,
    /// A move of which a part has been handed out, and how long that is, mm.
    rest: Option<(Command, f64)>,
}

impl SurfaceFeed {
    /// The spindle's speed is this from here on.
    pub(crate) fn set_speed(&mut self, action: &Action) {
        match action {
            Action::SurfaceSpeed { surface, .. } => self.speed = Some(SpindleSpeed::Surface(*surface)),
            Action::Spindle { .. } => self.speed = None,
            _ => {}
        }
    }

    /// The next piece of the move in hand.
    pub(crate) fn next(&mut self) -> Option<Command> {
        let (command, done_mm) = self.rest.take()?;
        Some(self.piece(command, done_mm))
    }

    /// A command, or the first piece of it.
    pub(crate) fn divide(&mut self, command: Command) -> Command {
        self.set_speed(&command.action);
        let is_fed = matches!(&command.action, Action::Move(motion) if motion.kind == MoveKind::Feed);
        if !is_fed || self.speed.is_none() || command.feed_per_revolution.is_none() {
            return command;
        }
        self.piece(command, 0.0)
    }

    /// The piece of a move behind what has been handed out of it.
    fn piece(&mut self, mut command: Command, done_mm: f64) -> Command {
        let (Some(speed), Some(feed), Action::Move(motion)) =
            (self.speed, command.feed_per_revolution, &mut command.action)
        else {
            return command;
        };
        let length_mm = motion.curve.length();
        let mut end_mm = length_mm;
        let mut range = range_rpm(&speed, &motion.curve, done_mm, end_mm);
        while range.1 > MOST_CHANGE * range.0 && end_mm - done_mm > 2.0 * SHORTEST_MM {
            let middle_mm = 0.5 * (done_mm + end_mm);
            if motion.curve.part(done_mm, middle_mm).is_none() {
                break;
            }
            end_mm = middle_mm;
            range = range_rpm(&speed, &motion.curve, done_mm, end_mm);
        }
        // What cannot be divided is driven at the feed of its slowest place, so that no chip is thicker than programmed.
        let rpm = if range.1 > MOST_CHANGE * range.0 {
            range.0
        } else {
            (range.0 * range.1).sqrt()
        };
        motion.feed = feed * rpm / 60.0;
        if done_mm == 0.0 && end_mm == length_mm {
            return command;
        }
        let Some(part) = motion.curve.part(done_mm, end_mm) else {
            return command;
        };
        let mut piece = command.clone();
        if let Action::Move(motion) = &mut piece.action {
            motion.curve = part;
            if end_mm < length_mm {
                if motion.path_mode == PathMode::ExactStop {
                    // The stop is at the end of the move alone.
                    motion.path_mode = PathMode::ExactPath;
                }
                self.rest = Some((command, end_mm));
            }
        }
        piece
    }
}

/// The spindle's lowest and highest speed along a part of a curve.
fn range_rpm(speed: &SpindleSpeed, curve: &Curve, from_mm: f64, to_mm: f64) -> (f64, f64) {
    let (low, high): (Axes, Axes) = curve.bounds(curve.parameter(from_mm), curve.parameter(to_mm));
    speed.range_rpm((low[0], high[0]))
}
