//! The latest revolutions of a cut: what is known of it if its load goes away.

/// The smallest factor and the deepest cut of a stretch of time.
#[derive(Clone, Copy, Debug)]
struct Span {
    min_factor: f64,
    deepest: f64,
}

impl Span {
    const EMPTY: Self = Self {
        min_factor: f64::INFINITY,
        deepest: 0.0,
    };
}

/// The extremes of the last one to two spans of a cut. Real-time safe.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RecentCut {
    span_s: f64,
    age_s: f64,
    before: Span,
    present: Span,
}

impl RecentCut {
    /// Without a cut. A span should cover the time in which a load that is gone fades from the readings.
    pub(crate) fn new(span_s: f64) -> Self {
        Self {
            span_s,
            age_s: 0.0,
            before: Span::EMPTY,
            present: Span::EMPTY,
        }
    }

    /// Adds a cycle of a cut: the factor of the feed, and the load at the programmed feed.
    pub(crate) fn add(&mut self, factor: f64, depth: f64, period_s: f64) {
        let present = &mut self.present;
        present.min_factor = present.min_factor.min(factor);
        present.deepest = present.deepest.max(depth);
        self.age_s += period_s;
        if self.age_s >= self.span_s {
            (self.age_s, self.before, self.present) = (0.0, self.present, Span::EMPTY);
        }
    }

    /// The smallest factor; infinite without a cut.
    pub(crate) fn min_factor(&self) -> f64 {
        self.before.min_factor.min(self.present.min_factor)
    }

    /// The largest load at the programmed feed.
    pub(crate) fn deepest(&self) -> f64 {
        self.before.deepest.max(self.present.deepest)
    }

    /// Discards the cut.
    pub(crate) fn clear(&mut self) {
        *self = Self::new(self.span_s);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn extremes_last_for_one_to_two_spans() {
        let mut cut = RecentCut::new(1.0);
        assert_eq!((cut.min_factor(), cut.deepest()), (f64::INFINITY, 0.0));
        cut.add(0.5, 7.0, 0.25);
        for k in 1..=8 {
            cut.add(0.9, 3.0, 0.25);
            let known = (cut.min_factor(), cut.deepest());
            // The span of the first cycle ends after three more, the next one four later.
            let expected = if k < 7 { (0.5, 7.0) } else { (0.9, 3.0) };
            assert_eq!(known, expected, "{k}");
        }
        cut.clear();
        assert_eq!(cut.deepest(), 0.0);
    }
}
