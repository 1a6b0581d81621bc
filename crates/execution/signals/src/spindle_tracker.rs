//! The angle of a spindle at any instant, from samples that are late and quantised, at varying speed.
//!
//! A Kalman filter. Its state is the angle `u` of an even spindle, its speed and acceleration, and the first
//! harmonics of one turn, by which the true angle differs: `phi = u + sum(c_k cos 2 pi k phi + s_k sin 2 pi k
//! phi)`. Acceleration and harmonics drift at random. The filter learns deviations that repeat every turn (an
//! uneven transmission, a bent encoder shaft, the teeth of the motor) and separates them from changes of
//! speed. Its prediction for a few milliseconds ahead is more accurate than the newest sample extrapolated at
//! its speed.

use std::f64::consts::TAU;

use crate::encoder_step::EncoderStep;

/// Number of harmonics of one turn that are learned.
pub const HARMONICS: usize = 3;
/// Angle, speed, acceleration.
const MEAN: usize = 3;
const STATES: usize = MEAN + 2 * HARMONICS;

/// The smallest step of an encoder that is distinguished, turns. Smaller steps have no effect.
const FINEST_STEP: f64 = 1.0 / 4096.0;
/// Drift of the acceleration, turns^2/s^5: the filter then follows changes up to about 15 Hz at 1000 samples
/// per second.
const ACCELERATION_DRIFT: f64 = 5.0;
/// Threshold of the smoothed squared prediction error, as a multiple of its expected value. Above it the
/// spindle has changed its motion: it is braked, reversed or loaded.
const SURPRISE: f64 = 4.0;
/// Weight of the newest error in the smoothed one.
const SURPRISE_FRACTION: f64 = 0.25;
/// Standard deviation of the acceleration above that threshold, turns/s^2.
const SURPRISE_ACCELERATION: f64 = 6.0;
/// Drift of the harmonics, turns^2/s: they are learned within a few seconds.
const HARMONIC_DRIFT: f64 = 2.5e-12;
/// Initial standard deviations: turns/s, turns/s^2, and turns of a harmonic.
const START: [f64; 3] = [100.0, 50.0, 3e-3];
/// Maximum time between two samples, s; after a longer gap the filter starts again.
const GAP_S: f64 = 0.2;
/// Minimum number of samples before a prediction is used.
const SETTLING_SAMPLES: u32 = 24;
/// Minimum angle before a prediction is used, turns, so that every harmonic has been observed.
const SETTLING_TURNS: f64 = 1.25;
/// Minimum time before a prediction is used, s.
const SETTLING_S: f64 = 0.06;

/// The angle of a spindle at one instant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SpindleAngle {
    /// Time of the sample, as the number of the setpoint that is due then; a fraction between two setpoints.
    pub cycle: f64,
    /// Turns since the index pulse, negative counter-clockwise.
    pub turns: f64,
}

/// Angle, speed and acceleration, turns and seconds.
pub type AngleJet = [f64; 3];

/// The motion of a spindle at one instant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SpindleMotion {
    /// Motion without the periodic deviation.
    pub mean: AngleJet,
    /// Contribution of each harmonic of one turn.
    pub ripple: [AngleJet; HARMONICS],
}

/// Predicts the angle. Neither allocates nor waits; a sample costs several hundred multiplications.
#[derive(Clone, Debug, PartialEq)]
pub struct SpindleTracker {
    period_s: f64,
    last: Option<SpindleAngle>,
    state: [f64; STATES],
    covariance: [[f64; STATES]; STATES],
    /// Step of the encoder, estimated from its samples.
    step: EncoderStep,
    surprise: f64,
    samples: u32,
    turned: f64,
    seconds: f64,
}

impl SpindleTracker {
    /// A filter without samples. `period_s` is the time from one setpoint to the next, s.
    #[must_use]
    pub const fn new(period_s: f64) -> Self {
        Self {
            period_s,
            last: None,
            state: [0.0; STATES],
            covariance: [[0.0; STATES]; STATES],
            step: EncoderStep::NEW,
            surprise: 0.0,
            samples: 0,
            turned: 0.0,
            seconds: 0.0,
        }
    }

