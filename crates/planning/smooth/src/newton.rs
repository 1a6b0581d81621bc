//! Newton's method for a quadratic cost inside a tube, on banded matrices.

use evolvent_path::{AXES, Axes};

use crate::tube::{GROUPS, Sample};

/// Fraction of its margin that every sample keeps in a step; factor and maximum number of backtracking steps.
const MARGIN: f64 = 0.05;
const BACKTRACK_FACTOR: f64 = 0.8;
const MAX_BACKTRACKS: usize = 80;

/// A term of the cost: the square of a linear function of the four control points of an interval, for each
/// axis.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Term {
    pub(crate) interval: usize,
    pub(crate) weights: [f64; 4],
    /// Weight of the square for each axis.
    pub(crate) factors: Axes,
}

/// The problem for a range of control points.
pub(crate) struct Problem<'a> {
    pub(crate) terms: &'a [Term],
    pub(crate) samples: &'a [Sample],
    /// Barrier weight of a sample of each interval, times `mu`; indexed from interval `first`.
    pub(crate) barrier: &'a [f64],
    pub(crate) first: usize,
    pub(crate) mu: f64,
    /// Range of the free control points.
    pub(crate) free: (usize, usize),
    pub(crate) active: [bool; AXES],
}

/// Working memory, kept between solutions.
#[derive(Debug, Default)]
pub(crate) struct Workspace {
    matrix: Vec<f64>,
    gradient: Vec<f64>,
    step: Vec<f64>,
    errors: Vec<[f64; 3]>,
}

/// Performs at most `steps` Newton steps and returns their number. The points stay strictly inside the tube.
pub(crate) fn minimise(
    problem: &Problem<'_>,
    points: &mut [Axes],
    steps: usize,
    work: &mut Workspace,
) -> usize {
    let count = problem.active.iter().filter(|&&active| active).count();
    match count {
        0 => 0,
        1 | 2 => Solver::<2>::new(problem).run(points, steps, work),
        3 => Solver::<3>::new(problem).run(points, steps, work),
        4 | 5 => Solver::<5>::new(problem).run(points, steps, work),
        _ => Solver::<9>::new(problem).run(points, steps, work),
    }
}

/// The active axes, then the others, which pad a solver for more axes and do not move.
pub(crate) fn order(active: &[bool; AXES]) -> impl Iterator<Item = usize> {
    (0..AXES)
        .filter(|&i| active[i])
        .chain((0..AXES).filter(|&i| !active[i]))
}

struct Solver<'a, const D: usize> {
    problem: &'a Problem<'a>,
    axes: [usize; D],
    /// Number of active axes; the others are padding.
    count: usize,
    /// For each group: the number of its active axes, their columns, and their indices in the group.
    groups: [(usize, [usize; 3], [usize; 3]); 5],
}

impl<'a, const D: usize> Solver<'a, D> {
    fn new(problem: &'a Problem<'a>) -> Self {
        let mut axes = [0; D];
        let mut columns = [usize::MAX; AXES];
        for (column, axis) in order(&problem.active).take(D).enumerate() {
            axes[column] = axis;
            if problem.active[axis] {
                columns[axis] = column;
            }
        }
        let count = problem.active.iter().filter(|&&active| active).count().min(D);
        let groups = GROUPS.map(|(first, count)| {
            let (mut n, mut cols, mut rows) = (0, [0; 3], [0; 3]);
            for d in 0..count {
                if columns[first + d] != usize::MAX {
                    cols[n] = columns[first + d];
                    rows[n] = d;
                    n += 1;
                }
            }
            (n, cols, rows)
        });
        Self {
            problem,
            axes,
            count,
            groups,
        }
    }

    /// Bandwidth: four control points.
    const BAND: usize = 4 * D;

    fn run(&self, points: &mut [Axes], steps: usize, work: &mut Workspace) -> usize {
        let (low, high) = self.problem.free;
        let size = (high - low) * D;
        if size == 0 {
            return 0;
        }
        work.matrix.resize((size + Self::BAND) * Self::BAND, 0.0);
        work.gradient.resize(size + Self::BAND, 0.0);
        work.step.resize(size + Self::BAND, 0.0);
        let mut last = 0.0;
        let mut back = 0;
        for taken in 0..steps {
            self.assemble(points, work);
            if taken > 0 {
                // Too far: the slope has changed sign. Halve the step and check again.
                let slope: f64 = work.step[..size]
                    .iter()
                    .zip(&work.gradient)
                    .map(|(s, g)| s * g)
                    .sum();
                if slope > 0.7 * last && back < 4 {
                    back += 1;
                    for s in &mut work.step[..size] {
                        *s *= 0.5;
                    }
                    self.advance(points, &work.step, -1.0);
                    last *= 0.5;
                    continue;
                }
            }
            back = 0;
            self.solve(work, size);
            let limit = self.limit(work);
            for s in &mut work.step[..size] {
                *s *= limit;
            }
            last = -work.step[..size]
                .iter()
                .zip(&work.gradient)
                .map(|(s, g)| s * g)
                .sum::<f64>();
            if !last.is_finite() {
                return taken;
            }
            self.advance(points, &work.step, 1.0);
        }
        steps
    }

