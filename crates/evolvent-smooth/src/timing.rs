//! A quick near-optimal time law along a window of the spline: what the spline is refined for.
//!
//! Along the parameter `u` let `a = u'^2`, `b = u''` and `c = u''' / u'`, the last constant between stations; then
//! `da/du = 2 b`, `db/du = c`, and velocity, acceleration and jerk of an axis are
//! `q' sqrt(a)`, `q'' a + q' b` and `sqrt(a) (q''' a + 3 q'' b + q' c)`. The time, the integral of `du / sqrt(a)`, is
//! minimised inside these limits by a log barrier; the Newton step comes from a Riccati recursion over the
//! stations. The ends of the window are free, so the law is what the axes allow there, not what will be driven.

use evolvent_path::{AXES, Axes};

use crate::newton::Term;
use crate::weights::Scales;
use crate::zone::Zone;

/// Stations in an interval of the spline.
const STATIONS: usize = 3;
/// Barrier: factor from one round to the next, and the share of the time at which it ends.
const FACTOR: f64 = 0.2;
const ENOUGH: f64 = 3e-3;
/// Share of the limits that the first law uses.
const BEGIN: f64 = 0.5;
/// Weights of acceleration, and of velocity where it is at its limit, beside jerk.
const ACCELERATION: f64 = 0.3;
const VELOCITY: f64 = 3.0;

/// One station: derivatives of the spline in units of the limits, and the bound of `a`.
#[derive(Clone, Copy, Debug)]
struct Station<const D: usize> {
    /// `q' / A`, `q'' / A`.
    a1: [f64; D],
    a2: [f64; D],
    /// `q' / J`, `3 q'' / J`, `q''' / J` to the right and to the left.
    j1: [f64; D],
    j2: [f64; D],
    j3: [f64; D],
    j3l: [f64; D],
    most: f64,
}

/// Memory that is kept.
#[derive(Debug, Default)]
pub(crate) struct Timing {
    solvers: Solvers,
    pub(crate) iterations: usize,
}

#[derive(Debug, Default)]
struct Solvers {
    one: Solver<1>,
    two: Solver<2>,
    three: Solver<3>,
    four: Solver<4>,
    five: Solver<5>,
    six: Solver<6>,
    seven: Solver<7>,
    eight: Solver<8>,
    nine: Solver<9>,
}

/// A window of the spline and what bounds the speed on it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Window<'a> {
    pub(crate) zone: &'a Zone,
    pub(crate) from: usize,
    pub(crate) to: usize,
    pub(crate) scales: &'a Scales,
    pub(crate) active: &'a [bool; AXES],
    /// Bound of the feed of each interval.
    pub(crate) feeds: &'a [f64],
    /// Where the path is at rest before and behind; infinite where it is not.
    pub(crate) rests: (f64, f64),
}

impl Timing {
    /// Finds the law, from the last one of the same window if `warm`; false if none was found.
    pub(crate) fn solve(&mut self, window: &Window<'_>, warm: bool) -> bool {
        macro_rules! with {
            ($field:ident) => {{
                let found = self.solvers.$field.run(window, warm);
                self.iterations += self.solvers.$field.iterations;
                found
            }};
        }
        match window.active.iter().filter(|&&active| active).count() {
            0 => false,
            1 => with!(one),
            2 => with!(two),
            3 => with!(three),
            4 => with!(four),
            5 => with!(five),
            6 => with!(six),
            7 => with!(seven),
            8 => with!(eight),
            _ => with!(nine),
        }
    }

    /// The law: `a`, `b`, `c` at the stations.
    pub(crate) fn law(&self, window: &Window<'_>) -> (&[f64], &[f64], &[f64]) {
        macro_rules! of {
            ($f:ident) => {
                (&self.solvers.$f.a, &self.solvers.$f.b, &self.solvers.$f.c)
            };
        }
        match window.active.iter().filter(|&&active| active).count() {
            1 => of!(one),
            2 => of!(two),
            3 => of!(three),
            4 => of!(four),
            5 => of!(five),
            6 => of!(six),
            7 => of!(seven),
            8 => of!(eight),
            _ => of!(nine),
        }
    }

