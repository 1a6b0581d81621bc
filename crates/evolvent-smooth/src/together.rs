//! Path and time law found together.
//!
//! `a = u'^2` is a quadratic spline over the stations, so that `b = a' / 2` is continuous and `c = b'` constant between
//! them; its coefficients and the spline's control points are unknowns of one problem: least time inside the axes'
//! limits and the tube, by a log barrier. Every condition belongs to one interval, so that the matrix is banded. Its
//! second derivatives are taken by Gauss and Newton: of the barrier, not of the conditions.

use evolvent_path::{AXES, Axes};

use crate::basis::Basis;
use crate::timing::Window;
use crate::tube::{GROUPS, Sample, dot};
use crate::zone::Zone;

/// Stations in an interval.
pub(crate) const STATIONS: usize = 3;

/// Memory that is kept.
#[derive(Debug, Default)]
pub(crate) struct Together {
    /// Coefficients of the law.
    alpha: Vec<f64>,
    trial_alpha: Vec<f64>,
    trial_points: Vec<Axes>,
    matrix: Vec<f64>,
    gradient: Vec<f64>,
    step: Vec<f64>,
    widths: Vec<f64>,
    caps: Vec<f64>,
    pub(crate) iterations: usize,
}

/// What is fixed.
pub(crate) struct Task<'a> {
    pub(crate) window: Window<'a>,
    pub(crate) samples: &'a [Sample],
    /// Weight of the samples of each interval, from the window's first.
    pub(crate) weights: &'a [f64],
    pub(crate) free: (usize, usize),
}

struct Layout<const D: usize> {
    axes: [usize; D],
    columns: [usize; AXES],
    from: usize,
    intervals: usize,
    free: (usize, usize),
}

const NONE: usize = usize::MAX;

impl<const D: usize> Layout<D> {
    const GROUP: usize = D + STATIONS;
    const BAND: usize = 4 * Self::GROUP;

    fn size(&self) -> usize {
        2 + self.intervals * Self::GROUP
    }

    /// Column of a coefficient of the law.
    fn alpha(&self, j: usize) -> usize {
        if j < 2 {
            j
        } else {
            2 + (j - 2) / STATIONS * Self::GROUP + (j - 2) % STATIONS
        }
    }

    /// First column of a control point; `NONE` if it is fixed.
    fn point(&self, j: usize) -> usize {
        if j < self.free.0 || j >= self.free.1 || j < self.from + 3 {
            NONE
        } else {
            2 + (j - 3 - self.from) * Self::GROUP + STATIONS
        }
    }
}

/// Values at one side of a station: `a`, `b`, `c` and the basis functions' derivatives.
struct Local {
    a: f64,
    b: f64,
    c: f64,
    /// Derivatives of a, b, c by the coefficients `j`, `j + 1`, `j + 2`.
    da: [f64; 3],
    db: [f64; 3],
    dc: [f64; 3],
    first: [f64; 4],
    second: [f64; 4],
    third: [f64; 4],
}

impl Together {
    /// Improves the control points; the law begins as the values of `a` at the stations by `law`.
    pub(crate) fn run(
        &mut self,
        task: &Task<'_>,
        points: &mut [Axes],
        law: (&[f64], &[f64], &[f64]),
        rounds: usize,
    ) -> bool {
        match task.window.active.iter().filter(|&&active| active).count() {
            1 => self.solve::<1>(task, points, law, rounds),
            2 => self.solve::<2>(task, points, law, rounds),
            3 => self.solve::<3>(task, points, law, rounds),
            4 => self.solve::<4>(task, points, law, rounds),
            _ => false,
        }
    }

