//! Feeding: towards the stock, into it, and along it.

use crate::adaptive::AHEAD_LAGS;
use crate::controller::TurningController;
use crate::missing::SURE_MM;
use crate::pass_watch::CAUTION_MM;
use crate::settings::{OnThin, PassDepth};
use crate::state::{Reason, TurningState};

/// Fraction of the depth at full feed below which a position is thin.
const THIN: f64 = 0.97;
/// Maximum growth of a depth that counts as settled, as a fraction of the depth.
const GROWTH: f64 = 0.02;
/// Revolutions of contact after which the cut is known again.
const KNOWN_REV: f64 = 1.5;
/// Minimum distance that is worth a rapid move, mm.
const MIN_FREE_MM: f64 = 3.0;
/// Time for which a growing depth must be too large before the tool backs off, s.
const ENGAGE_CONFIRM_S: f64 = 0.005;
/// Distance before known stock at which the feed is reduced, mm.
const WATCH_MM: f64 = 0.5;
/// Distance into known stock at which there must be a load, mm: the record has cells of finite width.
const MET_MM: f64 = 0.2;
/// Distance ahead over which the record must bound the stock, mm.
const BOUND_MM: f64 = 2.0;
/// Fraction of the depth for the set load in a steady cut that a first contact may have.
const DEPTH_OF_ENTRY: f64 = 0.9;
/// Minimum length of the edge above the stock at its face, mm.
const HOLDER_MM: f64 = 0.3;

impl TurningController {
    /// Feeds at the requested `wish`, within the limits of slew rate, preview, protection and override.
    pub(crate) fn drive(&mut self, wish: f64, factor: f64) {
        self.limit_feed(wish);
        let speed = self.settings.speed_mm_s(self.feed) * factor.min(1.0);
        self.along.aim(self.pass_end_mm(), speed);
    }

    /// Moves the feed towards the requested `wish` for one period, within the limits of slew rate, preview and
    /// protection.
    pub(crate) fn limit_feed(&mut self, wish: f64) {
        let settings = &self.settings;
        let regime = &settings.regime;
        let mut wish = wish.min(regime.feed_max_mm_rev);
        if settings.strategy.preview {
            wish = wish.min(self.preview());
        }
        if let Some(to) = self.pass_watch.cautious_to_mm {
            if self.along.point().position < to {
                wish = wish.min(settings.strategy.resume_feed_mm_rev);
            } else {
                self.pass_watch.cautious_to_mm = None;
            }
        }
        if self.guard.blind_s > 0.0 {
            wish = regime.feed_min_mm_rev;
        }
        wish = wish.max(regime.feed_min_mm_rev);
        let up = self.feed + settings.slew_up_mm_rev_s * settings.period_s;
        let down = self.feed - settings.slew_down_mm_rev_s * settings.period_s;
        // From rest, the feed starts at its minimum.
        self.feed = wish.clamp(down, up.max(regime.feed_min_mm_rev));
    }

    /// Largest feed for the stock ahead that earlier passes have left.
    pub(crate) fn preview(&self) -> f64 {
        let settings = &self.settings;
        let (along, out) = (self.along.point().position, self.out.point().position);
        let ahead = WATCH_MM + 1.5 * self.feed;
        let depth = self.record.depth_ahead_mm(along, out, ahead, false);
        settings.regime.feed_mm_rev(depth)
    }

    pub(crate) fn approach(&mut self, factor: f64) {
        let settings = self.settings;
        let here = self.along.point().position;
        if self.feels() && self.view.trouble.is_none() {
            self.felt.contact_mm = Some(here);
            self.felt.grown_mm = (0.0, here);
            if self.pass_watch.cautious_to_mm.is_some() {
                let turns = KNOWN_REV + 2.0 * settings.sensor_lag_s / settings.turn_s();
                self.pass_watch.cautious_to_mm = Some(here + turns * settings.strategy.resume_feed_mm_rev);
            }
            let load = self.view.now;
            if let Some(reason) = self.face_felt(here) {
                return self.leave_for(reason);
            }
            self.plan.is_touched = true;
            self.loss.missing_s = 0.0;
            self.felt.expected_mm = None;
            (self.felt.in_air, self.pass_watch.thin_from_mm) = (false, None);
            self.go(TurningState::Engage, Reason::Contact { load });
            return;
        }
        if self.misses_load(here) {
            return;
        }
        // Air inside a pass counts as a thin position.
        let gap = self.felt.in_air && here > 0.0;
        if self.thin(gap, 0.0) {
            return;
        }
        if let Some(free) = self.free_way(here) {
            self.along.aim(free, settings.rapid_mm_s * factor.min(1.0));
            return;
        }
        self.drive(self.approach_feed(here), factor);
        self.end_of_pass();
    }

