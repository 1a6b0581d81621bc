//! The barrier function of a window: its value, and its gradient and Gauss-Newton Hessian by stations.
//!
//! Unknowns are `a = u'^2` and `b = u''` at stations and `c = u'''/u'` on the intervals between; on an interval
//! `b` is linear and `a` quadratic in the parameter. Every limit is `|y| <= 1` for an axis and a point:
//! acceleration `y = (q'' a + q' b)/A`, jerk `y = sqrt(a) (q''' a + 3 q'' b + q' c)/J`, and contributes
//! `-w log(1 - y^2)`; a cap contributes a quarter of `-w log(1 - a/cap)`. The weight `w` of an interval is the barrier
//! parameter times the time that the interval takes, so that what the barrier costs is the same share of the
//! motion everywhere, on whatever scale of length and time.
//!
//! `-w log(a + b d)` keeps the speed above zero between stations as well: with the values at the ends it is the
//! middle one of the three Bernstein coefficients of the quadratic `a` over an interval of length `d`. It has a cap
//! too: where speed passes its maximum within an interval, it does not exceed the caps there.

use crate::window::Window;

/// Weight of the barrier at a cap beside that at a row of the axes: where nothing but the cap limits the motion, the
/// speed stays below it by the barrier parameter times this.
const CAP_WEIGHT: f64 = 0.25;

/// Values at stations and intervals.
#[derive(Clone, Debug, Default)]
pub(crate) struct Iterate {
    /// `u'^2` at the stations.
    pub(crate) a: Vec<f64>,
    /// `u''` at the stations.
    pub(crate) b: Vec<f64>,
    /// `u'''/u'` on the intervals.
    pub(crate) c: Vec<f64>,
}

impl Iterate {
    pub(crate) fn with_capacity(stations: usize) -> Self {
        Self {
            a: Vec::with_capacity(stations + 1),
            b: Vec::with_capacity(stations + 1),
            c: Vec::with_capacity(stations),
        }
    }

    /// Everything zero for `n` intervals.
    pub(crate) fn reset(&mut self, n: usize) {
        for (values, length) in [(&mut self.a, n + 1), (&mut self.b, n + 1), (&mut self.c, n)] {
            values.clear();
            values.resize(length, 0.0);
        }
    }

    /// `self = from + t * step`.
    pub(crate) fn along(&mut self, from: &Self, step: &Self, t: f64) {
        let pairs = [
            (&mut self.a, &from.a, &step.a),
            (&mut self.b, &from.b, &step.b),
            (&mut self.c, &from.c, &step.c),
        ];
        for (to, from, step) in pairs {
            for ((to, from), step) in to.iter_mut().zip(from).zip(step) {
                *to = from + t * step;
            }
        }
    }

    pub(crate) fn copy(&mut self, other: &Self) {
        self.a.clone_from(&other.a);
        self.b.clone_from(&other.b);
        self.c.clone_from(&other.c);
    }
}

/// What is minimised beside the barrier.
#[derive(Clone, Debug, Default)]
pub(crate) struct Objective {
    /// Weights of `a` at stations, beside the duration.
    pub(crate) linear: Vec<f64>,
    /// Barrier weights of the intervals.
    pub(crate) weight: Vec<f64>,
}

/// Gradients by `(a, b, c)` and Hessians `aa, ab, bb, ac, bc, cc`, one a station; `c` of the last is unused.
#[derive(Clone, Debug, Default)]
pub(crate) struct Local {
    pub(crate) g: Vec<[f64; 3]>,
    pub(crate) h: Vec<[f64; 6]>,
}

/// Value of the barrier function; `None` outside of the limits.
pub(crate) fn value(window: &Window, objective: &Objective, x: &Iterate) -> Option<f64> {
    match window.lanes {
        2 => value_of::<2>(window, objective, x),
        4 => value_of::<4>(window, objective, x),
        6 => value_of::<6>(window, objective, x),
        _ => value_of::<10>(window, objective, x),
    }
}

/// Gradient and Hessian at a point within the limits.
pub(crate) fn assemble(window: &Window, objective: &Objective, x: &Iterate, local: &mut Local) {
    match window.lanes {
        2 => assemble_of::<2>(window, objective, x, local),
        4 => assemble_of::<4>(window, objective, x, local),
        6 => assemble_of::<6>(window, objective, x, local),
        _ => assemble_of::<10>(window, objective, x, local),
    }
}

/// One point's derivatives, a lane for every axis.
struct Row<'a, const L: usize> {
    first: &'a [f64; L],
    second: &'a [f64; L],
    third: &'a [f64; L],
}

