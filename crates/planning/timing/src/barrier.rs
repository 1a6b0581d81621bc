//! The barrier function of a window: its value, gradient, and Gauss-Newton Hessian per station.
//!
//! Unknowns are `a = u'^2` and `b = u''` at the stations and `c = u'''/u'` on the intervals between them; on
//! an interval `b` is linear and `a` quadratic in the parameter. Every constraint is `|y| <= 1` for an axis
//! and a point: acceleration `y = (q'' a + q' b)/A`, jerk `y = sqrt(a) (q''' a + 3 q'' b + q' c)/J`. It
//! contributes `-w log(1 - y^2)`; a cap contributes a quarter of `-w log(1 - a/cap)`. The weight `w` of an
//! interval is the barrier parameter times the duration of the interval, so that the barrier costs the same
//! fraction of the motion everywhere, on any scale of length and time.
//!
//! `-w log(a + b d)` keeps the speed above zero between the stations too: together with the values at the
//! ends it is the middle one of the three Bernstein coefficients of the quadratic `a` over an interval of
//! length `d`. It has a cap as well: where the speed has its maximum inside an interval, that maximum does
//! not exceed the caps there.

use std::ops::{Add, AddAssign, Mul};

use wide::f64x2;

use crate::window::Window;

/// Weight of the barrier at a cap relative to that of an axis constraint. Where only the cap limits the
/// motion, the speed stays below it by the barrier parameter times this. 1/4, because the fourth root of the
/// caps' product is two square roots.
const CAP_WEIGHT: f64 = 0.25;

/// Values at the stations and intervals.
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

    /// Sets everything to zero, for `n` intervals.
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

/// The objective besides the barrier.
#[derive(Clone, Debug, Default)]
pub(crate) struct Objective {
    /// Linear weights of `a` at the stations, added to the duration.
    pub(crate) linear: Vec<f64>,
    /// Barrier weights of the intervals.
    pub(crate) weight: Vec<f64>,
}

/// Per station: gradient by `(a, b, c)` and Hessian `aa, ab, bb, ac, bc, cc`. `c` of the last station is
/// unused.
#[derive(Clone, Debug, Default)]
pub(crate) struct Local {
    pub(crate) g: Vec<[f64; 3]>,
    pub(crate) h: Vec<[f64; 6]>,
}

/// Two numbers: of an interval with even index and of the next one.
type Pair = f64x2;

/// Two neighbouring intervals: their lengths, and the values at their starts, middles and ends.
struct StationPair {
    first: usize,
    second: usize,
    d: Pair,
    a: Pair,
    b: Pair,
    c: Pair,
    end: (Pair, Pair),
    middle: (Pair, Pair),
    /// `u'^2` of the middle Bernstein coefficient.
    control: Pair,
    /// 0 where the state at the start is fixed and only the jerk after it is free.
    free: Pair,
}

impl StationPair {
    /// The pair with index `j`. With an odd number of intervals the last one fills both places.
    fn new(window: &Window, x: &Iterate, j: usize) -> Self {
        let n = window.n();
        let (first, second) = (2 * j, (2 * j + 1).min(n - 1));
        let of = |values: &[f64]| Pair::new([values[first], values[second]]);
        let next = |values: &[f64]| Pair::new([values[first + 1], values[second + 1]]);
        let (d, a, b, c) = (of(&window.d), of(&x.a), of(&x.b), of(&x.c));
        let free = if j == 0 && !window.from_rest {
            Pair::new([0.0, if n > 1 { 1.0 } else { 0.0 }])
        } else {
            Pair::splat(1.0)
        };
        Self {
            first,
            second,
            d,
            a,
            b,
            c,
            end: (next(&x.a), next(&x.b)),
            middle: (a + d * (b + 0.25 * d * c), b + 0.5 * d * c),
            control: a + b * d,
            free,
        }
    }

