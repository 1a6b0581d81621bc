//! What is driven where a zone has no spline.

use evolvent_path::{Axes, Curve, Jet, Spline};

use super::{SHORTEST, Smoother, State};
use crate::chain::distance;
use crate::tube::within_tolerance;
use crate::{Output, Stretch};

/// Halvings of the straight that leads back to the program.
const HALVINGS: usize = 40;

impl Smoother {
    /// Gives up the zone: comes to rest where the path has come to, returns to the programmed curve, and keeps the joints
    /// up to `until`, and at least one, as they are programmed.
    pub(super) fn fall_back(&mut self, until: f64, out: &mut Vec<Output>) {
        self.failures += 1;
        self.state = State::Exact;
        if let Some(place) = self.off.take() {
            out.push(Output::Cap { speed: 0.0 });
            self.lead_back(place, out);
            out.push(Output::Cap { speed: 0.0 });
            self.kept = self.cursor;
            self.moving = false;
            self.joint = false;
            // At rest: whatever joint is here has been passed.
            let here = self.chain.find(self.cursor);
            if let Some(link) = self.chain.get_mut(here)
                && link.from >= self.cursor - SHORTEST
            {
                link.kept = link.corner();
                link.smoothed = false;
            }
        }
        let mut until = until;
        if let Some(joint) = self.smoothed(self.chain.find(self.cursor) + 1)
            && let Some(link) = self.chain.get(joint)
        {
            until = until.max(link.from);
        }
        let mut number = self.chain.find(self.cursor) + 1;
        while let Some(link) = self.chain.get_mut(number)
            && link.from <= until
        {
            if link.smoothed {
                link.smoothed = false;
                link.kept = true;
                link.unsaid = true;
                self.kept = link.from;
            }
            number += 1;
        }
    }

    /// From `place`, within the tolerance of the programmed point, straight back to the programmed curve.
    ///
    /// On a straight all of the way is within the tolerance, as both ends are. On a curve the way strays from it by at
    /// most `b L^2 / 2 s (1 - s)` more than `(1 - s) e`, where `s` is the share of its length `L`, `e` the distance at
    /// its start and `b` a bound of the second derivative: never more than `e` if `b L^2 / 2` is not.
    fn lead_back(&mut self, place: Axes, out: &mut Vec<Output>) {
        let mut number = self.chain.find(self.cursor);
        while let Some(link) = self.chain.get(number)
            && link.to - self.cursor <= SHORTEST
        {
            number += 1;
        }
        let Some(link) = self.chain.get(number) else {
            return;
        };
        let error = distance(&(place - link.position(self.cursor)));
        let mut length = link.to - self.cursor;
        if !link.straight {
            let from = (self.cursor - link.from).max(0.0);
            for _ in 0..HALVINGS {
                let (_, second, _) = link.curve.derivative_bounds(from, from + length);
                let chord_deviation = 0.5 * distance(&second) * length * length;
                if chord_deviation <= error || error + 0.25 * chord_deviation <= link.tolerance {
                    break;
                }
                length *= 0.5;
            }
        } else if length > 4.0 * link.tolerance {
            length = 4.0 * link.tolerance;
        }
        // Where the point that it is within the tolerance of lies on another link, a shorter way may be needed.
        let mut found = None;
        for _ in 0..HALVINGS {
            let to = if length < link.to - self.cursor {
                self.cursor + length
            } else {
                link.to
            };
            let end = if to < link.to {
                link.position(to)
            } else {
                link.curve.end()
            };
            let mut jet = Jet::at_rest(place);
            jet.first = (end - place) / (to - self.cursor);
            // A way of no length is none: then the curve can go on from here.
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
        out.push(Output::Stretch(Stretch {
            curve: Curve::Spline(spline),
            from: 0.0,
            length,
            feed: link.feed,
            rapid: link.rapid,
            blend: true,
            joint: false,
        }));
        self.cursor = to;
        self.release_marks(out);
    }
}