    /// Time that the window takes.
    pub(crate) fn seconds(&self, window: &Window<'_>) -> f64 {
        match window.active.iter().filter(|&&active| active).count() {
            0 => 0.0,
            1 => self.solvers.one.seconds(),
            2 => self.solvers.two.seconds(),
            3 => self.solvers.three.seconds(),
            4 => self.solvers.four.seconds(),
            5 => self.solvers.five.seconds(),
            6 => self.solvers.six.seconds(),
            7 => self.solvers.seven.seconds(),
            8 => self.solvers.eight.seconds(),
            _ => self.solvers.nine.seconds(),
        }
    }

    /// Terms that measure jerk and acceleration under the law, and the time of each interval.
    pub(crate) fn terms(&self, window: &Window<'_>, terms: &mut Vec<Term>, times: &mut Vec<f64>) {
        match window.active.iter().filter(|&&active| active).count() {
            0 => {}
            1 => self.solvers.one.terms(window, terms, times),
            2 => self.solvers.two.terms(window, terms, times),
            3 => self.solvers.three.terms(window, terms, times),
            4 => self.solvers.four.terms(window, terms, times),
            5 => self.solvers.five.terms(window, terms, times),
            6 => self.solvers.six.terms(window, terms, times),
            7 => self.solvers.seven.terms(window, terms, times),
            8 => self.solvers.eight.terms(window, terms, times),
            _ => self.solvers.nine.terms(window, terms, times),
        }
    }
}

#[derive(Debug, Default)]
struct Solver<const D: usize> {
    stations: Vec<Station<D>>,
    steps: Vec<f64>,
    a: Vec<f64>,
    b: Vec<f64>,
    c: Vec<f64>,
    trial: [Vec<f64>; 3],
    gradients: Vec<[f64; 3]>,
    hessians: Vec<[f64; 6]>,
    gains: Vec<[f64; 3]>,
    moves: Vec<[f64; 3]>,
    iterations: usize,
    mu: f64,
}

impl<const D: usize> Solver<D> {
    fn axes(window: &Window<'_>) -> [usize; D] {
        let mut axes = [0; D];
        for (slot, axis) in axes.iter_mut().zip((0..AXES).filter(|&i| window.active[i])) {
            *slot = axis;
        }
        axes
    }

    fn prepare(&mut self, window: &Window<'_>) {
        let axes = Self::axes(window);
        let zone = window.zone;
        let scale = |v: &Axes, s: &Axes| -> [f64; D] { std::array::from_fn(|d| v[axes[d]] * s[axes[d]]) };
        self.stations.clear();
        self.steps.clear();
        let mut third = Axes::zeros();
        for i in window.from..=window.to {
            // Behind the last interval its own end.
            let (i, offset, count) = if i < window.to {
                (i, 0.0, STATIONS)
            } else {
                (i - 1, zone.knot(i) - zone.knot(i - 1), 1)
            };
            let jet = zone.jet(i);
            if offset == 0.0 && i == window.from {
                third = jet.third;
            }
            let width = zone.knot(i + 1) - zone.knot(i);
            for k in 0..count {
                let x = offset + width * k as f64 / STATIONS as f64;
                let first = jet.first + (jet.second + jet.third * (0.5 * x)) * x;
                let second = jet.second + jet.third * x;
                let (velocity, acceleration, jerk) =
                    (&window.scales.velocity, &window.scales.acceleration, &window.scales.jerk);
                let rate = |scale: &Axes| axes.iter().map(|&d| first[d].abs() * scale[d]).fold(0.0, f64::max);
                let slowest = axes.iter().map(|&d| velocity[d]).fold(0.0, f64::max).max(1e-9);
                let speed = crate::joint::metric(&first).max(1e-9);
                let mut most = (1.0 / rate(velocity).max(0.3 * slowest)).min(window.feeds[i - window.from] / speed);
                let u = zone.knot(i) + x;
                for rest in [u - window.rests.0, window.rests.1 - u] {
                    // From rest with the largest jerk: v^3 = 9/2 J s^2.
                    let rest = rest.max(0.1 * width);
                    most = most.min(libm::cbrt(4.5 * rest * rest / rate(jerk).max(1e-12)));
                    most = most.min((2.0 * rest / rate(acceleration).max(1e-12)).sqrt());
                }
                self.stations.push(Station {
                    a1: scale(&first, acceleration),
                    a2: scale(&second, acceleration),
                    j1: scale(&first, jerk),
                    j2: scale(&(second * 3.0), jerk),
                    j3: scale(&jet.third, jerk),
                    j3l: scale(if k == 0 && offset == 0.0 { &third } else { &jet.third }, jerk),
                    most: most * most,
                });
                if offset == 0.0 {
                    self.steps.push(width / STATIONS as f64);
                }
            }
            third = jet.third;
        }
    }

