//! The limit of the depth, and the largest multiplier there.

use nalgebra::Complex;

use super::MillingDelay;
use super::characteristic::{Circle, characteristic};
use super::elements::{Elements, Strength};
use crate::error::{ChatterError, number};

type C = Complex<f64>;

/// Gauss points per element: with 10 a wave has an error of 1e-9.
const NODES: usize = 10;
/// Gauss points per element of the check.
const CHECK_NODES: usize = 15;
/// Maximum relative difference of the two limits.
const AGREEMENT: f64 = 1e-6;
/// Relative accuracy of a limit.
const ACCURACY: f64 = 1e-7;
/// Factor between the depths that are tried.
const STEP: f64 = 1.08;
/// The factor if a multiplier is nearly 1.
const SMALL_STEP: f64 = 1.01;
/// Inverse of the multiplier from which it is nearly 1.
const NEAR: f64 = 1.1;
/// Relative differences for derivatives: far above the rounding of the characteristic function.
const DIFFERENCE: f64 = 1e-5;
/// Maximum number of complex multiplications of a circle with one mode: about 20 ms, and a limit takes up to
/// a hundred circles.
const MAX_CIRCLE_WORK: f64 = 1e7;
/// The same with many modes, which take longer even with few waves.
const MAX_CIRCLE_WORK_OF_MODES: f64 = 3e8;
/// Maximum growth of a disturbance before it dies out: with more, it would leave any cut, and rounding errors
/// would look like a motion.
const MAX_GROWTH: f64 = 1e9;

/// The elements of a period for depths up to a bound.
struct Solver<'a> {
    delay: &'a MillingDelay,
    strength: Strength,
    nodes: usize,
    elements: Elements,
    /// Depth and radius of the circle for which the elements are valid.
    max_m: f64,
    radius: f64,
}

impl<'a> Solver<'a> {
    fn new(delay: &'a MillingDelay, nodes: usize, depth: f64, radius: f64) -> Result<Self, ChatterError> {
        let strength = Strength::new(delay);
        let max_m = 1.5 * depth;
        let elements = Elements::new(delay, &strength, nodes, max_m * (1.0 + radius))?;
        Ok(Self {
            delay,
            strength,
            nodes,
            elements,
            max_m,
            radius,
        })
    }

    fn reach(&mut self, depth: f64, radius: f64) -> Result<(), ChatterError> {
        if depth > self.max_m || radius > self.radius {
            *self = Self::new(self.delay, self.nodes, depth, radius.max(self.radius))?;
        }
        Ok(())
    }

    fn growth(&self, depth: f64) -> f64 {
        const POINTS: u32 = 48;
        let growth = (0..=POINTS).map(|k| {
            let angle = std::f64::consts::PI * f64::from(k) / f64::from(POINTS);
            let z = C::new(libm::cos(angle), libm::sin(angle));
            self.elements.growth((C::ONE - z) * depth)
        });
        growth.fold(1.0, f64::max)
    }

    fn unresolved(&self) -> ChatterError {
        ChatterError::Unresolved {
            waves: Elements::waves(self.delay),
        }
    }

    fn circle(&mut self, depth: f64, radius: f64) -> Result<Circle, ChatterError> {
        self.reach(depth, radius)?;
        // Change of the exponent of a motion along the circle.
        let change = depth * radius * self.strength.mean * self.delay.period_s;
        let points = 24.0 + 1.5 * change;
        let value = Elements::work(self.delay, &self.strength, self.max_m * (1.0 + radius));
        let work = 0.5 * points * value;
        if work.is_nan() || work > max_circle_work(self.delay) {
            return Err(ChatterError::TooManyWaves {
                waves: Elements::waves(self.delay),
                modes: self.delay.states() / 2,
            });
        }
        Circle::new(&self.elements, depth, radius, points as usize).ok_or_else(|| self.unresolved())
    }

