//! The limit of the depth, and the largest multiplier there.

use nalgebra::Complex;

use super::MillingDelay;
use super::characteristic::{Circle, characteristic};
use super::elements::{Elements, Strength};
use crate::error::{ChatterError, number};

type C = Complex<f64>;

/// Gauss points an element: a wave has an error of 1e-9 with 10.
const NODES: usize = 10;
/// Points that check it.
const CHECK_NODES: usize = 15;
/// What a limit may differ by between both, relative.
const AGREEMENT: f64 = 1e-6;
/// To what a limit is computed, relative.
const ACCURACY: f64 = 1e-7;
/// Depths are tried in steps of this.
const STEP: f64 = 1.08;
/// And of this where a multiplier is nearly 1.
const SMALL_STEP: f64 = 1.01;
/// Its inverse.
const NEAR: f64 = 1.1;
/// Differences that give derivatives, relative: far above the rounding of the characteristic function.
const DIFFERENCE: f64 = 1e-5;
/// Complex multiplications of a circle with one mode, at most: some 20 ms, and a limit takes up to a hundred
/// circles.
const MAX_CIRCLE_WORK: f64 = 1e7;
/// The same with many modes, which take longer with few waves, too.
const MAX_CIRCLE_WORK_OF_MODES: f64 = 3e8;
/// What a disturbance may grow by before it dies out, at most: beyond, it would leave any cut, and rounding
/// passes for a motion.
const MAX_GROWTH: f64 = 1e9;

/// The elements of a period for depths up to a bound.
struct Solver<'a> {
    delay: &'a MillingDelay,
    strength: Strength,
    nodes: usize,
    elements: Elements,
    /// Depth and radius of the circle that the elements are for.
    most_m: f64,
    radius: f64,
}

impl<'a> Solver<'a> {
    fn new(delay: &'a MillingDelay, nodes: usize, depth: f64, radius: f64) -> Result<Self, ChatterError> {
        let strength = Strength::new(delay);
        let most_m = 1.5 * depth;
        let elements = Elements::new(delay, &strength, nodes, most_m * (1.0 + radius))?;
        Ok(Self {
            delay,
            strength,
            nodes,
            elements,
            most_m,
            radius,
        })
    }

    fn reach(&mut self, depth: f64, radius: f64) -> Result<(), ChatterError> {
        if depth > self.most_m || radius > self.radius {
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
        // By what the exponent of a motion changes along the circle.
        let change = depth * radius * self.strength.mean * self.delay.period_s;
        let points = 24.0 + 1.5 * change;
        let value = Elements::work(self.delay, &self.strength, self.most_m * (1.0 + radius));
        let work = 0.5 * points * value;
        if work.is_nan() || work > most_circle_work(self.delay) {
            return Err(ChatterError::TooManyWaves {
                waves: Elements::waves(self.delay),
                modes: self.delay.states() / 2,
            });
        }
        Circle::new(&self.elements, depth, radius, points as usize).ok_or_else(|| self.unresolved())
    }

    /// The depth and angle at which a zero lies on the unit circle, by Newton's method in both.
    fn crossing(&mut self, zero: C, depth: f64) -> Result<Option<(f64, f64)>, ChatterError> {
        let (mut angle, mut depth) = (zero.arg(), depth);
        let least = 0.2 * depth;
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
            // No step further than a lobe is wide.
            let much = (steps[0].abs() / 0.5)
                .max(steps[1].abs() / (0.05 * depth))
                .max(1.0);
            if !much.is_finite() {
                return Ok(None);
            }
            angle += steps[0] / much;
            depth += steps[1] / much;
            if depth < least || depth > 1.2 * self.most_m {
                return Ok(None);
            }
            if steps[1].abs() < 0.1 * ACCURACY * depth && steps[0].abs() < 1e-7 {
                return Ok(Some((angle, depth)));
            }
        }
        Ok(None)
    }

