//! Lines that go straight on, as one.
//!
//! Programs cut straight moves into pieces, and every piece would cost stations of its own. Where direction and feed
//! go on, the pieces are one line; blocks are still told apart by their marks.

use evolvent_path::{Axes, Curve, Line};
use evolvent_smooth::Stretch;

/// How far vertices may lie off the joined line, mm or degrees, all in all: rounding.
const OFF: f64 = 1e-9;

/// Joins stretches; the last one is kept back until it is known that the next does not go straight on.
#[derive(Debug, Default)]
pub(crate) struct Straightener {
    held: Option<Stretch>,
    /// How far vertices of the held line may lie off it.
    off: f64,
}

impl Straightener {
    /// Takes a stretch; returns the one before if that is complete.
    pub(crate) fn push(&mut self, next: Stretch) -> Option<Stretch> {
        if let Some(held) = &self.held
            && let Some((joined, off)) = join(held, &next)
            && self.off + off <= OFF
        {
            self.off += off;
            self.held = Some(joined);
            return None;
        }
        self.off = 0.0;
        self.held.replace(next)
    }

    /// The stretch kept back: nothing can join it any more.
    pub(crate) fn flush(&mut self) -> Option<Stretch> {
        self.off = 0.0;
        self.held.take()
    }
}

/// Both as one, and how far their joint lies off it.
fn join(left: &Stretch, right: &Stretch) -> Option<(Stretch, f64)> {
    let (Curve::Line(_), Curve::Line(_)) = (&left.curve, &right.curve) else {
        return None;
    };
    let alike = left.feed == right.feed
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
    // The marks of blocks count the parameter: it must go on as it was.
    if (curve.domain() - length).abs() > OFF {
        return None;
    }
    let off = off_line(&start, &end, &joint)?;
    let joined = Stretch {
        curve,
        from: 0.0,
        length: curve.domain(),
        ..*left
    };
    Some((joined, off))
}

fn off_line(start: &Axes, end: &Axes, point: &Axes) -> Option<f64> {
    let (along, to) = (end - start, point - start);
    let share = along.dot(&to) / along.norm_squared();
    let off = (to - along * share).amax();
    (off.is_finite() && (0.0..=1.0).contains(&share)).then_some(off)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::expect_used, reason = "a test may fail")]

    use super::*;
    use crate::recorder::point;

    fn stretch(from: (f64, f64), to: (f64, f64), feed: f64) -> Stretch {
        let line = Line::new(point(from.0, from.1), point(to.0, to.1)).expect("line");
        let curve = Curve::Line(line);
        Stretch {
            curve,
            from: 0.0,
            length: curve.domain(),
            feed,
            rapid: false,
            blend: false,
            joint: false,
        }
    }

    #[test]
    fn a_thousand_pieces_of_a_line_are_one() {
        let mut straightener = Straightener::default();
        for k in 0..1000 {
            let at = |k: i32| (0.0254 * f64::from(k), 0.01 * f64::from(k));
            assert!(
                straightener.push(stretch(at(k), at(k + 1), 50.0)).is_none(),
                "{k}"
            );
        }
        let whole = straightener.flush().expect("line");
        assert!((whole.curve.end() - point(25.4, 10.0)).amax() < 1e-12);
        assert!((whole.length - 25.4_f64.hypot(10.0)).abs() < 1e-9);
        assert!(straightener.flush().is_none());
    }

    #[test]
    fn what_turns_comes_back_or_has_another_feed_is_not_joined() {
        let first = stretch((0.0, 0.0), (10.0, 0.0), 50.0);
        let mut joint = stretch((10.0, 0.0), (20.0, 0.0), 50.0);
        joint.joint = true;
        for next in [
            stretch((10.0, 0.0), (20.0, 1e-5), 50.0),
            stretch((10.0, 0.0), (5.0, 0.0), 50.0),
            stretch((10.0, 0.0), (20.0, 0.0), 50.1),
            joint,
        ] {
            let mut straightener = Straightener::default();
            assert!(straightener.push(first).is_none());
            assert_eq!(straightener.push(next), Some(first));
            assert_eq!(straightener.flush(), Some(next));
        }
    }

    #[test]
    fn small_turns_do_not_add_up_to_a_curve() {
        // A circle of 100 m radius in chords of 10 um: each turns by 1e-10.
        let at = |k: i32| {
            let angle = 1e-7 * 1e-3 * f64::from(k);
            (1e5 * angle.sin(), 1e5 * (1.0 - angle.cos()))
        };
        let mut straightener = Straightener::default();
        let mut lines = 0;
        for k in 0..2000 {
            if let Some(line) = straightener.push(stretch(at(k), at(k + 1), 50.0)) {
                let chord = line.length;
                assert!(chord * chord / 8.0 / 1e5 <= 2.0 * OFF, "{chord}");
                lines += 1;
            }
        }
        assert!(lines > 0, "all one line");
    }
}
