//! Canonical moves: the interpreter's output, free of units, planes, offsets and cycles.

use crate::curve::Curve;

/// A motion along one curve, in machine coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Move {
    /// The curve, in mm, and degrees for rotary axes. Its length is never zero.
    pub curve: Curve,
    /// Rapid or feed.
    pub kind: MoveKind,
    /// Programmed speed in the feed metric of the curve (mm/s; deg/s if only rotary axes move), before
    /// override. G93 and G95 are already resolved. Infinite for rapids: the axis limits alone bound the
    /// speed.
    pub feed_mm_s: f64,
    /// How the joint between this move and the next is treated.
    pub path_mode: PathMode,
}

/// Whether a move is a rapid or a feed move.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum MoveKind {
    /// G0.
    Rapid,
    /// G1, G2, G3, G2.2, G3.2.
    Feed,
}

/// Path control mode (RS274/NGC).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PathMode {
    /// G61: the path is kept exactly; joints are passed as fast as the limits permit, corners with a stop.
    ExactPath,
    /// G61.1: stop at the end of every move.
    ExactStop,
    /// G64: joints may be rounded.
    Blend {
        /// Maximum distance between the programmed and the driven path in mm (G64 P). `None` without P: the
        /// machine's default applies.
        tolerance_mm: Option<f64>,
        /// Maximum distance in mm of a point from the line through its neighbours for the point to be dropped
        /// (G64 Q), so that short lines are merged. `None` without Q: the tolerance of P applies. 0 merges
        /// nothing.
        merge_mm: Option<f64>,
    },
}
