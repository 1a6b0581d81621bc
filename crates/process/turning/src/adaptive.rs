//! Adaptive feed for any program: a factor of the programmed feed that holds a set load.
//!
//! LinuxCNC's M52 multiplies the feed by a pin and leaves law and protection to others. This type includes
//! both: it computes the load at the programmed feed from the present load and feed (`load ~ feed^exponent`).
//! The factor follows from that load at once, within limits and slew rates. Readings that fail the
//! plausibility checks reduce the feed and then stop it. A load that goes away in a cut never raises the
//! factor: the cut may have ended, the insert may be broken, or the sensor dead.

use evolvent_config::plain;
use evolvent_machine::LoadSample;

use crate::chip::ChipTrail;
use crate::law::CutLaw;
use crate::recent_cut::RecentCut;
use crate::state::Reason;
use crate::watch::{LoadWatch, SensorTrouble};

/// Smallest fraction of the programmed feed at which the load still gives a depth.
const MIN_FACTOR: f64 = 0.02;
/// Revolutions without load after which the tool is out of the cut: one, so that an interrupted cut is not
/// left, and the time in which the filtered load falls.
const AIR_TURNS: f64 = 1.1;
/// Fraction of the set load that a cut may have at the idle factor to be left as air. The sensor cannot show
/// whether such a cut has ended; if it has not, the feed may rise to the idle factor in it, with as much
/// margin again for stock that grows.
const LIGHT: f64 = 0.5;
/// Fraction of the mean cut of a revolution below which the load may be on its way to zero, and the factor
/// does not rise. Noise of 5 % is less after smoothing; an even cut does not fall below.
const FALLING: f64 = 0.8;
/// Revolutions after the last good reading after which the feed stops.
const STAND_TURNS: f64 = 0.9;
/// Time constants of the sensor over which the growth of a cut is extrapolated.
pub(crate) const AHEAD_LAGS: f64 = 2.0;
/// Time constants of the sensor after which it shows the load of the present cut.
const SHOWN_LAGS: f64 = 3.0;

/// Limits and reactions, for one tool.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdaptiveSettings {
    /// The load to hold.
    pub set_load: f64,
    /// Exponent of the feed in the load, 0.05 to 3.
    pub feed_exponent: f64,
    /// Smallest factor of the programmed feed, above 0.
    pub factor_min: f64,
    /// Largest factor while cutting, up to 2.
    pub factor_max: f64,
    /// Factor from the first contact until the tool has cut for one revolution. Also the largest factor after
    /// the load of a cut is lost, until it returns or a rapid follows.
    pub factor_entry: f64,
    /// Factor in air: after a rapid, and after a light cut.
    pub factor_idle: f64,
    /// Load above which the tool is in contact.
    pub contact_load: f64,
    /// Load above which the feed is held, ...
    pub overload: f64,
    /// ... if it lasts for this time, s.
    pub overload_s: f64,
    /// Fastest rise of the factor, 1/s.
    pub slew_up_per_s: f64,
    /// Fastest fall of the factor, 1/s.
    pub slew_down_per_s: f64,
    /// Longest time between two readings, s.
    pub stale_s: f64,
    /// Time over which the load repeats, s: a revolution of the work (turning) or of the tool (milling).
    pub turn_s: f64,
    /// Edges that pass in a revolution, each with its own chip: 1 in turning, the number of teeth in milling.
    pub edges: u32,
    /// Time constant of the sensor including delays of its readings, s.
    pub lag_s: f64,
    /// Control period, s.
    pub period_s: f64,
}

