//! The nearest stable speeds.

use crate::assess::StabilityVerdict;
use crate::map::Mapper;
use crate::model::{CuttingTool, Laws, Model};

/// The nearest stable speeds below and above a cut's speed, m/min, within `range_m_min`; each to 0.1 %.
///
/// Stable means that every disturbance dies out: bistable speeds do not count. Speeds are tried in steps of 2
/// %, so a narrower stable gap may be missed.
#[must_use]
pub fn nearest_stable<'a>(
    mapper: &mut Mapper,
    tool: CuttingTool,
    laws: impl Into<Laws<'a>>,
    range_m_min: [f64; 2],
) -> [Option<f64>; 2] {
    let law = laws.into();
    let mut search = |step: f64| {
        let stable = |mapper: &mut Mapper, speed_m_min: f64| {
            let cell = mapper.cell(CuttingTool { speed_m_min, ..tool }, law);
            cell.verdict == Some(StabilityVerdict::Stable)
        };
        let mut unstable_at = tool.speed_m_min;
        loop {
            let next = unstable_at * step;
            if next < range_m_min[0].max(1.001 * tool.floor_m_min) || next > range_m_min[1] {
                return None;
            }
            if stable(mapper, next) {
                let mut stable_at = next;
                while (stable_at / unstable_at - 1.0).abs() > 1e-3 {
                    let middle = 0.5 * (stable_at + unstable_at);
                    if stable(mapper, middle) {
                        stable_at = middle;
                    } else {
                        unstable_at = middle;
                    }
                }
                // A cell of a map is quick; a speed that is recommended has been assessed completely.
                let whole = Model::new(
                    CuttingTool {
                        speed_m_min: stable_at,
                        ..tool
                    },
                    law,
                )
                .and_then(|model| mapper.assess(&model));
                if whole.is_ok_and(|whole| whole.verdict == StabilityVerdict::Stable) {
                    return Some(stable_at);
                }
            }
            unstable_at = next;
        }
    };
    [search(1.0 / 1.02), search(1.02)]
}
