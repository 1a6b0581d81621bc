//! Feedback at entry: random bits in every field, judged by the contract.

use evolvent_drive::{DriveAlarm, FeedbackBounds};
use evolvent_path::AxisMask;
use evolvent_random::Random;
use evolvent_wire::{AXES, BRIDGE_STATES, Feedback};

const NOW_NS: u64 = 5_000_000_000_000;
const TRAVEL: [f64; 2] = [-400.0, 100.0];
const MAX_VELOCITY: f64 = 500.0;

fn bounds() -> FeedbackBounds {
    let mut bounds = FeedbackBounds::new(AxisMask::from_bits(0b111));
    for axis in 0..3 {
        bounds.set_axis(axis, TRAVEL, MAX_VELOCITY);
    }
    bounds
}

fn good() -> Feedback {
    Feedback {
        sequence: 7,
        time_ns: NOW_NS - 400_000,
        axes_mask: 0b111,
        status_word: [0x0237; AXES],
        bridge_state: 1,
        instance: 1,
        ..Feedback::default()
    }
}

/// Numbers of any magnitude.
trait AnyMagnitude {
    fn whole(&mut self) -> u64;
    fn real(&mut self) -> f64;
}

impl AnyMagnitude for Random {
    /// Of any magnitude: small numbers are as likely as large ones.
    fn whole(&mut self) -> u64 {
        let shift = self.bits() % 64;
        self.bits() >> shift
    }

    /// Any bit pattern, or a plausible number.
    fn real(&mut self) -> f64 {
        match self.bits() % 3 {
            0 => f64::from_bits(self.bits()),
            1 => (self.bits() as f64 / u64::MAX as f64 - 0.5) * 4000.0,
            _ => (self.bits() as f64 / u64::MAX as f64 - 0.5) * 20.0,
        }
    }
}

/// The contract of the fields, independent of the code.
fn can_be_true(feedback: &Feedback) -> bool {
    let axes: Vec<usize> = (0..3)
        .filter(|axis| feedback.axes_mask & (1 << axis) > 0)
        .collect();
    let masks = feedback.axes_mask
        | feedback.home_switch_mask
        | feedback.positive_limit_mask
        | feedback.negative_limit_mask
        | feedback.absolute_mask;
    let second = 1_000_000_000;
    feedback.time_ns <= NOW_NS + 20_000_000
        && masks <= 0b1_1111_1111
        && (feedback.bridge_state as usize) < BRIDGE_STATES.len()
        && feedback.datum < 1 << 32
        && feedback.error_code < 1 << 16
        && (-second..=second).contains(&feedback.phase_error_ns)
        && (feedback.index_position.is_nan() || (-1400.0..=1400.0).contains(&feedback.index_position))
        && axes.into_iter().all(|axis| {
            // 400 is the farthest end of the travel, which is 500 long.
            (-1400.0..=1400.0).contains(&feedback.position[axis])
                && (-5000.0..=5000.0).contains(&feedback.velocity[axis])
                && (-2800.0..=2800.0).contains(&feedback.following_error[axis])
                && (-100.0..=100.0).contains(&feedback.torque_ratio[axis])
                && feedback.status_word[axis] < 1 << 16
        })
}

#[test]
fn feedback_is_accepted_if_every_field_is_possible() {
    let (bounds, mut random) = (bounds(), Random::new());
    assert_eq!(bounds.check(NOW_NS, &good()), Ok(()));
    let mut counts = [0, 0];
    for _ in 0..200_000 {
        let mut feedback = good();
        let axis = (random.bits() % AXES as u64) as usize;
        for _ in 0..=random.bits() % 3 {
            match random.bits() % 19 {
                0 => feedback.time_ns = random.whole(),
                1 => feedback.position[axis] = random.real(),
                2 => feedback.velocity[axis] = random.real(),
                3 => feedback.following_error[axis] = random.real(),
                4 => feedback.torque_ratio[axis] = random.real(),
                5 => feedback.phase_error_ns = random.whole().cast_signed(),
                6 => feedback.status_word[axis] = random.whole() as u32,
                7 => feedback.axes_mask = random.whole() as u32,
                8 => feedback.home_switch_mask = random.whole() as u32,
                9 => feedback.positive_limit_mask = random.whole() as u32,
                10 => feedback.negative_limit_mask = random.whole() as u32,
                11 => feedback.absolute_mask = random.whole() as u32,
                12 => feedback.bridge_state = random.whole() as u32,
                13 => feedback.error_code = random.whole() as u32,
                14 => feedback.datum = random.whole(),
                15 => feedback.time_ns = NOW_NS + random.whole() % 40_000_000,
                // These may have any value: they are shown, or compared with what was sent.
                17 => feedback.index_position = random.real(),
                16 => (feedback.sequence, feedback.instance) = (random.whole(), random.whole()),
                _ => {
                    (feedback.note, feedback.missed_setpoints) = (random.bits() as u32, random.bits() as u32);
                }
            }
        }
        let believed = bounds.check(NOW_NS, &feedback);
        assert_eq!(
            believed.is_ok(),
            can_be_true(&feedback),
            "{believed:?} {feedback:?}"
        );
        counts[usize::from(believed.is_ok())] += 1;
    }
    assert!(counts.iter().all(|count| *count > 20_000), "{counts:?}");
}

#[test]
fn what_is_not_believed_is_named_with_value_and_bound() {
    let mut feedback = good();
    feedback.position[1] = 1e308;
    let alarm = bounds().check(NOW_NS, &feedback).expect_err("no axis is there");
    assert!(
        matches!(alarm, DriveAlarm::Unbelievable { axis: Some(1), .. }),
        "{alarm:?}"
    );
    let text = alarm.to_string();
    for part in ["position of axis Y", "1.000000e308", "1.400000e3", "check"] {
        assert!(text.contains(part), "{text}");
    }
}
