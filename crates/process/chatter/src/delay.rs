//! Regenerative chatter in time: the multipliers of the periodic delay equation of milling and turning.
//!
//! Over one tooth period `T` the deflections follow
//!
//! ```text
//! m q'' + c q' + k q = -w h(t) (r(t) - r(t - T)),     h periodic with T, zero where no tooth cuts
//! ```
//!
//! with `r` the sum of the modes along each direction. A linear map takes the motion of one period to the
//! next; the cut is stable if all its eigenvalues, the multipliers, are within the unit circle.
//!
//! [`MillingDelay::limit`] finds them as zeros of a characteristic function, at a cost proportional to the
//! waves in the cut; if that is too much, it returns an error. Two other methods compute the largest one, for
//! comparison:
//!
//! - collocation at Chebyshev's points between entries and exits of teeth, exact between cuts: the error
//!   falls faster than any power of the number of points, from about three a wave on
//!   ([`MillingDelay::collocation`]);
//! - semi-discretisation (T. Insperger, G. Stepan, "Updated semi-discretization method for periodic
//!   delay-differential equations with discrete delay", 2004): coefficients constant over a step, the delayed
//!   value the mean of two, exact within it ([`MillingDelay::semi_discretisation`]); its error falls with the
//!   square of the step.

use nalgebra::{Complex, DMatrix, DVector, Dyn, LU, Schur};

mod characteristic;
mod elements;
mod kind;
mod limit;

use crate::error::{ChatterError, number};
use crate::lobe::{Lobes, Milling, Mode, Turning};

pub use kind::{Chatter, ChatterKind};

/// A cut with its delay, at a spindle speed.
#[derive(Clone, Debug)]
pub struct MillingDelay {
    /// Modes with their direction of motion (0 for x, 1 for y) and the fraction of the force that drives
    /// them.
    modes: Vec<(Mode, usize, f64)>,
    /// Number of directions in use.
    directions: usize,
    period_s: f64,
    stretches: Vec<Stretch>,
    force: Force,
}

/// A section of a tooth period in which the same teeth cut.
#[derive(Clone, Copy, Debug)]
struct Stretch {
    start: f64,
    end: f64,
    /// Whether a tooth cuts in it.
    cuts: bool,
}

#[derive(Clone, Copy, Debug)]
enum Force {
    /// Turning: K in N/m2.
    Constant(f64),
    /// Milling: coefficients, angles of entry and exit, pitch and angular velocity.
    Teeth {
        tangential: f64,
        radial: f64,
        entry: f64,
        exit: f64,
        pitch: f64,
        turn: f64,
    },
}

/// A linear map of a period, as a matrix or as a procedure.
trait PeriodMap {
    fn size(&self) -> usize;
    fn apply(&self, vector: &DVector<f64>) -> DVector<f64>;
}

impl MillingDelay {
    /// Milling at a spindle speed in rpm.
    ///
    /// # Errors
    /// A speed that is not from 1 to 1e6 rpm.
    pub fn milling(milling: &Milling, speed_rpm: f64) -> Result<Self, ChatterError> {
        number("spindle speed in rpm", speed_rpm, 1.0, 1e6)?;
        let cut = &milling.cut;
        let period_s = 60.0 / (speed_rpm * f64::from(cut.teeth));
        let pitch = std::f64::consts::TAU / f64::from(cut.teeth);
        let (entry, exit) = (cut.entry_deg.to_radians(), cut.exit_deg.to_radians());
        // A tooth enters at time 0; others leave, or enter, within the period.
        let inside = (exit - entry) / pitch;
        let leaves = (inside - libm::floor(inside)) * period_s;
        let mut stretches = Vec::new();
        let always = inside >= 1.0;
        for (start, end, cuts) in [(0.0, leaves, true), (leaves, period_s, always)] {
            if end - start > 1e-9 * period_s {
                stretches.push(Stretch { start, end, cuts });
            }
        }
        let both = !milling.y.is_empty();
        let along = |modes: &[Mode], direction: usize| {
            modes
                .iter()
                .map(|mode| (*mode, direction, 1.0))
                .collect::<Vec<_>>()
        };
        let mut modes = along(&milling.x, 0);
        modes.extend(along(&milling.y, 1));
        Ok(Self {
            modes,
            directions: if both { 2 } else { 1 },
            period_s,
            stretches,
            force: Force::Teeth {
                tangential: cut.tangential_n_m2,
                radial: cut.radial_n_m2,
                entry,
                exit,
                pitch,
                turn: std::f64::consts::TAU * speed_rpm / 60.0,
            },
        })
    }

