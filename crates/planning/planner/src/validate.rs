//! A last look at a window before it is handed on.
//!
//! The guard stops the machine at a setpoint that breaks a limit. A plan that would bring it there is found here
//! first, by a computation that shares nothing with the solver, while there is still time for another.

use evolvent_machine::Limits;
use evolvent_path::AXES;
use evolvent_timing::Piece;

use crate::step::Segment;

/// Positions checked in a piece, minimum and maximum, and the time for which there is one, s.
const PLACES: (u32, u32) = (4, 24);
const PLACE_S: f64 = 0.0015;
/// What is let pass: less than the guard does.
const MOST: Ratios = Ratios {
    velocity: 1.0008,
    acceleration: 1.0008,
    jerk: 1.015,
};
/// Largest step of speed and acceleration between two pieces, as a share of the largest there is.
const SEAM: f64 = 1e-6;
/// Largest gap between where a piece ends and where the next one begins, parameter units: far less than what shows in
/// third differences.
const GAP: f64 = 1e-10;
/// The same as a share of a length.
const GAP_FRACTION: f64 = 1e-9;
/// A plan made slower is made a little slower than it must be.
const SLOWER: f64 = 0.99;

/// Largest ratios of an axis to its limits.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Ratios {
    pub(crate) velocity: f64,
    pub(crate) acceleration: f64,
    pub(crate) jerk: f64,
}

impl Ratios {
    pub(crate) fn hold(&self) -> bool {
        self.velocity <= MOST.velocity && self.acceleration <= MOST.acceleration && self.jerk <= MOST.jerk
    }

    /// The factor on speed that brings a plan from rest within the limits.
    pub(crate) fn remedy(&self) -> f64 {
        let excess = self
            .velocity
            .max(self.acceleration.sqrt())
            .max(libm::cbrt(self.jerk))
            .max(1.0);
        SLOWER / excess
    }
}

/// What the axes do along the pieces, the first of which starts at `(v, a)`; infinite where two pieces do not meet, in
/// place, speed or acceleration.
pub(crate) fn ratios<'a>(
    pieces: &[Piece],
    entry: (f64, f64),
    limits: &Limits,
    segment: impl Fn(u64) -> Option<&'a Segment>,
) -> Ratios {
    let mut most = Ratios::default();
    let broken = Ratios {
        velocity: f64::INFINITY,
        acceleration: f64::INFINITY,
        jerk: f64::INFINITY,
    };
    let speed = (pieces.iter().map(|piece| piece.law.at(0.0).0.v)).fold(entry.0, f64::max);
    let push = (pieces.iter().map(|piece| piece.law.at(0.0).0.a.abs())).fold(entry.1.abs(), f64::max);
    let (mut v, mut a) = entry;
    let mut before: Option<&Piece> = None;
    for piece in pieces {
        if !before.is_none_or(|before| meet(before, piece, &segment)) {
            return broken;
        }
        before = Some(piece);
        let Some(segment) = segment(piece.stretch) else {
            return broken;
        };
        let start = piece.law.at(0.0).0;
        if !((start.v - v).abs() <= SEAM * speed.max(1e-3) && (start.a - a).abs() <= SEAM * push.max(1.0)) {
            return broken;
        }
        let places = ((piece.duration / PLACE_S).ceil() as u32).clamp(PLACES.0, PLACES.1);
        for k in 0..=places {
            let t = piece.duration * f64::from(k) / f64::from(places);
            let (state, jerk) = piece.law.at(t);
            let jet = segment.jet((piece.from + state.x).clamp(0.0, segment.length));
            for i in 0..AXES {
                if !limits.present[i] {
                    continue;
                }
                let (q1, q2, q3) = (jet.first[i], jet.second[i], jet.third[i]);
                let (v, a) = (state.v, state.a);
                let velocity = (q1 * v).abs() / limits.velocity[i];
                let acceleration = (q2 * v * v + q1 * a).abs() / limits.acceleration[i];
                let jerk = (q3 * v * v * v + 3.0 * q2 * v * a + q1 * jerk).abs() / limits.jerk[i];
                if !(velocity.is_finite() && acceleration.is_finite() && jerk.is_finite()) {
                    return broken;
                }
                most.velocity = most.velocity.max(velocity);
                most.acceleration = most.acceleration.max(acceleration);
                most.jerk = most.jerk.max(jerk);
            }
        }
        let end = piece.law.at(piece.duration).0;
        let miss = (end.x - piece.length).abs();
        if miss.is_nan() || miss > GAP + GAP_FRACTION * piece.length {
            return broken;
        }
        (v, a) = (end.v, end.a);
    }
    most
}

/// Whether a piece begins where the one before ends: in the same stretch, or at the start of a later one behind the end
/// of its own. Stretches between them are shorter than rounding.
fn meet<'a>(before: &Piece, piece: &Piece, segment: &impl Fn(u64) -> Option<&'a Segment>) -> bool {
    let end = before.from + before.length;
    let near = |one: f64, other: f64| (one - other).abs() <= GAP + GAP_FRACTION * other.abs().min(1.0);
    if piece.stretch == before.stretch {
        return near(piece.from, end);
    }
    let length = |stretch: u64| segment(stretch).map_or(f64::INFINITY, |segment| segment.length);
    piece.stretch > before.stretch
        && near(end, length(before.stretch))
        && near(piece.from, 0.0)
        && (before.stretch + 1..piece.stretch).all(|between| length(between) <= GAP)
}

