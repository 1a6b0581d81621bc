//! Maps over speed and depth: whether a cut is stable, bistable, self-excited, or leaves the model.
//!
//! A cell has the verdict of a whole [`Assessor`], at less cost where possible: cycles are bracketed with one
//! harmonic, refined with all, and their multipliers are taken from one period; without a cycle, disturbances
//! are followed. If these results contradict each other, the cell is assessed like a single cut. A
//! [`Mapper::tile`] is divided until the corners and the middle of each part agree; between them only growth
//! and amplitude are computed.

use nalgebra::Complex;

use crate::assess::{Assessment, Assessor, StabilityVerdict};
use crate::cycle::Cycle;
use crate::error::ChatterError;
use crate::floquet::{quick_multipliers, verify};
use crate::model::{CuttingTool, Equilibrium, Laws, Model, SmallMode, State};
use crate::scan::{Branch, ScanPoint, Scanner};
use crate::transient::Fate;

/// Error bounds of a balance of few harmonics. Tuned on the cells of ten maps, so that no cell differs from
/// the result of all harmonics.
#[derive(Clone, Copy, Debug)]
struct Trust {
    /// Extra damping below which two roots may be missed, 1/s ...
    near_fold_per_s: f64,
    /// ... and as a fraction of the largest on the branch.
    near_fold_part: f64,
    /// A minimum of the extra damping along a branch below this fraction of the largest may touch zero.
    grazing_part: f64,
    /// Distance beyond the end of a branch, as a fraction of the amplitude there, at which a root may still
    /// be within the model.
    near_end_part: f64,
}

/// For one harmonic.
const ONE_HARMONIC: Trust = Trust {
    near_fold_per_s: 0.5,
    near_fold_part: 0.02,
    grazing_part: 0.06,
    near_end_part: 0.15,
};
/// For three harmonics.
const THREE_HARMONICS: Trust = Trust {
    near_fold_per_s: 0.2,
    near_fold_part: 0.005,
    grazing_part: 0.02,
    near_end_part: 0.03,
};
/// Error of multipliers from a cycle with five harmonics.
const MULTIPLIER_ERROR: f64 = 2e-3;
/// ... and with loss of contact.
const FREE_MULTIPLIER_ERROR: f64 = 2e-2;
/// Maximum relative difference of the amplitudes of one harmonic and of all for the same cycle.
const REFINED_PART: f64 = 0.3;
/// Maximum size of a part of a map that counts as uniform, in cells per side.
const LARGEST_PART: usize = 7;

/// One cell of a map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapCell {
    /// Cutting speed, m/min.
    pub speed_m_min: f64,
    /// Depth of cut, mm.
    pub depth_mm: f64,
    /// The verdict; `None` if there is no steady cut or no force.
    pub verdict: Option<StabilityVerdict>,
    /// Growth of the fastest growing small vibration, 1/s.
    pub growth_per_s: f64,
    /// Amplitude of the larger coordinate on the largest stable cycle, m; 0 if there is none, or if the cut
    /// leaves the model.
    pub amplitude_m: f64,
    /// Its frequency, Hz; 0 if there is none.
    pub frequency_hz: f64,
}

/// Computes cells of a map; reuses its working memory. Use one per thread.
///
/// ```
/// # use evolvent_chatter::{CuttingTool, Mapper, PrincipalAxis, StabilityVerdict};
/// # use evolvent_cutting::{LawDefinition, ToolAngles};
/// # let law = LawDefinition::built_in("40X-R1").ok_or("no such law")?.law(ToolAngles { rake_deg: 10.0, lead_deg: 60.0 })?;
/// # let axes = [PrincipalAxis::with_ratio(6.0, 3.0e7, 0.03), PrincipalAxis::with_ratio(6.0, 1.5e7, 0.02)];
/// # let tool = CuttingTool { axes, beta_deg: 35.0, speed_m_min: 60.0, depth_mm: 4.0, feed_mm_rev: 0.49,
/// #     radial_ratio: 0.4, floor_m_min: 2.0 };
/// let cells = Mapper::new(5).tile(tool, &law, &[30.0, 60.0], &[1.0, 4.0]);
/// // Speed by speed, from the lowest depth up.
/// assert_eq!((cells[1].speed_m_min, cells[1].depth_mm), (30.0, 4.0));
/// assert_eq!(cells[3].verdict, Some(StabilityVerdict::SelfExcited));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct Mapper {
    assessor: Assessor,
    coarse: Scanner,
    medium: Scanner,
    fine: Scanner,
    ends: Scanner,
}