    /// A slow, smooth law by the local limits.
    fn begin(&mut self) {
        let n = self.steps.len();
        let count = self.stations.len();
        self.a.clear();
        self.b.clear();
        self.c.clear();
        // Values of a quadratic spline's control points between the stations.
        let mut control = std::mem::take(&mut self.trial[0]);
        control.clear();
        for s in &self.stations {
            let norm = |v: &[f64; D]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
            let most = s
                .most
                .min(1.0 / norm(&s.a2).max(1e-12))
                .min(libm::cbrt(1.0 / norm(&s.j3).max(norm(&s.j3l)).max(1e-18)).powi(2));
            control.push(BEGIN * most);
        }
        // The least of the neighbours, then averages.
        for k in 0..count {
            let near = k.saturating_sub(4)..(k + 5).min(count);
            let least = control[near].iter().copied().fold(f64::INFINITY, f64::min);
            self.a.push(least);
        }
        for k in 0..count {
            let near = k.saturating_sub(4)..(k + 5).min(count);
            let size = near.len() as f64;
            control[k] = self.a[near].iter().sum::<f64>() / size;
        }
        // Interval control points: d_k over interval k; a at a station is their average by width.
        for k in 0..count {
            let (before, after) = (k.max(1) - 1, k.min(n - 1));
            let (hb, ha) = (self.steps[before], self.steps[after]);
            let (db, da) = if k == 0 || k == n {
                (control[k], control[k])
            } else {
                (
                    0.5 * (control[before] + control[before + 1]),
                    0.5 * (control[after] + control[after + 1]),
                )
            };
            self.a[k] = (db * ha + da * hb) / (hb + ha);
            self.b.push((da - db) / (hb + ha));
        }
        for k in 0..n {
            self.c.push((self.b[k + 1] - self.b[k]) / self.steps[k]);
        }
        // Made consistent from the start.
        let mut a = self.a[0];
        for k in 0..n {
            self.a[k] = a;
            a += (self.b[k] + self.b[k + 1]) * self.steps[k];
        }
        self.a[n] = a;
        self.trial[0] = control;
        // Slow parts must not vanish.
        let least = self.a.iter().copied().fold(f64::INFINITY, f64::min);
        if !(least > 0.0) {
            let crawl = self.stations.iter().map(|s| s.most).fold(f64::INFINITY, f64::min);
            self.a.fill(0.01 * crawl);
            self.b.fill(0.0);
            self.c.fill(0.0);
        }
    }

