//! Self-programmed turning: the controller that finds its passes from the load.

use crate::axis::{AxisDrive, AxisPoint};
use crate::engagement::Engagement;
use crate::missing::SURE_MM;
use crate::record::SizeRecord;
use crate::sensor::LoadSample;
use crate::settings::{SettingsError, TurningSettings};
use crate::state::{Reason, Transition, TurningState};
use crate::trail::Trail;
use crate::watch::{LoadView, LoadWatch, SMOOTHING_S};

/// Way beyond where contact is expected after which caution ends, mm.
const CAUTION_MM: f64 = 1.5;
/// What noise may make of a load that fades.
const RESIDUE_NOISE: f64 = 1.15;
/// Share of the smallest feed below which a chip tells nothing.
pub(crate) const MIN_CHIP: f64 = 0.4;

/// What comes into a cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TurningInputs {
    /// The newest reading of the load; the same again where there is no newer one.
    pub load: Option<LoadSample>,
    /// Start; after a fault it must have been unset to start again.
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
pub(crate) enum Leg {
    Out,
    Back,
    In,
    /// Everything is at size: across to the height that is to be gone back to, ...
    HomeAcross,
    /// ... and along to the place.
    HomeAlong,
}

/// The controller. [`TurningController::step`] allocates nothing, looks at no clock, and is bounded: the cycle may call
/// it.
#[derive(Clone, Debug)]
pub struct TurningController {
    pub(crate) settings: TurningSettings,
    pub(crate) along: AxisDrive,
    pub(crate) out: AxisDrive,
    pub(crate) trail: Trail,
    pub(crate) watch: LoadWatch,
    pub(crate) record: SizeRecord,
    pub(crate) state: TurningState,
    pub(crate) before_hold: TurningState,
    pub(crate) leg: Leg,
    pub(crate) leg_out: f64,
    /// Where the tool goes at the end, if not simply before the stock.
    pub(crate) home: Option<(f64, f64)>,
    pub(crate) cycle: u64,
    pub(crate) pass: u32,
    pub(crate) transition: Option<Transition>,
    pub(crate) view: LoadView,
    pub(crate) feed: f64,
    /// Height of the present pass, and the highest that the tool has been at in it.
    pub(crate) pass_out: f64,
    pub(crate) pass_highest: f64,
    pub(crate) pass_start: f64,
    pub(crate) pass_end: f64,
    /// Depth that the record or the face promises for the present pass; none where nothing is known.
    pub(crate) promised: Option<f64>,
    /// Load that the sensor still shows of what was cut before, and its share that goes in a cycle.
    pub(crate) residue: f64,
    pub(crate) residue_share: f64,
    /// Place of contact; none in air.
    pub(crate) contact: Option<f64>,
    pub(crate) touched: bool,
    /// What was felt last, and must still be there.
    pub(crate) engagement: Engagement,
    /// Height of the shoulder that is backed off from, mm.
    pub(crate) shoulder_mm: f64,
    /// Place by which stock must be met, and its depth: a shoulder that was backed off from, or the cut before a hold.
    pub(crate) expected: Option<(f64, f64)>,
    /// Time for which the cut counts as interrupted, s: a load has gone and come back within a revolution.
    pub(crate) interrupted_s: f64,
    /// The longest way of such an interruption, mm.
    pub(crate) interruption_mm: f64,
    /// The load has gone at this place in a way that may be a gap, or a shoulder was backed off from; none once a depth is
    /// felt again. A touch alone proves nothing: off the axis the highest point comes first.
    pub(crate) unproven: Option<f64>,
    /// The present pass goes over places that no pass has been over before.
    pub(crate) meets_unknown: bool,
    /// In a gap of the stock.
    pub(crate) air: bool,
    /// Largest depth since contact and where it was reached.
    pub(crate) grown: (f64, f64),
    /// The feed stays at the one of resumption until this place.
    pub(crate) cautious_to: Option<f64>,
    pub(crate) deep_s: f64,
    pub(crate) thin_from: Option<f64>,
    /// Place and depth of the cut once it had settled for a revolution, mm.
    pub(crate) settled: (f64, f64),
    /// The highest stock that was felt, mm above the final size.
    pub(crate) highest_felt: f64,
    /// Passes of the job that were ended on a thin place.
    pub(crate) returned_thin: u32,
    /// Of these, those where stock was cut: not at a gap.
    pub(crate) returned_low: u32,
    pub(crate) air_s: f64,
    pub(crate) loss_s: f64,
    pub(crate) load_before: f64,
    pub(crate) end_s: f64,
    pub(crate) overload_s: f64,
    pub(crate) blind_s: f64,
    pub(crate) blind_most_s: f64,
    /// The start has not been let go since the last one.
    pub(crate) start_seen: bool,
    pub(crate) overhead_rev: f64,
    pub(crate) split_mm: f64,
    pub(crate) detection_mm: f64,
}

