//! Tests across crates and with foreign clients: Evolvent as its users see it.
//!
//! The tests are in the `tests` folder next to this folder and run the binary. They share:
//!
//! - [`evolvent`], [`run`] and [`Finished`]: the binary under test, and the result of one command;
//! - [`Launch`]: one `evolvent run`;
//! - [`Served`] and [`Operator`]: an `evolvent serve`, and a client that commands and observes it;
//! - [`Scene`]: a served mill with its folder and domain;
//! - [`Drives`]: simulated drives; [`HardwareBridge`]: a hardware bridge; [`Simulator`]: a simulator of
//!   hardware; each in its own process;
//! - [`Lathe`]: a lathe on a hardware bridge, [`MesaLathe`], [`RingLathe`] or [`ShippedLathe`];
//! - [`Domain`]: a separate domain of shared memory, cleaned and checked at the end;
//! - [`hold_to_the_suite`]: the conformance suite for a bridge; [`c_example`]: the examples in C;
//! - [`unless_disturbed`] and [`where_undisturbed`]: a real-time trial that is repeated if the host suspended
//!   its processes;
//! - [`Workshop`]: a temporary folder with machine files and programs for one test;
//! - [`cycles`]: the cycles of a trace; [`verifies`]: recomputes a trace; [`phases`]: the phase of threads;
//! - [`Hole`]: exact involutes and circles of a program, by formulas independent of the crates under test;
//! - [`Random`]: random numbers that report their seed.
//!
//! Foreign clients are Python scripts in `python`, run by the interpreter that `EVOLVENT_PYTHON` names;
//! `tools/test` sets it up.
#![expect(
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "helpers of tests fail and talk as tests do"
)]

mod binary;
mod bridged_lathe;
mod bridges;
mod domain;
mod drives;
mod hardware_bridge;
mod hole;
pub mod job_result;
mod lathe;
mod launch;
mod output_listener;
mod python;
mod scene;
mod served;
mod simulator;
mod trace;
mod workshop;

pub use binary::{Finished, evolvent, run, wait};
pub use bridged_lathe::{Lathe, MesaLathe, RingLathe, ShippedLathe, Sight, Trouble};
pub use bridges::{c_example, hold_to_the_suite};
pub use domain::Domain;
pub use drives::Drives;
pub use evolvent_disturbance::{unless_disturbed, watched, where_undisturbed};
pub use evolvent_random::Random;
pub use hardware_bridge::HardwareBridge;
pub use hole::{Hole, Piece};
pub use lathe::{ThreadPass, angles, phases};
pub use launch::Launch;
pub use output_listener::OutputListener;
pub use python::python;
pub use scene::Scene;
pub use served::{Operator, Served, command, is_behind, speed};
pub use simulator::Simulator;
pub use trace::{Cycle, cycles, verifies};
pub use workshop::{HOMING, Workshop, repository};
