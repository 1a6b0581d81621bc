//! Joins collinear lines.
//!
//! Programs divide straight moves into pieces, and every piece would need its own stations. Pieces with equal
//! direction and feed become one line; marks still distinguish the blocks.

use evolvent_path::{Axes, Curve, Line};
use evolvent_smooth::PathSegment;

/// Maximum total distance of dropped vertices from the joined line, mm or degrees: rounding.
const MAX_OFFSET: f64 = 1e-9;

/// Joins segments. The last one is held until it is known whether the next continues it.
#[derive(Debug, Default)]
pub(crate) struct Straightener {
    held: Option<PathSegment>,
    /// Distance of the vertices of the held line so far.
    offset: f64,
}

impl Straightener {
    /// Appends a segment; returns the previous one if it is complete.
    pub(crate) fn push(&mut self, next: PathSegment) -> Option<PathSegment> {
        if let Some(held) = &self.held
            && let Some((joined, offset)) = join(held, &next)
            && self.offset + offset <= MAX_OFFSET
        {
            self.offset += offset;
            self.held = Some(joined);
            return None;
        }
        self.offset = 0.0;
        self.held.replace(next)
    }

    /// Returns the held segment, which nothing can join any more.
    pub(crate) fn flush(&mut self) -> Option<PathSegment> {
        self.offset = 0.0;
        self.held.take()
    }
}

/// Both segments as one, and the distance of their joint from it.
fn join(left: &PathSegment, right: &PathSegment) -> Option<(PathSegment, f64)> {
    let (Curve::Line(_), Curve::Line(_)) = (&left.curve, &right.curve) else {
        return None;
    };
    let alike = left.feed_mm_s == right.feed_mm_s
        && left.metric == right.metric
        && left.rapid == right.rapid
        && left.blend == right.blend
        && !right.joint
        && (left.curve.jet(0.0).first - right.curve.jet(0.0).first).amax() <= 1e-6;
    if !alike {
        return None;
    }
    let start = left.curve.position(left.from);
    let joint = right.curve.position(right.from);
    let end = right.curve.position(right.from + right.length);
    let line = Line::new(start, end).ok()?;
    let length = left.length + right.length;
    let curve = Curve::Line(line);
    // The marks of blocks refer to the parameter, which must not change.
    if (curve.domain() - length).abs() > MAX_OFFSET {
        return None;
    }
    let offset = distance_from_line(&start, &end, &joint)?;
    let joined = PathSegment {
        curve,
        from: 0.0,
        length: curve.domain(),
        ..*left
    };
    Some((joined, offset))
}

fn distance_from_line(start: &Axes, end: &Axes, point: &Axes) -> Option<f64> {
    let (along, to) = (end - start, point - start);
    let fraction = along.dot(&to) / along.norm_squared();
    let offset = (to - along * fraction).amax();
    (offset.is_finite() && (0.0..=1.0).contains(&fraction)).then_some(offset)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::expect_used, reason = "a test may fail")]

    use evolvent_path::FeedMetric;

    use super::*;
    use crate::recorder::point;

    fn segment(from: (f64, f64), to: (f64, f64), feed: f64) -> PathSegment {
        let line = Line::new(point(from.0, from.1), point(to.0, to.1)).expect("line");
        let curve = Curve::Line(line);
        PathSegment {
            curve,
            from: 0.0,
            length: curve.domain(),
            feed_mm_s: feed,
            metric: FeedMetric::Xyz,
            rapid: false,
            blend: false,
            joint: false,
        }
    }

    #[test]
    fn a_thousand_pieces_of_a_line_are_joined() {
        let mut straightener = Straightener::default();
        for k in 0..1000 {
            let at = |k: i32| (0.0254 * f64::from(k), 0.01 * f64::from(k));
            assert!(
                straightener.push(segment(at(k), at(k + 1), 50.0)).is_none(),
                "{k}"
            );
        }
        let whole = straightener.flush().expect("line");
        assert!((whole.curve.end() - point(25.4, 10.0)).amax() < 1e-12);
        assert!((whole.length - 25.4_f64.hypot(10.0)).abs() < 1e-9);
        assert!(straightener.flush().is_none());
    }

    #[test]
    fn only_collinear_lines_of_equal_feed_are_joined() {
        let first = segment((0.0, 0.0), (10.0, 0.0), 50.0);
        let mut joint = segment((10.0, 0.0), (20.0, 0.0), 50.0);
        joint.joint = true;
        for next in [
            segment((10.0, 0.0), (20.0, 1e-5), 50.0),
            segment((10.0, 0.0), (5.0, 0.0), 50.0),
            segment((10.0, 0.0), (20.0, 0.0), 50.1),
            joint,
        ] {
            let mut straightener = Straightener::default();
            assert!(straightener.push(first).is_none());
            assert_eq!(straightener.push(next), Some(first));
            assert_eq!(straightener.flush(), Some(next));
        }
    }

    #[test]
    fn small_rotations_do_not_accumulate() {
        // A circle of 100 m radius in chords of 10 um, each rotated by 1e-10.
        let at = |k: i32| {
            let angle = 1e-7 * 1e-3 * f64::from(k);
            (1e5 * angle.sin(), 1e5 * (1.0 - angle.cos()))
        };
        let mut straightener = Straightener::default();
        let mut lines = 0;
        for k in 0..2000 {
            if let Some(line) = straightener.push(segment(at(k), at(k + 1), 50.0)) {
                let chord = line.length;
                assert!(chord * chord / 8.0 / 1e5 <= 2.0 * MAX_OFFSET, "{chord}");
                lines += 1;
            }
        }
        assert!(lines > 0, "all one line");
    }
}