impl AdaptiveSettings {
    /// Usual values for a sensor with a time constant of 10 ms. Only the arguments have to be chosen.
    #[must_use]
    pub fn usual(set_load: f64, turn_s: f64, period_s: f64) -> Self {
        Self {
            set_load,
            feed_exponent: 0.75,
            factor_min: 0.2,
            factor_max: 1.5,
            factor_entry: 0.8,
            factor_idle: 1.5,
            contact_load: 0.05 * set_load,
            overload: 1.5 * set_load,
            overload_s: 0.02,
            slew_up_per_s: 2.0,
            slew_down_per_s: 100.0,
            stale_s: 0.01,
            turn_s,
            edges: 1,
            lag_s: 0.01,
            period_s,
        }
    }
}

/// A setting is out of range.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("{name} is {}; it must lie from {min} to {max}", plain(*.value))]
pub struct AdaptiveError {
    /// Name of the setting.
    pub name: &'static str,
    /// Its value.
    pub value: f64,
    /// Minimum.
    pub min: f64,
    /// Maximum.
    pub max: f64,
}

/// Why the feed is held.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AdaptiveStop {
    /// The load exceeded the limit for too long.
    Overload {
        /// Load.
        load: f64,
        /// Limit.
        limit: f64,
    },
    /// Even the smallest feed gives more than the overload limit in a steady cut.
    TooDeep {
        /// Load at the smallest feed.
        load: f64,
        /// The overload limit.
        limit: f64,
    },
    /// The readings of the sensor are implausible.
    Sensor(SensorTrouble),
}

impl AdaptiveStop {
    /// A sentence for the operator: what happened and what to do.
    #[must_use]
    pub fn text(&self) -> String {
        match self {
            Self::Overload { load, limit } => format!(
                "the cutting load was {load:.1}, above the limit of {limit:.1}: the feed was stopped; look \
                 at tool and stock, then start again"
            ),
            Self::TooDeep { load, limit } => format!(
                "even the smallest feed would give a load of {load:.1}, above the limit of {limit:.1}: the \
                 feed was stopped; take less depth"
            ),
            Self::Sensor(trouble) => Reason::Sensor(*trouble).text(),
        }
    }
}

/// Feed factor of one cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdaptiveOutput {
    /// Factor of the programmed feed; 0 holds it. The caller multiplies it by the operator's override where
    /// that is below 1.
    pub factor: f64,
    /// Why the feed is held; kept until [`AdaptiveFeed::reset`].
    pub stop: Option<AdaptiveStop>,
    /// There has been no load for more than a revolution.
    pub in_air: bool,
}

/// What the program does in a control period.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CutPhase {
    /// It feeds.
    Feed,
    /// It is held, dwells or waits, with the tool where it is.
    Rest,
    /// A rapid takes the tool away from the cut.
    Rapid,
}

/// Adaptive feed. The output depends on the readings only. Real-time safe.
///
/// ```
/// use evolvent_turning::{AdaptiveFeed, AdaptiveSettings, CutPhase, LoadSample};
/// // 1000 N, a revolution of 0.12 s, a period of 1 ms.
/// let mut feed = AdaptiveFeed::new(AdaptiveSettings::usual(1000.0, 0.12, 0.001))?;
/// let mut factor = 1.0;
/// for sequence in 1..2000_u32 {
///     // A cut that loads with 1500 N at the programmed feed.
///     let value = 1500.0 * f64::powf(factor, 0.75) * (1.0 + 1e-3 * f64::from(sequence % 7));
///     let sample = LoadSample { sequence: sequence.into(), value, range_max: 8000.0 };
///     factor = feed.step(Some(sample), factor, CutPhase::Feed).factor;
/// }
/// assert!((1500.0 * f64::powf(factor, 0.75) / 1000.0 - 1.0).abs() < 0.05);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Copy, Debug)]
pub struct AdaptiveFeed {
    settings: AdaptiveSettings,
    watch: LoadWatch,
    chip: ChipTrail,
    factor: f64,
    stop: Option<AdaptiveStop>,
    overload_s: f64,
    blind_s: f64,
    max_blind_s: f64,
    air_s: f64,
    contact_s: f64,
    recent: RecentCut,
    /// The largest factor since a cut lost its load, until contact for a whole revolution. A rapid raises it to
    /// that of an entry.
    lost_limit: Option<f64>,
}

