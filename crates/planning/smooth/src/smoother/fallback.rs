//! The path where a zone has no spline.

use evolvent_path::{Axes, Curve, Jet, Spline};

use super::{MIN_LENGTH, Smoother, State};
use crate::chain::distance;
use crate::tube::within_tolerance;
use crate::{Output, PathSegment};

/// Maximum number of halvings of the straight return to the program.
const MAX_HALVINGS: usize = 40;

impl Smoother {
    /// Abandons the zone: stops at the present end of the path, returns to the programmed curve, and keeps
    /// the joints up to `until`, at least one, as programmed.
    pub(super) fn fall_back(&mut self, until: f64, out: &mut Vec<Output>) {
        self.tally.failures += 1;
        self.state = State::Exact;
        if let Some(position) = self.offset_point.take() {
            out.push(Output::Cap { speed: 0.0 });
            self.return_to_program(position, out);
            out.push(Output::Cap { speed: 0.0 });
            self.kept = self.cursor;
            self.departure.moving = false;
            self.departure.joint = false;
            // At rest: any joint here has been passed.
            let here = self.chain.find(self.cursor);
            if let Some(segment) = self.chain.get_mut(here)
                && segment.from >= self.cursor - MIN_LENGTH
            {
                segment.kept = segment.corner();
                segment.smoothed = false;
            }
        }
        let mut until = until;
        if let Some(joint) = self.smoothed(self.chain.find(self.cursor) + 1)
            && let Some(segment) = self.chain.get(joint)
        {
            until = until.max(segment.from);
        }
        let mut number = self.chain.find(self.cursor) + 1;
        while let Some(segment) = self.chain.get_mut(number)
            && segment.from <= until
        {
            if segment.smoothed {
                segment.smoothed = false;
                segment.kept = true;
                segment.cap_pending = true;
                self.kept = segment.from;
            }
            number += 1;
        }
    }

    /// Returns straight to the programmed curve from `position`, which is within the tolerance of its programmed
    /// point.
    ///
    /// On a straight segment the whole return is within the tolerance, because both ends are. On a curve its
    /// distance exceeds `(1 - s) e` by at most `b L^2 / 2 s (1 - s)`, where `s` is the fraction of its length
    /// `L`, `e` the distance at its start and `b` a bound of the second derivative: it stays below `e` if
    /// `b L^2 / 2` does.
    fn return_to_program(&mut self, position: Axes, out: &mut Vec<Output>) {
        let mut number = self.chain.find(self.cursor);
        while let Some(segment) = self.chain.get(number)
            && segment.to - self.cursor <= MIN_LENGTH
        {
            number += 1;
        }
        let Some(segment) = self.chain.get(number) else {
            return;
        };
        let error = distance(&(position - segment.position(self.cursor)));
        let mut length = segment.to - self.cursor;
        if !segment.straight {
            let from = (self.cursor - segment.from).max(0.0);
            for _ in 0..MAX_HALVINGS {
                let (_, second, _) = segment.curve.derivative_bounds(from, from + length);
                let chord_deviation = 0.5 * distance(&second) * length * length;
                if chord_deviation <= error || error + 0.25 * chord_deviation <= segment.tolerance {
                    break;
                }
                length *= 0.5;
            }
        } else if length > 4.0 * segment.tolerance {
            length = 4.0 * segment.tolerance;
        }
        // If the corresponding point is on another segment, a shorter return may be needed.
        let mut found = None;
        for _ in 0..MAX_HALVINGS {
            let to = if length < segment.to - self.cursor {
                self.cursor + length
            } else {
                segment.to
            };
            let end = if to < segment.to {
                segment.position(to)
            } else {
                segment.curve.end()
            };
            let mut jet = Jet::at_rest(position);
            jet.first = (end - position) / (to - self.cursor);
            // A return without length is not needed: the curve continues from here.
            let Ok(spline) = Spline::new(&jet, end, to - self.cursor) else {
                break;
            };
            found = Some((spline, to));
            if within_tolerance(&self.chain, (self.cursor, to), &spline) {
                break;
            }
            length *= 0.5;
        }
        let Some((spline, to)) = found else {
            return;
        };
        let length = to - self.cursor;
        out.push(Output::Segment(PathSegment {
            curve: Curve::Spline(spline),
            from: 0.0,
            length,
            feed_mm_s: segment.feed_mm_s,
            metric: segment.metric,
            rapid: segment.rapid,
            blend: true,
            joint: false,
        }));
        self.cursor = to;
        self.release_marks(out);
    }
}