    /// Turning at a spindle speed in rpm.
    ///
    /// # Errors
    /// A speed that is not from 1 to 1e6 rpm.
    pub fn turning(turning: &Turning, speed_rpm: f64) -> Result<Self, ChatterError> {
        number("spindle speed in rpm", speed_rpm, 1.0, 1e6)?;
        let period_s = 60.0 / speed_rpm;
        Ok(Self {
            modes: turning
                .gains()
                .iter()
                .map(|(mode, gain)| (*mode, 0, *gain))
                .collect(),
            directions: 1,
            period_s,
            stretches: vec![Stretch {
                start: 0.0,
                end: period_s,
                cuts: true,
            }],
            force: Force::Constant(turning.coefficient()),
        })
    }

    /// Factors of the force per unit of depth at a time of the period: rows fx, fy, columns x, y; N/m2.
    fn factors(&self, time: f64) -> [[f64; 2]; 2] {
        match self.force {
            Force::Constant(k) => [[k, 0.0], [0.0, 0.0]],
            Force::Teeth {
                tangential,
                radial,
                entry,
                exit,
                pitch,
                turn,
            } => {
                let mut sum = [[0.0; 2]; 2];
                let mut angle = entry + turn * time;
                // Rounding at the ends of a section must not lose a tooth.
                while angle <= exit + 1e-9 * pitch {
                    let (c, s) = (libm::cos(angle), libm::sin(angle));
                    let (fx, fy) = (tangential * c + radial * s, radial * c - tangential * s);
                    sum[0][0] += fx * s;
                    sum[0][1] += fx * c;
                    sum[1][0] += fy * s;
                    sum[1][1] += fy * c;
                    angle += pitch;
                }
                sum
            }
        }
    }

    /// Degree of the polynomials at which the multipliers of collocation are accurate to about 1e-9: 24, and
    /// more with more waves in a section. From 80 waves on it exceeds the maximum of
    /// [`MillingDelay::collocation`].
    #[must_use]
    pub fn degree(&self) -> usize {
        let fastest = self
            .modes
            .iter()
            .map(|(mode, ..)| mode.frequency_hz)
            .fold(0.0, f64::max);
        let longest = self
            .stretches
            .iter()
            .map(|stretch| stretch.end - stretch.start)
            .fold(0.0, f64::max);
        let radians = std::f64::consts::TAU * fastest * longest;
        (24.0 + 0.75 * radians) as usize
    }

    /// Largest multiplier, in magnitude, at a depth in m, by collocation with polynomials of the given degree
    /// (4 to 400) in each section.
    ///
    /// # Errors
    /// A depth or degree out of range.
    pub fn collocation(&self, depth_m: f64, degree: usize) -> Result<f64, ChatterError> {
        number("depth in m", depth_m, 0.0, 10.0)?;
        number("degree", degree as f64, 4.0, 400.0)?;
        let map = Collocation::new(self, depth_m, degree);
        Ok(map.map_or(f64::INFINITY, |map| leading(&map).norm()))
    }

    /// Largest multiplier, in magnitude, at a depth in m, by semi-discretisation with `steps` steps per
    /// period (4 to 2000).
    ///
    /// # Errors
    /// A depth or number of steps out of range.
    pub fn semi_discretisation(&self, depth_m: f64, steps: usize) -> Result<f64, ChatterError> {
        number("depth in m", depth_m, 0.0, 10.0)?;
        number("steps", steps as f64, 4.0, 2000.0)?;
        Ok(leading(&SemiDiscretisation::new(self, depth_m, steps)).norm())
    }

    fn states(&self) -> usize {
        2 * self.modes.len()
    }

