//! What must still be in front of the edge, from what was felt.

/// The stock that was felt, and the least of it that must still stand before the tip.
///
/// A gap shows in the load before it is there. The outer end of the edge leads, so at a wall square to the
/// feed the depth falls by the tangent of the lead angle for each mm of feed, and never faster. In material
/// that is harder than the law of the load says the depth reads higher by a factor, and falls faster by the
/// same. A load that goes away faster than that belongs to stock which still stands: the insert is broken, or
/// the sensor does not show the load any more.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Engagement {
    /// Where the stock was felt last, mm along the cut.
    place_mm: f64,
    /// The least height above the final size that must stand there, mm; 0 where nothing was felt.
    top_mm: f64,
    /// Height of the tip at that place, mm.
    out_mm: f64,
    /// The most by which the depth falls per mm of feed.
    slope: f64,
}

impl Engagement {
    /// Nothing has been felt. At the end of stock the depth falls by at most `slope` mm per mm of feed.
    pub(crate) fn new(slope: f64) -> Self {
        Self {
            slope,
            ..Self::default()
        }
    }

    /// A load belongs to a depth at a place and height of the tip, all in mm. Real-time safe.
    pub(crate) fn feel(&mut self, place_mm: f64, out_mm: f64, depth_mm: f64) {
        self.top_mm = self.top_at(place_mm).max(out_mm + depth_mm);
        (self.place_mm, self.out_mm) = (place_mm, out_mm);
    }

    /// The least height that must stand before a tip at a place, mm.
    pub(crate) fn top_at(&self, place_mm: f64) -> f64 {
        (self.top_mm - (place_mm - self.place_mm).max(0.0) * self.slope).max(0.0)
    }

    /// The depth that was there when a load was felt last, mm.
    pub(crate) fn depth_mm(&self) -> f64 {
        (self.top_mm - self.out_mm).max(0.0)
    }

    /// The minimum depth that a tip must still cut at a distance ahead, mm.
    pub(crate) fn depth_after_mm(&self, way_mm: f64) -> f64 {
        (self.top_at(self.place_mm + way_mm) - self.out_mm).max(0.0)
    }

    /// Where a load was felt last, mm.
    pub(crate) fn place_mm(&self) -> f64 {
        self.place_mm
    }

    /// What was felt does not count any more.
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
            let place = 0.001 * f64::from(k);
            // A wall at 2 mm: the tip leaves it last.
            felt.feel(place, 1.0, (slope * (3.0 - place)).clamp(0.0, 3.0));
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
