//! Backing off from a cut that is too deep.

use crate::controller::TurningController;
use crate::settings::PassDepth;
use crate::state::{Reason, TurningState};
use crate::tip_contact::Front;

/// Share of the deepest cut at which it is backed off from: the load is noisy.
const DEEP: f64 = 0.98;
/// Distance of a cut after which it is decided whether it is level, mm.
const LEVEL_MM: f64 = 6.0;
/// Least part of a depth that is worth backing off by.
const MIN_PART: f64 = 0.25;
/// Hard spots up to this factor of the load are not taken for higher stock where passes are counted, nor for
/// a lost load where they end.
pub(crate) const HARDEST: f64 = 1.35;
/// Way beyond where contact is expected after which caution ends, mm.
const CAUTION_MM: f64 = 1.5;

impl TurningController {
    /// Deepest cut that is taken at once: in passes of least time, what two passes would not do faster.
    pub(crate) fn deepest(&self) -> f64 {
        match self.settings.strategy.depth {
            PassDepth::LeastTime { .. } => self.constants.split_mm,
            // Two parts must be left for it to be split, and the stock must go on as high as it is.
            PassDepth::Bounded { .. } if self.passes_left() > 1 && self.goes_on_level() => {
                self.constants.split_mm
            }
            _ => self.settings.regime.depth_max_mm,
        }
    }

    /// Backs off from a depth that is too much; returns whether it does.
    pub(crate) fn too_deep(&mut self, depth: f64, limit: f64, confirm_s: f64) -> bool {
        let settings = self.settings;
        let regime = &settings.regime;
        let least_time = match settings.strategy.depth {
            PassDepth::LeastTime { .. } => true,
            PassDepth::Bounded { .. } => limit < regime.depth_max_mm,
            PassDepth::Final | PassDepth::KnownFinal => false,
        };
        self.places.deep_s = if depth > DEEP * limit {
            self.places.deep_s + settings.period_s
        } else {
            0.0
        };
        if self.places.deep_s <= confirm_s || self.is_load_falling() {
            return false;
        }
        // So near to its end the cut is through before its shoulder would be felt again.
        let rest_mm = self.stock_end_mm() - self.along.point().position;
        if rest_mm < self.constants.detection_mm + regime.feed_min_mm_rev {
            return false;
        }
        let out = self.out.point().position;
        self.places.highest_felt_mm = self.places.highest_felt_mm.max(out + depth);
        let wanted = if least_time {
            self.part_of(out + depth).max(out + MIN_PART * depth)
        } else {
            out + depth - regime.depth_back_off_mm
        };
        self.plan.out_mm = wanted.max(out);
        // A depth that was not there for a revolution may be a transient.
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
            // The shoulder that was left is parallel to the edge and not farther than this.
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
            // A cut that was not felt for a whole revolution, or had slots, does not tell how high the
            // shoulder is. What was felt stands all the same, and is felt again before the job ends.
            self.felt.unproven_mm.get_or_insert(here.max(0.0));
            self.places.cautious_to_mm = Some(shoulder + CAUTION_MM);
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

    /// Passes that may still be begun, the present one among them, for stock of a height.
    fn passes_left_for(&self, height_mm: f64) -> u32 {
        match self.settings.strategy.depth {
            PassDepth::Bounded { extra } => {
                let ideal = self.settings.regime.passes(height_mm).max(1);
                (ideal + extra).saturating_sub(self.plan.number.saturating_sub(1))
            }
            _ => u32::MAX,
        }
    }

    /// The same for what was felt, for parts of a height: what reads higher may only be harder, and stock
    /// that was lower in places is not level. A gap tells nothing of what stands beside it.
    pub(crate) fn passes_left(&self) -> u32 {
        self.passes_left_for(self.places.highest_felt_mm / HARDEST)
            .saturating_sub(self.places.returned_low)
    }

    /// Whether a pass may be ended on a thin place: what is ahead may be as high as what was felt.
    pub(crate) fn may_return(&self) -> bool {
        self.passes_left_for(self.places.highest_felt_mm)
            > self.settings.regime.passes(self.places.highest_felt_mm)
    }

    /// Whether the cut has been as deep for a while, so that what is left of the pass is worth two passes.
    fn goes_on_level(&self) -> bool {
        let (from, depth) = self.felt.settled_mm;
        let here = self.along.point().position;
        let now = self.view.depth_mean_mm;
        let rest = (self.settings.length_mm - here).max(0.0);
        let way = here - from;
        let out = self.out.point().position;
        // Half of the rest at the present slope; and the passes that are left must make parts of it.
        self.state == TurningState::Cut
            && way >= LEVEL_MM
            && self.part_of(out + now) >= out + MIN_PART * now
            && now + 0.5 * rest * (now - depth) / way >= DEEP * self.constants.split_mm
    }
}
