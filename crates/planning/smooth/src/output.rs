//! What comes out: the path that is driven.

use evolvent_path::Curve;

/// One thing that comes out, in the order of the path.
///
/// `u` is the regular parameter of the programmed curves, counted on from the start of the first.
#[derive(Clone, Copy, Debug, PartialEq)]
#[expect(
    clippy::large_enum_variant,
    reason = "nearly every output is a stretch; a box each would cost more"
)]
pub enum Output {
    /// The next stretch of the path.
    Stretch(Stretch),
    /// A bound of the speed where the path that has come out ends.
    Cap {
        /// Bound of the parameter speed; 0: the path comes to rest here.
        speed: f64,
    },
    /// A block ends.
    Mark(Mark),
}

/// A stretch of the path: a range of a curve, of one feed.
///
/// Position, first and second derivative by the parameter go on from stretch to stretch, but where a [`Output::Cap`]
/// stands between them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stretch {
    /// The curve, by its regular parameter.
    pub curve: Curve,
    /// Parameter of the curve at which the stretch begins.
    pub from: f64,
    /// Length of the stretch in the parameter.
    pub length: f64,
    /// Programmed feed as in [`crate::Block::feed`].
    pub feed: f64,
    /// Whether it belongs to a rapid.
    pub rapid: bool,
    /// Whether it leaves the programmed curve.
    pub blend: bool,
    /// Whether it begins at a joint that is kept though it is not smooth.
    pub joint: bool,
}

/// The end of a programmed block.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mark {
    /// Where it ends: `u` since the smoother was made.
    pub end: f64,
    /// Line of the program.
    pub line: u32,
    /// Number of the block.
    pub block: u32,
    /// Whether it is a rapid.
    pub rapid: bool,
}
