//! A measured table of screw errors, as corrections.

use crate::error_curve::ErrorCurve;

/// Maximum number of points.
pub(crate) const MAX_POINTS: usize = 10_000;
/// Maximum correction, mm or degrees. A larger one is in another unit.
const MAX_CORRECTION: f64 = 10.0;
/// Minimum distance of points, mm or degrees.
const MIN_SPACING: f64 = 1e-3;

/// Corrections of an axis over its position for either direction: the amount added to the commanded position
/// so that the axis reaches the ideal one.
#[derive(Clone, Debug, PartialEq)]
pub struct ScrewTable {
    mean: ErrorCurve,
    /// Half of the difference forwards minus backwards.
    half: Option<ErrorCurve>,
    range: [f64; 2],
}

/// The reason why a table is not usable.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum TableError {
    /// Too few or too many points.
    #[error("a table has 2 to {MAX_POINTS} points, this one has {0}")]
    Points(usize),
    /// The numbers of positions and corrections differ.
    #[error("there are {positions} positions and {corrections} corrections")]
    Lengths {
        /// Number of positions.
        positions: usize,
        /// Number of corrections of one direction.
        corrections: usize,
    },
    /// The positions do not ascend.
    #[error("position {position} is not at least {MIN_SPACING} above the previous one, {before}")]
    Order {
        /// Index of the point.
        index: usize,
        /// Its position.
        position: f64,
        /// The previous position.
        before: f64,
    },
    /// A position or correction is not finite, or a correction is too large.
    #[error("{value} is out of range: corrections are within {MAX_CORRECTION}, positions are finite")]
    Value {
        /// Index of the point.
        index: usize,
        /// Its value.
        value: f64,
    },
}

impl ScrewTable {
    /// Creates a table from corrections at ascending positions, mm or degrees: forwards (towards larger
    /// positions), and backwards if they differ.
    ///
    /// # Errors
    /// [`TableError`] if there are too few points, positions do not ascend, or a number is out of range.
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

    /// The mean correction of both directions.
    #[must_use]
    pub fn mean(&self) -> &ErrorCurve {
        &self.mean
    }

    /// Half of the difference forwards minus backwards; `None` if both directions are equal.
    #[must_use]
    pub fn half_difference(&self) -> Option<&ErrorCurve> {
        self.half.as_ref()
    }

    /// First and last position.
    #[must_use]
    pub fn range(&self) -> [f64; 2] {
        self.range
    }
}