/// A cell, and the starting points for its neighbours.
#[derive(Clone, Debug)]
struct Node {
    cell: MapCell,
    /// Stable cycle of the largest amplitude.
    cycle: Option<Cycle>,
    cycles: Survey,
}

/// Cycles of a cut, stable or not.
type Survey = Vec<(Cycle, bool)>;

/// Results of the balance for a cut.
#[derive(Clone, Debug, Default)]
struct Found {
    branches: Vec<Branch>,
    cycles: Survey,
    /// Stability of the first cycle on the growing branch.
    first_is_stable: bool,
}

impl Mapper {
    /// Creates a mapper that finds cycles with this many harmonics (5 for amplitudes to 1e-4).
    #[must_use]
    pub fn new(harmonics: usize) -> Self {
        Self {
            assessor: Assessor::new(harmonics),
            coarse: Scanner::coarse(),
            medium: Scanner::medium(),
            fine: Scanner::for_maps(harmonics),
            ends: Scanner::for_ends(),
        }
    }

    /// The cell of a tool's cut.
    #[must_use]
    pub fn cell<'a>(&mut self, tool: CuttingTool, laws: impl Into<Laws<'a>>) -> MapCell {
        self.node(tool, laws.into()).cell
    }

    /// The cell of a tool's cut, and its cycles with their stability.
    #[must_use]
    pub fn cycles<'a>(
        &mut self,
        tool: CuttingTool,
        laws: impl Into<Laws<'a>>,
    ) -> (MapCell, Vec<(Cycle, bool)>) {
        let node = self.node(tool, laws.into());
        (node.cell, node.cycles)
    }

    /// The complete assessment of a model's cut.
    pub(crate) fn assess(&mut self, model: &Model<'_>) -> Result<Assessment, ChatterError> {
        self.assessor.assess(model)
    }

    /// The cells of a rectangle of speeds, m/min, and depths, mm, both ascending: speed by speed, from the
    /// lowest depth up.
    ///
    /// An island smaller than 4 cells across may be missed.
    #[must_use]
    pub fn tile<'a>(
        &mut self,
        tool: CuttingTool,
        laws: impl Into<Laws<'a>>,
        speeds_m_min: &[f64],
        depths_mm: &[f64],
    ) -> Vec<MapCell> {
        let (columns, rows) = (speeds_m_min.len(), depths_mm.len());
        let mut tile = Tile {
            mapper: self,
            law: laws.into(),
            cut: |column, row| CuttingTool {
                speed_m_min: speeds_m_min[column],
                depth_mm: depths_mm[row],
                ..tool
            },
            rows,
            nodes: vec![None; columns * rows],
        };
        if columns > 0 && rows > 0 {
            tile.divide([0, columns - 1], [0, rows - 1]);
        }
        tile.nodes.into_iter().flatten().map(|node| node.cell).collect()
    }

    fn node(&mut self, tool: CuttingTool, law: Laws<'_>) -> Node {
        let mut node = Node {
            cell: MapCell {
                speed_m_min: tool.speed_m_min,
                depth_mm: tool.depth_mm,
                verdict: None,
                growth_per_s: f64::NAN,
                amplitude_m: 0.0,
                frequency_hz: 0.0,
            },
            cycle: None,
            cycles: Survey::new(),
        };
        // A cut that cannot be computed is a cell without a verdict.
        let _refused = self.fill(tool, law, &mut node);
        node
    }

    fn fill(&mut self, tool: CuttingTool, law: Laws<'_>, node: &mut Node) -> Result<(), ChatterError> {
        let model = Model::new(tool, law)?;
        let rest = model.equilibrium()?;
        node.cell.growth_per_s = rest.growth_per_s();
        let quick = match self.survey(&model, &rest)? {
            Some(mut found) => match self.assessor.quick_verdict(&model, &rest, &mut found) {
                Some(StabilityVerdict::Stable)
                    if self.may_hide_a_cycle(&model, &rest, &found.branches)? =>
                {
                    None
                }
                verdict => verdict.map(|verdict| (verdict, found.cycles)),
            },
            None => None,
        };
        let (verdict, survey) = match quick {
            Some(quick) => quick,
            None => {
                let whole = self.assessor.assess(&model)?;
                let cycles = whole.cycles.iter();
                let survey = cycles
                    .map(|known| (known.cycle.clone(), known.verified.stable()))
                    .collect();
                (whole.verdict, survey)
            }
        };
        node.cell.verdict = Some(verdict);
        let size = |cycle: &Cycle| cycle.amplitude_m(0).max(cycle.amplitude_m(1));
        let stable = survey
            .iter()
            .filter(|(_, stable)| *stable)
            .map(|(cycle, _)| cycle);
        node.cycle = stable.max_by(|a, b| size(a).total_cmp(&size(b))).cloned();
        node.cycles = survey;
        // A cut that leaves the model has no stable cycle.
        if verdict == StabilityVerdict::OutOfModel {
            node.cycle = None;
        }
        if let Some(cycle) = &node.cycle {
            node.cell.amplitude_m = size(cycle);
            node.cell.frequency_hz = cycle.frequency_hz;
        }
        Ok(())
    }

    /// Whether one of these branches may have a cycle beyond its end.
    fn may_hide_a_cycle(
        &mut self,
        model: &Model<'_>,
        rest: &Equilibrium,
        branches: &[Branch],
    ) -> Result<bool, ChatterError> {
        for branch in branches {
            if self.ends.may_meet_a_cycle_beyond(model, rest, branch)? {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// The branches and all their cycles; `None` if results contradict each other.
    fn survey(&mut self, model: &Model<'_>, rest: &Equilibrium) -> Result<Option<Found>, ChatterError> {
        let mut found = Found::default();
        for mode in &rest.modes {
            let branch = self.branch(model, rest, mode)?;
            if !branch.end.is_known() {
                return Ok(None);
            }
            for (k, cycle) in branch.cycles.iter().enumerate() {
                let Some(stable) = stability(model, cycle)? else {
                    return Ok(None);
                };
                found.first_is_stable |= stable && k == 0 && mode.growth_per_s > 0.0;
                let same = |known: &Cycle| {
                    (known.frequency_hz / cycle.frequency_hz - 1.0).abs() < 1e-4
                        && (known.amplitude_m(1) / cycle.amplitude_m(1) - 1.0).abs() < 1e-3
                };
                if !found.cycles.iter().any(|(known, _)| same(known)) {
                    found.cycles.push((cycle.clone(), stable));
                }
            }
            found.branches.push(branch);
        }
        Ok(Some(found))
    }

    /// The branch of a mode with the minimum number of harmonics that find its cycles reliably; the cycles
    /// with all harmonics.
    fn branch(
        &mut self,
        model: &Model<'_>,
        rest: &Equilibrium,
        mode: &SmallMode,
    ) -> Result<Branch, ChatterError> {
        let mut branch = self.coarse.branch(model, rest, mode)?;
        if self.refined(model, &mut branch, ONE_HARMONIC)? {
            return Ok(branch);
        }
        if self.fine.harmonics() > self.medium.harmonics() {
            let seen = branch.cycles.len();
            branch = self.medium.branch(model, rest, mode)?;
            // With fewer cycles than one harmonic has found, some may have been missed.
            if branch.cycles.len() >= seen && self.refined(model, &mut branch, THREE_HARMONICS)? {
                return Ok(branch);
            }
        }
        self.fine.branch(model, rest, mode)
    }

    /// Refines each cycle; false if the harmonics of the branch may have missed some.
    fn refined(
        &mut self,
        model: &Model<'_>,
        branch: &mut Branch,
        trust: Trust,
    ) -> Result<bool, ChatterError> {
        if !branch.end.is_known() {
            return Ok(false);
        }
        let size = |point: &ScanPoint| point.extra_per_s.abs();
        let nearest = branch.points.iter().map(size).fold(f64::INFINITY, f64::min);
        let largest = branch.points.iter().map(size).fold(0.0, f64::max);
        // Near a fold, or just before a cycle appears, few harmonics may find two roots or none.
        let near = nearest < trust.near_fold_per_s.max(trust.near_fold_part * largest);
        if branch.mode.growth_per_s < 0.0 && near && branch.cycles.is_empty() {
            return Ok(false);
        }
        let grazes = branch.points.windows(3).any(|three| {
            let [a, b, c] = [size(&three[0]), size(&three[1]), size(&three[2])];
            // At a root it passes through zero.
            let signs = three.iter().filter(|point| point.extra_per_s > 0.0).count();
            b < a && b < c && b < trust.grazing_part * largest && signs % 3 == 0
        });
        if grazes {
            return Ok(false);
        }
        // Just beyond the end of the branch a root may still be within the model.
        if let [.., before, last] = branch.points.as_slice() {
            let slope = (last.extra_per_s - before.extra_per_s) / (last.amplitude_m - before.amplitude_m);
            let beyond = -last.extra_per_s / slope;
            if beyond > 0.0 && beyond < trust.near_end_part * last.amplitude_m {
                return Ok(false);
            }
        }
        for cycle in &mut branch.cycles {
            let before = cycle.amplitude_m(cycle.driver);
            match self.fine.refine(model, cycle)? {
                Some(better)
                    if (better.extra_slope < 0.0) == (cycle.extra_slope < 0.0)
                        && (better.amplitude_m(better.driver) / before - 1.0).abs() < REFINED_PART =>
                {
                    *cycle = better;
                }
                _ => return Ok(false),
            }
        }
        Ok(true)
    }
}

/// Whether a cycle is stable, by its multipliers; `None` if it does not close in time, or converges to
/// another one.
fn stability(model: &Model<'_>, cycle: &Cycle) -> Result<Option<bool>, ChatterError> {
    let largest = quick_multipliers(model, cycle)?
        .iter()
        .map(|value: &Complex<f64>| value.norm())
        .fold(0.0, f64::max);
    let error = if cycle.free_part > 0.0 {
        FREE_MULTIPLIER_ERROR
    } else {
        MULTIPLIER_ERROR
    };
    if (largest - 1.0).abs() > error {
        return Ok(Some(largest < 1.0));
    }
    let Ok(verified) = verify(model, cycle, 1e-8) else {
        return Ok(None);
    };
    let landed = verified.amplitude_error.abs() > 0.1 || !verified.within_model(model);
    Ok((!landed).then(|| verified.stable()))
}

/// A rectangle of cells during its division.
struct Tile<'a, F: Fn(usize, usize) -> CuttingTool> {
    mapper: &'a mut Mapper,
    law: Laws<'a>,
    cut: F,
    rows: usize,
    nodes: Vec<Option<Node>>,
}

impl<F: Fn(usize, usize) -> CuttingTool> Tile<'_, F> {
    fn at(&mut self, column: usize, row: usize) -> &Node {
        let index = column * self.rows + row;
        let (mapper, law, tool) = (&mut *self.mapper, self.law, (self.cut)(column, row));
        self.nodes[index].get_or_insert_with(|| mapper.node(tool, law))
    }

    /// Computes the cells from the first to the last column and row.
    fn divide(&mut self, columns: [usize; 2], rows: [usize; 2]) {
        let middle = |range: [usize; 2]| usize::midpoint(range[0], range[1]);
        let (column, row) = (middle(columns), middle(rows));
        let mut first: Option<Node> = None;
        let mut uniform = true;
        for (column, row) in [
            (columns[0], rows[0]),
            (columns[0], rows[1]),
            (columns[1], rows[0]),
            (columns[1], rows[1]),
            (column, row),
        ] {
            let here = self.at(column, row);
            let signature = |node: &Node| {
                let cycle = node.cycle.is_some();
                (node.cell.verdict, node.cell.growth_per_s > 0.0, cycle)
            };
            match &first {
                Some(first) => uniform &= signature(here) == signature(first),
                None => first = Some(here.clone()),
            }
        }
        let (width, height) = (columns[1] - columns[0], rows[1] - rows[0]);
        if width.max(height) <= 1 {
            return;
        }
        if uniform && width.max(height) <= LARGEST_PART {
            let middle = self.at(column, row).clone();
            self.between(&middle, columns, rows);
            return;
        }
        let halves = |range: [usize; 2], middle: usize| {
            if range[1] - range[0] > 1 {
                vec![[range[0], middle], [middle, range[1]]]
            } else {
                vec![range]
            }
        };
        for columns in halves(columns, column) {
            for rows in halves(rows, row) {
                self.divide(columns, rows);
            }
        }
    }

    /// Fills a part that is like its middle.
    fn between(&mut self, like: &Node, columns: [usize; 2], rows: [usize; 2]) {
        for column in columns[0]..=columns[1] {
            for row in rows[0]..=rows[1] {
                let index = column * self.rows + row;
                if self.nodes[index].is_none() {
                    let tool = (self.cut)(column, row);
                    let node = self.mapper.alike(tool, self.law, like);
                    self.nodes[index] = Some(node.unwrap_or_else(|| self.mapper.node(tool, self.law)));
                }
            }
        }
    }
}