    /// Caps of `u'^2` at the starts, in the middles and of the middle Bernstein coefficients.
    fn caps(&self, window: &Window) -> [Pair; 3] {
        let (first, second) = (self.first, self.second);
        let start = Pair::new([window.cap[first], window.cap[second]]);
        let end = Pair::new([window.cap[first + 1], window.cap[second + 1]]);
        let middle = Pair::new([window.middle_cap[first], window.middle_cap[second]]);
        [start, middle, middle.fast_max(start).fast_max(end)]
    }

    fn of(&self, values: &[f64]) -> Pair {
        Pair::new([values[self.first], values[self.second]])
    }

    /// The state at the three points.
    fn states(&self) -> [(Pair, Pair, Pair); 3] {
        [
            (self.a, self.b, self.c),
            (self.middle.0, self.middle.1, self.c),
            (self.end.0, self.end.1, self.c),
        ]
    }

    /// Factors on the jerk and acceleration constraints at the three points; 0 where there are none.
    fn rows(&self, window: &Window) -> [(Pair, Pair); 3] {
        let one = Pair::splat(1.0);
        let curved = self.of(&window.curved);
        [(one, self.free), (curved, curved), (one, self.of(&window.joints))]
    }

    /// Factors on acceleration and jerk constraints, see [`Window::relaxation`].
    fn relaxation(&self, window: &Window) -> (Pair, Pair) {
        let (first, second) = (window.relaxation[self.first], window.relaxation[self.second]);
        (Pair::new([first.0, second.0]), Pair::new([first.1, second.1]))
    }
}

fn is_zero(pair: Pair) -> bool {
    pair == Pair::splat(0.0)
}

fn all_positive(pair: Pair) -> bool {
    let [first, second] = pair.to_array();
    first > 0.0 && second > 0.0
}

/// Duration of an interval by Simpson's rule.
pub(crate) fn interval_time(d: f64, a: f64, middle: f64, end: f64) -> f64 {
    d / 6.0 * (1.0 / a.sqrt() + 4.0 / middle.sqrt() + 1.0 / end.sqrt())
}

/// Value of the barrier function; `None` outside of the limits.
pub(crate) fn value(window: &Window, objective: &Objective, x: &Iterate) -> Option<f64> {
    let n = window.n();
    let one = Pair::splat(1.0);
    let (rows, _) = window.rows.as_chunks::<9>();
    let mut sum = Pair::splat(0.0);
    let mut last = Pair::splat(0.0);
    for j in 0..n.div_ceil(2) {
        let pair = StationPair::new(window, x, j);
        let roots = [pair.a.sqrt(), pair.middle.0.sqrt(), pair.end.0.sqrt()];
        // NaN is in every sum and product from here on, so it fails the final check.
        let low = (pair.a.fast_min(pair.middle.0)).fast_min(pair.end.0.fast_min(pair.control));
        if !all_positive(low) {
            return None;
        }
        let caps = pair.caps(window);
        let mut margin = one - pair.free * pair.a / caps[0];
        let mid = one - pair.middle.0 / caps[1];
        let top = one - pair.free * pair.control / caps[2];
        let mut min = margin.fast_min(mid).fast_min(top);
        // The fourth root: see CAP_WEIGHT.
        margin = (margin * mid * top).sqrt().sqrt();
        let (relaxation_a, relaxation_j) = pair.relaxation(window);
        let parts = pair.rows(window);
        let states = pair.states();
        for (point, (on_jerk, on_acceleration)) in parts.into_iter().enumerate() {
            if is_zero(on_jerk) {
                continue;
            }
            let ((a, b, c), root) = (states[point], roots[point]);
            let (b3, root) = (3.0 * b, root * relaxation_j);
            for (i, row) in rows[window.count * j..window.count * (j + 1)].iter().enumerate() {
                let (d1, d2, d3) = (row[3 * point], row[3 * point + 1], row[3 * point + 2]);
                let y = root * (d3 * a + d2 * b3 + d1 * c) * window.inverse_j[i];
                let left = one - on_jerk * y * y;
                margin *= left;
                min = min.fast_min(left);
            }
            if is_zero(on_acceleration) {
                continue;
            }
            for (i, row) in rows[window.count * j..window.count * (j + 1)].iter().enumerate() {
                let y = (row[3 * point + 1] * a + row[3 * point] * b) * relaxation_a * window.inverse_a[i];
                let left = one - on_acceleration * y * y;
                margin *= left;
                min = min.fast_min(left);
            }
        }
        if !all_positive(min) {
            return None;
        }
        margin *= pair.control / caps[1];
        let [first, second] = margin.to_array();
        let logarithms = Pair::new([libm::log(first), libm::log(second)]);
        let ends = roots[0] * roots[2];
        let time = pair.d / 6.0 * (roots[1] * (roots[0] + roots[2]) + 4.0 * ends) / (ends * roots[1]);
        last = time + pair.of(&objective.linear) * pair.a - pair.of(&objective.weight) * logarithms;
        sum += last;
    }
    let [even, odd] = sum.to_array();
    let mut sum = even + odd;
    if n % 2 == 1 {
        sum = even + (odd - last.to_array()[1]);
    }
    sum += 3.0 * (window.start.length / x.a[0].sqrt() + window.end.length / x.a[n].sqrt());
    let (a, b) = (x.a[n], x.b[n]);
    sum += objective.linear[n] * a;
    let (w0, w1) = (objective.weight[0], objective.weight[n - 1]);
    let mut margin = (1.0 - a / window.cap[n]).sqrt().sqrt();
    let low = 1.0 + b / window.end.max_b;
    if !(a > 0.0 && margin > 0.0 && low > 0.0 && b < 0.0) {
        return None;
    }
    margin *= low;
    sum -= w1 * libm::log(margin);
    if window.from_rest {
        let low = 1.0 - x.b[0] / window.start.max_b;
        if !(low > 0.0 && x.b[0] > 0.0) {
            return None;
        }
        sum -= w0 * libm::log(low);
    }
    sum.is_finite().then_some(sum)
}

