//! A correction over the position of an axis.

/// The natural cubic spline through the points of a table: C2, without curvature at the first and the last
/// point, so that a uniform error of pitch stays uniform.
///
/// Beyond the table the slope fades to zero over the length of the interval beside it, and then the curve is
/// constant.
///
/// Exact up to rounding; evaluation is a binary search and a polynomial.
#[derive(Clone, Debug, PartialEq)]
pub struct ErrorCurve {
    pieces: Vec<Piece>,
}

/// Valid from `start` to the next piece: `c[0] + c[1] t + c[2] t^2 + c[3] t^3`, with `t` counted from
/// `start`.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Piece {
    start: f64,
    c: [f64; 4],
}

impl Piece {
    fn constant(start: f64, value: f64) -> Self {
        Self {
            start,
            c: [value, 0.0, 0.0, 0.0],
        }
    }

    fn at(&self, t: f64) -> [f64; 4] {
        let [c0, c1, c2, c3] = self.c;
        [
            c0 + t * (c1 + t * (c2 + t * c3)),
            c1 + t * (2.0 * c2 + t * (3.0 * c3)),
            2.0 * c2 + t * (6.0 * c3),
            6.0 * c3,
        ]
    }
}

impl ErrorCurve {
    /// The spline through `values` at ascending `positions`; both have the same length, at least two, as
    /// checked by [`ScrewTable`](crate::ScrewTable).
    pub(crate) fn through(positions: &[f64], values: &[f64]) -> Self {
        let last = positions.len() - 1;
        let length = |i: usize| positions[i + 1] - positions[i];
        let slopes = slopes(positions, values);
        let mut pieces = Vec::with_capacity(last + 6);
        fade_in(positions[0], length(0), values[0], slopes[0], &mut pieces);
        for i in 0..last {
            let h = length(i);
            let mean = (values[i + 1] - values[i]) / h;
            let (left, right) = (slopes[i], slopes[i + 1]);
            let c = [
                values[i],
                left,
                (3.0 * mean - 2.0 * left - right) / h,
                (left + right - 2.0 * mean) / (h * h),
            ];
            pieces.push(Piece {
                start: positions[i],
                c,
            });
        }
        fade_out(
            positions[last],
            length(last - 1),
            values[last],
            slopes[last],
            &mut pieces,
        );
        Self { pieces }
    }

    /// Value and three derivatives by the position. At a knot the third derivative is that of the piece on
    /// the right. Real-time safe.
    #[must_use]
    pub fn at(&self, position: f64) -> [f64; 4] {
        let after = self.pieces.partition_point(|piece| piece.start <= position);
        let piece = &self.pieces[after.saturating_sub(1)];
        if piece.start.is_finite() {
            piece.at(position - piece.start)
        } else {
            [piece.c[0], 0.0, 0.0, 0.0]
        }
    }

    /// Maximum magnitude of the value and of each derivative, with its position.
    #[must_use]
    pub fn maxima(&self) -> [(f64, f64); 4] {
        let mut max = [(0.0, 0.0); 4];
        for (index, piece) in self.pieces.iter().enumerate() {
            // The constants outside equal the ends of their neighbours.
            let Some(next) = self.pieces.get(index + 1) else {
                break;
            };
            if !piece.start.is_finite() {
                max[0] = (piece.c[0].abs(), next.start);
                continue;
            }
            let length = next.start - piece.start;
            let [_, c1, c2, c3] = piece.c;
            // Candidates for extrema: the ends, and the zeros of the next higher derivative.
            let mut candidates = [0.0, length, -c2 / (3.0 * c3), 0.0, 0.0];
            let discriminant = c2 * c2 - 3.0 * c1 * c3;
            if discriminant >= 0.0 {
                let root = -(c2 + discriminant.sqrt().copysign(c2));
                candidates[3] = root / (3.0 * c3);
                candidates[4] = c1 / root;
            }
            for t in candidates {
                if !(0.0..=length).contains(&t) {
                    continue;
                }
                for (max, value) in max.iter_mut().zip(piece.at(t)) {
                    if value.abs() > max.0 {
                        *max = (value.abs(), piece.start + t);
                    }
                }
            }
        }
        max
    }
}

/// Slopes at the points, from the continuity of the second derivative, which is zero at both ends: Thomas
/// algorithm on a diagonally dominant tridiagonal system.
fn slopes(positions: &[f64], values: &[f64]) -> Vec<f64> {
    let last = positions.len() - 1;
    // For an interval: its contribution to half of the diagonal, and to the right side.
    let interval = |i: usize| {
        let h = positions[i + 1] - positions[i];
        (1.0 / h, 3.0 * (values[i + 1] - values[i]) / (h * h))
    };
    let mut slopes = vec![0.0; last + 1];
    // For the previous row, normalised: the factor of the next slope.
    let mut above = vec![0.0; last + 1];
    let (mut lower, mut right0) = (0.0, 0.0);
    for i in 0..=last {
        let (upper, right1) = if i < last { interval(i) } else { (0.0, 0.0) };
        let (factor, before) = match i.checked_sub(1) {
            Some(before) => (above[before], slopes[before]),
            None => (0.0, 0.0),
        };
        let pivot = 2.0 * (lower + upper) - lower * factor;
        above[i] = upper / pivot;
        slopes[i] = (right0 + right1 - lower * before) / pivot;
        (lower, right0) = (upper, right1);
    }
    for i in (0..last).rev() {
        slopes[i] -= above[i] * slopes[i + 1];
    }
    slopes
}

/// From a constant to `value` at `x` with this slope and no curvature, over `length`: constant third
/// derivative, and its negative.
fn fade_in(x: f64, length: f64, value: f64, slope: f64, pieces: &mut Vec<Piece>) {
    let rise = slope * length / 12.0;
    let c3 = slope / (1.5 * length * length);
    pieces.push(Piece::constant(f64::NEG_INFINITY, value - 6.0 * rise));
    pieces.push(Piece {
        start: x - length,
        c: [value - 6.0 * rise, 0.0, 0.0, c3],
    });
    pieces.push(Piece {
        start: x - 0.5 * length,
        c: [value - 5.0 * rise, 0.5 * slope, slope / length, -c3],
    });
}

/// The reverse of `fade_in`.
fn fade_out(x: f64, length: f64, value: f64, slope: f64, pieces: &mut Vec<Piece>) {
    let rise = slope * length / 12.0;
    let c3 = slope / (1.5 * length * length);
    pieces.push(Piece {
        start: x,
        c: [value, slope, 0.0, -c3],
    });
    pieces.push(Piece {
        start: x + 0.5 * length,
        c: [value + 5.0 * rise, 0.5 * slope, -slope / length, c3],
    });
    pieces.push(Piece::constant(x + length, value + 6.0 * rise));
}
