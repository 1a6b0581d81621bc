//! A feed far above what the machine can do: one warning for a program.

use evolvent_gcode::{Action, Command, MoveKind};
use evolvent_machine::Limits;
use evolvent_path::AxisLetter;

/// A programmed feed above this multiple of the maximum speed of the machine is a mistake. A few times the
/// maximum is usual and means "as fast as possible".
const UNLIKELY_RATIO: f64 = 10.0;

/// Looks at the feeds of a program, command after command.
pub(crate) struct UnlikelyFeed {
    /// The speed in mm/s with all linear axes at their limits, or in degrees/s with the rotary ones if that
    /// is more: both have the same F word.
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

    /// The warning of the first F word that no direction of motion can reach by far: a number too large, or
    /// of another unit. `feed` is the word in force and what it means in mm/s
    /// ([`evolvent_gcode::Interpreter::feed_per_minute`]).
    pub(crate) fn warning(&mut self, command: &Command, feed: Option<(f64, f64)>) -> Option<String> {
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
