//! Divides segments where the speed changes in a step.
//!
//! The optimizer's intervals are fine at the ends of lines and coarse in between, in proportion to the
//! length. Within one interval the third derivative is constant, so at the joint of a slow block with a long
//! fast one, a coarse interval limits the rise of the speed. In a line of 20 mm at 600 mm/min after one at 10
//! mm/min, the change took 2 mm and 0.5 s instead of 0.1 mm and 0.03 s. There the fast segment is divided a
//! little after the position where its speed is reached, and the short part has its own intervals.

use evolvent_machine::Limits;
use evolvent_path::{Curve, Feed};
use evolvent_smooth::PathSegment;

/// Length of the short part as a multiple of the distance over which the speed changes.
const LENGTH_FACTOR: f64 = 2.0;
/// Duration of a change of speed below which no finer intervals are needed, s.
const MIN_CHANGE_S: f64 = 2e-3;
/// Minimum ratio of the remainder to the short parts: the intervals of a shorter segment are fine enough
/// without a division.
const MIN_REMAINDER: f64 = 2.0;

/// Keeps the maximum speed at the end of the previous segment.
#[derive(Debug)]
pub(crate) struct SpeedStep {
    limits: Limits,
    /// Speed of the parameter, per s; `None` where the path stops.
    before: Option<f64>,
}

impl SpeedStep {
    pub(crate) fn new(limits: &Limits) -> Self {
        Self {
            limits: *limits,
            before: None,
        }
    }

    /// The parts of the next segment in order. `after`: the maximum speed of the parameter after it, per s,
    /// if known.
    pub(crate) fn divide(
        &mut self,
        segment: &PathSegment,
        after: Option<f64>,
    ) -> impl Iterator<Item = PathSegment> + use<> {
        let before = self.before.replace(self.end_speed(segment));
        let lengths = match segment.curve {
            // Spline pieces are short, and involutes are divided by their roll angle.
            Curve::Line(_) | Curve::Arc(_) => {
                let part = |slow: Option<f64>, at: f64| {
                    slow.map_or(0.0, |slow| {
                        LENGTH_FACTOR * self.transition_length(segment, slow, at)
                    })
                };
                [
                    part(before, segment.from),
                    part(after, segment.from + segment.length),
                ]
            }
            _ => [0.0; 2],
        };
        let middle = segment.length - lengths[0] - lengths[1];
        let lengths = if middle >= MIN_REMAINDER * (lengths[0] + lengths[1]) {
            lengths
        } else {
            [0.0; 2]
        };
        let ends = [lengths[0], segment.length - lengths[1], segment.length];
        let whole = *segment;
        let mut from = 0.0;
        ends.into_iter().filter_map(move |end| {
            let part = PathSegment {
                from: whole.from + from,
                length: end - from,
                joint: whole.joint && from == 0.0,
                ..whole
            };
            from = end;
            (part.length > 0.0).then_some(part)
        })
    }

    /// Limits the speed of the parameter here, per s, independent of any feed; 0 is a stop.
    pub(crate) fn cap(&mut self, speed_u_s: f64) {
        self.before = match self.before {
            Some(before) if speed_u_s > 0.0 => Some(before.min(speed_u_s)),
            _ => None,
        };
    }

    /// The maximum speed of the parameter at the start of a segment, per s.
    pub(crate) fn start_speed(&self, segment: &PathSegment) -> f64 {
        self.speed(segment, segment.from)
    }

    fn end_speed(&self, segment: &PathSegment) -> f64 {
        self.speed(segment, segment.from + segment.length)
    }

    fn speed(&self, segment: &PathSegment, at: f64) -> f64 {
        let first = segment.curve.jet(at).first;
        let feed = Feed {
            mm_s: segment.feed_mm_s,
            metric: Some(segment.metric),
        };
        feed.parameter_speed(&first)
            .min(self.limits.velocity_along(&first))
    }

