//! The climb along the cone at the end of a pass, which leaves no step on it.

use evolvent_timing::ScalarLimits;

use crate::axis::{AxisDrive, AxisPoint};
use crate::cone::Cone;
use crate::controller::TurningController;
use crate::missing::SURE_MM;
use crate::settings::TurningSettings;
use crate::state::{Reason, TurningState};

/// The present climb: one drive along the cone leads both axes, so that they cannot leave it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Climb {
    drive: AxisDrive,
    /// Position and height at its start, mm.
    from_mm: (f64, f64),
    /// Components of the direction along and across the cut.
    direction: (f64, f64),
    /// Its length, mm.
    length_mm: f64,
}

impl Climb {
    /// From one position of the cone to another, mm along the cut.
    fn new(cone: &Cone, settings: &TurningSettings, from_mm: (f64, f64), to_mm: f64) -> Self {
        let long = libm::hypot(1.0, cone.slope);
        let direction = (1.0 / long, cone.slope / long);
        let (along, out) = (&settings.along_limits, &settings.out_limits);
        let min = |along: f64, out: f64| (along / direction.0).min(out / direction.1);
        let limits = ScalarLimits {
            velocity: min(along.velocity, out.velocity),
            acceleration: min(along.acceleration, out.acceleration),
            jerk: min(along.jerk, out.jerk),
        };
        Self {
            drive: AxisDrive::new(0.0, &limits),
            from_mm,
            direction,
            length_mm: (to_mm - from_mm.0) / direction.0,
        }
    }

    /// Stops as soon as the limits allow, on the cone.
    pub(crate) fn stop(&mut self) {
        self.drive.stop();
    }

    /// Advances by a period and returns the points of both axes.
    pub(crate) fn advance(&mut self, period_s: f64) -> (AxisPoint, AxisPoint) {
        let point = self.drive.advance(period_s);
        let axis = |from: f64, fraction: f64| AxisPoint {
            position: from + fraction * point.position,
            velocity: fraction * point.velocity,
            acceleration: fraction * point.acceleration,
            jerk: fraction * point.jerk,
        };
        (
            axis(self.from_mm.0, self.direction.0),
            axis(self.from_mm.1, self.direction.1),
        )
    }
}

impl TurningController {
    /// End of the pass: the cone, the shoulder, or the end of the stock, mm.
    pub(crate) fn pass_end_mm(&self) -> f64 {
        let cone = self.settings.cone;
        self.stock_end_mm()
            .min(cone.map_or(f64::INFINITY, |cone| cone.position_mm(self.plan.out_mm)))
    }

    /// End of the climb: the shoulder at the end of the cone, or the end of the stock, mm.
    pub(crate) fn stock_end_mm(&self) -> f64 {
        self.plan.stock_to_mm.min(self.settings.end_mm(self.plan.out_mm))
    }

    /// Starts the climb if there may be stock on the cone after the pass; returns whether it does.
    pub(crate) fn begin_climb(&mut self) -> bool {
        let Some(cone) = self.settings.cone else {
            return false;
        };
        let from = (self.along.point().position, self.out.point().position);
        let end_mm = self.plan.stock_to_mm.min(self.settings.length_mm);
        let beyond = end_mm - from.0;
        if beyond <= self.settings.tolerance_mm || from.0 < cone.position_mm(from.1) {
            return false;
        }
        // The depth at the end of the pass continues, less what the edge leaves at a wall within a
        // revolution.
        let depth = self.felt.engagement.depth_mm();
        let feed = self.settings.regime.feed_max_mm_rev;
        let sure = depth - feed * (self.settings.tool.slope() + cone.slope);
        self.lose_contact();
        self.require_stock(from.0, sure);
        self.felt.shoulder_mm = from.1 + depth;
        self.climb = Some(Climb::new(&cone, &self.settings, from, end_mm));
        self.feed = 0.0;
        self.plan.end_s = 0.0;
        self.go(TurningState::Climb, Reason::ConeReached);
        true
    }