    /// Slows the law down until it keeps every limit with room.
    fn fit(&mut self) -> bool {
        let n = self.steps.len();
        let mut factor: f64 = 1.0;
        for k in 0..=n {
            let s = &self.stations[k];
            let (a, b) = (self.a[k], self.b[k]);
            if !(a > 0.0) {
                return false;
            }
            factor = factor.min(s.most / a);
            if k < n {
                let h = self.steps[k];
                let middle = a + h * (b + 0.25 * h * self.c[k]);
                if !(middle > 0.0) {
                    return false;
                }
                factor = factor.min(s.most.max(self.stations[k + 1].most) / middle);
            }
            for d in 0..D {
                let acceleration = (s.a2[d] * a + s.a1[d] * b).abs();
                factor = factor.min(1.0 / acceleration);
                let root = a.sqrt();
                if k < n {
                    let jerk = root * (s.j3[d] * a + s.j2[d] * b + s.j1[d] * self.c[k]).abs();
                    factor = factor.min(1.0 / libm::cbrt(jerk * jerk));
                }
                if k > 0 {
                    let jerk = root * (s.j3l[d] * a + s.j2[d] * b + s.j1[d] * self.c[k - 1]).abs();
                    factor = factor.min(1.0 / libm::cbrt(jerk * jerk));
                }
            }
        }
        let factor = if factor < 1.0 { 0.9 * factor } else { (0.9 * factor).min(1.0) };
        if !(factor > 0.0) {
            return false;
        }
        for values in [&mut self.a, &mut self.b, &mut self.c] {
            for value in values.iter_mut() {
                *value *= factor;
            }
        }
        true
    }

    fn run(&mut self, window: &Window<'_>, warm: bool) -> bool {
        self.iterations = 0;
        let before = self.stations.len();
        self.prepare(window);
        let n = self.steps.len();
        if n == 0 {
            return false;
        }
        if !(warm && before == n + 1 && self.a.len() == n + 1 && self.fit()) {
            self.begin();
            if !self.fit() {
                return false;
            }
        }
        let rows = ((4 + 3 * D) * n) as f64;
        let mut mu = self.seconds() / rows * if warm { 0.2 } else { 1.0 };
        self.gradients.resize(n + 1, [0.0; 3]);
        self.hessians.resize(n + 1, [0.0; 6]);
        self.gains.resize(n + 1, [0.0; 3]);
        self.moves.resize(n + 1, [0.0; 3]);
        for (trial, values) in self.trial.iter_mut().zip([&self.a, &self.b, &self.c]) {
            trial.clone_from(values);
        }
        loop {
            let Some(mut merit) = self.merit([&self.a, &self.b, &self.c], mu) else {
                return false;
            };
            for _ in 0..8 {
                self.iterations += 1;
                self.assemble(mu);
                let slope = self.riccati();
                if -slope < 1e-2 * mu * rows {
                    break;
                }
                let mut length: f64 = 1.0;
                for k in 0..=n {
                    let d = self.moves[k][0];
                    if d < 0.0 {
                        length = length.min(0.98 * self.a[k] / -d);
                    } else if d > 0.0 {
                        length = length.min(0.98 * (self.stations[k].most - self.a[k]) / d);
                    }
                }
                let mut better = false;
                for _ in 0..20 {
                    let mut trial = std::mem::take(&mut self.trial);
                    for k in 0..=n {
                        trial[0][k] = self.a[k] + length * self.moves[k][0];
                        trial[1][k] = self.b[k] + length * self.moves[k][1];
                        if k < n {
                            trial[2][k] = self.c[k] + length * self.moves[k][2];
                        }
                    }
                    let value = self.merit([&trial[0], &trial[1], &trial[2]], mu);
                    self.trial = trial;
                    if let Some(value) = value
                        && value <= merit + 1e-4 * length * slope
                    {
                        merit = value;
                        better = true;
                        break;
                    }
                    length *= 0.5;
                }
                if !better {
                    break;
                }
                std::mem::swap(&mut self.a, &mut self.trial[0]);
                std::mem::swap(&mut self.b, &mut self.trial[1]);
                std::mem::swap(&mut self.c, &mut self.trial[2]);
            }
            self.mu = mu;
            if mu * rows < ENOUGH * self.seconds() {
                return true;
            }
            mu *= FACTOR;
        }
    }

