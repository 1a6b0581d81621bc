//! Assesses a cut: its cycles with their multipliers, the fate of disturbances, and the verdict.
//!
//! Three methods search for cycles, each of which finds some that the others may miss: harmonic balance along
//! the branches of this cut and of its neighbours in speed and depth; disturbances followed in time, which
//! find attractors; and bisection between a disturbance that dies out and one that does not, which finds the
//! cycle that separates them. A cycle counts if it closes in time; its Floquet multipliers decide its
//! stability. A cut is stable only if no cycle is known, no unconfirmed cycle was found, and a disturbance in
//! each direction, both ways, was followed until it died out.

use crate::cycle::Cycle;
use crate::error::ChatterError;
use crate::floquet::{Verified, report, shoot, verify};
use crate::model::{CuttingTool, Equilibrium, Model, State};
use crate::scan::{Branch, Prediction, Scanner};
use crate::transient::{Fate, TransientFollower};

/// Relative difference in amplitude from which a prediction has converged to another cycle: predictions with
/// five harmonics and loss of contact are off by 5e-3, with one harmonic by up to 0.1.
const LANDED_AMPLITUDE: f64 = 0.15;
/// ... or in frequency.
const LANDED_FREQUENCY: f64 = 3e-3;
/// Neighbours whose cycles are continued to a cut: factors on speed and depth.
const NEIGHBOURS: [[f64; 2]; 4] = [[1.005, 1.0], [0.995, 1.0], [1.0, 1.005], [1.0, 0.995]];
/// Numbers of harmonics with which a balance without a cycle is repeated: near the end of a branch, few
/// harmonics may not find it.
const FINER: [usize; 2] = [24, 48];
/// Size of a large disturbance, relative to the maximum that keeps the speed above the floor.
const LARGE: f64 = 0.9;
/// ... of a medium one, if the large one does not die out.
const MIDDLE: f64 = 0.4;
/// ... and of a small one, if the steady cut is unstable.
const SMALL: f64 = 0.02;
/// Size from which a disturbance that begins outside the model is halved instead of reduced to
/// [`LARGER_PART`]: the verdict for thin cuts needs its order of magnitude only.
const COARSE: f64 = 0.1;
const LARGER_PART: f64 = 0.85;
/// Size of the smallest disturbance that is tried. At a cutting speed of 300 m/min it moves a tool of 100 Hz
/// by 8 nm, less than any chip, and is 1e10 times the rounding errors of the motion.
const SMALLEST: f64 = 1e-6;

/// The prediction for a cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StabilityVerdict {
    /// Every disturbance within the model dies out.
    Stable,
    /// The cut is steady, but a disturbance beyond the unstable cycle grows to a lasting vibration.
    Bistable,
    /// The cut vibrates by itself.
    SelfExcited,
    /// Vibration leaves the model, by itself or after a disturbance: it is large, with an unknown amplitude.
    /// Also if the balance has a cycle that integration in time neither confirms nor replaces by another one,
    /// or if no disturbance could be followed in some direction.
    OutOfModel,
}

impl StabilityVerdict {
    /// Its name in reports.
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

/// The method that found a cycle first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FoundBy {
    /// On a branch of harmonic balance.
    Scan,
    /// From a cycle at a neighbouring speed or depth.
    Neighbour,
    /// By following a disturbance.
    Disturbance,
}

/// A cycle that closes in time.
#[derive(Clone, Debug, PartialEq)]
pub struct AssessedCycle {
    /// Its harmonics: from the balance, or from the motion in time.
    pub cycle: Cycle,
    /// The result of integration in time, with the multipliers.
    pub verified: Verified,
    /// How it was found.
    pub found_by: FoundBy,
}

/// Why a cycle of the balance is dropped.
#[derive(Clone, Debug, PartialEq)]
pub enum DropReason {
    /// Integration in time converges to another cycle, which counts by itself.
    Landed,
    /// It equals a known cycle.
    Duplicate,
    /// It does not close in time.
    Refused(ChatterError),
    /// In time it is outside the model.
    Outside,
    /// In time it returns to the steady cut.
    Rest,
}

