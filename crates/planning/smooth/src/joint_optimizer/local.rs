//! Contribution of one interval to gradient and Hessian of time law and path.

use evolvent_path::Axes;

use super::cell::{Cell, LAW, STATIONS, of3};
use super::layout::{Layout, NONE};
use crate::tube::{GROUPS, Sample, dot};

/// A speed bound used to less than this fraction is omitted from the second derivatives.
const INACTIVE_RATIO: f64 = 0.2;

/// The contribution of one interval: by the coefficients of the law and, axis by axis, by the four control
/// points.
pub(super) struct Local<const D: usize> {
    law: [[f64; LAW]; LAW],
    mixed: [[[f64; LAW]; 4]; D],
    points: [[[[f64; D]; D]; 4]; 4],
    law_gradient: [f64; LAW],
    point_gradient: [[f64; D]; 4],
}

impl<const D: usize> Local<D> {
    pub(super) fn new() -> Self {
        Self {
            law: [[0.0; LAW]; LAW],
            mixed: [[[0.0; LAW]; 4]; D],
            points: [[[[0.0; D]; D]; 4]; 4],
            law_gradient: [0.0; LAW],
            point_gradient: [[0.0; D]; 4],
        }
    }

    /// Adds a function of the law alone, from its `k`-th coefficient, with first and second derivative `g`
    /// and `h` of the merit.
    fn law_row(&mut self, k: usize, values: &[f64; 3], g: f64, h: f64) {
        for x in 0..3 {
            self.law_gradient[k + x] += g * values[x];
            for y in 0..=x {
                self.law[k + x][k + y] += h * values[x] * values[y];
            }
        }
    }

    /// Adds a function of the law and the control points of one axis.
    fn row(&mut self, k: usize, d: usize, law: &[f64; 3], points: &[f64; 4], g: f64, h: f64) {
        self.law_row(k, law, g, h);
        for l in 0..4 {
            self.point_gradient[l][d] += g * points[l];
            let hp = h * points[l];
            for x in 0..3 {
                self.mixed[d][l][k + x] += hp * law[x];
            }
            for m in 0..=l {
                self.points[l][m][d][d] += hp * points[m];
            }
        }
    }