    /// Time over an interval by Simpson's rule on 1 / sqrt(a).
    fn duration(&self, k: usize) -> f64 {
        let (h, a) = (self.steps[k], self.a[k]);
        let middle = a + h * (self.b[k] + 0.25 * h * self.c[k]);
        h / 6.0 * (1.0 / a.sqrt() + 4.0 / middle.max(1e-12).sqrt() + 1.0 / self.a[k + 1].sqrt())
    }

    fn seconds(&self) -> f64 {
        (0..self.steps.len()).map(|k| self.duration(k)).sum()
    }

    /// Time with barrier; `None` outside the limits.
    fn merit(&self, [a, b, c]: [&[f64]; 3], mu: f64) -> Option<f64> {
        let n = self.steps.len();
        let (mut time, mut product, mut logs) = (0.0, 1.0f64, 0.0);
        for k in 0..=n {
            let s = &self.stations[k];
            let room = s.most - a[k];
            if !(a[k] > 0.0 && room > 0.0) {
                return None;
            }
            let root = a[k].sqrt();
            let step = if k == 0 { 0.0 } else { self.steps[k - 1] } + if k < n { self.steps[k] } else { 0.0 };
            time += step / (6.0 * root);
            product *= room / s.most;
            for d in 0..D {
                let q = s.a2[d] * a[k] + s.a1[d] * b[k];
                let room = 1.0 - q * q;
                if !(room > 0.0) {
                    return None;
                }
                product *= room;
                if k < n {
                    let q = root * (s.j3[d] * a[k] + s.j2[d] * b[k] + s.j1[d] * c[k]);
                    let room = 1.0 - q * q;
                    if !(room > 0.0) {
                        return None;
                    }
                    product *= room;
                }
                if k > 0 {
                    let q = root * (s.j3l[d] * a[k] + s.j2[d] * b[k] + s.j1[d] * c[k - 1]);
                    let room = 1.0 - q * q;
                    if !(room > 0.0) {
                        return None;
                    }
                    product *= room;
                }
            }
            if k < n {
                let h = self.steps[k];
                let middle = a[k] + h * (b[k] + 0.25 * h * c[k]);
                let most = s.most.max(self.stations[k + 1].most);
                if !(middle > 0.0 && middle < most) {
                    return None;
                }
                time += h * 2.0 / (3.0 * middle.sqrt());
                product *= middle / most * ((most - middle) / most);
            }
            if !(1e-100..1e100).contains(&product) {
                logs += libm::log(product.max(1e-300));
                product = 1.0;
            }
        }
        Some(time - mu * (logs + libm::log(product)))
    }