    /// Feed towards stock that has not been felt: the entry feed, or a higher one if the record bounds the
    /// depth and the set load permits it.
    pub(crate) fn approach_feed(&self, here: f64) -> f64 {
        let settings = &self.settings;
        let entry = settings.strategy.entry_feed_mm_rev;
        if !settings.strategy.preview || self.pass_watch.cautious_to_mm.is_some() {
            return entry;
        }
        // After a gap the depth grows along the lead angle as before it, and the edge is intact because it
        // was just felt.
        if self.felt.in_air {
            return settings.regime.feed_max_mm_rev;
        }
        let out = self.out.point().position;
        let bound = self.record.bound_ahead_mm(here, out, BOUND_MM);
        bound.map_or(entry, |depth| {
            entry.max(settings.regime.feed_mm_rev(depth / DEPTH_OF_ENTRY))
        })
    }

    /// Target of a rapid move, before which the tool is known to be clear of stock.
    pub(crate) fn free_way(&self, here: f64) -> Option<f64> {
        let settings = &self.settings;
        if !settings.strategy.preview || self.pass_watch.cautious_to_mm.is_some() {
            return None;
        }
        let out = self.out.point().position;
        let stock = self
            .record
            .next_above(here, out + 1e-9)
            .unwrap_or(f64::INFINITY)
            .min(self.pass_end_mm());
        let clear = self.record.clear_place_mm(stock, out) - settings.clear_along_mm;
        (clear - here > MIN_FREE_MM
            || (self.along.target() == clear && !self.along.has_arrived() && clear > here))
            .then_some(clear)
    }

    /// Minimum depth that must be felt now: known stock at the position of the tip `behind_mm` ago.
    pub(crate) fn sure_depth(&self, behind_mm: f64) -> f64 {
        let (along, out) = (self.along.point().position, self.out.point().position);
        self.record.depth_ahead_mm(along, out, -behind_mm, true)
    }

    /// Depth that must have been felt by now, mm: known stock, and stock that was felt before.
    pub(crate) fn depth_to_be_met(&self, here: f64) -> f64 {
        self.sure_depth(MET_MM).max(self.expected_depth(here))
    }

    pub(crate) fn report_broken(&mut self, depth_mm: f64) {
        let before = self.loss.before_n;
        let (here, out) = (self.along.point().position, self.out.point().position);
        self.record.leave_shoulder(here, out + depth_mm, true);
        self.draw_out();
        self.go(TurningState::Fault, Reason::BrokenInsert { before, depth_mm });
    }

    /// On the first contact with the face, its position gives the height of the stock.
    pub(crate) fn face_felt(&mut self, here: f64) -> Option<Reason> {
        let settings = self.settings;
        let out = self.out.point().position;
        if self.plan.is_touched || self.plan.number != 1 || !self.record.is_blank() {
            return None;
        }
        let height = out + (self.constants.detection_mm - here).max(0.0) * settings.tool.slope();
        if height - out > settings.tool.reach_mm() - HOLDER_MM {
            return Some(Reason::StockTooThick {
                height_mm: height,
                reach_mm: settings.tool.reach_mm(),
            });
        }
        let PassDepth::LeastTime { face_is_known: true } = settings.strategy.depth else {
            return None;
        };
        let wanted = self.part_of(height);
        if wanted <= out + settings.tolerance_mm {
            return None;
        }
        self.plan.out_mm = wanted;
        self.felt.shoulder_mm = height;
        Some(Reason::FaceFelt { height_mm: height })
    }

    pub(crate) fn leave_for(&mut self, reason: Reason) {
        if matches!(reason, Reason::StockTooThick { .. }) {
            self.draw_out();
            self.go(TurningState::Fault, reason);
        } else {
            self.plan.is_touched = true;
            self.go(TurningState::BackOff, reason);
        }
    }

    pub(crate) fn engage(&mut self, factor: f64) {
        let settings = self.settings;
        let here = self.along.point().position;
        if self.has_lost_load() {
            return;
        }
        if self.felt.engagement.depth_mm() > SURE_MM {
            self.felt.unproven_mm = None;
        }
        let depth = self.view.depth_now_mm.max(self.view.depth_mm);
        if depth > self.felt.grown_mm.0 * (1.0 + GROWTH) {
            self.felt.grown_mm = (depth, here);
        }
        if self.too_deep(
            self.view.depth_now_mm,
            settings.regime.depth_max_mm,
            ENGAGE_CONFIRM_S,
        ) {
            return;
        }
        let since = here - self.felt.grown_mm.1;
        let whole = self.felt.contact_mm.is_none_or(|contact| {
            here - contact > settings.tool.overhang_mm() + settings.regime.feed_max_mm_rev
        });
        if since > KNOWN_REV * self.feed.max(settings.regime.feed_min_mm_rev) || whole {
            let depth_mm = self.view.depth_mm;
            if !self.too_deep(depth_mm, self.deepest(), 0.0) {
                self.pass_watch.highest_felt_mm = self
                    .pass_watch
                    .highest_felt_mm
                    .max(self.out.point().position + depth_mm);
                self.felt.settled_mm = (here, depth_mm);
                self.felt.unproven_mm = None;
                self.go(TurningState::Cut, Reason::Settled { depth_mm });
            }
            return;
        }
        let turns = settings.strategy.anticipation_rev * (1.0 + settings.sensor_lag_s / settings.turn_s());
        let growth = turns * settings.tool.slope() * self.feed;
        self.drive(settings.regime.feed_mm_rev(depth + growth), factor);
        self.end_of_pass();
    }

