//! A missing load: a gap in the stock, or a cut that the sensor does not show.

use crate::climb::LoadAfter;
use crate::controller::{MIN_CHIP, TurningController};
use crate::state::{Reason, TurningState};

/// Revolutions without load after which it counts as lost.
pub(crate) const LOSS_REV: f64 = 1.1;
/// Depth at which a load must be felt, mm.
pub(crate) const SURE_MM: f64 = 0.5;
/// Distance back to where the load was felt before, mm.
const GONE_MM: f64 = 0.1;
/// Decrease of depth that the end of stock may cause at once, mm: noise of the load and the shape of the
/// chip.
const ABRUPT_MM: f64 = 0.3;
/// Excess above which a lost load stays unproven, because it may not be the end of stock, mm.
const GRADUAL_MM: f64 = 0.1;
/// Effect of noise on the depth at which the load of contact ends (factor), and on a depth that was felt
/// (fraction).
const NOISE: f64 = 1.3;
const DEPTH_NOISE: f64 = 0.06;
/// Revolutions for which a cut counts as interrupted after an interruption.
const INTERRUPTED_REV: f64 = 3.0;
/// Factor of the sensor's lag on the distance of an interruption.
const INTERRUPTION_NOISE: f64 = 1.3;
/// Fraction of the mean load of a revolution below which the load is falling to zero.
const FALLING: f64 = 0.5;
/// Load of a chip, in contact loads, above which its absence is noticed.
const CLEAR_LOADS: f64 = 2.0;

impl TurningController {
    /// Follows the load of a cut. If it has been missing for a revolution, the pass ends in a fault, or goes
    /// on as in air if the edge can have left the stock. Returns whether it does either.
    pub(crate) fn has_lost_load(&mut self) -> bool {
        match self.load_after() {
            LoadAfter::There => return false,
            LoadAfter::Broken { depth_mm } => self.report_broken(depth_mm),
            LoadAfter::Air => {
                let from = self.pass_watch.thin_from_mm;
                self.lose_contact();
                (self.felt.in_air, self.pass_watch.thin_from_mm) = (true, from);
                self.go(TurningState::Approach, Reason::Air);
            }
        }
        true
    }

    /// Follows the load of a cut and returns its state.
    pub(crate) fn load_after(&mut self) -> LoadAfter {
        let settings = self.settings;
        let turn_s = settings.turn_s();
        let (here, out) = (self.along.point().position, self.out.point().position);
        self.loss.interrupted_s = (self.loss.interrupted_s - settings.period_s).max(0.0);
        if self.view.now >= settings.contact_load_n {
            if self.loss.air_s > 0.0 {
                self.loss.interrupted_s = INTERRUPTED_REV * turn_s;
                self.loss.interruption_mm = self
                    .loss
                    .interruption_mm
                    .max(here - self.felt.engagement.position_mm());
            } else if self.loss.interrupted_s == 0.0 {
                self.loss.interruption_mm = 0.0;
            }
            self.loss.air_s = 0.0;
            self.loss.before_n = self.view.mean;
            let depth = self.view.depth_now_mm.min(self.view.depth_mean_mm);
            self.felt.engagement.feel(here, out, depth);
            return LoadAfter::There;
        }
        if self.shows_chips(self.felt.engagement.depth_mm()) {
            self.loss.air_s += settings.period_s;
        }
        if self.loss.air_s <= LOSS_REV * turn_s {
            return LoadAfter::There;
        }
        // In an interrupted cut the edge may have left the stock during an interruption.
        let left = self
            .felt
            .engagement
            .depth_after_mm(INTERRUPTION_NOISE * self.loss.interruption_mm);
        let law = &settings.regime.law;
        let unfelt = NOISE * law.depth_mm(settings.contact_load_n, self.trail.chip_mm().max(self.feed));
        // Stock must have been under the edge for the whole revolution, and not only at its end.
        let revolution_mm = self.trail.chip_mm().max(GONE_MM);
        let sure = self.sure_depth(GONE_MM).min(self.sure_depth(revolution_mm));
        if sure > SURE_MM || left > unfelt + ABRUPT_MM + DEPTH_NOISE * self.felt.grown_mm.0 {
            return LoadAfter::Broken {
                depth_mm: sure.max(left),
            };
        }
        if left > unfelt + GRADUAL_MM {
            self.felt
                .unproven_mm
                .get_or_insert(self.felt.engagement.position_mm());
        }
        LoadAfter::Air
    }

    /// Whether the load is missing or falling to zero. The depths of the revolution are then not those of the
    /// stock: the mean falls as at a thin position, and the deepest part exceeds the mean as in a growing
    /// cut. A pass that ended on them would hide a broken insert until the stock is met again.
    pub(crate) fn is_load_falling(&self) -> bool {
        let is_cut = self.felt.contact_mm.is_some();
        is_cut && (self.loss.air_s > 0.0 || self.view.now < FALLING * self.view.mean)
    }

    /// Whether the tool advances fast enough for a depth to show in the load.
    pub(crate) fn shows_chips(&self, depth_mm: f64) -> bool {
        let regime = &self.settings.regime;
        let chip = self.trail.chip_mm();
        chip >= MIN_CHIP * regime.feed_min_mm_rev
            || regime.law.load(depth_mm, chip) >= CLEAR_LOADS * self.settings.contact_load_n
    }

    /// Stock of a depth must be met before or at a position.
    pub(crate) fn require_stock(&mut self, position_mm: f64, depth_mm: f64) {
        self.felt.expected_mm = (depth_mm > SURE_MM).then_some((position_mm, depth_mm));
    }

    /// Depth of the stock that must have been met by now, mm.
    pub(crate) fn expected_depth(&self, here: f64) -> f64 {
        match self.felt.expected_mm {
            Some((position, depth)) if here >= position => depth,
            _ => 0.0,
        }
    }

    /// After a fault in a cut, keeps the shoulder, which is expected when the job continues.
    pub(crate) fn keep_shoulder(&mut self) {
        let depth = self.felt.engagement.depth_mm();
        let cuts = matches!(
            self.state,
            TurningState::Engage | TurningState::Cut | TurningState::Climb
        );
        if depth > SURE_MM && cuts {
            let (here, out) = (self.along.point().position, self.out.point().position);
            self.record.leave_shoulder(here, out + depth, true);
        }
    }
}