    /// The free system: `x' = a x`, states (q, q') by modes.
    fn free(&self) -> DMatrix<f64> {
        let mut a = DMatrix::zeros(self.states(), self.states());
        for (i, (mode, ..)) in self.modes.iter().enumerate() {
            let omega = std::f64::consts::TAU * mode.frequency_hz;
            a[(2 * i, 2 * i + 1)] = 1.0;
            a[(2 * i + 1, 2 * i)] = -omega * omega;
            a[(2 * i + 1, 2 * i + 1)] = -2.0 * mode.damping_ratio * omega;
        }
        a
    }

    /// Acceleration of mode `i` per deflection along `column`, of a cut with these factors.
    fn drive(&self, i: usize, column: usize, depth: f64, factors: &[[f64; 2]; 2]) -> f64 {
        let Some((mode, direction, gain)) = self.modes.get(i) else {
            return 0.0;
        };
        let omega = std::f64::consts::TAU * mode.frequency_hz;
        let mass = mode.stiffness_n_m / (omega * omega);
        depth * gain * factors[*direction][column] / mass
    }
}

/// The map from states at the nodes of the cutting sections and at the end of one period to those of the
/// next.
struct Collocation {
    matrix: DMatrix<f64>,
}

impl PeriodMap for Collocation {
    fn size(&self) -> usize {
        self.matrix.nrows()
    }

    fn apply(&self, vector: &DVector<f64>) -> DVector<f64> {
        &self.matrix * vector
    }
}

impl Collocation {
    /// The history is the deflection along each direction at the nodes, and the state at the end.
    fn new(delay: &MillingDelay, depth: f64, degree: usize) -> Option<Self> {
        let (d, r, n) = (delay.states(), delay.directions, degree);
        let nodes = n + 1;
        let cutting = delay.stretches.iter().filter(|stretch| stretch.cuts).count();
        let history = cutting * nodes * r;
        let size = history + d;
        let (points, derivative) = chebyshev(n);
        let free = delay.free();
        // The state at the beginning of each section, as a map of the history.
        let mut state = DMatrix::zeros(d, size);
        state.view_mut((0, history), (d, d)).fill_with_identity();
        let mut matrix = DMatrix::zeros(size, size);
        let mut at = 0;
        for stretch in &delay.stretches {
            let length = stretch.end - stretch.start;
            if !stretch.cuts {
                state = exponential(&(&free * length)) * state;
                continue;
            }
            let mut left = DMatrix::<f64>::zeros(nodes * d, nodes * d);
            let mut right = DMatrix::<f64>::zeros(nodes * d, size);
            for node in 0..nodes {
                if node == 0 {
                    for k in 0..d {
                        left[(k, k)] = 1.0;
                    }
                    right.view_mut((0, 0), (d, size)).copy_from(&state);
                    continue;
                }
                for other in 0..nodes {
                    for k in 0..d {
                        left[(node * d + k, other * d + k)] += 2.0 / length * derivative[(node, other)];
                    }
                }
                let factors = delay.factors(stretch.start + 0.5 * (1.0 + points[node]) * length);
                for i in 0..delay.modes.len() {
                    for k in 0..d {
                        left[(node * d + 2 * i, node * d + k)] -= free[(2 * i, k)];
                        left[(node * d + 2 * i + 1, node * d + k)] -= free[(2 * i + 1, k)];
                    }
                    for (j, (_, direction, _)) in delay.modes.iter().enumerate() {
                        left[(node * d + 2 * i + 1, node * d + 2 * j)] +=
                            delay.drive(i, *direction, depth, &factors);
                    }
                    for column in 0..r {
                        right[(node * d + 2 * i + 1, at + node * r + column)] +=
                            delay.drive(i, column, depth, &factors);
                    }
                }
            }
            let lu: LU<f64, Dyn, Dyn> = left.lu();
            let solution = lu.solve(&right)?;
            for node in 0..nodes {
                for (j, (_, direction, _)) in delay.modes.iter().enumerate() {
                    let row = solution.row(node * d + 2 * j);
                    let mut target = matrix.row_mut(at + node * r + direction);
                    target += row;
                }
            }
            state = solution.rows(n * d, d).into_owned();
            at += nodes * r;
        }
        matrix.rows_mut(history, d).copy_from(&state);
        matrix
            .iter()
            .all(|value| value.is_finite())
            .then_some(Self { matrix })
    }
}

