//! The scan: follows motions that an extra damping makes periodic, from each mode of small vibration.
//!
//! The branch that begins at a mode is a curve of motions of amplitude `A` and extra damping `D`. It is
//! followed by its arc length (H. B. Keller's continuation), because near a coupling of two modes it turns
//! back in `A`. It ends at the limit of the model or at rest. A point with `D = 0` is a cycle. The branch
//! cannot return to rest by mistake, brackets every root, and finds a large cycle beside a steady cut that is
//! stable against small disturbances. The scan does not decide whether a cycle is stable: see
//! [`crate::verify`] for its multipliers.

use crate::balance::{Balance, Balanced, Condition};
use crate::cycle::Cycle;
use crate::error::ChatterError;
use crate::model::{Equilibrium, Model, SmallMode, State};

/// Fraction of a period out of contact above which the model is invalid: the tool hammers.
pub const MAX_FREE_PART: f64 = 0.5;
/// Steps of the scan up to the amplitude at which the linear motion reaches the limit of the model.
const STEPS: f64 = 24.0;
/// Samples per period with loss of contact: the force over time has a corner, which needs close samples.
const FINE_SAMPLES: usize = 512;
/// Maximum number of steps of a scan.
const MAX_STEPS: usize = 400;
/// Distance from the previous point, in steps, above which a point is on another part of the branch, or on
/// another branch.
const LEAP: f64 = 1.5;
/// Change of frequency and extra damping, relative to the frequency, that has the weight of the whole
/// amplitude or force along a branch. Tuned: from 0.01 to 0.2 the same cycles are found, with the fewest
/// steps at 0.05.
const SPEED_PART: f64 = 0.05;

/// Harmonics of the balance beyond the end of a branch.
const END_HARMONICS: usize = 24;
/// Extra damping at the end of a branch, relative to the largest along it, from which no cycle is near: in a
/// balance of few harmonics ...
const FEW_DAMPED: f64 = 0.5;
/// ... and of many.
const MANY_DAMPED: f64 = 0.3;
/// Maximum relative difference of the damping of a motion with few and with many harmonics.
const OTHER_DAMPED: f64 = 0.5;

/// The end of the scan of a branch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ScanEnd {
    /// The cutting speed falls to the floor below which the force law is not trusted.
    SpeedFloor,
    /// The tool is out of contact for more than half of the period.
    ContactLost,
    /// The branch returns to rest, at another mode.
    Rest,
    /// The balance was not found any more: the continuation is unknown.
    NotFound,
    /// The branch is longer than 400 steps: the continuation is unknown.
    TooLong,
    /// The mode does not oscillate, so no branch begins at it.
    NoBranch,
}

impl ScanEnd {
    /// Whether the branch was followed to the limit of the model, or to rest.
    #[must_use]
    pub fn is_known(self) -> bool {
        !matches!(self, Self::NotFound | Self::TooLong)
    }
}

/// One point of a branch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScanPoint {
    /// Amplitude of the driving coordinate, m.
    pub amplitude_m: f64,
    /// Extra damping that makes the motion periodic, 1/s.
    pub extra_per_s: f64,
    /// Frequency, Hz.
    pub frequency_hz: f64,
}

/// The branch that begins at a mode of small vibration.
#[derive(Clone, Debug, PartialEq)]
pub struct Branch {
    /// The mode at its start.
    pub mode: SmallMode,
    /// The coordinate whose amplitude was scanned (0 for V1, 1 for V2).
    pub driver: usize,
    /// The computed points.
    pub points: Vec<ScanPoint>,
    /// Cycles in their order along the branch.
    pub cycles: Vec<Cycle>,
    /// Reason of the end.
    pub end: ScanEnd,
    /// A state of the last motion on it.
    pub largest: Option<State>,
    /// The last motion on it, from the balance.
    last: Option<Balanced>,
}

