//! The hold of a plan that takes the longest path to stop.

use evolvent_motion::StoppingDistance;
use serde::Serialize;

/// The hold that needs the longest path. Absent for the classic planner, whose holds are profiles of their own.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct LongestStop {
    /// Path from the hold to rest.
    pub longest_stop_mm: Option<f64>,
    /// Time from the hold to rest.
    pub longest_stop_s: Option<f64>,
    /// Program line at the hold.
    pub longest_stop_line: Option<u32>,
    /// Path time of the hold.
    pub longest_stop_at_s: Option<f64>,
}

impl LongestStop {
    /// Of the setpoints that were seen, with the control period in s.
    #[must_use]
    pub fn new(stops: Option<&StoppingDistance>, period_s: f64) -> Self {
        let Some(longest) = stops.and_then(StoppingDistance::longest) else {
            return Self::default();
        };
        Self {
            longest_stop_mm: Some(longest.path_mm),
            longest_stop_s: Some(longest.seconds),
            longest_stop_line: Some(longest.line),
            longest_stop_at_s: Some((longest.sequence + 1) as f64 * period_s),
        }
    }

    /// In words; none where there is nothing to stop.
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
