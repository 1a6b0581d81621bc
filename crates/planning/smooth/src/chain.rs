//! The programmed path that is known, link by link.

use std::collections::VecDeque;

use evolvent_path::{Axes, Curve, Jet};

use crate::Block;

/// One block on the path.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ProgramSegment {
    /// Path parameter at its start and end, counted from the section's start.
    pub(crate) from: f64,
    pub(crate) to: f64,
    pub(crate) curve: Curve,
    pub(crate) feed: f64,
    pub(crate) rapid: bool,
    /// Greatest distance from it, 0 where it is kept.
    pub(crate) tolerance: f64,
    /// Whether it is straight, and then its start and direction.
    pub(crate) straight: bool,
    start: Axes,
    slope: Axes,
    /// Whether the joint at its start has to be eased.
    pub(crate) smoothed: bool,
    /// Whether it is kept as programmed instead, since easing it failed; the speed at which it may then be passed, and
    /// whether that is still to be said.
    pub(crate) kept: bool,
    pub(crate) exact_speed: f64,
    pub(crate) unsaid: bool,
    /// Whether the path turns sharply at its start, by more than 120 degrees.
    pub(crate) sharp: bool,
    /// Knot spacing at its start, as far as it is settled; and the largest inside.
    pub(crate) spacing: f64,
    pub(crate) inner_spacing: f64,
}

impl ProgramSegment {
    pub(crate) fn new(block: &Block, from: f64) -> Self {
        let curve = block.curve;
        let jet = curve.jet(0.0);
        Self {
            from,
            to: from + curve.domain(),
            curve,
            feed: block.feed,
            rapid: block.rapid,
            tolerance: block.tolerance.mm(),
            straight: matches!(curve, Curve::Line(_)),
            start: jet.position,
            slope: jet.first,
            smoothed: false,
            kept: false,
            exact_speed: 0.0,
            unsaid: false,
            sharp: false,
            spacing: f64::INFINITY,
            inner_spacing: f64::INFINITY,
        }
    }

    /// Position; beyond the ends, straight on.
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

    /// Whether the path bends at its start.
    pub(crate) fn corner(&self) -> bool {
        self.smoothed || self.kept
    }

    /// First point.
    pub(crate) fn start(&self) -> &Axes {
        &self.start
    }

    /// Direction at the start of a straight link.
    pub(crate) fn slope(&self) -> &Axes {
        &self.slope
    }

    pub(crate) fn jet(&self, u: f64) -> Jet {
        self.curve.jet(u - self.from)
    }
}

/// The links from a little before the place up to which the path has come out.
///
/// Links have numbers that stay when links before them are forgotten.
#[derive(Debug, Default)]
pub(crate) struct Chain {
    links: VecDeque<ProgramSegment>,
    first: usize,
    /// Bound of the knot spacing at the end of the last link.
    pub(crate) end_spacing: f64,
}

impl Chain {
    pub(crate) fn clear(&mut self) {
        self.links.clear();
        self.first = 0;
        self.end_spacing = f64::INFINITY;
    }

    pub(crate) fn push(&mut self, link: ProgramSegment) {
        self.links.push_back(link);
    }

    /// Number of the first link that is kept.
    pub(crate) fn first(&self) -> usize {
        self.first
    }

    /// Number that the next link gets.
    pub(crate) fn next(&self) -> usize {
        self.first + self.links.len()
    }

    pub(crate) fn get(&self, number: usize) -> Option<&ProgramSegment> {
        self.links.get(number.checked_sub(self.first)?)
    }

    pub(crate) fn get_mut(&mut self, number: usize) -> Option<&mut ProgramSegment> {
        self.links.get_mut(number.checked_sub(self.first)?)
    }

    /// Parameter up to which the path is known.
    pub(crate) fn end(&self) -> f64 {
        self.links.back().map_or(0.0, |link| link.to)
    }

    /// Number of the link at a parameter: at a joint the one that begins there; before and behind all, the nearest.
    pub(crate) fn find(&self, u: f64) -> usize {
        let behind = self.links.partition_point(|link| link.from <= u);
        self.first + behind.max(1) - 1
    }

    /// The same, searched from a link nearby: in time that grows with the logarithm of how far it is away.
    pub(crate) fn find_near(&self, u: f64, near: usize) -> usize {
        let last = self.links.len().saturating_sub(1);
        let near = near.saturating_sub(self.first).min(last);
        let behind = |k: usize| self.links.get(k).is_some_and(|link| link.from <= u);
        // The link sought is in `low..high`.
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
            .map_or_else(Axes::zeros, |link| link.position(u))
    }

    /// Forgets links that end before `u`, but for the last.
    pub(crate) fn forget(&mut self, u: f64) {
        while self.links.len() > 1 && self.links.front().is_some_and(|link| link.to < u) {
            self.links.pop_front();
            self.first += 1;
        }
    }
}

/// The largest of the XYZ distance, the UVW distance and each rotary angle: what a tolerance is compared with.
pub(crate) fn distance(d: &Axes) -> f64 {
    let norm = |i: usize| (d[i] * d[i] + d[i + 1] * d[i + 1] + d[i + 2] * d[i + 2]).sqrt();
    norm(0)
        .max(norm(6))
        .max(d[3].abs())
        .max(d[4].abs())
        .max(d[5].abs())
}
