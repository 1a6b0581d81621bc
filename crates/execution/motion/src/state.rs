//! States of the cycle and flags of a setpoint, with the numbers that bus and trace carry.

/// The state of the cycle. The numbers are part of the bus and trace contract.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum MotionState {
    /// At rest, without a job.
    Idle = 0,
    /// Moving along the path, or ready to move.
    Running = 1,
    /// Decelerating for a feed hold.
    Holding = 2,
    /// At rest on the path in a feed hold; continues when the hold is released.
    Held = 3,
    /// Decelerating for a stop that ends the run.
    Stopping = 4,
    /// At rest on the path after a stop.
    Stopped = 5,
    /// Waiting for the time of a dwell (G4).
    Dwell = 6,
    /// At rest at a program stop (M0, M1, M60); continues on resume.
    ProgramStop = 7,
    /// Decelerating or at rest after a fault.
    Fault = 8,
    /// The program has ended.
    Done = 9,
}
