//! Spindle orientation (M19) by a position loop on the speed command of a drive.

use crate::spindle_encoder::SpindleEncoder;

/// `spindle_way` of the bus.
const WAY_CLOCKWISE: u32 = 1;
const WAY_COUNTER_CLOCKWISE: u32 = 2;
/// The loop begins below this multiple of its maximum speed; above it the spindle brakes.
const CATCH_RATIO: f64 = 1.2;
/// Time within the tolerance after which the spindle is oriented, ns.
const SETTLED_NS: u64 = 50_000_000;
/// The integral acts below this fraction of the maximum speed. At higher speeds it would only cause
/// overshoot; its purpose is to remove the error at standstill.
const INTEGRAL_BELOW: f64 = 0.05;
/// Maximum part of the integral in the command, as a ratio of the maximum speed.
const INTEGRAL_RATIO: f64 = 0.2;

/// The loop of a spindle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OrientationSettings {
    /// Speed per error, 1/s.
    pub gain: f64,
    /// Integral gain, 1/s2: removes the offset of an analog speed of zero.
    pub integral_gain: f64,
    /// Maximum speed, rpm.
    pub max_rpm: f64,
    /// Tolerance of the angle, degrees.
    pub tolerance_deg: f64,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum Phase {
    /// No orientation is commanded.
    #[default]
    Off,
    /// The spindle is too fast, or its index has not occurred yet.
    Approach,
    /// The spindle turns to this angle, turns since the index pulse, and holds it.
    Turn(f64),
}

/// Turns a spindle to an angle. Neither allocates nor waits.
#[derive(Clone, Copy, Debug)]
pub struct SpindleOrientation {
    settings: OrientationSettings,
    phase: Phase,
    integral: f64,
    /// Time since which it has been within the tolerance.
    there_since_ns: Option<u64>,
    last_ns: u64,
    /// The last command: angle and `spindle_way`.
    wanted: (f64, u32),
}

impl SpindleOrientation {
    /// Creates a loop without a command.
    #[must_use]
    pub const fn new(settings: OrientationSettings) -> Self {
        Self {
            settings,
            phase: Phase::Off,
            integral: 0.0,
            there_since_ns: None,
            last_ns: 0,
            wanted: (0.0, 0),
        }
    }

    /// No orientation is commanded.
    pub const fn end(&mut self) {
        (self.phase, self.integral, self.there_since_ns) = (Phase::Off, 0.0, None);
    }

    /// Runs one period of an orientation to an angle, degrees; `way` is the `spindle_way` of the bus. Returns
    /// the speed to command, rpm, negative counter-clockwise.
    pub fn step(&mut self, angle_deg: f64, way: u32, encoder: &SpindleEncoder, now_ns: u64) -> f64 {
        let period_s = now_ns.saturating_sub(self.last_ns).min(100_000_000) as f64 * 1e-9;
        self.last_ns = now_ns;
        if self.wanted != (angle_deg, way) {
            self.end();
            self.wanted = (angle_deg, way);
        }
        if self.phase == Phase::Off {
            (self.phase, self.integral) = (Phase::Approach, 0.0);
        }
        let max = self.settings.max_rpm;
        if self.phase == Phase::Approach {
            if encoder.speed_rpm().abs() > CATCH_RATIO * max {
                return 0.0;
            }
            if !encoder.is_indexed() {
                return if way == WAY_COUNTER_CLOCKWISE { -max } else { max };
            }
            self.phase = Phase::Turn(encoder.angle() + self.distance(angle_deg, way, encoder.angle()));
        }
        let Phase::Turn(target) = self.phase else {
            return 0.0;
        };
        let error = target - encoder.angle();
        if error.abs() > self.tolerance(encoder) {
            self.there_since_ns = None;
        } else {
            let _since = self.there_since_ns.get_or_insert(now_ns);
        }
        let max = max / 60.0;
        let integral = self.integral + self.settings.integral_gain * error * period_s;
        let proportional = self.settings.gain * error;
        if encoder.speed_rpm().abs() < INTEGRAL_BELOW * self.settings.max_rpm {
            self.integral = integral.clamp(-INTEGRAL_RATIO * max, INTEGRAL_RATIO * max);
        }
        (proportional + self.integral).clamp(-max, max) * 60.0
    }

    /// Whether the spindle is at its angle and holds it.
    #[must_use]
    pub fn is_oriented(&self) -> bool {
        matches!(self.phase, Phase::Turn(_))
            && (self.there_since_ns)
                .is_some_and(|since_ns| self.last_ns.saturating_sub(since_ns) >= SETTLED_NS)
    }

    /// The tolerance in turns, at least the resolution of a coarse encoder.
    fn tolerance(&self, encoder: &SpindleEncoder) -> f64 {
        (self.settings.tolerance_deg / 360.0).max(encoder.turns_per_count())
    }

