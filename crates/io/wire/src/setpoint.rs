//! The setpoint: the target of the drives at one instant.

use crate::layout::{AXES, payload};

payload! {
    /// Target position of every axis at one instant, and its derivatives.
    ///
    /// Published ahead of time: in a real-time run `due_time_ns` is `lead` periods after publication.
    /// `sequence` grows by one per setpoint, so a gap is a lost setpoint and is detected as one.
    pub struct Setpoint = "evolvent.Setpoint.v1" {
        /// Index of the cycle; grows by exactly one.
        sequence: u64,
        /// When the setpoint holds: ns of CLOCK_MONOTONIC (real-time clock) or of path time (virtual clock).
        due_time_ns: u64,
        /// Time from this setpoint to the next, in ns.
        period_ns: u64,
        /// Position in machine coordinates: mm, degrees for A B C.
        position: [f64; AXES],
        /// Velocity: mm/s, degrees/s for A B C.
        velocity: [f64; AXES],
        /// Acceleration: mm/s2, degrees/s2 for A B C.
        acceleration: [f64; AXES],
        /// Position rounded to the machine's increments, counted from machine zero.
        position_increments: [i64; AXES],
        /// State of the core, a number of the list of states.
        state: u32,
        /// Bits of the list of setpoint flags.
        flags: u32,
        /// Line of the program, counted from 1; 0 if none.
        line: u32,
        /// Bit i set: axis i is driven; the values of the others have no meaning.
        axes_mask: u32,
        /// Speed along the path, in mm/s.
        feed_mm_s: f64,
        /// Feed override as a ratio: 1 is 100 %.
        override_ratio: f64,
        /// Distance along the path since the start of the run, in mm.
        path_mm: f64,
        /// Requested state of the drives' power stages, a number of the list of power requests.
        power_request: u32,
        /// Grows by one to request a reset of the drives' faults.
        fault_reset: u32,
        /// Grows by one when homing assigns new coordinates: the axes are at rest, and the step of position is not a motion.
        datum: u64,
        /// Another number, not 0: the next index pulse of the encoder of axis `index_axis` is to be latched.
        index_request: u32,
        /// The axis of `index_request`, an index into X Y Z A B C U V W.
        index_axis: u32,
        /// Zero; for later versions.
        reserved: [u64; 2],
    }
}

/// Names and numbers of `power_request`.
pub const POWER_REQUESTS: [(&str, u32); 3] = [("OFF", 0), ("ON", 1), ("QUICK_STOP", 2)];

/// Names and numbers of `state`, as on the bus and in the trace.
pub const STATES: [(&str, u32); 10] = [
    ("IDLE", 0),
    ("RUNNING", 1),
    ("HOLDING", 2),
    ("HELD", 3),
    ("STOPPING", 4),
    ("STOPPED", 5),
    ("DWELL", 6),
    ("PROGRAM_STOP", 7),
    ("FAULT", 8),
    ("DONE", 9),
];

/// Bits of `flags` in [`Setpoint`] and [`Status`](crate::Status), the same in the trace.
pub mod flags {
    /// The setpoint was published after its due time.
    pub const LATE: u32 = 1 << 0;
    /// A feed hold is in force.
    pub const HOLD: u32 = 1 << 1;
    /// On a blend between two programmed blocks.
    pub const BLEND: u32 = 1 << 2;
    /// A rapid move (G0).
    pub const RAPID: u32 = 1 << 3;
    /// Within a step of curvature in exact-path mode, where only the joint rule bounds jerk.
    pub const JOINT: u32 = 1 << 4;
    /// The planner had not finished the next part of the plan: the speed is lower than possible.
    pub const STARVED: u32 = 1 << 5;
    /// The guard rejected the planned setpoint.
    pub const GUARD: u32 = 1 << 6;
    /// The last setpoint of the run.
    pub const LAST: u32 = 1 << 7;
}

/// Names and bits of `flags`, as on the bus and in the trace.
pub const SETPOINT_FLAGS: [(&str, u32); 8] = [
    ("LATE", flags::LATE),
    ("HOLD", flags::HOLD),
    ("BLEND", flags::BLEND),
    ("RAPID", flags::RAPID),
    ("JOINT", flags::JOINT),
    ("STARVED", flags::STARVED),
    ("GUARD", flags::GUARD),
    ("LAST", flags::LAST),
];
