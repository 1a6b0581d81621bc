//! What was measured of a screw, as corrections.

use crate::error_curve::ErrorCurve;

/// Points of the largest table.
pub(crate) const MAX_POINTS: usize = 10_000;
/// The largest correction, mm or degrees: beyond it the table is in another unit.
const MAX_CORRECTION: f64 = 10.0;
/// Points are farther apart than this, mm or degrees.
const MIN_SPACING: f64 = 1e-3;

/// Corrections of an axis over its position, for either direction: what is added to the position so that the axis is there.
#[derive(Clone, Debug, PartialEq)]
pub struct ScrewTable {
    mean: ErrorCurve,
    /// Half of what forwards is more than backwards.
    half: Option<ErrorCurve>,
    range: [f64; 2],
}

/// A table that cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum TableError {
    /// Too few points for a curve, or too many.
    #[error("a table has 2 to {MAX_POINTS} points, this one {0}")]
    Points(usize),
    /// Not as many corrections as positions.
    #[error("there are {positions} positions and {corrections} corrections")]
    Lengths {
        /// Positions.
        positions: usize,
        /// Corrections of one direction.
        corrections: usize,
    },
    /// Positions that do not ascend.
    #[error("position {position} is not at least {MIN_SPACING} above the one before, {before}")]
    Order {
        /// Index of the point.
        index: usize,
        /// Its position.
        position: f64,
        /// The position before.
        before: f64,
    },
    /// A number that is none, or a correction that is absurd.
    #[error("{value} is out of range: corrections are within {MAX_CORRECTION}, positions are finite")]
    Value {
        /// Index of the point.
        index: usize,
        /// The number.
        value: f64,
    },
}

impl ScrewTable {
    /// Of corrections at ascending positions, mm or degrees: forwards (to larger positions), and backwards where that differs.
    ///
    /// # Errors
    /// There are too few points, positions do not ascend, or a number is out of range.
    pub fn new(positions: &[f64], forward: &[f64], reverse: Option<&[f64]>) -> Result<Self, TableError> {
        if !(2..=MAX_POINTS).contains(&positions.len()) {
            return Err(TableError::Points(positions.len()));
        }
        for corrections in [Some(forward), reverse].into_iter().flatten() {
            if corrections.len() != positions.len() {
                return Err(TableError::Lengths {
                    positions: positions.len(),
                    corrections: corrections.len(),
                });
            }
        }
        for (index, position) in positions.iter().enumerate() {
            if !position.is_finite() || position.abs() > 1e9 {
                return Err(TableError::Value {
                    index,
                    value: *position,
                });
            }
            for value in [Some(forward), reverse]
                .into_iter()
                .flatten()
                .map(|all| all[index])
            {
                if !value.is_finite() || value.abs() > MAX_CORRECTION {
                    return Err(TableError::Value { index, value });
                }
            }
            if index > 0 && *position < positions[index - 1] + MIN_SPACING {
                return Err(TableError::Order {
                    index,
                    position: *position,
                    before: positions[index - 1],
                });
            }
        }
        let combined = |sign: f64| -> Vec<f64> {
            let reverse = reverse.unwrap_or(forward);
            let both = forward.iter().zip(reverse);
            both.map(|(forward, reverse)| 0.5 * (forward + sign * reverse))
                .collect()
        };
        Ok(Self {
            mean: ErrorCurve::through(positions, &combined(1.0)),
            half: reverse.map(|_| ErrorCurve::through(positions, &combined(-1.0))),
            range: [positions[0], positions[positions.len() - 1]],
        })
    }

    /// The mean of both directions.
    #[must_use]
    pub fn mean(&self) -> &ErrorCurve {
        &self.mean
    }

    /// Half of what forwards is more than backwards; none where both are the same.
    #[must_use]
    pub fn half_difference(&self) -> Option<&ErrorCurve> {
        self.half.as_ref()
    }

    /// The first and the last position.
    #[must_use]
    pub fn range(&self) -> [f64; 2] {
        self.range
    }
}
