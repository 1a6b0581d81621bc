//! Self-programmed turning: the controller that finds its passes from the load.

use crate::axis::{AxisDrive, AxisPoint};
use crate::record::SizeRecord;
use crate::sensor::LoadSample;
use crate::settings::{OnThin, PassDepth, SettingsError, TurningSettings};
use crate::state::{Reason, Transition, TurningState};
use crate::trail::Trail;
use crate::watch::{LoadView, LoadWatch};

/// Share of the deepest cut at which it is backed off from: the load is noisy.
const DEEP: f64 = 0.98;
/// Share of the depth at full feed below which a place is thin.
const THIN: f64 = 0.97;
/// Largest growth over the way below that counts as settled, as a share of the depth.
const GROWTH: f64 = 0.02;
/// Revolutions of contact after which the cut is known again.
const KNOWN_REV: f64 = 1.5;
/// Revolutions for which the feed goes on at its smallest without a reading.
const BLIND_REV: f64 = 0.5;
/// Shortest way that is worth a move in rapid, mm.
const LEAST_FREE_MM: f64 = 3.0;
/// Time for which the growing depth must be too much before it is backed off from, s.
const ENGAGE_CONFIRM_S: f64 = 0.005;
/// Way beyond where contact is expected after which caution ends, mm.
const CAUTION_MM: f64 = 1.5;
/// Way before known stock at which the load is waited for, mm.
const WATCH_MM: f64 = 0.5;
/// Depth of known stock in which a load must be felt, mm.
const SURE_MM: f64 = 0.5;
/// More passes than these are a fault.
const MOST_PASSES: u32 = 1000;

/// What comes into a cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TurningInputs {
    /// The newest reading of the load; the same again where there is no newer one.
    pub load: Option<LoadSample>,
    /// Start, or start again after a fault.
    pub start: bool,
    /// Stand while this is set.
    pub hold: bool,
    /// Feed override, 1 at 100 %. It slows everything; it never lifts the feed above what the set load allows.
    pub feed_override: f64,
}

impl Default for TurningInputs {
    fn default() -> Self {
        Self {
            load: None,
            start: true,
            hold: false,
            feed_override: 1.0,
        }
    }
}

/// What a cycle gives out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TurningOutput {
    /// Place along the cut.
    pub along: AxisPoint,
    /// Height above the final size.
    pub out: AxisPoint,
    /// State.
    pub state: TurningState,
    /// Feed that is wished for, mm/rev; 0 where the tool does not cut.
    pub feed_mm_rev: f64,
    /// Depth reckoned with, mm.
    pub depth_mm: f64,
    /// Smoothed load.
    pub load: f64,
    /// Number of the pass, from 1.
    pub pass: u32,
    /// The change of state in this cycle.
    pub transition: Option<Transition>,
}

/// Parts of the way back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Leg {
    Out,
    Back,
    In,
}

/// The controller. [`TurningController::step`] allocates nothing, looks at no clock, and is bounded: the cycle may call
/// it.
#[derive(Clone, Debug)]
pub struct TurningController {
    settings: TurningSettings,
    along: AxisDrive,
    out: AxisDrive,
    trail: Trail,
    watch: LoadWatch,
    record: SizeRecord,
    state: TurningState,
    before_hold: TurningState,
    leg: Leg,
    leg_out: f64,
    cycle: u64,
    pass: u32,
    transition: Option<Transition>,
    view: LoadView,
    feed: f64,
    /// Height of the present pass, and the highest that the tool has been at in it.
    pass_out: f64,
    pass_highest: f64,
    pass_start: f64,
    pass_end: f64,
    /// Depth that the record or the face promises for the present pass; none where nothing is known.
    promised: Option<f64>,
    /// Place of contact; none in air.
    contact: Option<f64>,
    touched: bool,
    /// In a gap of the stock.
    air: bool,
    /// Largest depth since contact and where it was reached.
    grown: (f64, f64),
    /// The feed stays at the one of resumption until this place.
    cautious_to: Option<f64>,
    deep_s: f64,
    thin_from: Option<f64>,
    air_s: f64,
    loss_s: f64,
    load_before: f64,
    end_s: f64,
    overload_s: f64,
    blind_s: f64,
    overhead_rev: f64,
    split_mm: f64,
    detection_mm: f64,
}

