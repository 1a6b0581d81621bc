//! What a cycle takes in and gives out.

use evolvent_machine::LoadSample;
use evolvent_path::Axes;
use evolvent_signals::{OverrideSwitches, ProbeInput, SpindleInput};

use crate::State;

/// What comes in from outside, sampled once a cycle. Recorded where it changes, so that a run can be computed
/// again.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inputs {
    /// Feed override, 1 at 100 %; taken as at most 2. Below 0.001, and not a number, counts as 0.
    pub feed_override: f64,
    /// Feed hold: decelerate and stay at rest while this is set.
    pub hold: bool,
    /// Decelerate and end the run. Once set it stays in force.
    pub stop: bool,
    /// Go on after a program stop. Must be seen unset before the next program stop counts it again.
    pub resume: bool,
    /// The newest reading of the cutting load, the same again where there is no newer one: what process
    /// cycles go by.
    pub load: Option<LoadSample>,
    /// The probe: what probing moves go by.
    pub probe: ProbeInput,
    /// The spindle when this setpoint is due: what threading goes by.
    pub spindle: SpindleInput,
}

impl Default for Inputs {
    fn default() -> Self {
        Self {
            feed_override: 1.0,
            hold: false,
            stop: false,
            resume: false,
            load: None,
            probe: ProbeInput::default(),
            spindle: SpindleInput::default(),
        }
    }
}

impl Inputs {
    /// As a program lets them count: without feed override it is 1, and a hold waits. A stop always counts.
    #[must_use]
    pub fn switched_by(mut self, switches: &OverrideSwitches) -> Self {
        if !switches.feed {
            self.feed_override = 1.0;
        }
        self.hold &= switches.feed_stop;
        self
    }
}

/// The state of the axes at one instant, and where on the path that is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setpoint {
    /// Index of the cycle, from 0.
    pub sequence: u64,
    /// Position, mm or degrees.
    pub position: Axes,
    /// Velocity per s.
    pub velocity: Axes,
    /// Acceleration per s2.
    pub acceleration: Axes,
    /// Jerk per s3.
    pub jerk: Axes,
    /// Programmed path travelled, mm (degrees while only rotary axes move).
    pub path_mm: f64,
    /// Speed along the path in the feed metric, mm/s (degrees/s while only rotary axes move).
    pub feed_mm_s: f64,
    /// Feed override that is wanted: a time-optimal plan follows a lower one at once, a higher one a lead
    /// time later.
    pub feed_override: f64,
    /// Program line.
    pub line: u32,
    /// Index of the block in the order of execution.
    pub block: u32,
    /// What the cycle is doing.
    pub state: State,
    /// Bits of [`crate::flags`].
    pub flags: u32,
    /// Number of actions for the periphery that have taken effect so far (M3, M6, M8 ...).
    pub actions: u32,
}