    #[expect(
        clippy::too_many_arguments,
        reason = "the innermost loop; every caller has all of them"
    )]
    pub(super) fn cell(
        &mut self,
        cell: &Cell,
        k: usize,
        alpha: &[f64],
        points: &[[f64; 4]; D],
        scales: &[[f64; 3]; D],
        (layout, feed): (&Layout<D>, f64),
        mu: f64,
    ) {
        let width = cell.width;
        let middle = of3(&cell.middle, alpha);
        let root = middle.sqrt();
        self.law_row(
            k,
            &cell.middle,
            -width / (3.0 * middle * root),
            width / (2.0 * middle * middle * root),
        );
        for end in 0..2 {
            let law = cell.law(end, alpha);
            let [a, b, c] = law;
            let (da, db, dc) = (&cell.a[end], &cell.b[end], &cell.c);
            let path = &cell.path[end];
            let root = a.sqrt();
            self.law_row(k, da, -width / (12.0 * a * root), width / (8.0 * a * a * root));
            let mut metric = 0.0;
            let mut rates = [0.0; D];
            for d in 0..D {
                let scale = scales[d];
                let motion = cell.motion(end, law, &points[d], scale);
                let [q1, q2, q3] = motion.q;
                // Jerk: -ln(1 - j^2).
                let inverse = mu / (1.0 - motion.jerk * motion.jerk);
                let (g, h) = (
                    2.0 * motion.jerk * inverse,
                    2.0 * (1.0 + motion.jerk * motion.jerk) * inverse * inverse / mu,
                );
                let (ra, half) = (root * scale[2], 0.5 * motion.jerk / a);
                let by_law =
                    std::array::from_fn(|j| ra * (q3 * da[j] + 3.0 * q2 * db[j] + q1 * dc[j]) + half * da[j]);
                let (w1, w2, w3) = (ra * c, 3.0 * ra * b, ra * a);
                let by_points = std::array::from_fn(|l| w3 * path[2][l] + w2 * path[1][l] + w1 * path[0][l]);
                self.row(k, d, &by_law, &by_points, g, h);
                if end != 0 {
                    continue;
                }
                let v = motion.acceleration;
                let inverse = mu / (1.0 - v * v);
                let (g, h) = (2.0 * v * inverse, 2.0 * (1.0 + v * v) * inverse * inverse / mu);
                let s = scale[1];
                let by_law = std::array::from_fn(|j| s * (q2 * da[j] + q1 * db[j]));
                let by_points = std::array::from_fn(|l| s * (path[1][l] * a + path[0][l] * b));
                self.row(k, d, &by_law, &by_points, g, h);
                // Velocity: -ln(1 - v^2).
                let inverse = mu / (1.0 - motion.velocity2);
                let h = if motion.velocity2 > INACTIVE_RATIO {
                    inverse * inverse / mu
                } else {
                    0.0
                };
                let s = scale[0] * scale[0] * q1;
                let by_law = da.map(|x| s * q1 * x);
                let by_points = path[0].map(|x| 2.0 * a * s * x);
                self.row(k, d, &by_law, &by_points, inverse, h);
                rates[d] = q1;
                if layout.metric[d] {
                    metric += q1 * q1;
                }
            }
            if end != 0 {
                continue;
            }
            let inverse = mu / (cell.cap - a);
            self.law_row(k, da, inverse, inverse * inverse / mu);
            if feed.is_finite() {
                let f = 1.0 / (feed * feed);
                let used = a * metric * f;
                let inverse = mu / (1.0 - used);
                let h = if used > INACTIVE_RATIO {
                    inverse * inverse / mu
                } else {
                    0.0
                };
                self.feed(
                    k,
                    &da.map(|x| metric * f * x),
                    &path[0],
                    &rates,
                    2.0 * a * f,
                    (inverse, h),
                    layout,
                );
            }
        }
    }

    /// Adds the feed bound, which couples the axes.
    #[expect(clippy::too_many_arguments, reason = "one row of the problem")]
    fn feed(
        &mut self,
        k: usize,
        law: &[f64; 3],
        first: &[f64; 4],
        rates: &[f64; D],
        factor: f64,
        (g, h): (f64, f64),
        layout: &Layout<D>,
    ) {
        self.law_row(k, law, g, h);
        let rates: [f64; D] = std::array::from_fn(|d| if layout.metric[d] { factor * rates[d] } else { 0.0 });
        for l in 0..4 {
            for d in 0..D {
                self.point_gradient[l][d] += g * first[l] * rates[d];
            }
            if h == 0.0 {
                continue;
            }
            for d in 0..D {
                let hp = h * first[l] * rates[d];
                for x in 0..3 {
                    self.mixed[d][l][k + x] += hp * law[x];
                }
                for m in 0..=l {
                    for e in 0..D {
                        self.points[l][m][d][e] += hp * first[m] * rates[e];
                    }
                }
            }
        }
    }

    pub(super) fn sample(&mut self, sample: &Sample, points: &[Axes], layout: &Layout<D>, mu: f64) {
        let error = sample.error(points);
        let (offset, inside) = sample.offset(&error);
        let inverse = 1.0 / (1.0 - dot(&offset, &offset) / sample.radius2);
        let h1 = 2.0 * mu * inverse / sample.radius2;
        let h2 = 2.0 * inverse / sample.radius2;
        let flat = f64::from(u8::from(inside));
        let (first, count) = GROUPS[sample.group];
        // In the axes of the problem.
        let (mut g, mut t, mut own) = ([0.0; D], [0.0; D], [0.0; D]);
        for p in 0..count {
            let column = layout.columns[first + p];
            if column != NONE {
                g[column] = offset[p];
                t[column] = sample.along[p];
                own[column] = h1;
            }
        }
        for l in 0..4 {
            for d in 0..D {
                self.point_gradient[l][d] += h1 * sample.weights[l] * g[d];
            }
        }
        let mut block = [[0.0; D]; D];
        for d in 0..D {
            for e in 0..D {
                block[d][e] = h1 * (h2 * g[d] * g[e] - flat * t[d] * t[e]);
            }
            block[d][d] += own[d];
        }
        for l in 0..4 {
            for m in 0..=l {
                let w = sample.weights[l] * sample.weights[m];
                for d in 0..D {
                    for e in 0..D {
                        self.points[l][m][d][e] += w * block[d][e];
                    }
                }
            }
        }
    }

    pub(super) fn scatter(&self, group: usize, layout: &Layout<D>, matrix: &mut [f64], gradient: &mut [f64]) {
        let band = Layout::<D>::BAND;
        let i = layout.from + group;
        let law: [usize; LAW] = std::array::from_fn(|j| layout.alpha(group * STATIONS + j));
        let points: [usize; 4] = std::array::from_fn(|l| layout.point(i + l));
        let mut add = |r: usize, c: usize, value: f64| {
            let (r, c) = if r >= c { (r, c) } else { (c, r) };
            matrix[c * band + r - c] += value;
        };
        for x in 0..LAW {
            gradient[law[x]] += self.law_gradient[x];
            for y in 0..=x {
                add(law[x], law[y], self.law[x][y]);
            }
        }
        for l in 0..4 {
            if points[l] == NONE {
                continue;
            }
            for d in 0..D {
                gradient[points[l] + d] += self.point_gradient[l][d];
                for x in 0..LAW {
                    add(points[l] + d, law[x], self.mixed[d][l][x]);
                }
            }
            for m in 0..=l {
                if points[m] == NONE {
                    continue;
                }
                for d in 0..D {
                    for e in 0..D {
                        if l != m || d >= e {
                            add(points[l] + d, points[m] + e, self.points[l][m][d][e]);
                        }
                    }
                }
            }
        }
    }
}
