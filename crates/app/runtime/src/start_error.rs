//! Why a run, or serving a machine, could not be started.

use std::path::PathBuf;
use std::time::Duration;

use evolvent_bus::BusError;
use evolvent_trace::RecordError;

/// How long to wait for the bus: opening clears what killed runs have left, and may wait for subscribers.
pub(crate) const BUS_TIMEOUT: Duration = Duration::from_secs(30);
/// How long to wait for an emergency-stop chain that is closed.
pub(crate) const CHAIN_TIMEOUT: Duration = Duration::from_secs(10);
/// How long to wait for the first setpoint of a served machine.
pub(crate) const CYCLE_TIMEOUT: Duration = Duration::from_secs(20);

/// Why a run could not be started.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// The bus.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The bus did not open in time.
    #[error("the bus did not open within {} s; see whether shared memory is usable (`evolvent doctor`)", BUS_TIMEOUT.as_secs())]
    BusTimeout,
    /// The machine file wants drives watched.
    #[error(
        "the machine file asks for drives that answer (drives.feedback = \"required\"), and `run` does not \
         watch drives: use `evolvent serve`, or \"if_present\" for a run without a machine"
    )]
    DrivesRequired,
    /// Without the bus the emergency-stop chain is not read.
    #[error(
        "the machine file has an emergency-stop chain ([estop]), and without the bus nobody reads it: leave \
         out --no-bus, or use --clock virtual for a run without a machine"
    )]
    ChainUnread,
    /// The emergency-stop chain is open.
    #[error(
        "the emergency-stop chain ([estop]) is open, or no bridge has sent its input within {} s; close it, \
         and see that the bridge runs", CHAIN_TIMEOUT.as_secs()
    )]
    ChainOpen,
    /// The trace.
    #[error(transparent)]
    Trace(#[from] RecordError),
    /// The cycle's thread computes nothing.
    #[error(
        "the cycle did not compute a setpoint within {} s; the host is overloaded, or real-time threads \
         take all of its processors (`evolvent doctor`)",
        CYCLE_TIMEOUT.as_secs()
    )]
    CycleTimeout,
    /// The modes that the interpreter begins with are refused.
    #[error(
        "the modes at power-up are refused: {0}; see program, tool table and parameters in the machine file"
    )]
    Modes(String),
    /// Two cores would overwrite each other's offsets and tools.
    #[error(
        "the state folder {} is used by another core ({holder}); give each core a folder of its own with \
         --state, or end the other",
        folder.display()
    )]
    StateInUse {
        /// The folder.
        folder: PathBuf,
        /// Name and process of the other.
        holder: String,
    },
    /// The operating system gave no thread.
    #[error("a thread could not be started: {0}; free memory or raise the limit of processes")]
    Thread(#[from] std::io::Error),
}
