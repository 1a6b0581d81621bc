//! The cost of a cut beside the machine's time: wear of the edge.

/// Cost of wear relative to the cost of machine time, by depth and feed: `ratio (s / s_ref)^a (t / t_ref)^b`.
///
/// With the price `E` of the edge, the price `M` of a second of the machine and a tool life of `T` seconds at
/// the reference cut, the ratio is `E / (M T)`; the exponents are those of feed and depth in Taylor's tool
/// life. With a ratio of 0 only time counts.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wear {
    /// At the reference cut.
    pub ratio: f64,
    /// Feed of the reference cut, mm/rev.
    pub feed_mm_rev: f64,
    /// Its depth, mm.
    pub depth_mm: f64,
    /// Exponent of the feed in the tool life.
    pub feed_exponent: f64,
    /// Exponent of the depth.
    pub depth_exponent: f64,
}

impl Wear {
    /// Cost of a second of a cut, in seconds of machine time: 1 without wear. Real-time safe.
    #[must_use]
    pub fn price(&self, depth_mm: f64, feed_mm_rev: f64) -> f64 {
        if self.ratio <= 0.0 {
            return 1.0;
        }
        1.0 + self.ratio
            * libm::pow(feed_mm_rev / self.feed_mm_rev, self.feed_exponent)
            * libm::pow(depth_mm / self.depth_mm, self.depth_exponent)
    }
}