impl Branch {
    /// Whether little extra damping would balance the last motion: a cycle may be near, beyond the end.
    pub(crate) fn ends_near_a_cycle(&self) -> bool {
        let last = self
            .points
            .last()
            .map_or(f64::NEG_INFINITY, |last| last.extra_per_s);
        self.end != ScanEnd::Rest && -last <= FEW_DAMPED * self.largest_extra_per_s()
    }

    fn largest_extra_per_s(&self) -> f64 {
        let sizes = self.points.iter().map(|point| point.extra_per_s.abs());
        sizes.fold(0.0, f64::max)
    }
}

/// Results of a scan.
#[derive(Clone, Debug, PartialEq)]
pub struct Prediction {
    /// The steady cut.
    pub equilibrium: Equilibrium,
    /// A branch for each mode.
    pub branches: Vec<Branch>,
}

impl Prediction {
    /// All cycles, branch by branch.
    pub fn cycles(&self) -> impl Iterator<Item = &Cycle> {
        self.branches.iter().flat_map(|branch| &branch.cycles)
    }
}

/// A scan with a number of harmonics; reuses its working memory.
#[derive(Clone, Debug)]
pub struct Scanner {
    balance: Balance,
    /// For cycles out of contact.
    fine: Option<Balance>,
    steps: f64,
    halvings: usize,
}

/// State of following a branch.
struct Walk {
    driver: usize,
    /// Scale of each unknown, for lengths along the branch.
    scale: Vec<f64>,
}

impl Scanner {
    /// Creates a scanner for 1 to 64 harmonics; 5 give amplitudes to 1e-4.
    #[must_use]
    pub fn new(harmonics: usize) -> Self {
        Self::with_balance(Balance::new(harmonics))
    }

    fn with_balance(balance: Balance) -> Self {
        Self {
            balance,
            fine: None,
            steps: STEPS,
            halvings: 10,
        }
    }

    /// A quick scan for maps: one harmonic, and fewer steps. It brackets cycles for [`Scanner::refine`].
    #[must_use]
    pub fn coarse() -> Self {
        Self {
            steps: 6.0,
            halvings: 3,
            ..Self::with_balance(Balance::with_samples(1, 16).until(1e-3))
        }
    }

    /// For maps if one harmonic is unreliable.
    pub(crate) fn medium() -> Self {
        Self {
            steps: 8.0,
            halvings: 6,
            ..Self::with_balance(Balance::with_samples(3, 24).until(1e-4))
        }
    }

    /// For the ends of branches in maps, where few harmonics may miss a cycle.
    pub(crate) fn for_ends() -> Self {
        Self {
            balance: Balance::new(END_HARMONICS).until(1e-5),
            halvings: 6,
            ..Self::new(1)
        }
    }

    /// For maps: the samples and steps for amplitudes to 1e-4.
    pub(crate) fn for_maps(harmonics: usize) -> Self {
        Self {
            balance: Balance::with_samples(harmonics, (9 * harmonics).max(16)).until(1e-5),
            steps: 14.0,
            halvings: 6,
            ..Self::new(harmonics)
        }
    }

    /// Every cycle of a model, on the branches of all its modes.
    ///
    /// # Errors
    /// No steady cut, or a motion outside the force law.
    pub fn scan(&mut self, model: &Model<'_>) -> Result<Prediction, ChatterError> {
        let equilibrium = model.equilibrium()?;
        let mut branches = Vec::with_capacity(2);
        for mode in &equilibrium.modes {
            branches.push(self.branch(model, &equilibrium, mode)?);
        }
        Ok(Prediction {
            equilibrium,
            branches,
        })
    }

