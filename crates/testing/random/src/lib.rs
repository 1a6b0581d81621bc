//! For tests: random numbers that report their seed.
//!
//! [`Random`] is xorshift64\* (Vigna, "An experimental exploration of Marsaglia's xorshift generators,
//! scrambled", 2016): 64 bits of state, the same sequence on every machine. [`seed`] and [`cases`] read
//! `EVOLVENT_SEED` and `EVOLVENT_CASES`, so that a failure can be repeated and a campaign extended without
//! changing a test.
//!
//! ```
//! use evolvent_random::Random;
//!
//! let (mut one, mut other) = (Random::from_state(7), Random::from_state(7));
//! let speed_mm_s = one.log(0.1, 1000.0);
//! assert!((0.1..1000.0).contains(&speed_mm_s));
//! assert_eq!(other.log(0.1, 1000.0), speed_mm_s);
//! ```
//!
//! The crate has no dependencies, so that every crate can use it in its tests. The product uses it only
//! through `evolvent-bridge-test` and `evolvent-verifier`.

use std::str::FromStr;
use std::time::{SystemTime, UNIX_EPOCH};

/// A xorshift64\* generator.
#[derive(Clone, Copy, Debug)]
pub struct Random(u64);

impl Random {
    /// Seeds the generator from `EVOLVENT_SEED`, or from the time, and prints the seed.
    #[must_use]
    #[expect(clippy::new_without_default, reason = "two of them differ")]
    pub fn new() -> Self {
        Self::mixed(seed(seed_of_time()))
    }

    /// Seeds the generator from `EVOLVENT_SEED`, or with `usual`, and prints the seed.
    #[must_use]
    pub fn seeded(usual: u64) -> Self {
        Self::mixed(seed(usual))
    }

    /// Seeds the generator so that adjacent seeds give unrelated sequences.
    #[must_use]
    pub const fn mixed(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1)
    }

    /// Starts with this state. A state of 0 would never change, so it counts as 1.
    #[must_use]
    pub const fn from_state(state: u64) -> Self {
        Self(if state == 0 { 1 } else { state })
    }

    /// The state, to print or to derive another generator from.
    #[must_use]
    pub const fn state(&self) -> u64 {
        self.0
    }

    /// The next 64 bits.
    pub const fn bits(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_F491_4F6C_DD1D)
    }

    /// A number from 0 to below 1.
    pub fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// A number from `low` to below `high`.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// A number from `low` to below `high`, both above 0, with a uniform distribution of its logarithm.
    pub fn log(&mut self, low: f64, high: f64) -> f64 {
        low * (high / low).powf(self.unit())
    }

    /// An index from 0 to below `count`, by the remainder; 0 if `count` is 0.
    pub fn below(&mut self, count: usize) -> usize {
        (self.bits() % count.max(1) as u64) as usize
    }

    /// An index from 0 to below `count`, by a fraction of it; 0 if `count` is 0.
    pub fn pick(&mut self, count: usize) -> usize {
        ((self.unit() * count as f64) as usize).min(count.saturating_sub(1))
    }

    /// A random item of a list.
    ///
    /// # Panics
    /// If the list is empty.
    pub fn one_of<'a, T>(&mut self, list: &'a [T]) -> &'a T {
        &list[self.below(list.len())]
    }
}

/// Returns and prints the seed: `EVOLVENT_SEED`, decimal or with `0x`, or else `usual`.
///
/// # Panics
/// If `EVOLVENT_SEED` is not a number: ignoring it would not repeat the failure.
#[must_use]
#[expect(clippy::print_stdout, reason = "a seed is told")]
pub fn seed(usual: u64) -> u64 {
    let seed = number("EVOLVENT_SEED").unwrap_or(usual);
    println!("EVOLVENT_SEED={seed}");
    seed
}

/// A seed that differs from run to run.
#[must_use]
pub fn seed_of_time() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.map_or(1, |since| since.as_nanos() as u64)
}

/// Returns and prints the number of cases: `EVOLVENT_CASES`, or else `usual`.
///
/// # Panics
/// If `EVOLVENT_CASES` is not a number.
#[must_use]
#[expect(clippy::print_stdout, reason = "a number of cases is told")]
pub fn cases(usual: usize) -> usize {
    let cases = number("EVOLVENT_CASES").map_or(usual, |cases| cases as usize);
    println!("EVOLVENT_CASES={cases}");
    cases
}

/// Whether `EVOLVENT_CASES` is set: bounds on totals over all cases need not hold then.
#[must_use]
pub fn cases_are_given() -> bool {
    std::env::var_os("EVOLVENT_CASES").is_some()
}

#[expect(clippy::panic, reason = "a wrong number ends the test")]
fn number(name: &str) -> Option<u64> {
    let text = std::env::var(name).ok()?;
    let number = match text.strip_prefix("0x") {
        Some(hex) => u64::from_str_radix(hex, 16),
        None => u64::from_str(&text),
    };
    Some(number.unwrap_or_else(|error| panic!("{name}={text}: {error}; give a number, decimal or with 0x")))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first numbers from state 1, computed in another language with the published shifts 12, 25, 27.
    #[test]
    fn the_sequence_is_that_of_the_published_generator() {
        let mut random = Random::from_state(1);
        let first: [u64; 3] = std::array::from_fn(|_| random.bits());
        assert_eq!(
            first,
            [
                0x47E4_CE4B_896C_DD1D,
                0xABCF_A6A8_E079_651D,
                0xB9D1_0D8F_EB73_1F57
            ]
        );
    }

    #[test]
    fn numbers_stay_in_their_ranges_and_reach_both_ends() {
        let mut random = Random::mixed(5);
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        let mut counts = [[0_u32; 7]; 2];
        for _ in 0..70_000 {
            let number = random.between(-2.0, 3.0);
            assert!((-2.0..3.0).contains(&number));
            (low, high) = (low.min(number), high.max(number));
            counts[0][random.below(7)] += 1;
            counts[1][random.pick(7)] += 1;
        }
        assert!(low < -1.999 && high > 2.999);
        // Five standard deviations of a binomial count.
        for count in counts.into_iter().flatten() {
            assert!((f64::from(count) - 10_000.0).abs() < 463.0, "{counts:?}");
        }
        assert_eq!((random.below(0), random.pick(0)), (0, 0));
    }
}
