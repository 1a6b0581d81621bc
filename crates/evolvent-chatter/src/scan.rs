//! The amplitude scan: every cycle of a model, stable or not.
//!
//! Along the branch that begins at a mode of small vibration, the extra damping `D(A)` that makes the motion of
//! amplitude `A` periodic is followed from nothing to where the model ends. `D = 0` is a cycle; where `D` falls through
//! zero it is stable, where it rises unstable. The branch cannot fall back to rest, brackets every root, and finds a
//! large cycle beside a steady cut that is stable against small disturbances.

use crate::balance::{Balance, Balanced};
use crate::cycle::Cycle;
use crate::error::ChatterError;
use crate::model::{Equilibrium, Model, SmallMode};

/// Part of a period out of contact beyond which the model says nothing: the tool hammers.
pub const MOST_FREE_PART: f64 = 0.5;
/// Steps of the scan up to the amplitude at which the model begins to end.
const STEPS: f64 = 24.0;
/// Samples a period where the contact is lost: force over time then has a corner, which must lie between close ones.
const FINE_SAMPLES: usize = 512;
/// Beyond, the amplitude grows by this part each step.
const GROWTH: f64 = 0.06;
/// No scan needs more steps.
const MOST_STEPS: usize = 400;

/// How the scan of a branch ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ScanEnd {
    /// The cutting speed falls to the floor below which the force law is not trusted.
    SpeedFloor,
    /// The tool is out of contact for more than half of the period.
    ContactLost,
    /// The balance was not found any more.
    NotFound,
    /// The mode does not swing, so no branch begins at it.
    NoBranch,
}

/// One point of a branch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScanPoint {
    /// Amplitude of the driving coordinate, m.
    pub amplitude_m: f64,
    /// Extra damping that would make it a cycle, 1/s.
    pub extra_per_s: f64,
    /// Frequency, Hz.
    pub frequency_hz: f64,
}

/// The branch that begins at a mode of small vibration.
#[derive(Clone, Debug, PartialEq)]
pub struct Branch {
    /// Where it begins.
    pub mode: SmallMode,
    /// The coordinate whose amplitude was scanned (0 for V1, 1 for V2).
    pub driver: usize,
    /// What was computed along it.
    pub points: Vec<ScanPoint>,
    /// Cycles, the smallest first.
    pub cycles: Vec<Cycle>,
    /// Where and why it ended.
    pub end: ScanEnd,
}

impl Branch {
    /// Whether motions at the end of the branch would go on growing: out of the model.
    #[must_use]
    pub fn grows_at_the_end(&self) -> bool {
        match self.points.last() {
            Some(last) => last.extra_per_s > 0.0,
            None => self.mode.growth_per_s > 0.0,
        }
    }
}

/// What the model says of a cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Every disturbance within the model dies out.
    Stable,
    /// The cut is steady, but a disturbance beyond the unstable cycle grows to a stable one.
    Bistable,
    /// The cut vibrates by itself.
    SelfExcited,
    /// Vibration grows until the model ends: no answer but that it is large.
    OutOfModel,
}

impl Verdict {
    /// As written in reports.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Stable => "stable",
            Self::Bistable => "bistable",
            Self::SelfExcited => "self-excited",
            Self::OutOfModel => "out-of-model",
        }
    }
}

/// The answer of a scan.
#[derive(Clone, Debug, PartialEq)]
pub struct Prediction {
    /// The steady cut.
    pub equilibrium: Equilibrium,
    /// A branch for each mode that swings.
    pub branches: Vec<Branch>,
}

impl Prediction {
    /// All cycles, the smallest of the first branch first.
    pub fn cycles(&self) -> impl Iterator<Item = &Cycle> {
        self.branches.iter().flat_map(|branch| &branch.cycles)
    }

    /// The verdict, from linear growth and the cycles' slopes.
    #[must_use]
    pub fn verdict(&self) -> Verdict {
        let grows = self.equilibrium.growth_per_s() > 0.0;
        let stable_cycle = self.cycles().any(Cycle::stable_by_slope);
        let lost = self
            .branches
            .iter()
            .any(|branch| branch.grows_at_the_end() && !branch.cycles.iter().any(Cycle::stable_by_slope));
        match (grows, stable_cycle, lost) {
            (true, true, _) => Verdict::SelfExcited,
            (true, false, _) => Verdict::OutOfModel,
            (false, true, _) => Verdict::Bistable,
            (false, false, true) => Verdict::OutOfModel,
            (false, false, false) => Verdict::Stable,
        }
    }
}