    /// The cycle near a given one, with this scanner's number of harmonics; `None` if there is none.
    ///
    /// # Errors
    /// The motion is outside the force law.
    pub fn refine(&mut self, model: &Model<'_>, cycle: &Cycle) -> Result<Option<Cycle>, ChatterError> {
        let rest = model.equilibrium()?;
        let omega = std::f64::consts::TAU * cycle.frequency_hz;
        let amplitude = cycle.amplitude_m(cycle.driver);
        let start = self
            .balance
            .start(model, cycle.driver, &rest, [omega, 0.0, amplitude]);
        let Some(root) = self
            .balance
            .solve(model, cycle.driver, start, Condition::Extra(0.0))?
        else {
            return Ok(None);
        };
        if !valid(model, &root) {
            return Ok(None);
        }
        let root = self.in_contact_or_finer(model, cycle.driver, root)?;
        Ok(Some(self.cycle(model, cycle.driver, &root)))
    }

    /// Amplitudes of the driver at which the speed would reach the floor and contact would be lost if the
    /// motion stayed linear.
    fn reach(&self, model: &Model<'_>, driver: usize, tiny: &Balanced) -> (f64, f64) {
        let [v1, v2] = self.balance.deflections(model, driver, tiny);
        let (c, s) = model.machine_axes(1.0, 0.0);
        let (a, b) = (v1[1], v2[1]);
        let (y, z) = ((a * c - b * s).norm(), (a * s + b * c).norm());
        let tool = model.tool();
        let floor = (tool.speed_m_min - tool.floor_m_min) / (60.0 * tiny.omega() * z) * tiny.amplitude();
        let contact = tiny.depths[1] / (1000.0 * y) * tiny.amplitude();
        (floor, contact)
    }

    /// The coordinate with the largest motion in a mode, and the motion at a tiny amplitude.
    fn begin(
        &mut self,
        model: &Model<'_>,
        rest: &Equilibrium,
        mode: &SmallMode,
    ) -> Result<Option<(usize, Balanced)>, ChatterError> {
        let Some((omega, extra)) = model.balanced_mode(rest, mode)? else {
            return Ok(None);
        };
        let amplitude = 1e-8 * model.tool().depth_mm;
        let mut best: Option<(usize, Balanced, f64)> = None;
        for driver in [1, 0] {
            if !model.has_radial_law() && model.direction()[driver].abs() < 1e-9 {
                continue;
            }
            let start = self.balance.start(model, driver, rest, [omega, extra, amplitude]);
            let tiny = self
                .balance
                .solve(model, driver, start, Condition::Amplitude(amplitude))?;
            let Some(tiny) = tiny else { continue };
            let [v1, v2] = self.balance.deflections(model, driver, &tiny);
            let fraction = [v1[1].norm(), v2[1].norm()][driver] / v1[1].norm().max(v2[1].norm());
            if best.as_ref().is_none_or(|best| fraction > best.2) {
                best = Some((driver, tiny, fraction));
            }
            if fraction >= 1.0 {
                break;
            }
        }
        Ok(best.map(|(driver, tiny, _)| (driver, tiny)))
    }

    pub(crate) fn branch(
        &mut self,
        model: &Model<'_>,
        rest: &Equilibrium,
        mode: &SmallMode,
    ) -> Result<Branch, ChatterError> {
        let mut branch = Branch {
            mode: *mode,
            driver: 1,
            points: Vec::new(),
            cycles: Vec::new(),
            end: ScanEnd::NoBranch,
            largest: None,
            last: None,
        };
        if mode.frequency_hz <= 0.0 {
            return Ok(branch);
        }
        let Some((driver, mut tiny)) = self.begin(model, rest, mode)? else {
            branch.end = ScanEnd::NotFound;
            return Ok(branch);
        };
        branch.driver = driver;
        let (floor, contact) = self.reach(model, driver, &tiny);
        let walk = Walk::new(rest, driver, &tiny, floor.min(contact));
        walk.orient(&mut tiny, None);
        branch.points.push(point(&tiny));
        let last = self.follow(model, &walk, tiny, &mut branch)?;
        branch.largest = Some(self.cycle(model, driver, &last).state(0.0));
        branch.last = Some(last);
        Ok(branch)
    }

