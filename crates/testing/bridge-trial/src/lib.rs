//! For tests of hardware bridges: a bridge on a thread, and a core that moves one axis against it.
//!
//! ```
//! use std::sync::atomic::Ordering;
//!
//! use evolvent_bridge_sim::{RunSettings, run};
//! use evolvent_bridge_trial::{TrialCore, with_bridge};
//!
//! let prefix = format!("trial{}_", std::process::id());
//! let core = TrialCore::open("trial", &prefix);
//! let settings = RunSettings {
//!     machine_name: "trial".to_owned(),
//!     prefix: Some(prefix.clone()),
//!     drives: None,
//!     spindles: Vec::new(),
//!     faults: Vec::new(),
//!     probe: None,
//!     drift_ppm: 0.0,
//!     duration: None,
//! };
//! with_bridge(
//!     &prefix,
//!     |stop, messages| {
//!         run(&settings, stop, |axes, _| messages.push(&format!("drives of {axes}")))
//!     },
//!     core,
//!     |core, messages| {
//!         let here = core.bring_up();
//!         core.velocity_x = 10.0;
//!         core.rest(0.1);
//!         assert!(core.position[0] > here.position[0]);
//!         assert!(messages.contain("drives of XYZ"));
//!     },
//! );
//! ```
//!
//! [`with_bridge`] runs one trial with any core. [`TrialCore`] is a core that moves X at a constant velocity,
//! or homes it ([`TrialCore::home_x`]). [`failed_cases`] runs the suite of `evolvent-bridge-test` and returns
//! the cases that the bridge fails.
//!
//! Everything in this crate panics if a trial fails, as tests do.
#![expect(
    clippy::expect_used,
    clippy::print_stdout,
    reason = "helpers of tests fail and print as tests do"
)]

mod homing;
mod messages;
mod suite;
mod trial;
mod trial_core;

pub use homing::HomingTrial;
pub use messages::Messages;
pub use suite::{failed_cases, failed_probe_cases, failed_spindle_cases};
pub use trial::with_bridge;
pub use trial_core::{ACCELERATION, PERIOD_NS, TrialCore, states};
