//! Settings of self-programmed turning, and their checks.

use evolvent_config::plain;
use evolvent_timing::ScalarLimits;

use crate::cone::{Cone, ConeError};
use crate::regime::Regime;
use crate::scale::LoadScale;
use crate::tool::CuttingEdge;
use crate::watch::LoadWatch;

/// Passes of the safe strategy beyond equation (5), for thin positions and for parts that take less time.
const SAFE_EXTRA: u32 = 2;

/// How passes are chosen and protected against their own transients.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Strategy {
    /// Feed towards stock that has not been felt, mm/rev.
    pub entry_feed_mm_rev: f64,
    /// Feed after backing off, until the cut is known again, mm/rev.
    pub resume_feed_mm_rev: f64,
    /// Slow down for shoulders of earlier passes.
    pub preview: bool,
    /// Revolutions over which a growing depth is extrapolated.
    pub anticipation_rev: f64,
    /// Reaction where the largest feed does not reach the set load.
    pub on_thin: OnThin,
    /// Height of a pass.
    pub depth: PassDepth,
}

/// Reaction to a thin position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OnThin {
    /// End the pass; the next one starts at the first position that is not at size.
    Return,
    /// As [`OnThin::Return`], this number of times in a job, then as [`OnThin::Continue`]. A pass that ended
    /// early can cost a further pass if the stock rises again; a pass that continues costs none.
    ReturnUpTo(u32),
    /// As [`OnThin::Return`] if the stock left there costs no further pass.
    ReturnIfSaved,
    /// Go on at the largest feed, and take the rest in a later pass.
    Continue,
}

/// Height of a pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PassDepth {
    /// Always to the final size first; the tool backs off where that is too deep.
    Final,
    /// The same, but a depth that is known to be too large is not tried.
    KnownFinal,
    /// In equal parts that take the least time, in at most `extra` passes beyond equation (5).
    Bounded {
        /// Passes beyond equation (5), including those that ended on thin positions.
        extra: u32,
    },
    /// In equal parts that take the least time, as far as the stock is known.
    LeastTime {
        /// The face is at position 0, so that the position of its contact gives the height of the stock.
        face_is_known: bool,
    },
}

impl Strategy {
    /// The paper, literally.
    #[must_use]
    pub fn literal(regime: &Regime) -> Self {
        Self {
            entry_feed_mm_rev: regime.feed_max_mm_rev,
            resume_feed_mm_rev: regime.feed_back_off_mm_rev,
            preview: false,
            anticipation_rev: 0.0,
            on_thin: OnThin::Return,
            depth: PassDepth::Final,
        }
    }

    /// With the results of simulations: enters with `s_o`, resumes with `s_min`, slows down for its own
    /// shoulders.
    #[must_use]
    pub fn safe(regime: &Regime) -> Self {
        Self {
            entry_feed_mm_rev: regime.feed_back_off_mm_rev,
            resume_feed_mm_rev: regime.feed_min_mm_rev,
            preview: true,
            anticipation_rev: 1.0,
            on_thin: OnThin::ReturnUpTo(SAFE_EXTRA),
            depth: PassDepth::Bounded { extra: SAFE_EXTRA },
        }
    }

    /// [`Strategy::safe`] with depths that take the least time.
    #[must_use]
    pub fn fast(regime: &Regime, face_is_known: bool) -> Self {
        Self {
            entry_feed_mm_rev: regime.feed_max_mm_rev,
            resume_feed_mm_rev: regime.feed_min_mm_rev,
            preview: true,
            anticipation_rev: 1.0,
            on_thin: OnThin::ReturnIfSaved,
            depth: PassDepth::LeastTime { face_is_known },
        }
    }
}

