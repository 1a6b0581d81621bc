//! Settings of the simulated axes.

use evolvent_bus::AXES;
use evolvent_drive::{FollowerSettings, bridge_cycles};
use evolvent_path::AxisMask;

use crate::fault::Fault;
use crate::servo::ServoSettings;

/// Time from the edge of a switch to the reaction of the core, s: the delay that homing permits between two
/// inputs.
const REPORT_S: f64 = 0.06;

/// Index pulses of an encoder, by true positions; mm or degrees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimIndex {
    /// Position of one pulse.
    pub position: f64,
    /// Distance between pulses.
    pub pitch: f64,
}

impl SimIndex {
    /// The first pulse between two positions, in the direction of motion.
    #[must_use]
    pub fn between(&self, from: f64, to: f64) -> Option<f64> {
        let turns = (from - self.position) / self.pitch;
        let at = |turn: f64| self.position + turn * self.pitch;
        if to > from {
            // A pulse at the start belongs to the preceding motion.
            Some(at(turns.floor() + 1.0)).filter(|pulse| *pulse <= to)
        } else {
            Some(at(turns.ceil() - 1.0)).filter(|pulse| *pulse >= to)
        }
    }
}

/// One simulated axis; mm or degrees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimAxis {
    /// Index into X Y Z A B C U V W.
    pub axis: usize,
    /// Maximum velocity.
    pub max_velocity: f64,
    /// Maximum acceleration.
    pub max_acceleration: f64,
    /// Maximum jerk.
    pub max_jerk: f64,
    /// Lowest position. The limit switch is slightly below it, and below the home switch and its pulse.
    pub travel_min: f64,
    /// Highest position. The limit switch is slightly above it, and above the home switch and its pulse.
    pub travel_max: f64,
    /// Position of the axis at the start.
    pub start: f64,
    /// Offset of the encoder's positions from the true ones, until homing corrects it.
    pub reference_offset: f64,
    /// Position at which the home switch closes.
    pub home_switch: f64,
    /// Whether the switch is closed below this position; otherwise above it.
    pub home_switch_is_below: bool,
    /// Velocity of the search for the home switch.
    pub search_velocity: f64,
    /// Whether this is an unlimited rotary axis: switch and pulses repeat every turn, and there are no limit
    /// switches.
    pub unlimited: bool,
    /// Index pulses of the encoder, if it has any.
    pub index: Option<SimIndex>,
    /// The smallest step that the encoder shows.
    pub encoder_step: f64,
    /// The position loop.
    pub servo: ServoSettings,
}

impl SimAxis {
    /// An axis of one metre with typical dynamics, for a machine of which only the letters are known.
    #[must_use]
    pub fn usual(axis: usize) -> Self {
        Self {
            axis,
            max_velocity: 1000.0,
            max_acceleration: 10_000.0,
            max_jerk: 1_000_000.0,
            travel_min: -1000.0,
            travel_max: 1000.0,
            start: 0.0,
            reference_offset: 0.0,
            home_switch: -980.0,
            home_switch_is_below: true,
            search_velocity: 0.0,
            unlimited: false,
            index: Some(SimIndex {
                position: 0.0,
                pitch: 5.0,
            }),
            encoder_step: 0.0001,
            servo: ServoSettings::default(),
        }
    }

    /// Positions of the limit switches: the first is closed below its position, the second above. The limit
    /// switch next to the home switch is beyond the range of homing, even if that range exceeds the travel.
    #[must_use]
    pub fn limit_switches(&self) -> [f64; 2] {
        let margin = (0.02 * (self.travel_max - self.travel_min)).min(5.0);
        let [mut low, mut high] = [self.travel_min, self.travel_max];
        let overrun = self.search_overrun();
        let pulse = self.index.map(|index| index.position);
        for found in [Some(self.home_switch), pulse].into_iter().flatten() {
            if self.home_switch_is_below {
                low = low.min(found - overrun);
            } else {
                high = high.max(found + overrun);
            }
        }
        [low - margin, high + margin]
    }

    /// Distance that a search continues after the switch has closed.
    fn search_overrun(&self) -> f64 {
        let velocity = self.search_velocity;
        // A jerk-limited stop takes at most v / a + a / j, at half of the velocity on average.
        let stop_s = velocity / self.max_acceleration + self.max_acceleration / self.max_jerk;
        velocity * (REPORT_S + 0.5 * stop_s)
    }
}

