//! What the judge found.

use std::fmt;

use evolvent_path::AxisLetter;
use serde::Serialize;

/// The worst of one kind, and where.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Worst {
    /// The value: a ratio to what is allowed, or mm or degrees where its field says so.
    pub value: f64,
    /// Setpoint, from 0.
    pub setpoint: u64,
    /// Program line.
    pub line: u32,
    /// Index of the axis in X Y Z A B C U V W, where one axis is meant.
    pub axis: usize,
}

impl Worst {
    pub(crate) fn see(&mut self, value: f64, setpoint: u64, line: u32, axis: usize) {
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

/// The worst of everything over a whole motion.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Verdict {
    /// Setpoints seen.
    pub setpoints: u64,
    /// Their time, s.
    pub duration_s: f64,
    /// Blocks of the program.
    pub blocks: usize,
    /// Programmed length, mm (degrees where only rotary axes move).
    pub path_mm: f64,
    /// First, second and third differences against each axis's limits: ratios.
    pub velocity: Worst,
    /// See `velocity`.
    pub acceleration: Worst,
    /// See `velocity`; away from joints of exact-path mode.
    pub jerk: Worst,
    /// At tangent joints of exact-path mode, where curvature steps: change of acceleration over a period
    /// against jerk times the machine's joint time and the period.
    pub joint: Worst,
    /// Distance of setpoints from the program, mm of XYZ or UVW.
    pub deviation_mm: Worst,
    /// Distance of setpoints from the program, degrees of the worst rotary axis.
    pub deviation_deg: Worst,
    /// The same over the tolerance there.
    pub deviation: Worst,
    /// Distance of points on the chords between setpoints from the program, mm or degrees.
    pub between_mm: Worst,
    /// The same over tolerance and permitted chord error together.
    pub between: Worst,
    /// Chords against the curve through the setpoints, over the permitted chord error.
    pub chord: Worst,
    /// Speed over the greatest feed of the blocks about the setpoint.
    pub feed: Worst,
    /// Beyond the travel of an axis, mm or degrees.
    pub travel: Worst,
    /// Setpoints at which the program could not be followed in its order.
    pub lost: u64,
    /// The first of them, and the line that was looked for.
    pub first_lost: Option<(u64, u32)>,
    /// Setpoints that are no numbers.
    pub unreadable: u64,
    /// Blocks whose end the motion did not come near, or that it did not finish.
    pub missed: usize,
    /// Line of the first of them.
    pub first_missed: Option<u32>,
    /// Greatest distance of the end of a block from the motion, mm or degrees: what corners are cut by.
    pub reverse: Worst,
    /// Distance of the nearest setpoint from places where the program rests, mm or degrees.
    pub rest: Worst,
    /// Distance of the last setpoint from the program's end, mm or degrees.
    pub end: f64,
    /// Distance of the first setpoint from the program's start, less one period at the greatest jerk, mm or
    /// degrees.
    pub start: f64,
}

/// What may be exceeded, and by how much.
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
    /// Ratio of the chord error to what is permitted.
    pub chord: f64,
    /// Ratio of the speed to the programmed feed.
    pub feed: f64,
    /// Distance of ends, rests and travel, mm or degrees.
    pub place: f64,
}

impl Default for Allowances {
    /// 0.1 % of velocity and acceleration, 2 % of jerk (third differences of a motion with jerk just at its
    /// limit), none of the tolerance, 1 % of the chord error (read from a cubic), 0.1 % of the feed, a
    /// nanometre of place.
    fn default() -> Self {
        Self {
            velocity: 1.001,
            acceleration: 1.001,
            jerk: 1.02,
            deviation: 1.000_001,
            chord: 1.01,
            feed: 1.001,
            place: 1e-6,
        }
    }
}

/// What can be wrong with a motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// An axis is too fast.
    Velocity,
    /// An axis accelerates too much.
    Acceleration,
    /// An axis jerks too much.
    Jerk,
    /// A step of curvature is taken too fast.
    Joint,
    /// Setpoints are too far from the program.
    Deviation,
    /// Chords between setpoints are too far from the program.
    Between,
    /// Chords are too far from the curve through the setpoints.
    Chord,
    /// Faster than the feed word.
    Feed,
    /// Beyond an axis's travel.
    Travel,
    /// Not the program's order.
    Order,
    /// Parts of the program were left out.
    Missed,
    /// A place of rest was not reached.
    Rest,
    /// The start is elsewhere.
    Start,
    /// The end is elsewhere.
    End,
    /// Setpoints that are no numbers.
    Unreadable,
}

/// One thing that is not allowed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Violation {
    /// What.
    pub kind: Kind,
    /// How much: the ratio to what is allowed, mm or degrees, or a count.
    pub value: f64,
    /// Program line, 0 where none is meant.
    pub line: u32,
    /// Setpoint, from 0.
    pub setpoint: u64,
    /// The axis, where one is meant.
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
    /// Everything that is not allowed, in the order of [`Kind`].
    #[must_use]
    pub fn violations(&self, allow: &Allowances) -> Vec<Violation> {
        let mut list = Vec::new();
        let mut compare = |kind, worst: &Worst, most: f64, one_axis: bool| {
            // Written so that NaN is a violation.
            if !(worst.value <= most) {
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
        let place = |value: f64, setpoint: u64| Worst {
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
        compare(Kind::Travel, &self.travel, allow.place, true);
        compare(Kind::Order, &count(self.lost, lost_line, lost_at), 0.0, false);
        let missed = count(self.missed as u64, self.first_missed.unwrap_or(0), 0);
        compare(Kind::Missed, &missed, 0.0, false);
        compare(Kind::Rest, &self.rest, allow.place, false);
        compare(Kind::Start, &place(self.start, 0), allow.place, false);
        compare(Kind::End, &place(self.end, self.setpoints), allow.place, false);
        compare(Kind::Unreadable, &count(self.unreadable, 0, 0), 0.0, false);
        list
    }
}