impl TurningController {
    /// Sets up, at rest at the start: before the stock and outside of it.
    ///
    /// # Errors
    /// What [`TurningSettings::check`] refuses.
    pub fn new(settings: TurningSettings) -> Result<Self, SettingsError> {
        let start = (
            -settings.tool.overhang_mm() - settings.clear_along_mm,
            settings.allowance_max_mm + settings.clear_out_mm,
        );
        Self::at(settings, start, None)
    }

    /// Sets up, at rest at a place along the cut and a height (mm), to which the tool comes back at the end. The place
    /// lies before the face or beside it, the height not below what the stock may have.
    ///
    /// # Errors
    /// What [`TurningSettings::check`] refuses, and a start within the stock.
    pub fn starting_at(settings: TurningSettings, along_mm: f64, out_mm: f64) -> Result<Self, SettingsError> {
        for (name, value, least, most) in [
            ("the place of the start in mm", along_mm, -1e4, 0.0),
            (
                "the height of the start in mm",
                out_mm,
                settings.allowance_max_mm,
                1e4,
            ),
        ] {
            if !(least..=most).contains(&value) {
                return Err(SettingsError::Number {
                    name,
                    value,
                    least,
                    most,
                });
            }
        }
        Self::at(settings, (along_mm, out_mm), Some((along_mm, out_mm)))
    }

