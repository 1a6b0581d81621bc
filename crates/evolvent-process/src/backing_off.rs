//! Backing off from a cut that is too deep.

use crate::controller::TurningController;
use crate::settings::PassDepth;
use crate::state::{Reason, TurningState};

/// Share of the deepest cut at which it is backed off from: the load is noisy.
const DEEP: f64 = 0.98;
/// Way beyond where contact is expected after which caution ends, mm.
const CAUTION_MM: f64 = 1.5;

impl TurningController {
    /// Deepest cut that is taken at once: in passes of least time, what two passes would not do faster.
    pub(crate) fn deepest(&self) -> f64 {
        match self.settings.strategy.depth {
            PassDepth::LeastTime { .. } => self.split_mm,
            _ => self.settings.regime.depth_max_mm,
        }
    }

    /// Backs off from a depth that is too much; returns whether it does.
    pub(crate) fn too_deep(&mut self, depth: f64, limit: f64, confirm_s: f64) -> bool {
        let settings = self.settings;
        let regime = &settings.regime;
        let least_time = matches!(settings.strategy.depth, PassDepth::LeastTime { .. });
        self.deep_s = if depth > DEEP * limit {
            self.deep_s + settings.period_s
        } else {
            0.0
        };
        if self.deep_s <= confirm_s {
            return false;
        }
        let out = self.out.point().position;
        let wanted = if least_time {
            self.part_of(out + depth).max(out + 0.25 * depth)
        } else {
            out + depth - regime.depth_back_off_mm
        };
        self.pass_out = wanted.max(out);
        // A depth that was not there for a revolution may be a transient.
        self.shoulder_mm = out + self.engagement.depth_mm();
        self.go(
            TurningState::BackOff,
            Reason::TooDeep {
                depth_mm: depth,
                limit_mm: DEEP * limit,
            },
        );
        true
    }

    pub(crate) fn back_off(&mut self, factor: f64) {
        let settings = self.settings;
        self.along.stop();
        self.out
            .aim(self.pass_out, settings.out_speed_mm_s * factor.min(1.0));
        if self.out.has_arrived() && self.along.is_at_rest() {
            let by = (self.pass_out - self.pass_highest).max(0.0);
            self.pass_highest = self.pass_highest.max(self.pass_out);
            // The shoulder that was left is parallel to the edge and not farther than this.
            let here = self.along.point().position;
            let shoulder = here + by / settings.tool.slope();
            let depth = self.shoulder_mm - self.pass_out;
            self.lose_contact();
            self.expect(shoulder, depth);
            self.cautious_to = Some(shoulder + CAUTION_MM);
            self.feed = 0.0;
            let out_mm = self.pass_out;
            if out_mm > settings.allowance_max_mm {
                self.draw_out();
                let reason = Reason::StockTooThick {
                    height_mm: out_mm,
                    reach_mm: settings.tool.reach_mm(),
                };
                self.go(TurningState::Fault, reason);
                return;
            }
            self.go(TurningState::Approach, Reason::AtDepth { out_mm });
        }
    }

    /// The depth from which two passes are faster than one.
    pub(crate) fn split_depth(&self) -> f64 {
        let regime = &self.settings.regime;
        let (mut low, mut high) = (regime.depth_full_feed_mm, regime.depth_max_mm);
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            if regime.fastest_passes(middle, self.settings.length_mm, self.overhead_rev) > 1 {
                high = middle;
            } else {
                low = middle;
            }
        }
        high
    }
}