    /// Whether a branch without cycles that was found with fewer harmonics may have one beyond its end: with
    /// the harmonics of this scanner the continued branch has a cycle, or cannot be followed.
    ///
    /// # Errors
    /// The motion is outside the force law.
    pub(crate) fn may_meet_a_cycle_beyond(
        &mut self,
        model: &Model<'_>,
        rest: &Equilibrium,
        branch: &Branch,
    ) -> Result<bool, ChatterError> {
        let (Some(end), true) = (&branch.last, branch.ends_near_a_cycle()) else {
            return Ok(false);
        };
        let damped = |at: &Balanced| -at.extra() / branch.largest_extra_per_s();
        let (driver, amplitude) = (branch.driver, end.amplitude());
        let mut unknowns = self.balance.widened(model, &end.unknowns);
        let mut start = None;
        // If the model ends earlier with more harmonics, starts from a smaller motion.
        for part in [1.0, 0.9, 0.75, 0.5] {
            let condition = Condition::Amplitude(part * amplitude);
            let Some(found) = self.balance.solve(model, driver, unknowns, condition)? else {
                break;
            };
            if valid(model, &found) {
                start = Some(found);
                break;
            }
            unknowns = found.unknowns;
        }
        let Some(mut start) = start else { return Ok(true) };
        // A different motion.
        if (damped(&start) - damped(end)).abs() > OTHER_DAMPED {
            return Ok(true);
        }
        if damped(&start) > MANY_DAMPED {
            return Ok(false);
        }
        if start.extra() >= 0.0 {
            return Ok(true);
        }
        let walk = Walk::new(rest, driver, &start, amplitude);
        walk.orient(&mut start, None);
        if end.tangent_amplitude() < 0.0 {
            start.tangent.iter_mut().for_each(|part| *part = -*part);
        }
        let mut beyond = Branch {
            points: vec![branch.points[0]],
            cycles: Vec::new(),
            ..branch.clone()
        };
        self.follow(model, &walk, start, &mut beyond)?;
        Ok(!beyond.cycles.is_empty() || !beyond.end.is_known())
    }

    /// Follows a branch from a motion on it to its end; returns the last motion.
    fn follow(
        &mut self,
        model: &Model<'_>,
        walk: &Walk,
        from: Balanced,
        branch: &mut Branch,
    ) -> Result<Balanced, ChatterError> {
        let min = branch.points[0].amplitude_m;
        let mut here = from;
        let longest = 1.0 / self.steps;
        let mut step = longest;
        let mut shortened = 0;
        branch.end = ScanEnd::TooLong;
        let mut end = ScanEnd::NotFound;
        for _ in 0..MAX_STEPS {
            let next = self.along(model, walk, &here, step)?;
            let next = match next {
                Some(next)
                    if valid(model, &next)
                        && walk.is_near(&here, &next)
                        && walk.distance(&here, &next) <= LEAP * step =>
                {
                    next
                }
                outcome => {
                    // The end is within this step, or the branch bends: approach it.
                    end = match &outcome {
                        Some(beyond) if !valid(model, beyond) => end_of(model, beyond),
                        _ if here.tangent_amplitude() < 0.0 && here.amplitude() < step * walk.size() => {
                            ScanEnd::Rest
                        }
                        _ => ScanEnd::NotFound,
                    };
                    shortened += 1;
                    if shortened > self.halvings || end == ScanEnd::Rest {
                        branch.end = end;
                        break;
                    }
                    step *= 0.5;
                    continue;
                }
            };
            self.roots(model, walk, &here, &next, &mut branch.cycles, 0)?;
            branch.points.push(point(&next));
            if next.amplitude() <= min {
                branch.end = ScanEnd::Rest;
                break;
            }
            // Once the model has ended, the remaining distance is short.
            let leaves = matches!(end, ScanEnd::SpeedFloor | ScanEnd::ContactLost);
            if !leaves {
                (shortened, end) = (0, ScanEnd::NotFound);
                let factor = if next.steps <= 3 { 1.5 } else { 1.0 };
                // Far beyond the linear reach, steps are proportional to the amplitude.
                let far = (next.amplitude() / walk.size()).max(1.0);
                step = (factor * step).min(longest * far);
            }
            here = next;
        }
        Ok(here)
    }

