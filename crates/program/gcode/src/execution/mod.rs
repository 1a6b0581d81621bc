//! Converts blocks into moves, in the order of execution: lines, arcs, splines, offsets, compensation,
//! cycles.

pub(crate) mod arc;
pub(crate) mod compensation;
pub(crate) mod contour_checker;
pub(crate) mod cycles;
pub(crate) mod execute;
pub(crate) mod hole;
pub(crate) mod offset_path;
pub(crate) mod offsets;
pub(crate) mod saved_modes;
pub(crate) mod spline;
pub(crate) mod straight;
pub(crate) mod unlimited;
