//! The stock that must still be in front of the edge, from what was felt.

/// The stock that was felt, and its minimum height before the tip.
///
/// A gap shows in the load before the tip reaches it. The outer end of the edge leads, so at a wall square to
/// the feed the depth falls by the tangent of the lead angle for each mm of feed, and never faster. In
/// material that is harder than the force law says, the depth reads higher by a factor and falls faster by
/// the same factor. If a load vanishes faster, the stock is still there: the insert is broken, or the sensor
/// no longer shows the load.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Engagement {
    /// Position at which stock was felt last, mm along the cut.
    position_mm: f64,
    /// Minimum height of that stock above the final size, mm; 0 if nothing was felt.
    top_mm: f64,
    /// Height of the tip at that position, mm.
    out_mm: f64,
    /// Maximum decrease of the depth per mm of feed.
    slope: f64,
}

impl Engagement {
    /// Nothing felt yet. At the end of stock the depth falls by at most `slope` mm per mm of feed.
    pub(crate) fn new(slope: f64) -> Self {
        Self {
            slope,
            ..Self::default()
        }
    }

    /// Records a depth that was felt at a position and height of the tip, all in mm. Real-time safe.
    pub(crate) fn feel(&mut self, position_mm: f64, out_mm: f64, depth_mm: f64) {
        self.top_mm = self.top_at(position_mm).max(out_mm + depth_mm);
        (self.position_mm, self.out_mm) = (position_mm, out_mm);
    }

    /// Minimum height of the stock before a tip at a position, mm.
    pub(crate) fn top_at(&self, position_mm: f64) -> f64 {
        (self.top_mm - (position_mm - self.position_mm).max(0.0) * self.slope).max(0.0)
    }

    /// The depth at the last load that was felt, mm.
    pub(crate) fn depth_mm(&self) -> f64 {
        (self.top_mm - self.out_mm).max(0.0)
    }

    /// The minimum depth that a tip must still cut at a distance ahead, mm.
    pub(crate) fn depth_after_mm(&self, distance_mm: f64) -> f64 {
        (self.top_at(self.position_mm + distance_mm) - self.out_mm).max(0.0)
    }

    /// Position at which a load was felt last, mm.
    pub(crate) fn position_mm(&self) -> f64 {
        self.position_mm
    }

    /// Discards what was felt.
    pub(crate) fn forget(&mut self) {
        (self.top_mm, self.out_mm) = (0.0, 0.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_depth_falling_at_the_lead_angle_leaves_nothing() {
        let slope = 60.0_f64.to_radians().tan();
        let mut felt = Engagement::new(slope);
        for k in 0..=4000 {
            let position = 0.001 * f64::from(k);
            // A wall at 2 mm: the tip leaves it last.
            felt.feel(position, 1.0, (slope * (3.0 - position)).clamp(0.0, 3.0));
        }
        assert!(felt.depth_mm() < 1e-9, "{felt:?}");
    }

    #[test]
    fn a_depth_that_goes_away_at_once_is_remembered() {
        let mut felt = Engagement::new(2.0);
        felt.feel(10.0, 1.0, 3.0);
        assert_eq!(
            (felt.depth_mm(), felt.depth_after_mm(0.5), felt.top_at(10.5)),
            (3.0, 2.0, 3.0)
        );
        felt.feel(10.2, 1.0, 0.0);
        assert!((felt.depth_mm() - 2.6).abs() < 1e-12);
        felt.forget();
        assert_eq!(felt.depth_mm(), 0.0);
    }
}
