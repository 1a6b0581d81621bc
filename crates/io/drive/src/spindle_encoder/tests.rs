use evolvent_random::Random;

use super::*;

const MS: u64 = 1_000_000;

const SETTINGS: SpindleEncoderSettings = SpindleEncoderSettings {
    counter_bits: 16,
    counts_per_turn: 4096,
    gear: [1, 1],
    inverted: false,
    index: SpindleIndex::PerSpindleTurn,
    index_tolerance: 8,
    at_speed_fraction: 0.02,
};

/// A shaft whose encoder is read by a bridge that arms the index latch again and again.
struct Shaft {
    encoder: SpindleEncoder,
    /// True turns of the spindle.
    turns: f64,
    /// Counts the counter has lost.
    lost: i64,
    has_index: bool,
    time_ns: u64,
    /// The true angle of the first pulse.
    first_pulse: Option<f64>,
    /// Where a pulse is, turns.
    index_at: f64,
}

impl Shaft {
    fn new(settings: SpindleEncoderSettings, turns: f64) -> Self {
        Self {
            encoder: SpindleEncoder::new(settings),
            turns,
            lost: 0,
            has_index: true,
            time_ns: 5 * MS,
            first_pulse: None,
            index_at: 0.3,
        }
    }

    fn raw(&self, turns: f64) -> u32 {
        let settings = self.encoder.settings();
        let counts = turns * f64::from(settings.counts_per_turn) * f64::from(settings.gear[0])
            / f64::from(settings.gear[1]);
        let counts = if settings.inverted { -counts } else { counts };
        let mask = if settings.counter_bits == 32 {
            u32::MAX
        } else {
            (1 << settings.counter_bits) - 1
        };
        (counts.floor() as i64 + self.lost) as u32 & mask
    }

    /// Goes on by one period at a speed; the pulse is latched where it truly is.
    fn step(&mut self, rpm: f64, period_ns: u64) {
        let before = self.turns;
        self.turns += rpm / NS_PER_MINUTE * period_ns as f64;
        self.time_ns += period_ns;
        let (low, high) = (before.min(self.turns), before.max(self.turns));
        let pulse = (high - self.index_at).floor() + self.index_at;
        self.encoder.read(self.raw(self.turns), self.time_ns);
        if self.has_index && self.encoder.has_pulse() && pulse > low && pulse <= high {
            // The count of the shaft just after the edge.
            let behind = pulse + (self.turns - before).signum() * 1e-6;
            self.encoder.latch(self.raw(behind));
            self.first_pulse.get_or_insert(pulse);
        }
        if self.encoder.swept.is_none() && self.encoder.has_pulse() {
            self.encoder.set_armed();
        }
    }

    /// By how many counts the reported angle is off.
    fn error_counts(&self) -> f64 {
        let zero = self.first_pulse.unwrap_or(0.0);
        (self.encoder.angle() - (self.turns - zero)) / self.encoder.turns_per_count()
    }
}

/// Random speeds and reversals, counters of 16 and 32 bits that wrap round, both directions of counting,
/// gears: the angle is the true one within a count, from the first pulse on.
#[test]
fn angle_counts_from_index_across_counter_wraps() {
    let mut random = Random::new();
    for round in 0..300 {
        let gear = [[1, 1], [2, 1], [1, 2], [3, 2], [40, 17]][random.bits() as usize % 5];
        let settings = SpindleEncoderSettings {
            counter_bits: if round % 2 == 0 { 16 } else { 32 },
            counts_per_turn: [400, 4096, 10_000][random.bits() as usize % 3],
            gear,
            inverted: random.bits().is_multiple_of(2),
            ..SETTINGS
        };
        // Near the end of the counter, wherever that is.
        let edge = [0.0, 65_536.0, 2_147_483_648.0, -65_536.0][random.bits() as usize % 4];
        let per_turn = f64::from(settings.counts_per_turn) * f64::from(gear[0]) / f64::from(gear[1]);
        let mut shaft = Shaft::new(settings, edge / per_turn + random.between(-1.0, 1.0));
        let mut speed = 0.0;
        for period in 0..2000 {
            if period % 100 == 0 {
                speed = random.between(-3000.0, 3000.0);
            }
            shaft.step(speed, MS);
            if shaft.first_pulse.is_some() {
                let error = shaft.error_counts();
                assert!(error.abs() <= 1.6, "{settings:?}: {error} counts at {period}");
                assert!(shaft.encoder.is_indexed());
            }
            assert_eq!(shaft.encoder.fault(), None, "{settings:?} at {period}");
        }
        assert!(shaft.first_pulse.is_some());
    }
}

