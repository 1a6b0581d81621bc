//! One interval between two stations, with the limits that apply there.

use evolvent_path::{Axes, Curve, Feed, Involute, Jet};

use crate::limits::PathLimits;

/// Maximum rotation of the tangent within one interval, rad.
const MAX_TANGENT_ANGLE: f64 = 0.1;
/// Minimum and maximum number of intervals of a curved segment.
const CURVE_INTERVALS: (f64, f64) = (16.0, 2000.0);
/// The same for a spline piece between two knots; a window has to span many of them. Tuned: with a maximum of
/// 12 instead of 3 windows no longer cover a stopping distance and programs take 20 % longer; with 4 they are
/// not faster, and planning costs 25 % more.
const SPLINE_INTERVALS: (f64, f64) = (3.0, 12.0);
/// Maximum roll angle of one interval of an involute, rad, and minimum and maximum number of intervals.
/// Tuned: with 0.1 instead of 0.05 three holes take 3 % longer; with 0.035 they take 0.3 % less and 0.1 %
/// more.
const MAX_ROLL_ANGLE: f64 = 0.05;
const INVOLUTE_INTERVALS: (f64, f64) = (16.0, 4000.0);
/// A part of an involute below this fraction of its domain is divided uniformly: the roll angles of its ends
/// differ by rounding only.
const MIN_INVOLUTE_FRACTION: f64 = 1e-6;
/// Number of intervals of a line, and the factor by which they grow from its ends towards its middle.
const LINE_INTERVALS: u32 = 10;
const LINE_GROWTH: f64 = 1.5;
/// Number of points at which the speed of a curve by its parameter is sampled.
const SPEED_SAMPLES: u32 = 8;

/// A path segment: a part of a curve with its feed.
#[derive(Clone, Debug)]
pub(crate) struct PathSegment {
    pub(crate) curve: Curve,
    pub(crate) from: f64,
    pub(crate) feed: Feed,
}

/// Derivatives at one point of an interval and the maximum speeds there.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Point {
    pub(crate) first: Axes,
    pub(crate) second: Axes,
    pub(crate) third: Axes,
    /// Maximum parameter speed by axis velocity and chord error.
    pub(crate) speed_u_s: f64,
    /// Maximum parameter speed by the feed word.
    pub(crate) feed_u_s: f64,
}

/// One interval of the grid.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cell {
    pub(crate) segment: u64,
    /// Offset of its start from the start of the segment.
    pub(crate) from: f64,
    pub(crate) length: f64,
    /// Start, middle and end, each with the derivatives of this segment's curve there.
    pub(crate) points: [Point; 3],
    /// Maximum parameter speed at the end, by the joint rule.
    pub(crate) joint: f64,
}

impl PathSegment {
    /// Start and length of each interval of the segment.
    pub(crate) fn intervals(&self, length: f64) -> impl Iterator<Item = (f64, f64)> {
        let division = self.division(length);
        let mut at = 0.0;
        (0..division.count()).map(move |k| {
            let start = at;
            at = division.end(k, start, length).clamp(start, length);
            (start, at - start)
        })
    }

    fn division(&self, length: f64) -> Division<'_> {
        match &self.curve {
            Curve::Line(_) => Division::Graded,
            // The curvature has no bound at the base circle, so intervals of equal length would be far too
            // short elsewhere.
            Curve::Involute(involute) if length > MIN_INVOLUTE_FRACTION * self.curve.domain() => {
                let roll = |x: f64| involute.roll_angle_rad(self.from + x);
                let (first, last) = (roll(0.0), roll(length));
                let count = ((last - first).abs() / MAX_ROLL_ANGLE)
                    .ceil()
                    .clamp(INVOLUTE_INTERVALS.0, INVOLUTE_INTERVALS.1) as u32;
                Division::RollAngles {
                    count,
                    first,
                    each: (last - first) / f64::from(count),
                    from: self.from,
                    involute,
                }
            }
            _ => Division::Equal(self.interval_count(length)),
        }
    }

    /// Number of equal intervals for a curve.
    fn interval_count(&self, length: f64) -> u32 {
        let speed = |k: u32| {
            let jet = self
                .curve
                .jet(self.from + length * f64::from(k) / f64::from(SPEED_SAMPLES));
            jet.first.norm()
        };
        let slow = (0..=SPEED_SAMPLES).map(speed).fold(f64::INFINITY, f64::min);
        let (first, second, _) = self.curve.derivative_bounds(self.from, self.from + length);
        let fast = first.norm().max(1e-12);
        // Where a curve almost reverses, most of the rotation is in a short part of it.
        let turn = second.norm() / fast * length / (slow / fast).clamp(0.3, 1.0);
        let (min, max) = if matches!(self.curve, Curve::Spline(_)) {
            SPLINE_INTERVALS
        } else {
            CURVE_INTERVALS
        };
        (turn / MAX_TANGENT_ANGLE).ceil().clamp(min, max) as u32
    }
}

