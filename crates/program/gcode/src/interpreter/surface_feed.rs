//! Feed per revolution (G95) while the spindle speed follows the radius (G96): a move is divided into pieces
//! of nearly constant speed.

use evolvent_path::{Axes, Curve, MoveKind, PathMode, SpindleSpeed};

use crate::{Action, CanonicalCommand, SPINDLES};

/// Maximum ratio of spindle speeds along a piece: the feed per revolution is accurate to half of the excess
/// over 1.
const MAX_SPEED_RATIO: f64 = 1.01;
/// Minimum length of a piece, mm: near the centre the surface speed would need an unlimited number.
const MIN_PIECE_MM: f64 = 0.005;
/// A piece is shorter than necessary by at most this fraction, so a few bisections find its end.
const END_FRACTION: f64 = 0.05;
/// Bisections for the position at which the maximum speed is reached: accurate to 1e-12 of the move.
const MAX_BISECTIONS: u32 = 40;
/// A speed is the maximum up to rounding.
const AT_MAX: f64 = 1.0 - 1e-9;

/// Divides moves on output, after cutter compensation and cycles.
#[derive(Debug, Default)]
pub(crate) struct SurfaceFeed {
    /// The speed of each spindle, if it follows the radius.
    speeds: [Option<SpindleSpeed>; SPINDLES],
    /// A partly output move, and the length output so far, mm.
    rest: Option<(CanonicalCommand, f64)>,
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

    /// The spindle speed that determines the feed of a command, if it follows the radius.
    fn speed_of(&self, command: &CanonicalCommand) -> Option<SpindleSpeed> {
        self.speeds.get(command.feed_spindle as usize).copied().flatten()
    }

    /// The next piece of the present move.
    pub(crate) fn next(&mut self) -> Option<CanonicalCommand> {
        let (command, done_mm) = self.rest.take()?;
        Some(self.piece(command, done_mm))
    }

    /// A command, or its first piece.
    pub(crate) fn split(&mut self, command: CanonicalCommand) -> CanonicalCommand {
        self.set_speed(&command.action);
        let is_fed = matches!(&command.action, Action::Move(motion) if motion.kind == MoveKind::Feed);
        if !is_fed || self.speed_of(&command).is_none() || command.feed_mm_rev.is_none() {
            return command;
        }
        self.piece(command, 0.0)
    }

    /// The next piece of a move of which `done_mm` has been output.
    fn piece(&mut self, mut command: CanonicalCommand, done_mm: f64) -> CanonicalCommand {
        let (Some(speed), Some(feed), Action::Move(motion)) =
            (self.speed_of(&command), command.feed_mm_rev, &mut command.action)
        else {
            return command;
        };
        let length_mm = motion.curve.length();
        let (end_mm, rpm) = next_piece(&speed, &motion.curve, done_mm, length_mm);
        motion.feed_mm_s = feed * rpm / 60.0;
        if done_mm == 0.0 && end_mm == length_mm {
            return command;
        }
        let Some(part) = motion.curve.part(done_mm, end_mm) else {
            return command;
        };
        let mut piece = command.clone();
        piece.continues = done_mm > 0.0;
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

/// End of the piece that starts at `done_mm`, and the spindle speed for its feed. It ends where the maximum
/// speed is reached or left, so that the feed is exact where the speed is constant.
fn next_piece(speed: &SpindleSpeed, curve: &Curve, done_mm: f64, length_mm: f64) -> (f64, f64) {
    let max_rpm = speed.max_rpm();
    let range = |end_mm: f64| range_rpm(speed, curve, done_mm, end_mm);
    let is_even = |(slow, fast): (f64, f64)| fast <= MAX_SPEED_RATIO * slow;
    let is_splittable = curve.part(done_mm, 0.5 * (done_mm + length_mm)).is_some();
    let crosses_max =
        |(slow, fast): (f64, f64)| fast >= AT_MAX * max_rpm && slow < AT_MAX * max_rpm && slow < fast;
    let mut end_mm = length_mm;
    if is_splittable && crosses_max(range(end_mm)) {
        let at_mm = bisect(done_mm, end_mm, 0.0, |at_mm| !crosses_max(range(at_mm))).1;
        if at_mm - done_mm > MIN_PIECE_MM && length_mm - at_mm > MIN_PIECE_MM {
            end_mm = at_mm;
        }
    }
    if is_splittable && !is_even(range(end_mm)) && end_mm - done_mm > 2.0 * MIN_PIECE_MM {
        let (even_mm, _) = bisect(done_mm, end_mm, END_FRACTION, |at_mm| is_even(range(at_mm)));
        // Leaves no remainder that is too short.
        end_mm = even_mm.clamp(done_mm + MIN_PIECE_MM, end_mm - MIN_PIECE_MM);
    }
    let (slow, fast) = range(end_mm);
    // An indivisible move has the feed of its slowest point, so that no chip is thicker than programmed. The
    // same holds for a piece at the maximum.
    let rpm = if is_even((slow, fast)) && slow < AT_MAX * max_rpm {
        (slow * fast).sqrt()
    } else {
        slow
    };
    (end_mm, rpm)
}

/// The position before `high_mm` at which a property that holds at first is lost: one position at which it
/// holds and one at which it does not. Their distance is at most `fraction` of that of the first from
/// `from_mm`, or rounding.
fn bisect(from_mm: f64, high_mm: f64, fraction: f64, predicate: impl Fn(f64) -> bool) -> (f64, f64) {
    let (mut low_mm, mut high_mm) = (from_mm, high_mm);
    for _ in 0..MAX_BISECTIONS {
        let middle_mm = 0.5 * (low_mm + high_mm);
        if predicate(middle_mm) {
            low_mm = middle_mm;
        } else {
            high_mm = middle_mm;
        }
        let is_at_minimum = high_mm - from_mm < MIN_PIECE_MM;
        if fraction > 0.0 && (is_at_minimum || high_mm - low_mm <= fraction * (low_mm - from_mm)) {
            break;
        }
    }
    (low_mm, high_mm)
}

/// Minimum and maximum spindle speed along a part of a curve.
fn range_rpm(speed: &SpindleSpeed, curve: &Curve, from_mm: f64, to_mm: f64) -> (f64, f64) {
    let (low, high): (Axes, Axes) = curve.bounds(curve.parameter(from_mm), curve.parameter(to_mm));
    speed.range_rpm((low[0], high[0]))
}
