//! The speed of a spindle as used by the feed: without the noise of its encoder, and reported when it has
//! changed.

use evolvent_bus::SpindleFeedback;

/// Time constant of the low-pass filter, s: ripple within a slow turn is not a change of speed.
const FILTER_S: f64 = 0.03;
/// A speed is sent again when it has changed by more than this fraction, or by 1 rpm.
const MIN_CHANGE: f64 = 0.005;

/// The speed of one spindle. Does not allocate or wait.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Speedometer {
    /// Number and time of the newest sample, and the filtered speed, rpm.
    newest: Option<(u64, u64, f64)>,
    reported_rpm: Option<f64>,
}

impl Speedometer {
    /// The commanded speed of a ramp, rpm, not negative, in the same steps, and exact at its end.
    /// `is_passing`: the ramp has not ended.
    pub(crate) fn commanded_rpm(&mut self, rpm: f64, is_passing: bool) -> f64 {
        let reported = self.reported_rpm.filter(|reported| {
            is_passing && rpm > 0.0 && (rpm - reported).abs() <= (MIN_CHANGE * reported).max(1.0)
        });
        let reported = reported.unwrap_or(rpm);
        self.reported_rpm = Some(reported);
        reported
    }

    /// The reported speed, rpm, never negative; `None` if it is not measured. `known` is the newest sample,
    /// unless it is too old.
    pub(crate) fn rpm(&mut self, known: Option<&SpindleFeedback>) -> Option<f64> {
        let Some(sample) = known else {
            *self = Self::default();
            return None;
        };
        let rpm = sample.speed_rpm.abs();
        let filtered = match self.newest {
            Some((sequence, _, filtered)) if sequence == sample.sequence => filtered,
            Some((_, time_ns, filtered)) => {
                let passed_s = sample.time_ns.saturating_sub(time_ns) as f64 * 1e-9;
                filtered + (rpm - filtered) * (1.0 - (-passed_s / FILTER_S).exp())
            }
            None => rpm,
        };
        self.newest = Some((sample.sequence, sample.time_ns, filtered));
        let stays = self.reported_rpm.is_some_and(|reported| {
            let has_stopped = rpm == 0.0 && filtered < 1.0;
            (filtered - reported).abs() <= (MIN_CHANGE * reported).max(1.0)
                && (!has_stopped || reported == 0.0)
        });
        if !stays {
            self.reported_rpm = Some(if rpm == 0.0 && filtered < 1.0 {
                0.0
            } else {
                filtered
            });
        }
        self.reported_rpm
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(sequence: u64, speed_rpm: f64) -> SpindleFeedback {
        SpindleFeedback {
            sequence,
            time_ns: sequence * 1_000_000,
            speed_rpm,
            ..SpindleFeedback::default()
        }
    }

    #[test]
    fn the_speedometer_hides_ripple_and_follows_changes() {
        let mut meter = Speedometer::default();
        let mut reported = Vec::new();
        for k in 1..=1000_u32 {
            // 2 % of ripple, three times a turn.
            let ripple = (std::f64::consts::TAU * 3.0 * 1500.0 / 60.0 * f64::from(k) * 1e-3).sin();
            let rpm = meter.rpm(Some(&sample(k.into(), -1500.0 * (1.0 + 0.02 * ripple))));
            reported.push(rpm.unwrap());
        }
        reported.dedup();
        assert!(reported.len() <= 4, "{reported:?}");
        assert!((reported[reported.len() - 1] / 1500.0 - 1.0).abs() < 0.01);
        // A step to 1000 rpm: after three time constants 5 % of it are left.
        let mut rpm = 0.0;
        for k in 1001..=1090 {
            rpm = meter.rpm(Some(&sample(k, 1000.0))).unwrap();
        }
        assert!((rpm - 1025.0).abs() < 10.0, "{rpm}");
        for k in 1091..=2000 {
            rpm = meter.rpm(Some(&sample(k, 0.0))).unwrap();
        }
        assert_eq!(rpm, 0.0);
        assert_eq!(meter.rpm(None), None);
        assert_eq!(meter.rpm(Some(&sample(1, 700.0))), Some(700.0), "another bridge");
    }
}