    /// Forgets all samples.
    pub const fn forget(&mut self) {
        self.last = None;
    }

    /// Processes a sample. A sample that is not later than the last one, or not finite, is ignored.
    pub fn observe(&mut self, sample: &SpindleAngle) {
        if !sample.cycle.is_finite() || !sample.turns.is_finite() {
            return;
        }
        match self.last {
            Some(last) if sample.cycle <= last.cycle => {}
            Some(last) if (sample.cycle - last.cycle) * self.period_s <= GAP_S => {
                let seconds = (sample.cycle - last.cycle) * self.period_s;
                self.last = Some(*sample);
                self.samples = self.samples.saturating_add(1);
                self.turned += (sample.turns - last.turns).abs();
                self.seconds += seconds;
                self.step.observe(sample.turns - last.turns, FINEST_STEP);
                self.predict(seconds);
                self.correct(sample.turns);
            }
            _ => self.begin(sample),
        }
    }

    /// Time of the newest sample, as the number of a setpoint.
    #[must_use]
    pub fn newest_cycle(&self) -> Option<f64> {
        self.last.map(|last| last.cycle)
    }

    /// Whether the filter has seen enough samples for its predictions to be used.
    #[must_use]
    pub fn is_settled(&self) -> bool {
        self.last.is_some()
            && self.samples >= SETTLING_SAMPLES
            && self.turned >= SETTLING_TURNS
            && self.seconds >= SETTLING_S
    }

    /// The motion when the setpoint with this number is due; `None` before the first sample.
    #[must_use]
    pub fn at(&self, cycle: f64) -> Option<SpindleMotion> {
        let ahead_s = (cycle - self.last?.cycle) * self.period_s;
        let [u, speed, acceleration] = [self.state[0], self.state[1], self.state[2]];
        let mean = [
            u + ahead_s * (speed + 0.5 * ahead_s * acceleration),
            speed + ahead_s * acceleration,
            acceleration,
        ];
        // The harmonics are functions of the true angle, which is the mean angle plus the harmonics.
        let angle = mean[0] + self.deviation(mean[0]);
        let mut ripple = [[0.0; 3]; HARMONICS];
        for (order, jet) in ripple.iter_mut().enumerate() {
            let (cosine, sine) = self.harmonic(order);
            let rate = TAU * (order + 1) as f64;
            let (sin, cos) = libm::sincos(rate * (angle - angle.floor()));
            let slope = rate * (sine * cos - cosine * sin);
            let value = cosine * cos + sine * sin;
            jet[0] = value;
            jet[1] = slope * mean[1];
            jet[2] = slope * mean[2] - rate * rate * value * mean[1] * mean[1];
        }
        Some(SpindleMotion { mean, ripple })
    }

    fn harmonic(&self, order: usize) -> (f64, f64) {
        (self.state[MEAN + 2 * order], self.state[MEAN + 2 * order + 1])
    }

    /// Cosines and sines of the turn at an angle.
    fn waves(angle: f64) -> [f64; 2 * HARMONICS] {
        let mut waves = [0.0; 2 * HARMONICS];
        for order in 0..HARMONICS {
            let (sin, cos) = libm::sincos(TAU * (order + 1) as f64 * (angle - angle.floor()));
            (waves[2 * order], waves[2 * order + 1]) = (cos, sin);
        }
        waves
    }

    fn deviation(&self, angle: f64) -> f64 {
        let waves = Self::waves(angle);
        waves
            .iter()
            .zip(&self.state[MEAN..])
            .map(|(wave, coefficient)| wave * coefficient)
            .sum()
    }

    /// Variance of a sample, turns squared: a uniform error within one step.
    fn sample_variance(&self) -> f64 {
        let step = self.step.turns().max(FINEST_STEP);
        step * step / 12.0
    }

