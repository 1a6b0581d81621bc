//! An independent check that a motion is what program, machine and tolerance require.
//!
//! ```text
//!   program text ─► Route (lines, arcs, involutes with feed and tolerance)
//!                      │
//!   positions ─────► Judge ─► Verdict ─► violations
//!                      │
//!   machine ───────────┘  limits of every axis, chord error, travel
//! ```
//!
//! A [`Judge`] receives positions, one per control period, and nothing else; the planner's own speed, block
//! or error is not used. Velocity, acceleration and jerk are differences of the positions. The judge follows
//! the program: for each position, and for points on the chord to it, it takes the *earliest* point of the
//! program within the tolerance that is not before the previous one. Taking the earliest point loses nothing,
//! because a motion that can continue from a later point can also continue from an earlier one. So if
//! following fails, the motion does not match the program in its order. Passed parts of the program must be
//! close to the motion as well, so that nothing is left out.
//!
//! A [`Verdict`] has the worst value of every kind with its position; [`Verdict::violations`] lists the
//! violations. A motion that keeps to the path, but reaches 10 mm/s within one period of 1 ms, has twice the
//! permitted acceleration:
//!
//! ```
//! use evolvent_verifier::{Allowances, Judge, Kind, Route};
//! # use evolvent_machine::Machine;
//! # let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../config/machines/mill-3axis.toml");
//! # let machine = Machine::load(file.as_ref())?;
//!
//! let program = "G21 G90 G61\nG1 X1 F600\nM2\n".as_bytes();
//! let route = Route::read(program, evolvent_gcode::Settings::default(), &machine)?;
//! let mut judge = Judge::new(&machine, 1_000_000, &route);
//! let mut position = evolvent_path::Axes::zeros();
//! for setpoint in 1..=100 {
//!     position[0] = 0.01 * f64::from(setpoint);
//!     judge.sample(&position);
//! }
//! let verdict = judge.finish();
//! assert!(verdict.deviation_mm.value < 1e-9);
//! assert!((verdict.acceleration.value - 2.0).abs() < 1e-6, "X: 10 of 5 m/s2");
//! let violations = verdict.violations(&Allowances::default());
//! assert!(violations.iter().any(|violation| violation.kind == Kind::Acceleration));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Curves are evaluated independently from their geometry, without any code of the planner, so that a mistake
//! there is not repeated here. [`suite`] writes the programs on which planners are compared.
//!
//! Nothing in this crate is for the real-time cycle.

#![expect(
    clippy::neg_cmp_op_on_partial_ord,
    reason = "checks are written so that NaN fails them: not (x <= limit) refuses NaN, x > limit lets it pass"
)]

mod block;
mod differences;
mod follower;
mod involute_piece;
mod judge;
mod measure;
mod other;
mod piece;
mod round;
mod route;
mod straight;
mod suite;
mod verdict;

pub use block::VerifiedMove;
pub use judge::Judge;
pub use route::{Route, RouteError};
pub use suite::{Program, butterfly_point, butterfly_program, suite};
pub use verdict::{Allowances, Kind, Verdict, Violation, Worst};
