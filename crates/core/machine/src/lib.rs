//! The machine: axes, limits, configuration, and the rational control rate.
//!
//! Input: a machine file (TOML, see `config/machines/`). Output: a checked [`Machine`], and the control rate
//! that its limits require.
//!
//! ```
//! use evolvent_machine::{chord_error_increments, rate_for};
//!
//! // 6 m/min on a radius of 10 mm, to 1 um on a grid of 1000 increments/mm:
//! let rate_hz = rate_for(100.0, 10.0, 1000.0, 1.0);
//! assert!((chord_error_increments(100.0, rate_hz, 10.0, 1000.0) - 1.0).abs() < 1e-6);
//! assert!(rate_hz > 353.5 && rate_hz < 353.6);
//! ```
//!
//! # Model
//!
//! [`Machine::load`] checks the file once. After that every number is finite, plausible for a machine, and in
//! mm (degrees for rotary axes) and seconds, whatever unit the file uses. [`Machine::limits`] gives the
//! limits of the nine axes as vectors.
//!
//! How fast must the control loop run? Between two setpoints a drive moves along a chord, which deviates from
//! a curved path by its sagitta. Three functions solve the same equation for different unknowns:
//!
//! - [`chord_error_increments`]: the error, from rate, feed and radius.
//! - [`rate_for`]: the rate, from feed, radius and permitted error. [`rational_rate`] takes the maximum over
//!   every feed and radius that the limits of a machine permit.
//! - [`chord_feed_limit_mm_s`]: the feed, from rate, curvature and permitted error. The planner keeps this
//!   limit, so the error is permitted at any rate, and too low a rate costs time instead.
//!
//! [`figures_svg`] draws the corresponding diagrams.
//!
//! # Guarantees
//!
//! Errors name file, line, column and key, and say what to do. The functions of the chord error are real-time
//! safe; everything else is for start-up. The crate starts no threads and knows no G-code.
//!
//! # Where to read on
//!
//! `machine.rs` for the settings, `file.rs` for the keys of the file, `parse/` for the checks;
//! `docs/contract.md` for the user's view of the machine file.

mod chord;
mod corrections;
mod error;
mod figures;
mod file;
mod handwheel;
mod homing;
mod limits;
mod load_sample;
mod machine;
mod parse;
mod rate;
mod screw_file;
mod signals;

pub use chord::{
    acceleration_feed_mm_s, acceleration_rate_hz, chord_error_increments, chord_feed_limit_mm_s,
    jerk_feed_mm_s, max_chord_mm, min_radius_for_chord_mm, rate_for,
};
pub use corrections::{CorrectionSettings, ScrewFile};
pub use error::{MachineError, PeriodError};
pub use figures::{FigureError, figures_svg, figures_svg_of_axes};
pub use file::machine_schema;
pub use handwheel::{HandwheelSettings, MAX_WHEEL_STEPS};
pub use homing::{HomingMethod, HomingSettings};
pub use limits::Limits;
pub use load_sample::LoadSample;
pub use machine::{
    Axis, ControlRate, CycleRecording, DriveSettings, FeedbackMode, Kinematics, Lead, LengthUnit,
    MAX_FILE_BYTES, MAX_RATE_HZ, MIN_RATE_HZ, Machine, MachineKind, Magazine, OnFull, PathMode, PathSettings,
    PlannerKind, ProgramSettings, RealtimeSettings, RotaryDirection, StartPlane, StartX, ToolChange,
    TraceSettings, TurningWords, UNLIMITED_DEG, WithoutToolTable,
};
pub use rate::{
    DEFAULT_MIN_RADIUS_MM, GRAVITY_MM_S2, LimitedBy, RateError, RateInput, RationalRate, period_ns_of,
    rational_rate,
};
pub use signals::{
    AtSpeed, EstopSettings, InputSettings, MAX_ANALOG, MAX_DIGITAL, MAX_SPINDLES, OutputRule, OutputSettings,
    ProbeSettings, SignalKind, SignalSettings, SpindleSettings,
};