    /// The limit between a depth without a zero in the unit circle and one with some; the angle of the zero
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
                    // No other zero came in earlier.
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

/// The depth up to which no motion grows: there the damping takes more than the cut can give.
fn safe_m(delay: &MillingDelay, strength: &Strength) -> f64 {
    let least = delay
        .modes
        .iter()
        .map(|(mode, ..)| std::f64::consts::TAU * mode.frequency_hz * mode.damping_ratio)
        .fold(f64::INFINITY, f64::min);
    0.5 * least / strength.mean
}

/// Complex multiplications of a circle, at most.
fn most_circle_work(delay: &MillingDelay) -> f64 {
    let states = delay.states() as f64;
    (MAX_CIRCLE_WORK * states * states / 4.0).clamp(MAX_CIRCLE_WORK, MAX_CIRCLE_WORK_OF_MODES)
}

impl MillingDelay {
    /// The smallest depth in m, up to `most_m`, from which on the cut chatters, to 1e-6 of it; None where
    /// none does.
    ///
    /// Depths are tried upwards in steps of 8 %, and of 1 % where the largest multiplier is above 0.9, so an
    /// unstable island that is narrower may be missed. The limit is
    /// computed twice, with 10 and 15 points a wave; where both differ by more than 1e-6 there is none.
    ///
    /// # Errors
    /// A depth out of range; a cut with too many waves, or one that cannot be resolved; one in which
    /// disturbances grow a billion times before they die out below the limit.
    pub fn limit(&self, most_m: f64) -> Result<Option<f64>, ChatterError> {
        number("depth in m", most_m, 1e-7, 10.0)?;
        let mut solver = Solver::new(self, NODES, 1e-3 * most_m, 1.0)?;
        let mut low = safe_m(self, &solver.strength);
        if low >= most_m {
            return Ok(None);
        }
        let mut high = (STEP * low).max(1e-3 * most_m).min(most_m);
        loop {
            let circle = solver.circle(high, 1.0)?;
            if circle.zeros() > 0 {
                break;
            }
            if high >= most_m {
                return Ok(None);
            }
            let is_near = circle
                .nearest_zeros()
                .first()
                .is_some_and(|zero| zero.norm() < NEAR);
            low = high;
            high = (high * if is_near { SMALL_STEP } else { STEP }).min(most_m);
        }
        let (angle, limit) = solver.between(low, high)?;
        let mut check = Solver::new(self, CHECK_NODES, limit, 1.0)?;
        let checked = match angle {
            Some(angle) => check
                .crossing(C::new(libm::cos(angle), libm::sin(angle)), limit)?
                .map(|(_, depth)| depth),
            // Two zeros that came in together.
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

    /// A bound of what a disturbance grows by before it dies out, at a depth in m below the limit; in
    /// simulations 10 to 30 times less.
    ///
    /// The more waves a tooth cuts, the more a disturbance grows where the force is largest, teeth after
    /// teeth, while it moves on to where it decays.
    ///
    /// # Errors
    /// A depth out of range; a cut with too many waves.
    pub fn growth(&self, depth_m: f64) -> Result<f64, ChatterError> {
        number("depth in m", depth_m, 1e-9, 10.0)?;
        Ok(Solver::new(self, NODES, depth_m, 1.0)?.growth(depth_m))
    }

    /// Complex multiplications of [`MillingDelay::limit`], roughly.
    #[must_use]
    pub fn limit_work(&self) -> f64 {
        const CIRCLES: f64 = 40.0;
        let strength = Strength::new(self);
        // A limit is at some three times the depth that no motion can chatter at.
        let depth = 3.0 * safe_m(self, &strength);
        let points = 24.0 + 1.5 * depth * strength.mean * self.period_s;
        let circle = 0.5 * points * Elements::work(self, &strength, 3.0 * depth);
        let most = most_circle_work(self);
        if circle > most {
            return most;
        }
        CIRCLES * circle
    }

    /// The largest multiplier at a depth in m, if it is larger than 0.3 in magnitude; of a pair the one with
    /// a positive imaginary part.
    ///
    /// # Errors
    /// A depth out of range; a cut with too many waves, or one that cannot be resolved.
    pub fn multiplier(&self, depth_m: f64) -> Result<Option<Complex<f64>>, ChatterError> {
        number("depth in m", depth_m, 0.0, 10.0)?;
        let mut solver = Solver::new(self, NODES, depth_m.max(1e-9), 1.0)?;
        for radius in [1.0, 1.3, 1.7, 2.2, 2.8, 3.4] {
            let mut circle = solver.circle(depth_m, radius)?;
            if circle.zeros() == 0 && radius < 3.0 {
                // One right outside is as good.
                let near = circle
                    .nearest_zeros()
                    .into_iter()
                    .find(|z| z.norm() < 1.05 * radius);
                if let Some(zero) = near {
                    return Ok(Some(zero.conj().inv()));
                }
                continue;
            }
            // The circle shrinks until the zero found is its only one.
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
