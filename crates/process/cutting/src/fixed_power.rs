//! A power with a fixed exponent, for many bases.

use std::fmt;

use crate::power::power;

/// Intervals per binade.
const INTERVALS: usize = 128;
/// Binary exponents of the bases in the table: 1e-6 to 1e5 in mm or m/min.
const BINADES: std::ops::Range<i32> = -20..17;
/// Terms of the binomial series. Its argument is at most 1/256, so the first omitted term is below 1e-16 of
/// the sum for exponents from -10 to 10.
const TERMS: usize = 8;
const MANTISSA_BITS: u32 = 52;
const ONE: u64 = 1.0_f64.to_bits();

/// `x^exponent`: the power of the middle of an interval from a table, times the binomial series of the
/// remaining ratio.
///
/// Accurate to a few units in the last place. Bases outside the table use `exp(exponent ln x)`, which costs
/// three times as much and is less accurate for a large power.
#[derive(Clone, PartialEq)]
pub(crate) struct FixedPower {
    exponent: f64,
    /// 2^(exponent k) for each binade.
    binades: Vec<f64>,
    /// For each interval of 1 to 2: the reciprocal of a number near its middle, and the power of that number.
    intervals: Vec<[f64; 2]>,
    /// Binomial coefficients of the exponent, starting with the linear term.
    series: [f64; TERMS],
}

impl FixedPower {
    pub(crate) fn new(exponent: f64) -> Self {
        let interval = |k: usize| {
            let reciprocal = 1.0 / (1.0 + (k as f64 + 0.5) / INTERVALS as f64);
            [reciprocal, libm::pow(reciprocal, -exponent)]
        };
        let mut series = [exponent; TERMS];
        for n in 1..TERMS {
            series[n] = series[n - 1] * (exponent - n as f64) / (n + 1) as f64;
        }
        Self {
            exponent,
            binades: BINADES
                .map(|k| libm::pow(libm::exp2(f64::from(k)), exponent))
                .collect(),
            intervals: (0..INTERVALS).map(interval).collect(),
            series,
        }
    }

    /// The power of a positive base. Does not allocate.
    pub(crate) fn of(&self, base: f64) -> f64 {
        let bits = base.to_bits();
        let mantissa = bits & ((1 << MANTISSA_BITS) - 1);
        let interval = (mantissa >> (MANTISSA_BITS - INTERVALS.ilog2())) as usize;
        // A sign bit, infinities and NaN give a binade outside the table.
        let binade =
            (bits >> MANTISSA_BITS) as i64 - (ONE >> MANTISSA_BITS) as i64 - i64::from(BINADES.start);
        let binade = usize::try_from(binade).ok().and_then(|k| self.binades.get(k));
        let (Some(binade), Some([reciprocal, middle])) = (binade, self.intervals.get(interval)) else {
            return power(base, self.exponent);
        };
        let rest = f64::from_bits(mantissa | ONE) * reciprocal - 1.0;
        let mut sum = 0.0;
        for coefficient in self.series.iter().rev() {
            sum = (sum + coefficient) * rest;
        }
        binade * (middle + middle * sum)
    }
}

impl fmt::Debug for FixedPower {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "FixedPower({})", self.exponent)
    }
}

#[cfg(test)]
mod tests {
    use evolvent_random::Random;

    use super::*;

    #[test]
    fn it_is_the_power_to_some_units_in_the_last_place() {
        let mut random = Random::new();
        let mut worst = 0.0_f64;
        for exponent in [-10.0, -1.0, -0.15, 0.0, 0.5, 0.75, 0.9, 1.0, 1.4, 2.0, 9.99] {
            let fixed = FixedPower::new(exponent);
            for _ in 0..20_000 {
                let base = libm::exp(random.between(-13.8, 11.7));
                let exact = libm::pow(base, exponent);
                worst = worst.max((fixed.of(base) / exact - 1.0).abs());
            }
        }
        assert!(worst < 3e-15, "{worst:e}");
    }

    #[test]
    fn bases_beyond_the_table_have_a_power() {
        let root = FixedPower::new(0.5);
        for base in [1e-300, 1e-7, 2e5, 1e300, f64::MIN_POSITIVE / 4.0] {
            assert!((root.of(base) / base.sqrt() - 1.0).abs() < 1e-13, "{base}");
        }
        assert_eq!(root.of(f64::INFINITY), f64::INFINITY);
        assert!(root.of(f64::NAN).is_nan() && root.of(-1.0).is_nan());
    }

    #[test]
    fn whole_powers_of_two_are_exact() {
        let square = FixedPower::new(2.0);
        for k in BINADES {
            assert!((square.of(libm::exp2(f64::from(k))) / libm::exp2(f64::from(2 * k)) - 1.0).abs() < 5e-16);
        }
    }
}