/// Gradient and Hessian, of one number or of two in parallel.
struct Model<T> {
    g: [T; 3],
    h: [T; 6],
}

impl Model<Pair> {
    fn new() -> Self {
        let zero = Pair::splat(0.0);
        Self {
            g: [zero; 3],
            h: [zero; 6],
        }
    }

    /// Adds `-weight log(1 - y^2)` of a constraint with gradient `dy`, without the second derivatives of `y`
    /// (Gauss-Newton).
    fn add_row(&mut self, y: Pair, dy: [Pair; 3], weight: Pair) {
        let square = y * y;
        let inverse = 1.0 / (1.0 - square);
        let double = (weight + weight) * inverse;
        let (r, s) = (double * y, double * inverse * (1.0 + square));
        let [da, db, dc] = dy;
        let (sa, sb) = (s * da, s * db);
        self.g[0] += r * da;
        self.g[1] += r * db;
        self.g[2] += r * dc;
        self.h[0] += sa * da;
        self.h[1] += sa * db;
        self.h[2] += sb * db;
        self.h[3] += sa * dc;
        self.h[4] += sb * dc;
        self.h[5] += s * dc * dc;
    }

    /// The same for `y` independent of `c`.
    fn add_short_row(&mut self, y: Pair, dy: [Pair; 2], weight: Pair) {
        let square = y * y;
        let inverse = 1.0 / (1.0 - square);
        let double = (weight + weight) * inverse;
        let (r, s) = (double * y, double * inverse * (1.0 + square));
        let [da, db] = dy;
        let sa = s * da;
        self.g[0] += r * da;
        self.g[1] += r * db;
        self.h[0] += sa * da;
        self.h[1] += sa * db;
        self.h[2] += s * db * db;
    }

    /// Adds `scale / sqrt(a) - CAP_WEIGHT weight log(1 - a/cap)`.
    ///
    /// Nothing where `on` is 0.
    fn add_cap(&mut self, a: Pair, root: Pair, cap: Pair, weight: Pair, scale: Pair, on: Pair) {
        let inverse = 1.0 / a;
        let slope = -0.5 * scale * on * inverse / root;
        let f = 1.0 / (cap - on * a);
        let push = CAP_WEIGHT * weight * on * f;
        self.g[0] += slope + push;
        self.h[0] += push * f - 1.5 * slope * inverse;
    }
}

