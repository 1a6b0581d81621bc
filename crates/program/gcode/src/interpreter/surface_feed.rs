//! Feed per revolution (G95) while the spindle speed follows the radius (G96): a move is divided into pieces of nearly constant
//! speed.

use evolvent_path::{Axes, Curve, MoveKind, PathMode, SpindleSpeed};

use crate::{Action, Command, SPINDLES};

/// Maximum ratio of spindle speeds along a piece, so that the feed per revolution is accurate to half of the excess over 1.
const MAX_SPEED_RATIO: f64 = 1.02;
/// Minimum length of a piece, mm: near the centre the surface speed would need an unlimited number.
const MIN_PIECE_MM: f64 = 0.005;

/// Divides moves on output, after cutter compensation and cycles.
#[derive(Debug, Default)]
pub(crate) struct SurfaceFeed {
    /// The speed of each spindle, if it follows the radius.
    speeds: [Option<SpindleSpeed>; SPINDLES],
    /// A partly output move, and the length output so far, mm.
    rest: Option<(Command, f64)>,
}

impl SurfaceFeed {
    /// Sets the speed of a spindle from here on.
    pub(crate) fn set_speed(&mut self, action: &Action) {
        let (spindle, speed) = match action {
            Action::SurfaceSpeed { spindle, surface, .. } => (spindle, Some(SpindleSpeed::Surface(*surface))),
            Action::Spindle { spindle, .. } => (spindle, None),
            _ => return,
        };
        if let Some(slot) = self.speeds.get_mut(*spindle as usize) {
            *slot = speed;
        }
    }

    /// The speed of the spindle that the feed of a command goes by, if it follows the radius.
    fn speed_of(&self, command: &Command) -> Option<SpindleSpeed> {
        self.speeds.get(command.feed_spindle as usize).copied().flatten()
    }

    /// The next piece of the present move.
    pub(crate) fn next(&mut self) -> Option<Command> {
        let (command, done_mm) = self.rest.take()?;
        Some(self.piece(command, done_mm))
    }

    /// A command, or its first piece.
    pub(crate) fn divide(&mut self, command: Command) -> Command {
        self.set_speed(&command.action);
        let is_fed = matches!(&command.action, Action::Move(motion) if motion.kind == MoveKind::Feed);
        if !is_fed || self.speed_of(&command).is_none() || command.feed_mm_rev.is_none() {
            return command;
        }
        self.piece(command, 0.0)
    }

    /// The next piece of a move of which `done_mm` has been output.
    fn piece(&mut self, mut command: Command, done_mm: f64) -> Command {
        let (Some(speed), Some(feed), Action::Move(motion)) =
            (self.speed_of(&command), command.feed_mm_rev, &mut command.action)
        else {
            return command;
        };
        let length_mm = motion.curve.length();
        let mut end_mm = length_mm;
        let mut range = range_rpm(&speed, &motion.curve, done_mm, end_mm);
        while range.1 > MAX_SPEED_RATIO * range.0 && end_mm - done_mm > 2.0 * MIN_PIECE_MM {
            let middle_mm = 0.5 * (done_mm + end_mm);
            if motion.curve.part(done_mm, middle_mm).is_none() {
                break;
            }
            end_mm = middle_mm;
            range = range_rpm(&speed, &motion.curve, done_mm, end_mm);
        }
        // An indivisible move has the feed of its slowest point, so that no chip is thicker than programmed.
        let rpm = if range.1 > MAX_SPEED_RATIO * range.0 {
            range.0
        } else {
            (range.0 * range.1).sqrt()
        };
        motion.feed_mm_s = feed * rpm / 60.0;
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
                    // Only the end of the move is a stop.
                    motion.path_mode = PathMode::ExactPath;
                }
                self.rest = Some((command, end_mm));
            }
        }
        piece
    }
}

/// Minimum and maximum spindle speed along a part of a curve.
fn range_rpm(speed: &SpindleSpeed, curve: &Curve, from_mm: f64, to_mm: f64) -> (f64, f64) {
    let (low, high): (Axes, Axes) = curve.bounds(curve.parameter(from_mm), curve.parameter(to_mm));
    speed.range_rpm((low[0], high[0]))
}
