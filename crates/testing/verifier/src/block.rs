//! One block of the programmed path.

use evolvent_path::{Axes, FeedMetric};

use crate::piece::Piece;

/// A move of the program, as used by the judge.
#[derive(Clone, Debug)]
pub struct VerifiedMove {
    pub(crate) piece: Piece,
    pub(crate) length: f64,
    pub(crate) end: Axes,
    /// Program line.
    pub line: u32,
    /// Programmed speed in the feed metric, mm/s, or degrees/s if only rotary axes move; infinite for rapids.
    pub feed: f64,
    /// Maximum distance of the motion from this block, mm or degrees of an axis; 0 in exact-path mode.
    pub tolerance: f64,
    /// Path length in the feed metric, mm or degrees.
    pub path_length: f64,
    /// The axes that the feed refers to.
    pub(crate) metric: FeedMetric,
    /// Whether the machine must stop exactly at its end.
    pub(crate) rest: bool,
    /// Whether its end is a joint of exact-path mode with continuous direction and a step in curvature.
    pub(crate) joint: bool,
}
