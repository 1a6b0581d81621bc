//! The step of an encoder, estimated from the angles that it reports.

/// Smaller differences count as rounding, turns. A double has fewer digits for fractions after many turns,
/// and Euclid's algorithm multiplies their errors by the number of counts in an increment.
const ROUNDING: f64 = 1.0 / (64.0 * 4096.0);
/// Number of changes of the increment per window. A jump at the index pulse spoils one window only.
const WINDOW: u32 = 32;
/// Maximum step, turns. A larger divisor is rejected: increments of an almost constant speed have a common
/// divisor that is not a step.
const LARGEST: f64 = 1.0 / 32.0;

/// Estimates the largest angle of which all increments are multiples: one count of the encoder, whatever the
/// speed. Angles that are interpolated between counts have no significant step. Neither allocates nor waits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct EncoderStep {
    increment: Option<f64>,
    /// Divisor of the current window, and the number of changes in it.
    divisor: f64,
    changes: u32,
    /// Divisor of the last complete window; 0 before the first.
    known: f64,
}

impl EncoderStep {
    /// Nothing is known yet.
    pub(crate) const NEW: Self = Self {
        increment: None,
        divisor: 0.0,
        changes: 0,
        known: 0.0,
    };

    /// Processes the increment of the angle from one sample to the next, turns. Steps smaller than `finest`
    /// are not distinguished.
    pub(crate) fn observe(&mut self, increment: f64, finest: f64) {
        let increment = increment.abs();
        let Some(before) = self.increment.replace(increment) else {
            return;
        };
        // A constant speed contains no information: all its increments are equal.
        if (increment - before).abs() < ROUNDING {
            return;
        }
        self.divisor = divisor(divisor(self.divisor, increment, finest), before, finest);
        self.changes += 1;
        if self.changes == WINDOW {
            (self.known, self.divisor, self.changes) = (self.divisor, 0.0, 0);
        }
    }

    /// The step, turns; 0 while it is unknown.
    pub(crate) fn turns(&self) -> f64 {
        let step = if self.known > 0.0 {
            self.known
        } else {
            self.divisor
        };
        if step > LARGEST { 0.0 } else { step }
    }
}

/// The greatest common divisor, by Euclid, down to `finest`.
fn divisor(one: f64, other: f64, finest: f64) -> f64 {
    let (mut large, mut small) = (one.max(other), one.min(other));
    while small > ROUNDING {
        if small < finest {
            return finest;
        }
        let rest = large % small;
        // A value just below a multiple also counts as a multiple.
        (large, small) = (small, rest.min(small - rest));
    }
    large
}

#[cfg(test)]
mod tests {
    use evolvent_random::{Random, cases};

    use super::*;

    const FINEST: f64 = 1.0 / 4096.0;

    fn seen(angles: impl Iterator<Item = f64>) -> f64 {
        let mut step = EncoderStep::NEW;
        let mut last = None;
        for angle in angles {
            if let Some(last) = last.replace(angle) {
                step.observe(angle - last, FINEST);
            }
        }
        step.turns()
    }

    #[test]
    fn the_step_is_found_at_any_speed() {
        let mut random = Random::from_state(0x0e5c_0de5);
        for case in 0..cases(300) {
            let counts = random.log(60.0, 4000.0).round();
            // Up to one week at 1000 rpm, from zero, in both directions.
            let (start, speed) = (
                random.between(-1e7, 1e7),
                random.log(0.2, 60.0) * if case % 2 == 0 { 1.0 } else { -1.0 },
            );
            let ripple = random.between(0.002, 0.02);
            let found = seen((0..3000).map(|ms| {
                let turns = start + 1e-3 * speed * f64::from(ms);
                let uneven = turns + ripple / std::f64::consts::TAU * (std::f64::consts::TAU * turns).sin();
                (uneven * counts).floor() / counts
            }));
            assert!(
                (found * counts - 1.0).abs() < 1e-3,
                "{counts} counts, {speed} turns/s: {found}"
            );
        }
    }

    #[test]
    fn fine_and_interpolated_angles_have_no_step() {
        let found = seen((0..500).map(|ms| (f64::from(ms) * 0.0317).sin() + 0.02 * f64::from(ms)));
        assert!(found <= FINEST, "{found}");
        let fine = seen((0..500).map(|ms| (f64::from(ms).powf(1.01) * 0.02 * 65_536.0).floor() / 65_536.0));
        assert!(fine <= FINEST, "{fine}");
    }

    #[test]
    fn an_even_speed_says_nothing_and_a_jump_is_forgotten() {
        assert_eq!(seen((0..500).map(|ms| 0.05 * f64::from(ms))), 0.0);
        let counts = 400.0;
        let angle = |ms: i32| (f64::from(ms) * 0.0123 * counts).floor() / counts;
        let jumps = (0..3000).map(|ms| angle(ms) + if ms < 300 { 0.0 } else { 0.123_456 });
        assert!((seen(jumps) - 1.0 / counts).abs() < 1e-7);
    }
}