/// A cycle of the balance that was dropped.
#[derive(Clone, Debug, PartialEq)]
pub struct DroppedCycle {
    /// The cycle by the balance.
    pub cycle: Cycle,
    /// Why.
    pub reason: DropReason,
}

/// A disturbance that was followed.
#[derive(Clone, Debug, PartialEq)]
pub struct Disturbance {
    /// Its initial state.
    pub start: State,
    /// Its size, m/s, by [`TransientFollower::size_m_s`].
    pub size_m_s: f64,
    /// Whether it shows the behaviour of the undisturbed cut.
    pub is_small: bool,
    /// Its fate.
    pub fate: Fate,
}

/// The complete result for a cut.
#[derive(Clone, Debug, PartialEq)]
pub struct Assessment {
    /// The steady cut.
    pub equilibrium: Equilibrium,
    /// The branches of harmonic balance.
    pub branches: Vec<Branch>,
    /// Cycles that close in time, without duplicates, in ascending order of size.
    pub cycles: Vec<AssessedCycle>,
    /// Cycles of the balance that were dropped.
    pub dropped: Vec<DroppedCycle>,
    /// Disturbances that were followed, and those that begin outside the model at any size.
    pub disturbances: Vec<Disturbance>,
    /// The verdict.
    pub verdict: StabilityVerdict,
}

impl Assessment {
    /// Whether a disturbance was found that leaves the model.
    #[must_use]
    pub fn can_leave(&self) -> bool {
        self.disturbances.iter().any(|kick| kick.fate == Fate::Leaves)
    }

    /// The stable cycle of the largest amplitude.
    #[must_use]
    pub fn largest_stable(&self) -> Option<&AssessedCycle> {
        self.cycles.iter().rev().find(|known| known.verified.stable())
    }

    /// Whether the balance has a cycle that is neither confirmed nor refuted. Newton's method misses a
    /// strongly unstable cycle if the harmonics are too inaccurate.
    #[must_use]
    pub fn is_in_doubt(&self) -> bool {
        // A cycle to which another one has converged is known if it counts.
        let settles = |reason: &DropReason| matches!(reason, DropReason::Duplicate | DropReason::Outside);
        let open = |dropped: &DroppedCycle| !settles(&dropped.reason);
        self.cycles.is_empty() && self.dropped.iter().any(open)
    }

    /// Whether in some direction even the smallest disturbance begins outside the model, so that none was
    /// followed.
    #[must_use]
    pub fn has_untested_direction(&self) -> bool {
        let fates = || self.disturbances.iter().map(|kick| &kick.fate);
        fates().any(|fate| *fate == Fate::BeginsOutside)
    }

    /// Adds a cycle, unless it is known already or is outside the model.
    fn add(
        &mut self,
        model: &Model<'_>,
        verified: Verified,
        cycle: Option<Cycle>,
        found_by: FoundBy,
    ) -> bool {
        // The steady cut closes after any time.
        let is_rest = size(&verified) < 1e-7 * model.tool().depth_mm;
        let is_new = !is_rest && !self.cycles.iter().any(|known| known.verified.is_same(&verified));
        if is_new && verified.within_model(model) {
            self.cycles.push(AssessedCycle {
                cycle: cycle.unwrap_or_else(|| verified.cycle()),
                verified,
                found_by,
            });
            return true;
        }
        false
    }
}

/// Assesses cuts; reuses its working memory.
#[derive(Clone, Debug)]
pub struct Assessor {
    scanner: Scanner,
    /// For the neighbours.
    near: Scanner,
}

impl Assessor {
    /// Creates an assessor with 1 to 64 harmonics in the balance; 5 give amplitudes to 1e-4.
    #[must_use]
    pub fn new(harmonics: usize) -> Self {
        Self {
            scanner: Scanner::new(harmonics),
            near: Scanner::for_maps(harmonics.min(5)),
        }
    }