    fn solve<const D: usize>(
        &mut self,
        task: &Task<'_>,
        points: &mut [Axes],
        (a, b, _): (&[f64], &[f64], &[f64]),
        rounds: usize,
    ) -> bool {
        let window = &task.window;
        let mut axes = [0; D];
        let mut columns = [NONE; AXES];
        for (d, axis) in (0..AXES).filter(|&i| window.active[i]).enumerate() {
            axes[d] = axis;
            columns[axis] = d;
        }
        let layout = Layout::<D> {
            axes,
            columns,
            from: window.from,
            intervals: window.to - window.from,
            free: task.free,
        };
        let n = layout.intervals * STATIONS;
        self.widths.clear();
        for i in window.from..window.to {
            let width = window.zone.knot(i + 1) - window.zone.knot(i);
            for _ in 0..STATIONS {
                self.widths.push(width / STATIONS as f64);
            }
        }
        self.set_caps::<D>(task, &layout);
        // Coefficients from values and slopes: the two about a station by those.
        self.alpha.clear();
        for j in 0..n + 2 {
            let value = if j <= n {
                // Left neighbour of station j: a - b h(j-1), of interval j - 1.
                let h = self.widths[j.max(1) - 1];
                a[j] - b[j] * h
            } else {
                a[n] + b[n] * self.widths[n - 1]
            };
            self.alpha.push(value);
        }
        // Slower until there is room.
        let mut inside = false;
        for _ in 0..30 {
            if self.merit::<D>(task, &layout, points, &self.alpha, 0.0).is_some() {
                inside = true;
                break;
            }
            for value in &mut self.alpha {
                *value *= 0.9;
            }
        }
        if !inside {
            return false;
        }
        for value in &mut self.alpha {
            *value *= 0.85;
        }
        let rows = (n * (4 + 4 * D)) as f64;
        let time = self.merit::<D>(task, &layout, points, &self.alpha, 0.0).unwrap_or(0.0);
        let mut mu = time / rows * crate::timing::knob("MU0", 0.5);
        self.iterations = 0;
        for _ in 0..rounds {
            let Some(mut merit) = self.merit::<D>(task, &layout, points, &self.alpha, mu) else {
                return false;
            };
            for _ in 0..crate::timing::knob("NI", 6.0) as usize {
                self.iterations += 1;
                self.assemble::<D>(task, &layout, points, mu);
                self.factor::<D>(&layout);
                let size = layout.size();
                let slope: f64 = (0..size).map(|k| self.gradient[k] * self.step[k]).sum();
                if !(slope < 0.0) || -slope < 0.01 * mu * rows {
                    break;
                }
                let mut length = 1.0;
                let mut better = false;
                for _ in 0..25 {
                    self.trial_alpha.clear();
                    for j in 0..n + 2 {
                        self.trial_alpha.push(self.alpha[j] + length * self.step[layout.alpha(j)]);
                    }
                    self.trial_points.clear();
                    self.trial_points.extend_from_slice(points);
                    for j in task.free.0..task.free.1 {
                        let at = layout.point(j);
                        if at != NONE {
                            for d in 0..D {
                                self.trial_points[j][axes[d]] += length * self.step[at + d];
                            }
                        }
                    }
                    if let Some(value) =
                        self.merit::<D>(task, &layout, &self.trial_points, &self.trial_alpha, mu)
                        && value <= merit + 1e-4 * length * slope
                    {
                        merit = value;
                        better = true;
                        break;
                    }
                    length *= 0.6;
                }
                if !better {
                    break;
                }
                std::mem::swap(&mut self.alpha, &mut self.trial_alpha);
                points.copy_from_slice(&self.trial_points);
            }
            mu *= crate::timing::knob("MF", 0.3);
        }
        true
    }

    fn set_caps<const D: usize>(&mut self, task: &Task<'_>, layout: &Layout<D>) {
        let window = &task.window;
        self.caps.clear();
        let slowest = layout.axes.iter().map(|&d| window.scales.velocity[d]).fold(0.0, f64::max).max(1e-9);
        for i in window.from..window.to {
            let width = window.zone.knot(i + 1) - window.zone.knot(i);
            for k in 0..STATIONS {
                let u = window.zone.knot(i) + width * k as f64 / STATIONS as f64;
                let mut most = 1.0 / (0.3 * slowest);
                for rest in [u - window.rests.0, window.rests.1 - u] {
                    let rest = rest.max(0.1 * width);
                    let jerk = layout.axes.iter().map(|&d| window.scales.jerk[d]).fold(0.0, f64::max);
                    let acceleration = layout.axes.iter().map(|&d| window.scales.acceleration[d]).fold(0.0, f64::max);
                    most = most.min(libm::cbrt(4.5 * rest * rest / jerk));
                    most = most.min((2.0 * rest / acceleration).sqrt());
                }
                self.caps.push(most * most);
            }
        }
    }

