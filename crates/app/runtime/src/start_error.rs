//! Why a run or a service could not start.

use std::path::PathBuf;
use std::time::Duration;

use evolvent_bus::BusError;
use evolvent_trace::RecordError;

/// Time limit for opening the bus, which removes the remains of killed runs and may wait for subscribers.
pub(crate) const BUS_TIMEOUT: Duration = Duration::from_secs(30);
/// Time limit for the emergency-stop chain to close.
pub(crate) const CHAIN_TIMEOUT: Duration = Duration::from_secs(10);
/// Time limit for the first setpoint of a served machine.
pub(crate) const CYCLE_TIMEOUT: Duration = Duration::from_secs(20);

/// Why a run could not be started.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// Error of the bus.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The bus did not open in time.
    #[error("the bus did not open within {} s; check that shared memory is usable (`evolvent \
             doctor`)", BUS_TIMEOUT.as_secs())]
    BusTimeout,
    /// The machine file requires monitoring of the drives.
    #[error(
        "the machine file requires drives that reply (drives.feedback = \"required\"), but `run` does not \
         monitor drives: use `evolvent serve`, or \"if_present\" for a run without a machine"
    )]
    DrivesRequired,
    /// Without the bus the emergency-stop chain is not read.
    #[error(
        "the machine file has an emergency-stop chain ([estop]), and without the bus nothing reads it: leave \
         out --no-bus, or use --clock virtual for a run without a machine"
    )]
    ChainUnread,
    /// The emergency-stop chain is open.
    #[error(
        "the emergency-stop chain ([estop]) is open, or no bridge has sent its input within {} s; close it, \
         and check that the bridge runs", CHAIN_TIMEOUT.as_secs()
    )]
    ChainOpen,
    /// Error of the trace.
    #[error(transparent)]
    Trace(#[from] RecordError),
    /// The cycle's thread computes nothing.
    #[error(
        "the cycle did not compute a setpoint within {} s; the host is overloaded, or real-time threads \
         take all of its processors (`evolvent doctor`)",
        CYCLE_TIMEOUT.as_secs()
    )]
    CycleTimeout,
    /// The initial modes of the interpreter are rejected.
    #[error(
        "the modes at power-up are rejected: {0}; check program, tool table and parameters in the machine \
         file"
    )]
    Modes(String),
    /// Two cores would overwrite each other's offsets and tools.
    #[error(
        "the state folder {} is used by another core ({holder}); give each core its own folder with --state, \
         or stop the other core",
        folder.display()
    )]
    StateInUse {
        /// The folder.
        folder: PathBuf,
        /// Name and process of the other.
        holder: String,
    },
    /// The operating system cannot start a thread.
    #[error("a thread could not be started: {0}; free memory or raise the limit of processes")]
    Thread(#[from] std::io::Error),
}
