//! What every drive bridge must do, whoever wrote it and in whatever language.
//!
//! ```text
//!   suite: one case after the other
//!     ├── TestCore ── setpoints, right and wrong ──► bus ──► bridge under test
//!     │      ▲                                                     │
//!     │      └──────────────────── feedback ◄──────────────────────┘
//!     └── BridgeUnderTest: start, end, kill
//! ```
//!
//! A case starts the bridge by way of [`BridgeUnderTest`], plays a core against it, well-behaved or not, and
//! judges by the feedback and the inputs alone. [`CASES`] names them all; [`run_case`] runs one on a bus of
//! its own.
//!
//! [`ProcessBridge`] is any command. `evolvent bridge test -- COMMAND` runs the suite against it.
//! [`ThreadBridge`] is a bridge within this process, the simulated one or another; it cannot be killed, so
//! cases with a kill leave it out.
//!
//! The first axis moves by some millimetres to and fro, slowly, the second and third by 0.4 mm, the cases of
//! the spindle turn it at 300 rpm either way, and that of the probe drives it against something: do not run
//! the suite against a machine whose axes or spindle may not.

mod begin_cases;
mod bridge;
mod case;
mod cases;
mod core_process;
mod probe_case;
mod setpoint_cases;
mod signal_cases;
mod spindle_cases;
mod test_core;
mod timing;

pub use bridge::{BridgeUnderTest, ProcessBridge, SIMULATED_PROBE, StartError, ThreadBridge};
pub use case::{CASES, Case, CaseError, Outcome, Part, Stage, run_case};
pub use core_process::{CoreProcess, run_core};
pub use test_core::{Seen, TestCore};