/// A set of drives.
#[derive(Clone, Debug, PartialEq)]
pub struct SimSettings {
    /// The period of the setpoints, ns.
    pub period_ns: u64,
    /// The axes.
    pub axes: Vec<SimAxis>,
    /// Number of periods for which the last motion continues without setpoints; the default of all bridges if
    /// `None`.
    pub bridge_cycles: Option<u32>,
    /// Maximum distance between an axis and the setpoint at which following begins. The axis moves to the
    /// setpoint within its limits.
    pub sync_tolerance: f64,
    /// Scheduled faults.
    pub faults: Vec<Fault>,
    /// Whether the encoders are absolute, so that their positions refer to the machine's zero at every start.
    pub absolute: bool,
    /// Instance number in every feedback; different for each start of a bridge.
    pub instance: u64,
}

impl SimSettings {
    /// Typical axes for a machine of which only the letters are known.
    #[must_use]
    pub fn usual(letters: &str, period_ns: u64) -> Self {
        let index = |letter: char| "XYZABCUVW".find(letter);
        Self {
            period_ns,
            axes: letters.chars().filter_map(index).map(SimAxis::usual).collect(),
            bridge_cycles: None,
            sync_tolerance: 0.5,
            faults: Vec::new(),
            absolute: false,
            instance: 1,
        }
    }

    /// The set of axes.
    #[must_use]
    pub fn axes_mask(&self) -> AxisMask {
        self.axes
            .iter()
            .filter(|axis| axis.axis < AXES)
            .map(|axis| axis.axis)
            .collect()
    }

    pub(crate) fn follower(&self) -> FollowerSettings {
        let mut settings = FollowerSettings {
            period_ns: self.period_ns,
            // Depends on the period of the running core, which may differ from its machine file.
            bridge_cycles: self
                .bridge_cycles
                .unwrap_or_else(|| bridge_cycles(self.period_ns)),
            axes: self.axes_mask(),
            max_velocity: [1.0; AXES],
            max_acceleration: [1.0; AXES],
            max_jerk: [1.0; AXES],
            sync_tolerance: [self.sync_tolerance; AXES],
        };
        for axis in self.axes.iter().filter(|axis| axis.axis < AXES) {
            settings.max_velocity[axis.axis] = axis.max_velocity;
            settings.max_acceleration[axis.axis] = axis.max_acceleration;
            settings.max_jerk[axis.axis] = axis.max_jerk;
        }
        settings
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limit_switches_leave_room_for_the_search() {
        let mut axis = SimAxis::usual(0);
        assert_eq!(axis.limit_switches(), [-1005.0, 1005.0]);
        (axis.travel_min, axis.travel_max) = (-100.0, 2.54);
        (axis.max_acceleration, axis.max_jerk, axis.search_velocity) = (500.0, 10_000.0, 12.7);
        (axis.home_switch, axis.home_switch_is_below) = (10.85, false);
        axis.index = Some(SimIndex {
            position: 6.35,
            pitch: 9.0,
        });
        let overrun = 12.7 * (0.06 + 0.5 * (12.7 / 500.0 + 500.0 / 10_000.0));
        let margin = 0.02 * 102.54;
        let [low, high] = axis.limit_switches();
        assert_eq!(low, -100.0 - margin);
        assert!((high - (10.85 + overrun + margin)).abs() < 1e-12, "{high}");
        // A home switch within the travel does not move the limit switches.
        (axis.home_switch, axis.home_switch_is_below) = (-50.0, true);
        assert_eq!(axis.limit_switches(), [-100.0 - margin, 2.54 + margin]);
        axis.home_switch = -120.0;
        let [low, high] = axis.limit_switches();
        assert!((low - (-120.0 - overrun - margin)).abs() < 1e-12, "{low}");
        assert_eq!(high, 2.54 + margin);
    }

    #[test]
    fn every_pulse_is_met_once_in_either_direction() {
        let index = SimIndex {
            position: 1.0,
            pitch: 5.0,
        };
        for (from, to) in [(-20.0, 30.0), (30.0, -20.0)] {
            let (mut met, mut at) = (Vec::new(), from);
            let step: f64 = 0.5 * f64::signum(to - from);
            while (to - at) * step > 0.0 {
                met.extend(index.between(at, at + step));
                at += step;
            }
            let expected = [-19.0, -14.0, -9.0, -4.0, 1.0, 6.0, 11.0, 16.0, 21.0, 26.0];
            assert!(met.iter().all(|pulse| expected.contains(pulse)), "{met:?}");
            assert_eq!(met.len(), expected.len());
        }
        assert_eq!(index.between(2.0, 2.0), None);
    }
}
