//! The active limit at a setpoint, derived from the setpoint itself.
//!
//! A value at or above 97 % of its limit is limiting, and the one with the largest ratio decides, so that
//! unused capacity is visible ([`Limiting::Nothing`]). The only value taken from the planner is the fraction
//! of the permitted chord error that it aims at.

use evolvent_machine::{Machine, chord_feed_limit_mm_s};
use evolvent_motion::{MotionState, Setpoint, flags};
use evolvent_path::AxisLetter;

/// Fraction of a limit at which it counts as active.
pub(crate) const REACHED: f64 = 0.97;
/// An axis below this fraction of its velocity limit counts as stationary.
const STANDING: f64 = 1e-9;

/// A derivative of the axis position.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Order {
    /// First.
    Velocity,
    /// Second.
    Acceleration,
    /// Third.
    Jerk,
}

impl Order {
    /// All derivatives, lowest first.
    pub const ALL: [Self; 3] = [Self::Velocity, Self::Acceleration, Self::Jerk];

    /// The name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Velocity => "velocity",
            Self::Acceleration => "acceleration",
            Self::Jerk => "jerk",
        }
    }

    /// "mm/s2" or "deg/s2".
    #[must_use]
    pub const fn unit(self, axis: AxisLetter) -> &'static str {
        match (self, axis.is_rotary()) {
            (Self::Velocity, false) => "mm/s",
            (Self::Acceleration, false) => "mm/s2",
            (Self::Jerk, false) => "mm/s3",
            (Self::Velocity, true) => "deg/s",
            (Self::Acceleration, true) => "deg/s2",
            (Self::Jerk, true) => "deg/s3",
        }
    }
}

/// The active limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Limiting {
    /// The feed word (or the machine's maximum feed) and the override.
    Feed,
    /// The limit of an axis.
    Axis(AxisLetter, Order),
    /// The chord error permitted at this control rate.
    ChordError,
    /// A step of curvature or a slight corner of the exact path.
    Joint,
    /// The axes are stationary: dwell, stop, tool change.
    Standing,
    /// No limit is reached: the planner holds back.
    Nothing,
}

impl Limiting {
    /// Number of values.
    pub const COUNT: usize = 5 + 27;

    /// An index below [`Self::COUNT`].
    #[must_use]
    pub const fn index(self) -> usize {
        match self {
            Self::Feed => 0,
            Self::Axis(axis, order) => 5 + 3 * axis.index() + order as usize,
            Self::ChordError => 1,
            Self::Joint => 2,
            Self::Standing => 3,
            Self::Nothing => 4,
        }
    }

    /// The value with this index.
    #[must_use]
    pub fn of_index(index: usize) -> Self {
        match index {
            0 => Self::Feed,
            1 => Self::ChordError,
            2 => Self::Joint,
            3 => Self::Standing,
            5.. => {
                let axis = AxisLetter::ALL.get((index - 5) / 3);
                axis.map_or(Self::Nothing, |axis| {
                    Self::Axis(*axis, Order::ALL[(index - 5) % 3])
                })
            }
            4 => Self::Nothing,
        }
    }

    /// In words.
    #[must_use]
    pub fn name(self) -> String {
        match self {
            Self::Feed => "feed word".to_owned(),
            Self::Axis(axis, order) => format!("{} {}", axis.letter(), order.name()),
            Self::ChordError => "chord error".to_owned(),
            Self::Joint => "joint (exact path)".to_owned(),
            Self::Standing => "standing still".to_owned(),
            Self::Nothing => "none reached".to_owned(),
        }
    }
}

/// The utilization of every limit at a setpoint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LimitRatios {
    /// Path speed relative to the feed word; 0 without one.
    pub feed_ratio: f64,
    /// Path speed relative to the speed at which the chord error is what the planner aims at
    /// ([`chord_fraction`](evolvent_machine::PlannerKind::chord_fraction) of the permitted one); 0 on
    /// straight paths.
    pub chord_ratio: f64,
    /// Velocity, acceleration and jerk of each axis relative to their limits.
    pub axes: [[f64; 3]; 9],
}

/// Finds the active limit.
#[derive(Clone, Debug)]
pub struct LimitClassifier {
    /// Reciprocal limits; 0 for axes that the machine does not have.
    inverse: [[f64; 3]; 9],
    rate_hz: f64,
    increments_per_mm: f64,
    /// The chord error that the planner aims at.
    chord_error_increments: f64,
}

impl LimitClassifier {
    /// A classifier for a machine with its planner and a control period, s.
    #[must_use]
    pub fn new(machine: &Machine, period_s: f64) -> Self {
        let mut inverse = [[0.0; 3]; 9];
        for axis in &machine.axes {
            inverse[axis.letter.index()] = [
                1.0 / axis.max_velocity,
                1.0 / axis.max_acceleration,
                1.0 / axis.max_jerk,
            ];
        }
        Self {
            inverse,
            rate_hz: 1.0 / period_s,
            increments_per_mm: machine.increments_per_mm,
            chord_error_increments: machine.path.planner.chord_fraction()
                * machine.path.chord_error_increments,
        }
    }