    /// Assesses a cut. Costs 5 to 200 ms.
    ///
    /// # Errors
    /// No steady cut, or a motion outside the force law.
    pub fn assess(&mut self, model: &Model<'_>) -> Result<Assessment, ChatterError> {
        let prediction = self.scanner.scan(model)?;
        let mut assessment = verified(model, prediction);
        let mut open = disturb(model, &mut assessment);
        let unknown = assessment.branches.iter().any(|branch| !branch.end.is_known());
        if assessment.cycles.is_empty() || open.is_some() || unknown {
            self.continue_neighbours(model, &mut assessment);
        }
        if assessment.cycles.is_empty()
            && let Some(finer) = self.look_closer(model)?
        {
            assessment = finer;
            open = disturb(model, &mut assessment);
        }
        let unstable = assessment.cycles.iter().any(|known| !known.verified.stable());
        if let (Some(open), false) = (open, unstable) {
            let follower = TransientFollower::new(*model, &assessment.equilibrium);
            if let Some(found) = open.border(&follower) {
                assessment.add(model, found, None, FoundBy::Disturbance);
            }
        }
        assessment
            .cycles
            .sort_by(|a, b| size(&a.verified).total_cmp(&size(&b.verified)));
        assessment.verdict = verdict(&assessment);
        Ok(assessment)
    }

    /// Repeats the balance with more harmonics, until its cycles close in time or it has none.
    fn look_closer(&self, model: &Model<'_>) -> Result<Option<Assessment>, ChatterError> {
        let mut last = None;
        for harmonics in FINER {
            if harmonics <= self.scanner.harmonics() {
                continue;
            }
            let finer = verified(model, Scanner::new(harmonics).scan(model)?);
            let ends = !finer.is_in_doubt();
            last = Some(finer);
            if ends {
                break;
            }
        }
        Ok(last)
    }

    /// Fates of disturbances, up to the first that leaves the model: of the largest within it, or of small
    /// ones if the steady cut is unstable, and of the given motions. A motion that reaches one of the given
    /// stable cycles is followed no further.
    pub(crate) fn disturbances(
        &self,
        model: &Model<'_>,
        rest: &Equilibrium,
        stable: &[Verified],
        motions: &[State],
    ) -> Vec<Fate> {
        let mut follower = TransientFollower::new(*model, rest).hasty();
        for cycle in stable {
            follower.add_stable_cycle(cycle);
        }
        let first = if rest.growth_per_s() > 0.0 { SMALL } else { LARGE };
        let mut fates: Vec<Fate> = Vec::new();
        let mut directions = directions(model, &follower);
        let impulses = directions.len();
        directions.extend(motions.iter().map(|state| state - follower.rest()));
        let opposite = follower.clone().hastier();
        for (k, direction) in directions.into_iter().enumerate() {
            // The opposite of the impulse before it.
            let is_second = k < impulses && k % 2 == 1 && fates.last() == Some(&Fate::DiesOut);
            let follower = if is_second { &opposite } else { &follower };
            let (_, fate) = fate_within(follower, follower.rest(), direction, first);
            let ends = fate == Fate::Leaves;
            fates.push(fate);
            if ends {
                break;
            }
        }
        fates
    }

    /// Continues the cycles of neighbouring cuts to this one.
    fn continue_neighbours(&mut self, model: &Model<'_>, assessment: &mut Assessment) {
        for [speed, depth] in NEIGHBOURS {
            let tool = CuttingTool {
                speed_m_min: speed * model.tool().speed_m_min,
                depth_mm: depth * model.tool().depth_mm,
                ..*model.tool()
            };
            // A neighbour that cannot be computed contributes nothing.
            let Ok(near) = model.with_tool(tool) else { continue };
            let Ok(prediction) = self.near.scan(&near) else {
                continue;
            };
            for cycle in prediction.cycles() {
                let size = cycle.amplitude_m(0).max(cycle.amplitude_m(1));
                let known = assessment.cycles.iter().any(|known| {
                    let other = &known.verified;
                    (cycle.frequency_hz / other.frequency_hz - 1.0).abs() < LANDED_FREQUENCY
                        && (0..2).all(|i| (cycle.amplitude_m(i) - other.amplitude_m[i]).abs() < 0.05 * size)
                });
                if known {
                    continue;
                }
                let closed = shoot(model, cycle.state(0.0), 1.0 / cycle.frequency_hz, size, 1e-8);
                if let Ok(Some(closed)) = closed
                    && let Ok(verified) = report(model, &closed)
                {
                    assessment.add(model, verified, None, FoundBy::Neighbour);
                }
            }
        }
    }
}