/// The same path at `factor` times the speed: only from rest.
pub(crate) fn slow_down(pieces: &mut [Piece], factor: f64) {
    for piece in pieces {
        piece.duration /= factor;
        piece.law = piece.law.slowed_down(factor);
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::expect_used, reason = "a test may fail")]

    use evolvent_path::{Curve, Line};
    use evolvent_timing::TimeLaw;

    use super::*;
    use crate::recorder::{equal_axes, point};
    use crate::step::SegmentMarks;

    fn segment() -> Segment {
        let line = Line::new(point(0.0, 0.0), point(10.0, 0.0)).expect("line");
        Segment {
            curve: Curve::Line(line),
            from: 0.0,
            length: 10.0,
            line: 1,
            block: 0,
            marks: SegmentMarks::default(),
        }
    }

    fn piece(law: TimeLaw, from: f64, duration: f64) -> Piece {
        Piece {
            law,
            length: law.at(duration).0.x,
            duration,
            stretch: 0,
            from,
            interval: 0,
        }
    }

    #[test]
    fn what_exceeds_a_limit_is_found_and_can_be_slowed_until_it_does_not() {
        let limits = equal_axes(100.0, 1000.0, 10_000.0);
        let segment = segment();
        // Jerk 80 000: speed 9, acceleration 1200 after 15 ms.
        let law = TimeLaw::Jerk {
            v: 0.0,
            a: 0.0,
            j: 80_000.0,
        };
        let mut pieces = [piece(law, 0.0, 0.015)];
        let found = ratios(&pieces, (0.0, 0.0), &limits, |_| Some(&segment));
        assert!((found.jerk - 8.0).abs() < 1e-12 && (found.acceleration - 1.2).abs() < 1e-12);
        assert!((found.velocity - 0.09).abs() < 1e-12 && !found.hold());
        slow_down(&mut pieces, found.remedy());
        let found = ratios(&pieces, (0.0, 0.0), &limits, |_| Some(&segment));
        assert!(found.hold() && found.jerk > 0.9, "{found:?}");
        let end = pieces[0].law.at(pieces[0].duration).0.x;
        assert!((end - pieces[0].length).abs() < 1e-12, "another path: {end}");
    }

    #[test]
    fn pieces_that_do_not_meet_are_found() {
        let limits = equal_axes(100.0, 1000.0, 10_000.0);
        let segment = segment();
        let cruise = |v: f64| TimeLaw::Flow { v, b: 0.0, c: 0.0 };
        let good = [piece(cruise(5.0), 0.0, 0.1), piece(cruise(5.0), 0.5, 0.1)];
        assert!(ratios(&good, (5.0, 0.0), &limits, |_| Some(&segment)).hold());
        assert!(!ratios(&good, (5.1, 0.0), &limits, |_| Some(&segment)).hold());
        assert!(!ratios(&good, (5.0, 1.0), &limits, |_| Some(&segment)).hold());
        let bad = [piece(cruise(5.0), 0.0, 0.1), piece(cruise(5.01), 0.5, 0.1)];
        assert!(!ratios(&bad, (5.0, 0.0), &limits, |_| Some(&segment)).hold());
        assert!(!ratios(&good, (5.0, 0.0), &limits, |_| None).hold());
        // The same motion, but it leaves out, or drives twice, a part of the path.
        for from in [0.500_001, 0.499_999, 0.0] {
            let gap = [piece(cruise(5.0), 0.0, 0.1), piece(cruise(5.0), from, 0.1)];
            assert!(
                !ratios(&gap, (5.0, 0.0), &limits, |_| Some(&segment)).hold(),
                "{from}"
            );
        }
        let mut short = good;
        short[0].duration = 0.09;
        assert!(!ratios(&short, (5.0, 0.0), &limits, |_| Some(&segment)).hold());
    }

    #[test]
    fn pieces_in_two_stretches_meet_at_the_end_of_one_and_the_start_of_the_other() {
        let limits = equal_axes(100.0, 1000.0, 10_000.0);
        let segment = segment();
        let tiny = Segment {
            length: 1e-13,
            ..segment
        };
        let cruise = TimeLaw::Flow {
            v: 5.0,
            b: 0.0,
            c: 0.0,
        };
        // Stretch 1 is shorter than rounding and has no piece.
        let at = |stretch: u64| Some(if stretch == 1 { &tiny } else { &segment });
        let to = |from: f64, stretch: u64, start: f64| {
            let second = Piece {
                stretch,
                ..piece(cruise, start, 0.1)
            };
            ratios(&[piece(cruise, from, 0.1), second], (5.0, 0.0), &limits, at).hold()
        };
        assert!(to(9.5, 1, 0.0) && to(9.5, 2, 0.0));
        assert!(!to(9.4, 2, 0.0), "leaves the end of a stretch out");
        assert!(!to(9.5, 2, 0.1), "leaves the start of a stretch out");
        assert!(!to(9.5, 3, 0.0), "leaves a whole stretch out");
    }
}