/// The three points of each interval.
fn rows<const L: usize>(q: &[f64]) -> impl Iterator<Item = [Row<'_, L>; 3]> {
    let (lanes, _) = q.as_chunks::<L>();
    lanes.chunks_exact(9).map(|nine| {
        let row = |p: usize| Row {
            first: &nine[3 * p],
            second: &nine[3 * p + 1],
            third: &nine[3 * p + 2],
        };
        [row(0), row(1), row(2)]
    })
}

/// Scales of an interval's rows.
fn scales<const L: usize>(window: &Window, k: usize) -> ([f64; L], [f64; L]) {
    let (mut a, mut j) = ([0.0; L], [0.0; L]);
    let (loose_a, loose_j) = window.loose[k];
    for i in 0..L {
        a[i] = window.inverse_a[i] * loose_a;
        j[i] = window.inverse_j[i] * loose_j;
    }
    (a, j)
}

impl<const L: usize> Row<'_, L> {
    /// Product of `1 - y^2` over all axes; not positive outside of the limits.
    fn room(&self, at: (f64, f64, f64), inverse: &([f64; L], [f64; L]), acceleration: bool) -> f64 {
        let (a, b, c) = at;
        let root = a.sqrt();
        let (mut product, mut least): (f64, f64) = (1.0, 1.0);
        let mut room = [1.0; L];
        for i in 0..L {
            let y = root * (self.third[i] * a + 3.0 * self.second[i] * b + self.first[i] * c) * inverse.1[i];
            room[i] = 1.0 - y * y;
        }
        for r in room {
            product *= r;
            least = least.min(r);
        }
        if acceleration {
            for i in 0..L {
                let y = (self.second[i] * a + self.first[i] * b) * inverse.0[i];
                room[i] = 1.0 - y * y;
            }
            for r in room {
                product *= r;
                least = least.min(r);
            }
        }
        if least > 0.0 { product } else { f64::NAN }
    }

    /// Adds gradient and Hessian of `-weight sum log(1 - y^2)` by the point's own `(a, b, c)`.
    fn add(
        &self,
        at: (f64, f64, f64),
        inverse: &([f64; L], [f64; L]),
        weight: f64,
        acceleration: bool,
        g: &mut [f64; 3],
        h: &mut [f64; 6],
    ) {
        let (a, b, c) = at;
        let root = a.sqrt();
        let half = 0.5 / root;
        let (mut r, mut s) = ([0.0; L], [0.0; L]);
        let (mut da, mut db, mut dc) = ([0.0; L], [0.0; L], [0.0; L]);
        for i in 0..L {
            let l = (self.third[i] * a + 3.0 * self.second[i] * b + self.first[i] * c) * inverse.1[i];
            let y = root * l;
            da[i] = root * self.third[i] * inverse.1[i] + half * l;
            db[i] = root * 3.0 * self.second[i] * inverse.1[i];
            dc[i] = root * self.first[i] * inverse.1[i];
            let inv = 1.0 / (1.0 - y * y);
            r[i] = 2.0 * weight * y * inv;
            s[i] = 2.0 * weight * (1.0 + y * y) * inv * inv;
        }
        g[0] += dot(&r, &da);
        g[1] += dot(&r, &db);
        g[2] += dot(&r, &dc);
        h[0] += dot3(&s, &da, &da);
        h[1] += dot3(&s, &da, &db);
        h[2] += dot3(&s, &db, &db);
        h[3] += dot3(&s, &da, &dc);
        h[4] += dot3(&s, &db, &dc);
        h[5] += dot3(&s, &dc, &dc);
        if acceleration {
            for i in 0..L {
                da[i] = self.second[i] * inverse.0[i];
                db[i] = self.first[i] * inverse.0[i];
                let y = da[i] * a + db[i] * b;
                let inv = 1.0 / (1.0 - y * y);
                r[i] = 2.0 * weight * y * inv;
                s[i] = 2.0 * weight * (1.0 + y * y) * inv * inv;
            }
            g[0] += dot(&r, &da);
            g[1] += dot(&r, &db);
            h[0] += dot3(&s, &da, &da);
            h[1] += dot3(&s, &da, &db);
            h[2] += dot3(&s, &db, &db);
        }
    }
}

/// Sums in pairs, so that lanes stay in vector registers.
fn dot<const L: usize>(x: &[f64; L], y: &[f64; L]) -> f64 {
    let mut pair = [0.0; 2];
    for i in 0..L / 2 {
        pair[0] += x[2 * i] * y[2 * i];
        pair[1] += x[2 * i + 1] * y[2 * i + 1];
    }
    pair[0] + pair[1]
}

fn dot3<const L: usize>(x: &[f64; L], y: &[f64; L], z: &[f64; L]) -> f64 {
    let mut pair = [0.0; 2];
    for i in 0..L / 2 {
        pair[0] += x[2 * i] * y[2 * i] * z[2 * i];
        pair[1] += x[2 * i + 1] * y[2 * i + 1] * z[2 * i + 1];
    }
    pair[0] + pair[1]
}