    fn assemble(&mut self, mu: f64) {
        let n = self.steps.len();
        let pair = |g: &mut [f64; 3], h: &mut [f64; 6], v: f64, da: f64, db: f64, dc: f64| {
            let inverse = 1.0 / (1.0 - v * v);
            let r = 2.0 * mu * v * inverse;
            let q = 2.0 * mu * (1.0 + v * v) * inverse * inverse;
            g[0] += r * da;
            g[1] += r * db;
            g[2] += r * dc;
            h[0] += q * da * da;
            h[1] += q * da * db;
            h[2] += q * db * db;
            h[3] += q * da * dc;
            h[4] += q * db * dc;
            h[5] += q * dc * dc;
        };
        for k in 0..=n {
            let s = &self.stations[k];
            let (a, b) = (self.a[k], self.b[k]);
            let root = a.sqrt();
            let step = if k == 0 { 0.0 } else { self.steps[k - 1] } + if k < n { self.steps[k] } else { 0.0 };
            let w = step / 6.0;
            let mut g = [-0.5 * w / (a * root), 0.0, 0.0];
            let mut h = [0.75 * w / (a * a * root), 0.0, 0.0, 0.0, 0.0, 0.0];
            let room = 1.0 / (s.most - a);
            g[0] += mu * room;
            h[0] += mu * room * room;
            for d in 0..D {
                pair(&mut g, &mut h, s.a2[d] * a + s.a1[d] * b, s.a2[d], s.a1[d], 0.0);
            }
            if k < n {
                let d = self.steps[k];
                let c = self.c[k];
                let middle = a + d * (b + 0.25 * d * c);
                let w = d * 2.0 / 3.0;
                let s1 = &self.stations[k + 1];
                let most = s.most.max(s1.most);
                let z = 1.0 / (most - middle);
                let root_middle = middle.sqrt();
                let g1 = -0.5 * w / (middle * root_middle) - mu / middle + mu * z;
                let h1 = 0.75 * w / (middle * middle * root_middle) + mu / (middle * middle) + mu * z * z;
                let (e1, e2) = (d, 0.25 * d * d);
                g[0] += g1;
                g[1] += g1 * e1;
                g[2] += g1 * e2;
                h[0] += h1;
                h[1] += h1 * e1;
                h[2] += h1 * e1 * e1;
                h[3] += h1 * e2;
                h[4] += h1 * e1 * e2;
                h[5] += h1 * e2 * e2;
                let (a1, b1) = (self.a[k + 1], self.b[k + 1]);
                let root1 = a1.sqrt();
                for i in 0..D {
                    let l = s.j3[i] * a + s.j2[i] * b + s.j1[i] * c;
                    pair(&mut g, &mut h, root * l, root * s.j3[i] + 0.5 * l / root, root * s.j2[i], root * s.j1[i]);
                    let l = s1.j3l[i] * a1 + s1.j2[i] * b1 + s1.j1[i] * c;
                    let ea = root1 * s1.j3l[i] + 0.5 * l / root1;
                    let eb = root1 * s1.j2[i];
                    let ec = root1 * s1.j1[i];
                    pair(&mut g, &mut h, root1 * l, ea, 2.0 * d * ea + eb, d * d * ea + d * eb + ec);
                }
            }
            self.gradients[k] = g;
            self.hessians[k] = h;
        }
    }

    /// Newton step by a Riccati recursion, both ends free; returns the slope of the merit along it.
    fn riccati(&mut self) -> f64 {
        let n = self.steps.len();
        let (h, g) = (self.hessians[n], self.gradients[n]);
        let (mut p00, mut p01, mut p11) = (h[0], h[1], h[2] + 1e-18);
        let (mut q0, mut q1) = (g[0], g[1]);
        for k in (0..n).rev() {
            let d = self.steps[k];
            let (h, g) = (self.hessians[k], self.gradients[k]);
            let pb0 = p00 * d * d + p01 * d;
            let pb1 = p01 * d * d + p11 * d;
            let cc = h[5] + d * d * pb0 + d * pb1;
            let ca = h[3] + pb0;
            let cb = h[4] + 2.0 * d * pb0 + pb1;
            let cg = g[2] + d * d * q0 + d * q1;
            let inverse = 1.0 / cc;
            let (ka, kb, kc) = (-ca * inverse, -cb * inverse, -cg * inverse);
            self.gains[k] = [ka, kb, kc];
            let t01 = 2.0 * d * p00 + p01;
            let t11 = 4.0 * d * d * p00 + 4.0 * d * p01 + p11;
            let n00 = h[0] + p00 + ka * ca;
            let n01 = h[1] + t01 + ka * cb;
            let n11 = h[2] + t11 + kb * cb;
            let m0 = g[0] + q0 + kc * ca;
            let m1 = g[1] + 2.0 * d * q0 + q1 + kc * cb;
            (p00, p01, p11, q0, q1) = (n00, n01, n11, m0, m1);
        }
        let determinant = p00 * p11 - p01 * p01;
        let (mut x0, mut x1) = if determinant > 0.0 {
            ((p01 * q1 - p11 * q0) / determinant, (p01 * q0 - p00 * q1) / determinant)
        } else {
            (0.0, 0.0)
        };
        let mut slope = 0.0;
        for k in 0..n {
            let gain = self.gains[k];
            let u = gain[0] * x0 + gain[1] * x1 + gain[2];
            self.moves[k] = [x0, x1, u];
            let g = self.gradients[k];
            slope += g[0] * x0 + g[1] * x1 + g[2] * u;
            let d = self.steps[k];
            (x0, x1) = (x0 + 2.0 * d * x1 + d * d * u, x1 + d * u);
        }
        self.moves[n] = [x0, x1, 0.0];
        slope + self.gradients[n][0] * x0 + self.gradients[n][1] * x1
    }