impl<T> Model<T>
where
    T: Copy + Add<Output = T> + Mul<Output = T> + Mul<f64, Output = T> + AddAssign,
{
    /// Adds the model of a point at distance `x` from the station to the model of the station.
    fn add_shifted(&mut self, x: T, point: &Self) {
        // The point's (a, b, c) as a function of the station's: rows (1, 2x, x^2), (0, 1, x), (0, 0, 1).
        let [aa, ab, bb, ac, bc, cc] = point.h;
        let (gp, twice) = (point.g, x * 2.0);
        self.g[0] += gp[0];
        self.g[1] += twice * gp[0] + gp[1];
        self.g[2] += x * (x * gp[0] + gp[1]) + gp[2];
        // Columns of the point's Hessian times the matrix.
        let (ab1, bb1) = (twice * aa + ab, twice * ab + bb);
        let (ac1, bc2, cc1) = (
            x * (x * aa + ab) + ac,
            x * (x * ab + bb) + bc,
            x * (x * ac + bc) + cc,
        );
        self.h[0] += aa;
        self.h[1] += ab1;
        self.h[2] += twice * ab1 + bb1;
        self.h[3] += ac1;
        self.h[4] += twice * ac1 + bc2;
        self.h[5] += x * (x * ac1 + bc2) + cc1;
    }
}

/// Gradient and Hessian at a feasible point.
pub(crate) fn assemble(window: &Window, objective: &Objective, x: &Iterate, local: &mut Local) {
    let n = window.n();
    local.g.clear();
    local.h.clear();
    local.g.resize(n + 1, [0.0; 3]);
    local.h.resize(n + 1, [0.0; 6]);
    let (rows, _) = window.rows.as_chunks::<9>();
    // The terms at the end of an interval are folded into its own (a, b, c): a1 = a + 2 b d + c d^2, b1 = b +
    // c d.
    for j in 0..n.div_ceil(2) {
        let pair = StationPair::new(window, x, j);
        let (weight, d) = (pair.of(&objective.weight), pair.d);
        let caps = pair.caps(window);
        let (relaxation_a, relaxation_j) = pair.relaxation(window);
        let (parts, states) = (pair.rows(window), pair.states());
        let roots = [pair.a.sqrt(), pair.middle.0.sqrt(), pair.end.0.sqrt()];
        let mut models = [Model::new(), Model::new(), Model::new()];
        for (point, (on_jerk, on_acceleration)) in parts.into_iter().enumerate() {
            if is_zero(on_jerk) {
                continue;
            }
            let ((a, b, c), model) = (states[point], &mut models[point]);
            let (b3, root) = (3.0 * b, roots[point]);
            let half = 0.5 / root;
            let on = weight * on_jerk;
            for (i, row) in rows[window.count * j..window.count * (j + 1)].iter().enumerate() {
                let inverse = relaxation_j * window.inverse_j[i];
                let (d1, d2, d3) = (row[3 * point], row[3 * point + 1], row[3 * point + 2]);
                let l = (d3 * a + d2 * b3 + d1 * c) * inverse;
                let scale = root * inverse;
                let dy = [scale * d3 + half * l, 3.0 * scale * d2, scale * d1];
                model.add_row(on_jerk * root * l, dy, on);
            }
            if is_zero(on_acceleration) {
                continue;
            }
            let on = weight * on_acceleration;
            for (i, row) in rows[window.count * j..window.count * (j + 1)].iter().enumerate() {
                let inverse = relaxation_a * window.inverse_a[i];
                let dy = [row[3 * point + 1] * inverse, row[3 * point] * inverse];
                model.add_short_row(on_acceleration * (dy[0] * a + dy[1] * b), dy, on);
            }
        }
        let [mut model, mut middle, mut end] = models;
        let sixth = d / 6.0;
        // A fixed start contributes constants only.
        let one = Pair::splat(1.0);
        model.add_cap(pair.a, roots[0], caps[0], weight, sixth, pair.free);
        middle.add_cap(pair.middle.0, roots[1], caps[1], weight, 4.0 * sixth, one);
        let time = -0.5 * sixth / (pair.end.0 * roots[2]);
        end.g[0] += time;
        end.h[0] -= 1.5 * time / pair.end.0;
        let inverse = 1.0 / pair.control;
        let f = 1.0 / (caps[2] - pair.free * pair.control);
        let push = CAP_WEIGHT * pair.free * weight * f;
        let (slope, bend) = (push - weight * inverse, push * f + weight * inverse * inverse);
        model.g[0] += pair.of(&objective.linear) + slope;
        model.g[1] += d * slope;
        model.h[0] += bend;
        model.h[1] += d * bend;
        model.h[2] += d * d * bend;
        model.add_shifted(0.5 * d, &middle);
        model.add_shifted(d, &end);
        for (i, g) in model.g.into_iter().enumerate() {
            let [first, second] = g.to_array();
            (local.g[pair.first][i], local.g[pair.second][i]) = (first, second);
        }
        for (i, h) in model.h.into_iter().enumerate() {
            let [first, second] = h.to_array();
            (local.h[pair.first][i], local.h[pair.second][i]) = (first, second);
        }
    }
    if window.from_rest {
        let (g, h) = (&mut local.g[0], &mut local.h[0]);
        let weight = objective.weight[0];
        add_time(x.a[0], 3.0 * window.start.length, g, h);
        let f = 1.0 / (window.start.max_b - x.b[0]);
        g[1] += weight * f;
        h[2] += weight * f * f;
    }
    let (g, h) = (&mut local.g[n], &mut local.h[n]);
    let weight = objective.weight[n - 1];
    add_time(x.a[n], 3.0 * window.end.length, g, h);
    let f = 1.0 / (window.cap[n] - x.a[n]);
    g[0] += objective.linear[n] + CAP_WEIGHT * weight * f;
    h[0] += CAP_WEIGHT * weight * f * f;
    let f = 1.0 / (window.end.max_b + x.b[n]);
    g[1] -= weight * f;
    h[2] += weight * f * f;
}

