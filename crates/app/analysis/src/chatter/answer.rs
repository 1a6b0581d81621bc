//! The results computed for a case of self-oscillation.

use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use evolvent_chatter::{
    Assessment, Assessor, ChatterError, CuttingTool, Fit, Laws, MapCell, Mapper, Measure, Model,
    OscillationCase, StabilityVerdict, least_squares, nearest_stable,
};
use evolvent_cutting::Cut;

use super::transient::{Transient, transient};
use super::{CaseLaws, ChatterRequest};
use crate::error::AnalysisError;

/// Columns of a map computed together by one thread.
const STRIP: usize = 25;

/// All results that pictures and reports show.
pub(crate) struct Answer {
    pub(crate) asked: OscillationCase,
    pub(crate) tool: CuttingTool,
    pub(crate) laws: CaseLaws,
    pub(crate) assessment: Assessment,
    /// Nearest stable speeds below and above, m/min; only if the cut is not stable.
    pub(crate) stable_m_min: [Option<f64>; 2],
    pub(crate) fits: Option<Vec<(Measure, Vec<Fit>)>>,
    pub(crate) sweep: Vec<SweepPoint>,
    /// One map per feed; cells column by column (speed), from the lowest depth up.
    pub(crate) maps: Vec<(f64, Vec<MapCell>)>,
    /// Response to the impulse, if one was requested.
    pub(crate) transient: Option<Transient>,
    pub(crate) assumptions: Vec<String>,
}

/// The limit cycles at one speed.
pub(crate) struct SweepPoint {
    pub(crate) speed_m_min: f64,
    /// `None` without a steady cut or without force.
    pub(crate) growth_per_s: Option<f64>,
    pub(crate) verdict: Option<StabilityVerdict>,
    /// Amplitude of V2, m, frequency, Hz, and stability of each cycle, largest first.
    pub(crate) cycles: Vec<(f64, f64, bool)>,
}

pub(crate) fn answer(
    case_file: &Path,
    asked: &OscillationCase,
    laws: CaseLaws,
    request: &ChatterRequest,
) -> Result<Answer, AnalysisError> {
    let failed = |error: ChatterError| AnalysisError::Failed(format!("{}: {error}", case_file.display()));
    let tool = CuttingTool {
        radial_ratio: asked.radial_ratio.unwrap_or_else(|| laws.law.radial_ratio()),
        ..asked.tool
    };
    let model = Model::new(tool, laws.laws()).map_err(failed)?;
    let assessment = Assessor::new(asked.harmonics).assess(&model).map_err(failed)?;
    let stable_m_min = if assessment.verdict == StabilityVerdict::Stable {
        [None; 2]
    } else {
        let range = [1.01 * tool.floor_m_min, 10.0 * tool.speed_m_min];
        nearest_stable(&mut Mapper::new(asked.harmonics), tool, laws.laws(), range)
    };
    let fits = if request.least_squares {
        let mut all = Vec::new();
        for measure in [Measure::Residual, Measure::Normalised] {
            let harmonics = asked.harmonics.min(16);
            all.push((
                measure,
                least_squares(&model, harmonics, measure).map_err(failed)?,
            ));
        }
        Some(all)
    } else {
        None
    };
    let sweep = if request.sweep {
        sweep(asked, tool, laws.laws())
    } else {
        Vec::new()
    };
    let maps = if request.maps {
        let feeds = asked.map.feed_mm_rev.iter();
        feeds
            .map(|&feed_mm_rev| {
                (
                    feed_mm_rev,
                    map(asked, CuttingTool { feed_mm_rev, ..tool }, laws.laws()),
                )
            })
            .collect()
    } else {
        Vec::new()
    };
    let transient = request
        .kick
        .and_then(|kick| transient(tool, laws.laws(), &assessment, kick.velocity_m_s, kick.seconds));
    let assumptions = assumptions(asked, &tool, &laws, &assessment);
    Ok(Answer {
        asked: asked.clone(),
        tool,
        laws,
        assessment,
        stable_m_min,
        fits,
        sweep,
        maps,
        transient,
        assumptions,
    })
}