/// A scan with so many harmonics; keeps its working memory from one model to the next.
#[derive(Clone, Debug)]
pub struct Scanner {
    balance: Balance,
    /// For cycles out of contact.
    fine: Option<Balance>,
    steps: f64,
    growth: f64,
    halvings: usize,
}

impl Scanner {
    /// For 1 to 64 harmonics; 5 give amplitudes to 1e-4.
    #[must_use]
    pub fn new(harmonics: usize) -> Self {
        Self {
            balance: Balance::new(harmonics),
            fine: None,
            steps: STEPS,
            growth: GROWTH,
            halvings: 10,
        }
    }

    /// A quick scan for maps: one harmonic, and fewer steps. It brackets cycles for [`Scanner::refine`].
    #[must_use]
    pub fn coarse() -> Self {
        Self {
            balance: Balance::with_samples(1, 16).until(1e-4),
            fine: None,
            steps: 6.0,
            growth: 0.15,
            halvings: 3,
        }
    }

    /// For maps: as many samples and steps as amplitudes to 1e-4 need.
    pub(crate) fn for_maps(harmonics: usize) -> Self {
        Self {
            balance: Balance::with_samples(harmonics, (9 * harmonics).max(16)),
            steps: 14.0,
            growth: 0.09,
            halvings: 6,
            ..Self::new(harmonics)
        }
    }

    /// Every cycle of a model, on the branches of all its modes.
    ///
    /// # Errors
    /// No steady cut, or a force law that does not reach as far as the motion.
    pub fn scan(&mut self, model: &Model<'_>) -> Result<Prediction, ChatterError> {
        let equilibrium = model.equilibrium()?;
        let mut branches = Vec::with_capacity(2);
        for mode in &equilibrium.modes {
            branches.push(self.branch(model, equilibrium.force_n, mode)?);
        }
        Ok(Prediction {
            equilibrium,
            branches,
        })
    }

    /// The cycle near a given one, with this scanner's number of harmonics; None where there is none.
    ///
    /// # Errors
    /// The force law does not reach as far.
    pub fn refine(&mut self, model: &Model<'_>, cycle: &Cycle) -> Result<Option<Cycle>, ChatterError> {
        let Some(first) = self.balance_at(model, cycle, cycle.amplitude_m(cycle.driver))? else {
            return Ok(None);
        };
        let Some(root) = newton(&mut self.balance, model, cycle.driver, first)? else {
            return Ok(None);
        };
        if !valid(model, &root) {
            return Ok(None);
        }
        let root = self.in_contact_or_finer(model, cycle.driver, root)?;
        Ok(Some(self.cycle(model, cycle.driver, &root)))
    }

    fn balance_at(
        &mut self,
        model: &Model<'_>,
        cycle: &Cycle,
        amplitude: f64,
    ) -> Result<Option<Balanced>, ChatterError> {
        let force = model.equilibrium()?.force_n;
        let mode = SmallMode {
            growth_per_s: 0.0,
            frequency_hz: cycle.frequency_hz,
        };
        let start = self.balance.start(force, &mode);
        self.balance.solve(model, cycle.driver, amplitude, start)
    }

    /// Amplitudes of the driver at which the speed reaches the floor and the contact is lost, if all stayed linear.
    fn reach(&self, model: &Model<'_>, driver: usize, tiny: &Balanced) -> (f64, f64) {
        let [v1, v2] = self.balance.deflections(model, driver, tiny);
        let (c, s) = model.machine_axes(1.0, 0.0);
        let (a, b) = (v1[1], v2[1]);
        let (y, z) = ((a * c - b * s).norm(), (a * s + b * c).norm());
        let tool = model.tool();
        let floor = (tool.speed_m_min - tool.floor_m_min) / (60.0 * tiny.omega() * z) * tiny.amplitude;
        let contact = tiny.depths[1] / (1000.0 * y) * tiny.amplitude;
        (floor, contact)
    }

    /// The coordinate that swings most in a mode, and the motion at a tiny amplitude.
    fn begin(
        &mut self,
        model: &Model<'_>,
        force: f64,
        mode: &SmallMode,
    ) -> Result<Option<(usize, Balanced)>, ChatterError> {
        let depth_m = 1e-3 * model.tool().depth_mm;
        let mut best: Option<(usize, Balanced, f64)> = None;
        for driver in [1, 0] {
            if model.direction()[driver].abs() < 1e-9 {
                continue;
            }
            let amplitude = 1e-5 * depth_m;
            let start = self.balance.start(force, mode);
            let Some(tiny) = self.balance.solve(model, driver, amplitude, start)? else {
                continue;
            };
            // Another mode than the one asked for.
            if (tiny.omega() / (std::f64::consts::TAU * mode.frequency_hz) - 1.0).abs() > 0.2 {
                continue;
            }
            let [v1, v2] = self.balance.deflections(model, driver, &tiny);
            let share = [v1[1].norm(), v2[1].norm()][driver] / v1[1].norm().max(v2[1].norm());
            if best.as_ref().is_none_or(|best| share > best.2) {
                best = Some((driver, tiny, share));
            }
            if share >= 1.0 {
                break;
            }
        }
        Ok(best.map(|(driver, tiny, _)| (driver, tiny)))
    }