    fn local(&self, zone: &Zone, from: usize, s: usize, right: bool, alpha: &[f64]) -> Local {
        let i = from + s / STATIONS;
        let basis: &Basis = &zone.bases[i];
        let last = self.widths.len() - 1;
        let h = self.widths[s];
        let (before, after) = (self.widths[s.max(1) - 1], self.widths[(s + 1).min(last)]);
        let (w0, w1) = (1.0 / (before + h), 1.0 / (h + after));
        let db0 = [-w0, w0, 0.0];
        let db1 = [0.0, -w1, w1];
        let dc = [(db1[0] - db0[0]) / h, (db1[1] - db0[1]) / h, (db1[2] - db0[2]) / h];
        let (da, db) = if right {
            ([h * w0, before * w0, 0.0], db0)
        } else {
            ([0.0, after * w1, h * w1], db1)
        };
        let three = &alpha[s..s + 3];
        let of = |d: &[f64; 3]| d[0] * three[0] + d[1] * three[1] + d[2] * three[2];
        let x = h * (s % STATIONS) as f64 + if right { 0.0 } else { h };
        Local {
            a: of(&da),
            b: of(&db),
            c: of(&dc),
            da,
            db,
            dc,
            first: basis.map(|f| f[1] + x * (f[2] + 0.5 * x * f[3])),
            second: basis.map(|f| f[2] + x * f[3]),
            third: basis.map(|f| f[3]),
        }
    }

    /// Time and barrier; `None` outside.
    fn merit<const D: usize>(
        &self,
        task: &Task<'_>,
        layout: &Layout<D>,
        points: &[Axes],
        alpha: &[f64],
        mu: f64,
    ) -> Option<f64> {
        let window = &task.window;
        let scales = window.scales;
        let (mut time, mut product, mut logs) = (0.0, 1.0f64, 0.0);
        let mut bar = |room: f64| -> Option<()> {
            if !(room > 0.0) {
                return None;
            }
            product *= room;
            if !(1e-150..1e150).contains(&product) {
                logs += libm::log(product);
                product = 1.0;
            }
            Some(())
        };
        for s in 0..self.widths.len() {
            let i = layout.from + s / STATIONS;
            let h = self.widths[s];
            for right in [true, false] {
                let l = self.local(window.zone, layout.from, s, right, alpha);
                if !(l.a > 0.0) {
                    return None;
                }
                let root = l.a.sqrt();
                time += h / (6.0 * root);
                let mut metric = 0.0;
                for d in 0..D {
                    let axis = layout.axes[d];
                    let of = |w: &[f64; 4]| (0..4).map(|k| w[k] * points[i + k][axis]).sum::<f64>();
                    let (q1, q2, q3) = (of(&l.first), of(&l.second), of(&l.third));
                    let jerk = root * (q3 * l.a + 3.0 * q2 * l.b + q1 * l.c) * scales.jerk[axis];
                    bar(1.0 - jerk * jerk)?;
                    if right {
                        let acceleration = (q2 * l.a + q1 * l.b) * scales.acceleration[axis];
                        bar(1.0 - acceleration * acceleration)?;
                        let v = q1 * scales.velocity[axis];
                        bar(1.0 - l.a * v * v)?;
                        if axis < 3 {
                            metric += q1 * q1;
                        }
                    }
                }
                if right {
                    let feed = window.feeds[i - layout.from];
                    bar(1.0 - l.a * metric / (feed * feed))?;
                    bar(1.0 - l.a / self.caps[s])?;
                    let middle = l.a + h * (l.b + 0.25 * h * l.c);
                    if !(middle > 0.0) {
                        return None;
                    }
                    time += h * 2.0 / (3.0 * middle.sqrt());
                }
            }
        }
        let mut tube = 0.0;
        for sample in task.samples {
            let i = sample.interval;
            let room = 1.0 - sample.ratio(&sample.error(&points[i..i + 4]));
            if !(room > 0.0) {
                return None;
            }
            if mu > 0.0 {
                tube += task.weights[i - layout.from] * libm::log(room);
            }
        }
        Some(time - mu * (logs + libm::log(product) + tube))
    }

