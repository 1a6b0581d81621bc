//! Contribution of one interval to gradient and Hessian of the time law alone.

use super::cell::{Cell, LAW, of3};
use super::layout::Layout;

/// The contribution of one interval with a fixed path.
pub(super) struct LawLocal {
    pub(super) law: [[f64; LAW]; LAW],
    pub(super) gradient: [f64; LAW],
}

impl LawLocal {
    pub(super) fn new() -> Self {
        Self {
            law: [[0.0; LAW]; LAW],
            gradient: [0.0; LAW],
        }
    }

    fn row(&mut self, k: usize, values: &[f64; 3], g: f64, h: f64) {
        for x in 0..3 {
            self.gradient[k + x] += g * values[x];
            for y in 0..=x {
                self.law[k + x][k + y] += h * values[x] * values[y];
            }
        }
    }

    #[expect(
        clippy::too_many_arguments,
        reason = "the innermost loop; every caller has all of them"
    )]
    pub(super) fn cell<const D: usize>(
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
        let (g, h) = (
            -width / (3.0 * middle * root),
            width / (2.0 * middle * middle * root),
        );
        self.row(k, &cell.middle, g, h);
        for end in 0..2 {
            let law = cell.law(end, alpha);
            let [a, ..] = law;
            let (da, db, dc) = (&cell.a[end], &cell.b[end], &cell.c);
            let root = a.sqrt();
            self.row(k, da, -width / (12.0 * a * root), width / (8.0 * a * a * root));
            let mut metric = 0.0;
            // Bounds of `a` alone: their gradients and curvatures add up.
            let inverse = mu / (cell.cap - a);
            let (mut slope, mut bend) = (inverse, inverse * inverse / mu);
            for d in 0..D {
                let scale = scales[d];
                let motion = cell.motion(end, law, &points[d], scale);
                let [q1, q2, q3] = motion.q;
                let inverse = mu / (1.0 - motion.jerk * motion.jerk);
                let g = 2.0 * motion.jerk * inverse;
                let h = 2.0 * (1.0 + motion.jerk * motion.jerk) * inverse * inverse / mu;
                let (ra, half) = (root * scale[2], 0.5 * motion.jerk / a);
                let values =
                    std::array::from_fn(|j| ra * (q3 * da[j] + 3.0 * q2 * db[j] + q1 * dc[j]) + half * da[j]);
                self.row(k, &values, g, h);
                if end != 0 {
                    continue;
                }
                let v = motion.acceleration;
                let inverse = mu / (1.0 - v * v);
                let (g, h) = (2.0 * v * inverse, 2.0 * (1.0 + v * v) * inverse * inverse / mu);
                let values = std::array::from_fn(|j| scale[1] * (q2 * da[j] + q1 * db[j]));
                self.row(k, &values, g, h);
                let used = motion.velocity2 / a;
                let inverse = mu * used / (1.0 - motion.velocity2);
                slope += inverse;
                bend += inverse * inverse / mu;
                if layout.metric[d] {
                    metric += q1 * q1;
                }
            }
            if end != 0 {
                continue;
            }
            let used = metric / (feed * feed);
            let inverse = mu * used / (1.0 - a * used);
            slope += inverse;
            bend += inverse * inverse / mu;
            self.row(k, da, slope, bend);
        }
    }
}