impl Mapper {
    /// A cell with the verdict of another one nearby; `None` if the two differ.
    fn alike(&mut self, tool: CuttingTool, law: Laws<'_>, like: &Node) -> Option<Node> {
        let mut node = like.clone();
        (node.cell.speed_m_min, node.cell.depth_mm) = (tool.speed_m_min, tool.depth_mm);
        let Ok(model) = Model::new(tool, law) else {
            return like.cell.verdict.is_none().then_some(node);
        };
        let Ok(rest) = model.equilibrium() else {
            return like.cell.verdict.is_none().then_some(node);
        };
        node.cell.growth_per_s = rest.growth_per_s();
        if (node.cell.growth_per_s > 0.0) != (like.cell.growth_per_s > 0.0) {
            return None;
        }
        if let Some(cycle) = &like.cycle {
            let size = |cycle: &Cycle| cycle.amplitude_m(0).max(cycle.amplitude_m(1));
            let found = self.fine.refine(&model, cycle).ok()??;
            if found.extra_slope > 0.0 || (size(&found) / size(cycle) - 1.0).abs() > REFINED_PART {
                return None;
            }
            node.cell.amplitude_m = size(&found);
            node.cell.frequency_hz = found.frequency_hz;
            node.cycle = Some(found);
        }
        Some(node)
    }
}

