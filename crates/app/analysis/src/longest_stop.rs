//! The feed hold with the longest stopping distance of a plan.

use evolvent_motion::StoppingDistance;
use serde::Serialize;

/// The feed hold with the longest stopping distance. Absent for the classic planner, whose holds have
/// separate profiles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct LongestStopReport {
    /// Stopping distance along the path.
    pub longest_stop_mm: Option<f64>,
    /// Stopping time.
    pub longest_stop_s: Option<f64>,
    /// Program line at the hold.
    pub longest_stop_line: Option<u32>,
    /// Path time of the hold.
    pub longest_stop_at_s: Option<f64>,
}

impl LongestStopReport {
    /// Evaluates setpoints, with the control period in s.
    #[must_use]
    pub fn new(stops: Option<&StoppingDistance>, period_s: f64) -> Self {
        let Some(longest) = stops.and_then(StoppingDistance::longest) else {
            return Self::default();
        };
        Self {
            longest_stop_mm: Some(longest.path_mm),
            longest_stop_s: Some(longest.duration_s),
            longest_stop_line: Some(longest.line),
            longest_stop_at_s: Some((longest.sequence + 1) as f64 * period_s),
        }
    }

    /// A text; `None` if nothing moves.
    #[must_use]
    pub fn text(&self) -> Option<String> {
        let (path, seconds, line) = (
            self.longest_stop_mm?,
            self.longest_stop_s?,
            self.longest_stop_line?,
        );
        Some(format!(
            "a hold stops within {path:.3} mm and {:.0} ms: longest on line {line}",
            1e3 * seconds
        ))
    }
}