    /// The utilization of every limit. `feed_mm_s` is the feed word before override; `None` on rapids.
    #[must_use]
    pub fn ratios(&self, setpoint: &Setpoint, feed_mm_s: Option<f64>) -> LimitRatios {
        let mut axes = [[0.0; 3]; 9];
        for (i, inverse) in self.inverse.iter().enumerate() {
            axes[i] = [
                setpoint.velocity[i].abs() * inverse[0],
                setpoint.acceleration[i].abs() * inverse[1],
                setpoint.jerk[i].abs() * inverse[2],
            ];
        }
        let feed = feed_mm_s.map_or(0.0, |word| setpoint.feed_mm_s / (word * setpoint.feed_override));
        let (speed, curvature) = bend(setpoint);
        let permitted = chord_feed_limit_mm_s(
            self.rate_hz,
            curvature,
            self.increments_per_mm,
            self.chord_error_increments,
        );
        let chord = if permitted.is_finite() && permitted > 0.0 {
            speed / permitted
        } else {
            0.0
        };
        LimitRatios {
            feed_ratio: if feed.is_finite() { feed } else { 0.0 },
            chord_ratio: chord,
            axes,
        }
    }

    /// The active limit at this setpoint: the feed word first, then the limit with the largest ratio.
    #[must_use]
    pub fn classify(&self, setpoint: &Setpoint, feed_mm_s: Option<f64>) -> Limiting {
        self.judge(setpoint, &self.ratios(setpoint, feed_mm_s))
    }

    /// Like [`Self::classify`], for known ratios.
    #[must_use]
    pub fn judge(&self, setpoint: &Setpoint, ratios: &LimitRatios) -> Limiting {
        let still = ratios
            .axes
            .iter()
            .all(|axis| axis[0] <= STANDING && axis[1] <= STANDING);
        if still
            || matches!(
                setpoint.state,
                MotionState::Dwell | MotionState::ProgramStop | MotionState::Held
            )
        {
            return Limiting::Standing;
        }
        if ratios.feed_ratio >= REACHED {
            return Limiting::Feed;
        }
        // At a joint, the jerk is bounded only by the joint rule: whatever its value, the joint is the cause.
        if setpoint.flags & flags::JOINT != 0 {
            return Limiting::Joint;
        }
        let (mut found, mut highest) = (Limiting::Nothing, REACHED);
        if ratios.chord_ratio >= highest {
            (found, highest) = (Limiting::ChordError, ratios.chord_ratio);
        }
        for (axis, ratios) in AxisLetter::ALL.iter().zip(&ratios.axes) {
            for (order, &fraction) in Order::ALL.iter().zip(ratios) {
                if fraction >= highest {
                    (found, highest) = (Limiting::Axis(*axis, *order), fraction);
                }
            }
        }
        found
    }
}