    fn begin(&mut self, sample: &SpindleAngle) {
        self.last = Some(*sample);
        self.state = [0.0; STATES];
        self.state[0] = sample.turns;
        self.covariance = [[0.0; STATES]; STATES];
        let [speed, acceleration, harmonic] = START;
        // The angle of the even spindle differs from the sample by the harmonics.
        self.covariance[0][0] = self.sample_variance() + harmonic * harmonic;
        self.covariance[1][1] = speed * speed;
        self.covariance[2][2] = acceleration * acceleration;
        for at in MEAN..STATES {
            self.covariance[at][at] = harmonic * harmonic;
        }
        // A trace that begins here has no earlier samples.
        self.step = EncoderStep::NEW;
        (self.surprise, self.samples, self.turned, self.seconds) = (0.0, 1, 0.0, 0.0);
    }

    fn predict(&mut self, t: f64) {
        let half = 0.5 * t * t;
        self.state[0] += t * self.state[1] + half * self.state[2];
        self.state[1] += t * self.state[2];
        let p = &mut self.covariance;
        for column in 0..STATES {
            p[0][column] += t * p[1][column] + half * p[2][column];
            p[1][column] += t * p[2][column];
        }
        for row in p.iter_mut() {
            row[0] += t * row[1] + half * row[2];
            row[1] += t * row[2];
        }
        let q = ACCELERATION_DRIFT * t;
        let drift = [
            [t * t * t * t / 20.0, t * t * t / 8.0, t * t / 6.0],
            [t * t * t / 8.0, t * t / 3.0, t / 2.0],
            [t * t / 6.0, t / 2.0, 1.0],
        ];
        for (row, drifts) in p.iter_mut().zip(drift) {
            for (value, drift) in row.iter_mut().zip(drifts) {
                *value += q * drift;
            }
        }
        for (at, row) in p.iter_mut().enumerate().skip(MEAN) {
            row[at] += HARMONIC_DRIFT * t;
        }
    }

