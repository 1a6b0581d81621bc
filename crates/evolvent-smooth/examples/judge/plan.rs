//! A feed planner for judging: interior point over the whole of a path between two rests, three axes.
//!
//! Per station a = u'^2 and b = u'', per interval c = u'''/u'. Not for use on a machine: no bound on its work.

use evolvent_path::{Axes, Jet};
use evolvent_smooth::Stretch;

pub type V3 = [f64; 3];

fn v3(a: &Axes) -> V3 {
    [a[0], a[1], a[2]]
}

fn norm(a: V3) -> f64 {
    (a[0] * a[0] + a[1] * a[1] + a[2] * a[2]).sqrt()
}

/// Limits of each axis.
pub struct Limits {
    pub v: V3,
    pub a: V3,
    pub j: V3,
}

#[derive(Clone, Copy)]
struct Station {
    /// Right and left derivatives.
    q: [V3; 3],
    l: [V3; 3],
    /// Bound of a.
    most: f64,
}

pub struct Plan {
    pub u: Vec<f64>,
    pub a: Vec<f64>,
    pub b: Vec<f64>,
    pub c: Vec<f64>,
    pub dt: Vec<f64>,
    pub t0: f64,
    pub d0: f64,
    pub j0: f64,
    pub total: f64,
    pub iterations: usize,
    pub failed: bool,
}

/// Time over an interval: Gauss-Legendre.
fn seconds(a: f64, b: f64, c: f64, d: f64) -> f64 {
    const X: [f64; 5] = [
        0.0,
        0.538_469_310_105_683_1,
        -0.538_469_310_105_683_1,
        0.906_179_845_938_664,
        -0.906_179_845_938_664,
    ];
    const W: [f64; 5] = [
        0.568_888_888_888_888_9,
        0.478_628_670_499_366_47,
        0.478_628_670_499_366_47,
        0.236_926_885_056_189_08,
        0.236_926_885_056_189_08,
    ];
    let mut s = 0.0;
    for p in 0..4 {
        let h = d / 8.0;
        let m = f64::from(2 * p + 1) * h;
        for i in 0..5 {
            let x = m + h * X[i];
            s += W[i] * h / (a + x * (2.0 * b + c * x)).max(1e-12).sqrt();
        }
    }
    s
}

/// The path between two rests: stretches, and caps after so many of them.
pub struct Section {
    pub stretches: Vec<Stretch>,
    pub starts: Vec<f64>,
    pub caps: Vec<(usize, f64)>,
    pub length: f64,
}

impl Section {
    pub fn new() -> Self {
        Self {
            stretches: Vec::new(),
            starts: Vec::new(),
            caps: Vec::new(),
            length: 0.0,
        }
    }

    pub fn push(&mut self, stretch: Stretch) {
        self.starts.push(self.length);
        self.length += stretch.length;
        self.stretches.push(stretch);
    }

    pub fn find(&self, u: f64) -> usize {
        self.starts.partition_point(|&s| s <= u).max(1) - 1
    }

    pub fn jet(&self, u: f64) -> Jet {
        let k = self.find(u);
        self.stretches[k]
            .curve
            .jet(self.stretches[k].from + u - self.starts[k])
    }
}

