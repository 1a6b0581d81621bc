//! Tests across crates and with foreign clients: Evolvent as its users see it.
//!
//! The tests stand in the `tests` folder beside this one and drive the binary. What they share is here:
//!
//! - [`evolvent`], [`run`] and [`Finished`]: the binary under test, and what one command came to;
//! - [`Launch`]: one `evolvent run`;
//! - [`Served`] and [`Operator`]: an `evolvent serve`, and a client that commands it and looks on;
//! - [`Scene`]: a mill that is served, with all that belongs to it;
//! - [`Drives`]: simulated drives in a process of their own; [`HardwareBridge`]: a bridge to hardware in one;
//!   [`Simulator`]: a simulator of hardware in one;
//! - [`Lathe`]: a lathe behind a bridge to hardware, [`MesaLathe`], [`RingLathe`] or [`ShippedLathe`];
//! - [`Domain`]: a corner of shared memory of one's own, swept and checked at the end;
//! - [`hold_to_the_suite`]: the conformance suite over a bridge; [`c_example`]: the examples in C;
//! - [`unless_disturbed`] and [`where_undisturbed`]: a trial of real time, played again where the host kept
//!   its processes from running;
//! - [`Workshop`]: a folder of one's own with machine files and programs made for one test;
//! - [`cycles`]: what a trace recorded, [`verifies`] that it computes again, [`phases`] whether threads are
//!   in phase;
//! - [`Hole`]: exact involutes and circles of a program, by formulas of their own and not the crates under
//!   test;
//! - [`Random`]: random numbers that tell their seed.
//!
//! Foreign clients are Python scripts in `python`, run by the interpreter that `EVOLVENT_PYTHON` names;
//! `tools/test` makes one.
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