/// Adds `scale / sqrt(a)`.
fn add_time(a: f64, scale: f64, g: &mut [f64; 3], h: &mut [f64; 6]) {
    let slope = -0.5 * scale / (a * a.sqrt());
    g[0] += slope;
    h[0] -= 1.5 * slope / a;
}

/// Maximum `|y|` of the acceleration and of the jerk constraints on interval `k`.
pub(crate) fn constraint_ratio(window: &Window, k: usize, x: &Iterate) -> (f64, f64) {
    let (d, a, b, c) = (window.d[k], x.a[k], x.b[k], x.c[k]);
    let (rows, _) = window.rows.as_chunks::<9>();
    let rows = &rows[window.count * (k / 2)..window.count * (k / 2 + 1)];
    let (mut max_a, mut max_j): (f64, f64) = (0.0, 0.0);
    for (point, at) in [0.0, 0.5 * d, d].into_iter().enumerate() {
        if point == 1 && window.curved[k] == 0.0 {
            continue;
        }
        let (ap, bp) = if point == 2 {
            (x.a[k + 1], x.b[k + 1])
        } else {
            (a + at * (2.0 * b + at * c), b + at * c)
        };
        let root = ap.max(0.0).sqrt();
        for (i, row) in rows.iter().enumerate() {
            let derivative = |order: usize| row[3 * point + order].to_array()[k % 2];
            let (d1, d2, d3) = (derivative(0), derivative(1), derivative(2));
            if point > 0 || k > 0 || window.from_rest {
                max_a = max_a.max((d2 * ap + d1 * bp).abs() * window.inverse_a[i]);
            }
            let jerk = root * (d3 * ap + 3.0 * d2 * bp + d1 * c);
            max_j = max_j.max(jerk.abs() * window.inverse_j[i]);
        }
    }
    (max_a, max_j)
}