/// Settings of the controller.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TurningSettings {
    /// Depths and feeds.
    pub regime: Regime,
    /// The cutting edge.
    pub tool: CuttingEdge,
    /// How passes are chosen.
    pub strategy: Strategy,
    /// Speed of the spindle, rev/min.
    pub spindle_rpm: f64,
    /// Length of the cut, mm: end of the last pass.
    pub length_mm: f64,
    /// Length of stock after the end of the cut, mm: infinite at a shoulder, 0 if the stock ends with the
    /// cut.
    pub beyond_mm: f64,
    /// A cone after the cylinder, up to the end of the cut.
    pub cone: Option<Cone>,
    /// Maximum height of the stock above the final size, mm: above it the tool moves freely.
    pub allowance_max_mm: f64,
    /// Clearance outwards, mm.
    pub clear_out_mm: f64,
    /// Clearance before the stock along the cut, mm.
    pub clear_along_mm: f64,
    /// Load above which the tool is in contact.
    pub contact_load_n: f64,
    /// Load above which the tool is drawn out, ...
    pub overload_n: f64,
    /// ... if it lasts for this time, s.
    pub overload_s: f64,
    /// What the sensor shows of the force.
    pub scale: LoadScale,
    /// Lag of the sensor, s.
    pub sensor_lag_s: f64,
    /// Longest time between two readings, s.
    pub sensor_stale_s: f64,
    /// Fastest rise of the feed, mm/rev per s.
    pub slew_up_mm_rev_s: f64,
    /// Fastest fall of the feed, mm/rev per s.
    pub slew_down_mm_rev_s: f64,
    /// Distance over which a position must be thin before the strategy reacts, mm.
    pub thin_mm: f64,
    /// Time for which a cut must be too deep before the tool backs off, s.
    pub confirm_s: f64,
    /// Stock that may remain, mm.
    pub tolerance_mm: f64,
    /// Speed of moves out and in, mm/s.
    pub out_speed_mm_s: f64,
    /// Speed of moves along the cut where there is no stock, mm/s.
    pub rapid_mm_s: f64,
    /// Limits of the axis along the cut.
    pub along_limits: ScalarLimits,
    /// Limits of the axis across it.
    pub out_limits: ScalarLimits,
    /// Control period, s.
    pub period_s: f64,
}

/// Why the settings are rejected.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum SettingsError {
    /// A number out of range.
    #[error("{name} is {}; it must lie from {min} to {max}", plain(*.value))]
    Number {
        /// Name.
        name: &'static str,
        /// Its value.
        value: f64,
        /// Minimum.
        min: f64,
        /// Maximum.
        max: f64,
    },
    /// A revolution has too few periods.
    #[error(
        "at {spindle_rpm} rev/min a revolution has {cycles:.1} control periods; it needs from 8 to 2000000: \
         change the speed or the control rate"
    )]
    Turn {
        /// Spindle.
        spindle_rpm: f64,
        /// Periods per revolution.
        cycles: f64,
    },
    /// The largest feed is faster than the axis.
    #[error(
        "the largest feed at {spindle_rpm} rev/min is {needed_mm_s:.2} mm/s, and the axis moves at \
         {limit_mm_s:.2} mm/s at the most: lower one of them"
    )]
    AxisSpeed {
        /// Spindle.
        spindle_rpm: f64,
        /// Required.
        needed_mm_s: f64,
        /// Limit of the axis.
        limit_mm_s: f64,
    },
    /// Feeds of the strategy outside the regime.
    #[error(
        "{name} is {} mm/rev; it must lie from the smallest to the largest feed, {min} to {max} mm/rev",
        plain(*.value)
    )]
    StrategyFeed {
        /// Name.
        name: &'static str,
        /// Its value.
        value: f64,
        /// Minimum.
        min: f64,
        /// Maximum.
        max: f64,
    },
    /// The cone does not suit the edge.
    #[error(transparent)]
    Cone(#[from] ConeError),
    /// The stock may be higher than the edge reaches.
    #[error(
        "the stock may stand {allowance_mm:.3} mm above the final size, and the edge reaches {reach_mm:.2} \
         mm: rough it down first, or take a longer edge"
    )]
    Allowance {
        /// Stock.
        allowance_mm: f64,
        /// Edge.
        reach_mm: f64,
    },
    /// Without readings the feed cannot be stopped within a revolution.
    #[error(
        "at {spindle_rpm} rev/min a revolution takes {turn_s:.4} s, and to notice a dead sensor and stop \
         takes {stop_s:.4} s: read the sensor more often, allow for fewer missing readings, or turn slower"
    )]
    SensorLoss {
        /// Spindle.
        spindle_rpm: f64,
        /// A revolution.
        turn_s: f64,
        /// Time to notice and stop.
        stop_s: f64,
    },
    /// The overload limit is not above the set load.
    #[error("the overload limit {overload_n} must lie above the set load {set_load}")]
    Overload {
        /// Limit.
        overload_n: f64,
        /// Set.
        set_load: f64,
    },
}

