//! Backing off from a cut that is too deep.

use crate::controller::TurningController;
use crate::pass_watch::CAUTION_MM;
use crate::settings::PassDepth;
use crate::state::{Reason, TurningState};
use crate::tip_contact::Front;

/// Fraction of the deepest cut at which the tool backs off: the load is noisy.
const DEEP: f64 = 0.98;
/// Length of a cut after which it counts as level or not, mm.
const LEVEL_MM: f64 = 6.0;
/// Minimum fraction of a depth by which backing off is worthwhile.
const MIN_PART: f64 = 0.25;
/// Hard spots up to this factor of the load count neither as higher stock in the number of passes, nor as a
/// lost load at their end.
pub(crate) const HARDEST: f64 = 1.35;

impl TurningController {
    /// Deepest cut that is taken at once. With passes of least time, two passes are faster than a deeper cut.
    pub(crate) fn deepest(&self) -> f64 {
        match self.settings.strategy.depth {
            PassDepth::LeastTime { .. } => self.constants.split_mm,
            // A split needs at least two remaining passes, and stock that continues at the same height.
            PassDepth::Bounded { .. } if self.passes_left() > 1 && self.goes_on_level() => {
                self.constants.split_mm
            }
            _ => self.settings.regime.depth_max_mm,
        }
    }

    /// Backs off if the depth exceeds the limit for `confirm_s`; returns whether it does.
    pub(crate) fn too_deep(&mut self, depth: f64, limit: f64, confirm_s: f64) -> bool {
        let settings = self.settings;
        let regime = &settings.regime;
        let is_min_time = match settings.strategy.depth {
            PassDepth::LeastTime { .. } => true,
            PassDepth::Bounded { .. } => limit < regime.depth_max_mm,
            PassDepth::Final | PassDepth::KnownFinal => false,
        };
        self.pass_watch.deep_s = if depth > DEEP * limit {
            self.pass_watch.deep_s + settings.period_s
        } else {
            0.0
        };
        if self.pass_watch.deep_s <= confirm_s || self.is_load_falling() {
            return false;
        }
        // This near to its end, the cut would be over before the shoulder is felt again.
        let rest_mm = self.stock_end_mm() - self.along.point().position;
        if rest_mm < self.constants.detection_mm + regime.feed_min_mm_rev {
            return false;
        }
        let out = self.out.point().position;
        self.pass_watch.highest_felt_mm = self.pass_watch.highest_felt_mm.max(out + depth);
        let wanted = if is_min_time {
            self.part_of(out + depth).max(out + MIN_PART * depth)
        } else {
            out + depth - regime.depth_back_off_mm
        };
        self.plan.out_mm = wanted.max(out);
        // A depth that did not last for a revolution may be a transient.
        self.felt.shoulder_mm = out + self.felt.engagement.depth_mm();
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
            .aim(self.plan.out_mm, settings.out_speed_mm_s * factor.min(1.0));
        if self.out.has_arrived() && self.along.is_at_rest() {
            let by = (self.plan.out_mm - self.plan.highest_mm).max(0.0);
            self.plan.highest_mm = self.plan.highest_mm.max(self.plan.out_mm);
            // The remaining shoulder is parallel to the edge and at most this far away.
            let here = self.along.point().position;
            let shoulder = here + by / settings.tool.slope();
            let depth = self.felt.shoulder_mm - self.plan.out_mm;
            let front = match self.front_left(depth + by) {
                Front::Shoulder(_) => Front::Shoulder(shoulder),
                other => other,
            };
            self.lose_contact();
            self.felt.tip.set_front(front);
            self.require_stock(shoulder, depth);
            // A cut that was felt for less than a revolution, or that has slots, does not give the height of
            // the shoulder. The stock is there all the same, and has to be felt again before the job ends.
            self.felt.unproven_mm.get_or_insert(here.max(0.0));
            self.pass_watch.cautious_to_mm = Some(shoulder + CAUTION_MM);
            self.feed = 0.0;
            let out_mm = self.plan.out_mm;
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

    /// Passes that may still begin, the present one included, for stock of a height.
    fn passes_left_for(&self, height_mm: f64) -> u32 {
        match self.settings.strategy.depth {
            PassDepth::Bounded { extra } => {
                let ideal = self.settings.regime.passes(height_mm).max(1);
                (ideal + extra).saturating_sub(self.plan.number.saturating_sub(1))
            }
            _ => u32::MAX,
        }
    }

    /// The same for the height that was felt, in a split into parts. A high reading may come from hard stock,
    /// and each pass that ended at lower stock counts because such stock is not level. A gap does not count:
    /// it says nothing about the stock beside it.
    pub(crate) fn passes_left(&self) -> u32 {
        self.passes_left_for(self.pass_watch.highest_felt_mm / HARDEST)
            .saturating_sub(self.pass_watch.returned_low)
    }

    /// Whether a pass may end on a thin position: the stock ahead may be as high as what was felt.
    pub(crate) fn may_return(&self) -> bool {
        self.passes_left_for(self.pass_watch.highest_felt_mm)
            > self.settings.regime.passes(self.pass_watch.highest_felt_mm)
    }

    /// Whether the depth has been constant for a while, so that the rest of the pass is worth two passes.
    fn goes_on_level(&self) -> bool {
        let (from, depth) = self.felt.settled_mm;
        let here = self.along.point().position;
        let now = self.view.depth_mean_mm;
        let rest = (self.settings.length_mm - here).max(0.0);
        let distance = here - from;
        let out = self.out.point().position;
        // Extrapolates over half of the rest at the present slope. The remaining passes must allow a split.
        self.state == TurningState::Cut
            && distance >= LEVEL_MM
            && self.part_of(out + now) >= out + MIN_PART * now
            && now + 0.5 * rest * (now - depth) / distance >= DEEP * self.constants.split_mm
    }
}
