//! Curves by arc length: line, arc, involute, blend; hole-milling synthesis.

mod axis;
mod jet;

pub use axis::{AXES, Axes, AxisLetter};
pub use jet::Jet;
