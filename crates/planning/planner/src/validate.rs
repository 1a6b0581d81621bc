//! Validates a window before it is handed over.
//!
//! The guard stops the machine at a setpoint beyond a limit. A plan with such setpoints is detected here
//! first, by a computation independent of the solver, while there is still time for another.

use evolvent_machine::Limits;
use evolvent_path::AXES;
use evolvent_timing::TimeLawPiece;

use crate::step::Segment;

/// Minimum and maximum number of samples of a piece, and the time per sample, s.
const SAMPLES: (u32, u32) = (4, 24);
const SAMPLE_S: f64 = 0.0015;
/// Maximum accepted ratios, below those of the guard.
const MAX_RATIOS: Ratios = Ratios {
    velocity: 1.0008,
    acceleration: 1.0008,
    jerk: 1.015,
};
/// Maximum step of speed and acceleration between two pieces, relative to their maximum.
const MAX_STEP: f64 = 1e-6;
/// Maximum gap between the end of a piece and the start of the next, parameter units: far below what third
/// differences show.
const MAX_GAP: f64 = 1e-10;
/// The same relative to a length.
const MAX_GAP_FRACTION: f64 = 1e-9;
/// Additional factor for a plan that is slowed down.
const SLOWDOWN_MARGIN: f64 = 0.99;

/// Maximum ratios of the axes to their limits.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Ratios {
    pub(crate) velocity: f64,
    pub(crate) acceleration: f64,
    pub(crate) jerk: f64,
}

impl Ratios {
    pub(crate) fn are_within_limits(&self) -> bool {
        self.velocity <= MAX_RATIOS.velocity
            && self.acceleration <= MAX_RATIOS.acceleration
            && self.jerk <= MAX_RATIOS.jerk
    }

    /// The factor on the speed that brings a plan from rest within the limits.
    pub(crate) fn required_slowdown(&self) -> f64 {
        let excess = self
            .velocity
            .max(self.acceleration.sqrt())
            .max(libm::cbrt(self.jerk))
            .max(1.0);
        SLOWDOWN_MARGIN / excess
    }
}

/// Maximum ratios along the pieces, the first of which starts at `(v, a)`; infinite if two pieces are not
/// contiguous in position, speed or acceleration.
pub(crate) fn ratios<'a>(
    pieces: &[TimeLawPiece],
    entry: (f64, f64),
    limits: &Limits,
    segment: impl Fn(u64) -> Option<&'a Segment>,
) -> Ratios {
    let mut max = Ratios::default();
    let broken = Ratios {
        velocity: f64::INFINITY,
        acceleration: f64::INFINITY,
        jerk: f64::INFINITY,
    };
    let speed = (pieces.iter().map(|piece| piece.law.at(0.0).0.v)).fold(entry.0, f64::max);
    let push = (pieces.iter().map(|piece| piece.law.at(0.0).0.a.abs())).fold(entry.1.abs(), f64::max);
    let (mut v, mut a) = entry;
    let mut before: Option<&TimeLawPiece> = None;
    for piece in pieces {
        if !before.is_none_or(|before| are_contiguous(before, piece, &segment)) {
            return broken;
        }
        before = Some(piece);
        let Some(segment) = segment(piece.segment) else {
            return broken;
        };
        let start = piece.law.at(0.0).0;
        if !((start.v - v).abs() <= MAX_STEP * speed.max(1e-3)
            && (start.a - a).abs() <= MAX_STEP * push.max(1.0))
        {
            return broken;
        }
        let samples = ((piece.duration_s / SAMPLE_S).ceil() as u32).clamp(SAMPLES.0, SAMPLES.1);
        for k in 0..=samples {
            let t = piece.duration_s * f64::from(k) / f64::from(samples);
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
                max.velocity = max.velocity.max(velocity);
                max.acceleration = max.acceleration.max(acceleration);
                max.jerk = max.jerk.max(jerk);
            }
        }
        let end = piece.law.at(piece.duration_s).0;
        let miss = (end.x - piece.length).abs();
        if miss.is_nan() || miss > MAX_GAP + MAX_GAP_FRACTION * piece.length {
            return broken;
        }
        (v, a) = (end.v, end.a);
    }
    max
}

/// Whether a piece starts where the previous one ends: in the same segment, or from its end to the start of a
/// later one. Segments in between are shorter than rounding.
fn are_contiguous<'a>(
    before: &TimeLawPiece,
    piece: &TimeLawPiece,
    segment: &impl Fn(u64) -> Option<&'a Segment>,
) -> bool {
    let end = before.from + before.length;
    let near =
        |one: f64, other: f64| (one - other).abs() <= MAX_GAP + MAX_GAP_FRACTION * other.abs().min(1.0);
    if piece.segment == before.segment {
        return near(piece.from, end);
    }
    let length = |number: u64| segment(number).map_or(f64::INFINITY, |segment| segment.length);
    piece.segment > before.segment
        && near(end, length(before.segment))
        && near(piece.from, 0.0)
        && (before.segment + 1..piece.segment).all(|between| length(between) <= MAX_GAP)
}

