//! Results of the judge.

use std::fmt;

use evolvent_path::AxisLetter;
use serde::Serialize;

/// The worst value of one kind, and its position.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Worst {
    /// The value: a ratio to the permitted value, or mm or degrees if the field says so.
    pub value: f64,
    /// Setpoint, from 0.
    pub setpoint: u64,
    /// Program line.
    pub line: u32,
    /// Index of the axis in X Y Z A B C U V W, if the value is of one axis.
    pub axis: usize,
}

impl Worst {
    pub(crate) fn record(&mut self, value: f64, setpoint: u64, line: u32, axis: usize) {
        if value > self.value {
            *self = Self {
                value,
                setpoint,
                line,
                axis,
            };
        }
    }
}

/// The worst values over a whole motion.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Verdict {
    /// Number of setpoints.
    pub setpoints: u64,
    /// Duration of the setpoints, s.
    pub duration_s: f64,
    /// Number of blocks of the program.
    pub blocks: usize,
    /// Programmed length, mm (degrees if only rotary axes move).
    pub path_mm: f64,
    /// First difference of the positions relative to the axis's limit; `acceleration` and `jerk` are the
    /// second and third.
    pub velocity: Worst,
    /// See `velocity`.
    pub acceleration: Worst,
    /// See `velocity`; away from joints of exact-path mode.
    pub jerk: Worst,
    /// At tangent joints of exact-path mode with a step in curvature: change of acceleration over three
    /// periods, relative to the jerk limit times the sum of the machine's joint time and three periods.
    pub joint: Worst,
    /// Distance of setpoints from the program, mm of XYZ or UVW.
    pub deviation_mm: Worst,
    /// Distance of setpoints from the program, degrees of the worst rotary axis.
    pub deviation_deg: Worst,
    /// The same relative to the tolerance.
    pub deviation: Worst,
    /// Distance of points on the chords between setpoints from the program, mm or degrees.
    pub between_mm: Worst,
    /// The same relative to the sum of tolerance and permitted chord error.
    pub between: Worst,
    /// Chord error between setpoints, relative to the permitted one.
    pub chord: Worst,
    /// Speed relative to the greatest feed of the blocks near the setpoint.
    pub feed: Worst,
    /// Distance beyond the travel of an axis, mm or degrees.
    pub travel: Worst,
    /// Number of setpoints at which the program could not be followed in its order.
    pub lost: u64,
    /// The first of them, and the expected line.
    pub first_lost: Option<(u64, u32)>,
    /// Setpoints that are not finite numbers.
    pub unreadable: u64,
    /// Number of blocks whose end the motion did not approach, or that it did not finish.
    pub missed: usize,
    /// Line of the first of them.
    pub first_missed: Option<u32>,
    /// Maximum distance of the end of a block from the motion, mm or degrees: the amount by which corners are
    /// cut.
    pub reverse: Worst,
    /// Distance of the nearest setpoint from points of rest of the program, mm or degrees.
    pub rest: Worst,
    /// Distance of the last setpoint from the program's end, mm or degrees.
    pub end: f64,
    /// Distance of the first setpoint from the program's start, minus the distance of one period at the
    /// maximum jerk, mm or degrees.
    pub start: f64,
}

/// Permitted ratios and distances.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Allowances {
    /// Ratio of velocity to its limit.
    pub velocity: f64,
    /// Ratio of acceleration to its limit.
    pub acceleration: f64,
    /// Ratio of jerk to its limit.
    pub jerk: f64,
    /// Ratio of the deviation to the tolerance.
    pub deviation: f64,
    /// Ratio of the chord error to the permitted one.
    pub chord: f64,
    /// Ratio of the speed to the programmed feed.
    pub feed: f64,
    /// Distance of ends, rests and travel, mm or degrees.
    pub position: f64,
}

impl Default for Allowances {
    /// Excess of 0.1 % in velocity and acceleration, 2 % in jerk (third differences of a motion with jerk at
    /// its limit), none in tolerance, 1 % in chord error (computed with a cubic), 0.1 % in feed, and a
    /// nanometre in position.
    fn default() -> Self {
        Self {
            velocity: 1.001,
            acceleration: 1.001,
            jerk: 1.02,
            deviation: 1.000_001,
            chord: 1.01,
            feed: 1.001,
            position: 1e-6,
        }
    }
}

/// Kinds of violations.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// An axis is too fast.
    Velocity,
    /// An axis accelerates too much.
    Acceleration,
    /// An axis exceeds its jerk limit.
    Jerk,
    /// A step in curvature is passed too fast.
    Joint,
    /// Setpoints are too far from the program.
    Deviation,
    /// Chords between setpoints are too far from the program.
    Between,
    /// Chords are too far from the curve through the setpoints.
    Chord,
    /// The motion is faster than the feed word.
    Feed,
    /// An axis is beyond its travel.
    Travel,
    /// The motion does not follow the program's order.
    Order,
    /// Parts of the program were left out.
    Missed,
    /// A point of rest was not reached.
    Rest,
    /// The motion starts elsewhere.
    Start,
    /// The motion ends elsewhere.
    End,
    /// Setpoints that are not finite numbers.
    Unreadable,
}