#[test]
fn angle_is_unknown_before_index_or_without_one() {
    let mut shaft = Shaft::new(SETTINGS, 0.4);
    for _ in 0..80 {
        shaft.step(600.0, MS);
    }
    assert!(!shaft.encoder.is_indexed());
    for _ in 0..20 {
        shaft.step(600.0, MS);
    }
    assert!(shaft.encoder.is_indexed());
    let none = SpindleEncoderSettings {
        index: SpindleIndex::None,
        ..SETTINGS
    };
    let mut shaft = Shaft::new(none, 0.0);
    for _ in 0..1000 {
        shaft.step(600.0, MS);
    }
    assert!(!shaft.encoder.is_indexed() && shaft.encoder.fault().is_none());
    assert!((shaft.encoder.speed_rpm() - 600.0).abs() < 3.0);
}

/// The angle of the time before is worth nothing: the zero is that of the next pulse.
#[test]
fn encoder_unread_for_too_long_searches_index_again() {
    let mut shaft = Shaft::new(SETTINGS, 0.0);
    for _ in 0..300 {
        shaft.step(600.0, MS);
    }
    assert!(shaft.encoder.is_indexed());
    shaft.encoder.set_unread(80);
    shaft.step(600.0, MS);
    assert_eq!(
        shaft.encoder.fault(),
        Some(SpindleEncoderFault::Unread { ms: 80 })
    );
    shaft.encoder.reset();
    assert!(shaft.encoder.fault().is_none() && !shaft.encoder.is_indexed());
}

/// Three turns of the encoder per turn of the spindle: a pulse each third of a turn, and the zero is the
/// first of them.
#[test]
fn geared_encoder_checks_index_by_encoder_turns() {
    let mut encoder = SpindleEncoder::new(SpindleEncoderSettings {
        counts_per_turn: 400,
        gear: [3, 1],
        index: SpindleIndex::PerEncoderTurn,
        ..SETTINGS
    });
    let pulses = [100, 500, 900, 1300, 2500];
    for (period, pulse) in (0_u64..).zip(pulses) {
        encoder.read(pulse + 3, period * MS);
        encoder.latch(pulse);
        assert_eq!(encoder.fault(), None, "{pulse}");
    }
    // Two turns of the spindle from the first pulse.
    assert_eq!(encoder.turns(), (2, 3.5 / 1200.0));
    encoder.read(2950, 9 * MS);
    encoder.latch(2940);
    assert_eq!(
        encoder.fault(),
        Some(SpindleEncoderFault::LostCounts { counts: 40 })
    );
}

#[test]
fn absolute_encoder_is_indexed_at_first_reading() {
    let absolute = SpindleEncoderSettings {
        counter_bits: 32,
        index: SpindleIndex::Absolute { zero: 1024 },
        ..SETTINGS
    };
    let mut encoder = SpindleEncoder::new(absolute);
    encoder.read(2048, MS);
    assert!(encoder.is_indexed());
    assert!(
        (encoder.angle() - 0.25).abs() <= 1.0 / 4096.0,
        "{}",
        encoder.angle()
    );
}

#[test]
fn the_speed_is_exact_at_any_speed() {
    for (counts_per_turn, rpm, max) in [
        (4096, 3000.0, 0.001),
        (4096, 300.0, 0.01),
        (4096, 30.0, 0.015),
        (4096, 2.0, 0.03),
        (400, 60.0, 0.02),
        (400, 12.0, 0.03),
    ] {
        for sign in [1.0, -1.0] {
            let settings = SpindleEncoderSettings {
                counts_per_turn,
                ..SETTINGS
            };
            let mut shaft = Shaft::new(settings, 0.17);
            let mut worst: f64 = 0.0;
            for period in 0..3000 {
                shaft.step(sign * rpm, MS);
                if period > 200 {
                    worst = worst.max((shaft.encoder.speed_rpm() / (sign * rpm) - 1.0).abs());
                }
            }
            assert!(worst <= max, "{counts_per_turn} counts, {rpm} rpm: {worst}");
        }
    }
}

#[test]
fn stopped_spindle_is_standing_even_on_count_edge() {
    let mut shaft = Shaft::new(SETTINGS, 0.0);
    for _ in 0..300 {
        shaft.step(1000.0, MS);
    }
    assert!(!shaft.encoder.is_standing());
    let mut after = 0;
    while !shaft.encoder.is_standing() {
        shaft.step(0.0, MS);
        after += 1;
    }
    assert!(after <= 40, "{after} ms");
    for period in 0..400 {
        // To and fro by a count.
        let rpm = if period % 2 == 0 { 10.0 } else { -10.0 };
        shaft.step(rpm, MS);
        assert!(period < 120 || shaft.encoder.is_standing(), "{period}");
    }
}