/// Duration of an interval by Simpson's rule, and of a stub: `3 x / v`.
pub(crate) fn interval_time(d: f64, a: f64, middle: f64, end: f64) -> f64 {
    d / 6.0 * (1.0 / a.sqrt() + 4.0 / middle.sqrt() + 1.0 / end.sqrt())
}

fn value_of<const L: usize>(window: &Window, objective: &Objective, x: &Iterate) -> Option<f64> {
    let n = window.n();
    let mut sum = 0.0;
    sum += 3.0 * (window.start.length / x.a[0].sqrt() + window.end.length / x.a[n].sqrt());
    for (k, three) in rows::<L>(&window.q).enumerate() {
        let (d, a, b, c) = (window.d[k], x.a[k], x.b[k], x.c[k]);
        let (a1, b1) = (x.a[k + 1], x.b[k + 1]);
        let middle = a + d * (b + 0.25 * d * c);
        let control = a + b * d;
        if !(a > 0.0 && middle > 0.0 && a1 > 0.0 && control > 0.0) {
            return None;
        }
        let traits = window.traits[k];
        let inverse = scales::<L>(window, k);
        // The first state of a moving start is what it is: only the jerk from it on can be chosen.
        let free = k > 0 || window.from_rest;
        let (start, mid) = (1.0 - a / window.cap[k], 1.0 - middle / window.middle_cap[k]);
        if !((start > 0.0 || !free) && mid > 0.0) {
            return None;
        }
        let top = 1.0 - control / window.control_cap(k);
        if free && (top.is_nan() || top <= 0.0) {
            return None;
        }
        // The fourth root: see CAP_WEIGHT.
        let mut room = (if free { start * mid * top } else { mid }).sqrt().sqrt();
        room *= three[0].room((a, b, c), &inverse, free);
        room *= three[2].room((a1, b1, c), &inverse, traits.joint);
        if !traits.straight {
            room *= three[1].room((middle, b + 0.5 * d * c, c), &inverse, true);
        }
        if room.is_nan() || room <= 0.0 {
            return None;
        }
        room *= control / window.middle_cap[k];
        sum -= objective.weight[k] * libm::log(room);
        sum += objective.linear[k] * a;
        sum += interval_time(d, a, middle, a1);
    }
    let (a, b) = (x.a[n], x.b[n]);
    sum += objective.linear[n] * a;
    let (w0, w1) = (objective.weight[0], objective.weight[n - 1]);
    let mut room = (1.0 - a / window.cap[n]).sqrt().sqrt();
    let low = 1.0 + b / window.end.most;
    if !(a > 0.0 && room > 0.0 && low > 0.0 && b < 0.0) {
        return None;
    }
    room *= low;
    sum -= w1 * libm::log(room);
    if window.from_rest {
        let low = 1.0 - x.b[0] / window.start.most;
        if !(low > 0.0 && x.b[0] > 0.0) {
            return None;
        }
        sum -= w0 * libm::log(low);
    }
    sum.is_finite().then_some(sum)
}

fn assemble_of<const L: usize>(window: &Window, objective: &Objective, x: &Iterate, local: &mut Local) {
    let n = window.n();
    local.g.clear();
    local.h.clear();
    local.g.resize(n + 1, [0.0; 3]);
    local.h.resize(n + 1, [0.0; 6]);
    // What an interval says of its end is folded into its own (a, b, c): a1 = a + 2 b d + c d^2, b1 = b + c d.
    for (k, three) in rows::<L>(&window.q).enumerate() {
        let (d, a, b, c) = (window.d[k], x.a[k], x.b[k], x.c[k]);
        let (a1, b1) = (x.a[k + 1], x.b[k + 1]);
        let (middle, b_middle) = (a + d * (b + 0.25 * d * c), b + 0.5 * d * c);
        let inverse = scales::<L>(window, k);
        let (weight, traits) = (objective.weight[k], window.traits[k]);
        let (mut g, mut h) = ([0.0; 3], [0.0; 6]);
        let free = k > 0 || window.from_rest;
        three[0].add((a, b, c), &inverse, weight, free, &mut g, &mut h);
        if free {
            add_cap(a, window.cap[k], weight, d / 6.0, &mut g, &mut h);
        }
        g[0] += objective.linear[k];
        if k == 0 && window.from_rest {
            add_time(a, 3.0 * window.start.length, &mut g, &mut h);
            let f = 1.0 / (window.start.most - b);
            g[1] += weight * f;
            h[2] += weight * f * f;
        }
        let control = a + b * d;
        let inverse_control = 1.0 / control;
        let (mut slope, mut bend) = (
            -weight * inverse_control,
            weight * inverse_control * inverse_control,
        );
        if free {
            let f = 1.0 / (window.control_cap(k) - control);
            slope += CAP_WEIGHT * weight * f;
            bend += CAP_WEIGHT * weight * f * f;
        }
        g[0] += slope;
        g[1] += d * slope;
        h[0] += bend;
        h[1] += d * bend;
        h[2] += d * d * bend;
        let (mut gm, mut hm) = ([0.0; 3], [0.0; 6]);
        if !traits.straight {
            three[1].add((middle, b_middle, c), &inverse, weight, true, &mut gm, &mut hm);
        }
        add_cap(middle, window.middle_cap[k], weight, d / 1.5, &mut gm, &mut hm);
        shift(0.5 * d, &gm, &hm, &mut g, &mut h);
        let (mut ge, mut he) = ([0.0; 3], [0.0; 6]);
        three[2].add((a1, b1, c), &inverse, weight, traits.joint, &mut ge, &mut he);
        add_time(a1, d / 6.0, &mut ge, &mut he);
        shift(d, &ge, &he, &mut g, &mut h);
        (local.g[k], local.h[k]) = (g, h);
    }
    let (g, h) = (&mut local.g[n], &mut local.h[n]);
    let weight = objective.weight[n - 1];
    add_cap(x.a[n], window.cap[n], weight, 3.0 * window.end.length, g, h);
    g[0] += objective.linear[n];
    let f = 1.0 / (window.end.most + x.b[n]);
    g[1] -= weight * f;
    h[2] += weight * f * f;
}

