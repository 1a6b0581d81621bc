//! One block of the programmed path.

use evolvent_path::{Axes, FeedMetric};

use crate::piece::Piece;

/// A move of the program as the judge sees it.
#[derive(Clone, Debug)]
pub struct Block {
    pub(crate) piece: Piece,
    pub(crate) length: f64,
    pub(crate) end: Axes,
    /// Program line.
    pub line: u32,
    /// Programmed speed in the feed metric, mm/s, degrees/s where only rotary axes move; infinite for rapids.
    pub feed: f64,
    /// How far the motion may leave this block, mm or degrees of an axis; 0 in exact-path mode.
    pub tolerance: f64,
    /// Path length in the feed metric, mm or degrees.
    pub path_length: f64,
    /// The axes that the feed refers to.
    pub(crate) metric: FeedMetric,
    /// Whether the machine has to stop exactly at its end.
    pub(crate) rest: bool,
    /// Whether its end is a joint of exact-path mode where direction holds and curvature steps.
    pub(crate) joint: bool,
}
