//! A correction over the position of an axis.

/// A C2 cubic spline through the points of a table, constant before the first and after the last point.
///
/// Slope and curvature are zero at both ends, so the spline joins the constants smoothly. The two additional conditions at
/// each end need one additional knot, in the middle of the first and of the last interval. A table of two points has its two
/// knots at one and three quarters.
///
/// Exact up to rounding; evaluation is a binary search and a polynomial.
#[derive(Clone, Debug, PartialEq)]
pub struct ErrorCurve {
    pieces: Vec<Piece>,
}

/// Valid from `start` to the next piece: `c[0] + c[1] t + c[2] t^2 + c[3] t^3`, with `t` counted from `start`.
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
    /// The spline through `values` at ascending `positions`; both have the same length, at least two, as checked by
    /// [`ScrewTable`](crate::ScrewTable).
    pub(crate) fn through(positions: &[f64], values: &[f64]) -> Self {
        let last = positions.len() - 1;
        let mut pieces = Vec::with_capacity(last + 4);
        pieces.push(Piece::constant(f64::NEG_INFINITY, values[0]));
        if last == 1 {
            single_interval(positions, values, &mut pieces);
        } else {
            let slopes = slopes(positions, values);
            for i in 0..last {
                let (x, h) = (positions[i], positions[i + 1] - positions[i]);
                let change = values[i + 1] - values[i];
                if i == 0 {
                    first_interval(x, h, values[0], change, slopes[1], &mut pieces);
                } else if i + 1 == last {
                    last_interval(x, h, values[i], change, slopes[i], &mut pieces);
                } else {
                    let (left, right) = (slopes[i], slopes[i + 1]);
                    let mean = change / h;
                    let c = [
                        values[i],
                        left,
                        (3.0 * mean - 2.0 * left - right) / h,
                        (left + right - 2.0 * mean) / (h * h),
                    ];
                    pieces.push(Piece { start: x, c });
                }
            }
        }
        pieces.push(Piece::constant(positions[last], values[last]));
        Self { pieces }
    }

    /// Value and three derivatives by the position. At a knot the third derivative is that of the piece on the right. Real-time safe.
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

/// Slopes at the inner points (the outer two are zero) from the continuity of the second derivative: Thomas algorithm on a
/// diagonally dominant tridiagonal system.
fn slopes(positions: &[f64], values: &[f64]) -> Vec<f64> {
    let last = positions.len() - 1;
    let mut slopes = vec![0.0; last + 1];
    // Of the previous row, normalised: the factor of the next slope, and the right side.
    let mut above = vec![0.0; last + 1];
    for i in 1..last {
        let (h0, h1) = (positions[i] - positions[i - 1], positions[i + 1] - positions[i]);
        let (change0, change1) = (values[i] - values[i - 1], values[i + 1] - values[i]);
        // With the middle knot, and zero slope and curvature at the outer end: curvature = 6 slope/h - 12 change/h^2.
        let (lower, diagonal0, right0) = if i == 1 {
            (0.0, 6.0 / h0, 12.0 * change0 / (h0 * h0))
        } else {
            (2.0 / h0, 4.0 / h0, 6.0 * change0 / (h0 * h0))
        };
        let (upper, diagonal1, right1) = if i + 1 == last {
            (0.0, 6.0 / h1, 12.0 * change1 / (h1 * h1))
        } else {
            (2.0 / h1, 4.0 / h1, 6.0 * change1 / (h1 * h1))
        };
        let pivot = diagonal0 + diagonal1 - lower * above[i - 1];
        above[i] = upper / pivot;
        slopes[i] = (right0 + right1 - lower * slopes[i - 1]) / pivot;
    }
    for i in (1..last).rev() {
        slopes[i] -= above[i] * slopes[i + 1];
    }
    slopes
}

/// `a t^3` up to the middle knot, plus `b (t - h/2)^3` after it; value and slope at the end determine `a` and `b`.
fn first_interval(x: f64, h: f64, value: f64, change: f64, slope: f64, pieces: &mut Vec<Piece>) {
    let (a, b) = end_coefficients(h, change, slope);
    let u = 0.5 * h;
    pieces.push(Piece {
        start: x,
        c: [value, 0.0, 0.0, a],
    });
    pieces.push(Piece {
        start: x + u,
        c: [value + a * u * u * u, 3.0 * a * u * u, 3.0 * a * u, a + b],
    });
}

/// The mirror image of `first_interval`.
fn last_interval(x: f64, h: f64, value: f64, change: f64, slope: f64, pieces: &mut Vec<Piece>) {
    let (a, b) = end_coefficients(h, -change, -slope);
    let u = 0.5 * h;
    pieces.push(Piece {
        start: x,
        c: [value, slope, 3.0 * a * h + 3.0 * b * u, -(a + b)],
    });
    pieces.push(Piece {
        start: x + u,
        c: [value + change + a * u * u * u, -3.0 * a * u * u, 3.0 * a * u, -a],
    });
}

fn end_coefficients(h: f64, change: f64, slope: f64) -> (f64, f64) {
    let a = (6.0 * change / h - slope) / (3.0 * h * h);
    (a, 8.0 * (change / (h * h * h) - a))
}

/// The transition between two constants: knots at one and three quarters of `h`, third derivatives in the ratio 1 : -1 : 1.
fn single_interval(positions: &[f64], values: &[f64], pieces: &mut Vec<Piece>) {
    let h = positions[1] - positions[0];
    let a = 16.0 / 3.0 * (values[1] - values[0]) / (h * h * h);
    let (u, w) = (0.25 * h, 0.5 * h);
    let quarter = values[0] + a * u * u * u;
    let (slope, half_curvature) = (3.0 * a * u * u, 3.0 * a * u);
    pieces.push(Piece {
        start: positions[0],
        c: [values[0], 0.0, 0.0, a],
    });
    pieces.push(Piece {
        start: positions[0] + u,
        c: [quarter, slope, half_curvature, -a],
    });
    pieces.push(Piece {
        start: positions[0] + 3.0 * u,
        c: [
            quarter + slope * w + half_curvature * w * w - a * w * w * w,
            slope,
            -half_curvature,
            a,
        ],
    });
}