/// How a segment is divided.
enum Division<'a> {
    /// Lengths in the ratio 1, g, g^2 ... from both ends.
    Graded,
    /// This number of equal lengths.
    Equal(u32),
    /// Equal roll angles.
    RollAngles {
        count: u32,
        first: f64,
        each: f64,
        from: f64,
        involute: &'a Involute,
    },
}

impl Division<'_> {
    fn count(&self) -> u32 {
        match self {
            Self::Graded => LINE_INTERVALS,
            Self::Equal(count) | Self::RollAngles { count, .. } => *count,
        }
    }

    /// The end of interval `k`, which starts at `start`, in a segment of this length.
    fn end(&self, k: u32, start: f64, length: f64) -> f64 {
        if k + 1 >= self.count() {
            return length;
        }
        match self {
            Self::Graded => {
                // Repeated multiplication, because the rounding of powi depends on the compiler.
                let size =
                    |k: u32| (0..k.min(LINE_INTERVALS - 1 - k)).fold(1.0, |size, _| size * LINE_GROWTH);
                start + length * size(k) / (0..LINE_INTERVALS).map(size).sum::<f64>()
            }
            Self::Equal(count) => start + length / f64::from(*count),
            Self::RollAngles {
                first,
                each,
                from,
                involute,
                ..
            } => involute.parameter_at_roll(first + each * f64::from(k + 1)) - from,
        }
    }
}

impl Cell {
    /// The interval of `length` at the offset `from` of `segment`, whose absolute index is `index`.
    pub(crate) fn new(
        segment: &PathSegment,
        index: u64,
        from: f64,
        length: f64,
        limits: &PathLimits,
    ) -> Self {
        let point = |x: f64| Point::of(segment, x, limits);
        Self {
            segment: index,
            from,
            length,
            points: [point(from), point(from + 0.5 * length), point(from + length)],
            joint: f64::INFINITY,
        }
    }
}

impl Point {
    /// The point at an offset from the start of a segment.
    pub(crate) fn of(segment: &PathSegment, offset: f64, limits: &PathLimits) -> Self {
        Self::new(&segment.curve.jet(segment.from + offset), segment.feed, limits)
    }

    fn new(jet: &Jet, feed: Feed, limits: &PathLimits) -> Self {
        let speed = limits
            .chord_speed(&jet.second)
            .min(limits.axes().velocity_along(&jet.first));
        Self {
            first: jet.first,
            second: jet.second,
            third: jet.third,
            speed_u_s: speed,
            feed_u_s: feed.parameter_speed(&jet.first),
        }
    }

    /// Maximum parameter speed with the feed times `factor`; rapids are not scaled.
    pub(crate) fn cap(&self, factor: f64) -> f64 {
        self.speed_u_s.min(self.feed_u_s * factor)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::expect_used, reason = "a test may fail")]

    use evolvent_path::{Plane, Sense};

    use super::*;

    /// Outwards from the base circle and back, and a part in between.
    #[test]
    fn an_involute_is_divided_at_equal_roll_angles() {
        let (r, phi): (f64, f64) = (0.5, 30.0);
        let (mut near, mut far) = (Axes::zeros(), Axes::zeros());
        near[0] = r;
        (far[0], far[1]) = (
            r * (phi.cos() + phi * phi.sin()),
            r * (phi.sin() - phi * phi.cos()),
        );
        for (start, end, sense) in [
            (near, far, Sense::CounterClockwise),
            (far, near, Sense::Clockwise),
        ] {
            let involute =
                Involute::new(Plane::Xy, start, end, [0.0, 0.0], r, sense, 1e-3).expect("involute");
            let curve = Curve::Involute(involute);
            for (from, length) in [
                (0.0, curve.domain()),
                (0.3 * curve.domain(), 0.01 * curve.domain()),
            ] {
                let segment = PathSegment {
                    curve,
                    from,
                    feed: Feed::from(1.0),
                };
                let intervals: Vec<_> = segment.intervals(length).collect();
                let direction = |x: f64| {
                    let first = curve.jet(from + x).first;
                    libm::atan2(first[1], first[0])
                };
                let interval_count: Vec<f64> = (intervals.iter())
                    .map(|(x, width)| {
                        let turn = (direction(x + width) - direction(*x)).abs();
                        turn.min(std::f64::consts::TAU - turn)
                    })
                    .collect();
                let mean = interval_count.iter().sum::<f64>() / interval_count.len() as f64;
                assert!(
                    interval_count.len() >= 16 && mean <= MAX_ROLL_ANGLE * (1.0 + 1e-9),
                    "{} of {mean}",
                    interval_count.len()
                );
                assert!(
                    interval_count.iter().all(|turn| (turn - mean).abs() < 1e-6),
                    "{interval_count:?}"
                );
                // Contiguous up to the end.
                let mut at = 0.0;
                for (x, width) in &intervals {
                    assert!(*x == at && *width > 0.0);
                    at = x + width;
                }
                assert!((at - length).abs() <= 1e-12 * length);
            }
        }
    }
}
