//! The rational control rate of a machine: the largest rate that any feed and radius it can reach needs.
//!
//! Source: Kombarov and Sorokin (see `chord.rs`), equations (3) to (11).

use serde::Serialize;

use crate::chord::{acceleration_feed_mm_s, jerk_feed_mm_s, longest_chord_mm, rate_for};

/// Standard gravity as the paper takes it, in mm/s2: `n = A / (1000 * 9.81)`, equation (8).
pub const GRAVITY_MM_S2: f64 = 9810.0;

/// The smallest radius of curvature that the paper's figures and tables consider, in mm.
pub const DEFAULT_MIN_RADIUS_MM: f64 = 0.25;

/// What the rational control rate follows from. A limit may be infinite, but not all three.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RateInput {
    /// Largest contour feed, mm/s; infinite for none.
    pub max_feed_mm_s: f64,
    /// Largest acceleration of an axis, mm/s2; infinite for none.
    pub acceleration_mm_s2: f64,
    /// Largest jerk of an axis, mm/s3; infinite for none.
    pub jerk_mm_s3: f64,
    /// Discreteness `k`: increments per millimetre.
    pub increments_per_mm: f64,
    /// Permitted chord error, in increments; 1 in the paper (3).
    pub permitted_error_increments: f64,
    /// Smallest radius of curvature that the machine is to meet, mm.
    pub min_radius_mm: f64,
}

/// What limits the feed on a curve.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum LimitedBy {
    /// The largest contour feed (5).
    Feed,
    /// Acceleration across the path (9).
    Acceleration,
    /// Jerk along the path (11).
    Jerk,
}

impl LimitedBy {
    /// The word that reports and JSON use.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Feed => "feed",
            Self::Acceleration => "acceleration",
            Self::Jerk => "jerk",
        }
    }
}

/// The rational control rate and where on the machine's range it is needed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RationalRate {
    /// The rate, Hz.
    pub rate_hz: f64,
    /// The cycle period in whole nanoseconds, rounded down so that the rate is never below `rate_hz`.
    pub period_ns: u64,
    /// Radius of curvature that needs this rate, mm.
    pub radius_mm: f64,
    /// Feed that the limits allow there, mm/min.
    pub feed_mm_min: f64,
    /// The limit that rules there; where two cross, the one that rules at the larger radii.
    pub limited_by: LimitedBy,
    /// Where two limits cross at the radius: the one that rules at the smaller radii.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub and_by: Option<LimitedBy>,
}

/// Why there is no rational rate.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum RateError {
    /// A number is zero, negative, NaN, or out of the range of any machine.
    #[error("{name} is {value}: give a number above {least:e} and up to {most:e} {unit}")]
    OutOfRange {
        /// Which number.
        name: &'static str,
        /// Its unit.
        unit: &'static str,
        /// As given.
        value: f64,
        /// Lower bound.
        least: f64,
        /// Upper bound.
        most: f64,
    },
    /// Neither feed nor acceleration nor jerk is limited.
    #[error("feed, acceleration and jerk are all unlimited: give at least one of them")]
    NoLimit,
    /// The smallest radius is so small that its whole circle lies within the permitted error.
    #[error(
        "the smallest radius is {min_radius_mm} mm, but on a radius of {least_mm} mm and below a chord cannot miss by \
         {permitted_error_increments} increments: give a larger radius"
    )]
    RadiusWithinError {
        /// As given, mm.
        min_radius_mm: f64,
        /// `D / (2 k)`, mm.
        least_mm: f64,
        /// Permitted error, increments.
        permitted_error_increments: f64,
    },
}