    pub(crate) fn branch(
        &mut self,
        model: &Model<'_>,
        force: f64,
        mode: &SmallMode,
    ) -> Result<Branch, ChatterError> {
        let mut branch = Branch {
            mode: *mode,
            driver: 1,
            points: Vec::new(),
            cycles: Vec::new(),
            end: ScanEnd::NoBranch,
        };
        if mode.frequency_hz <= 0.0 {
            return Ok(branch);
        }
        let Some((driver, tiny)) = self.begin(model, force, mode)? else {
            return Ok(branch);
        };
        branch.driver = driver;
        let (floor, contact) = self.reach(model, driver, &tiny);
        let near = floor.min(contact);
        let mut here = tiny;
        let mut step = near / self.steps;
        let mut shortened = 0;
        branch.points.push(point(&here));
        branch.end = ScanEnd::NotFound;
        for _ in 0..MOST_STEPS {
            let amplitude = here.amplitude + step;
            let guess = predicted(&here, amplitude);
            let next = self.balance.solve(model, driver, amplitude, guess)?;
            let next = match next {
                Some(next) if valid(model, &next) => next,
                outcome => {
                    // The end lies within this step: come near to it.
                    if let Some(beyond) = &outcome {
                        branch.end = end_of(model, beyond);
                    }
                    shortened += 1;
                    if shortened > self.halvings {
                        break;
                    }
                    step *= 0.5;
                    continue;
                }
            };
            self.roots(model, driver, &here, &next, &mut branch.cycles, 0)?;
            branch.points.push(point(&next));
            here = next;
            if shortened == 0 {
                step = (near / self.steps).max(self.growth * here.amplitude);
            }
        }
        Ok(branch)
    }

    /// Cycles between two neighbours on a branch.
    fn roots(
        &mut self,
        model: &Model<'_>,
        driver: usize,
        from: &Balanced,
        to: &Balanced,
        cycles: &mut Vec<Cycle>,
        depth: usize,
    ) -> Result<(), ChatterError> {
        if (from.extra() > 0.0) != (to.extra() > 0.0) {
            if let Some(root) = self.root(model, driver, from, to)? {
                let root = self.in_contact_or_finer(model, driver, root)?;
                cycles.push(self.cycle(model, driver, &root));
            }
            return Ok(());
        }
        // Two roots may hide between points on the same side: look at the extremum of the cubic through both.
        let towards_zero = |at: &Balanced| at.extra() * at.extra_slope() < 0.0;
        if depth < 4 && towards_zero(from) && to.extra() * to.extra_slope() > 0.0 {
            let Some(amplitude) = extremum(from, to) else {
                return Ok(());
            };
            let guess = predicted(from, amplitude);
            if let Some(between) = self.balance.solve(model, driver, amplitude, guess)? {
                self.roots(model, driver, from, &between, cycles, depth + 1)?;
                self.roots(model, driver, &between, to, cycles, depth + 1)?;
            }
        }
        Ok(())
    }

    /// The root of `D` between two points where its sign differs, to 1e-12 of the amplitude.
    fn root(
        &mut self,
        model: &Model<'_>,
        driver: usize,
        from: &Balanced,
        to: &Balanced,
    ) -> Result<Option<Balanced>, ChatterError> {
        let (mut low, mut high) = (from.clone(), to.clone());
        for _ in 0..60 {
            let near = if low.extra().abs() < high.extra().abs() {
                &low
            } else {
                &high
            };
            let newton = near.amplitude - near.extra() / near.extra_slope();
            let inside = newton > low.amplitude && newton < high.amplitude;
            let amplitude = if inside {
                newton
            } else {
                0.5 * (low.amplitude + high.amplitude)
            };
            let tolerance = 1e-12 * high.amplitude;
            if high.amplitude - low.amplitude <= tolerance
                || (inside && (newton - near.amplitude).abs() <= tolerance)
            {
                return Ok(Some(near.clone()));
            }
            let guess = predicted(near, amplitude);
            let Some(next) = self.balance.solve(model, driver, amplitude, guess)? else {
                return Ok(Some(near.clone()));
            };
            if next.extra() == 0.0 {
                return Ok(Some(next));
            }
            if (next.extra() > 0.0) == (low.extra() > 0.0) {
                low = next;
            } else {
                high = next;
            }
        }
        Ok(Some(low))
    }

