//! The geometry of one block, with its own distances.

use evolvent_path::{Axes, Curve, Sense};

use crate::involute_piece::InvolutePiece;
use crate::measure::distance;
use crate::other::Other;
use crate::round::Round;
use crate::straight::Straight;

/// A curve by a parameter from 0 to [`length`](Self::length). No point moves faster than the parameter: the
/// distance to any fixed point changes by at most the change of the parameter.
#[derive(Clone, Debug)]
pub(crate) enum Piece {
    Straight(Straight),
    Round(Round),
    Involute(Box<InvolutePiece>),
    Other(Box<Other>),
}

impl Piece {
    pub(crate) fn of(curve: &Curve) -> Self {
        match curve {
            Curve::Line(_) => Self::Straight(Straight::of(curve)),
            Curve::Arc(arc) => Self::Round(Round::of(arc, curve.start(), curve.end())),
            Curve::Involute(involute) if curve.sense() != Sense::Straight => Self::Involute(Box::new(
                InvolutePiece::of(involute, curve.sense(), curve.start(), curve.end()),
            )),
            _ => Self::Other(Box::new(Other::of(curve))),
        }
    }

    pub(crate) fn is_straight(&self) -> bool {
        matches!(self, Self::Straight(_))
    }

    pub(crate) fn length(&self) -> f64 {
        match self {
            Self::Straight(piece) => piece.length(),
            Self::Round(piece) => piece.length(),
            Self::Involute(piece) => piece.length(),
            Self::Other(piece) => piece.length(),
        }
    }

    pub(crate) fn point(&self, u: f64) -> Axes {
        match self {
            Self::Straight(piece) => piece.point(u),
            Self::Round(piece) => piece.point(u),
            Self::Involute(piece) => piece.point(u),
            Self::Other(piece) => piece.point(u),
        }
    }

    /// Derivative of the position by the parameter.
    pub(crate) fn tangent(&self, u: f64) -> Axes {
        match self {
            Self::Straight(piece) => piece.tangent(),
            Self::Round(piece) => piece.tangent(u),
            Self::Involute(piece) => piece.tangent(u),
            Self::Other(piece) => piece.tangent(u),
        }
    }

    /// Finds the point nearest to `point` in the neighbourhood of `from`, not before it. Returns its
    /// parameter and distance.
    pub(crate) fn nearest(&self, point: &Axes, from: f64) -> (f64, f64) {
        let start = (from, distance(point, &self.point(from)));
        let foot = match self {
            Self::Straight(line) => line.nearest(point).clamp(from, self.length()),
            _ => self.foot(point, from),
        };
        let met = (foot, distance(point, &self.point(foot)));
        let best = if met.1 < start.1 { met } else { start };
        if self.moves_in_one_group(foot) {
            best
        } else {
            self.balance(point, from, best)
        }
    }

    /// The foot of the perpendicular in all axes together, by the Gauss-Newton method.
    fn foot(&self, point: &Axes, from: f64) -> f64 {
        let mut u = from;
        for _ in 0..12 {
            let tangent = self.tangent(u);
            let square = tangent.dot(&tangent);
            if !(square > 0.0) {
                break;
            }
            let step = (point - self.point(u)).dot(&tangent) / square;
            let next = (u + step).clamp(from, self.length());
            let done = (next - u).abs() <= 1e-13 * (1.0 + u);
            u = next;
            if done {
                break;
            }
        }
        u
    }

    /// Whether only XYZ moves: then the nearest point in all axes together is also the nearest in terms of
    /// tolerances.
    fn moves_in_one_group(&self, u: f64) -> bool {
        self.tangent(u).rows(3, 6).iter().all(|rate| *rate == 0.0)
    }

    /// Minimizes the greatest distance of several groups of axes, by golden-section search.
    fn balance(&self, point: &Axes, from: f64, best: (f64, f64)) -> (f64, f64) {
        let ratio = 0.618_033_988_749_894_9;
        let reach = 10.0 * best.1 + 1e-9;
        let (mut low, mut high) = (
            (best.0 - reach).max(from),
            (best.0 + reach).min(self.length()).max(from),
        );
        let off = |u: f64| distance(point, &self.point(u));
        let (mut a, mut b) = (high - ratio * (high - low), low + ratio * (high - low));
        let (mut at_a, mut at_b) = (off(a), off(b));
        for _ in 0..60 {
            if at_a <= at_b {
                high = b;
                (b, at_b) = (a, at_a);
                a = high - ratio * (high - low);
                at_a = off(a);
            } else {
                low = a;
                (a, at_a) = (b, at_b);
                b = low + ratio * (high - low);
                at_b = off(b);
            }
        }
        [best, (a, at_a), (b, at_b)]
            .into_iter()
            .fold(best, |best, next| if next.1 < best.1 { next } else { best })
    }
}
