//! Load-adaptive turning passes and adaptive feed, with a simulated workpiece.
//!
//! ```text
//! load sample ─► LoadWatch ─► depth of cut ─► TurningController ─► feed, height ─► two AxisDrives ─► setpoint
//!                                              │        ▲                                              │
//!                                              └► SizeRecord (remaining stock)                         ▼
//!                 Sensor ◄───────────────────────────────────────────────────────────────────── Workpiece
//! ```
//!
//! A [`CutLaw`] gives the load of a depth and a feed. At the set load, the feed gives the depth; a [`Regime`]
//! holds the depths at which the feed meets its limits. The [`TurningController`] feeds at the final size,
//! backs off where the cut is too deep, and returns for the rest. It knows only the stock that it has felt.
//!
//! ```
//! use evolvent_turning::{
//!     BackOff, Blank, CutLaw, Regime, RegimeInput, SensorModel, Simulation, CuttingEdge, TurningSettings,
//! };
//!
//! let tool = CuttingEdge::new(60.0, 12.0)?;
//! let law = CutLaw { coefficient: 1467.0, depth_exponent: 1.0, feed_exponent: 0.75 };
//! let input = RegimeInput {
//!     law,
//!     set_load: 2200.0,
//!     permitted_load: 10_000.0,
//!     feed_min_mm_rev: 0.2,
//!     feed_max_mm_rev: 0.7,
//!     back_off: BackOff::Balanced,
//! };
//! let settings = TurningSettings::usual(Regime::new(&input, &tool)?, tool, 500.0, 30.0);
//! let sensor = SensorModel { lag_s: 0.01, noise: 0.02, range_max: 8000.0, seed: 1 };
//! let mut job = Simulation::new(settings, Blank::uniform(3.0), law, sensor)?;
//! let (figures, _reason) = job.run(60.0, |_, _| {});
//! assert!(figures.done && figures.passes == 1 && figures.residual_mm < 0.1);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Positions are measured along the cut from the face at which the tool enters, heights outwards from the
//! final size, both in mm, in longitudinal turning and in facing. The caller converts them to X and Z.
//!
//! [`TurningController::step`], [`LoadWatch`], [`SizeRecord`], [`AxisDrive`] and [`CutLaw`] are for the
//! real-time cycle: they do not allocate after set-up, read no clock, and give the same bits for the same
//! inputs. [`Workpiece`], [`Sensor`], [`SimulatedProcess`] and [`Simulation`] are the simulated process for
//! tests and trials.
//!
//! The idea and equations (1) to (5) are from V. A. Timiryazev, A. V. Mukhin, A. A. Ivanov, "Adaptable
//! control in autoprogramming of cutting tool path on a numerical control lathe".

mod adaptive;
mod adaptive_file;
mod axis;
mod backing_off;
mod blank;
mod chip;
mod climb;
mod cone;
mod controller;
mod cutting;
mod engagement;
mod feeding;
mod felt_stock;
mod fixed;
mod job;
mod job_constants;
mod job_file;
mod law;
mod load_loss;
mod missing;
mod pass_end;
mod pass_plan;
mod pass_watch;
mod protection_state;
mod recent_cut;
mod record;
mod regime;
mod return_path;
mod scale;
mod sensor;
mod settings;
mod simulation;
mod state;
mod tip_contact;
mod tool;
mod trail;
mod watch;
mod wear;
mod workpiece;

pub use adaptive::{AdaptiveError, AdaptiveFeed, AdaptiveOutput, AdaptiveSettings, AdaptiveStop, CutPhase};
pub use adaptive_file::adaptive_schema;
pub use axis::{AxisDrive, AxisPoint};
pub use blank::{Blank, BlankError};
pub use cone::{Cone, ConeError};
pub use controller::{TurningController, TurningInputs, TurningOutput};
pub use cutting::SimulatedProcess;
pub use evolvent_machine::LoadSample;
pub use evolvent_timing::ScalarLimits;
pub use fixed::FixedPasses;
pub use job::TurningJob;
pub use job_file::{CutEnd, CutFile, CutKind, JobFile, SensorKind, process_schema};
pub use law::CutLaw;
pub use record::SizeRecord;
pub use regime::{BackOff, Regime, RegimeError, RegimeInput};
pub use scale::{Lever, LoadScale};
pub use sensor::{Sensor, SensorFault, SensorModel};
pub use settings::{OnThin, PassDepth, SettingsError, Strategy, TurningSettings};
pub use simulation::{Figures, Simulation, run_fixed, run_fixed_at_load};
pub use state::{Reason, Transition, TurningState};
pub use tool::{CuttingEdge, ToolError};
pub use watch::{LoadView, LoadWatch, SensorTrouble};
pub use wear::Wear;
pub use workpiece::{CutState, Workpiece};
