//! The known programmed path, as a chain of program segments.

use std::collections::VecDeque;

use evolvent_path::{Axes, Curve, FeedMetric, Jet};

use crate::ProgramMove;

/// One block on the path.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ProgramSegment {
    /// Path parameter at its start and end, from the start of the section.
    pub(crate) from: f64,
    pub(crate) to: f64,
    pub(crate) curve: Curve,
    pub(crate) feed_mm_s: f64,
    /// The axes to which the feed refers.
    pub(crate) metric: FeedMetric,
    pub(crate) rapid: bool,
    /// Maximum deviation, 0 if it is kept.
    pub(crate) tolerance: f64,
    /// Whether it is straight; if so, its start and direction.
    pub(crate) straight: bool,
    start: Axes,
    slope: Axes,
    /// Whether the joint at its start has to be smoothed.
    pub(crate) smoothed: bool,
    /// Whether that joint is kept as programmed because smoothing has failed; the speed at which it may then
    /// be passed, and whether that is still to be output.
    pub(crate) kept: bool,
    pub(crate) exact_speed: f64,
    pub(crate) cap_pending: bool,
    /// Whether the path turns by more than 120 degrees at its start.
    pub(crate) sharp: bool,
    /// Knot spacing at its start, as far as it is determined; and the maximum inside.
    pub(crate) spacing: f64,
    pub(crate) inner_spacing: f64,
}

impl ProgramSegment {
    pub(crate) fn new(block: &ProgramMove, from: f64) -> Self {
        let curve = block.curve;
        let jet = curve.jet(0.0);
        Self {
            from,
            to: from + curve.domain(),
            curve,
            feed_mm_s: block.feed_mm_s,
            metric: FeedMetric::of(&jet.first).unwrap_or(FeedMetric::Xyz),
            rapid: block.rapid,
            tolerance: block.tolerance.mm(),
            straight: matches!(curve, Curve::Line(_)),
            start: jet.position,
            slope: jet.first,
            smoothed: false,
            kept: false,
            exact_speed: 0.0,
            cap_pending: false,
            sharp: false,
            spacing: f64::INFINITY,
            inner_spacing: f64::INFINITY,
        }
    }

    /// Position; beyond the ends the segment is extended linearly.
    pub(crate) fn position(&self, u: f64) -> Axes {
        let x = u - self.from;
        if self.straight || x < 0.0 {
            self.start + self.slope * x
        } else if u > self.to {
            let jet = self.curve.jet(self.curve.domain());
            jet.position + jet.first * (u - self.to)
        } else {
            self.curve.position(x)
        }
    }

    /// Whether the path has a corner at its start.
    pub(crate) fn corner(&self) -> bool {
        self.smoothed || self.kept
    }

    /// Whether another segment is driven with the same feed.
    pub(crate) fn has_feed_of(&self, other: &Self) -> bool {
        (self.feed_mm_s, self.metric, self.rapid) == (other.feed_mm_s, other.metric, other.rapid)
    }

    /// The start point.
    pub(crate) fn start(&self) -> &Axes {
        &self.start
    }

    /// Direction at the start of a straight segment.
    pub(crate) fn slope(&self) -> &Axes {
        &self.slope
    }

    pub(crate) fn jet(&self, u: f64) -> Jet {
        self.curve.jet(u - self.from)
    }
}

/// The program segments from shortly before the position up to which the path has been output.
///
/// Segment numbers stay valid when earlier segments are dropped.
#[derive(Debug, Default)]
pub(crate) struct Chain {
    segments: VecDeque<ProgramSegment>,
    first: usize,
    /// Limit of the knot spacing at the end of the last segment.
    pub(crate) end_spacing: f64,
}

impl Chain {
    pub(crate) fn clear(&mut self) {
        self.segments.clear();
        self.first = 0;
        self.end_spacing = f64::INFINITY;
    }

    pub(crate) fn push(&mut self, segment: ProgramSegment) {
        self.segments.push_back(segment);
    }

    /// Number of the first segment that is still stored.
    pub(crate) fn first(&self) -> usize {
        self.first
    }

    /// Number of the next segment.
    pub(crate) fn next(&self) -> usize {
        self.first + self.segments.len()
    }

    pub(crate) fn get(&self, number: usize) -> Option<&ProgramSegment> {
        self.segments.get(number.checked_sub(self.first)?)
    }

    pub(crate) fn get_mut(&mut self, number: usize) -> Option<&mut ProgramSegment> {
        self.segments.get_mut(number.checked_sub(self.first)?)
    }

    /// Parameter up to which the path is known.
    pub(crate) fn end(&self) -> f64 {
        self.segments.back().map_or(0.0, |segment| segment.to)
    }

    /// Number of the segment at a parameter: at a joint the one that starts there; outside of the chain the
    /// nearest.
    pub(crate) fn find(&self, u: f64) -> usize {
        let behind = self.segments.partition_point(|segment| segment.from <= u);
        self.first + behind.max(1) - 1
    }

    /// The same, searched from a nearby segment, in time logarithmic in the distance.
    pub(crate) fn find_near(&self, u: f64, near: usize) -> usize {
        let last = self.segments.len().saturating_sub(1);
        let near = near.saturating_sub(self.first).min(last);
        let behind = |k: usize| self.segments.get(k).is_some_and(|segment| segment.from <= u);
        // The segment is in `low..high`.
        let (mut low, mut high, mut reach) = (near, near + 1, 1);
        if behind(near) {
            while behind(high) {
                (low, high) = (high, (high + reach).min(last + 1));
                reach *= 2;
            }
        } else {
            while low > 0 && !behind(low) {
                (low, high) = (low.saturating_sub(reach), low);
                reach *= 2;
            }
        }
        while high - low > 1 {
            let middle = low + (high - low) / 2;
            if behind(middle) {
                low = middle;
            } else {
                high = middle;
            }
        }
        self.first + low
    }

    pub(crate) fn position(&self, u: f64) -> Axes {
        self.get(self.find(u))
            .map_or_else(Axes::zeros, |segment| segment.position(u))
    }

    /// Drops segments that end before `u`, except the last.
    pub(crate) fn forget(&mut self, u: f64) {
        while self.segments.len() > 1 && self.segments.front().is_some_and(|segment| segment.to < u) {
            self.segments.pop_front();
            self.first += 1;
        }
    }
}

/// The maximum of the XYZ distance, the UVW distance and each rotary angle, which is compared with a
/// tolerance.
pub(crate) fn distance(d: &Axes) -> f64 {
    let norm = |i: usize| (d[i] * d[i] + d[i + 1] * d[i + 1] + d[i + 2] * d[i + 2]).sqrt();
    norm(0)
        .max(norm(6))
        .max(d[3].abs())
        .max(d[4].abs())
        .max(d[5].abs())
}
