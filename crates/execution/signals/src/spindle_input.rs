//! The angle of a spindle, as one cycle uses it.

use crate::spindle_tracker::{AngleJet, HARMONICS};

/// What is known of the angle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SpindleKnowledge {
    /// It is not reported, or the last report is too old.
    #[default]
    Unknown,
    /// With the virtual clock it is not reported: the spindle turns as commanded, which gives its angle.
    Imagined,
    /// It is reported, but for too short a time, or the index pulse has not been seen.
    Seeking,
    /// It is known.
    Tracked,
}

/// The motion of a spindle when a setpoint is due, turns and seconds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SpindleInput {
    /// What is known of it. The other fields are 0 if it is unknown or being sought.
    pub knowledge: SpindleKnowledge,
    /// Age of the newest sample when it is used, s: beyond the time from the computation of the setpoint until
    /// it is due. 0 if the angle is imagined.
    pub age_s: f64,
    /// Angle since the index pulse, speed and acceleration, without the periodic deviation.
    pub mean: AngleJet,
    /// The contribution of each harmonic of one turn.
    pub ripple: [AngleJet; HARMONICS],
}