impl AdaptiveFeed {
    /// Creates the feed control, in air.
    ///
    /// # Errors
    /// A setting that is out of range.
    pub fn new(settings: AdaptiveSettings) -> Result<Self, AdaptiveError> {
        let s = &settings;
        for (name, value, min, max) in [
            ("the set load", s.set_load, 1e-9, 1e9),
            ("the exponent of the feed", s.feed_exponent, 0.05, 3.0),
            ("the smallest factor", s.factor_min, MIN_FACTOR, 1.0),
            ("the largest factor", s.factor_max, s.factor_min, 2.0),
            ("the entry factor", s.factor_entry, s.factor_min, s.factor_max),
            ("the idle factor", s.factor_idle, s.factor_min, 2.0),
            ("the load of contact", s.contact_load, 1e-9, 0.5 * s.set_load),
            ("the overload limit", s.overload, 1.01 * s.set_load, 1e9),
            ("the duration of an overload in s", s.overload_s, 0.0, 10.0),
            ("the fastest rise of the factor per s", s.slew_up_per_s, 1e-3, 1e4),
            (
                "the fastest fall of the factor per s",
                s.slew_down_per_s,
                1e-2,
                1e4,
            ),
            ("the control period in s", s.period_s, 1e-5, 0.02),
            ("the longest time between readings in s", s.stale_s, 0.0, 1.0),
            ("the time of a turn in s", s.turn_s, s.period_s, 60.0),
            ("the number of edges", f64::from(s.edges), 1.0, 100.0),
            ("the lag of the sensor in s", s.lag_s, 0.0, 1.0),
        ] {
            if !(min..=max).contains(&value) {
                return Err(AdaptiveError {
                    name,
                    value,
                    min,
                    max,
                });
            }
        }
        let law = CutLaw {
            coefficient: 1.0,
            depth_exponent: 1.0,
            feed_exponent: s.feed_exponent,
        };
        Ok(Self {
            watch: LoadWatch::new(
                law,
                s.set_load,
                s.period_s,
                s.turn_s,
                (s.lag_s, s.stale_s),
                MIN_FACTOR,
            ),
            chip: ChipTrail::new(s.turn_s / f64::from(s.edges) / s.period_s),
            factor: s.factor_idle,
            stop: None,
            overload_s: 0.0,
            blind_s: 0.0,
            // The feed has to stop within a revolution of the last good reading, less the time to detect the
            // loss.
            max_blind_s: (STAND_TURNS * s.turn_s - LoadWatch::notice_s(s.stale_s, s.period_s))
                .clamp(0.0, 0.5 * s.turn_s),
            air_s: f64::INFINITY,
            contact_s: 0.0,
            recent: RecentCut::new(s.turn_s + SHOWN_LAGS * s.lag_s),
            lost_limit: None,
            settings,
        })
    }