    /// Drives both axes up the cone at a feed that follows the load.
    pub(crate) fn climb(&mut self, factor: f64) {
        let settings = self.settings;
        let here = self.along.point().position;
        self.plan.highest_mm = self.plan.highest_mm.max(self.out.point().position);
        if self.feels() && self.view.trouble.is_none() && self.felt.contact_mm.is_none() {
            self.felt.contact_mm = Some(here);
            self.felt.expected_mm = None;
            self.felt.in_air = false;
            self.plan.is_touched = true;
            self.loss.missing_s = 0.0;
        }
        let wish = if self.felt.contact_mm.is_some() {
            if self.loses_load_on_cone() || self.too_deep_on_cone() {
                return;
            }
            let turns =
                settings.strategy.anticipation_rev * (1.0 + settings.sensor_lag_s / settings.turn_s());
            let ahead = self.view.depth_now_mm + turns * self.view.growth_mm;
            let felt = self.felt.engagement.depth_mm();
            settings
                .regime
                .feed_mm_rev(self.view.depth_mm.max(ahead).max(felt))
        } else {
            if self.misses_load(here) {
                return;
            }
            let left = self.felt.shoulder_mm - self.out.point().position;
            self.approach_feed(here).min(settings.regime.feed_mm_rev(left))
        };
        self.limit_feed(wish);
        let Some(climb) = &mut self.climb else {
            return;
        };
        // The feed limits the speed along the cut and along the cone.
        let cosine = climb.direction.0;
        let feed = (self.feed / cosine).min(settings.regime.feed_max_mm_rev);
        climb
            .drive
            .aim(climb.length_mm, settings.speed_mm_s(feed) * factor.min(1.0));
        if !climb.drive.has_arrived() {
            self.plan.end_s = 0.0;
            return;
        }
        self.plan.end_s += settings.period_s;
        if self.plan.end_s >= settings.dwell_s() {
            self.finish_pass();
        }
    }

    /// Follows the load. If it vanishes, the stock has ended or the insert is broken.
    fn loses_load_on_cone(&mut self) -> bool {
        if self.plan.end_s > 0.0 {
            return false;
        }
        match self.load_after() {
            LoadAfter::There => false,
            LoadAfter::Broken { depth_mm } => {
                self.report_broken(depth_mm);
                true
            }
            LoadAfter::Air => {
                self.lose_contact();
                (self.felt.in_air, self.felt.shoulder_mm) = (true, 0.0);
                false
            }
        }
    }

    /// Backs off from stock that rises more steeply than the cone.
    fn too_deep_on_cone(&mut self) -> bool {
        let settings = self.settings;
        let limit = settings.regime.depth_max_mm;
        if !self.too_deep(self.view.depth_mm, limit, settings.confirm_s) {
            return false;
        }
        // Moves out at once: the cone rises while the axis along it stops.
        self.climb = None;
        self.along.stop();
        self.out.aim(self.plan.out_mm, settings.out_speed_mm_s);
        true
    }

    /// Reports a fault if expected stock is not met; returns whether it does.
    pub(crate) fn misses_load(&mut self, here: f64) -> bool {
        let settings = &self.settings;
        let depth = self.depth_to_be_met(here);
        if depth <= SURE_MM {
            self.loss.missing_s = 0.0;
        } else if self.shows_chips(depth) {
            self.loss.missing_s += settings.period_s;
        }
        if self.loss.missing_s <= crate::missing::LOSS_REV * settings.turn_s() {
            return false;
        }
        self.report_broken(depth);
        true
    }
}

/// State of the load in a cut.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum LoadAfter {
    /// Present, or missing for less than a revolution.
    There,
    /// Lost where there is still stock.
    Broken {
        /// Depth of that stock, mm.
        depth_mm: f64,
    },
    /// Lost where the edge can have left the stock.
    Air,
}
