//! Inputs and output of a cycle.

use evolvent_machine::LoadSample;
use evolvent_path::Axes;
use evolvent_signals::{OverrideSwitches, ProbeInput, SpindleInput};

use crate::MotionState;

/// Inputs from outside, sampled once per cycle. Changes are recorded, so that a run can be recomputed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inputs {
    /// Feed override, 1 at 100 %, limited to 2. Values below 0.001 and NaN count as 0.
    pub feed_override: f64,
    /// Feed hold: decelerate and stay at rest while this is set.
    pub hold: bool,
    /// Decelerate and end the run. Once set it stays in force.
    pub stop: bool,
    /// Continue after a program stop. It must be seen unset before it applies to the next program stop.
    pub resume: bool,
    /// The newest reading of the cutting load, repeated if there is no newer one; for process cycles.
    pub load: Option<LoadSample>,
    /// The probe; for probing moves.
    pub probe: ProbeInput,
    /// The spindle when this setpoint is due; for threading.
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
    /// The inputs as enabled by a program: without feed override it is 1, and a hold waits. A stop is always
    /// enabled.
    #[must_use]
    pub fn switched_by(mut self, switches: &OverrideSwitches) -> Self {
        if !switches.feed {
            self.feed_override = 1.0;
        }
        self.hold &= switches.feed_stop;
        self
    }
}

/// The state of the axes at one instant, and their position on the path.
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
    /// Requested feed override. A time-optimal plan follows a lower one at once and a higher one a lead
    /// later.
    pub feed_override: f64,
    /// Program line.
    pub line: u32,
    /// Index of the block in the order of execution.
    pub block: u32,
    /// State of the cycle.
    pub state: MotionState,
    /// Bits of [`crate::flags`].
    pub flags: u32,
    /// Number of actions for the periphery that have taken effect so far (M3, M6, M8 ...).
    pub actions: u32,
}
