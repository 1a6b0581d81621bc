//! Self-programmed turning: the controller that determines its passes from the load.

use evolvent_machine::LoadSample;

use crate::axis::{AxisDrive, AxisPoint};
use crate::climb::Climb;
use crate::felt_stock::FeltStock;
use crate::job_constants::JobConstants;
use crate::load_loss::LoadLoss;
use crate::missing::SURE_MM;
use crate::pass_plan::PassPlan;
use crate::pass_watch::{CAUTION_MM, PassWatch};
use crate::protection_state::ProtectionState;
use crate::record::SizeRecord;
use crate::return_path::ReturnPath;
use crate::settings::{SettingsError, TurningSettings};
use crate::state::{Reason, Transition, TurningState};
use crate::tip_contact::{Front, TipCut, UnderTip};
use crate::trail::Trail;
use crate::watch::{LoadView, LoadWatch};

/// Factor by which noise may raise a decaying load.
const RESIDUE_NOISE: f64 = 1.15;
/// Fraction of the smallest feed below which a chip gives no depth.
pub(crate) const MIN_CHIP: f64 = 0.4;

/// Inputs of a cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TurningInputs {
    /// The newest reading of the load; repeated until there is a newer one.
    pub load: Option<LoadSample>,
    /// Start. After a fault it has to be cleared before it can start the job again.
    pub start: bool,
    /// Hold while this is set.
    pub hold: bool,
    /// Feed override, 1 at 100 %. It slows every move and never raises the feed above what the set load
    /// permits.
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

/// Outputs of a cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TurningOutput {
    /// Point along the cut.
    pub along: AxisPoint,
    /// Point across the cut: height above the final size.
    pub out: AxisPoint,
    /// State.
    pub state: TurningState,
    /// Requested feed, mm/rev; 0 while the tool does not cut.
    pub feed_mm_rev: f64,
    /// Depth that the feed is based on, mm.
    pub depth_mm: f64,
    /// Smoothed load.
    pub load: f64,
    /// Number of the pass, from 1.
    pub pass: u32,
    /// The change of state in this cycle.
    pub transition: Option<Transition>,
}

/// The controller. [`TurningController::step`] does not allocate, reads no clock, and has a bounded run time:
/// the cycle may call it.
#[derive(Clone, Debug)]
pub struct TurningController {
    pub(crate) settings: TurningSettings,
    pub(crate) along: AxisDrive,
    pub(crate) out: AxisDrive,
    pub(crate) trail: Trail,
    pub(crate) watch: LoadWatch,
    pub(crate) record: SizeRecord,
    pub(crate) state: TurningState,
    pub(crate) cycle: u64,
    pub(crate) transition: Option<Transition>,
    pub(crate) view: LoadView,
    /// Present feed, mm/rev.
    pub(crate) feed: f64,
    pub(crate) plan: PassPlan,
    pub(crate) back: ReturnPath,
    /// The present climb, which leads both axes.
    pub(crate) climb: Option<Climb>,
    pub(crate) felt: FeltStock,
    pub(crate) loss: LoadLoss,
    pub(crate) pass_watch: PassWatch,
    pub(crate) guard: ProtectionState,
    pub(crate) constants: JobConstants,
}

impl TurningController {
    /// Creates a controller at rest at the start: before the stock and outside of it.
    ///
    /// # Errors
    /// Settings that [`TurningSettings::check`] rejects.
    pub fn new(settings: TurningSettings) -> Result<Self, SettingsError> {
        let start = (
            -settings.tool.overhang_mm() - settings.clear_along_mm,
            settings.allowance_max_mm + settings.clear_out_mm,
        );
        Self::at(settings, start, None)
    }

