//! States of the cycle and flags of a setpoint, with the numbers that bus and trace carry.

/// What the cycle is doing. The numbers are part of the bus and trace contract.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum State {
    /// At rest, nothing to do.
    Idle = 0,
    /// Moving along the path, or ready to.
    Running = 1,
    /// Decelerating for a feed hold.
    Holding = 2,
    /// At rest on the path in feed hold; resume continues.
    Held = 3,
    /// Decelerating for a stop that ends the run.
    Stopping = 4,
    /// At rest on the path after a stop.
    Stopped = 5,
    /// Waiting for the time of a dwell (G4).
    Dwell = 6,
    /// At rest at a program stop (M0, M1, M60); resume continues.
    ProgramStop = 7,
    /// Decelerating or at rest after a fault.
    Fault = 8,
    /// The program has ended.
    Done = 9,
}

/// Bits of a setpoint's `flags`, the same on the bus and in the trace.
pub mod flags {
    /// The setpoint left after it was due.
    pub const LATE: u32 = 1 << 0;
    /// A feed hold is in force.
    pub const HOLD: u32 = 1 << 1;
    /// On a blend between two programmed blocks.
    pub const BLEND: u32 = 1 << 2;
    /// A rapid move (G0).
    pub const RAPID: u32 = 1 << 3;
    /// Within a step of curvature in exact-path mode, where jerk is bounded by the joint rule only.
    pub const JOINT: u32 = 1 << 4;
    /// The planner had not finished the next run: the speed here is lower than it could be.
    pub const STARVED: u32 = 1 << 5;
    /// The guard refused the planned setpoint.
    pub const GUARD: u32 = 1 << 6;
    /// The last setpoint of the run.
    pub const LAST: u32 = 1 << 7;
}
