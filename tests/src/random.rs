//! Random numbers that tell their seed.

use std::time::{SystemTime, UNIX_EPOCH};

/// A xorshift64* generator. Its seed is the environment variable `EVOLVENT_SEED`, or the time, and is printed.
#[derive(Clone, Debug)]
pub struct Random(u64);

impl Random {
    /// Seeds it and says with what.
    #[must_use]
    #[expect(clippy::new_without_default, reason = "two of them differ")]
    pub fn new() -> Self {
        let since = SystemTime::now().duration_since(UNIX_EPOCH);
        Self::seeded(since.map_or(1, |since| since.as_nanos() as u64))
    }

    /// The same with a seed of the test's own where the environment names none: for what is to go the same way in every run.
    #[must_use]
    pub fn seeded(usual: u64) -> Self {
        let given = std::env::var("EVOLVENT_SEED")
            .ok()
            .and_then(|text| text.parse().ok());
        let seed: u64 = given.unwrap_or(usual);
        println!("EVOLVENT_SEED={seed}");
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1)
    }

    /// The next 64 bits.
    pub fn bits(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_F491_4F6C_DD1D)
    }

    /// From 0 to before `count`.
    pub fn below(&mut self, count: usize) -> usize {
        (self.bits() % count.max(1) as u64) as usize
    }

    /// From `low` to before `high`.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.bits() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// One of a list.
    ///
    /// # Panics
    /// The list is empty.
    pub fn one_of<'a, T>(&mut self, list: &'a [T]) -> &'a T {
        &list[self.below(list.len())]
    }
}