impl TurningController {
    /// Sets up, at rest at the start: before the stock and outside of it.
    ///
    /// # Errors
    /// What [`TurningSettings::check`] refuses.
    pub fn new(settings: TurningSettings) -> Result<Self, SettingsError> {
        settings.check()?;
        let regime = &settings.regime;
        let start = (
            -settings.tool.overhang_mm() - settings.clear_along_mm,
            settings.allowance_max_mm + settings.clear_out_mm,
        );
        let turn = settings.turn_s();
        let overhead_s = settings.length_mm / settings.rapid_mm_s
            + 2.0 * (settings.clear_out_mm + regime.depth_back_off_mm) / settings.out_speed_mm_s
            + 3.0 * settings.clear_along_mm / settings.speed_mm_s(regime.feed_max_mm_rev)
            + turn;
        let mut controller = Self {
            along: AxisDrive::new(start.0, &settings.along_limits),
            out: AxisDrive::new(start.1, &settings.out_limits),
            trail: Trail::new(turn / settings.period_s, settings.sensor_lag_s / settings.period_s, start),
            watch: LoadWatch::new(
                regime.law,
                regime.set_load,
                settings.contact_load,
                settings.period_s,
                turn,
                settings.sensor_stale_s,
            ),
            record: SizeRecord::new(settings.length_mm, settings.tool.slope(), settings.tool.overhang_mm()),
            state: TurningState::Idle,
            before_hold: TurningState::Idle,
            leg: Leg::Out,
            leg_out: start.1,
            cycle: 0,
            pass: 0,
            transition: None,
            view: LoadView {
                now: 0.0,
                mean: 0.0,
                peak: 0.0,
                depth_now_mm: 0.0,
                depth_mean_mm: 0.0,
                depth_mm: 0.0,
                trouble: None,
            },
            feed: 0.0,
            pass_out: 0.0,
            pass_highest: start.1,
            pass_start: start.0,
            pass_end: settings.length_mm,
            promised: None,
            contact: None,
            touched: false,
            air: false,
            grown: (0.0, 0.0),
            cautious_to: None,
            deep_s: 0.0,
            thin_from: None,
            air_s: 0.0,
            loss_s: 0.0,
            load_before: 0.0,
            end_s: 0.0,
            overload_s: 0.0,
            blind_s: 0.0,
            overhead_rev: overhead_s / turn,
            split_mm: regime.depth_max_mm,
            detection_mm: 0.0,
            settings,
        };
        controller.split_mm = controller.split_depth();
        controller.detection_mm = controller.detection();
        Ok(controller)
    }

