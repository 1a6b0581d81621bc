//! Canonical moves: what an interpreter gives to a planner, free of units, planes, offsets and cycles.

use crate::curve::Curve;

/// A motion along one curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Move {
    /// Where to, in machine coordinates: mm, and degrees for rotary axes. Never of length zero.
    pub curve: Curve,
    /// Rapid or feed.
    pub kind: MoveKind,
    /// Programmed speed along the curve's feed metric (mm/s; deg/s if only rotary axes move), before override.
    /// G93 and G95 are already resolved. Infinite for rapids: as fast as the axes can.
    pub feed: f64,
    /// How the corner between this move and the next is to be taken.
    pub path_mode: PathMode,
}

/// Rapid or feed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum MoveKind {
    /// G0.
    Rapid,
    /// G1, G2, G3, G2.2, G3.2.
    Feed,
}

/// Path control mode.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PathMode {
    /// G61: the path is kept exactly; slow down or stop at corners as the limits demand.
    ExactPath,
    /// G61.1: stop at the end of every move.
    ExactStop,
    /// G64: corners may be rounded.
    Blend {
        /// Greatest distance between the programmed corner and the path in mm (G64 P); without P: `None`,
        /// what the machine is set up for.
        tolerance_mm: Option<f64>,
        /// How far a point may lie off the line through its neighbours to be left out, in mm (G64 Q): short
        /// lines are merged. Without Q: `None`, as P says; 0: nothing is merged.
        merge_mm: Option<f64>,
    },
}