    fn assemble<const D: usize>(&mut self, task: &Task<'_>, layout: &Layout<D>, points: &[Axes], mu: f64) {
        let band = Layout::<D>::BAND;
        let size = layout.size();
        self.matrix.clear();
        self.matrix.resize((size + band) * band, 0.0);
        self.gradient.clear();
        self.gradient.resize(size + band, 0.0);
        let window = &task.window;
        let scales = window.scales;
        let mut matrix = std::mem::take(&mut self.matrix);
        let mut gradient = std::mem::take(&mut self.gradient);
        // A row: gradient of a function with slope g and curvature h of the merit by it.
        let mut add = |columns: &[usize], values: &[f64], g: f64, h: f64| {
            for (x, &r) in columns.iter().enumerate() {
                if r == NONE {
                    continue;
                }
                gradient[r] += g * values[x];
                for (y, &c) in columns.iter().enumerate() {
                    if c != NONE && r >= c {
                        matrix[c * band + r - c] += h * values[x] * values[y];
                    }
                }
            }
        };
        for s in 0..self.widths.len() {
            let i = layout.from + s / STATIONS;
            let h = self.widths[s];
            let law = [layout.alpha(s), layout.alpha(s + 1), layout.alpha(s + 2)];
            for right in [true, false] {
                let l = self.local(window.zone, layout.from, s, right, &self.alpha);
                let root = l.a.sqrt();
                add(&law, &l.da, -h / (12.0 * l.a * root), h / (8.0 * l.a * l.a * root));
                let mut metric = 0.0;
                let mut q1s = [0.0; D];
                for d in 0..D {
                    let axis = layout.axes[d];
                    let of = |w: &[f64; 4]| (0..4).map(|k| w[k] * points[i + k][axis]).sum::<f64>();
                    let (q1, q2, q3) = (of(&l.first), of(&l.second), of(&l.third));
                    q1s[d] = q1;
                    let mut columns = [NONE; 7];
                    columns[..3].copy_from_slice(&law);
                    for k in 0..4 {
                        let at = layout.point(i + k);
                        columns[3 + k] = if at == NONE { NONE } else { at + d };
                    }
                    let pair = |v: f64| {
                        let inverse = 1.0 / (1.0 - v * v);
                        (2.0 * mu * v * inverse, 2.0 * mu * (1.0 + v * v) * inverse * inverse)
                    };
                    let mut values = [0.0; 7];
                    let inner = q3 * l.a + 3.0 * q2 * l.b + q1 * l.c;
                    let scale = scales.jerk[axis];
                    for k in 0..3 {
                        values[k] = scale
                            * (root * (q3 * l.da[k] + 3.0 * q2 * l.db[k] + q1 * l.dc[k])
                                + 0.5 * inner / root * l.da[k]);
                    }
                    for k in 0..4 {
                        values[3 + k] =
                            scale * root * (l.third[k] * l.a + 3.0 * l.second[k] * l.b + l.first[k] * l.c);
                    }
                    let (g, c) = pair(scale * root * inner);
                    add(&columns, &values, g, c);
                    if right {
                        let scale = scales.acceleration[axis];
                        for k in 0..3 {
                            values[k] = scale * (q2 * l.da[k] + q1 * l.db[k]);
                        }
                        for k in 0..4 {
                            values[3 + k] = scale * (l.second[k] * l.a + l.first[k] * l.b);
                        }
                        let (g, c) = pair(scale * (q2 * l.a + q1 * l.b));
                        add(&columns, &values, g, c);
                        let v = scales.velocity[axis];
                        let room = 1.0 - l.a * q1 * q1 * v * v;
                        for k in 0..3 {
                            values[k] = q1 * q1 * v * v * l.da[k];
                        }
                        for k in 0..4 {
                            values[3 + k] = 2.0 * l.a * q1 * v * v * l.first[k];
                        }
                        add(&columns, &values, mu / room, mu / (room * room));
                        if axis < 3 {
                            metric += q1 * q1;
                        }
                    }
                }
                if right {
                    let feed = window.feeds[i - layout.from];
                    if feed.is_finite() {
                        let f = 1.0 / (feed * feed);
                        let room = 1.0 - l.a * metric * f;
                        let mut columns = [NONE; 15];
                        let mut values = [0.0; 15];
                        columns[..3].copy_from_slice(&law);
                        for k in 0..3 {
                            values[k] = metric * f * l.da[k];
                        }
                        for d in 0..D.min(3) {
                            if layout.axes[d] >= 3 {
                                continue;
                            }
                            for k in 0..4 {
                                let at = layout.point(i + k);
                                if at != NONE {
                                    columns[3 + 4 * d + k] = at + d;
                                    values[3 + 4 * d + k] = 2.0 * l.a * q1s[d] * f * l.first[k];
                                }
                            }
                        }
                        add(&columns, &values, mu / room, mu / (room * room));
                    }
                    let cap = 1.0 / self.caps[s];
                    let room = 1.0 - l.a * cap;
                    add(&law, &l.da.map(|x| x * cap), mu / room, mu / (room * room));
                    let middle = l.a + h * (l.b + 0.25 * h * l.c);
                    let values: [f64; 3] =
                        std::array::from_fn(|k| l.da[k] + h * (l.db[k] + 0.25 * h * l.dc[k]));
                    let r = middle.sqrt();
                    add(&law, &values, -h / (3.0 * middle * r), h / (2.0 * middle * middle * r));
                }
            }
        }
        for sample in task.samples {
            let i = sample.interval;
            let error = sample.error(&points[i..i + 4]);
            let (off, inside) = sample.off(&error);
            let inverse = 1.0 / (1.0 - dot(&off, &off) / sample.radius2);
            let flat = f64::from(u8::from(inside));
            let weight = mu * task.weights[i - layout.from];
            let h1 = 2.0 * weight * inverse / sample.radius2;
            let h2 = 2.0 * inverse / sample.radius2;
            let (first, count) = GROUPS[sample.group];
            for l in 0..4 {
                let at = layout.point(i + l);
                if at == NONE {
                    continue;
                }
                for p in 0..count {
                    let a = layout.columns[first + p];
                    if a == NONE {
                        continue;
                    }
                    let ep = off[p];
                    gradient[at + a] += h1 * sample.weights[l] * ep;
                    for m in l..4 {
                        let to = layout.point(i + m);
                        if to == NONE {
                            continue;
                        }
                        for q in 0..count {
                            let b = layout.columns[first + q];
                            if b == NONE || to + b < at + a {
                                continue;
                            }
                            let eq = off[q];
                            let mut h = h1 * (h2 * ep * eq - flat * sample.along[p] * sample.along[q]);
                            if p == q {
                                h += h1;
                            }
                            matrix[(at + a) * band + to + b - at - a] += sample.weights[l] * sample.weights[m] * h;
                        }
                    }
                }
            }
        }
        self.matrix = matrix;
        self.gradient = gradient;
    }