pub fn plan(section: &Section, limits: &Limits, sub: usize) -> Plan {
    let rate = section
        .jet(0.0)
        .first
        .amax()
        .max(section.jet(section.length).first.amax());
    let js = limits.j[0].min(limits.j[1]).min(limits.j[2]) / if rate > 1.0 + 1e-9 { 1.2 * rate } else { 1.0 };
    let n = section.stretches.len();
    let slowest = section
        .stretches
        .iter()
        .map(|s| s.feed)
        .fold(limits.v[0], f64::min);
    let widths: Vec<f64> = section.stretches.iter().map(|s| s.length).collect();
    let mut d0 = (section.length / 60.0).min(5e-4);
    loop {
        let t = (6.0 * d0 / js).cbrt();
        if 1.6 * js * t * t < 0.6 * slowest || d0 < 1e-9 {
            break;
        }
        d0 *= 0.5;
    }
    let t0 = (6.0 * d0 / js).cbrt();
    // Stations: (u, stretch).
    let mut marks: Vec<f64> = vec![d0];
    for k in 0..n {
        let s = &section.stretches[k];
        let (u0, u1) = (section.starts[k], section.starts[k] + s.length);
        let mut inner = Vec::new();
        let straight = matches!(s.curve, evolvent_path::Curve::Line(_));
        if s.blend {
            let (a, b) = (s.curve.jet(s.from), s.curve.jet(s.from + s.length));
            let (s0, s1) = (norm(v3(&a.first)), norm(v3(&b.first)));
            let whole = s.curve.domain();
            let z = whole * norm(v3(&a.second)).max(norm(v3(&b.second))) / s0.min(s1).max(0.3);
            let mut count = sub.max((12.0 * z).ceil().min(12.0) as usize);
            if s0.min(s1) < 0.6 {
                count = count.max(8);
            }
            let count = ((count as f64 * s.length / whole).ceil() as usize)
                .max((s.length / 0.5).ceil() as usize)
                .max(1);
            for i in 0..count {
                inner.push(u0 + s.length * i as f64 / count as f64);
            }
        } else {
            let before = if k > 0 { widths[k - 1] / sub as f64 } else { 1.0 };
            let after = if k + 1 < n {
                widths[k + 1] / sub as f64
            } else {
                1.0
            };
            let most = if straight { 1.0 } else { 0.3 };
            let mut u = u0;
            while u < u1 {
                inner.push(u);
                let step = (before.min(0.3) + 0.2 * (u - u0))
                    .min(after.min(0.3) + 0.2 * (u1 - u))
                    .min(most)
                    .min(0.34 * s.length);
                if u1 - u < 1.5 * step {
                    break;
                }
                u += step.max(1e-6);
            }
        }
        marks.extend(inner);
    }
    // Graded from both rests, alike so that the profile below comes back to its first speed.
    let ramp = 22.0 * d0;
    marks.retain(|&u| u > ramp && u < section.length - ramp);
    marks.push(d0);
    let mut x = d0 * 1.3;
    while x < 0.5f64.min(0.5 * section.length) {
        marks.push(x);
        marks.push(section.length - x);
        x *= 1.3;
    }
    marks.push(section.length - d0);
    marks.retain(|&u| u >= d0 && u <= section.length - d0);
    marks.sort_by(f64::total_cmp);
    let mut u: Vec<f64> = Vec::with_capacity(marks.len());
    let gap = |u: f64| 0.2 * u.min(section.length - u).min(0.05).max(d0);
    let fixed: Vec<bool> = marks
        .iter()
        .map(|&m| section.starts.binary_search_by(|s| s.total_cmp(&m)).is_ok())
        .collect();
    for (i, &m) in marks.iter().enumerate() {
        let last = i + 1 == marks.len();
        if let Some(&p) = u.last() {
            if m - p <= 1e-9 {
                continue;
            }
            let tiny = m - p < gap(m) * 0.25;
            if tiny && m > ramp && section.length - m > ramp && !fixed[i] && !last {
                continue;
            }
        }
        u.push(m);
    }
    let count = u.len() - 1;
    let mut stations = Vec::with_capacity(u.len());
    for k in 0..=count {
        let i = section.find(u[k] + 1e-12);
        let li = section.find(u[k] - 1e-10);
        let at = |i: usize| {
            let s = &section.stretches[i];
            s.curve.jet(s.from + (u[k] - section.starts[i]))
        };
        let (right, left) = (at(i), at(li));
        let lo = section.find(u[k.max(1) - 1]);
        let hi = section.find(u[(k + 1).min(count)]);
        let feed = section.stretches[lo..=hi]
            .iter()
            .map(|s| s.feed)
            .fold(1e9, f64::min);
        let mut most = (3.0 * limits.v[0]).powi(2);
        for d in 0..3 {
            most = most.min((limits.v[d] / right.first[d].abs().max(1e-9)).powi(2));
        }
        most = most.min((feed / norm(v3(&right.first)).max(1e-9)).powi(2));
        for &(j, cap) in &section.caps {
            if j == i && (u[k] - section.starts[j]).abs() < 1e-9 {
                most = most.min(cap * cap);
            }
        }
        let of = |jet: &Jet| [v3(&jet.first), v3(&jet.second), v3(&jet.third)];
        stations.push(Station {
            q: of(&right),
            l: of(&left),
            most,
        });
    }
    let ds: Vec<f64> = (0..count).map(|k| u[k + 1] - u[k]).collect();
    let b0 = js * t0;
    let a0 = (0.5 * js * t0 * t0).powi(2);
    let l0 = 20.0 * d0;
    let profile = |x: f64| {
        let y = (x - d0).max(0.0);
        if y < l0 { b0 * (1.0 - y / l0).powi(2) } else { 0.0 }
    };
    let mut b: Vec<f64> = u
        .iter()
        .map(|&x| {
            if 2.0 * x < section.length {
                profile(x)
            } else {
                -profile(section.length - x)
            }
        })
        .collect();
    let mut c: Vec<f64> = (0..count).map(|k| (b[k + 1] - b[k]) / ds[k]).collect();
    let mut a = vec![a0; count + 1];
    for k in 0..count {
        a[k + 1] = a[k] + (b[k] + b[k + 1]) * ds[k];
    }
    let mut ipm = Ipm {
        stations,
        n: count,
        w: vec![0.0; count + 1],
        ds,
        af: a0,
        bf: -b0,
        h: vec![[0.0; 6]; count + 1],
        g: vec![[0.0; 3]; count + 1],
        kk: vec![[0.0; 3]; count],
        dx: vec![[0.0; 3]; count + 1],
        iterations: 0,
        limits,
    };
    for k in 0..count {
        ipm.w[k] += 0.5 * ipm.ds[k];
        ipm.w[k + 1] += 0.5 * ipm.ds[k];
    }
    let ok = ipm.solve(&mut a, &mut b, &mut c);
    let dt: Vec<f64> = (0..count).map(|k| seconds(a[k], b[k], c[k], ipm.ds[k])).collect();
    let total = 2.0 * t0 + dt.iter().sum::<f64>();
    Plan {
        u,
        a,
        b,
        c,
        dt,
        t0,
        d0,
        j0: js,
        total,
        iterations: ipm.iterations,
        failed: !ok,
    }
}