    fn terms(&self, window: &Window<'_>, terms: &mut Vec<Term>, times: &mut Vec<f64>) {
        let axes = Self::axes(window);
        terms.clear();
        times.clear();
        for i in window.from..window.to {
            let basis = &window.zone.bases[i];
            let width = window.zone.knot(i + 1) - window.zone.knot(i);
            let mut time = 0.0;
            for part in 0..STATIONS {
                let k = (i - window.from) * STATIONS + part;
                let half = 0.5 * self.steps[k];
                let x = width * part as f64 / STATIONS as f64 + half;
                let c = self.c[k];
                let b = self.b[k] + c * half;
                let a = (self.a[k] + half * (2.0 * self.b[k] + c * half)).max(1e-12);
                let v = a.sqrt();
                let dt = self.duration(k);
                time += dt;
                let first = |f: &[f64; 4]| f[1] + x * (f[2] + 0.5 * x * f[3]);
                let second = |f: &[f64; 4]| f[2] + x * f[3];
                let jerk = basis.map(|f| v * (f[3] * a + 3.0 * second(&f) * b + first(&f) * c));
                let acceleration = basis.map(|f| second(&f) * a + first(&f) * b);
                let mut norm: f64 = 0.0;
                let mut js = Axes::zeros();
                for d in 0..D {
                    let axis = axes[d];
                    js[axis] = (0..4).map(|l| jerk[l] * window.zone.points[i + l][axis]).sum::<f64>()
                        * window.scales.jerk[axis];
                    norm += js[axis] * js[axis];
                }
                let norm = norm.sqrt().max(0.1);
                let scale = dt * norm;
                terms.push(Term {
                    interval: i,
                    weights: jerk,
                    factors: window.scales.jerk.map(|s| scale * s * s),
                });
                terms.push(Term {
                    interval: i,
                    weights: acceleration,
                    factors: window.scales.acceleration.map(|s| ACCELERATION * dt * s * s),
                });
                let velocity = basis.map(|f| first(&f) * v);
                let mut vs = Axes::zeros();
                for d in 0..D {
                    let axis = axes[d];
                    vs[axis] = (0..4).map(|l| velocity[l] * window.zone.points[i + l][axis]).sum::<f64>();
                }
                let feed = window.feeds[i - window.from];
                let speed = crate::joint::metric(&vs);
                let by_feed = (speed / feed).powi(8) / (feed * feed);
                terms.push(Term {
                    interval: i,
                    weights: velocity,
                    factors: Axes::from_fn(|k, _| {
                        let s = window.scales.velocity[k];
                        VELOCITY * dt * (s * s * (vs[k] * s).powi(8) + if k < 3 { by_feed } else { 0.0 })
                    }),
                });
            }
            times.push(time);
        }
    }
}

pub(crate) fn knob(name: &str, default: f64) -> f64 {
    std::env::var(name).ok().and_then(|x| x.parse().ok()).unwrap_or(default)
}
