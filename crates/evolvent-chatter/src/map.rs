//! Maps over speed and depth: where a cut is stable, bistable, vibrates by itself, or is beyond the model.

use evolvent_cutting::ForceLaw;

use crate::cycle::Cycle;
use crate::error::ChatterError;
use crate::model::{CuttingTool, Model};
use crate::scan::{Branch, ScanPoint, Scanner, Verdict};

/// Extra damping below which two roots may hide from one harmonic, 1/s ...
const NEAR_FOLD_PER_S: f64 = 0.5;
/// ... and as part of the largest on the branch.
const NEAR_FOLD_PART: f64 = 0.02;
/// A minimum of the extra damping along a branch below this part of the largest may touch zero.
const GRAZING_PART: f64 = 0.06;
/// How far beyond the end of a branch, as part of the amplitude there, a root is looked for with all harmonics.
const NEAR_END_PART: f64 = 0.15;

/// What a map says of one cut.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapCell {
    /// Cutting speed, m/min.
    pub speed_m_min: f64,
    /// Depth of cut, mm.
    pub depth_mm: f64,
    /// The verdict; None where there is no steady cut or no force.
    pub verdict: Option<Verdict>,
    /// Growth of the fastest growing small vibration, 1/s.
    pub growth_per_s: f64,
    /// Amplitude of the driving coordinate on the largest stable cycle, m; 0 where there is none.
    pub amplitude_m: f64,
    /// Its frequency, Hz; 0 where there is none.
    pub frequency_hz: f64,
}

/// Computes cells of a map; keeps its working memory. One for each thread.
#[derive(Clone, Debug)]
pub struct Mapper {
    coarse: Scanner,
    fine: Scanner,
}

impl Mapper {
    /// Cycles are found with one harmonic and refined with so many (5 for amplitudes to 1e-4).
    #[must_use]
    pub fn new(harmonics: usize) -> Self {
        Self {
            coarse: Scanner::coarse(),
            fine: Scanner::for_maps(harmonics),
        }
    }

    /// The cell of a tool's cut.
    #[must_use]
    pub fn cell(&mut self, tool: CuttingTool, law: &ForceLaw) -> MapCell {
        let mut cell = MapCell {
            speed_m_min: tool.speed_m_min,
            depth_mm: tool.depth_mm,
            verdict: None,
            growth_per_s: f64::NAN,
            amplitude_m: 0.0,
            frequency_hz: 0.0,
        };
        // What cannot be computed is a cell without a verdict.
        let _refused = self.fill(tool, law, &mut cell);
        cell
    }

    fn fill(&mut self, tool: CuttingTool, law: &ForceLaw, cell: &mut MapCell) -> Result<(), ChatterError> {
        let model = Model::new(tool, law)?;
        let mut prediction = self.coarse.scan(&model)?;
        for branch in &mut prediction.branches {
            if !self.refined(&model, branch)? {
                *branch = self
                    .fine
                    .branch(&model, prediction.equilibrium.force_n, &branch.mode)?;
            }
        }
        cell.growth_per_s = prediction.equilibrium.growth_per_s();
        cell.verdict = Some(prediction.verdict());
        let stable = prediction.cycles().filter(|cycle| cycle.stable_by_slope());
        let size = |cycle: &Cycle| cycle.amplitude_m(cycle.driver);
        if let Some(cycle) = stable.max_by(|a, b| size(a).total_cmp(&size(b))) {
            cell.amplitude_m = size(cycle);
            cell.frequency_hz = cycle.frequency_hz;
        }
        Ok(())
    }

    /// Refines each cycle; false where one harmonic cannot be trusted to have found them all.
    fn refined(&mut self, model: &Model<'_>, branch: &mut Branch) -> Result<bool, ChatterError> {
        let size = |point: &ScanPoint| point.extra_per_s.abs();
        let nearest = branch.points.iter().map(size).fold(f64::INFINITY, f64::min);
        let largest = branch.points.iter().map(size).fold(0.0, f64::max);
        // Near a fold, or where a cycle is about to be born, one harmonic may see two roots or none.
        let near = nearest < NEAR_FOLD_PER_S.max(NEAR_FOLD_PART * largest);
        if branch.mode.growth_per_s < 0.0 && near && branch.cycles.is_empty() {
            return Ok(false);
        }
        let grazes = branch.points.windows(3).any(|three| {
            let [a, b, c] = [size(&three[0]), size(&three[1]), size(&three[2])];
            b < a && b < c && b < GRAZING_PART * largest
        });
        if grazes {
            return Ok(false);
        }
        // Just beyond the end of the branch a root may be within the model after all.
        if let [.., before, last] = branch.points.as_slice() {
            let slope = (last.extra_per_s - before.extra_per_s) / (last.amplitude_m - before.amplitude_m);
            let beyond = -last.extra_per_s / slope;
            if beyond > 0.0 && beyond < NEAR_END_PART * last.amplitude_m {
                return Ok(false);
            }
        }
        for cycle in &mut branch.cycles {
            match self.fine.refine(model, cycle)? {
                Some(better) if better.stable_by_slope() == cycle.stable_by_slope() => *cycle = better,
                _ => return Ok(false),
            }
        }
        Ok(true)
    }
}