/// Speed, mm/s, and curvature, 1/mm, of the path of X, Y and Z.
pub(crate) fn bend(setpoint: &Setpoint) -> (f64, f64) {
    let (v, a) = (&setpoint.velocity, &setpoint.acceleration);
    let cross = [
        v[1] * a[2] - v[2] * a[1],
        v[2] * a[0] - v[0] * a[2],
        v[0] * a[1] - v[1] * a[0],
    ];
    let speed = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
    let bend = (cross[0] * cross[0] + cross[1] * cross[1] + cross[2] * cross[2]).sqrt();
    if speed > 0.0 && bend > 0.0 {
        (speed, bend / (speed * speed * speed))
    } else {
        (speed, 0.0)
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use evolvent_machine::PlannerKind;
    use evolvent_path::Axes;

    use super::*;

    /// X and Y: 500 mm/s, 5000 mm/s2, 200 000 mm/s3; Z: 333.3 mm/s, 3000 mm/s2, 100 000 mm/s3; 1 um at
    /// 1000/mm.
    pub(crate) fn mill() -> Machine {
        let text = include_str!("../../../../config/machines/mill-3axis.toml");
        Machine::parse(text, "mill-3axis.toml").unwrap()
    }

    pub(crate) fn moving(velocity: [f64; 3], acceleration: [f64; 3], jerk: [f64; 3]) -> Setpoint {
        let axes = |values: [f64; 3]| {
            let mut axes = Axes::zeros();
            axes.fixed_rows_mut::<3>(0).copy_from_slice(&values);
            axes
        };
        let speed = velocity.iter().map(|v| v * v).sum::<f64>().sqrt();
        Setpoint {
            sequence: 0,
            position: Axes::zeros(),
            velocity: axes(velocity),
            acceleration: axes(acceleration),
            jerk: axes(jerk),
            path_mm: 0.0,
            feed_mm_s: speed,
            feed_override: 1.0,
            line: 1,
            block: 0,
            state: MotionState::Running,
            flags: 0,
            actions: 0,
        }
    }

    fn limiting(setpoint: &Setpoint, feed: Option<f64>) -> Limiting {
        LimitClassifier::new(&mill(), 0.001).classify(setpoint, feed)
    }

    #[test]
    fn numbers_and_names_belong_to_one_cause_each() {
        let all: Vec<Limiting> = (0..Limiting::COUNT).map(Limiting::of_index).collect();
        for (index, limiting) in all.iter().enumerate() {
            assert_eq!(limiting.index(), index);
            let twins = all.iter().filter(|other| other.name() == limiting.name()).count();
            assert_eq!(twins, 1, "{}", limiting.name());
        }
        assert_eq!(Limiting::of_index(Limiting::COUNT), Limiting::Nothing);
    }

    #[test]
    fn feed_word_takes_precedence_over_an_axis_limit() {
        let fast = moving([500.0, 0.0, 0.0], [0.0; 3], [0.0; 3]);
        assert_eq!(limiting(&fast, Some(500.0)), Limiting::Feed);
        // The same on a rapid, which has no feed word.
        let velocity = Limiting::Axis(AxisLetter::X, Order::Velocity);
        assert_eq!(limiting(&fast, None), velocity);
        assert_eq!(limiting(&fast, Some(600.0)), velocity);
    }

    #[test]
    fn the_feed_word_is_scaled_by_the_override() {
        let mut slow = moving([49.0, 0.0, 0.0], [0.0; 3], [0.0; 3]);
        assert_eq!(limiting(&slow, Some(100.0)), Limiting::Nothing);
        slow.feed_override = 0.5;
        assert_eq!(limiting(&slow, Some(100.0)), Limiting::Feed);
    }

    #[test]
    fn the_axis_nearest_to_its_limit_wins() {
        // Y brakes with 99 % of its acceleration, Z has 98 % of its jerk.
        let braking = moving([100.0, 100.0, 0.0], [0.0, -4950.0, 0.0], [0.0, 0.0, 98_000.0]);
        assert_eq!(
            limiting(&braking, Some(1000.0)),
            Limiting::Axis(AxisLetter::Y, Order::Acceleration)
        );
        let jerky = moving([100.0, 100.0, 0.0], [0.0, -4850.0, 0.0], [0.0, 0.0, -99_000.0]);
        assert_eq!(
            limiting(&jerky, Some(1000.0)),
            Limiting::Axis(AxisLetter::Z, Order::Jerk)
        );
        // Just below 97 % of everything.
        let easy = moving([480.0, 0.0, 0.0], [4800.0, 0.0, 0.0], [190_000.0, 0.0, 0.0]);
        assert_eq!(limiting(&easy, Some(1000.0)), Limiting::Nothing);
    }

    #[test]
    fn chord_error_limits_at_the_permitted_sagitta() {
        // Geometry: on radius R a chord of v/f misses by R - sqrt(R^2 - (v/2f)^2); 1 um is permitted.
        for (radius, planner) in [
            (1.0_f64, PlannerKind::Optimal),
            (20.0, PlannerKind::Optimal),
            (20.0, PlannerKind::Classic),
            (300.0, PlannerKind::Classic),
        ] {
            let inner = radius - 1e-3 * planner.chord_fraction();
            let half = (radius * radius - inner * inner).sqrt();
            let speed = 2.0 * half * 1000.0;
            let on_circle =
                |speed: f64| moving([speed, 0.0, 0.0], [0.0, speed * speed / radius, 0.0], [0.0; 3]);
            // A machine without any other limit.
            let mut machine = mill();
            machine.path.planner = planner;
            for axis in &mut machine.axes {
                (axis.max_velocity, axis.max_acceleration, axis.max_jerk) = (1e9, 1e12, 1e15);
            }
            let classifier = LimitClassifier::new(&machine, 0.001);
            let ratios = classifier.ratios(&on_circle(speed), None);
            assert!(
                (ratios.chord_ratio - 1.0).abs() < 1e-9,
                "R {radius}: {}",
                ratios.chord_ratio
            );
            assert_eq!(classifier.classify(&on_circle(speed), None), Limiting::ChordError);
            assert_eq!(
                classifier.classify(&on_circle(0.96 * speed), None),
                Limiting::Nothing
            );
        }
    }

    #[test]
    fn joints_and_rests_are_named_as_such() {
        let mut joint = moving([10.0, 0.0, 0.0], [0.0; 3], [400_000.0, 0.0, 0.0]);
        joint.flags = flags::JOINT;
        assert_eq!(limiting(&joint, Some(100.0)), Limiting::Joint);
        assert_eq!(limiting(&joint, Some(10.0)), Limiting::Feed);
        let mut rest = moving([0.0; 3], [0.0; 3], [0.0; 3]);
        assert_eq!(limiting(&rest, Some(100.0)), Limiting::Standing);
        rest.state = MotionState::Dwell;
        assert_eq!(limiting(&rest, None), Limiting::Standing);
    }

    #[test]
    fn first_setpoint_from_rest_is_limited_by_jerk() {
        let start = moving([1e-4, 0.0, 0.0], [0.2, 0.0, 0.0], [200_000.0, 0.0, 0.0]);
        assert_eq!(
            limiting(&start, Some(100.0)),
            Limiting::Axis(AxisLetter::X, Order::Jerk)
        );
    }
}