#[test]
fn fine_encoder_noise_is_no_motion_slow_turn_is() {
    let fine = SpindleEncoderSettings {
        counter_bits: 32,
        counts_per_turn: 1 << 20,
        index: SpindleIndex::None,
        ..SETTINGS
    };
    let mut random = Random::new();
    let mut encoder = SpindleEncoder::new(fine);
    for ms in 0..2000 {
        encoder.read((1000.0 + random.between(-2.0, 2.0)) as u32, ms * MS);
        assert!(encoder.is_standing(), "{ms} ms: {} rpm", encoder.speed_rpm());
    }
    let mut shaft = Shaft::new(fine, 0.0);
    for _ in 0..200 {
        shaft.step(2.0, MS);
    }
    assert!(!shaft.encoder.is_standing());
}

#[test]
fn any_number_of_lost_counts_is_a_fault_until_reset() {
    let mut random = Random::new();
    for _ in 0..200 {
        let mut shaft = Shaft::new(SETTINGS, random.between(-3.0, 3.0));
        let sign = if random.bits().is_multiple_of(2) {
            1.0
        } else {
            -1.0
        };
        let rpm = sign * random.between(50.0, 3000.0);
        let turn = (60_000.0 / rpm.abs()) as u64 + 3;
        for _ in 0..2 * turn {
            shaft.step(rpm, MS);
        }
        assert_eq!(shaft.encoder.fault(), None);
        let lost = [-1, 1][random.bits() as usize % 2] * random.between(10.0, 2000.0) as i64;
        shaft.lost += lost;
        for _ in 0..turn {
            shaft.step(rpm, MS);
        }
        let Some(SpindleEncoderFault::LostCounts { counts }) = shaft.encoder.fault() else {
            panic!("{:?}", shaft.encoder.fault());
        };
        assert!((counts - lost).abs() <= 1, "{counts} of {lost}");
        let flags = shaft.encoder.feedback(&SpindleConditions::default()).flags;
        assert_ne!(flags & spindle_flags::FAULT, 0);
        shaft.encoder.reset();
        assert!(!shaft.encoder.is_indexed());
        shaft.first_pulse = None;
        for _ in 0..2 * turn {
            shaft.step(rpm, MS);
        }
        assert!(shaft.encoder.is_indexed() && shaft.encoder.fault().is_none());
        assert!(shaft.error_counts().abs() < 1.6 + lost.abs() as f64);
    }
}

#[test]
fn missing_index_is_a_fault_after_two_turns() {
    for seen_before in [true, false] {
        let mut shaft = Shaft::new(SETTINGS, 0.5);
        shaft.has_index = seen_before;
        for _ in 0..if seen_before { 300 } else { 80 } {
            shaft.step(600.0, MS);
        }
        assert_eq!(shaft.encoder.fault(), None);
        shaft.has_index = false;
        let mut turned = 0.0;
        while shaft.encoder.fault().is_none() {
            shaft.step(600.0, MS);
            turned += 0.01;
            assert!(turned < 2.1, "no fault");
        }
        assert!(matches!(
            shaft.encoder.fault(),
            Some(SpindleEncoderFault::IndexMissing { .. })
        ));
        assert!(turned > 1.0, "{turned} turns");
        // To and fro within a turn is none.
        shaft.encoder.reset();
        for period in 0..1000 {
            let rpm = if period % 100 < 50 { 600.0 } else { -600.0 };
            shaft.step(rpm, MS);
        }
        assert_eq!(shaft.encoder.fault(), None);
    }
}

#[test]
fn speed_is_reached_by_tolerance_and_drive_input() {
    let mut shaft = Shaft::new(SETTINGS, 0.0);
    for _ in 0..300 {
        shaft.step(-990.0, MS);
    }
    let reached = |direction, rpm, at_speed_input| {
        let message = shaft.encoder.feedback(&SpindleConditions {
            direction,
            rpm,
            at_speed_input,
            outputs_sequence: 5,
            spindle: 2,
            ..SpindleConditions::default()
        });
        assert_eq!((message.outputs_sequence, message.spindle), (5, 2));
        assert!(message.is_valid());
        message.flags & spindle_flags::AT_SPEED != 0
    };
    assert!(reached(2, 1000.0, None) && reached(2, 1000.0, Some(true)));
    assert!(!reached(2, 1000.0, Some(false)));
    assert!(!reached(2, 1020.0, None) && !reached(1, 1000.0, None));
    assert!(!reached(0, 0.0, None) && !reached(3, 0.0, None));
}
