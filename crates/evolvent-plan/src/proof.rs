//! A last look at a window before it is handed on.
//!
//! The guard stops the machine at a setpoint that breaks a limit. A plan that would bring it there is found here
//! first, by a computation that shares nothing with the solver, while there is still time for another.

use evolvent_feed::{Law, Piece};
use evolvent_machine::Limits;
use evolvent_path::AXES;

use crate::step::Segment;

/// Places looked at in a piece.
const PLACES: u32 = 4;
/// What is let pass: less than the guard does.
const MOST: Ratios = Ratios {
    velocity: 1.0008,
    acceleration: 1.0008,
    jerk: 1.015,
};
/// Largest step of speed and acceleration between two pieces, as a share of the largest there is.
const SEAM: f64 = 1e-6;
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

/// What the axes do along the pieces, the first of which starts at `(v, a)`; infinite where two pieces do not meet.
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
    for piece in pieces {
        let Some(segment) = segment(piece.stretch) else {
            return broken;
        };
        let start = piece.law.at(0.0).0;
        if !((start.v - v).abs() <= SEAM * speed.max(1e-3) && (start.a - a).abs() <= SEAM * push.max(1.0)) {
            return broken;
        }
        for k in 0..=PLACES {
            let t = piece.duration * f64::from(k) / f64::from(PLACES);
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
        (v, a) = (end.v, end.a);
    }
    most
}

/// The same path at `factor` times the speed: only from rest.
pub(crate) fn slow_down(pieces: &mut [Piece], factor: f64) {
    let (f, ff, fff) = (factor, factor * factor, factor * factor * factor);
    for piece in pieces {
        piece.duration /= f;
        piece.law = match piece.law {
            Law::Flow { v, b, c } => Law::Flow {
                v: v * f,
                b: b * ff,
                c: c * ff,
            },
            Law::Jerk { v, a, j } => Law::Jerk {
                v: v * f,
                a: a * ff,
                j: j * fff,
            },
        };
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::expect_used, reason = "a test may fail")]

    use evolvent_path::{Curve, Line};

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

    fn piece(law: Law, from: f64, duration: f64) -> Piece {
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
        let law = Law::Jerk {
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
        let cruise = |v: f64| Law::Flow { v, b: 0.0, c: 0.0 };
        let good = [piece(cruise(5.0), 0.0, 0.1), piece(cruise(5.0), 0.5, 0.1)];
        assert!(ratios(&good, (5.0, 0.0), &limits, |_| Some(&segment)).hold());
        assert!(!ratios(&good, (5.1, 0.0), &limits, |_| Some(&segment)).hold());
        assert!(!ratios(&good, (5.0, 1.0), &limits, |_| Some(&segment)).hold());
        let bad = [piece(cruise(5.0), 0.0, 0.1), piece(cruise(5.01), 0.5, 0.1)];
        assert!(!ratios(&bad, (5.0, 0.0), &limits, |_| Some(&segment)).hold());
        assert!(!ratios(&good, (5.0, 0.0), &limits, |_| None).hold());
    }
}
