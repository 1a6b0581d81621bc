//! Warns once per program of a feed far above what the machine can do.

use evolvent_gcode::{Action, CanonicalCommand, MoveKind};
use evolvent_machine::Limits;
use evolvent_path::AxisLetter;

/// A programmed feed above this multiple of the machine's maximum speed is a mistake. A few times the maximum
/// is common and means "as fast as possible".
const UNLIKELY_RATIO: f64 = 10.0;

/// Checks the feeds of a program, command by command.
pub(crate) struct UnlikelyFeed {
    /// The speed with all linear axes at their limits, mm/s, or with the rotary axes, degrees/s, if that is
    /// more: both use the same F word.
    fastest: f64,
    has_warned: bool,
}

impl UnlikelyFeed {
    pub(crate) fn new(limits: &Limits) -> Self {
        let norm = |is_rotary: bool| {
            let axes = AxisLetter::ALL
                .into_iter()
                .filter(|axis| axis.is_rotary() == is_rotary);
            axes.map(|axis| limits.velocity[axis.index()].powi(2))
                .sum::<f64>()
                .sqrt()
        };
        Self {
            fastest: norm(false).max(norm(true)),
            has_warned: false,
        }
    }

    /// The warning for the first F word that is far above the speed in any direction of motion: a number that
    /// is too large or in another unit. `feed` is the word in force and its value in mm/s
    /// ([`evolvent_gcode::Interpreter::feed_per_minute`]).
    pub(crate) fn warning(&mut self, command: &CanonicalCommand, feed: Option<(f64, f64)>) -> Option<String> {
        let (Some((word, linear_mm_s)), Action::Move(motion)) = (feed, &command.action) else {
            return None;
        };
        let is_likely = linear_mm_s <= UNLIKELY_RATIO * self.fastest;
        if self.has_warned || motion.kind != MoveKind::Feed || is_likely {
            return None;
        }
        self.has_warned = true;
        let fastest = 60.0 * self.fastest;
        let written = 60.0 * linear_mm_s;
        let in_mm = if (written - word).abs() > 0.001 * word {
            format!(" ({written:.0} mm/min)")
        } else {
            String::new()
        };
        Some(format!(
            "F{word}{in_mm} is far above what the machine can do, at most {fastest:.0} mm/min or \
             degrees/min with all axes together: its limits set the speed; write the feed that was meant, \
             or G0 for a rapid move"
        ))
    }
}