fn size(verified: &Verified) -> f64 {
    verified.amplitude_m[0].max(verified.amplitude_m[1])
}

/// The cycles of a scan that close in time.
fn verified(model: &Model<'_>, prediction: Prediction) -> Assessment {
    let mut assessment = Assessment {
        equilibrium: prediction.equilibrium,
        branches: Vec::new(),
        cycles: Vec::new(),
        dropped: Vec::new(),
        disturbances: Vec::new(),
        verdict: StabilityVerdict::OutOfModel,
    };
    for cycle in prediction.branches.iter().flat_map(|branch| &branch.cycles) {
        let reason = match verify(model, cycle, 1e-8) {
            Err(error) => DropReason::Refused(error),
            Ok(verified) => {
                let is_rest = size(&verified) < 1e-3 * cycle.amplitude_m(cycle.driver);
                let landed = verified.amplitude_error.abs() > LANDED_AMPLITUDE
                    || verified.frequency_error.abs() > LANDED_FREQUENCY;
                let within = verified.within_model(model);
                let kept = (!landed).then(|| cycle.clone());
                let added = assessment.add(model, verified, kept, FoundBy::Scan);
                match (landed, within, added) {
                    _ if is_rest => DropReason::Rest,
                    (true, ..) => DropReason::Landed,
                    (_, false, _) => DropReason::Outside,
                    (_, _, false) => DropReason::Duplicate,
                    _ => continue,
                }
            }
        };
        assessment.dropped.push(DroppedCycle {
            cycle: cycle.clone(),
            reason,
        });
    }
    assessment.branches = prediction.branches;
    assessment
}

/// Follows disturbances in time and adds the cycles at which they settle. Returns two disturbances in one
/// direction with different fates, if the motion between them is unknown.
fn disturb(model: &Model<'_>, assessment: &mut Assessment) -> Option<Between> {
    let mut open = None;
    let mut follower = TransientFollower::new(*model, &assessment.equilibrium);
    for known in assessment.cycles.iter().filter(|known| known.verified.stable()) {
        follower.add_stable_cycle(&known.verified);
    }
    let rest = follower.rest();
    let grows = assessment.equilibrium.growth_per_s() > 0.0;
    let mut directions = directions(model, &follower);
    // The last motion of a branch is likely to be near an attractor.
    for branch in &assessment.branches {
        directions.extend(branch.largest.map(|state| state - rest));
    }
    // Where small vibrations grow, a small disturbance shows the behaviour of the undisturbed cut, a large
    // one the effect of an impulse.
    let sizes = if grows { [SMALL, LARGE] } else { [LARGE, MIDDLE] };
    for direction in directions {
        let (mut dies, mut stays): (Option<f64>, Option<f64>) = (None, None);
        let mut before = f64::INFINITY;
        for first in sizes {
            // Well below a large one that had to be reduced.
            let next = if grows { first } else { first.min(0.5 * before) };
            let (part, fate) = fate_within(&follower, rest, direction, next);
            before = part;
            match fate {
                Fate::BeginsOutside => {}
                Fate::DiesOut => dies = Some(dies.map_or(part, |before| before.max(part))),
                _ => stays = Some(stays.map_or(part, |before| before.min(part))),
            }
            if let Fate::Settles(found) = &fate
                && assessment.add(model, (**found).clone(), None, FoundBy::Disturbance)
            {
                follower.add_stable_cycle(found);
            }
            let start = rest + direction * part;
            let ended = !grows && matches!(fate, Fate::DiesOut | Fate::BeginsOutside);
            assessment.disturbances.push(Disturbance {
                start,
                size_m_s: follower.size_m_s(&start),
                is_small: first <= SMALL,
                fate,
            });
            // Smaller disturbances in this direction die out, or begin outside, as well.
            if ended {
                break;
            }
        }
        let unstable = assessment.cycles.iter().any(|known| !known.verified.stable());
        if let (false, Some(stays), false) = (grows, stays, unstable) {
            open = Some(Between {
                direction,
                dies: dies.unwrap_or(SMALL.min(0.1 * stays)),
                stays,
            });
        }
    }
    open
}

