//! The cycle's ends of the queues to the bus thread.

use core::sync::atomic::{AtomicBool, AtomicU64};

use evolvent_bus::{Feedback, MachineInputs, MachineOutputs, Setpoint, SpindleFeedback};
use rtrb::{Consumer, Producer};

/// A message from the bus.
#[derive(Clone, Copy, Debug)]
pub enum Incoming {
    /// A setpoint of the core.
    Setpoint(Setpoint),
    /// The outputs of the machine.
    Outputs(MachineOutputs),
    /// A setpoint of another interface version, which cannot be read.
    OtherVersion,
}

/// The queues between a session and the bus thread, and the flags that end the session. Using them never
/// waits or allocates.
#[derive(Debug)]
pub struct BusEnds<'a, N> {
    /// Messages from the bus, in the order of arrival for each kind.
    pub incoming: &'a mut Consumer<Incoming>,
    /// Feedback of the drives, one per cycle.
    pub feedback: &'a mut Producer<Feedback>,
    /// Inputs of the machine.
    pub inputs: &'a mut Producer<MachineInputs>,
    /// Feedback of the spindles, one per spindle and cycle.
    pub spindles: &'a mut Producer<SpindleFeedback>,
    /// Events for the log.
    pub notices: &'a mut Producer<N>,
    /// Set to end the session.
    pub stop: &'a AtomicBool,
    /// The core's period in ns; another one ends the session.
    pub period_ns: &'a AtomicU64,
}