struct Ipm<'a> {
    stations: Vec<Station>,
    n: usize,
    ds: Vec<f64>,
    af: f64,
    bf: f64,
    w: Vec<f64>,
    h: Vec<[f64; 6]>,
    g: Vec<[f64; 3]>,
    kk: Vec<[f64; 3]>,
    dx: Vec<[f64; 3]>,
    iterations: usize,
    limits: &'a Limits,
}

impl Ipm<'_> {
    fn merit(&self, a: &[f64], b: &[f64], c: &[f64], mu: f64) -> Option<f64> {
        let (mut m, mut product, mut logs) = (0.0, 1.0f64, 0.0);
        macro_rules! bar {
            ($x:expr) => {{
                let x: f64 = $x;
                if !(x > 0.0) {
                    return None;
                }
                product *= x;
                if !(1e-200..1e200).contains(&product) {
                    logs += product.ln();
                    product = 1.0;
                }
            }};
        }
        for k in 0..=self.n {
            let s = &self.stations[k];
            if !(a[k] > 0.0) {
                return None;
            }
            m += self.w[k] / (3.0 * a[k].sqrt());
            if k < self.n {
                let am = a[k] + self.ds[k] * (b[k] + 0.25 * self.ds[k] * c[k]);
                if !(am > 0.0) {
                    return None;
                }
                m += self.ds[k] * 2.0 / (3.0 * am.sqrt());
                bar!(am / s.most);
                let cp = s.most.max(self.stations[k + 1].most);
                bar!((cp - am) / cp);
            }
            bar!((s.most - a[k]) / s.most);
            for i in 0..3 {
                let q = (s.q[1][i] * a[k] + s.q[0][i] * b[k]) / self.limits.a[i];
                bar!(1.0 - q * q);
            }
            if k < self.n {
                let ra = a[k].sqrt();
                let s1 = &self.stations[k + 1];
                if !(a[k + 1] > 0.0) {
                    return None;
                }
                let r1 = a[k + 1].sqrt();
                for i in 0..3 {
                    let j = self.limits.j[i];
                    let q = ra * (s.q[2][i] * a[k] + 3.0 * s.q[1][i] * b[k] + s.q[0][i] * c[k]) / j;
                    bar!(1.0 - q * q);
                    let q =
                        r1 * (s1.l[2][i] * a[k + 1] + 3.0 * s1.l[1][i] * b[k + 1] + s1.l[0][i] * c[k]) / j;
                    bar!(1.0 - q * q);
                }
            } else {
                let q = (b[k] - self.bf) / (0.005 * self.bf);
                bar!(1.0 - q * q);
                let q = (a[k] - self.af) / (0.005 * self.af);
                bar!(1.0 - q * q);
            }
        }
        Some(m - mu * (logs + product.ln()))
    }

    fn assemble(&mut self, a: &[f64], b: &[f64], c: &[f64], mu: f64) {
        for k in 0..=self.n {
            let s = &self.stations[k];
            let (ak, bk) = (a[k], b[k]);
            let ra = ak.sqrt();
            let wk = self.w[k] / 3.0;
            let mut g = [-0.5 * wk / (ak * ra), 0.0, 0.0];
            let mut h = [0.75 * wk / (ak * ak * ra), 0.0, 0.0, 0.0, 0.0, 0.0];
            if k < self.n {
                let d = self.ds[k];
                let am = ak + d * (bk + 0.25 * d * c[k]);
                let w = d * 2.0 / 3.0;
                let cp = s.most.max(self.stations[k + 1].most);
                let z = 1.0 / (cp - am);
                let g1 = -0.5 * w / (am * am.sqrt()) - mu / am + mu * z;
                let h1 = 0.75 * w / (am * am * am.sqrt()) + mu / (am * am) + mu * z * z;
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
            }
            let mut pair = |v: f64, da: f64, db: f64, dc: f64| {
                let (x, y) = (1.0 / (1.0 - v), 1.0 / (1.0 + v));
                let r = mu * (x - y);
                g[0] += r * da;
                g[1] += r * db;
                g[2] += r * dc;
                let q = mu * (x * x + y * y);
                h[0] += q * da * da;
                h[1] += q * da * db;
                h[2] += q * db * db;
                h[3] += q * da * dc;
                h[4] += q * db * dc;
                h[5] += q * dc * dc;
            };
            for i in 0..3 {
                let (p, q) = (s.q[1][i] / self.limits.a[i], s.q[0][i] / self.limits.a[i]);
                pair(p * ak + q * bk, p, q, 0.0);
            }
            if k < self.n {
                let ck = c[k];
                let s1 = &self.stations[k + 1];
                let ds = self.ds[k];
                let (a1, b1) = (a[k + 1], b[k + 1]);
                let ra1 = a1.sqrt();
                for i in 0..3 {
                    let j = self.limits.j[i];
                    let l = s.q[2][i] * ak + 3.0 * s.q[1][i] * bk + s.q[0][i] * ck;
                    pair(
                        ra * l / j,
                        (ra * s.q[2][i] + 0.5 * l / ra) / j,
                        ra * 3.0 * s.q[1][i] / j,
                        ra * s.q[0][i] / j,
                    );
                    let l = s1.l[2][i] * a1 + 3.0 * s1.l[1][i] * b1 + s1.l[0][i] * ck;
                    let ea = (ra1 * s1.l[2][i] + 0.5 * l / ra1) / j;
                    let eb = ra1 * 3.0 * s1.l[1][i] / j;
                    let ec = ra1 * s1.l[0][i] / j;
                    pair(ra1 * l / j, ea, 2.0 * ds * ea + eb, ds * ds * ea + ds * eb + ec);
                }
            } else {
                pair(
                    (bk - self.bf) / (0.005 * self.bf),
                    0.0,
                    1.0 / (0.005 * self.bf),
                    0.0,
                );
                pair(
                    (ak - self.af) / (0.005 * self.af),
                    1.0 / (0.005 * self.af),
                    0.0,
                    0.0,
                );
            }
            let f = s.most - ak;
            g[0] += mu / f;
            h[0] += mu / (f * f);
            self.g[k] = g;
            self.h[k] = h;
        }
    }

    fn riccati(&mut self) -> f64 {
        let n = self.n;
        let (hn, gn) = (self.h[n], self.g[n]);
        let (mut p00, mut p01, mut p11) = (hn[0], hn[1], hn[2]);
        let (mut q0, mut q1) = (gn[0], gn[1]);
        for k in (0..n).rev() {
            let d = self.ds[k];
            let h = self.h[k];
            let g = self.g[k];
            let pb0 = p00 * d * d + p01 * d;
            let pb1 = p01 * d * d + p11 * d;
            let cc = h[5] + d * d * pb0 + d * pb1;
            let ca = h[3] + pb0;
            let cb = h[4] + 2.0 * d * pb0 + pb1;
            let cg = g[2] + d * d * q0 + d * q1;
            let inv = 1.0 / cc;
            let (ka, kb, kc) = (-ca * inv, -cb * inv, -cg * inv);
            self.kk[k] = [ka, kb, kc];
            let t01 = 2.0 * d * p00 + p01;
            let t11 = 4.0 * d * d * p00 + 4.0 * d * p01 + p11;
            let n00 = h[0] + p00 + ka * ca;
            let n01 = h[1] + t01 + ka * cb;
            let n11 = h[2] + t11 + kb * cb;
            let m0 = g[0] + q0 + kc * ca;
            let m1 = g[1] + 2.0 * d * q0 + q1 + kc * cb;
            (p00, p01, p11, q0, q1) = (n00, n01, n11, m0, m1);
        }
        let (mut x0, mut x1, mut dec) = (0.0, 0.0, 0.0);
        for k in 0..n {
            let u = self.kk[k][0] * x0 + self.kk[k][1] * x1 + self.kk[k][2];
            self.dx[k] = [x0, x1, u];
            let g = self.g[k];
            dec += g[0] * x0 + g[1] * x1 + g[2] * u;
            let d = self.ds[k];
            (x0, x1) = (x0 + 2.0 * d * x1 + d * d * u, x1 + d * u);
        }
        self.dx[n] = [x0, x1, 0.0];
        dec + self.g[n][0] * x0 + self.g[n][1] * x1
    }

    fn solve(&mut self, a: &mut Vec<f64>, b: &mut Vec<f64>, c: &mut Vec<f64>) -> bool {
        let n = self.n;
        let rows = (14 * n) as f64;
        let (mut na, mut nb, mut nc) = (a.clone(), b.clone(), c.clone());
        let objective = |w: &[f64], a: &[f64]| -> f64 { (0..=n).map(|k| w[k] / a[k].sqrt()).sum() };
        let mut mu = objective(&self.w, a) / rows;
        loop {
            let Some(mut m) = self.merit(a, b, c, mu) else {
                return false;
            };
            for _ in 0..25 {
                if self.iterations >= 400 {
                    return true;
                }
                self.iterations += 1;
                self.assemble(a, b, c, mu);
                let dec = self.riccati();
                if -dec < 1e-3 * mu * rows {
                    break;
                }
                let mut t = 1.0f64;
                for k in 0..=n {
                    let d = self.dx[k][0];
                    if d < 0.0 {
                        t = t.min(0.98 * a[k] / -d);
                    } else if d > 0.0 {
                        t = t.min(0.98 * (self.stations[k].most - a[k]) / d);
                    }
                }
                let mut ok = false;
                for _ in 0..25 {
                    for k in 0..=n {
                        na[k] = a[k] + t * self.dx[k][0];
                        nb[k] = b[k] + t * self.dx[k][1];
                        if k < n {
                            nc[k] = c[k] + t * self.dx[k][2];
                        }
                    }
                    if let Some(x) = self.merit(&na, &nb, &nc, mu)
                        && x <= m + 1e-4 * t * dec
                    {
                        m = x;
                        ok = true;
                        break;
                    }
                    t *= 0.6;
                }
                if !ok {
                    break;
                }
                std::mem::swap(a, &mut na);
                std::mem::swap(b, &mut nb);
                std::mem::swap(c, &mut nc);
            }
            let t = objective(&self.w, a);
            if mu * rows < 1e-3 * t {
                return true;
            }
            mu *= 0.2;
        }
    }
}

