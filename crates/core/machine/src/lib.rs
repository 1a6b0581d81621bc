//! The machine: axes, limits, configuration, and the rational control rate.
//!
//! A [`Machine`] is what a file in `config/machines/` says, checked once on entry ([`Machine::load`]): every number in
//! it is finite, within the range of a real machine, and in mm (degrees for rotary axes) and seconds, whatever unit the
//! file uses. Who needs vectors over the nine axes takes [`Limits`].
//!
//! The rest answers one question: how fast must the control loop run? Between two setpoints a drive moves along a
//! chord; the chord misses the curved path by its sagitta. Three functions of the same equation look at it from the
//! three sides:
//!
//! - [`chord_error_increments`]: rate, feed and radius are given: how large is the error?
//! - [`rate_for`]: feed, radius and permitted error are given: which rate keeps it? [`rational_rate`] takes the largest
//!   over every feed and radius that a machine's limits allow.
//! - [`chord_feed_limit_mm_s`]: rate, curvature and permitted error are given: how fast may the path be run? The
//!   planner keeps this limit, so the error stays permitted at any rate and too low a rate costs time instead.
//!
//! ```
//! use evolvent_machine::{chord_error_increments, rate_for};
//!
//! // 6 m/min on a radius of 10 mm, to 1 um on a grid of 1000 increments/mm:
//! let rate_hz = rate_for(100.0, 10.0, 1000.0, 1.0);
//! assert!((chord_error_increments(100.0, rate_hz, 10.0, 1000.0) - 1.0).abs() < 1e-6);
//! assert!(rate_hz > 353.5 && rate_hz < 353.6);
//! ```
//! [`figures_svg`] draws the diagrams that belong to it. Nothing here starts threads or knows G-code; the functions of
//! the chord error are free of allocation, everything else is for start-up.

mod chord;
mod corrections;
mod error;
mod figures;
mod file;
mod handwheel;
mod homing;
mod limits;
mod machine;
mod parse;
mod rate;
mod screw_file;
mod signals;

pub use chord::{
    acceleration_feed_mm_s, acceleration_rate_hz, chord_error_increments, chord_feed_limit_mm_s,
    jerk_feed_mm_s, longest_chord_mm, rate_for, smallest_radius_mm,
};
pub use corrections::{CorrectionSettings, ScrewFile};
pub use error::{MachineError, PeriodError};
pub use figures::{FigureError, figures_svg, figures_svg_of_axes};
pub use file::machine_schema;
pub use handwheel::{HandwheelSettings, MAX_WHEEL_STEPS};
pub use homing::HomingSettings;
pub use limits::Limits;
pub use machine::{
    Axis, ControlRate, CycleRecording, DriveSettings, FeedbackWish, Kinematics, Lead, MAX_FILE_BYTES,
    MAX_RATE_HZ, MIN_RATE_HZ, Machine, MachineKind, Magazine, OnFull, PathMode, PathSettings, PlannerKind,
    ProgramSettings, RealtimeSettings, ToolChange, TraceSettings, TurningWords, WithoutToolTable,
};
pub use rate::{
    DEFAULT_MIN_RADIUS_MM, GRAVITY_MM_S2, LimitedBy, RateError, RateInput, RationalRate, period_ns_of,
    rational_rate,
};
pub use signals::{
    AtSpeed, EstopSettings, InputSettings, MAX_ANALOG, MAX_DIGITAL, MAX_SPINDLES, OutputRule, OutputSettings,
    ProbeSettings, SignalKind, SignalSettings, SpindleSettings,
};