    /// The depth and angle at which a zero is on the unit circle, by Newton's method in both.
    fn crossing(&mut self, zero: C, depth: f64) -> Result<Option<(f64, f64)>, ChatterError> {
        let (mut angle, mut depth) = (zero.arg(), depth);
        let min = 0.2 * depth;
        for _ in 0..30 {
            self.reach(depth, 1.0)?;
            let at = |angle: f64, depth: f64| {
                characteristic(&self.elements, depth, C::new(libm::cos(angle), libm::sin(angle)))
            };
            let (turn, deeper) = (DIFFERENCE, DIFFERENCE * depth);
            let value = at(angle, depth);
            let by_angle = (at(angle + turn, depth) - value) / turn;
            let by_depth = (at(angle, depth + deeper) - value) / deeper;
            let cross = |a: C, b: C| a.re * b.im - a.im * b.re;
            let both = cross(by_angle, by_depth);
            let steps = [-cross(value, by_depth) / both, -cross(by_angle, value) / both];
            // No step is longer than a lobe is wide.
            let much = (steps[0].abs() / 0.5)
                .max(steps[1].abs() / (0.05 * depth))
                .max(1.0);
            if !much.is_finite() {
                return Ok(None);
            }
            angle += steps[0] / much;
            depth += steps[1] / much;
            if depth < min || depth > 1.2 * self.max_m {
                return Ok(None);
            }
            if steps[1].abs() < 0.1 * ACCURACY * depth && steps[0].abs() < 1e-7 {
                return Ok(Some((angle, depth)));
            }
        }
        Ok(None)
    }

    /// The limit between a depth without a zero in the unit circle and one with a zero; the angle of the zero
    /// there.
    fn between(&mut self, mut low: f64, mut high: f64) -> Result<(Option<f64>, f64), ChatterError> {
        let mut circle = self.circle(high, 1.0)?;
        for _ in 0..60 {
            if high - low <= ACCURACY * high {
                break;
            }
            let mut first: Option<(f64, f64)> = None;
            for zero in circle.nearest_zeros() {
                let crossing = self.crossing(zero, high)?;
                let inside = crossing.filter(|(_, depth)| (low..=high).contains(depth));
                if let Some(here) = inside
                    && first.is_none_or(|first| here.1 < first.1)
                {
                    first = Some(here);
                }
            }
            let middle = match first {
                Some((angle, depth)) => {
                    // No other zero has entered earlier.
                    let before = self.circle((1.0 - ACCURACY) * depth, 1.0)?;
                    if before.zeros() == 0 {
                        return Ok((Some(angle), depth));
                    }
                    (high, circle) = ((1.0 - ACCURACY) * depth, before);
                    0.5 * (low + high)
                }
                None => 0.5 * (low + high),
            };
            let here = self.circle(middle, 1.0)?;
            if here.zeros() == 0 {
                low = middle;
            } else {
                (high, circle) = (middle, here);
            }
        }
        Ok((None, 0.5 * (low + high)))
    }
}

/// The depth up to which no motion grows: the damping absorbs more than the cut can supply.
fn safe_m(delay: &MillingDelay, strength: &Strength) -> f64 {
    let min = delay
        .modes
        .iter()
        .map(|(mode, ..)| std::f64::consts::TAU * mode.frequency_hz * mode.damping_ratio)
        .fold(f64::INFINITY, f64::min);
    0.5 * min / strength.mean
}

/// Maximum number of complex multiplications of a circle.
fn max_circle_work(delay: &MillingDelay) -> f64 {
    let states = delay.states() as f64;
    (MAX_CIRCLE_WORK * states * states / 4.0).clamp(MAX_CIRCLE_WORK, MAX_CIRCLE_WORK_OF_MODES)
}

