//! Increments of an encoder per mm or degree, as an exact fraction.

use thiserror::Error;

/// Numerators and denominators stay below this, so that both are exact as `f64`.
const MAX: u128 = 1 << 53;

/// Why numbers give no valid scale.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum ScaleError {
    /// A number is not a positive decimal number.
    #[error("it must be a positive decimal number with at most 12 digits")]
    Number,
    /// The fraction has more digits than any gear.
    #[error("increments per unit is a fraction with more than 15 digits")]
    TooLong,
}

/// A positive fraction in lowest terms.
///
/// ```
/// use evolvent_ethercat::Scale;
///
/// // 2^20 increments a turn, a belt of 3 to 2, and a screw of 5.08 mm.
/// let scale = Scale::new(1 << 20, [3, 2], 5.08)?;
/// assert_eq!(scale.fraction(), (39_321_600, 127));
/// assert_eq!(scale.increments(127.0), 39_321_600);
/// # Ok::<(), evolvent_ethercat::ScaleError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Scale {
    numerator: u64,
    denominator: u64,
}

const fn gcd(mut a: u128, mut b: u128) -> u128 {
    while b != 0 {
        (a, b) = (b, a % b);
    }
    a
}

/// A decimal number as the fraction of its shortest text.
fn decimal(value: f64) -> Result<(u128, u128), ScaleError> {
    if !(value.is_finite() && value > 0.0) {
        return Err(ScaleError::Number);
    }
    let text = value.to_string();
    let (whole, part) = text.split_once('.').unwrap_or((&text, ""));
    if whole.len() + part.len() > 12 {
        return Err(ScaleError::Number);
    }
    let digits: u128 = format!("{whole}{part}").parse().map_err(|_| ScaleError::Number)?;
    Ok((digits, 10_u128.pow(part.len() as u32)))
}

impl Scale {
    /// From increments per turn of the motor, a gear ratio (turns of the motor to turns of its output), and
    /// the travel per turn of the gear output, in mm or degrees.
    ///
    /// # Errors
    /// A number is zero, or has more digits than can be represented exactly.
    pub fn new(increments_per_turn: u32, gear: [u32; 2], travel_per_turn: f64) -> Result<Self, ScaleError> {
        let (digits, unit) = decimal(travel_per_turn)?;
        let [motor, shaft] = gear.map(u128::from);
        let (numerator, denominator) = (u128::from(increments_per_turn) * motor * unit, shaft * digits);
        if numerator == 0 || denominator == 0 {
            return Err(ScaleError::Number);
        }
        let common = gcd(numerator, denominator);
        let (numerator, denominator) = (numerator / common, denominator / common);
        if numerator > MAX || denominator > MAX {
            return Err(ScaleError::TooLong);
        }
        Ok(Self {
            numerator: numerator as u64,
            denominator: denominator as u64,
        })
    }

    /// Numerator and denominator, in lowest terms.
    #[must_use]
    pub const fn fraction(self) -> (u64, u64) {
        (self.numerator, self.denominator)
    }

    /// Increments of a position, rounded to the nearest.
    #[must_use]
    pub fn increments(self, position: f64) -> i64 {
        (position * self.numerator as f64 / self.denominator as f64).round() as i64
    }

    /// The position for a number of increments.
    #[must_use]
    pub fn position(self, increments: i64) -> f64 {
        increments as f64 * self.denominator as f64 / self.numerator as f64
    }

    /// Increments per unit.
    #[must_use]
    pub fn per_unit(self) -> f64 {
        self.numerator as f64 / self.denominator as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn increments_of_long_axis_convert_back_exactly() {
        let scale = Scale::new(1 << 23, [7, 3], 5.08).expect("a scale");
        for increments in (-2_000_000_000_i64..2_000_000_000).step_by(7_654_321) {
            assert_eq!(scale.increments(scale.position(increments)), increments);
        }
    }

    #[test]
    fn what_is_no_number_is_no_scale() {
        for turn in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-300] {
            assert_eq!(Scale::new(1, [1, 1], turn), Err(ScaleError::Number));
        }
        assert_eq!(Scale::new(0, [1, 1], 1.0), Err(ScaleError::Number));
        assert_eq!(Scale::new(1, [1, 0], 1.0), Err(ScaleError::Number));
    }
}
