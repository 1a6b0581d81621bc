//! One interval between two stations, with what limits the motion there.

use evolvent_path::{AXES, Axes, Curve, Jet, feed_rate};

use crate::limits::PathLimits;

/// Largest turn of the tangent within one interval, rad.
const TURN: f64 = 0.1;
/// Fewest and most intervals of a curved stretch.
const CURVED: (f64, f64) = (16.0, 2000.0);
/// The same of a piece of a spline between two knots: a window must reach over many of them. Do not raise: with 12
/// instead of 3, windows no longer cover a stopping distance and programs take a fifth longer. With 4 they are no
/// faster, and planning costs a quarter more.
const SPLINE: (f64, f64) = (3.0, 12.0);
/// Intervals of a line, and the factor by which they grow from its ends to its middle.
const STRAIGHT: f64 = 10.0;
const GROWTH: f64 = 1.5;
/// Places at which the metric of a curve is looked at.
const SPEEDS: u32 = 8;

/// A part of a curve with its feed.
#[derive(Clone, Debug)]
pub(crate) struct Stretch {
    pub(crate) curve: Curve,
    pub(crate) from: f64,
    pub(crate) feed: f64,
}

/// Derivatives at one point of an interval and the highest speeds there.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Point {
    pub(crate) first: Axes,
    pub(crate) second: Axes,
    pub(crate) third: Axes,
    /// Highest parameter speed by the axes' velocity and the chord error.
    pub(crate) speed: f64,
    /// Highest parameter speed by the feed word.
    pub(crate) feed: f64,
}

/// One interval.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cell {
    pub(crate) stretch: u64,
    /// Offset of the start from the stretch's.
    pub(crate) from: f64,
    pub(crate) length: f64,
    /// Start, middle and end, each with the derivatives that the curve of this stretch has there.
    pub(crate) points: [Point; 3],
    /// Highest parameter speed at the end, by the rule for joints.
    pub(crate) joint: f64,
}

impl Stretch {
    /// Start and width of each interval that the stretch is cut into.
    pub(crate) fn cuts(&self, length: f64) -> impl Iterator<Item = (f64, f64)> + use<> {
        let straight = matches!(self.curve, Curve::Line(_));
        let count = if straight {
            STRAIGHT
        } else {
            let speed = |k: u32| {
                let jet = self
                    .curve
                    .jet(self.from + length * f64::from(k) / f64::from(SPEEDS));
                jet.first.norm()
            };
            let slow = (0..=SPEEDS).map(speed).fold(f64::INFINITY, f64::min);
            let (first, second, _) = self.curve.derivative_bounds(self.from, self.from + length);
            let fast = first.norm().max(1e-12);
            // Where a curve nearly turns back on the spot, all happens in a short part of it.
            let turn = second.norm() / fast * length / (slow / fast).clamp(0.3, 1.0);
            let (least, most) = if matches!(self.curve, Curve::Spline(_)) {
                SPLINE
            } else {
                CURVED
            };
            (turn / TURN).ceil().clamp(least, most)
        };
        // Sizes 1, g, g^2 ... from both ends on lines, equal ones on curves.
        let growth: f64 = if straight { GROWTH } else { 1.0 };
        let size = move |k: u32| {
            let n = count as u32;
            // Products, since how powi rounds is the compiler's business.
            (0..k.min(n - 1 - k)).fold(1.0, |size, _| size * growth)
        };
        let total: f64 = (0..count as u32).map(size).sum();
        let mut at = 0.0;
        (0..count as u32).map(move |k| {
            let start = at;
            at = if f64::from(k + 1) >= count {
                length
            } else {
                at + length * size(k) / total
            };
            (start, at - start)
        })
    }
}

impl Cell {
    /// The interval of `length` at the offset `from` of `stretch`, whose index is `index`.
    pub(crate) fn new(stretch: &Stretch, index: u64, from: f64, length: f64, limits: &PathLimits) -> Self {
        let point = |x: f64| Point::of(stretch, x, limits);
        Self {
            stretch: index,
            from,
            length,
            points: [point(from), point(from + 0.5 * length), point(from + length)],
            joint: f64::INFINITY,
        }
    }
}

impl Point {
    /// The point at an offset from the start of a stretch.
    pub(crate) fn of(stretch: &Stretch, offset: f64, limits: &PathLimits) -> Self {
        Self::new(&stretch.curve.jet(stretch.from + offset), stretch.feed, limits)
    }

    fn new(jet: &Jet, feed: f64, limits: &PathLimits) -> Self {
        let axes = limits.axes();
        let mut speed = limits.chord_speed(&jet.second);
        for i in 0..AXES {
            if axes.present[i] {
                speed = speed.min(axes.velocity[i] / jet.first[i].abs());
            }
        }
        Self {
            first: jet.first,
            second: jet.second,
            third: jet.third,
            speed,
            feed: feed / feed_rate(&jet.first),
        }
    }

    /// Highest parameter speed with the feeds times `factor`; rapids are not scaled.
    pub(crate) fn cap(&self, factor: f64) -> f64 {
        self.speed.min(self.feed * factor)
    }
}