    fn advance(&self, points: &mut [Axes], step: &[f64], sign: f64) {
        let (low, high) = self.problem.free;
        for (point, change) in points[low..high].iter_mut().zip(step.chunks_exact(D)) {
            for d in 0..D {
                point[self.axes[d]] += sign * change[d];
            }
        }
    }

    /// Gradient and lower half of the Hessian by columns: entry `(r, c)` at `c * BAND + r - c`.
    fn assemble(&self, points: &[Axes], work: &mut Workspace) {
        let (low, high) = self.problem.free;
        let (matrix, gradient) = (&mut work.matrix, &mut work.gradient);
        matrix.fill(0.0);
        gradient.fill(0.0);
        let band = Self::BAND;
        for term in self.problem.terms {
            let i = term.interval;
            for d in 0..self.count {
                let axis = self.axes[d];
                let factor = 2.0 * term.factors[axis];
                let value: f64 = (0..4).map(|l| term.weights[l] * points[i + l][axis]).sum();
                for l in 0..4 {
                    if i + l < low || i + l >= high {
                        continue;
                    }
                    let column = (i + l - low) * D + d;
                    let w = factor * term.weights[l];
                    gradient[column] += w * value;
                    for m in l..4 {
                        if i + m < high {
                            matrix[column * band + (m - l) * D] += w * term.weights[m];
                        }
                    }
                }
            }
        }
        work.errors.clear();
        for sample in self.problem.samples {
            let i = sample.interval;
            let error = sample.error(&points[i..i + 4]);
            work.errors.push(error);
            let (n, columns, rows) = &self.groups[sample.group];
            let (offset, inside) = sample.offset(&error);
            let ratio = crate::tube::dot(&offset, &offset) / sample.radius2;
            let flat = f64::from(u8::from(inside));
            let inverse = 1.0 / (1.0 - ratio);
            let weight = self.problem.mu * self.problem.barrier[i - self.problem.first];
            let h1 = 2.0 * weight * inverse / sample.radius2;
            let h2 = 2.0 * inverse / sample.radius2;
            let mut g = [0.0; 3];
            let mut h = [[0.0; 3]; 3];
            for a in 0..*n {
                let p = rows[a];
                g[a] = offset[p];
            }
            for a in 0..*n {
                for b in 0..*n {
                    let (p, q) = (rows[a], rows[b]);
                    h[a][b] = h1 * (h2 * g[a] * g[b] - flat * sample.along[p] * sample.along[q]);
                }
                h[a][a] += h1;
            }
            for l in 0..4 {
                if i + l < low || i + l >= high {
                    continue;
                }
                let base = (i + l - low) * D;
                let w = sample.weights[l];
                for a in 0..*n {
                    gradient[base + columns[a]] += h1 * w * g[a];
                }
                for m in l..4 {
                    if i + m >= high {
                        break;
                    }
                    let ww = w * sample.weights[m];
                    for b in 0..*n {
                        let column = base + columns[b];
                        // Row minus column; on the diagonal block only the lower half.
                        for a in 0..*n {
                            let row = (m - l) * D + columns[a];
                            if row >= columns[b] {
                                matrix[column * band + row - columns[b]] += ww * h[a][b];
                            }
                        }
                    }
                }
            }
        }
    }

    /// The Newton step.
    fn solve(&self, work: &mut Workspace, size: usize) {
        work.step.clear();
        work.step.extend(work.gradient.iter().map(|g| -g));
        crate::band::solve(&mut work.matrix, &mut work.step, size, Self::BAND);
    }

    /// Maximum multiple of the step that stays well inside the tube.
    fn limit(&self, work: &Workspace) -> f64 {
        let (low, high) = self.problem.free;
        let mut limit: f64 = 1.0;
        for (sample, error) in self.problem.samples.iter().zip(&work.errors) {
            let i = sample.interval;
            let (n, columns, rows) = &self.groups[sample.group];
            let mut change = [0.0; 3];
            for l in 0..4 {
                if i + l < low || i + l >= high {
                    continue;
                }
                let base = (i + l - low) * D;
                for a in 0..*n {
                    change[rows[a]] += sample.weights[l] * work.step[base + columns[a]];
                }
            }
            let max = 1.0 - MARGIN * (1.0 - sample.ratio(error));
            let at = |t: f64| sample.ratio(&std::array::from_fn(|d| error[d] + t * change[d]));
            for _ in 0..MAX_BACKTRACKS {
                if at(limit) <= max {
                    break;
                }
                limit *= BACKTRACK_FACTOR;
            }
        }
        limit
    }
}