    fn correct(&mut self, turns: f64) {
        let mut measures = [0.0; STATES];
        measures[0] = 1.0;
        measures[MEAN..].copy_from_slice(&Self::waves(turns));
        let mut gain = [0.0; STATES];
        for (value, row) in gain.iter_mut().zip(&self.covariance) {
            *value = row.iter().zip(&measures).map(|(a, b)| a * b).sum();
        }
        let variance: f64 =
            gain.iter().zip(&measures).map(|(a, b)| a * b).sum::<f64>() + self.sample_variance();
        let predicted: f64 = self.state.iter().zip(&measures).map(|(a, b)| a * b).sum();
        let innovation = turns - predicted;
        // Row by row, so that the matrix stays symmetric to the last bit.
        for row in 0..STATES {
            self.state[row] += gain[row] / variance * innovation;
            for column in 0..=row {
                let value = self.covariance[row][column] - gain[row] * gain[column] / variance;
                self.covariance[row][column] = value;
                self.covariance[column][row] = value;
            }
        }
        self.surprise += SURPRISE_FRACTION * (innovation * innovation / variance - self.surprise);
        if self.surprise > SURPRISE {
            self.surprise = 1.0;
            self.covariance[2][2] += SURPRISE_ACCELERATION * SURPRISE_ACCELERATION;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_S: f64 = 1e-3;

    /// A spindle of constant speed plus one harmonic, with an encoder.
    struct Uneven {
        rev_s: f64,
        order: f64,
        ripple: f64,
        counts: f64,
    }

    impl Uneven {
        /// Integrates the speed in small steps, without the model of the filter.
        fn angles(&self, seconds: f64) -> Vec<f64> {
            let steps = 50;
            let dt = PERIOD_S / f64::from(steps);
            let mut turns = 0.37;
            let mut angles = Vec::new();
            for _ in 0..(seconds / PERIOD_S) as usize {
                angles.push(turns);
                for _ in 0..steps {
                    turns += dt * self.rev_s * (1.0 + self.ripple * (self.order * TAU * turns).sin());
                }
            }
            angles
        }

        fn shown(&self, turns: f64) -> f64 {
            (turns * self.counts).floor() / self.counts + 0.5 / self.counts
        }
    }

    /// The maximum error of the angle `ahead` setpoints after each sample, once the filter has settled,
    /// turns.
    fn worst(spindle: &Uneven, ahead: usize) -> f64 {
        let angles = spindle.angles(4.0);
        let mut tracker = SpindleTracker::new(PERIOD_S);
        let mut worst: f64 = 0.0;
        for (at, turns) in angles.iter().enumerate() {
            tracker.observe(&SpindleAngle {
                cycle: at as f64,
                turns: spindle.shown(*turns),
            });
            if let Some(truth) = angles.get(at + ahead)
                && at > 2000
            {
                let motion = tracker.at((at + ahead) as f64).expect("samples");
                let estimate = motion.mean[0] + motion.ripple.iter().map(|jet| jet[0]).sum::<f64>();
                worst = worst.max((estimate - truth).abs());
            }
        }
        assert!(tracker.is_settled());
        worst
    }

    /// The angle of a coarse encoder is a staircase although the speed of the spindle is constant.
    #[test]
    fn a_coarse_encoder_is_predicted_within_its_step() {
        for counts in [72.0, 100.0, 256.0, 400.0, 1024.0, 2500.0, 4096.0] {
            for rpm in [60.0, 100.0, 300.0, 600.0, 1500.0, 3000.0] {
                for (order, ripple) in [(1.0, 0.0), (1.0, 0.01), (3.0, 0.01)] {
                    let spindle = Uneven {
                        rev_s: rpm / 60.0,
                        order,
                        ripple,
                        counts,
                    };
                    let steps = worst(&spindle, 5) * counts;
                    let what = format!("{counts} counts, {rpm} rpm, ripple {ripple} of order {order}");
                    assert!(steps < 1.1, "{what}: {steps} steps");
                }
            }
        }
    }

    #[test]
    fn an_uneven_spindle_is_predicted_within_a_count() {
        for rpm in [100.0, 600.0, 1500.0, 3000.0] {
            for order in [1.0, 2.0, 3.0] {
                let spindle = Uneven {
                    rev_s: rpm / 60.0,
                    order,
                    ripple: 0.02,
                    counts: 4096.0,
                };
                let worst = worst(&spindle, 5);
                assert!(worst < 1.0 / 4096.0, "{rpm} rpm, order {order}: {worst} turns");
            }
        }
    }

    #[test]
    fn a_spindle_that_speeds_up_is_followed() {
        // 2000 rpm/s from 600 rpm on, then constant again.
        let mut tracker = SpindleTracker::new(PERIOD_S);
        let (mut turns, mut speed, mut worst) = (0.0, 10.0, 0.0_f64);
        let mut foretold = Vec::new();
        for at in 0..3000 {
            tracker.observe(&SpindleAngle {
                cycle: f64::from(at),
                turns: (turns * 4096.0_f64).floor() / 4096.0,
            });
            foretold.push(tracker.at(f64::from(at + 5)).unwrap().mean[0]);
            if at > 500 {
                worst = worst.max((foretold[at as usize - 5] - turns).abs());
            }
            let acceleration = if (1000..1500).contains(&at) { 33.0 } else { 0.0 };
            turns += speed * PERIOD_S + 0.5 * acceleration * PERIOD_S * PERIOD_S;
            speed += acceleration * PERIOD_S;
        }
        assert!(worst < 2e-3, "{worst}");
    }

    #[test]
    fn settling_takes_one_turn_and_a_gap_restarts_it() {
        let mut tracker = SpindleTracker::new(PERIOD_S);
        assert_eq!(tracker.at(0.0), None);
        let see = |tracker: &mut SpindleTracker, at: f64| {
            tracker.observe(&SpindleAngle {
                cycle: at,
                turns: at * 0.01,
            });
        };
        for at in 0..120 {
            see(&mut tracker, f64::from(at));
            assert!(!tracker.is_settled(), "{at}");
        }
        for at in 120..130 {
            see(&mut tracker, f64::from(at));
        }
        assert!(tracker.is_settled());
        let before = tracker.clone();
        for bad in [100.0, f64::NAN, f64::INFINITY] {
            see(&mut tracker, bad);
            assert_eq!(tracker, before, "{bad}");
        }
        see(&mut tracker, 1000.0);
        assert!(!tracker.is_settled());
        tracker.forget();
        assert_eq!(tracker.at(1001.0), None);
    }
}