/// The assumptions of the result, shown with every output.
fn assumptions(
    asked: &OscillationCase,
    tool: &CuttingTool,
    laws: &CaseLaws,
    assessment: &Assessment,
) -> Vec<String> {
    let (law, definition) = (&laws.law, &laws.definition);
    let mut all = vec![
        format!("force law {}: {}", definition.name, definition.description),
        laws.radial_text(asked),
        "no regeneration: waves of the last revolution are not seen, so there are no stability lobes in this"
            .to_owned(),
        format!("below {} m/min the force law is not valid", tool.floor_m_min),
    ];
    let outside = |law: &evolvent_cutting::ForceLaw, speed: f64| {
        !law.covers(Cut {
            speed_m_min: speed,
            depth_mm: tool.depth_mm,
            feed_mm_rev: tool.feed_mm_rev,
        })
    };
    let speeds = || {
        let cycles = assessment.cycles.iter();
        cycles
            .flat_map(|known| known.cycle.speed_m_min)
            .chain([tool.speed_m_min])
    };
    let radial = laws.radial.as_ref().map(|(law, _)| ("radial force law", law));
    for (what, law) in [("force law", law)].into_iter().chain(radial) {
        if speeds().any(|speed| outside(law, speed)) {
            let [from, to] = law.covered().speed_m_min;
            all.push(format!(
                "the {what} is extrapolated: its data are from {from} to {to} m/min"
            ));
        }
    }
    all
}

/// Calls `each` for 0 to `count` on as many threads as there are processors; returns the results in order.
fn in_parallel<T: Send>(
    count: usize,
    each: impl Fn(&mut Mapper, usize) -> T + Sync,
    harmonics: usize,
) -> Vec<T> {
    let threads = std::thread::available_parallelism()
        .map_or(1, usize::from)
        .min(count.max(1));
    let next = AtomicUsize::new(0);
    let work = || {
        let mut mapper = Mapper::new(harmonics);
        let mut done = Vec::new();
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            if index >= count {
                return done;
            }
            done.push((index, each(&mut mapper, index)));
        }
    };
    let mut all: Vec<(usize, T)> = std::thread::scope(|scope| {
        let others: Vec<_> = (1..threads).map(|_| scope.spawn(work)).collect();
        let mut all = work();
        for other in others {
            // A thread that panicked contributes nothing; its columns stay empty.
            all.extend(other.join().unwrap_or_default());
        }
        all
    });
    all.sort_by_key(|(index, _)| *index);
    all.into_iter().map(|(_, result)| result).collect()
}

fn sweep(asked: &OscillationCase, tool: CuttingTool, law: Laws<'_>) -> Vec<SweepPoint> {
    let [from, to] = asked.sweep.speed_m_min;
    let last = (asked.sweep.points - 1) as f64;
    let point = |mapper: &mut Mapper, k: usize| {
        let speed_m_min = from + (to - from) * k as f64 / last;
        let (cell, cycles) = mapper.cycles(CuttingTool { speed_m_min, ..tool }, law);
        let mut cycles: Vec<_> = cycles
            .iter()
            .map(|(cycle, stable)| (cycle.amplitude_m(1), cycle.frequency_hz, *stable))
            .collect();
        cycles.sort_by(|a, b| b.0.total_cmp(&a.0));
        SweepPoint {
            speed_m_min,
            growth_per_s: cell.growth_per_s.is_finite().then_some(cell.growth_per_s),
            verdict: cell.verdict,
            cycles,
        }
    };
    in_parallel(asked.sweep.points, point, asked.harmonics)
}

fn map(asked: &OscillationCase, tool: CuttingTool, law: Laws<'_>) -> Vec<MapCell> {
    let range = &asked.map;
    // Cells are centred on their values.
    let middle = |range: [f64; 2], k: usize, count: usize| {
        range[0] + (range[1] - range[0]) * (k as f64 + 0.5) / count as f64
    };
    let depths: Vec<f64> = (0..range.rows)
        .map(|row| middle(range.depth_mm, row, range.rows))
        .collect();
    let strip = |mapper: &mut Mapper, k: usize| {
        let columns = k * STRIP..((k + 1) * STRIP).min(range.columns);
        let speeds: Vec<f64> = columns
            .map(|column| middle(range.speed_m_min, column, range.columns))
            .collect();
        mapper.tile(tool, law, &speeds, &depths)
    };
    in_parallel(range.columns.div_ceil(STRIP), strip, asked.harmonics)
        .into_iter()
        .flatten()
        .collect()
}
