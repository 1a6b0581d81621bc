//! Which speed would be stable.

use evolvent_cutting::ForceLaw;

use crate::map::Mapper;
use crate::model::CuttingTool;
use crate::scan::Verdict;

/// The nearest stable speeds below and above a cut's speed, m/min, within `range_m_min`; each to 0.1 %.
///
/// Stable means that every disturbance dies out: bistable speeds do not count. Speeds are tried in steps of 2 %, so a
/// stable gap that is narrower may be missed.
#[must_use]
pub fn nearest_stable(
    mapper: &mut Mapper,
    tool: CuttingTool,
    law: &ForceLaw,
    range_m_min: [f64; 2],
) -> [Option<f64>; 2] {
    [1.0 / 1.02, 1.02].map(|step| {
        let mut stable = |speed_m_min: f64| {
            let cell = mapper.cell(CuttingTool { speed_m_min, ..tool }, law);
            cell.verdict == Some(Verdict::Stable)
        };
        let mut unstable_at = tool.speed_m_min;
        loop {
            let next = unstable_at * step;
            if next < range_m_min[0].max(1.001 * tool.floor_m_min) || next > range_m_min[1] {
                return None;
            }
            if stable(next) {
                let mut stable_at = next;
                while (stable_at / unstable_at - 1.0).abs() > 1e-3 {
                    let middle = 0.5 * (stable_at + unstable_at);
                    if stable(middle) {
                        stable_at = middle;
                    } else {
                        unstable_at = middle;
                    }
                }
                return Some(stable_at);
            }
            unstable_at = next;
        }
    })
}