    fn factor<const D: usize>(&mut self, layout: &Layout<D>) {
        let band = Layout::<D>::BAND;
        let size = layout.size();
        let (matrix, step) = (&mut self.matrix, &mut self.step);
        step.clear();
        step.extend(self.gradient.iter().map(|g| -g));
        for s in &mut step[size..] {
            *s = 0.0;
        }
        for r in 0..size {
            let (head, tail) = matrix.split_at_mut((r + 1) * band);
            let pivot = &mut head[r * band..];
            let inverse = if pivot[0] > 1e-200 { 1.0 / pivot[0] } else { 0.0 };
            pivot[0] = inverse;
            let value = step[r];
            for j in 1..band {
                let factor = pivot[j] * inverse;
                if factor == 0.0 {
                    continue;
                }
                let column = &mut tail[(j - 1) * band..(j - 1) * band + band - j];
                for (entry, p) in column.iter_mut().zip(&pivot[j..band]) {
                    *entry -= factor * p;
                }
                step[r + j] -= factor * value;
            }
        }
        for r in (0..size).rev() {
            let pivot = &matrix[r * band..(r + 1) * band];
            let sum: f64 = (1..band).map(|j| pivot[j] * step[r + j]).sum();
            step[r] = (step[r] - sum) * pivot[0];
        }
    }
}
