//! Messages to the core: the drives' feedback and the cutting load.

use crate::layout::{AXES, payload};

payload! {
    /// A drive bridge's reply to one setpoint.
    pub struct Feedback = "evolvent.Feedback.v1" {
        /// The setpoint that it replies to.
        sequence: u64,
        /// When the positions were sampled, in ns of CLOCK_MONOTONIC.
        time_ns: u64,
        /// Actual position in machine coordinates: mm, degrees for A B C.
        position: [f64; AXES],
        /// Actual velocity: mm/s, degrees/s for A B C.
        velocity: [f64; AXES],
        /// Demanded minus actual position: mm, degrees for A B C.
        following_error: [f64; AXES],
        /// Torque or force as a ratio of the drive's rated value.
        torque_ratio: [f64; AXES],
        /// Time of the bus clock minus time of the setpoint, in ns: positive if the drives run late.
        phase_error_ns: i64,
        /// CiA 402 status word (object 6041h) per axis.
        status_word: [u32; AXES],
        /// Bit i set: the values of axis i are valid.
        axes_mask: u32,
        /// Bit i set: the home switch of axis i is actuated.
        home_switch_mask: u32,
        /// Bit i set: the limit switch at the positive end of axis i is actuated.
        positive_limit_mask: u32,
        /// Bit i set: the limit switch at the negative end of axis i is actuated.
        negative_limit_mask: u32,
        /// State of the bridge, a number of the list of bridge states.
        bridge_state: u32,
        /// The last problem with setpoints, a number of the list of notes.
        note: u32,
        /// CiA 402 error code (object 603Fh) of the first axis in fault; 0 if none.
        error_code: u32,
        /// The last `fault_reset` of the setpoints that was executed.
        fault_reset_done: u32,
        /// Setpoints that were missing, late or rejected since the start of the bridge.
        missed_setpoints: u32,
        /// The setpoints' `datum` that the positions refer to.
        datum: u64,
        /// Differs at every start of the bridge.
        instance: u64,
        /// Bit i set: positions of axis i refer to machine zero after every start of bridge or drive.
        absolute_mask: u32,
        /// The setpoints' `index_request` that was taken over last; a bridge that latches no index pulses leaves it 0.
        index_request: u32,
        /// Position of its axis at the index pulse, by the names of `datum`; not a number until the pulse has come.
        index_position: f64,
    }
}

/// Names and numbers of `bridge_state`.
pub const BRIDGE_STATES: [(&str, u32); 6] = [
    ("WAITING", 0),
    ("FOLLOWING", 1),
    ("BRIDGING", 2),
    ("BRAKING", 3),
    ("HOLDING", 4),
    ("OFF", 5),
];

/// Names and numbers of `note`.
pub const BRIDGE_NOTES: [(&str, u32); 8] = [
    ("NONE", 0),
    ("GAP", 1),
    ("SILENCE", 2),
    ("LATE", 3),
    ("JUMP", 4),
    ("RESTART", 5),
    ("NOT_FINITE", 6),
    ("VERSION", 7),
];

impl Feedback {
    /// Whether every value of the valid axes is finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        (0..AXES)
            .filter(|axis| self.axes_mask >> axis & 1 == 1)
            .all(|axis| {
                self.position[axis].is_finite()
                    && self.velocity[axis].is_finite()
                    && self.following_error[axis].is_finite()
                    && self.torque_ratio[axis].is_finite()
            })
    }
}

payload! {
    /// A measured cutting load, from a drive or a sensor.
    pub struct Load = "evolvent.Load.v1" {
        /// Grows by one with every value of the same sensor.
        sequence: u64,
        /// When the load was sampled, in ns of CLOCK_MONOTONIC.
        time_ns: u64,
        /// Kind of `value`, a number of the list of load kinds.
        kind: u32,
        /// Where it was measured: 0 to 8 an axis, 9 the spindle, 16 and above user-defined sensors.
        source: u32,
        /// The load in the unit of its kind.
        value: f64,
        /// The lowest value that the sensor can report.
        range_min: f64,
        /// The highest value that the sensor can report.
        range_max: f64,
        /// Zero; for later versions.
        reserved: [u64; 4],
    }
}

impl Load {
    /// Whether the numbers are finite, the range is valid and contains the value, and the kind is known.
    #[must_use]
    pub fn is_valid(&self) -> bool {
        LOAD_KINDS.iter().any(|&(_, number)| number == self.kind)
            && self.range_min.is_finite()
            && self.range_max.is_finite()
            && (self.range_min..=self.range_max).contains(&self.value)
    }
}

/// Names and numbers of a load's `kind`; the unit is part of the name.
pub const LOAD_KINDS: [(&str, u32); 5] = [
    ("FORCE_N", 1),
    ("TORQUE_N_M", 2),
    ("POWER_W", 3),
    ("CURRENT_A", 4),
    ("RATIO_OF_RATED", 5),
];