impl Assessor {
    /// The verdict from cycles with their stability, if it is unambiguous; disturbances are followed before
    /// it is `Stable`.
    fn quick_verdict(
        &self,
        model: &Model<'_>,
        rest: &Equilibrium,
        found: &mut Found,
    ) -> Option<StabilityVerdict> {
        let survey = &mut found.cycles;
        let stable = survey.iter().any(|(_, stable)| *stable);
        let grows = rest.growth_per_s() > 0.0;
        if grows && survey.is_empty() {
            return Some(StabilityVerdict::OutOfModel);
        }
        let growing = rest.modes.iter().filter(|mode| mode.growth_per_s > 0.0).count();
        if grows && found.first_is_stable && growing == 1 {
            return Some(StabilityVerdict::SelfExcited);
        }
        if !grows && stable {
            return Some(StabilityVerdict::Bistable);
        }
        if !grows && !survey.is_empty() {
            return Some(StabilityVerdict::OutOfModel);
        }
        let mut verified = Vec::new();
        for (cycle, _) in survey.iter().filter(|(_, stable)| *stable) {
            verified.push(verify(model, cycle, 1e-8).ok()?);
        }
        let ends = found.branches.iter().filter(|branch| branch.ends_near_a_cycle());
        let ends: Vec<State> = ends.filter_map(|branch| branch.largest).collect();
        let fates = self.disturbances(model, rest, &verified, &ends);
        let all = |is: fn(&Fate) -> bool| fates.iter().all(is);
        // Attractors that the balance did not find.
        for fate in &fates {
            if let Fate::Settles(found) = fate
                && !verified.iter().any(|known| known.is_same(found))
            {
                survey.push((found.cycle(), true));
                verified.push((**found).clone());
            }
        }
        if fates.contains(&Fate::Leaves) {
            Some(StabilityVerdict::OutOfModel)
        } else if grows && all(|fate| matches!(fate, Fate::Settles(_))) {
            Some(StabilityVerdict::SelfExcited)
        } else if !grows && all(|fate| *fate == Fate::DiesOut) {
            Some(StabilityVerdict::Stable)
        } else {
            None
        }
    }
}