impl MillingDelay {
    /// The smallest depth in m, up to `max_m`, from which on the cut chatters, to 1e-6 of it; `None` if
    /// there is none.
    ///
    /// Depths are tried upwards in steps of 8 %, and of 1 % if the largest multiplier is above 0.9, so a
    /// narrower unstable island may be missed. The limit is computed twice, with 10 and 15 points per wave;
    /// if both differ by more than 1e-6, the result is an error.
    ///
    /// # Errors
    /// A depth out of range; a cut with too many waves, or one that cannot be resolved; one in which
    /// disturbances grow a billion times before they die out below the limit.
    pub fn limit(&self, max_m: f64) -> Result<Option<f64>, ChatterError> {
        number("depth in m", max_m, 1e-7, 10.0)?;
        let mut solver = Solver::new(self, NODES, 1e-3 * max_m, 1.0)?;
        let mut low = safe_m(self, &solver.strength);
        if low >= max_m {
            return Ok(None);
        }
        let mut high = (STEP * low).max(1e-3 * max_m).min(max_m);
        loop {
            let circle = solver.circle(high, 1.0)?;
            if circle.zeros() > 0 {
                break;
            }
            if high >= max_m {
                return Ok(None);
            }
            let is_near = circle
                .nearest_zeros()
                .first()
                .is_some_and(|zero| zero.norm() < NEAR);
            low = high;
            high = (high * if is_near { SMALL_STEP } else { STEP }).min(max_m);
        }
        let (angle, limit) = solver.between(low, high)?;
        let mut check = Solver::new(self, CHECK_NODES, limit, 1.0)?;
        let checked = match angle {
            Some(angle) => check
                .crossing(C::new(libm::cos(angle), libm::sin(angle)), limit)?
                .map(|(_, depth)| depth),
            // Two zeros that entered together.
            None => {
                let margin = 0.5 * AGREEMENT * limit;
                let below = check.circle(limit - margin, 1.0)?.zeros();
                let above = check.circle(limit + margin, 1.0)?.zeros();
                (below == 0 && above > 0).then_some(limit)
            }
        };
        match checked {
            Some(depth) if (depth - limit).abs() <= AGREEMENT * limit => {
                let growth = solver.growth(limit);
                if growth > MAX_GROWTH {
                    return Err(ChatterError::Growth { growth });
                }
                Ok(Some(limit))
            }
            _ => Err(solver.unresolved()),
        }
    }

    /// An upper bound of the growth of a disturbance before it dies out, at a depth in m below the limit.
    /// Simulations show 10 to 30 times less.
    ///
    /// With many waves per cut, a disturbance grows where the force is largest, over many teeth, while it
    /// moves on to where it decays.
    ///
    /// # Errors
    /// A depth out of range; a cut with too many waves.
    pub fn growth(&self, depth_m: f64) -> Result<f64, ChatterError> {
        number("depth in m", depth_m, 1e-9, 10.0)?;
        Ok(Solver::new(self, NODES, depth_m, 1.0)?.growth(depth_m))
    }

    /// Approximate number of complex multiplications of [`MillingDelay::limit`].
    #[must_use]
    pub fn limit_work(&self) -> f64 {
        const CIRCLES: f64 = 40.0;
        let strength = Strength::new(self);
        // A limit is at about three times the depth up to which no motion can chatter.
        let depth = 3.0 * safe_m(self, &strength);
        let points = 24.0 + 1.5 * depth * strength.mean * self.period_s;
        let circle = 0.5 * points * Elements::work(self, &strength, 3.0 * depth);
        let max = max_circle_work(self);
        if circle > max {
            return max;
        }
        CIRCLES * circle
    }

    /// The largest multiplier at a depth in m, if its magnitude exceeds 0.3; of a pair the one with a
    /// positive imaginary part.
    ///
    /// # Errors
    /// A depth out of range; a cut with too many waves, or one that cannot be resolved.
    pub fn multiplier(&self, depth_m: f64) -> Result<Option<Complex<f64>>, ChatterError> {
        number("depth in m", depth_m, 0.0, 10.0)?;
        let mut solver = Solver::new(self, NODES, depth_m.max(1e-9), 1.0)?;
        for radius in [1.0, 1.3, 1.7, 2.2, 2.8, 3.4] {
            let mut circle = solver.circle(depth_m, radius)?;
            if circle.zeros() == 0 && radius < 3.0 {
                // A zero right outside the circle serves as well.
                let near = circle
                    .nearest_zeros()
                    .into_iter()
                    .find(|z| z.norm() < 1.05 * radius);
                if let Some(zero) = near {
                    return Ok(Some(zero.conj().inv()));
                }
                continue;
            }
            // The circle shrinks until it contains this zero only.
            let (mut none, mut some) = (0.5 * radius, radius);
            for _ in 0..60 {
                let zeros = circle.nearest_zeros();
                let zero = zeros
                    .first()
                    .filter(|zero| zero.norm() < (1.0 - 1e-7) * some || some - none < 1e-6);
                let within = zero.map_or(0.5 * (none + some), |zero| (1.0 - 1e-6) * zero.norm());
                let smaller = solver.circle(depth_m, within)?;
                match zero {
                    Some(zero) if smaller.zeros() == 0 => return Ok(Some(zero.inv().conj())),
                    None if smaller.zeros() == 0 => none = within,
                    _ => (some, circle) = (within, smaller),
                }
            }
            return Err(solver.unresolved());
        }
        Ok(None)
    }
}