    pub(crate) fn cut(&mut self, factor: f64) {
        let settings = self.settings;
        let regime = &settings.regime;
        let turn_s = settings.turn_s();
        if self.has_lost_load() {
            return;
        }
        let depth = self.view.depth_mm;
        if self.too_deep(depth, self.deepest(), settings.confirm_s) {
            return;
        }
        let thin = depth < THIN * regime.depth_full_feed_mm && self.feed >= 0.999 * regime.feed_max_mm_rev;
        if self.thin(thin, depth) {
            return;
        }
        // Growth over the last revolution is extrapolated over the sensor's lag and the revolution in which
        // the chip forms.
        let turns = settings.strategy.anticipation_rev * (1.0 + AHEAD_LAGS * settings.sensor_lag_s / turn_s);
        let ahead = self.view.depth_now_mm + turns * self.view.growth_mm;
        self.drive(regime.feed_mm_rev(depth.max(ahead)), factor);
        self.end_of_pass();
    }

    /// Distance ahead for which the known stock was planned, mm.
    fn ahead_mm(&self) -> f64 {
        self.settings.tool.overhang_mm() + CAUTION_MM
    }

    /// Whether the stock ahead is known: the pass was planned for it, thin positions included.
    fn knows_ahead(&self, here: f64) -> bool {
        self.record.at(here + self.ahead_mm()).known
    }

    /// Monitors a thin position and leaves it if the strategy requires that; returns whether it does.
    pub(crate) fn thin(&mut self, thin: bool, depth_mm: f64) -> bool {
        let settings = self.settings;
        let (here, out) = (self.along.point().position, self.out.point().position);
        let from = match (thin, self.pass_watch.thin_from_mm) {
            (true, Some(from)) => from,
            (true, None) => here,
            (false, _) => {
                self.pass_watch.thin_from_mm = None;
                return false;
            }
        };
        self.pass_watch.thin_from_mm = Some(from);
        if here - from <= settings.thin_mm || out <= settings.tolerance_mm || self.is_load_falling() {
            return false;
        }
        let leaves = match settings.strategy.on_thin {
            OnThin::Continue => false,
            OnThin::Return => true,
            OnThin::ReturnUpTo(max) => {
                self.pass_watch.returned_thin < max && self.may_return() && !self.knows_ahead(here)
            }
            OnThin::ReturnIfSaved => {
                // Stock this thin costs no further pass if it is left.
                let length = (settings.length_mm - here).max(0.0);
                let passes = |height| {
                    settings
                        .regime
                        .fastest_passes(height, length, self.constants.overhead_rev)
                };
                passes(out + depth_mm) <= passes(out)
                    && here + self.ahead_mm() < settings.length_mm
                    && !self.knows_ahead(here)
            }
        };
        if leaves {
            self.pass_watch.returned_thin = self.pass_watch.returned_thin.saturating_add(1);
            self.pass_watch.returned_low = self
                .pass_watch
                .returned_low
                .saturating_add(u32::from(!self.felt.in_air));
            self.record.leave_shoulder(here, out + depth_mm, false);
            self.begin_return(TurningState::ReEnter, Reason::TooThin { depth_mm });
        }
        leaves
    }

    /// Dwells at the end for a revolution, so that the end of the cut is round.
    pub(crate) fn end_of_pass(&mut self) {
        let settings = self.settings;
        if !self.along.has_arrived() || self.along.target() < self.pass_end_mm() {
            self.plan.end_s = 0.0;
            return;
        }
        self.plan.end_s += settings.period_s;
        if self.plan.end_s >= settings.dwell_s() && !self.begin_climb() {
            self.finish_pass();
        }
    }

    /// Ends the pass: returns, or enters a fault if the pass showed that something is wrong.
    pub(crate) fn finish_pass(&mut self) {
        let settings = self.settings;
        if self.plan.meets_unknown && !self.plan.is_touched && self.plan.out_mm <= settings.tolerance_mm {
            self.record.forget_from(self.plan.start_mm.max(0.0));
            self.draw_out();
            self.go(TurningState::Fault, Reason::NoStock);
            return;
        }
        if let Some(along_mm) = self.felt.unproven_mm
            && self.record.first_above(settings.tolerance_mm).is_none()
        {
            self.record.forget_from(along_mm);
            self.draw_out();
            self.go(TurningState::Fault, Reason::LoadStaysAway { along_mm });
            return;
        }
        self.begin_return(TurningState::Return, Reason::EndOfPass);
    }
}
