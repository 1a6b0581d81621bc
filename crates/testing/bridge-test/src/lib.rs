//! A conformance suite for drive bridges, independent of their author and language.
//!
//! ```text
//!   suite: one case after the other
//!     ├── TestCore ── setpoints, right and wrong ──► bus ──► bridge under test
//!     │      ▲                                                     │
//!     │      └──────────────────── feedback ◄──────────────────────┘
//!     └── BridgeUnderTest: start, end, kill
//! ```
//!
//! A case starts the bridge through [`BridgeUnderTest`], runs a correct or faulty core against it, and judges
//! by the feedback and the inputs alone. [`CASES`] lists all cases; [`run_case`] runs one on its own bus.
//!
//! The simulated bridge on a thread of this process: a case that kills the bridge is left out.
//!
//! ```
//! use evolvent_bridge_test::{CASES, Outcome, Stage, ThreadBridge, run_case};
//!
//! let mut stage = Stage {
//!     bridge: &mut ThreadBridge::simulated(),
//!     machine_name: "example".to_owned(),
//!     prefix: format!("example{}_", std::process::id()),
//!     core_program: None,
//!     seed: 1,
//!     moments: 1,
//!     parts: &[],
//!     stop: std::sync::Arc::default(),
//! };
//! let case = CASES.iter().find(|case| case.name == "bridge_kill").unwrap();
//! assert!(matches!(run_case(case, &mut stage), Ok(Outcome::LeftOut(_))));
//! ```
//!
//! [`ProcessBridge`] runs any command. `evolvent bridge test -- COMMAND` runs the suite against it.
//! [`ThreadBridge`] runs the simulated bridge or another one in this process; it cannot be killed, so cases
//! with a kill are left out.
//!
//! The first axis moves slowly to and fro by some millimetres, the second and third by 0.4 mm. The spindle
//! cases turn the spindle at 300 rpm in both directions, and the probe case drives the probe against an
//! object. Do not run the suite on a machine where any of these motions is unsafe.

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
pub use test_core::{FeedbackSample, TestCore};
