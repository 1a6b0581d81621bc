//! The rational control rate of a machine: the maximum over every feed and radius that the machine can reach.
//!
//! Source: Kombarov and Sorokin (see `chord.rs`), equations (3) to (11).

use evolvent_config::plain;
use serde::Serialize;

use crate::chord::{acceleration_feed_mm_s, jerk_feed_mm_s, max_chord_mm, rate_for};

/// Standard gravity as in the paper, mm/s2: `n = A / (1000 * 9.81)`, equation (8).
pub const GRAVITY_MM_S2: f64 = 9810.0;

/// Minimum radius of curvature in the paper's figures and tables, mm.
pub const DEFAULT_MIN_RADIUS_MM: f64 = 0.25;

/// The input of the rational control rate. A limit may be infinite, but not all three.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RateInput {
    /// Maximum contour feed, mm/s; may be infinite.
    pub max_feed_mm_s: f64,
    /// Maximum acceleration of an axis, mm/s2; may be infinite.
    pub acceleration_mm_s2: f64,
    /// Maximum jerk of an axis, mm/s3; may be infinite.
    pub jerk_mm_s3: f64,
    /// Resolution `k`: increments per millimetre.
    pub increments_per_mm: f64,
    /// Permitted chord error in increments; 1 in the paper (3).
    pub permitted_error_increments: f64,
    /// Minimum radius of curvature on the machine, mm.
    pub min_radius_mm: f64,
}

/// The limit that bounds the feed on a curve.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum LimitedBy {
    /// Maximum contour feed (5).
    Feed,
    /// Centripetal acceleration (9).
    Acceleration,
    /// Tangential jerk (11).
    Jerk,
}

impl LimitedBy {
    /// Its name in reports and JSON.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Feed => "feed",
            Self::Acceleration => "acceleration",
            Self::Jerk => "jerk",
        }
    }
}

/// The rational control rate, and the motion that requires it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RationalRate {
    /// The rate, Hz.
    pub rate_hz: f64,
    /// The cycle period in whole nanoseconds, rounded down so that the rate is at least `rate_hz`.
    pub period_ns: u64,
    /// Radius of curvature that requires this rate, mm.
    pub radius_mm: f64,
    /// Feed that the limits permit there, mm/min.
    pub feed_mm_min: f64,
    /// The active limit there; where two cross, the one active at larger radii.
    pub limited_by: LimitedBy,
    /// If two limits cross at the radius: the one active at smaller radii.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub and_by: Option<LimitedBy>,
}

/// The reason why there is no rational rate.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum RateError {
    /// A number is zero, negative, NaN or out of range.
    #[error("{name} is {}: give a number above {min:e} and up to {max:e} {unit}", plain(*.value))]
    OutOfRange {
        /// Name of the quantity.
        name: &'static str,
        /// Its unit.
        unit: &'static str,
        /// Its value.
        value: f64,
        /// Lower bound.
        min: f64,
        /// Upper bound.
        max: f64,
    },
    /// Neither feed nor acceleration nor jerk is limited.
    #[error("feed, acceleration and jerk are all unlimited: give at least one of them")]
    NoLimit,
    /// The minimum radius is so small that its whole circle is within the permitted error.
    #[error(
        "the minimum radius is {min_radius_mm} mm, but on a radius of {min_mm} mm or less a chord cannot \
         deviate by {permitted_error_increments} increments: give a larger radius"
    )]
    RadiusWithinError {
        /// The minimum radius, mm.
        min_radius_mm: f64,
        /// `D / (2 k)`, mm.
        min_mm: f64,
        /// Permitted error, increments.
        permitted_error_increments: f64,
    },
}

impl RateInput {
    /// Checks every number. Called by [`rational_rate`].
    ///
    /// # Errors
    /// [`RateError`] with the invalid number.
    pub fn check(&self) -> Result<(), RateError> {
        let limits = [
            ("the maximum feed", "mm/s", self.max_feed_mm_s),
            ("the acceleration", "mm/s2", self.acceleration_mm_s2),
            ("the jerk", "mm/s3", self.jerk_mm_s3),
        ];
        for (name, unit, value) in limits {
            // Infinity means "unlimited" here, and only here.
            if value != f64::INFINITY {
                in_range(name, unit, value, 1e-9, 1e12)?;
            }
        }
        if limits.iter().all(|&(_, _, value)| value == f64::INFINITY) {
            return Err(RateError::NoLimit);
        }
        in_range("increments per mm", "1/mm", self.increments_per_mm, 1e-9, 1e9)?;
        in_range(
            "the permitted error",
            "increments",
            self.permitted_error_increments,
            1e-6,
            1e6,
        )?;
        in_range("the minimum radius", "mm", self.min_radius_mm, 1e-12, 1e9)?;
        let min_mm = self.permitted_error_increments / (2.0 * self.increments_per_mm);
        if self.min_radius_mm <= min_mm {
            return Err(RateError::RadiusWithinError {
                min_radius_mm: self.min_radius_mm,
                min_mm,
                permitted_error_increments: self.permitted_error_increments,
            });
        }
        Ok(())
    }

    /// The feed in mm/s that the limits permit on a circle, and the active limit: (5), (9), (11).
    ///
    /// Of equal limits the one active at larger radii is returned: feed before acceleration before jerk.
    #[must_use]
    pub fn feed_on_mm_s(&self, radius_mm: f64) -> (f64, LimitedBy) {
        let mut ruling = (self.max_feed_mm_s, LimitedBy::Feed);
        let acceleration = acceleration_feed_mm_s(radius_mm, self.acceleration_mm_s2);
        if acceleration < ruling.0 {
            ruling = (acceleration, LimitedBy::Acceleration);
        }
        let jerk = jerk_feed_mm_s(radius_mm, self.jerk_mm_s3);
        if jerk < ruling.0 {
            ruling = (jerk, LimitedBy::Jerk);
        }
        ruling
    }