/// Adds `scale / sqrt(a)`.
fn add_time(a: f64, scale: f64, g: &mut [f64; 3], h: &mut [f64; 6]) {
    let slope = -0.5 * scale / (a * a.sqrt());
    g[0] += slope;
    h[0] -= 1.5 * slope / a;
}

/// Adds `scale / sqrt(a) - CAP_WEIGHT weight log(1 - a/cap)`.
fn add_cap(a: f64, cap: f64, weight: f64, scale: f64, g: &mut [f64; 3], h: &mut [f64; 6]) {
    add_time(a, scale, g, h);
    let f = 1.0 / (cap - a);
    g[0] += CAP_WEIGHT * weight * f;
    h[0] += CAP_WEIGHT * weight * f * f;
}

/// Adds a point's gradient and Hessian at distance `x` from the station to the station's own.
fn shift(x: f64, gp: &[f64; 3], hp: &[f64; 6], g: &mut [f64; 3], h: &mut [f64; 6]) {
    // The point's (a, b, c) by the station's: rows (1, 2x, x^2), (0, 1, x), (0, 0, 1).
    let [aa, ab, bb, ac, bc, cc] = *hp;
    g[0] += gp[0];
    g[1] += 2.0 * x * gp[0] + gp[1];
    g[2] += x * (x * gp[0] + gp[1]) + gp[2];
    // Columns of Hp times the matrix.
    let (ab1, bb1) = (2.0 * x * aa + ab, 2.0 * x * ab + bb);
    let (ac1, bc2, cc1) = (
        x * (x * aa + ab) + ac,
        x * (x * ab + bb) + bc,
        x * (x * ac + bc) + cc,
    );
    h[0] += aa;
    h[1] += ab1;
    h[2] += 2.0 * x * ab1 + bb1;
    h[3] += ac1;
    h[4] += 2.0 * x * ac1 + bc2;
    h[5] += x * (x * ac1 + bc2) + cc1;
}

/// The largest `|y|` of acceleration and of jerk among the rows of interval `k`.
pub(crate) fn strain(window: &Window, k: usize, x: &Iterate) -> (f64, f64) {
    let (d, a, b, c) = (window.d[k], x.a[k], x.b[k], x.c[k]);
    let lanes = window.lanes;
    let q = &window.q[9 * lanes * k..9 * lanes * (k + 1)];
    let (mut most_a, mut most_j): (f64, f64) = (0.0, 0.0);
    for (point, at) in [0.0, 0.5 * d, d].into_iter().enumerate() {
        if point == 1 && window.traits[k].straight {
            continue;
        }
        let (ap, bp) = if point == 2 {
            (x.a[k + 1], x.b[k + 1])
        } else {
            (a + at * (2.0 * b + at * c), b + at * c)
        };
        let root = ap.max(0.0).sqrt();
        for lane in 0..window.count {
            let derivative = |order: usize| q[(3 * point + order) * lanes + lane];
            let (d1, d2, d3) = (derivative(0), derivative(1), derivative(2));
            if point > 0 || k > 0 || window.from_rest {
                most_a = most_a.max((d2 * ap + d1 * bp).abs() * window.inverse_a[lane]);
            }
            let jerk = root * (d3 * ap + 3.0 * d2 * bp + d1 * c);
            most_j = most_j.max(jerk.abs() * window.inverse_j[lane]);
        }
    }
    (most_a, most_j)
}
