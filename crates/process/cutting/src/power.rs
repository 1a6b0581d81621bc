//! The power law of handbooks.

use crate::error::LawError;
use crate::fixed_power::FixedPower;
use crate::force::SectionForce;

/// `Pz = coefficient_n factor V^speed_exponent t^depth_exponent S^feed_exponent`, V in m/min, t in mm, S in
/// mm/rev.
///
/// ```
/// use evolvent_cutting::{Cut, ForceLaw, PowerLaw};
/// let steel = PowerLaw {
///     coefficient_n: 2943.0,
///     factor: 1.0,
///     speed_exponent: -0.15,
///     depth_exponent: 1.0,
///     feed_exponent: 0.75,
/// };
/// let law = ForceLaw::from(steel.checked()?);
/// let at = |depth_mm| law.force(Cut { speed_m_min: 100.0, depth_mm, feed_mm_rev: 0.2 });
/// assert!((at(4.0)?.tangential_n / at(2.0)?.tangential_n - 2.0).abs() < 1e-12);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PowerLaw {
    /// Force at 1 m/min, 1 mm and 1 mm/rev, N.
    pub coefficient_n: f64,
    /// Further factor (tool, material), 1 for none.
    pub factor: f64,
    /// Exponent of the cutting speed.
    pub speed_exponent: f64,
    /// Exponent of the depth of cut.
    pub depth_exponent: f64,
    /// Exponent of the feed.
    pub feed_exponent: f64,
}

impl PowerLaw {
    /// Checks the numbers.
    ///
    /// # Errors
    /// A coefficient or factor that is not positive, an exponent beyond 10, or a number that is not finite.
    pub fn checked(self) -> Result<Self, LawError> {
        number("coefficient_n", self.coefficient_n, 1e-9, 1e9)?;
        number("factor", self.factor, 1e-9, 1e9)?;
        number("speed_exponent", self.speed_exponent, -10.0, 10.0)?;
        number("depth_exponent", self.depth_exponent, 0.0, 10.0)?;
        number("feed_exponent", self.feed_exponent, 0.0, 10.0)?;
        Ok(self)
    }

    /// The factor of the feed, including all constants.
    pub(crate) fn at_feed(&self, feed: f64) -> f64 {
        self.coefficient_n * self.factor * libm::pow(feed, self.feed_exponent)
    }

    /// The powers of speed and depth in this law.
    pub(crate) fn powers(&self) -> [FixedPower; 2] {
        [self.speed_exponent, self.depth_exponent].map(FixedPower::new)
    }

    pub(crate) fn force(
        &self,
        at_feed: f64,
        powers: &[FixedPower; 2],
        speed: f64,
        depth: f64,
    ) -> SectionForce {
        let force = Self::tangential_n(at_feed, powers, speed, depth);
        SectionForce {
            tangential_n: force,
            per_speed: force * self.speed_exponent / speed,
            per_depth: force * self.depth_exponent / depth,
        }
    }

    pub(crate) fn tangential_n(at_feed: f64, powers: &[FixedPower; 2], speed: f64, depth: f64) -> f64 {
        at_feed * powers[0].of(speed) * powers[1].of(depth)
    }
}

/// `base` to the `exponent`, for a positive base, in a third of the time of `pow`. The relative error is
/// 1e-16 times the logarithm of the power.
pub(crate) fn power(base: f64, exponent: f64) -> f64 {
    libm::exp(exponent * libm::log(base))
}

pub(crate) fn number(name: &'static str, value: f64, min: f64, max: f64) -> Result<(), LawError> {
    // No range contains NaN.
    if (min..=max).contains(&value) {
        return Ok(());
    }
    Err(LawError::Number {
        name,
        value,
        min,
        max,
    })
}