/// Chebyshev points from -1 to 1, and the matrix that differentiates at them.
fn chebyshev(n: usize) -> (Vec<f64>, DMatrix<f64>) {
    let points: Vec<f64> = (0..=n)
        .map(|k| -libm::cos(std::f64::consts::PI * k as f64 / n as f64))
        .collect();
    let weight = |k: usize| {
        let end = if k == 0 || k == n { 2.0 } else { 1.0 };
        if k.is_multiple_of(2) { end } else { -end }
    };
    let mut derivative = DMatrix::zeros(n + 1, n + 1);
    for i in 0..=n {
        let mut sum = 0.0;
        for j in 0..=n {
            if i != j {
                let value = weight(i) / weight(j) / (points[i] - points[j]);
                derivative[(i, j)] = value;
                sum += value;
            }
        }
        // The derivative of a constant is zero: more accurate than the closed form.
        derivative[(i, i)] = -sum;
    }
    (points, derivative)
}

/// The steps of a period, applied one by one.
struct SemiDiscretisation {
    /// Each step: state to state, and delayed deflections to state.
    steps: Vec<(DMatrix<f64>, DMatrix<f64>)>,
    states: usize,
    directions: usize,
    /// Directions of the modes.
    along: Vec<usize>,
}

impl SemiDiscretisation {
    fn new(delay: &MillingDelay, depth: f64, count: usize) -> Self {
        let (d, r) = (delay.states(), delay.directions);
        let step = delay.period_s / count as f64;
        let mut steps = Vec::with_capacity(count);
        for k in 0..count {
            let factors = mean_factors(delay, k as f64 * step, step);
            // The delayed deflections as constant states: one exponential gives both maps.
            let mut all = DMatrix::zeros(d + r, d + r);
            all.view_mut((0, 0), (d, d)).copy_from(&delay.free());
            for i in 0..delay.modes.len() {
                for (j, (_, direction, _)) in delay.modes.iter().enumerate() {
                    all[(2 * i + 1, 2 * j)] -= delay.drive(i, *direction, depth, &factors);
                }
                for column in 0..r {
                    all[(2 * i + 1, d + column)] += delay.drive(i, column, depth, &factors);
                }
            }
            let whole = exponential(&(all * step));
            steps.push((
                whole.view((0, 0), (d, d)).into_owned(),
                whole.view((0, d), (d, r)).into_owned(),
            ));
        }
        Self {
            steps,
            states: d,
            directions: r,
            along: delay.modes.iter().map(|(_, direction, _)| *direction).collect(),
        }
    }

    fn deflection(&self, state: &DVector<f64>) -> DVector<f64> {
        let mut r = DVector::zeros(self.directions);
        for (i, direction) in self.along.iter().enumerate() {
            r[*direction] += state[2 * i];
        }
        r
    }
}

impl PeriodMap for SemiDiscretisation {
    /// The state at the end of a period, and the deflections at the beginning of each of its steps.
    fn size(&self) -> usize {
        self.states + self.steps.len() * self.directions
    }

    fn apply(&self, vector: &DVector<f64>) -> DVector<f64> {
        let (d, r, count) = (self.states, self.directions, self.steps.len());
        let mut result = DVector::zeros(self.size());
        let mut state = vector.rows(0, d).into_owned();
        let last = self.deflection(&state);
        let past = |k: usize| -> DVector<f64> {
            if k == count {
                last.clone()
            } else {
                vector.rows(d + k * r, r).into_owned()
            }
        };
        for (k, (own, delayed)) in self.steps.iter().enumerate() {
            let here = self.deflection(&state);
            result.rows_mut(d + k * r, r).copy_from(&here);
            let before = 0.5 * (past(k) + past(k + 1));
            state = own * state + delayed * before;
        }
        result.rows_mut(0, d).copy_from(&state);
        result
    }
}

