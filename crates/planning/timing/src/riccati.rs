//! Newton's step of a window by the Riccati recursion.
//!
//! Stage by stage from the end, the minimum cost to go of the quadratic model is a quadratic form in the
//! state `(a, b)` of a station; the control `c` of each interval follows from it. One division per stage, no
//! matrix larger than 2 x 2.

use crate::barrier::{Iterate, Local};
use crate::window::Window;

/// Gains of the controls; kept between calls only to reuse the memory.
#[derive(Clone, Debug, Default)]
pub(crate) struct Riccati {
    gains: Vec<[f64; 3]>,
}

impl Riccati {
    pub(crate) fn with_capacity(stations: usize) -> Self {
        Self {
            gains: Vec::with_capacity(stations),
        }
    }

    /// The step that minimises the quadratic model, with the given step `start` of the first state unless the
    /// motion starts at rest. Returns the directional derivative of the barrier function along it.
    pub(crate) fn step(
        &mut self,
        window: &Window,
        local: &Local,
        start: (f64, f64),
        step: &mut Iterate,
    ) -> f64 {
        let n = window.n();
        step.reset(n);
        self.gains.clear();
        self.gains.resize(n, [0.0; 3]);
        // Cost to go: p = (aa, ab, bb), r = linear part.
        let h = local.h[n];
        let (mut p, mut r) = ([h[0], h[1], h[2]], [local.g[n][0], local.g[n][1]]);
        for k in (0..n).rev() {
            let (d, h, g) = (window.d[k], local.h[k], local.g[k]);
            // The whole stage by (a, b, c): the next state is (a + 2 b d + c d^2, b + c d).
            let u = d * (p[0] * d + p[1]);
            let w = d * (p[1] * d + p[2]);
            let cc = h[5] + d * (d * u + w);
            let ca = h[3] + u;
            let cb = h[4] + 2.0 * d * u + w;
            let cg = g[2] + d * (d * r[0] + r[1]);
            let aa = h[0] + p[0];
            let ab = h[1] + 2.0 * d * p[0] + p[1];
            let bb = h[2] + 4.0 * d * (d * p[0] + p[1]) + p[2];
            let (ga, gb) = (g[0] + r[0], g[1] + 2.0 * d * r[0] + r[1]);
            let gain = if k + 1 == n {
                // The last control keeps the last state on the stub's line a + 3/2 x b = 0.
                let x = 1.5 * window.end.length;
                let inv = -1.0 / (d * (d + x));
                [inv, inv * (2.0 * d + x), 0.0]
            } else {
                let inv = -1.0 / cc;
                [inv * ca, inv * cb, inv * cg]
            };
            self.gains[k] = gain;
            let [ka, kb, kc] = gain;
            // Substituting c = ka a + kb b + kc.
            p = [
                aa + ka * (2.0 * ca + ka * cc),
                ab + ka * cb + kb * ca + ka * kb * cc,
                bb + kb * (2.0 * cb + kb * cc),
            ];
            r = [
                ga + ka * (cg + cc * kc) + kc * ca,
                gb + kb * (cg + cc * kc) + kc * cb,
            ];
        }
        let (mut a, mut b) = start;
        if window.from_rest {
            // Along the first stub's line: (a, b) = beta (3/2 x, 1).
            let x = 1.5 * window.start.length;
            let beta = -(x * r[0] + r[1]) / (x * (x * p[0] + 2.0 * p[1]) + p[2]);
            (a, b) = (x * beta, beta);
        }
        let mut slope = 0.0;
        for k in 0..n {
            let [ka, kb, kc] = self.gains[k];
            let (d, g) = (window.d[k], local.g[k]);
            let c = ka * a + kb * b + kc;
            (step.a[k], step.b[k], step.c[k]) = (a, b, c);
            slope += g[0] * a + g[1] * b + g[2] * c;
            (a, b) = (a + d * (2.0 * b + d * c), b + d * c);
        }
        (step.a[n], step.b[n]) = (a, b);
        slope + local.g[n][0] * a + local.g[n][1] * b
    }
}