impl RateInput {
    /// Checks every number. Called by [`rational_rate`].
    ///
    /// # Errors
    /// Names the number that is not usable.
    pub fn check(&self) -> Result<(), RateError> {
        let limits = [
            ("the largest feed", "mm/s", self.max_feed_mm_s),
            ("the acceleration", "mm/s2", self.acceleration_mm_s2),
            ("the jerk", "mm/s3", self.jerk_mm_s3),
        ];
        for (name, unit, value) in limits {
            // Infinite stands for "not limited" here, and only here.
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
        in_range("the smallest radius", "mm", self.min_radius_mm, 1e-12, 1e9)?;
        let least_mm = self.permitted_error_increments / (2.0 * self.increments_per_mm);
        if self.min_radius_mm <= least_mm {
            return Err(RateError::RadiusWithinError {
                min_radius_mm: self.min_radius_mm,
                least_mm,
                permitted_error_increments: self.permitted_error_increments,
            });
        }
        Ok(())
    }

    /// The feed that the limits allow on a circle, in mm/s, and which of them rules: (5), (9), (11).
    ///
    /// Of equal limits the one that rules at larger radii is named: feed before acceleration before jerk.
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

    /// The rate, in Hz, that this radius needs at the feed which the limits allow there: (4) with (5).
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

    /// Below this radius (mm) jerk rules, above it acceleration: `A^3 / J^2`.
    #[must_use]
    pub fn jerk_to_acceleration_radius_mm(&self) -> f64 {
        let ratio = self.acceleration_mm_s2 / self.jerk_mm_s3;
        self.acceleration_mm_s2 * ratio * ratio
    }

    /// Above this radius (mm) the largest feed rules and below it acceleration: `F^2 / A`.
    #[must_use]
    pub fn acceleration_to_feed_radius_mm(&self) -> f64 {
        self.max_feed_mm_s * self.max_feed_mm_s / self.acceleration_mm_s2
    }

    /// Above this radius (mm) the largest feed rules and below it jerk: `sqrt(F^3 / J)`.
    #[must_use]
    pub fn jerk_to_feed_radius_mm(&self) -> f64 {
        self.max_feed_mm_s * (self.max_feed_mm_s / self.jerk_mm_s3).sqrt()
    }
}

/// The rational control rate: the largest of (4) over all radii from the smallest on, at the feed that (5) allows.
///
/// The largest is found exactly, not by a search, because each piece of the curve has a known shape. With `D` the
/// permitted error and `R k >= D`: on the feed limit the rate falls with the radius, on the acceleration limit it falls
/// (towards [`acceleration_rate_hz`](crate::acceleration_rate_hz)), on the jerk limit it falls up to `R k = 2 D` and
/// rises beyond. For `R k < D` it falls on every limit (see [`longest_chord_mm`]). So it lies where two limits cross, or
/// at the smallest radius, or, with jerk alone, has no largest value below the largest radius: see `radius_mm` of 1e9 mm
/// in that case.
///
/// Not for the cycle, although it allocates nothing.
///
/// # Errors
/// [`RateError`] for numbers that no machine has.
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
        // A crossing with an unlimited quantity lies at zero, infinity or NaN.
        if radius_mm > smallest && radius_mm <= LARGEST_RADIUS_MM {
            let here = at(input, radius_mm, Some((above, below)));
            if here.rate_hz > best.rate_hz {
                best = here;
            }
        }
    }
    let largest = at(input, LARGEST_RADIUS_MM, None);
    if largest.rate_hz > best.rate_hz {
        best = largest;
    }
    Ok(best)
}

/// Where a path counts as straight, mm.
const LARGEST_RADIUS_MM: f64 = 1e9;

fn at(input: &RateInput, radius_mm: f64, crossing: Option<(LimitedBy, LimitedBy)>) -> RationalRate {
    let (feed_mm_s, ruling) = input.feed_on_mm_s(radius_mm);
    let chord_mm = longest_chord_mm(
        radius_mm,
        input.increments_per_mm,
        input.permitted_error_increments,
    );
    let rate_hz = feed_mm_s / chord_mm;
    // At a crossing of two limits the third may be lower; then it is no crossing of the ruling limits.
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

/// The period of a rate in whole nanoseconds: rounded down, for the rate must never be lower than what is needed.
///
/// At least 1 ns; a rate that is zero, negative or NaN gives the longest period.
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

fn in_range(
    name: &'static str,
    unit: &'static str,
    value: f64,
    least: f64,
    most: f64,
) -> Result<(), RateError> {
    if value > least && value <= most {
        Ok(())
    } else {
        Err(RateError::OutOfRange {
            name,
            unit,
            value,
            least,
            most,
        })
    }
}