/// Positions at a fixed period: the exact flow of u'' = b + c x.
pub fn sample(section: &Section, p: &Plan, dt: f64) -> Vec<(f64, V3)> {
    let mut out = Vec::new();
    let n = p.u.len() - 1;
    let (mut tb, mut k, mut j) = (p.t0, 0, 0);
    loop {
        let t = f64::from(j) * dt;
        j += 1;
        let u = if t <= p.t0 {
            p.j0 * t * t * t / 6.0
        } else if t >= p.total {
            break;
        } else if t >= p.total - p.t0 {
            let r = p.total - t;
            section.length - p.j0 * r * r * r / 6.0
        } else {
            while k < n - 1 && t > tb + p.dt[k] {
                tb += p.dt[k];
                k += 1;
            }
            let tau = t - tb;
            let (a, b, c) = (p.a[k], p.b[k], p.c[k]);
            let z = c * tau * tau;
            let (ch, sh) = if z.abs() < 1e-4 {
                (0.5 + z / 24.0 + z * z / 720.0, 1.0 + z / 6.0 + z * z / 120.0)
            } else if z > 0.0 {
                let r = z.sqrt();
                ((r.cosh() - 1.0) / z, r.sinh() / r)
            } else {
                let r = (-z).sqrt();
                ((r.cos() - 1.0) / z, r.sin() / r)
            };
            p.u[k] + (a.sqrt() * tau * sh + b * tau * tau * ch).clamp(0.0, p.u[k + 1] - p.u[k])
        };
        out.push((u, v3(&section.jet(u).position)));
    }
    out
}
