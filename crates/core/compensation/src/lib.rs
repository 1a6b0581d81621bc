//! Backlash, screw error, squareness and thermal offset: converts ideal setpoints into those for the drives.
//!
//! Input: the ideal setpoint, position and three derivatives by time of every axis of an error-free machine.
//! Output: the corrected setpoint with the same derivatives. A [`Design`] is created once from the errors and
//! limits of the axes. It states the limits the planner has to keep ([`Design::planner_limits`]) so that the
//! corrected setpoints keep the limits of the axes, and creates the [`Compensation`] that runs in the cycle.
//!
//! ```
//! use evolvent_compensation::{AxisErrors, AxisLimits, Design, MachineErrors};
//! use evolvent_path::{AXES, Axes, Jet};
//!
//! let limits = AxisLimits { velocity: 500.0, acceleration: 5000.0, jerk: 200_000.0 };
//! let mut errors = MachineErrors::default();
//! errors.axes[0] = AxisErrors { backlash: 0.02, hysteresis: 0.001, ..AxisErrors::default() };
//! let mut drives = [None; AXES];
//! drives[0] = Some(limits);
//! let design = Design::new(&errors, &drives)?;
//! // A tenth of the jerk is reserved for the backlash.
//! assert!((design.planner_limits(0).unwrap().jerk - 180_000.0).abs() < 1e-6);
//! let mut compensation = design.compensation(0.001, Axes::zeros());
//! let mut ideal = Jet::at_rest(Axes::zeros());
//! ideal.position[0] = 1.0;
//! let mut corrected = ideal;
//! for _ in 0..100 {
//!     corrected = compensation.step(&ideal);
//! }
//! // The axis has moved forwards: half of the backlash is added.
//! assert_eq!(corrected.position[0], 1.01);
//! # Ok::<(), evolvent_compensation::DesignError>(())
//! ```
//!
//! # Model
//!
//! Squareness comes first: the ideal tool position `x` becomes the slide position `y = S x`. Then each axis
//! separately:
//!
//! ```text
//! q = y + m(y) + b g(y) + o
//! ```
//!
//! `m` is the mean correction of both directions, `g` is half of their difference plus half of the backlash.
//! Both are natural cubic splines over the position ([`ErrorCurve`]); beyond the table the slope fades to
//! zero, then the curve is constant. `b` is the direction, -1 to 1: a hysteresis ([`Direction`]) whose steps
//! are smoothed by three moving averages ([`TripleAverage`]), so that the take-up of the backlash has bounded
//! velocity, acceleration and jerk. `o` is the thermal offset, limited in rate and smoothed in the same way.
//!
//! # Limits
//!
//! With `T` the length of one moving average, `|b'| <= 1.5/T`, `|b''| <= 4/T^2` and `|b'''| <= 8/T^3` for any
//! sequence of reversals. With the maximum derivatives of `m` and `g` the chain rule gives the limits that
//! remain for the ideal motion. `T` is chosen so that the take-up of the backlash needs at most a tenth of
//! each limit.
//!
//! # Guarantees
//!
//! [`Compensation::step`] neither allocates nor waits; its cost is independent of the motion, apart from a
//! binary search in the table. The smoothed direction is computed in integers: equal positions give equal
//! bits, and nothing drifts. [`Compensation::ideal_position`] is the inverse, for positions that the drives
//! report.
//!
//! # Where to read on
//!
//! `docs/adr/0054-corrections-behind-the-planner.md` for the position between planner and drives; [`Design`],
//! then [`Compensation`].

mod axis_compensation;
mod compensation;
mod design;
mod direction;
mod error_curve;
mod screw_table;
mod squareness;
mod thermal_offset;
mod triple_average;

pub use compensation::Compensation;
pub use design::{AxisErrors, AxisLimits, Design, DesignError, Excess, MachineErrors, ThermalSettings};
pub use direction::Direction;
pub use error_curve::ErrorCurve;
pub use screw_table::{ScrewTable, TableError};
pub use squareness::Squareness;
pub use triple_average::TripleAverage;