    /// The depth from which two passes are faster than one.
    fn split_depth(&self) -> f64 {
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

    /// How far the tool goes in at the entry feed until the load of contact is reached, mm: the chip is then as thick as
    /// the way gone.
    fn detection(&self) -> f64 {
        let (law, slope) = (&self.settings.regime.law, self.settings.tool.slope());
        let (mut low, mut high) = (0.0, self.settings.strategy.entry_feed_mm_rev);
        for _ in 0..40 {
            let way = 0.5 * (low + high);
            if law.load(way * slope, 0.5 * way) < self.settings.contact_load {
                low = way;
            } else {
                high = way;
            }
        }
        let speed = self.settings.speed_mm_s(self.settings.strategy.entry_feed_mm_rev);
        high + speed * self.settings.sensor_lag_s
    }

    /// The record of what still stands.
    #[must_use]
    pub fn record(&self) -> &SizeRecord {
        &self.record
    }

    /// The settings.
    #[must_use]
    pub fn settings(&self) -> &TurningSettings {
        &self.settings
    }

    /// The state.
    #[must_use]
    pub fn state(&self) -> TurningState {
        self.state
    }

    /// Whether nothing moves any more.
    #[must_use]
    pub fn is_over(&self) -> bool {
        matches!(self.state, TurningState::Done | TurningState::Fault)
            && self.along.is_at_rest()
            && self.out.is_at_rest()
    }

    /// One control period. Real-time safe.
    pub fn step(&mut self, inputs: &TurningInputs) -> TurningOutput {
        self.transition = None;
        let least_chip = 0.4 * self.settings.regime.feed_min_mm_rev;
        self.view = self.watch.step(inputs.load, self.trail.chip_mm(), least_chip);
        let factor = if inputs.feed_override > 0.0 {
            inputs.feed_override.min(2.0)
        } else {
            0.0
        };
        if !self.protect(inputs) {
            self.act(inputs, factor);
        }
        let along = self.along.advance(self.settings.period_s);
        let out = self.out.advance(self.settings.period_s);
        self.trail.push(along.position, out.position);
        if self.feeds() {
            let (cut_along, cut_out) = self.trail.turn_ago();
            let felt = self.view.now > self.settings.contact_load;
            self.record
                .sweep(cut_along, cut_out, felt, felt && self.state == TurningState::Cut);
        }
        self.cycle += 1;
        TurningOutput {
            along,
            out,
            state: self.state,
            feed_mm_rev: if self.feeds() { self.feed } else { 0.0 },
            depth_mm: if self.contact.is_some() { self.view.depth_mm } else { 0.0 },
            load: self.view.now,
            pass: self.pass,
            transition: self.transition,
        }
    }

    /// Whether the tool is where stock may be.
    fn feeds(&self) -> bool {
        matches!(
            self.state,
            TurningState::Approach | TurningState::Engage | TurningState::Cut | TurningState::BackOff
        )
    }

    fn go(&mut self, to: TurningState, reason: Reason) {
        self.transition = Some(Transition {
            cycle: self.cycle,
            from: self.state,
            to,
            reason,
            along_mm: self.along.point().position,
            out_mm: self.out.point().position,
            load: self.view.now,
            feed_mm_rev: self.feed,
            depth_mm: self.view.depth_mm,
            pass: self.pass,
        });
        self.state = to;
    }

    /// What comes before everything else. Returns whether it has taken over.
    fn protect(&mut self, inputs: &TurningInputs) -> bool {
        let settings = self.settings;
        if matches!(self.state, TurningState::Idle | TurningState::Done | TurningState::Fault) {
            return false;
        }
        // Moves outside the stock need no sensor, but none may begin to cut without one.
        let near = self.feeds() || (self.state == TurningState::Held && self.before_hold != TurningState::Return);
        self.blind_s = match self.view.trouble {
            Some(_) if near => self.blind_s + settings.period_s,
            _ => 0.0,
        };
        if let Some(trouble) = self.view.trouble
            && self.blind_s > BLIND_REV * settings.turn_s()
        {
            self.along.stop();
            self.out.stop();
            self.go(TurningState::Fault, Reason::Sensor(trouble));
            return true;
        }
        self.overload_s = if self.view.now > settings.overload {
            self.overload_s + settings.period_s
        } else {
            0.0
        };
        if self.overload_s > settings.overload_s {
            self.draw_out();
            let reason = Reason::Overload {
                load: self.view.now,
                limit: settings.overload,
            };
            self.go(TurningState::Fault, reason);
            return true;
        }
        if inputs.hold != (self.state == TurningState::Held) {
            if inputs.hold {
                self.before_hold = self.state;
                self.along.stop();
                self.out.stop();
                self.go(TurningState::Held, Reason::Hold);
            } else {
                let to = match self.before_hold {
                    // The load has gone: what is cut has to be felt again.
                    TurningState::Engage | TurningState::Cut => {
                        self.lose_contact();
                        self.cautious_to = Some(self.along.point().position + CAUTION_MM);
                        TurningState::Approach
                    }
                    other => other,
                };
                self.go(to, Reason::Hold);
            }
            return true;
        }
        false
    }

    /// Away from the work as fast as the limits allow, while the axial feed stops.
    fn draw_out(&mut self) {
        self.along.stop();
        let to = self.out.point().position + self.settings.clear_out_mm + self.settings.regime.depth_max_mm;
        self.out.aim(to, self.settings.out_limits.velocity);
    }

    fn lose_contact(&mut self) {
        self.air = false;
        self.contact = None;
        self.grown = (0.0, 0.0);
        self.thin_from = None;
        self.deep_s = 0.0;
        self.air_s = 0.0;
        self.loss_s = 0.0;
        self.watch.forget();
    }

    fn act(&mut self, inputs: &TurningInputs, factor: f64) {
        match self.state {
            TurningState::Idle => {
                if inputs.start && !inputs.hold {
                    self.begin_return(TurningState::Return, Reason::Started);
                }
            }
            TurningState::Return | TurningState::ReEnter => self.go_back(factor),
            TurningState::Approach => self.approach(factor),
            TurningState::Engage => self.engage(factor),
            TurningState::BackOff => self.back_off(factor),
            TurningState::Cut => self.cut(factor),
            TurningState::Held | TurningState::Done | TurningState::Fault => {}
        }
    }

    // ---- the way back -------------------------------------------------------------------------------------------

    fn begin_return(&mut self, state: TurningState, reason: Reason) {
        self.lose_contact();
        self.record.lift();
        self.leg = Leg::Out;
        self.promised = None;
        self.cautious_to = None;
        self.along.stop();
        let here = self.out.point().position;
        self.leg_out = if self.pass > 0 {
            here.max(self.pass_highest) + self.settings.clear_out_mm
        } else {
            here
        };
        self.plan_pass();
        self.go(state, reason);
    }

    /// Where the next pass starts and how high it goes.
    fn plan_pass(&mut self) {
        let settings = &self.settings;
        let (tolerance, regime) = (settings.tolerance_mm, &settings.regime);
        let known = self.record.highest_known_mm();
        self.pass_out = match settings.strategy.depth {
            PassDepth::Final => 0.0,
            PassDepth::KnownFinal => {
                let first = self.record.first_above(tolerance).unwrap_or(0.0);
                let there = self.record.at(first + 0.5 * settings.tool.overhang_mm());
                if there.known && there.top_mm > regime.depth_max_mm {
                    there.top_mm - regime.depth_back_off_mm
                } else {
                    0.0
                }
            }
            PassDepth::LeastTime { .. } => self.part_of(known),
        };
        let from = self.record.first_above(self.pass_out + tolerance).unwrap_or(0.0);
        let end = self
            .record
            .last_above(self.pass_out + tolerance)
            .unwrap_or(settings.length_mm);
        let clear = self.record.clear_place_mm(from, self.pass_out);
        self.pass_start = clear - settings.clear_along_mm;
        self.pass_end = end.min(settings.length_mm);
    }

    /// What remains of a height after the first of the equal parts that take the least time.
    fn part_of(&self, height: f64) -> f64 {
        let parts = self
            .settings
            .regime
            .fastest_passes(height, self.settings.length_mm, self.overhead_rev);
        let parts = f64::from(parts.max(1));
        height * (parts - 1.0) / parts
    }

    fn go_back(&mut self, factor: f64) {
        let settings = self.settings;
        let slow = factor.min(1.0);
        let done = self.record.first_above(settings.tolerance_mm).is_none();
        match self.leg {
            Leg::Out => {
                self.out.aim(self.leg_out, settings.out_speed_mm_s * slow);
                if self.out.has_arrived() {
                    self.leg = Leg::Back;
                }
            }
            Leg::Back => {
                let start = -settings.tool.overhang_mm() - settings.clear_along_mm;
                let to = if done && self.pass > 0 { start } else { self.pass_start };
                self.along.aim(to, settings.rapid_mm_s * slow);
                if self.along.has_arrived() {
                    if done && self.pass > 0 {
                        self.go(TurningState::Done, Reason::AtSize);
                    } else {
                        self.leg = Leg::In;
                    }
                }
            }
            Leg::In => {
                self.out.aim(self.pass_out, settings.out_speed_mm_s * slow);
                if self.out.has_arrived() {
                    self.pass += 1;
                    if self.pass > MOST_PASSES {
                        self.go(TurningState::Fault, Reason::TooManyPasses);
                        return;
                    }
                    self.pass_highest = self.pass_out;
                    self.touched = false;
                    self.end_s = 0.0;
                    self.feed = 0.0;
                    self.go(TurningState::Approach, Reason::InPlace);
                }
            }
        }
    }

    // ---- feeding ------------------------------------------------------------------------------------------------

    /// Feeds with a wish, within slew, preview, protection and override.
    fn drive(&mut self, wish: f64, factor: f64) {
        let settings = &self.settings;
        let regime = &settings.regime;
        let mut wish = wish.min(regime.feed_max_mm_rev);
        if settings.strategy.preview {
            wish = wish.min(self.preview());
        }
        if let Some(to) = self.cautious_to {
            if self.along.point().position < to {
                wish = wish.min(settings.strategy.resume_feed_mm_rev);
            } else {
                self.cautious_to = None;
            }
        }
        if self.blind_s > 0.0 {
            wish = regime.feed_min_mm_rev;
        }
        wish = wish.max(regime.feed_min_mm_rev);
        let up = self.feed + settings.slew_up * settings.period_s;
        let down = self.feed - settings.slew_down * settings.period_s;
        // From a stand the smallest feed is taken at once.
        self.feed = wish.clamp(down, up.max(regime.feed_min_mm_rev));
        let speed = settings.speed_mm_s(self.feed) * factor.min(1.0);
        self.along.aim(self.pass_end, speed);
    }

    /// Largest feed for what earlier passes have left ahead.
    fn preview(&self) -> f64 {
        let settings = &self.settings;
        let (along, out) = (self.along.point().position, self.out.point().position);
        let ahead = WATCH_MM + 1.5 * self.feed;
        let depth = self.record.depth_ahead_mm(along, out, ahead, false);
        settings.regime.feed_mm_rev(depth)
    }

    fn approach(&mut self, factor: f64) {
        let settings = self.settings;
        let here = self.along.point().position;
        if self.view.now > settings.contact_load && self.view.trouble.is_none() {
            self.contact = Some(here);
            self.grown = (0.0, here);
            if self.cautious_to.is_some() {
                let turns = KNOWN_REV + 2.0 * settings.sensor_lag_s / settings.turn_s();
                self.cautious_to = Some(here + turns * settings.strategy.resume_feed_mm_rev);
            }
            let load = self.view.now;
            if let Some(reason) = self.face_felt(here) {
                return self.leave_for(reason);
            }
            self.touched = true;
            (self.air, self.thin_from) = (false, None);
            self.go(TurningState::Engage, Reason::Contact { load });
            return;
        }
        // Known stock that is not felt.
        let depth = self
            .record
            .depth_ahead_mm(here, self.out.point().position, -WATCH_MM, true);
        self.loss_s = if depth > SURE_MM { self.loss_s + settings.period_s } else { 0.0 };
        if self.loss_s > 1.5 * settings.turn_s() {
            let before = self.load_before;
            self.draw_out();
            self.go(
                TurningState::Fault,
                Reason::BrokenInsert {
                    before,
                    depth_mm: depth,
                },
            );
            return;
        }
        // Air inside a pass is a thin place too.
        let gap = self.air && here > 0.0;
        if self.thin(gap, 0.0) {
            return;
        }
        if let Some(free) = self.free_way(here) {
            self.along.aim(free, settings.rapid_mm_s * factor.min(1.0));
            return;
        }
        self.drive(settings.strategy.entry_feed_mm_rev, factor);
        self.end_of_pass();
    }

    /// How far the tool may go in rapid: where it is known that nothing stands in the way.
    fn free_way(&self, here: f64) -> Option<f64> {
        let settings = &self.settings;
        if !settings.strategy.preview || self.cautious_to.is_some() {
            return None;
        }
        let out = self.out.point().position;
        let stock = self
            .record
            .next_above(here, out + 1e-9)
            .unwrap_or(settings.length_mm)
            .min(self.pass_end);
        let clear = self.record.clear_place_mm(stock, out) - settings.clear_along_mm;
        (clear - here > LEAST_FREE_MM || (self.along.target() == clear && !self.along.has_arrived() && clear > here))
            .then_some(clear)
    }

    /// The first time that the face is felt, its place tells how high the stock is.
    fn face_felt(&mut self, here: f64) -> Option<Reason> {
        let settings = self.settings;
        let out = self.out.point().position;
        if self.touched || self.pass != 1 || !self.record.is_blank() {
            return None;
        }
        let PassDepth::LeastTime { face_is_known: true } = settings.strategy.depth else {
            return None;
        };
        let height = out + (self.detection_mm - here).max(0.0) * settings.tool.slope();
        if height - out > settings.tool.reach_mm() {
            return Some(Reason::StockTooThick {
                height_mm: height,
                reach_mm: settings.tool.reach_mm(),
            });
        }
        let wanted = self.part_of(height);
        if wanted <= out + settings.tolerance_mm {
            return None;
        }
        self.pass_out = wanted;
        Some(Reason::FaceFelt { height_mm: height })
    }

    fn leave_for(&mut self, reason: Reason) {
        if matches!(reason, Reason::StockTooThick { .. }) {
            self.draw_out();
            self.go(TurningState::Fault, reason);
        } else {
            self.touched = true;
            self.go(TurningState::BackOff, reason);
        }
    }

    fn engage(&mut self, factor: f64) {
        let settings = self.settings;
        let here = self.along.point().position;
        let depth = self.view.depth_now_mm.max(self.view.depth_mm);
        if depth > self.grown.0 * (1.0 + GROWTH) {
            self.grown = (depth, here);
        }
        if self.too_deep(self.view.depth_now_mm, settings.regime.depth_max_mm, ENGAGE_CONFIRM_S) {
            return;
        }
        let since = here - self.grown.1;
        let whole = self
            .contact
            .is_none_or(|contact| here - contact > settings.tool.overhang_mm() + settings.regime.feed_max_mm_rev);
        if since > KNOWN_REV * self.feed.max(settings.regime.feed_min_mm_rev) || whole {
            let depth_mm = self.view.depth_mm;
            if !self.too_deep(depth_mm, self.deepest(), 0.0) {
                self.go(TurningState::Cut, Reason::Settled { depth_mm });
            }
            return;
        }
        let turns = settings.strategy.anticipation_rev * (1.0 + settings.sensor_lag_s / settings.turn_s());
        let growth = turns * settings.tool.slope() * self.feed;
        self.drive(settings.regime.feed_mm_rev(depth + growth), factor);
        self.end_of_pass();
    }

    /// Deepest cut that is taken at once: in passes of least time, what two passes would not do faster.
    fn deepest(&self) -> f64 {
        match self.settings.strategy.depth {
            PassDepth::LeastTime { .. } => self.split_mm,
            _ => self.settings.regime.depth_max_mm,
        }
    }

    /// Backs off from a depth that is too much; returns whether it does.
    fn too_deep(&mut self, depth: f64, limit: f64, confirm_s: f64) -> bool {
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
        self.go(
            TurningState::BackOff,
            Reason::TooDeep {
                depth_mm: depth,
                limit_mm: limit,
            },
        );
        true
    }

    fn back_off(&mut self, factor: f64) {
        let settings = self.settings;
        self.along.stop();
        self.out.aim(self.pass_out, settings.out_speed_mm_s * factor.min(1.0));
        if self.out.has_arrived() && self.along.is_at_rest() {
            let by = (self.pass_out - self.pass_highest).max(0.0);
            self.pass_highest = self.pass_highest.max(self.pass_out);
            self.lose_contact();
            // The shoulder that was left is parallel to the edge and not farther than this.
            let here = self.along.point().position;
            self.cautious_to = Some(here + by / settings.tool.slope() + CAUTION_MM);
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

    fn cut(&mut self, factor: f64) {
        let settings = self.settings;
        let regime = &settings.regime;
        let (here, out) = (self.along.point().position, self.out.point().position);
        let turn_s = settings.turn_s();
        self.air_s = if self.view.now < settings.contact_load {
            self.air_s + settings.period_s
        } else {
            self.load_before = self.view.mean;
            0.0
        };
        if self.air_s > 1.1 * turn_s {
            let from = self.thin_from;
            self.lose_contact();
            (self.air, self.thin_from) = (true, from);
            self.go(TurningState::Approach, Reason::Air);
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
        self.drive(regime.feed_mm_rev(depth), factor);
        self.end_of_pass();
    }

    /// Watches for a thin place, and leaves it if that is wanted; returns whether it does.
    fn thin(&mut self, thin: bool, depth_mm: f64) -> bool {
        let settings = self.settings;
        let (here, out) = (self.along.point().position, self.out.point().position);
        let from = match (thin, self.thin_from) {
            (true, Some(from)) => from,
            (true, None) => here,
            (false, _) => {
                self.thin_from = None;
                return false;
            }
        };
        self.thin_from = Some(from);
        if here - from <= settings.thin_mm || out <= settings.tolerance_mm {
            return false;
        }
        let leaves = match settings.strategy.on_thin {
            OnThin::Continue => false,
            OnThin::Return => true,
            OnThin::ReturnIfSaved => {
                // What is this thin costs no further pass if it is left.
                let length = settings.length_mm - here;
                let passes = |height| settings.regime.fastest_passes(height, length, self.overhead_rev);
                // What lies ahead and is known was planned for.
                let ahead = here + settings.tool.overhang_mm() + CAUTION_MM;
                passes(out + depth_mm) <= passes(out) && ahead < settings.length_mm && !self.record.at(ahead).known
            }
        };
        if leaves {
            self.begin_return(TurningState::ReEnter, Reason::TooThin { depth_mm });
        }
        leaves
    }

    /// At the end the tool stays for a revolution, so that the last of the cut is round.
    fn end_of_pass(&mut self) {
        let settings = self.settings;
        if !self.along.has_arrived() || self.along.target() < self.pass_end {
            self.end_s = 0.0;
            return;
        }
        self.end_s += settings.period_s;
        if self.end_s < 1.05 * settings.turn_s() {
            return;
        }
        if self.pass == 1 && !self.touched && self.out.point().position <= settings.tolerance_mm {
            self.draw_out();
            self.go(TurningState::Fault, Reason::NoStock);
            return;
        }
        self.begin_return(TurningState::Return, Reason::EndOfPass);
    }
}
