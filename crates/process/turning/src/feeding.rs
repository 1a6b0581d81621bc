//! Feeding: towards the stock, into it, and along it.

use crate::controller::TurningController;
use crate::missing::SURE_MM;
use crate::settings::{OnThin, PassDepth};
use crate::state::{Reason, TurningState};

/// Time constants of the sensor for which a growing cut is taken to go on growing.
const AHEAD_LAGS: f64 = 2.0;
/// Share of the depth at full feed below which a place is thin.
const THIN: f64 = 0.97;
/// Largest growth over the way below that counts as settled, as a share of the depth.
const GROWTH: f64 = 0.02;
/// Revolutions of contact after which the cut is known again.
const KNOWN_REV: f64 = 1.5;
/// Shortest way that is worth a move in rapid, mm.
const MIN_FREE_MM: f64 = 3.0;
/// Time for which the growing depth must be too much before it is backed off from, s.
const ENGAGE_CONFIRM_S: f64 = 0.005;
/// Way beyond where contact is expected after which caution ends, mm.
const CAUTION_MM: f64 = 1.5;
/// Way before known stock at which the feed is reduced, mm.
const WATCH_MM: f64 = 0.5;
/// Way into known stock after which a load must be there, mm: what stands is recorded in cells.
const MET_MM: f64 = 0.2;
/// Way ahead over which the record must say what may stand, mm.
const BOUND_MM: f64 = 2.0;
/// Of the depth that the set load permits in a steady cut, what may be met at once.
const DEPTH_OF_ENTRY: f64 = 0.9;
/// What must be left of the edge above the stock at its face, mm.
const HOLDER_MM: f64 = 0.3;

impl TurningController {
    /// Feeds with a wish, within slew, preview, protection and override.
    pub(crate) fn drive(&mut self, wish: f64, factor: f64) {
        self.limit_feed(wish);
        let speed = self.settings.speed_mm_s(self.feed) * factor.min(1.0);
        self.along.aim(self.pass_end_mm(), speed);
    }

    /// The feed after a period, for a wish: within slew, preview and protection.
    pub(crate) fn limit_feed(&mut self, wish: f64) {
        let settings = &self.settings;
        let regime = &settings.regime;
        let mut wish = wish.min(regime.feed_max_mm_rev);
        if settings.strategy.preview {
            wish = wish.min(self.preview());
        }
        if let Some(to) = self.places.cautious_to_mm {
            if self.along.point().position < to {
                wish = wish.min(settings.strategy.resume_feed_mm_rev);
            } else {
                self.places.cautious_to_mm = None;
            }
        }
        if self.guard.blind_s > 0.0 {
            wish = regime.feed_min_mm_rev;
        }
        wish = wish.max(regime.feed_min_mm_rev);
        let up = self.feed + settings.slew_up_mm_rev_s * settings.period_s;
        let down = self.feed - settings.slew_down_mm_rev_s * settings.period_s;
        // From a stand the smallest feed is taken at once.
        self.feed = wish.clamp(down, up.max(regime.feed_min_mm_rev));
    }