    /// The distance, in the parameter, over which the speed rises from `slow` to that of the segment at `at`,
    /// or falls from it, along a line.
    fn transition_length(&self, segment: &PathSegment, slow: f64, at: f64) -> f64 {
        let first = segment.curve.jet(at).first;
        let fast = self.speed(segment, at);
        let change = fast - slow;
        // The law at a stop is different, and a small step needs no finer intervals.
        if !(slow > 0.0 && change > 0.1 * fast) {
            return 0.0;
        }
        let (acceleration, jerk) = (
            self.limits.acceleration_along(&first),
            self.limits.jerk_along(&first),
        );
        let seconds = if change * jerk <= acceleration * acceleration {
            2.0 * (change / jerk).sqrt()
        } else {
            change / acceleration + acceleration / jerk
        };
        let length = 0.5 * (slow + fast) * seconds;
        // A change within a few periods costs almost nothing if it is made more slowly.
        if length.is_finite() && seconds > MIN_CHANGE_S {
            length
        } else {
            0.0
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::expect_used, reason = "a test may fail")]

    use evolvent_path::{FeedMetric, Line};

    use super::*;
    use crate::recorder::{equal_axes, point};

    fn line(from: f64, to: f64, feed_mm_s: f64) -> PathSegment {
        let line = Line::new(point(from, 0.0), point(to, 0.0)).expect("a line");
        let curve = Curve::Line(line);
        PathSegment {
            curve,
            from: 0.0,
            length: curve.domain(),
            feed_mm_s,
            metric: FeedMetric::Xyz,
            rapid: false,
            blend: false,
            joint: true,
        }
    }

    /// Lengths of the parts of each segment; they cover it without a gap, and a joint stays at its start.
    fn lengths(segments: &[PathSegment]) -> Vec<Vec<f64>> {
        let mut step = SpeedStep::new(&equal_axes(500.0, 5000.0, 200_000.0));
        let mut all = Vec::new();
        for (index, segment) in segments.iter().enumerate() {
            let after = segments.get(index + 1).map(|next| step.start_speed(next));
            let parts: Vec<_> = step.divide(segment, after).collect();
            let mut at = segment.from;
            for (number, part) in parts.iter().enumerate() {
                assert_eq!(part.from, at, "no gap");
                assert_eq!(part.joint, number == 0);
                at += part.length;
            }
            assert!((at - segment.from - segment.length).abs() < 1e-12);
            all.push(parts.iter().map(|part| part.length).collect());
        }
        all
    }

    #[test]
    fn the_faster_segment_is_divided_near_the_slower() {
        let found = lengths(&[
            line(0.0, 20.0, 1.0),
            line(20.0, 40.0, 10.0),
            line(40.0, 60.0, 2.0),
        ]);
        assert_eq!(found[0].len(), 1);
        // From 1 to 10 mm/s within the jerk limit takes 2 sqrt(9 / 200 000) s, at 5.5 mm/s on average; twice
        // that.
        let [begin, _, end] = found[1][..] else {
            unreachable!("{found:?}")
        };
        assert!(
            (begin - 2.0 * 5.5 * 2.0 * (9.0_f64 / 200_000.0).sqrt()).abs() < 1e-12,
            "{begin}"
        );
        assert!(
            (end - 2.0 * 6.0 * 2.0 * (8.0_f64 / 200_000.0).sqrt()).abs() < 1e-12,
            "{end}"
        );
        assert_eq!(found[2].len(), 1);
    }

    #[test]
    fn small_steps_and_short_segments_are_not_divided() {
        for segments in [
            [line(0.0, 20.0, 10.0), line(20.0, 40.0, 10.5)],
            [line(0.0, 20.0, 1.0), line(20.0, 20.2, 10.0)],
            // 0.26 ms.
            [line(0.0, 20.0, 0.016), line(20.0, 40.0, 0.02)],
        ] {
            assert_eq!(lengths(&segments)[1].len(), 1);
        }
    }

    #[test]
    fn divides_after_joint_limits_but_not_after_stops() {
        let mut step = SpeedStep::new(&equal_axes(500.0, 5000.0, 200_000.0));
        let segment = line(0.0, 20.0, 100.0);
        assert_eq!(step.divide(&segment, None).count(), 1, "the first");
        step.cap(3.0);
        assert_eq!(step.divide(&segment, None).count(), 2);
        step.cap(0.0);
        assert_eq!(step.divide(&segment, None).count(), 1);
    }
}