impl TurningSettings {
    /// Usual values. Only the arguments have to be chosen.
    #[must_use]
    pub fn usual(regime: Regime, tool: CuttingEdge, spindle_rpm: f64, length_mm: f64) -> Self {
        Self {
            regime,
            tool,
            strategy: Strategy::safe(&regime),
            spindle_rpm,
            length_mm,
            beyond_mm: f64::INFINITY,
            cone: None,
            allowance_max_mm: tool.reach_mm(),
            clear_out_mm: 1.0,
            clear_along_mm: 1.0,
            contact_load_n: 0.05 * regime.set_load,
            overload_n: 1.5 * regime.set_load,
            overload_s: 0.02,
            scale: LoadScale::FORCE,
            sensor_lag_s: 0.01,
            sensor_stale_s: 0.01,
            slew_up_mm_rev_s: 1.0,
            slew_down_mm_rev_s: 40.0,
            thin_mm: 3.0,
            confirm_s: 0.06,
            tolerance_mm: 0.02,
            out_speed_mm_s: 8.0,
            rapid_mm_s: 166.0,
            along_limits: ScalarLimits {
                velocity: 200.0,
                acceleration: 2000.0,
                jerk: 50_000.0,
            },
            out_limits: ScalarLimits {
                velocity: 100.0,
                acceleration: 2000.0,
                jerk: 50_000.0,
            },
            period_s: 0.001,
        }
    }

    /// End of a pass at a height, mm along the cut. The edge leaves a wall along itself. All passes leave the
    /// same wall; otherwise the last of them would meet the stock between their walls with its whole edge at
    /// once. Real-time safe.
    #[must_use]
    pub fn end_mm(&self, out_mm: f64) -> f64 {
        let above_mm = (out_mm - self.height_at_end_mm()).max(0.0);
        self.length_mm + (above_mm / self.tool.slope()).min(self.beyond_mm)
    }

    /// Distance of the highest pass beyond the end of the cut, mm.
    #[must_use]
    pub fn shoulder_mm(&self) -> f64 {
        self.end_mm(self.allowance_max_mm) - self.length_mm
    }

    /// Height of the final contour at the end of the cut, mm.
    #[must_use]
    pub fn height_at_end_mm(&self) -> f64 {
        self.cone.map_or(0.0, |cone| cone.height_mm(self.length_mm))
    }

    /// Duration of a revolution, s.
    #[must_use]
    pub fn turn_s(&self) -> f64 {
        60.0 / self.spindle_rpm
    }

    /// Dwell at the end of a cut, s: one revolution, so that the end is round.
    #[must_use]
    pub fn dwell_s(&self) -> f64 {
        1.05 * self.turn_s()
    }

    /// Axis speed at a feed, mm/s.
    #[must_use]
    pub fn speed_mm_s(&self, feed_mm_rev: f64) -> f64 {
        feed_mm_rev * self.spindle_rpm / 60.0
    }

    /// Time for which the feed may continue at its minimum without plausible readings, s, so that it stops
    /// within a revolution after the last good one. Negative if that is impossible.
    #[must_use]
    pub fn blind_s(&self) -> f64 {
        let (limits, speed) = (&self.along_limits, self.speed_mm_s(self.regime.feed_max_mm_rev));
        let braking = speed / limits.acceleration + 2.0 * (speed / limits.jerk).sqrt();
        0.95 * self.turn_s() - braking - LoadWatch::notice_s(self.sensor_stale_s, self.period_s)
    }

    /// Checks all settings.
    ///
    /// # Errors
    /// The first setting that is invalid, with its numbers.
    pub fn check(&self) -> Result<(), SettingsError> {
        check_ranges(&self.process_numbers())?;
        self.check_cone()?;
        check_ranges(&axis_numbers(&self.along_limits, ALONG))?;
        check_ranges(&axis_numbers(&self.out_limits, ACROSS))?;
        self.check_motion()?;
        self.check_strategy()?;
        self.check_protection()
    }

    /// Numbers of the process with their ranges.
    fn process_numbers(&self) -> [Ranged; 20] {
        let regime = &self.regime;
        let max_load = 1e9;
        [
            ("the spindle's speed in rev/min", self.spindle_rpm, 0.1, 1e5),
            ("the control period in s", self.period_s, 1e-5, 0.02),
            ("the length of the cut in mm", self.length_mm, 0.1, 1e4),
            ("the way behind the cut in mm", self.beyond_mm, 0.0, f64::INFINITY),
            ("the largest allowance in mm", self.allowance_max_mm, 0.0, 1e3),
            ("the clearance outwards in mm", self.clear_out_mm, 0.01, 100.0),
            ("the clearance along in mm", self.clear_along_mm, 0.01, 100.0),
            (
                "the load of contact",
                self.contact_load_n,
                1e-9,
                0.5 * regime.set_load,
            ),
            ("the overload limit", self.overload_n, 1e-9, max_load),
            ("the duration of an overload in s", self.overload_s, 0.0, 1.0),
            ("the sensor's lag in s", self.sensor_lag_s, 0.0, 1.0),
            (
                "the longest time between readings in s",
                self.sensor_stale_s,
                0.0,
                1.0,
            ),
            (
                "the fastest rise of the feed in mm/rev per s",
                self.slew_up_mm_rev_s,
                1e-3,
                1e4,
            ),
            (
                "the fastest fall of the feed in mm/rev per s",
                self.slew_down_mm_rev_s,
                1e-1,
                1e5,
            ),
            ("the way of a thin place in mm", self.thin_mm, 0.0, 1e3),
            ("the time of a deep place in s", self.confirm_s, 0.0, 10.0),
            ("the tolerance in mm", self.tolerance_mm, 0.0, 10.0),
            (
                "the speed of moves across in mm/s",
                self.out_speed_mm_s,
                0.01,
                1e4,
            ),
            ("the rapid speed in mm/s", self.rapid_mm_s, 0.01, 1e4),
            (
                "the anticipation in revolutions",
                self.strategy.anticipation_rev,
                0.0,
                5.0,
            ),
        ]
    }