    /// Largest feed for what earlier passes have left ahead.
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
            if self.places.cautious_to_mm.is_some() {
                let turns = KNOWN_REV + 2.0 * settings.sensor_lag_s / settings.turn_s();
                self.places.cautious_to_mm = Some(here + turns * settings.strategy.resume_feed_mm_rev);
            }
            let load = self.view.now;
            if let Some(reason) = self.face_felt(here) {
                return self.leave_for(reason);
            }
            self.plan.is_touched = true;
            self.loss.missing_s = 0.0;
            self.felt.expected_mm = None;
            (self.felt.in_air, self.places.thin_from_mm) = (false, None);
            self.go(TurningState::Engage, Reason::Contact { load });
            return;
        }
        if self.misses_load(here) {
            return;
        }
        // Air inside a pass is a thin place too.
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

    /// Feed towards stock that has not been felt: what may stand there by the record is taken at the set load
    /// at once.
    pub(crate) fn approach_feed(&self, here: f64) -> f64 {
        let settings = &self.settings;
        let entry = settings.strategy.entry_feed_mm_rev;
        if !settings.strategy.preview || self.places.cautious_to_mm.is_some() {
            return entry;
        }
        // Beyond a gap the stock is met as it was left: growing along the lead angle, by an edge that has
        // just been felt.
        if self.felt.in_air {
            return settings.regime.feed_max_mm_rev;
        }
        let out = self.out.point().position;
        let bound = self.record.bound_ahead_mm(here, out, BOUND_MM);
        bound.map_or(entry, |depth| {
            entry.max(settings.regime.feed_mm_rev(depth / DEPTH_OF_ENTRY))
        })
    }

    /// How far the tool may go in rapid: where it is known that nothing stands in the way.
    pub(crate) fn free_way(&self, here: f64) -> Option<f64> {
        let settings = &self.settings;
        if !settings.strategy.preview || self.places.cautious_to_mm.is_some() {
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

    /// Depth that must be felt now: what stands for sure where the tip was `behind_mm` before.
    pub(crate) fn sure_depth(&self, behind_mm: f64) -> f64 {
        let (along, out) = (self.along.point().position, self.out.point().position);
        self.record.depth_ahead_mm(along, out, -behind_mm, true)
    }

    /// Depth that must have been felt by now: known stock, and what was felt before, mm.
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

    /// The first time that the face is felt, its place tells how high the stock is.
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
                self.places.highest_felt_mm = self
                    .places
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
        // What has grown over a revolution goes on growing while the chip forms and the sensor lags.
        let turns = settings.strategy.anticipation_rev * (1.0 + AHEAD_LAGS * settings.sensor_lag_s / turn_s);
        let ahead = self.view.depth_now_mm + turns * self.view.growth_mm;
        self.drive(regime.feed_mm_rev(depth.max(ahead)), factor);
        self.end_of_pass();
    }

    /// How far ahead what is known was planned for, mm.
    fn ahead_mm(&self) -> f64 {
        self.settings.tool.overhang_mm() + CAUTION_MM
    }

    /// Whether what lies ahead is known: the pass was planned for it, thin places and all.
    fn knows_ahead(&self, here: f64) -> bool {
        self.record.at(here + self.ahead_mm()).known
    }

    /// Watches for a thin place, and leaves it if that is wanted; returns whether it does.
    pub(crate) fn thin(&mut self, thin: bool, depth_mm: f64) -> bool {
        let settings = self.settings;
        let (here, out) = (self.along.point().position, self.out.point().position);
        let from = match (thin, self.places.thin_from_mm) {
            (true, Some(from)) => from,
            (true, None) => here,
            (false, _) => {
                self.places.thin_from_mm = None;
                return false;
            }
        };
        self.places.thin_from_mm = Some(from);
        if here - from <= settings.thin_mm || out <= settings.tolerance_mm || self.is_load_falling() {
            return false;
        }
        let leaves = match settings.strategy.on_thin {
            OnThin::Continue => false,
            OnThin::Return => true,
            OnThin::ReturnUpTo(most) => {
                self.places.returned_thin < most && self.may_return() && !self.knows_ahead(here)
            }
            OnThin::ReturnIfSaved => {
                // What is this thin costs no further pass if it is left.
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
            self.places.returned_thin = self.places.returned_thin.saturating_add(1);
            self.places.returned_low = self
                .places
                .returned_low
                .saturating_add(u32::from(!self.felt.in_air));
            self.record.leave_shoulder(here, out + depth_mm, false);
            self.begin_return(TurningState::ReEnter, Reason::TooThin { depth_mm });
        }
        leaves
    }

    /// At the end the tool stays for a revolution, so that the last of the cut is round.
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

    /// The pass is over: the way back, or a fault where it has shown that something is wrong.
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