/// The fate of a disturbance that is a fraction of a direction, or of the largest smaller one that begins
/// within the model; [`Fate::BeginsOutside`] if the smallest does not.
fn fate_within(follower: &TransientFollower<'_>, rest: State, direction: State, first: f64) -> (f64, Fate) {
    let mut part = first;
    loop {
        match follower.fate(rest + direction * part) {
            Fate::BeginsOutside if part > COARSE => part *= LARGER_PART,
            Fate::BeginsOutside if part > SMALLEST => part *= 0.5,
            // It has grown there.
            Fate::BeginsOutside if !follower.is_steady() => return (part, Fate::Leaves),
            fate => return (part, fate),
        }
    }
}

/// Disturbances that just keep the speed above the floor: impulses along both principal axes, along the
/// cutting speed, and across it, each both ways, because the force law is asymmetric.
fn directions(model: &Model<'_>, follower: &TransientFollower<'_>) -> Vec<State> {
    let (cos, sin) = model.machine_axes(1.0, 0.0);
    let along = |v1: f64, v2: f64| {
        let (_, z) = model.machine_axes(v1, v2);
        // An impulse across the cutting speed turns into motion along it, but never completely.
        let by = follower.reach_m_s() / z.abs().max(0.3);
        State::new(0.0, 0.0, by * v1, by * v2)
    };
    let axes = [
        along(1.0, 0.0),
        along(0.0, 1.0),
        along(sin, cos),
        along(cos, -sin),
    ];
    axes.into_iter().flat_map(|axis| [axis, -axis]).collect()
}

/// A disturbance that dies out and a larger one that does not, as fractions of a direction.
struct Between {
    direction: State,
    dies: f64,
    stays: f64,
}

impl Between {
    /// The unstable cycle between the two, by bisection: close to the border the motion lingers near the
    /// cycle before it departs.
    fn border(&self, follower: &TransientFollower<'_>) -> Option<Verified> {
        let (mut low, mut high) = (self.dies, self.stays);
        let mut calmest = None;
        for _ in 0..12 {
            let middle = 0.5 * (low + high);
            let (fate, lingering) = follower.follow(follower.rest() + self.direction * middle);
            calmest = lingering.or(calmest);
            match fate {
                Fate::DiesOut => low = middle,
                _ => high = middle,
            }
        }
        follower.cycle_near(&calmest?.state)
    }
}

fn verdict(assessment: &Assessment) -> StabilityVerdict {
    let grows = assessment.equilibrium.growth_per_s() > 0.0;
    let stable_cycle = assessment.cycles.iter().any(|known| known.verified.stable());
    let fates = || assessment.disturbances.iter().map(|kick| &kick.fate);
    let lasts = stable_cycle || fates().any(|fate| matches!(fate, Fate::Settles(_) | Fate::GoesOn));
    if !grows {
        // An unstable cycle is the border to a motion that does not die out.
        let all_die = fates().next().is_some()
            && fates().all(|fate| *fate == Fate::DiesOut)
            && assessment.cycles.is_empty();
        return match (lasts, all_die && !assessment.is_in_doubt()) {
            (true, _) => StabilityVerdict::Bistable,
            (false, true) => StabilityVerdict::Stable,
            (false, false) => StabilityVerdict::OutOfModel,
        };
    }
    // The behaviour of the undisturbed cut.
    let small = || {
        assessment
            .disturbances
            .iter()
            .filter(|kick| kick.is_small)
            .map(|kick| &kick.fate)
    };
    if !lasts || small().any(|fate| *fate == Fate::Leaves) {
        StabilityVerdict::OutOfModel
    } else {
        StabilityVerdict::SelfExcited
    }
}