    fn at(
        settings: TurningSettings,
        start: (f64, f64),
        home: Option<(f64, f64)>,
    ) -> Result<Self, SettingsError> {
        settings.check()?;
        let regime = &settings.regime;
        let turn = settings.turn_s();
        let overhead_s = settings.length_mm / settings.rapid_mm_s
            + 2.0 * (settings.clear_out_mm + regime.depth_back_off_mm) / settings.out_speed_mm_s
            + 3.0 * settings.clear_along_mm / settings.speed_mm_s(regime.feed_max_mm_rev)
            + turn;
        let mut controller = Self {
            along: AxisDrive::new(start.0, &settings.along_limits),
            out: AxisDrive::new(start.1, &settings.out_limits),
            trail: Trail::new(turn / settings.period_s, start),
            watch: LoadWatch::new(
                regime.law,
                regime.set_load,
                settings.period_s,
                turn,
                (settings.sensor_lag_s, settings.sensor_stale_s),
                MIN_CHIP * regime.feed_min_mm_rev,
            ),
            record: SizeRecord::new(
                settings.length_mm,
                settings.tool.slope(),
                settings.tool.overhang_mm(),
            ),
            state: TurningState::Idle,
            before_hold: TurningState::Idle,
            leg: Leg::Out,
            leg_out: start.1,
            home,
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
                growth_mm: 0.0,
                trouble: None,
            },
            feed: 0.0,
            pass_out: 0.0,
            pass_highest: start.1,
            pass_start: start.0,
            pass_end: settings.length_mm,
            promised: None,
            residue: 0.0,
            residue_share: 1.0 - libm::exp(-settings.period_s / (settings.sensor_lag_s + SMOOTHING_S)),
            contact: None,
            touched: false,
            engagement: Engagement::new(settings.tool.slope()),
            shoulder_mm: 0.0,
            expected: None,
            interrupted_s: 0.0,
            interruption_mm: 0.0,
            unproven: None,
            meets_unknown: true,
            air: false,
            grown: (0.0, 0.0),
            cautious_to: None,
            deep_s: 0.0,
            thin_from: None,
            settled: (0.0, 0.0),
            highest_felt: 0.0,
            returned_thin: 0,
            returned_low: 0,
            air_s: 0.0,
            loss_s: 0.0,
            load_before: 0.0,
            end_s: 0.0,
            overload_s: 0.0,
            blind_s: 0.0,
            blind_most_s: settings.blind_s().min(0.5 * turn),
            start_seen: false,
            overhead_rev: overhead_s / turn,
            split_mm: regime.depth_max_mm,
            detection_mm: 0.0,
            settings,
        };
        controller.split_mm = controller.split_depth();
        controller.detection_mm = controller.detection();
        Ok(controller)
    }

    /// How far the tool goes in at the entry feed until the load of contact shows, mm. The chip is as thick as the way
    /// gone until a revolution is over; the sensor and the smoothing lag behind.
    fn detection(&self) -> f64 {
        let settings = &self.settings;
        let feed = settings.strategy.entry_feed_mm_rev;
        let step_mm = settings.speed_mm_s(feed) * settings.period_s;
        let share = |lag_s: f64| 1.0 - libm::exp(-settings.period_s / lag_s.max(1e-9));
        let (lag, smoothing) = (share(settings.sensor_lag_s), share(SMOOTHING_S));
        let (mut way, mut read, mut smooth) = (0.0, 0.0, 0.0);
        while smooth < settings.contact_load && way < 4.0 * feed {
            way += step_mm;
            let depth = way * settings.tool.slope();
            let chip = if way < feed {
                0.5 * way
            } else {
                feed * (1.0 - 0.5 * feed / way)
            };
            read += lag * (settings.regime.law.load(depth, chip) - read);
            smooth += smoothing * (read - smooth);
        }
        way
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
        matches!(self.state, TurningState::Done | TurningState::Fault) && self.is_at_rest()
    }

    /// Whether both axes stand. Real-time safe.
    #[must_use]
    pub fn is_at_rest(&self) -> bool {
        self.along.is_at_rest() && self.out.is_at_rest()
    }

    /// One control period. Real-time safe.
    pub fn step(&mut self, inputs: &TurningInputs) -> TurningOutput {
        self.transition = None;
        let scale = self.settings.scale;
        let place_mm = [self.along.point().position, self.out.point().position];
        let load = inputs.load.map(|sample| scale.force(sample, place_mm));
        self.view = self.watch.step(load, self.trail.chip_mm());
        self.residue -= self.residue_share * self.residue;
        let factor = if inputs.feed_override > 0.0 {
            inputs.feed_override.min(2.0)
        } else {
            0.0
        };
        if !self.protect(inputs) {
            self.act(inputs, factor);
        }
        self.start_seen = inputs.start;
        let along = self.along.advance(self.settings.period_s);
        let out = self.out.advance(self.settings.period_s);
        self.trail.push(along.position, out.position);
        if self.feeds() {
            let (cut_along, cut_out) = self.trail.turn_ago();
            // While a load is missed it is not known whether anything is cut; what has been swept by then follows.
            // Standing at the end of the pass the load goes as it should.
            let ends = self.end_s > 0.0;
            let felt = self.feels() || (ends && self.contact.is_some());
            let sure = felt && !ends && self.state == TurningState::Cut;
            let cuts = matches!(self.state, TurningState::Engage | TurningState::Cut);
            let missed = self.loss_s > 0.0 || (cuts && self.air_s > 0.0);
            // Nor is it where known stock is met, until a load is felt.
            let meets = self.state == TurningState::Approach && self.sure_depth(0.0) > SURE_MM;
            let waits = (missed && !ends) || meets;
            if !waits {
                self.record.sweep(cut_along, cut_out, felt, sure);
            }
        }
        self.cycle += 1;
        TurningOutput {
            along,
            out,
            state: self.state,
            feed_mm_rev: if self.feeds() { self.feed } else { 0.0 },
            depth_mm: if self.contact.is_some() {
                self.view.depth_mm
            } else {
                0.0
            },
            load: self.view.now,
            pass: self.pass,
            transition: self.transition,
        }
    }

    /// Whether the tool is where stock may be.
    pub(crate) fn feeds(&self) -> bool {
        matches!(
            self.state,
            TurningState::Approach | TurningState::Engage | TurningState::Cut | TurningState::BackOff
        )
    }

    /// Whether there is a load beyond what the sensor still shows of the cut before.
    pub(crate) fn feels(&self) -> bool {
        self.view.now > self.settings.contact_load + RESIDUE_NOISE * self.residue
    }

    pub(crate) fn go(&mut self, to: TurningState, reason: Reason) {
        if to == TurningState::Approach {
            self.residue = self.view.now;
        }
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
        if matches!(
            self.state,
            TurningState::Idle | TurningState::Done | TurningState::Fault
        ) {
            return false;
        }
        // Moves outside the stock need no sensor, but none may begin to cut without one.
        let near =
            self.feeds() || (self.state == TurningState::Held && self.before_hold != TurningState::Return);
        self.blind_s = match self.view.trouble {
            Some(_) if near => self.blind_s + settings.period_s,
            _ => 0.0,
        };
        if let Some(trouble) = self.view.trouble
            && self.blind_s > self.blind_most_s
        {
            self.along.stop();
            self.out.stop();
            self.keep_shoulder();
            self.go(TurningState::Fault, Reason::Sensor(trouble));
            return true;
        }
        self.overload_s = if self.view.now > settings.overload {
            self.overload_s + settings.period_s
        } else {
            0.0
        };
        if self.overload_s > settings.overload_s {
            self.keep_shoulder();
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
                        let depth = self.engagement.depth_mm();
                        self.lose_contact();
                        self.expect(self.along.point().position, depth);
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
    pub(crate) fn draw_out(&mut self) {
        self.along.stop();
        let to = self.out.point().position + self.settings.clear_out_mm + self.settings.regime.depth_max_mm;
        self.out.aim(to, self.settings.out_limits.velocity);
    }

    pub(crate) fn lose_contact(&mut self) {
        self.air = false;
        self.contact = None;
        self.grown = (0.0, 0.0);
        self.thin_from = None;
        self.deep_s = 0.0;
        self.air_s = 0.0;
        self.loss_s = 0.0;
        (self.interrupted_s, self.interruption_mm) = (0.0, 0.0);
        self.engagement.forget();
        self.expected = None;
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
            TurningState::Fault => {
                if inputs.start && !self.start_seen && !inputs.hold && self.is_over() {
                    self.overload_s = 0.0;
                    self.begin_return(TurningState::Return, Reason::Started);
                }
            }
            TurningState::Held | TurningState::Done => {}
        }
    }
}