    /// Advances by one control period. `driven` is the actual feed of the axes as a factor of the programmed
    /// feed.
    pub fn step(&mut self, sample: Option<LoadSample>, driven: f64, phase: CutPhase) -> AdaptiveOutput {
        let s = self.settings;
        let driven = if driven.is_finite() && phase == CutPhase::Feed {
            driven
        } else {
            0.0
        };
        let view = self.watch.step(sample, self.chip.step(driven));
        if phase != CutPhase::Feed {
            // Neither is adapted; the next cut starts with a new contact. After a hold the tool is still in the
            // cut: without a load it does not go on as in air. After a rapid it may be in a cut again, and the
            // sensor dead: until a load shows that it is not, the feed is at most that of an entry.
            if phase == CutPhase::Rapid {
                let entry = s.factor_entry.min(1.0);
                self.lost_limit = self.lost_limit.map(|limit| limit.max(entry));
            } else {
                self.lose_contact();
            }
            (self.air_s, self.contact_s, self.blind_s) = (f64::INFINITY, 0.0, 0.0);
            self.watch.forget();
            self.recent.clear();
            self.factor = self.factor.min(s.factor_entry.max(s.factor_min));
            return self.output();
        }
        self.protect(view.now, view.trouble, view.depth_mean_mm);
        // Load at the programmed feed; its maximum over a revolution where the cut is uneven. Growth is
        // extrapolated over the sensor's lag and the revolution in which the chip forms.
        let ahead = 1.0 + AHEAD_LAGS * s.lag_s / s.turn_s;
        let engaged = view.depth_mm.max(view.depth_now_mm + ahead * view.growth_mm);
        if view.now < s.contact_load {
            self.air_s += s.period_s;
        } else {
            (self.air_s, self.contact_s) = (0.0, self.contact_s + s.period_s);
            self.recent.add(self.factor, engaged, s.period_s);
            if self.has_cut_a_revolution() {
                self.lost_limit = None;
            }
        }
        let in_air = self.in_air();
        if in_air {
            self.lose_contact();
        }
        let wish = if self.stop.is_some() {
            0.0
        } else if self.blind_s > 0.0 {
            s.factor_min
        } else if in_air {
            self.lost_limit.unwrap_or(s.factor_idle)
        } else {
            let held = libm::pow(s.set_load / engaged.max(1e-12), 1.0 / s.feed_exponent);
            let max = if self.has_cut_a_revolution() {
                s.factor_max
            } else {
                s.factor_entry
            };
            let held = held.min(max).max(s.factor_min);
            // The reading itself, because the filtered load falls later; as a depth, because a load that falls
            // with the feed is not lost.
            let reading = sample.map_or(view.now, |sample| sample.value.min(view.now));
            let shown = (reading / view.now.max(1e-12)).max(0.0) * view.depth_now_mm;
            if self.air_s > 0.0 || shown < FALLING * view.depth_mean_mm {
                held.min(self.factor.max(s.factor_min))
            } else {
                held
            }
        };
        let (up, down) = (
            self.factor + s.slew_up_per_s * s.period_s,
            self.factor - s.slew_down_per_s * s.period_s,
        );
        self.factor = wish.clamp(down, up).max(0.0);
        self.output()
    }

    fn protect(&mut self, load: f64, trouble: Option<SensorTrouble>, engagement: f64) {
        let s = &self.settings;
        self.blind_s = if trouble.is_some() {
            self.blind_s + s.period_s
        } else {
            0.0
        };
        self.overload_s = if load > s.overload {
            self.overload_s + s.period_s
        } else {
            0.0
        };
        if self.stop.is_some() {
            return;
        }
        let min = engagement * libm::pow(s.factor_min, s.feed_exponent);
        if self.overload_s > s.overload_s {
            self.stop = Some(AdaptiveStop::Overload {
                load,
                limit: s.overload,
            });
        } else if min > s.overload {
            self.stop = Some(AdaptiveStop::TooDeep {
                load: min,
                limit: s.overload,
            });
        } else if let Some(trouble) = trouble
            && self.blind_s > self.max_blind_s
        {
            self.stop = Some(AdaptiveStop::Sensor(trouble));
        }
    }

    /// Whether the readings show the depth of a whole revolution.
    fn has_cut_a_revolution(&self) -> bool {
        self.contact_s >= self.settings.turn_s + SHOWN_LAGS * self.settings.lag_s
    }

