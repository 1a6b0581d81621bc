//! Results of load-adaptive turning cycles.

use evolvent_turning::{CutState, TurningOutput, TurningState};
use serde::Serialize;

/// Passes and loads of the turning cycles (Q1) of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct TurningSummary {
    /// Number of cycles begun.
    pub cycles: u32,
    /// Number of cycles that ended at size.
    pub done: u32,
    /// Number of passes of all cycles.
    pub passes: u32,
    /// Number of times that the tool backed off from a cut that was too deep.
    pub back_offs: u32,
    /// Time within the cycles, s.
    pub time_s: f64,
    /// Largest load reported by the sensor, smoothed over 4 ms, in its unit.
    pub peak_load: f64,
    /// Largest true load, if the stock is simulated.
    pub peak_true_load: Option<f64>,
    /// The set load.
    pub set_load: f64,
}

/// Counts cycle by cycle. Allocates nothing.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TurningTally {
    summary: TurningSummary,
    period_s: f64,
    inside: bool,
    pass: u32,
}

impl TurningTally {
    pub(crate) fn new(set_load: f64, period_ns: u64) -> Self {
        Self {
            summary: TurningSummary {
                set_load,
                ..TurningSummary::default()
            },
            period_s: period_ns as f64 * 1e-9,
            inside: false,
            pass: 0,
        }
    }

    /// Counts one control period: the output of a turning cycle, if one moves the axes, and the material
    /// removed from a simulated stock.
    pub(crate) fn observe(&mut self, output: Option<&TurningOutput>, cut: Option<&CutState>) {
        let Some(output) = output else {
            self.inside = false;
            return;
        };
        let sum = &mut self.summary;
        if !self.inside {
            (self.inside, self.pass) = (true, 0);
            sum.cycles += 1;
        }
        sum.passes += output.pass.saturating_sub(self.pass);
        self.pass = self.pass.max(output.pass);
        sum.time_s += self.period_s;
        sum.peak_load = sum.peak_load.max(output.load);
        if let Some(cut) = cut {
            sum.peak_true_load = Some(sum.peak_true_load.unwrap_or(0.0).max(cut.load));
        }
        let to = output.transition.map(|transition| transition.to);
        sum.back_offs += u32::from(to == Some(TurningState::BackOff));
        sum.done += u32::from(to == Some(TurningState::Done));
    }

    /// The summary; `None` if no cycle was begun.
    pub(crate) fn summary(&self) -> Option<TurningSummary> {
        (self.summary.cycles > 0).then_some(self.summary)
    }
}
