//! The cycle's ends of the queues.

use core::sync::atomic::{AtomicBool, AtomicU64};

use evolvent_bus::{Feedback, MachineInputs, MachineOutputs, Setpoint};
use rtrb::{Consumer, Producer};

/// What comes from the bus.
#[derive(Clone, Copy, Debug)]
pub enum Incoming {
    /// A setpoint of the core.
    Setpoint(Setpoint),
    /// The outputs of the machine.
    Outputs(MachineOutputs),
    /// A setpoint of another interface version, which cannot be read.
    OtherVersion,
}

/// What a session takes from the bus thread and hands to it, and what ends the session. Its use never waits or allocates.
#[derive(Debug)]
pub struct BusEnds<'a, N> {
    /// What came from the bus, in the order of arrival for each kind.
    pub incoming: &'a mut Consumer<Incoming>,
    /// Feedback of the drives, one for each cycle.
    pub feedback: &'a mut Producer<Feedback>,
    /// Inputs of the machine.
    pub inputs: &'a mut Producer<MachineInputs>,
    /// What people should know.
    pub notices: &'a mut Producer<N>,
    /// Set when the session shall end.
    pub stop: &'a AtomicBool,
    /// The core's period in ns; another one ends the session.
    pub period_ns: &'a AtomicU64,
}
