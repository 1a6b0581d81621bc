//! The chip thickness that belongs to a reading of the load.

/// Positions stored over the time in which a chip forms.
const SLOTS: usize = 256;

/// The mean feed over the time in which a chip forms: the chip of an edge is the feed since the previous edge
/// passed. The memory is of fixed size, independent of that time. Real-time safe.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ChipTrail {
    /// The distance fed, at every `stride`-th cycle.
    feeds: [f64; SLOTS + 2],
    next: usize,
    stride: u32,
    since: u32,
    travelled: f64,
    forming_cycles: f64,
}

impl ChipTrail {
    /// Creates a trail at rest, for chips that form over this number of cycles, at least 1.
    pub(crate) fn new(forming_cycles: f64) -> Self {
        let forming_cycles = forming_cycles.max(1.0);
        Self {
            feeds: [0.0; SLOTS + 2],
            next: 0,
            stride: (forming_cycles / SLOTS as f64).ceil().clamp(1.0, 1e9) as u32,
            since: 0,
            travelled: 0.0,
            forming_cycles,
        }
    }

    /// Advances by one cycle at a feed in any unit; returns the chip in that unit.
    pub(crate) fn step(&mut self, feed: f64) -> f64 {
        self.travelled += feed;
        self.since += 1;
        if self.since == self.stride {
            self.since = 0;
            self.next = (self.next + 1) % self.feeds.len();
            self.feeds[self.next] = self.travelled;
        }
        (self.travelled - self.before()) / self.forming_cycles
    }

    /// The distance when the chip began to form.
    fn before(&self) -> f64 {
        let back = (self.forming_cycles - f64::from(self.since)) / f64::from(self.stride);
        if back <= 0.0 {
            return self.feeds[self.next];
        }
        let n = self.feeds.len();
        let whole = (back as usize).min(n - 2);
        let at = |lags: usize| self.feeds[(self.next + n - lags) % n];
        let fraction = (back - whole as f64).clamp(0.0, 1.0);
        at(whole) + fraction * (at(whole + 1) - at(whole))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_chip_is_the_mean_feed_of_the_last_revolution() {
        for cycles in [1.0, 7.0, 60.0, 256.0, 257.0, 1000.0, 5000.0] {
            let mut trail = ChipTrail::new(cycles);
            // A ramp: its mean over a revolution is its value half a revolution ago.
            let mut chip = 0.0;
            for k in 0..20_000 {
                chip = trail.step(f64::from(k));
            }
            let expected = 19_999.0 - 0.5 * (cycles - 1.0);
            assert!(
                (chip / expected - 1.0).abs() < 1e-4,
                "{chip} for {expected} at {cycles}"
            );
        }
    }

    #[test]
    fn a_feed_step_reaches_the_chip_in_one_revolution() {
        for cycles in [60.0, 1000.0] {
            let mut trail = ChipTrail::new(cycles);
            for k in 1..=1500 {
                let chip = trail.step(1.0);
                assert!(
                    (chip - (f64::from(k) / cycles).min(1.0)).abs() < 0.005,
                    "{k}: {chip}"
                );
            }
            for k in 1..=1500 {
                let chip = trail.step(0.0);
                assert!(
                    (chip - (1.0 - f64::from(k) / cycles).max(0.0)).abs() < 0.005,
                    "{k}: {chip}"
                );
            }
        }
    }
}
