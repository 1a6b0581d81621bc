//! Backlash, screw error, squareness and thermal offset: from ideal setpoints to what the drives are sent.
//!
//! In goes the ideal setpoint: position and three derivatives by time of the axes of a machine without errors. Out comes the
//! corrected setpoint with the same derivatives. A [`Design`] is made once from the errors and the limits of the axes; it says
//! which limits the planner has to keep ([`Design::planned`]) so that the corrected setpoints keep those of the axes, and makes
//! the [`Compensation`] that runs in the cycle.
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
//! // A tenth of the jerk is left for the backlash.
//! assert!((design.planned(0).unwrap().jerk - 180_000.0).abs() < 1e-6);
//! let mut compensation = design.compensation(0.001, Axes::zeros());
//! let mut ideal = Jet::at_rest(Axes::zeros());
//! ideal.position[0] = 1.0;
//! let mut corrected = ideal;
//! for _ in 0..100 {
//!     corrected = compensation.step(&ideal);
//! }
//! // It has moved forwards: half of the backlash is added.
//! assert_eq!(corrected.position[0], 1.01);
//! # Ok::<(), evolvent_compensation::DesignError>(())
//! ```
//!
//! # Model
//!
//! Squareness first: the ideal position `x` of the tool becomes the position `y` of the slides, `y = S x`. Then each axis by
//! itself:
//!
//! ```text
//! q = y + m(y) + b g(y) + o
//! ```
//!
//! `m` is the mean of the corrections of both directions and `g` half of their difference, with half of the backlash: C2 cubic
//! splines over the position ([`ErrorCurve`]), constant outside the table. `b` is the direction, from -1 to 1: a hysteresis
//! ([`Direction`]) whose steps are smoothed by three moving averages ([`TripleAverage`]), so that taking up the backlash is a
//! motion of bounded velocity, acceleration and jerk. `o` is the thermal offset, limited in rate and smoothed in the same way.
//!
//! # Limits
//!
//! Where `T` is the length of one moving average, `|b'| <= 1.5/T`, `|b''| <= 4/T^2` and `|b'''| <= 8/T^3`, whenever the direction
//! changes. With the largest derivatives of `m` and `g` the chain rule gives what is left for the ideal motion. `T` is chosen
//! so that taking up the backlash takes at most a tenth of each limit.
//!
//! # Guarantees
//!
//! [`Compensation::step`] neither allocates nor waits; its cost does not depend on the motion but for a binary search in the
//! table. The smoothed direction is computed in integers: the same positions give the same bits, and nothing drifts.
//! [`Compensation::ideal_position`] goes back from what the drives report.
//!
//! Why it is here, between planning and drives: ADR 54 of the documentation.

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
