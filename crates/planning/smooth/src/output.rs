//! Output of the smoother: the driven path.

use evolvent_path::{Curve, FeedMetric};

/// One element of the output, in the order of the path.
///
/// `u` is the regular parameter of the programmed curves, counted from the start of the first.
#[derive(Clone, Copy, Debug, PartialEq)]
#[expect(
    clippy::large_enum_variant,
    reason = "nearly every output is a segment; boxing each would cost more"
)]
pub enum Output {
    /// The next path segment.
    Segment(PathSegment),
    /// A limit of the speed at the present end of the path.
    Cap {
        /// Maximum parameter speed; 0: the path stops here.
        speed: f64,
    },
    /// The end of a block.
    Mark(Mark),
}

/// A path segment: a parameter range of one curve, with one feed.
///
/// Position, first and second derivative by the parameter are continuous from segment to segment, except at
/// an [`Output::Cap`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathSegment {
    /// The curve, by its regular parameter.
    pub curve: Curve,
    /// Parameter of the curve at the start of the segment.
    pub from: f64,
    /// Parameter length of the segment.
    pub length: f64,
    /// Programmed feed as in [`crate::ProgramMove::feed_mm_s`].
    pub feed_mm_s: f64,
    /// The axes of the block to which the feed refers.
    pub metric: FeedMetric,
    /// Whether it belongs to a rapid.
    pub rapid: bool,
    /// Whether it deviates from the programmed curve.
    pub blend: bool,
    /// Whether it starts at a joint that is kept although it is not smooth.
    pub joint: bool,
}

/// The end of a programmed block.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mark {
    /// Its position: `u` since the smoother was created.
    pub end: f64,
    /// Program line.
    pub line: u32,
    /// Index of the block in the order of execution.
    pub block: u32,
    /// Whether it is a rapid.
    pub rapid: bool,
}
