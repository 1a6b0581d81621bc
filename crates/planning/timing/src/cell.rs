//! One interval between two stations, with what limits the motion there.

use evolvent_path::{AXES, Axes, Curve, Involute, Jet, feed_rate};

use crate::limits::PathLimits;

/// Largest turn of the tangent within one interval, rad.
const TURN: f64 = 0.1;
/// Fewest and most intervals of a curved stretch.
const CURVED: (f64, f64) = (16.0, 2000.0);
/// The same of a piece of a spline between two knots: a window must reach over many of them. Do not raise: with 12
/// instead of 3, windows no longer cover a stopping distance and programs take a fifth longer. With 4 they are no
/// faster, and planning costs a quarter more.
const SPLINE: (f64, f64) = (3.0, 12.0);
/// Largest roll angle of one interval of an involute, rad, and fewest and most intervals. With 0.1 instead of 0.05 the
/// axes share their limits worse, and three holes take 3 % longer; with 0.035 they take 0.3 % less and 0.1 % more.
const ROLL: f64 = 0.05;
const ROLLS: (f64, f64) = (16.0, 4000.0);
/// An involute that is shorter than this share of the whole is cut evenly: its ends' roll angles differ by rounding.
const SHORT: f64 = 1e-6;
/// Intervals of a line, and the factor by which they grow from its ends to its middle.
const STRAIGHT: u32 = 10;
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
    pub(crate) fn cuts(&self, length: f64) -> impl Iterator<Item = (f64, f64)> {
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
            // Its curvature has no bound at the base circle, so equal lengths would be by far too short elsewhere.
            Curve::Involute(involute) if length > SHORT * self.curve.domain() => {
                let roll = |x: f64| involute.roll_angle_rad(self.from + x);
                let (first, last) = (roll(0.0), roll(length));
                let count = ((last - first).abs() / ROLL).ceil().clamp(ROLLS.0, ROLLS.1) as u32;
                Division::Rolls {
                    count,
                    first,
                    each: (last - first) / f64::from(count),
                    from: self.from,
                    involute,
                }
            }
            _ => Division::Equal(self.turns(length)),
        }
    }

    /// In how many equal intervals a curve is cut.
    fn turns(&self, length: f64) -> u32 {
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
        (turn / TURN).ceil().clamp(least, most) as u32
    }
}

/// How a stretch is cut.
enum Division<'a> {
    /// Lengths in the proportion 1, g, g^2 ... from both ends.
    Graded,
    /// So many equal lengths.
    Equal(u32),
    /// Equal roll angles.
    Rolls {
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
            Self::Graded => STRAIGHT,
            Self::Equal(count) | Self::Rolls { count, .. } => *count,
        }
    }

    /// Where interval `k` ends that begins at `start`, of all within `length`.
    fn end(&self, k: u32, start: f64, length: f64) -> f64 {
        if k + 1 >= self.count() {
            return length;
        }
        match self {
            Self::Graded => {
                // Products, since how powi rounds is the compiler's business.
                let size = |k: u32| (0..k.min(STRAIGHT - 1 - k)).fold(1.0, |size, _| size * GROWTH);
                start + length * size(k) / (0..STRAIGHT).map(size).sum::<f64>()
            }
            Self::Equal(count) => start + length / f64::from(*count),
            Self::Rolls {
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

#[cfg(test)]
mod tests {
    #![allow(clippy::expect_used, reason = "a test may fail")]

    use evolvent_path::{Plane, Sense};

    use super::*;

    /// Out from the base circle and back, and a part from the middle.
    #[test]
    fn an_involute_is_cut_where_the_tangent_has_turned_by_equal_angles() {
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
                let stretch = Stretch {
                    curve,
                    from,
                    feed: 1.0,
                };
                let cuts: Vec<_> = stretch.cuts(length).collect();
                let direction = |x: f64| {
                    let first = curve.jet(from + x).first;
                    libm::atan2(first[1], first[0])
                };
                let turns: Vec<f64> = (cuts.iter())
                    .map(|(x, width)| {
                        let turn = (direction(x + width) - direction(*x)).abs();
                        turn.min(std::f64::consts::TAU - turn)
                    })
                    .collect();
                let mean = turns.iter().sum::<f64>() / turns.len() as f64;
                assert!(
                    turns.len() >= 16 && mean <= ROLL * (1.0 + 1e-9),
                    "{} of {mean}",
                    turns.len()
                );
                assert!(turns.iter().all(|turn| (turn - mean).abs() < 1e-6), "{turns:?}");
                // One after the other, to the end.
                let mut at = 0.0;
                for (x, width) in &cuts {
                    assert!(*x == at && *width > 0.0);
                    at = x + width;
                }
                assert!((at - length).abs() <= 1e-12 * length);
            }
        }
    }
}
