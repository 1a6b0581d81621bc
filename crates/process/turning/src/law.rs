//! The load of a cut at one cutting speed, and its inverses.

/// `load = coefficient depth^depth_exponent feed^feed_exponent` at one cutting speed, depth in mm, feed in
/// mm/rev.
///
/// The load is the sensor's quantity: a force in N, a torque, a power or a current. The closed form has
/// closed inverses, so the real-time cycle may call everything here.
///
/// ```
/// use evolvent_turning::CutLaw;
/// let law = CutLaw { coefficient: 1467.0, depth_exponent: 1.0, feed_exponent: 0.75 };
/// let load = law.load(3.0, 0.4);
/// assert!((law.feed_mm_rev(load, 3.0) - 0.4).abs() < 1e-12);
/// assert!((law.depth_mm(load, 0.4) - 3.0).abs() < 1e-12);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CutLaw {
    /// Load at a depth of 1 mm and a feed of 1 mm/rev.
    pub coefficient: f64,
    /// Exponent of the depth (`xz` of the handbooks).
    pub depth_exponent: f64,
    /// Exponent of the feed (`yz`).
    pub feed_exponent: f64,
}

impl CutLaw {
    /// Load of a depth in mm and a feed in mm/rev; 0 where either is not positive. Real-time safe.
    #[must_use]
    pub fn load(&self, depth_mm: f64, feed_mm_rev: f64) -> f64 {
        if depth_mm > 0.0 && feed_mm_rev > 0.0 {
            self.coefficient
                * libm::pow(depth_mm, self.depth_exponent)
                * libm::pow(feed_mm_rev, self.feed_exponent)
        } else {
            0.0
        }
    }

    /// Feed in mm/rev at which a depth gives a load: the paper's equation (1). Real-time safe.
    #[must_use]
    pub fn feed_mm_rev(&self, load: f64, depth_mm: f64) -> f64 {
        let at_one = self.coefficient * libm::pow(depth_mm.max(0.0), self.depth_exponent);
        libm::pow(load / at_one, 1.0 / self.feed_exponent)
    }

    /// Depth in mm at which a feed gives a load: the paper's equation (2). Real-time safe.
    #[must_use]
    pub fn depth_mm(&self, load: f64, feed_mm_rev: f64) -> f64 {
        if load <= 0.0 {
            return 0.0;
        }
        let at_one = self.coefficient * libm::pow(feed_mm_rev.max(0.0), self.feed_exponent);
        libm::pow(load / at_one, 1.0 / self.depth_exponent)
    }

    /// `xz/yz`: the effect of depth relative to that of feed.
    #[must_use]
    pub fn exponent_ratio(&self) -> f64 {
        self.depth_exponent / self.feed_exponent
    }

    /// Whether the law is valid: finite, positive coefficient, exponents above 0.05 and at most 3.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        let exponents = [self.depth_exponent, self.feed_exponent];
        self.coefficient.is_finite()
            && self.coefficient > 0.0
            && exponents
                .iter()
                .all(|exponent| *exponent > 0.05 && *exponent <= 3.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_inverses_undo_the_law() {
        let law = CutLaw {
            coefficient: 1467.0,
            depth_exponent: 0.9,
            feed_exponent: 0.75,
        };
        for depth in [0.1, 1.0, 4.0] {
            for feed in [0.05, 0.2, 0.7] {
                let load = law.load(depth, feed);
                assert!((law.feed_mm_rev(load, depth) / feed - 1.0).abs() < 1e-12);
                assert!((law.depth_mm(load, feed) / depth - 1.0).abs() < 1e-12);
            }
        }
        assert_eq!(law.load(0.0, 0.3), 0.0);
        assert_eq!(law.load(f64::NAN, 0.3), 0.0);
        assert_eq!(law.depth_mm(-5.0, 0.3), 0.0);
    }
}