    /// The load has been missing for a revolution: the cut has ended, the insert is broken, or the sensor is
    /// dead. Only a cut that is known all round and light at any factor is left as air.
    fn lose_contact(&mut self) {
        let s = &self.settings;
        if self.contact_s > 0.0 {
            let at_idle = self.recent.deepest() * libm::pow(s.factor_idle, s.feed_exponent);
            // All round, before the revolution in which the load fell.
            let is_known = self.contact_s >= 2.0 * s.turn_s + SHOWN_LAGS * s.lag_s;
            if !is_known || at_idle > LIGHT * s.set_load {
                let limit = self.recent.min_factor().min(s.factor_entry).min(s.factor_idle);
                let limit = limit.min(self.lost_limit.unwrap_or(1.0));
                self.lost_limit = Some(limit.max(s.factor_min));
            }
        }
        self.contact_s = 0.0;
        self.recent.clear();
    }

    fn in_air(&self) -> bool {
        self.air_s > AIR_TURNS * self.settings.turn_s
    }

    fn output(&self) -> AdaptiveOutput {
        AdaptiveOutput {
            factor: self.factor,
            stop: self.stop,
            in_air: self.in_air(),
        }
    }

    /// Clears the reason for which the feed was held, after the operator's acknowledgement.
    pub fn reset(&mut self) {
        self.stop = None;
        self.overload_s = 0.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Sensor, SensorFault, SensorModel};

    const TURN_S: f64 = 0.12;
    const PERIOD_S: f64 = 0.002;

    fn settings() -> AdaptiveSettings {
        AdaptiveSettings::usual(2200.0, TURN_S, PERIOD_S)
    }

    #[test]
    fn a_failed_sensor_holds_within_a_revolution() {
        for fault in SensorFault::ALL
            .into_iter()
            // A sensor reads zero in air as well: see the test of lost loads.
            .filter(|fault| *fault != SensorFault::Zero)
        {
            let mut feed = AdaptiveFeed::new(settings()).unwrap();
            let mut sensor = Sensor::new(
                SensorModel {
                    lag_s: 0.01,
                    noise: 0.02,
                    range_max: 8000.0,
                    seed: 1,
                },
                PERIOD_S,
            );
            let mut factor = 1.0;
            for _ in 0..500 {
                let load = 2000.0 * libm::pow(factor, 0.75);
                factor = feed.step(sensor.read(load, None), factor, CutPhase::Feed).factor;
            }
            assert!(factor > 0.5);
            let mut time = 0.0;
            while factor > 0.0 {
                let output = feed.step(sensor.read(2000.0, Some(fault)), factor, CutPhase::Feed);
                factor = output.factor;
                time += PERIOD_S;
                assert!(time <= TURN_S, "{fault:?}");
            }
            let output = feed.step(sensor.read(2000.0, None), 0.0, CutPhase::Feed);
            assert!(matches!(output.stop, Some(AdaptiveStop::Sensor(_))), "{output:?}");
            feed.reset();
            assert_eq!(
                feed.step(sensor.read(2000.0, None), 0.0, CutPhase::Feed).stop,
                None
            );
        }
    }

    #[test]
    fn an_overload_holds_the_feed() {
        let mut feed = AdaptiveFeed::new(settings()).unwrap();
        let sample = |sequence, value| {
            Some(LoadSample {
                sequence,
                value,
                range_max: 8000.0,
            })
        };
        let mut stop = None;
        for k in 0..40 {
            stop = feed.step(sample(k, 5000.0 + k as f64), 0.2, CutPhase::Feed).stop;
        }
        assert!(matches!(
            stop,
            Some(AdaptiveStop::Overload { .. } | AdaptiveStop::TooDeep { .. })
        ));
    }

    #[test]
    fn settings_that_make_no_sense_are_refused() {
        for change in [
            |s: &mut AdaptiveSettings| s.factor_min = 0.0,
            |s: &mut AdaptiveSettings| s.factor_max = f64::NAN,
            |s: &mut AdaptiveSettings| s.overload = 2000.0,
            |s: &mut AdaptiveSettings| s.factor_entry = 1.6,
        ] {
            let mut changed = settings();
            change(&mut changed);
            assert!(AdaptiveFeed::new(changed).is_err(), "{changed:?}");
        }
    }
}