    /// Turns from an angle to the commanded one, in the commanded direction.
    fn distance(&self, angle_deg: f64, way: u32, from: f64) -> f64 {
        let ahead = (angle_deg / 360.0 - from).rem_euclid(1.0);
        let tolerance = self.settings.tolerance_deg / 360.0;
        let is_there = ahead.min(1.0 - ahead) <= tolerance;
        match way {
            WAY_CLOCKWISE if !is_there => ahead,
            WAY_COUNTER_CLOCKWISE if !is_there => ahead - 1.0,
            _ if ahead > 0.5 => ahead - 1.0,
            _ => ahead,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{SpindleEncoderSettings, SpindleIndex};

    const MS: u64 = 1_000_000;

    /// A motor with a time constant of 20 ms and a speed offset, and its encoder.
    struct Motor {
        turns: f64,
        rpm: f64,
        drift_rpm: f64,
        encoder: SpindleEncoder,
        now_ns: u64,
    }

    impl Motor {
        fn step(&mut self, commanded: f64) {
            self.now_ns += MS;
            let before = self.turns;
            self.rpm += (commanded + self.drift_rpm - self.rpm) * (1.0 - (-0.05_f64).exp());
            self.turns += self.rpm / 60e3;
            let raw = |turns: f64| (turns * 4096.0).floor() as i64 as u32;
            self.encoder.read(raw(self.turns), self.now_ns);
            if !self.encoder.is_indexed() && before.floor() != self.turns.floor() {
                self.encoder.latch(raw(before.max(self.turns).floor()));
            }
        }
    }

    fn trial(angle_deg: f64, way: u32, start: (f64, f64), drift_rpm: f64) -> (f64, f64) {
        let mut motor = Motor {
            turns: start.0,
            rpm: start.1,
            drift_rpm,
            encoder: SpindleEncoder::new(SpindleEncoderSettings {
                counter_bits: 32,
                counts_per_turn: 4096,
                gear: [1, 1],
                inverted: false,
                index: SpindleIndex::PerSpindleTurn,
                index_tolerance: 8,
                at_speed_fraction: 0.02,
            }),
            now_ns: MS,
        };
        let mut orientation = SpindleOrientation::new(OrientationSettings {
            gain: 8.0,
            integral_gain: 16.0,
            max_rpm: 60.0,
            tolerance_deg: 0.3,
        });
        motor.step(0.0);
        let mut turned_from = None;
        for _ in 0..10_000 {
            let rpm = orientation.step(angle_deg, way, &motor.encoder, motor.now_ns);
            if let Phase::Turn(_) = orientation.phase {
                turned_from.get_or_insert(motor.turns);
            }
            assert!(rpm.abs() <= 60.0 + 1e-9);
            motor.step(rpm);
            if orientation.is_oriented() {
                let off = (motor.turns - angle_deg / 360.0).rem_euclid(1.0);
                let off = off.min(1.0 - off) * 360.0;
                return (off, motor.turns - turned_from.unwrap_or(motor.turns));
            }
        }
        panic!("{angle_deg} by {way} from {start:?}: {orientation:?}");
    }

    #[test]
    fn spindle_orients_in_any_direction_despite_drift() {
        for angle_deg in [0.0, 90.0, 251.0] {
            for way in [0, 1, 2] {
                for start in [(0.2, 0.0), (0.2, 900.0), (3.7, -700.0)] {
                    for drift in [0.0, 6.0, -6.0] {
                        let (off, turned) = trial(angle_deg, way, start, drift);
                        assert!(
                            off <= 0.4,
                            "{angle_deg} by {way} from {start:?}: {off} degrees off"
                        );
                        let (min, max) = [(-0.6, 0.6), (-0.1, 1.1), (-1.1, 0.1)][way as usize];
                        assert!((min..max).contains(&turned), "by {way}: {turned} turns");
                    }
                }
            }
        }
    }

    #[test]
    fn another_angle_begins_again_and_its_end_ends_it() {
        let settings = OrientationSettings {
            gain: 8.0,
            integral_gain: 0.0,
            max_rpm: 60.0,
            tolerance_deg: 0.3,
        };
        let mut encoder = SpindleEncoder::new(SpindleEncoderSettings {
            counter_bits: 32,
            counts_per_turn: 4096,
            gear: [1, 1],
            inverted: false,
            index: SpindleIndex::Absolute { zero: 0 },
            index_tolerance: 8,
            at_speed_fraction: 0.02,
        });
        encoder.read(0, MS);
        let mut orientation = SpindleOrientation::new(settings);
        for ms in 1..100 {
            let _rpm = orientation.step(0.0, 0, &encoder, ms * MS);
        }
        assert!(orientation.is_oriented());
        let rpm = orientation.step(90.0, 0, &encoder, 100 * MS);
        assert!(!orientation.is_oriented() && rpm > 0.0);
        orientation.end();
        assert!(!orientation.is_oriented());
    }
}