    /// The cone is within the cut, and the edge does not cut into it.
    fn check_cone(&self) -> Result<(), SettingsError> {
        let Some(cone) = &self.cone else {
            return Ok(());
        };
        cone.check(&self.tool)?;
        check_ranges(&[
            (
                "the place of the cone in mm along the cut",
                cone.from_mm,
                0.0,
                self.length_mm,
            ),
            (
                "the height of the cone in mm",
                cone.height_mm(self.length_mm),
                0.0,
                self.allowance_max_mm + 1e-9,
            ),
        ])
    }

    /// Limits of the spindle and of the axis along the cut.
    fn check_motion(&self) -> Result<(), SettingsError> {
        let cycles = self.turn_s() / self.period_s;
        if !(8.0..=2e6).contains(&cycles) {
            return Err(SettingsError::Turn {
                spindle_rpm: self.spindle_rpm,
                cycles,
            });
        }
        let needed_mm_s = self.speed_mm_s(self.regime.feed_max_mm_rev);
        if needed_mm_s > self.along_limits.velocity {
            return Err(SettingsError::AxisSpeed {
                spindle_rpm: self.spindle_rpm,
                needed_mm_s,
                limit_mm_s: self.along_limits.velocity,
            });
        }
        Ok(())
    }

    /// Feeds of the strategy.
    fn check_strategy(&self) -> Result<(), SettingsError> {
        for (name, value) in [
            ("the entry feed", self.strategy.entry_feed_mm_rev),
            ("the feed after backing off", self.strategy.resume_feed_mm_rev),
        ] {
            let (min, max) = (self.regime.feed_min_mm_rev, self.regime.feed_max_mm_rev);
            if !(min..=max).contains(&value) {
                return Err(SettingsError::StrategyFeed {
                    name,
                    value,
                    min,
                    max,
                });
            }
        }
        Ok(())
    }

    /// Reach of the edge, and requirements of protection.
    fn check_protection(&self) -> Result<(), SettingsError> {
        let reach_mm = self.tool.reach_mm();
        if self.allowance_max_mm > reach_mm + 1e-9 {
            return Err(SettingsError::Allowance {
                allowance_mm: self.allowance_max_mm,
                reach_mm,
            });
        }
        if self.blind_s() < 0.0 {
            return Err(SettingsError::SensorLoss {
                spindle_rpm: self.spindle_rpm,
                turn_s: self.turn_s(),
                stop_s: self.turn_s() - self.blind_s(),
            });
        }
        if self.overload_n <= self.regime.set_load {
            return Err(SettingsError::Overload {
                overload_n: self.overload_n,
                set_load: self.regime.set_load,
            });
        }
        Ok(())
    }
}

/// Name with unit, value, minimum and maximum.
type Ranged = (&'static str, f64, f64, f64);

/// Names of an axis's limits.
type LimitNames = [&'static str; 3];

const ALONG: LimitNames = [
    "the axis's velocity along in mm/s",
    "the axis's acceleration along in mm/s2",
    "the axis's jerk along in mm/s3",
];
const ACROSS: LimitNames = [
    "the axis's velocity across in mm/s",
    "the axis's acceleration across in mm/s2",
    "the axis's jerk across in mm/s3",
];

fn axis_numbers(limits: &ScalarLimits, [velocity, acceleration, jerk]: LimitNames) -> [Ranged; 3] {
    [
        (velocity, limits.velocity, 1e-3, 1e5),
        (acceleration, limits.acceleration, 1e-2, 1e7),
        (jerk, limits.jerk, 1e-1, 1e10),
    ]
}

/// # Errors
/// The first number that is out of its range, or NaN.
fn check_ranges(numbers: &[Ranged]) -> Result<(), SettingsError> {
    for &(name, value, min, max) in numbers {
        if !(min..=max).contains(&value) {
            return Err(SettingsError::Number {
                name,
                value,
                min,
                max,
            });
        }
    }
    Ok(())
}
