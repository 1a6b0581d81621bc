//! The handwheel: converts counts to distances of an axis.

/// Maximum detents between two readings. A larger change means that the encoder or the bridge was restarted.
const MAX_DETENTS: f64 = 100.0;

/// The counts and the switches of the wheel at one moment.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HandwheelReading {
    /// Counts since the bridge started; `None` if unknown.
    pub counts: Option<f64>,
    /// Index of the selected axis; without one nothing moves.
    pub axis: Option<usize>,
    /// Distance of that axis per detent, mm or degrees.
    pub step: f64,
    /// The enabling button is pressed, or there is none.
    pub is_enabled: bool,
}

/// Follows the counts of a handwheel.
///
/// No count is lost between two readings with the same axis while the wheel is enabled. Counts that come
/// before an axis is selected, without the button, or while the counts are unknown move nothing, then or
/// later.
///
/// ```
/// use evolvent_control::{Handwheel, HandwheelReading};
///
/// let mut wheel = Handwheel::new(4.0);
/// let mut reading = HandwheelReading { counts: Some(7.0), axis: Some(0), step: 0.01, is_enabled: true };
/// assert_eq!(wheel.turn(&reading), None, "where it stands at first says nothing");
/// reading.counts = Some(15.0);
/// assert_eq!(wheel.turn(&reading), Some((0, 0.02)), "two detents");
/// reading.is_enabled = false;
/// reading.counts = Some(99.0);
/// assert_eq!(wheel.turn(&reading), None);
/// reading.is_enabled = true;
/// assert_eq!(wheel.turn(&reading), None, "nothing is made up for");
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Handwheel {
    counts_per_detent: f64,
    /// Counts and axis of the previous reading, if it was valid.
    last: Option<(f64, usize)>,
}

impl Handwheel {
    /// A wheel with this number of counts per detent.
    #[must_use]
    pub fn new(counts_per_detent: f64) -> Self {
        Self {
            counts_per_detent,
            last: None,
        }
    }

    /// The axis and its distance (mm or degrees) since the previous reading.
    pub fn turn(&mut self, reading: &HandwheelReading) -> Option<(usize, f64)> {
        let last = self.last.take();
        let (Some(counts), Some(axis), true) = (reading.counts, reading.axis, reading.is_enabled) else {
            return None;
        };
        self.last = Some((counts, axis));
        let (before, _) = last.filter(|(_, before)| *before == axis)?;
        let detents = (counts - before) / self.counts_per_detent;
        let was_turned = detents != 0.0 && detents.abs() <= MAX_DETENTS;
        was_turned.then_some((axis, detents * reading.step))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reading(counts: f64) -> HandwheelReading {
        HandwheelReading {
            counts: Some(counts),
            axis: Some(2),
            step: 0.1,
            is_enabled: true,
        }
    }

    #[test]
    fn every_count_is_followed_however_they_are_read() {
        let seed = 0x5eed_3ee1_u64;
        println!("seed {seed:#x}");
        let mut random = evolvent_random::Random::from_state(seed);
        for _ in 0..200 {
            let mut wheel = Handwheel::new(4.0);
            let (mut counts, mut travelled) = (1e6_f64, 0.0_f64);
            wheel.turn(&reading(counts));
            let start = counts;
            for _ in 0..500 {
                counts += f64::round(9.0 * random.unit() - 4.5);
                if random.unit() < 0.6 {
                    travelled += wheel
                        .turn(&reading(counts))
                        .map_or(0.0, |(_, travelled)| travelled);
                }
            }
            travelled += wheel
                .turn(&reading(counts))
                .map_or(0.0, |(_, travelled)| travelled);
            assert!((travelled - (counts - start) / 4.0 * 0.1).abs() < 1e-9);
        }
    }

    #[test]
    fn what_is_not_the_hand_moves_nothing() {
        let mut wheel = Handwheel::new(4.0);
        wheel.turn(&reading(0.0));
        // The bridge was restarted: its counts are different.
        assert_eq!(wheel.turn(&reading(-5000.0)), None);
        assert_eq!(wheel.turn(&reading(-4996.0)), Some((2, 0.1)));
        // Unknown for a while.
        assert_eq!(
            wheel.turn(&HandwheelReading {
                counts: None,
                ..reading(0.0)
            }),
            None
        );
        assert_eq!(wheel.turn(&reading(-4900.0)), None);
        assert_eq!(wheel.turn(&reading(-4904.0)), Some((2, -0.1)));
        // Another axis, or none.
        let other = |axis| HandwheelReading {
            axis,
            ..reading(-4800.0)
        };
        assert_eq!(wheel.turn(&other(Some(0))), None);
        assert_eq!(wheel.turn(&other(None)), None);
        assert_eq!(wheel.turn(&reading(-4700.0)), None);
        // NaN never gets here; it would move nothing.
        assert_eq!(wheel.turn(&reading(f64::NAN)), None);
        assert_eq!(wheel.turn(&reading(-4700.0)), None);
    }
}
