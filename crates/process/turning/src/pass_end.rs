//! The end of a pass: the return, and the start of the next pass.

use crate::controller::TurningController;
use crate::return_path::Leg;
use crate::settings::PassDepth;
use crate::state::{Reason, TurningState};
use crate::tip_contact::Front;

/// Maximum number of passes; a further one is a fault.
const MAX_PASSES: u32 = 1000;

impl TurningController {
    pub(crate) fn begin_return(&mut self, state: TurningState, reason: Reason) {
        self.lose_contact();
        self.record
            .lift(self.along.point().position, self.out.point().position);
        self.back.leg = Leg::Out;
        self.pass_watch.cautious_to_mm = None;
        self.climb = None;
        self.along.stop();
        let here = self.out.point().position;
        self.back.out_mm = if self.plan.number > 0 {
            here.max(self.plan.highest_mm) + self.settings.clear_out_mm
        } else {
            here
        };
        self.plan_pass();
        self.go(state, reason);
    }

    /// Plans start and height of the next pass.
    pub(crate) fn plan_pass(&mut self) {
        let settings = &self.settings;
        let tolerance = settings.tolerance_mm;
        let known = self.record.highest_known_mm();
        self.plan.out_mm = match settings.strategy.depth {
            PassDepth::Final => 0.0,
            PassDepth::KnownFinal => self.known_final(),
            // The planned pass is not counted yet.
            PassDepth::LeastTime { .. } => self.parts_of(known, u32::MAX),
            PassDepth::Bounded { .. } if self.record.is_level(tolerance) => {
                self.parts_of(known, self.passes_left().saturating_sub(1))
            }
            PassDepth::Bounded { .. } => self.known_final(),
        };
        let from = self
            .record
            .first_above(self.plan.out_mm + tolerance)
            .unwrap_or(0.0);
        let end = self
            .record
            .last_above(self.plan.out_mm + tolerance)
            .unwrap_or(f64::INFINITY);
        let clear = self.record.clear_place_mm(from, self.plan.out_mm);
        // Stock that is only on the cone is reached along the pass before it.
        let before_cone = settings
            .cone
            .map_or(f64::INFINITY, |cone| cone.position_mm(self.plan.out_mm));
        self.plan.start_mm = clear.min(before_cone) - settings.clear_along_mm;
        self.plan.stock_to_mm = end;
    }

    /// The final size, or the depth after backing off from stock that is known to be too deep.
    fn known_final(&self) -> f64 {
        let (settings, regime) = (&self.settings, &self.settings.regime);
        let first = self.record.first_above(settings.tolerance_mm).unwrap_or(0.0);
        let there = self.record.at(first + 0.5 * settings.tool.overhang_mm());
        if there.known && there.top_mm - there.final_mm > regime.depth_max_mm {
            there.top_mm - regime.depth_back_off_mm
        } else {
            0.0
        }
    }

    /// Height that remains after the first of the equal parts that take the least time, within the remaining
    /// number of passes.
    pub(crate) fn part_of(&self, height: f64) -> f64 {
        self.parts_of(height, self.passes_left())
    }

    /// The same in at most `max` parts, or in as many as are needed.
    fn parts_of(&self, height: f64, max: u32) -> f64 {
        let regime = &self.settings.regime;
        let fastest = regime.fastest_passes(height, self.settings.length_mm, self.constants.overhead_rev);
        let parts = f64::from(fastest.min(max.max(regime.passes(height))).max(1));
        height * (parts - 1.0) / parts
    }

    pub(crate) fn go_back(&mut self, factor: f64) {
        let settings = self.settings;
        let slow = factor.min(1.0);
        let done = self.record.first_above(settings.tolerance_mm).is_none();
        match self.back.leg {
            Leg::Out => {
                self.out.aim(self.back.out_mm, settings.out_speed_mm_s * slow);
                if self.out.has_arrived() {
                    self.back.leg = Leg::Back;
                }
            }
            Leg::Back => {
                let start = -settings.tool.overhang_mm() - settings.clear_along_mm;
                let to = if done && self.plan.number > 0 {
                    start
                } else {
                    self.plan.start_mm
                };
                self.along.aim(to, settings.rapid_mm_s * slow);
                if self.along.has_arrived() {
                    self.back.leg = match self.back.home_mm {
                        Some(_) if done && self.plan.number > 0 => Leg::HomeAcross,
                        _ => Leg::In,
                    };
                    if done && self.plan.number > 0 && self.back.home_mm.is_none() {
                        self.go(TurningState::Done, Reason::AtSize);
                    }
                }
            }
            Leg::HomeAcross => {
                let (_, out) = self.back.home_mm.unwrap_or_default();
                self.out.aim(out, settings.out_speed_mm_s * slow);
                if self.out.has_arrived() {
                    self.back.leg = Leg::HomeAlong;
                }
            }
            Leg::HomeAlong => {
                let (along, _) = self.back.home_mm.unwrap_or_default();
                self.along.aim(along, settings.rapid_mm_s * slow);
                if self.along.has_arrived() {
                    self.go(TurningState::Done, Reason::AtSize);
                }
            }
            Leg::In => {
                self.out.aim(self.plan.out_mm, settings.out_speed_mm_s * slow);
                if self.out.has_arrived() {
                    self.plan.number += 1;
                    if self.plan.number > MAX_PASSES {
                        self.go(TurningState::Fault, Reason::TooManyPasses);
                        return;
                    }
                    self.plan.highest_mm = self.plan.out_mm;
                    self.plan.is_touched = false;
                    self.plan.meets_unknown = self.record.has_unknown();
                    self.plan.end_s = 0.0;
                    self.feed = 0.0;
                    let stock_mm = self.record.next_above(
                        self.along.point().position,
                        self.plan.out_mm + settings.tolerance_mm,
                    );
                    self.felt
                        .tip
                        .set_front(Front::Face(stock_mm.unwrap_or(f64::INFINITY)));
                    self.go(TurningState::Approach, Reason::InPlace);
                }
            }
        }
    }
}