    /// The rate in Hz that this radius requires at the feed the limits permit there: (4) with (5).
    #[must_use]
    pub fn rate_on_hz(&self, radius_mm: f64) -> f64 {
        let (feed_mm_s, _) = self.feed_on_mm_s(radius_mm);
        rate_for(
            feed_mm_s,
            radius_mm,
            self.increments_per_mm,
            self.permitted_error_increments,
        )
    }

    /// Radius in mm below which jerk is the active limit, and above which it is acceleration: `A^3 / J^2`.
    #[must_use]
    pub fn jerk_to_acceleration_radius_mm(&self) -> f64 {
        let ratio = self.acceleration_mm_s2 / self.jerk_mm_s3;
        self.acceleration_mm_s2 * ratio * ratio
    }

    /// Radius in mm above which the maximum feed is the active limit, and below which it is acceleration:
    /// `F^2 / A`.
    #[must_use]
    pub fn acceleration_to_feed_radius_mm(&self) -> f64 {
        self.max_feed_mm_s * self.max_feed_mm_s / self.acceleration_mm_s2
    }

    /// Radius in mm above which the maximum feed is the active limit, and below which it is jerk:
    /// `sqrt(F^3 / J)`.
    #[must_use]
    pub fn jerk_to_feed_radius_mm(&self) -> f64 {
        self.max_feed_mm_s * (self.max_feed_mm_s / self.jerk_mm_s3).sqrt()
    }
}

/// The rational control rate: the maximum of (4) over all radii from the minimum radius up, at the feed that
/// (5) permits.
///
/// The maximum is computed exactly, without a search, because the shape of each piece of the curve is known.
/// With the permitted error `D` and `R k >= D`: on the feed limit the rate decreases with the radius, on the
/// acceleration limit it decreases (towards [`acceleration_rate_hz`](crate::acceleration_rate_hz)), on the
/// jerk limit it decreases up to `R k = 2 D` and increases beyond. For `R k < D` it decreases on every limit
/// (see [`max_chord_mm`](crate::max_chord_mm)). So the maximum is where two limits cross, or at the minimum
/// radius. With jerk alone there is no maximum; the result is then that of a radius of 1e9 mm.
///
/// Not for the cycle, although it does not allocate.
///
/// # Errors
/// [`RateError`] for numbers out of range.
pub fn rational_rate(input: &RateInput) -> Result<RationalRate, RateError> {
    input.check()?;
    let crossings = [
        (
            input.jerk_to_acceleration_radius_mm(),
            LimitedBy::Acceleration,
            LimitedBy::Jerk,
        ),
        (input.jerk_to_feed_radius_mm(), LimitedBy::Feed, LimitedBy::Jerk),
        (
            input.acceleration_to_feed_radius_mm(),
            LimitedBy::Feed,
            LimitedBy::Acceleration,
        ),
    ];
    let smallest = input.min_radius_mm;
    let mut best = at(input, smallest, None);
    for (radius_mm, above, below) in crossings {
        // A crossing with an unlimited quantity is at zero, infinity or NaN.
        if radius_mm > smallest && radius_mm <= MAX_RADIUS_MM {
            let here = at(input, radius_mm, Some((above, below)));
            if here.rate_hz > best.rate_hz {
                best = here;
            }
        }
    }
    let largest = at(input, MAX_RADIUS_MM, None);
    if largest.rate_hz > best.rate_hz {
        best = largest;
    }
    Ok(best)
}

/// Radius above which a path counts as straight, mm.
const MAX_RADIUS_MM: f64 = 1e9;

fn at(input: &RateInput, radius_mm: f64, crossing: Option<(LimitedBy, LimitedBy)>) -> RationalRate {
    let (feed_mm_s, ruling) = input.feed_on_mm_s(radius_mm);
    let chord_mm = max_chord_mm(
        radius_mm,
        input.increments_per_mm,
        input.permitted_error_increments,
    );
    let rate_hz = feed_mm_s / chord_mm;
    // At a crossing of two limits the third may be lower; then they are not the active limits.
    let crossing = crossing.filter(|&(above, below)| ruling == above || ruling == below);
    RationalRate {
        rate_hz,
        period_ns: period_ns_of(rate_hz),
        radius_mm,
        feed_mm_min: feed_mm_s * 60.0,
        limited_by: crossing.map_or(ruling, |(above, _)| above),
        and_by: crossing.map(|(_, below)| below),
    }
}

/// The period of a rate in whole nanoseconds, rounded down so that the rate is at least the required one.
///
/// At least 1 ns; a rate of zero, below zero or NaN gives the longest period.
#[must_use]
pub fn period_ns_of(rate_hz: f64) -> u64 {
    let period = (1e9 / rate_hz).floor();
    // `as` saturates and turns NaN into 0.
    if rate_hz > 0.0 {
        (period as u64).max(1)
    } else {
        u64::MAX
    }
}

fn in_range(name: &'static str, unit: &'static str, value: f64, min: f64, max: f64) -> Result<(), RateError> {
    if value > min && value <= max {
        Ok(())
    } else {
        Err(RateError::OutOfRange {
            name,
            unit,
            value,
            min,
            max,
        })
    }
}