/// Scales a plan from rest in time, to `factor` times the speed.
pub(crate) fn slow_down(pieces: &mut [TimeLawPiece], factor: f64) {
    for piece in pieces {
        piece.duration_s /= factor;
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

    fn piece(law: TimeLaw, from: f64, duration: f64) -> TimeLawPiece {
        TimeLawPiece {
            law,
            length: law.at(duration).0.x,
            duration_s: duration,
            segment: 0,
            from,
            interval: 0,
        }
    }

    #[test]
    fn an_excess_is_found_and_removed_by_slowing_down() {
        let limits = equal_axes(100.0, 1000.0, 10_000.0);
        let segment = segment();
        // Jerk 80 000: speed 9, acceleration 1200 after 15 ms.
        let law = TimeLaw::ConstantJerk {
            v: 0.0,
            a: 0.0,
            j: 80_000.0,
        };
        let mut pieces = [piece(law, 0.0, 0.015)];
        let found = ratios(&pieces, (0.0, 0.0), &limits, |_| Some(&segment));
        assert!((found.jerk - 8.0).abs() < 1e-12 && (found.acceleration - 1.2).abs() < 1e-12);
        assert!((found.velocity - 0.09).abs() < 1e-12 && !found.are_within_limits());
        slow_down(&mut pieces, found.required_slowdown());
        let found = ratios(&pieces, (0.0, 0.0), &limits, |_| Some(&segment));
        assert!(found.are_within_limits() && found.jerk > 0.9, "{found:?}");
        let end = pieces[0].law.at(pieces[0].duration_s).0.x;
        assert!((end - pieces[0].length).abs() < 1e-12, "another path: {end}");
    }

    #[test]
    fn gaps_between_pieces_are_found() {
        let limits = equal_axes(100.0, 1000.0, 10_000.0);
        let segment = segment();
        let cruise = |v: f64| TimeLaw::LinearAcceleration { v, b: 0.0, c: 0.0 };
        let good = [piece(cruise(5.0), 0.0, 0.1), piece(cruise(5.0), 0.5, 0.1)];
        assert!(ratios(&good, (5.0, 0.0), &limits, |_| Some(&segment)).are_within_limits());
        assert!(!ratios(&good, (5.1, 0.0), &limits, |_| Some(&segment)).are_within_limits());
        assert!(!ratios(&good, (5.0, 1.0), &limits, |_| Some(&segment)).are_within_limits());
        let bad = [piece(cruise(5.0), 0.0, 0.1), piece(cruise(5.01), 0.5, 0.1)];
        assert!(!ratios(&bad, (5.0, 0.0), &limits, |_| Some(&segment)).are_within_limits());
        assert!(!ratios(&good, (5.0, 0.0), &limits, |_| None).are_within_limits());
        // The same motion, but with a gap or an overlap of the path.
        for from in [0.500_001, 0.499_999, 0.0] {
            let gap = [piece(cruise(5.0), 0.0, 0.1), piece(cruise(5.0), from, 0.1)];
            assert!(
                !ratios(&gap, (5.0, 0.0), &limits, |_| Some(&segment)).are_within_limits(),
                "{from}"
            );
        }
        let mut short = good;
        short[0].duration_s = 0.09;
        assert!(!ratios(&short, (5.0, 0.0), &limits, |_| Some(&segment)).are_within_limits());
    }

    #[test]
    fn pieces_of_adjacent_segments_are_contiguous() {
        let limits = equal_axes(100.0, 1000.0, 10_000.0);
        let segment = segment();
        let tiny = Segment {
            length: 1e-13,
            ..segment
        };
        let cruise = TimeLaw::LinearAcceleration {
            v: 5.0,
            b: 0.0,
            c: 0.0,
        };
        // Segment 1 is shorter than rounding and has no piece.
        let at = |number: u64| Some(if number == 1 { &tiny } else { &segment });
        let to = |from: f64, segment: u64, start: f64| {
            let second = TimeLawPiece {
                segment,
                ..piece(cruise, start, 0.1)
            };
            ratios(&[piece(cruise, from, 0.1), second], (5.0, 0.0), &limits, at).are_within_limits()
        };
        assert!(to(9.5, 1, 0.0) && to(9.5, 2, 0.0));
        assert!(!to(9.4, 2, 0.0), "leaves the end of a stretch out");
        assert!(!to(9.5, 2, 0.1), "leaves the start of a stretch out");
        assert!(!to(9.5, 3, 0.0), "leaves a whole stretch out");
    }
}