/// A violation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Violation {
    /// Kind of the violation.
    pub kind: Kind,
    /// Value: the ratio to the permitted value, mm or degrees, or a count.
    pub value: f64,
    /// Program line, 0 if not applicable.
    pub line: u32,
    /// Setpoint, from 0.
    pub setpoint: u64,
    /// The axis, if the violation is of one axis.
    pub axis: Option<char>,
}

impl fmt::Display for Violation {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (value, line, setpoint) = (self.value, self.line, self.setpoint);
        let of_axis = self.axis.map_or_else(String::new, |axis| format!(" of {axis}"));
        let what = match self.kind {
            Kind::Velocity => format!("velocity{of_axis} {value:.6} times its limit"),
            Kind::Acceleration => format!("acceleration{of_axis} {value:.6} times its limit"),
            Kind::Jerk => format!("jerk{of_axis} {value:.6} times its limit"),
            Kind::Joint => format!("step of acceleration{of_axis} at a joint {value:.6} times its limit"),
            Kind::Deviation => format!("distance from the program {value:.6} times the tolerance"),
            Kind::Between => {
                format!("distance from the program between setpoints {value:.6} times the tolerance")
            }
            Kind::Chord => format!("chord error {value:.6} times what is permitted"),
            Kind::Feed => format!("speed {value:.6} times the feed word"),
            Kind::Travel => format!("{value:.6} mm or degrees beyond the travel{of_axis}"),
            Kind::Order => format!("{value} setpoints do not follow the program"),
            Kind::Missed => {
                return write!(
                    formatter,
                    "{value} ends of moves left out, the first of line {line}"
                );
            }
            Kind::Rest => {
                return write!(
                    formatter,
                    "the stop of line {line} missed by {value:.6} mm or degrees"
                );
            }
            Kind::Start => {
                return write!(
                    formatter,
                    "start {value:.6} mm or degrees from that of the program"
                );
            }
            Kind::End => return write!(formatter, "end {value:.6} mm or degrees from that of the program"),
            Kind::Unreadable => return write!(formatter, "{value} setpoints that are no numbers"),
        };
        write!(formatter, "{what} (line {line}, setpoint {setpoint})")
    }
}

impl Verdict {
    /// All violations, in the order of [`Kind`].
    #[must_use]
    pub fn violations(&self, allow: &Allowances) -> Vec<Violation> {
        let mut list = Vec::new();
        let mut compare = |kind, worst: &Worst, max: f64, one_axis: bool| {
            // Negated so that NaN is a violation.
            if !(worst.value <= max) {
                list.push(Violation {
                    kind,
                    value: worst.value,
                    line: worst.line,
                    setpoint: worst.setpoint,
                    axis: AxisLetter::ALL
                        .get(worst.axis)
                        .filter(|_| one_axis)
                        .map(|axis| axis.letter()),
                });
            }
        };
        let count = |value: u64, line: u32, setpoint: u64| Worst {
            value: value as f64,
            setpoint,
            line,
            axis: 0,
        };
        let at_setpoint = |value: f64, setpoint: u64| Worst {
            value,
            setpoint,
            ..Worst::default()
        };
        let (lost_at, lost_line) = self.first_lost.unwrap_or_default();
        compare(Kind::Velocity, &self.velocity, allow.velocity, true);
        compare(Kind::Acceleration, &self.acceleration, allow.acceleration, true);
        compare(Kind::Jerk, &self.jerk, allow.jerk, true);
        compare(Kind::Joint, &self.joint, allow.jerk, true);
        compare(Kind::Deviation, &self.deviation, allow.deviation, false);
        compare(Kind::Between, &self.between, allow.chord, false);
        compare(Kind::Chord, &self.chord, allow.chord, false);
        compare(Kind::Feed, &self.feed, allow.feed, false);
        compare(Kind::Travel, &self.travel, allow.position, true);
        compare(Kind::Order, &count(self.lost, lost_line, lost_at), 0.0, false);
        let missed = count(self.missed as u64, self.first_missed.unwrap_or(0), 0);
        compare(Kind::Missed, &missed, 0.0, false);
        compare(Kind::Rest, &self.rest, allow.position, false);
        compare(Kind::Start, &at_setpoint(self.start, 0), allow.position, false);
        compare(
            Kind::End,
            &at_setpoint(self.end, self.setpoints),
            allow.position,
            false,
        );
        compare(Kind::Unreadable, &count(self.unreadable, 0, 0), 0.0, false);
        list
    }
}