    /// The motion one step along the tangent.
    fn along(
        &mut self,
        model: &Model<'_>,
        walk: &Walk,
        from: &Balanced,
        step: f64,
    ) -> Result<Option<Balanced>, ChatterError> {
        let guess: Vec<f64> = from
            .unknowns
            .iter()
            .zip(&from.tangent)
            .map(|(value, tangent)| value + step * tangent)
            .collect();
        let weights: Vec<f64> = from
            .tangent
            .iter()
            .zip(&walk.scale)
            .map(|(tangent, scale)| tangent / (scale * scale))
            .collect();
        let value: f64 = weights.iter().zip(&guess).map(|(w, x)| w * x).sum();
        let next = self
            .balance
            .solve(model, walk.driver, guess, Condition::Along(&weights, value))?;
        Ok(next.map(|mut next| {
            walk.orient(&mut next, Some(from));
            next
        }))
    }

    /// Cycles between two neighbours on a branch.
    fn roots(
        &mut self,
        model: &Model<'_>,
        walk: &Walk,
        from: &Balanced,
        to: &Balanced,
        cycles: &mut Vec<Cycle>,
        depth: usize,
    ) -> Result<(), ChatterError> {
        let length = walk.distance(from, to);
        if (from.extra() > 0.0) != (to.extra() > 0.0) {
            if let Some(root) = self.root(model, walk, from, to, length)? {
                let root = self.in_contact_or_finer(model, walk.driver, root)?;
                cycles.push(self.cycle(model, walk.driver, &root));
            }
            return Ok(());
        }
        // Two roots may be between points on the same side: examine the extremum of the cubic through both.
        let towards_zero = from.extra() * from.tangent[2] < 0.0 && to.extra() * to.tangent[2] > 0.0;
        if depth < 4
            && towards_zero
            && let Some(part) = extremum(from, to, length)
            && let Some(between) = self.along(model, walk, from, part * length)?
        {
            self.roots(model, walk, from, &between, cycles, depth + 1)?;
            self.roots(model, walk, &between, to, cycles, depth + 1)?;
        }
        Ok(())
    }

    /// The root of `D` between two points where its sign differs.
    fn root(
        &mut self,
        model: &Model<'_>,
        walk: &Walk,
        from: &Balanced,
        to: &Balanced,
        length: f64,
    ) -> Result<Option<Balanced>, ChatterError> {
        let (mut low, mut high, mut length) = (from.clone(), to.clone(), length);
        for _ in 0..40 {
            let part = low.extra() / (low.extra() - high.extra());
            let guess: Vec<f64> = (low.unknowns.iter().zip(&high.unknowns))
                .map(|(low, high)| low + part * (high - low))
                .collect();
            let root = self
                .balance
                .solve(model, walk.driver, guess, Condition::Extra(0.0))?;
            // Newton's method may jump to another part of the branch, or to the neighbour of two close roots:
            // there the slope of the extra damping has the opposite sign.
            if let Some(mut root) = root
                && walk.distance(&low, &root) <= 1.2 * length
                && walk.distance(&high, &root) <= 1.2 * length
            {
                walk.orient(&mut root, Some(&low));
                if (root.tangent[2] > 0.0) == (high.extra() > low.extra()) {
                    return Ok(valid(model, &root).then_some(root));
                }
            }
            let Some(between) = self.along(model, walk, &low, 0.5 * length)? else {
                return Ok(None);
            };
            if (between.extra() > 0.0) == (low.extra() > 0.0) {
                low = between;
            } else {
                high = between;
            }
            length = walk.distance(&low, &high);
        }
        Ok(None)
    }

    /// With loss of contact, the same root with more samples.
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
        let finer = fine.solve(model, driver, root.unknowns.clone(), Condition::Extra(0.0))?;
        Ok(finer.unwrap_or(root))
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