    /// Where the contact is lost, the same root with more samples.
    fn in_contact_or_finer(
        &mut self,
        model: &Model<'_>,
        driver: usize,
        root: Balanced,
    ) -> Result<Balanced, ChatterError> {
        if root.depths[0] > 0.0 || self.balance.harmonics() == 1 {
            return Ok(root);
        }
        let harmonics = self.balance.harmonics();
        let fine = self
            .fine
            .get_or_insert_with(|| Balance::with_samples(harmonics, FINE_SAMPLES));
        Ok(newton(fine, model, driver, root.clone())?.unwrap_or(root))
    }

    fn cycle(&self, model: &Model<'_>, driver: usize, at: &Balanced) -> Cycle {
        Cycle {
            frequency_hz: at.omega() / std::f64::consts::TAU,
            harmonics_m: self.balance.deflections(model, driver, at),
            driver,
            extra_slope: at.extra_slope(),
            speed_m_min: at.speeds,
            depth_mm: at.depths,
            free_part: at.free,
        }
    }

    /// Harmonics that are kept.
    #[must_use]
    pub fn harmonics(&self) -> usize {
        self.balance.harmonics()
    }
}

/// Newton's method on `D(A)`, from a neighbour of the root.
fn newton(
    balance: &mut Balance,
    model: &Model<'_>,
    driver: usize,
    start: Balanced,
) -> Result<Option<Balanced>, ChatterError> {
    let mut at = start;
    for _ in 0..20 {
        let step = (-at.extra() / at.extra_slope()).clamp(-0.3 * at.amplitude, 0.3 * at.amplitude);
        let amplitude = at.amplitude + step;
        let Some(next) = balance.solve(model, driver, amplitude, predicted(&at, amplitude))? else {
            return Ok(None);
        };
        at = next;
        if step.abs() <= 1e-9 * at.amplitude {
            return Ok(Some(at));
        }
    }
    Ok(None)
}

/// The unknowns at another amplitude, along the tangent.
fn predicted(at: &Balanced, amplitude: f64) -> Vec<f64> {
    let step = amplitude - at.amplitude;
    let both = at.unknowns.iter().zip(&at.slopes);
    both.map(|(value, slope)| value + slope * step).collect()
}

fn valid(model: &Model<'_>, at: &Balanced) -> bool {
    at.speeds[0] > model.tool().floor_m_min && at.free <= MOST_FREE_PART
}

fn end_of(model: &Model<'_>, at: &Balanced) -> ScanEnd {
    if at.speeds[0] > model.tool().floor_m_min {
        ScanEnd::ContactLost
    } else {
        ScanEnd::SpeedFloor
    }
}

fn point(at: &Balanced) -> ScanPoint {
    ScanPoint {
        amplitude_m: at.amplitude,
        extra_per_s: at.extra(),
        frequency_hz: at.omega() / std::f64::consts::TAU,
    }
}

/// Where the cubic through two values and slopes has its extremum towards zero.
fn extremum(from: &Balanced, to: &Balanced) -> Option<f64> {
    let h = to.amplitude - from.amplitude;
    let (d0, d1) = (h * from.extra_slope(), h * to.extra_slope());
    let rise = to.extra() - from.extra();
    // Slope of the cubic: d0 + s (2 b + 3 c s), b and c by Hermite's conditions.
    let (b, c) = (3.0 * rise - 2.0 * d0 - d1, d0 + d1 - 2.0 * rise);
    let mut best = None;
    let root = b * b - 3.0 * c * d0;
    let candidates = if c.abs() < 1e-12 * (b.abs() + d0.abs()) {
        [-d0 / (2.0 * b), f64::NAN]
    } else {
        let root = libm::sqrt(root);
        [(-b + root) / (3.0 * c), (-b - root) / (3.0 * c)]
    };
    let value = |s: f64| from.extra() + s * (d0 + s * (b + c * s));
    for s in candidates {
        if s > 0.0 && s < 1.0 && best.is_none_or(|best: f64| value(s).abs() < value(best).abs()) {
            best = Some(s);
        }
    }
    // What is far from zero for the cubic is far for the branch.
    let limit = 0.3 * from.extra().abs().max(to.extra().abs());
    best.filter(|s| value(*s) * from.extra() <= 0.0 || value(*s).abs() < limit)
        .map(|s| from.amplitude + s * h)
}
