//! What a cycle goes by of a spindle's angle.

use crate::spindle_tracker::{AngleJet, HARMONICS};

/// What is known of the angle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SpindleKnowledge {
    /// It is not reported, or has not been for too long.
    #[default]
    Unknown,
    /// Time is not real and it is not reported: the spindle turns as commanded, and its angle is known from
    /// that.
    Imagined,
    /// It is reported, but not for long enough, or the index pulse has not been seen.
    Seeking,
    /// It is known.
    Tracked,
}

/// The motion of a spindle when a setpoint is due, turns and seconds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SpindleInput {
    /// What is known of it. The other fields are 0 if it is unknown or being sought.
    pub knowledge: SpindleKnowledge,
    /// Angle since the index pulse, speed and acceleration of an even spindle.
    pub mean: AngleJet,
    /// What each harmonic of the turn adds to it.
    pub ripple: [AngleJet; HARMONICS],
}