    /// Number of harmonics.
    #[must_use]
    pub fn harmonics(&self) -> usize {
        self.balance.harmonics()
    }
}

impl Walk {
    /// Starts on the branch through a motion, with the amplitude `size` as unit.
    fn new(rest: &Equilibrium, driver: usize, at: &Balanced, size: f64) -> Self {
        let mut scale = vec![rest.force_n; at.unknowns.len()];
        (scale[1], scale[2]) = (SPEED_PART * at.omega(), SPEED_PART * at.omega());
        if let Some(last) = scale.last_mut() {
            *last = size;
        }
        Self { driver, scale }
    }

    /// The amplitude that serves as unit.
    fn size(&self) -> f64 {
        self.scale.last().copied().unwrap_or(f64::NAN)
    }

    /// Normalizes the tangent so that it continues from the last point, or points to larger amplitudes at the
    /// first.
    fn orient(&self, at: &mut Balanced, from: Option<&Balanced>) {
        let dot = |a: &[f64], b: &[f64]| -> f64 {
            let all = a.iter().zip(b).zip(&self.scale);
            all.map(|((a, b), scale)| a * b / (scale * scale)).sum()
        };
        let length = libm::sqrt(dot(&at.tangent, &at.tangent));
        let ahead = match from {
            Some(from) => dot(&at.tangent, &from.tangent),
            None => at.tangent_amplitude(),
        };
        let factor = if ahead < 0.0 { -1.0 / length } else { 1.0 / length };
        for tangent in &mut at.tangent {
            *tangent *= factor;
        }
    }

    fn distance(&self, a: &Balanced, b: &Balanced) -> f64 {
        let all = a.unknowns.iter().zip(&b.unknowns).zip(&self.scale);
        libm::sqrt(
            all.map(|((a, b), scale)| ((a - b) / scale) * ((a - b) / scale))
                .sum(),
        )
    }

    /// Whether the branch bends little enough between two points that they are on the same part.
    fn is_near(&self, from: &Balanced, to: &Balanced) -> bool {
        let all = from.tangent.iter().zip(&to.tangent).zip(&self.scale);
        let cosine: f64 = all.map(|((a, b), scale)| a * b / (scale * scale)).sum();
        cosine > 0.9
    }
}

fn valid(model: &Model<'_>, at: &Balanced) -> bool {
    at.speeds[0] > model.tool().floor_m_min && at.free <= MAX_FREE_PART
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
        amplitude_m: at.amplitude(),
        extra_per_s: at.extra(),
        frequency_hz: at.omega() / std::f64::consts::TAU,
    }
}

/// Position of the extremum towards zero of the cubic through two values and slopes of `D`, as a fraction of
/// the length.
fn extremum(from: &Balanced, to: &Balanced, length: f64) -> Option<f64> {
    let (d0, d1) = (length * from.tangent[2], length * to.tangent[2]);
    let rise = to.extra() - from.extra();
    // Slope of the cubic: d0 + s (2 b + 3 c s), b and c by Hermite's conditions.
    let (b, c) = (3.0 * rise - 2.0 * d0 - d1, d0 + d1 - 2.0 * rise);
    let mut best = None;
    let candidates = if c.abs() < 1e-12 * (b.abs() + d0.abs()) {
        [-d0 / (2.0 * b), f64::NAN]
    } else {
        let root = libm::sqrt(b * b - 3.0 * c * d0);
        [(-b + root) / (3.0 * c), (-b - root) / (3.0 * c)]
    };
    let value = |s: f64| from.extra() + s * (d0 + s * (b + c * s));
    for s in candidates {
        if s > 0.0 && s < 1.0 && best.is_none_or(|best: f64| value(s).abs() < value(best).abs()) {
            best = Some(s);
        }
    }
    // Far from zero for the cubic is far from zero for the branch.
    let limit = 0.3 * from.extra().abs().max(to.extra().abs());
    best.filter(|s| value(*s) * from.extra() <= 0.0 || value(*s).abs() < limit)
}
