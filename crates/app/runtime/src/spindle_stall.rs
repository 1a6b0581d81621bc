//! Detects whether the cut has stopped a spindle that had reached its speed.

/// Fraction of the commanded speed from which on the speed counts as reached.
const REACHED: f64 = 0.8;
/// Fraction of the commanded speed below which a spindle that had reached it counts as stopped.
const STALLED: f64 = 0.2;
/// A command above the reached speed times this factor is a new speed, which has to be reached first.
const RAISED: f64 = 1.25;
/// Minimum duration of a stall, s, and in turns at the commanded speed: a coarse encoder reports a slow
/// spindle's speed in jumps.
const MIN_S: f64 = 0.2;
const MIN_TURNS: f64 = 0.5;

/// Monitors one spindle. Does not allocate or wait.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct StallWatch {
    /// The commanded direction, 1 or -1; 0 to stop.
    direction: f64,
    /// The commanded speed that was reached, rpm; 0 if none.
    reached_rpm: f64,
    stands_since_ns: Option<u64>,
}

impl StallWatch {
    /// Checks one pair of speeds, both in rpm and negative counter-clockwise.
    pub(crate) fn is_stalled(&mut self, commanded_rpm: f64, measured_rpm: f64, now_ns: u64) -> bool {
        let direction = if commanded_rpm == 0.0 {
            0.0
        } else {
            commanded_rpm.signum()
        };
        if direction != self.direction {
            *self = Self {
                direction,
                ..Self::default()
            };
        }
        let (wanted, found) = (commanded_rpm.abs(), direction * measured_rpm);
        if wanted == 0.0 {
            return false;
        }
        if found >= REACHED * wanted {
            (self.reached_rpm, self.stands_since_ns) = (wanted, None);
            return false;
        }
        if wanted > RAISED * self.reached_rpm {
            self.reached_rpm = 0.0;
        }
        if self.reached_rpm == 0.0 || found >= STALLED * wanted {
            self.stands_since_ns = None;
            return false;
        }
        let since_ns = *self.stands_since_ns.get_or_insert(now_ns);
        let least_s = MIN_S.max(MIN_TURNS * 60.0 / wanted);
        now_ns.saturating_sub(since_ns) as f64 * 1e-9 >= least_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Checks each millisecond; returns the first at which the spindle is stalled.
    fn stalls(speeds: impl Fn(u64) -> (f64, f64)) -> Option<u64> {
        let mut watch = StallWatch::default();
        (0..10_000).find(|ms| {
            let (commanded, measured) = speeds(*ms);
            watch.is_stalled(commanded, measured, ms * 1_000_000)
        })
    }

    /// Speeds up at 600 rpm/s.
    fn speeding_up(ms: u64, from: f64, to: f64) -> f64 {
        (from + 0.6 * ms as f64).min(to)
    }

    #[test]
    fn a_spindle_stopped_at_speed_is_stalled() {
        for sign in [1.0, -1.0] {
            let found = stalls(|ms| {
                let measured = if ms < 2000 {
                    speeding_up(ms, 0.0, 900.0)
                } else {
                    0.0
                };
                (sign * 900.0, sign * measured)
            });
            assert_eq!(found, Some(2200));
        }
        // Half a turn at a low speed takes longer.
        assert_eq!(stalls(|ms| (30.0, if ms < 50 { 30.0 } else { 0.0 })), Some(1050));
    }

    #[test]
    fn speed_changes_and_lag_are_no_stall() {
        assert_eq!(
            stalls(|ms| (3000.0, speeding_up(ms / 4, 0.0, 3000.0))),
            None,
            "slowly"
        );
        let raised = |ms: u64| {
            if ms < 1000 {
                (50.0, 50.0)
            } else {
                (2000.0, speeding_up(ms - 1000, 50.0, 2000.0))
            }
        };
        assert_eq!(stalls(raised), None, "an override that is raised");
        assert_eq!(
            stalls(|ms| if ms < 1000 { (900.0, 900.0) } else { (0.0, 0.0) }),
            None,
            "M5"
        );
        let reversed = |ms: u64| {
            let command = if ms < 1000 { 600.0 } else { -600.0 };
            (
                command,
                if ms < 1000 {
                    600.0
                } else {
                    (600.0 - 0.6 * (ms - 1000) as f64).max(-600.0)
                },
            )
        };
        assert_eq!(stalls(reversed), None, "M4 behind M3");
        assert_eq!(
            stalls(|ms| (900.0, if ms < 1000 { 900.0 } else { 450.0 })),
            None,
            "half the speed"
        );
        let dips = |ms: u64| (900.0, if ms > 1000 && ms % 300 < 150 { 0.0 } else { 900.0 });
        assert_eq!(stalls(dips), None, "samples that are missing");
        assert_eq!(
            stalls(|_| (900.0, 0.0)),
            None,
            "one that never turned is waited for elsewhere"
        );
    }
}