/// Mean of the factors over a step, divided at the ends of the cut: Gauss rule on each side of an end.
fn mean_factors(delay: &MillingDelay, start: f64, length: f64) -> [[f64; 2]; 2] {
    const NODES: [(f64, f64); 3] = [
        (-0.774_596_669_241_483_4, 5.0 / 9.0),
        (0.0, 8.0 / 9.0),
        (0.774_596_669_241_483_4, 5.0 / 9.0),
    ];
    let mut mean = [[0.0; 2]; 2];
    for stretch in &delay.stretches {
        let (from, to) = (stretch.start.max(start), stretch.end.min(start + length));
        if to <= from || !stretch.cuts {
            continue;
        }
        for (node, weight) in NODES {
            let time = 0.5 * (from + to) + 0.5 * node * (to - from);
            let factors = delay.factors(time);
            for (mean, factors) in mean.iter_mut().flatten().zip(factors.iter().flatten()) {
                *mean += 0.5 * weight * (to - from) / length * factors;
            }
        }
    }
    mean
}

/// `exp(matrix)` by the Taylor series of order 18 after halving until the norm is below 1/2.
fn exponential(matrix: &DMatrix<f64>) -> DMatrix<f64> {
    let norm = matrix
        .row_iter()
        .map(|row| row.iter().map(|x| x.abs()).sum())
        .fold(0.0, f64::max);
    let mut halvings = 0;
    let mut scale = 1.0;
    while norm * scale > 0.5 && halvings < 60 {
        scale *= 0.5;
        halvings += 1;
    }
    let small = matrix * scale;
    let mut term = DMatrix::identity(matrix.nrows(), matrix.ncols());
    let mut sum = term.clone();
    for k in 1..=18 {
        term = &term * &small / f64::from(k);
        sum += &term;
    }
    for _ in 0..halvings {
        sum = &sum * &sum;
    }
    sum
}

/// The eigenvalue of largest magnitude: of the whole matrix if it is small, otherwise of its projection to a
/// Krylov space of 48 vectors (W. E. Arnoldi), which contains the largest ones of a map that damps almost
/// everything.
fn leading(map: &impl PeriodMap) -> Complex<f64> {
    let size = map.size();
    let count = size.min(48);
    // Any start that is not an eigenvector; the same every time.
    let mut start = DVector::from_fn(size, |i, _| 1.0 + 0.5 * libm::sin(1.0 + 12.9898 * i as f64));
    start.normalize_mut();
    let mut basis = vec![start];
    let mut small = DMatrix::<f64>::zeros(count, count);
    let mut filled = count;
    for k in 0..count {
        let Some(vector) = basis.get(k) else { break };
        let mut next = map.apply(vector);
        // Two passes keep the basis orthogonal.
        for _ in 0..2 {
            for (i, vector) in basis.iter().enumerate() {
                let part = vector.dot(&next);
                small[(i, k)] += part;
                next.axpy(-part, vector, 1.0);
            }
        }
        let norm = next.norm();
        if !norm.is_finite() {
            return Complex::new(f64::INFINITY, 0.0);
        }
        if k + 1 == count || norm < 1e-14 {
            filled = k + 1;
            break;
        }
        small[(k + 1, k)] = norm;
        basis.push(next / norm);
    }
    let small = small.view((0, 0), (filled, filled)).into_owned();
    let Some(schur) = Schur::try_new(small, 1e-15, 10_000) else {
        return Complex::new(f64::NAN, 0.0);
    };
    let eigenvalues = schur.complex_eigenvalues();
    let largest = eigenvalues.iter().max_by(|a, b| a.norm().total_cmp(&b.norm()));
    largest.copied().unwrap_or(Complex::ZERO)
}

/// Speeds and limits of a whole diagram: one point per speed, from `from_rpm` to `to_rpm`, in the frequency
/// domain.
#[must_use]
pub fn lobe_diagram(
    lobes: &impl Lobes,
    from_rpm: f64,
    to_rpm: f64,
    points: usize,
) -> Vec<(f64, Option<f64>)> {
    let speed = |k: usize| from_rpm + (to_rpm - from_rpm) * k as f64 / points.max(2).saturating_sub(1) as f64;
    let limit = |rpm: f64| lobes.limit_at(rpm).map(|limit| limit.depth_m);
    (0..points).map(|k| (speed(k), limit(speed(k)))).collect()
}