    /// Creates a controller at rest at a position along the cut and a height (mm), to which the tool returns
    /// at the end. The position is at or before the face, the height at least the maximum allowance.
    ///
    /// # Errors
    /// Settings that [`TurningSettings::check`] rejects, and a start within the stock.
    pub fn starting_at(settings: TurningSettings, along_mm: f64, out_mm: f64) -> Result<Self, SettingsError> {
        for (name, value, min, max) in [
            ("the place of the start in mm", along_mm, -1e4, 0.0),
            (
                "the height of the start in mm",
                out_mm,
                settings.allowance_max_mm,
                1e4,
            ),
        ] {
            if !(min..=max).contains(&value) {
                return Err(SettingsError::Number {
                    name,
                    value,
                    min,
                    max,
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
        let turn_s = settings.turn_s();
        Ok(Self {
            along: AxisDrive::new(start.0, &settings.along_limits),
            out: AxisDrive::new(start.1, &settings.out_limits),
            trail: Trail::new(turn_s / settings.period_s, start),
            watch: LoadWatch::new(
                regime.law,
                regime.set_load,
                settings.period_s,
                turn_s,
                (settings.sensor_lag_s, settings.sensor_stale_s),
                MIN_CHIP * regime.feed_min_mm_rev,
            ),
            record: SizeRecord::new(
                settings.length_mm,
                settings.tool.slope(),
                settings.tool.overhang_mm(),
            )
            .with_cone(settings.cone, settings.tolerance_mm)
            .with_shoulder(
                settings.shoulder_mm(),
                settings.height_at_end_mm() + settings.tolerance_mm,
            ),
            state: TurningState::Idle,
            cycle: 0,
            transition: None,
            view: LoadView::default(),
            feed: 0.0,
            plan: PassPlan::new(start),
            back: ReturnPath::new(start.1, home),
            climb: None,
            felt: FeltStock::new(&settings),
            loss: LoadLoss::default(),
            pass_watch: PassWatch::default(),
            guard: ProtectionState::new(&settings),
            constants: JobConstants::new(&settings),
            settings,
        })
    }

    /// The record of the remaining stock.
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

    /// Whether the job is over.
    #[must_use]
    pub fn is_over(&self) -> bool {
        matches!(self.state, TurningState::Done | TurningState::Fault) && self.is_at_rest()
    }

    /// Whether both axes are at rest. Real-time safe.
    #[must_use]
    pub fn is_at_rest(&self) -> bool {
        self.along.is_at_rest() && self.out.is_at_rest()
    }

    /// Advances by one control period. Real-time safe.
    pub fn step(&mut self, inputs: &TurningInputs) -> TurningOutput {
        self.transition = None;
        let scale = self.settings.scale;
        let position_mm = [self.along.point().position, self.out.point().position];
        let load = inputs.load.map(|sample| scale.force(sample, position_mm));
        self.view = self.watch.step(load, self.trail.chip_mm());
        self.felt.residue_n -= self.felt.residue_fraction * self.felt.residue_n;
        let factor = if inputs.feed_override > 0.0 {
            inputs.feed_override.min(2.0)
        } else {
            0.0
        };
        if !self.protect(inputs) {
            self.act(inputs, factor);
        }
        self.guard.start_seen = inputs.start;
        if let Some(climb) = &mut self.climb {
            let (along, out) = climb.advance(self.settings.period_s);
            self.along.lead(along);
            self.out.lead(out);
        }
        let along = self.along.advance(self.settings.period_s);
        let out = self.out.advance(self.settings.period_s);
        self.trail.push(along.position, out.position);
        if self.feeds() {
            let (cut_along, cut_out) = self.trail.turn_ago();
            // While the load is missing it is unknown whether anything is cut, so the positions swept
            // meanwhile are recorded later. At the end of the pass the load vanishes as expected.
            let ends = self.plan.end_s > 0.0;
            let felt = self.feels() || (ends && self.felt.contact_mm.is_some());
            let cuts = matches!(
                self.state,
                TurningState::Engage | TurningState::Cut | TurningState::Climb
            );
            let missed = self.loss.missing_s > 0.0 || (cuts && self.loss.air_s > 0.0);
            // The same holds where known stock begins, until a load is felt.
            let meets = self.state == TurningState::Approach && self.sure_depth(0.0) > SURE_MM;
            let waits = (missed && !ends) || meets;
            if !waits {
                let under = self.under_tip(felt && !ends, cut_along);
                self.record
                    .sweep(cut_along, cut_out, felt, under != UnderTip::Unknown);
                if let UnderTip::StockSince(from_mm) = under {
                    self.record.confirm_from(from_mm);
                }
            }
        }
        self.cycle += 1;
        TurningOutput {
            along,
            out,
            state: self.state,
            feed_mm_rev: if self.feeds() { self.feed } else { 0.0 },
            depth_mm: if self.felt.contact_mm.is_some() {
                self.view.depth_mm
            } else {
                0.0
            },
            load: self.view.now,
            pass: self.plan.number,
            transition: self.transition,
        }
    }

    /// What the load of a cut shows about the position that the tip has cut over a whole revolution.
    fn under_tip(&mut self, cuts: bool, swept_mm: f64) -> UnderTip {
        let (Some(contact_mm), TurningState::Cut, true) = (self.felt.contact_mm, self.state, cuts) else {
            return UnderTip::Unknown;
        };
        let (position_mm, out_mm) = (self.along.point().position, self.out.point().position);
        let tool = &self.settings.tool;
        let cut = TipCut {
            position_mm,
            swept_mm,
            contact_mm,
            depth_mm: self.view.depth_mean_mm,
            bound_mm: self.record.highest_mm(swept_mm, position_mm + tool.overhang_mm()) - out_mm,
        };
        self.felt.tip.follow(cut, tool.slope(), tool.overhang_mm())
    }

    /// The front that the tool has to meet again after it leaves a cut of a depth in mm.
    pub(crate) fn front_left(&self, depth_mm: f64) -> Front {
        let here = self.along.point().position;
        let slope = self.settings.tool.slope();
        self.felt
            .tip
            .front_left(here, self.felt.contact_mm, depth_mm, slope)
    }

    /// Whether the tool feeds where there may be stock.
    pub(crate) fn feeds(&self) -> bool {
        matches!(
            self.state,
            TurningState::Approach
                | TurningState::Engage
                | TurningState::Cut
                | TurningState::Climb
                | TurningState::BackOff
        )
    }

    /// Whether there is a load beyond the decaying reading of the previous cut.
    pub(crate) fn feels(&self) -> bool {
        self.view.now > self.settings.contact_load_n + RESIDUE_NOISE * self.felt.residue_n
    }

    pub(crate) fn go(&mut self, to: TurningState, reason: Reason) {
        if matches!(to, TurningState::Approach | TurningState::Climb) {
            self.felt.residue_n = self.view.now;
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
            pass: self.plan.number,
        });
        self.state = to;
    }

    /// Checks everything that has precedence over the state. Returns whether it has taken over.
    fn protect(&mut self, inputs: &TurningInputs) -> bool {
        let settings = self.settings;
        if matches!(
            self.state,
            TurningState::Idle | TurningState::Done | TurningState::Fault
        ) {
            return false;
        }
        // Moves outside the stock need no sensor, but a cut must not begin without one.
        let near = self.feeds()
            || (self.state == TurningState::Held && self.guard.before_hold != TurningState::Return);
        self.guard.blind_s = match self.view.trouble {
            Some(_) if near => self.guard.blind_s + settings.period_s,
            _ => 0.0,
        };
        if let Some(trouble) = self.view.trouble
            && self.guard.blind_s > self.guard.blind_max_s
        {
            self.stand();
            self.keep_shoulder();
            self.go(TurningState::Fault, Reason::Sensor(trouble));
            return true;
        }
        self.guard.overload_s = if self.view.now > settings.overload_n {
            self.guard.overload_s + settings.period_s
        } else {
            0.0
        };
        if self.guard.overload_s > settings.overload_s {
            self.keep_shoulder();
            self.draw_out();
            let reason = Reason::Overload {
                load: self.view.now,
                limit: settings.overload_n,
            };
            self.go(TurningState::Fault, reason);
            return true;
        }
        if inputs.hold != (self.state == TurningState::Held) {
            if inputs.hold {
                self.guard.before_hold = self.state;
                self.stand();
                self.go(TurningState::Held, Reason::Hold);
            } else {
                let to = match self.guard.before_hold {
                    // The load has decayed: the cut has to be felt again.
                    TurningState::Engage | TurningState::Cut => {
                        let depth = self.felt.engagement.depth_mm();
                        let front = self.front_left(depth);
                        self.lose_contact();
                        self.felt.tip.set_front(front);
                        self.require_stock(self.along.point().position, depth);
                        self.pass_watch.cautious_to_mm = Some(self.along.point().position + CAUTION_MM);
                        TurningState::Approach
                    }
                    TurningState::Climb => {
                        let depth = self.felt.engagement.depth_mm();
                        self.lose_contact();
                        self.require_stock(self.along.point().position, depth);
                        self.felt.shoulder_mm = self.out.point().position + depth;
                        self.feed = 0.0;
                        TurningState::Climb
                    }
                    other => other,
                };
                self.go(to, Reason::Hold);
            }
            return true;
        }
        false
    }

    /// Stops as soon as the limits allow: on the cone during a climb.
    fn stand(&mut self) {
        if let Some(climb) = &mut self.climb {
            climb.stop();
        } else {
            self.along.stop();
            self.out.stop();
        }
    }

    /// Draws the tool out as fast as the limits allow, while the axial feed stops.
    pub(crate) fn draw_out(&mut self) {
        self.climb = None;
        self.along.stop();
        let to = self.out.point().position + self.settings.clear_out_mm + self.settings.regime.depth_max_mm;
        self.out.aim(to, self.settings.out_limits.velocity);
    }

    pub(crate) fn lose_contact(&mut self) {
        self.felt.lose();
        self.pass_watch.leave();
        self.loss.begin();
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
            TurningState::Climb => self.climb(factor),
            TurningState::Fault => {
                if inputs.start && !self.guard.start_seen && !inputs.hold && self.is_over() {
                    self.guard.overload_s = 0.0;
                    self.begin_return(TurningState::Return, Reason::Started);
                }
            }
            TurningState::Held | TurningState::Done => {}
        }
    }
}
