//! The limits within which a bridge follows setpoints.

use evolvent_path::AxisMask;
use thiserror::Error;

use evolvent_wire::AXES;

/// Number of periods for which motion continues without setpoints, at rates at which they last longer than
/// [`SHORTEST_BRIDGED_NS`].
const BRIDGED_CYCLES: u64 = 10;
/// Minimum time for which motion continues without setpoints, ns: the default lead between sending a setpoint
/// and its due time, and so the lateness that is expected of a host. In this time an axis leaves its path by
/// at most a t^2 / 2, which is 0.02 mm at 10 m/s2.
const SHORTEST_BRIDGED_NS: u64 = 2_000_000;
/// Maximum of [`FollowerSettings::bridge_cycles`].
const MAX_BRIDGE_CYCLES: u32 = 100;

/// Number of periods of `period_ns` for which motion continues without setpoints: ten, but at least 2 ms, and
/// at most 100 periods.
///
/// ```
/// assert_eq!(evolvent_drive::bridge_cycles(1_000_000), 10);
/// // At 35 kHz ten periods are 0.29 ms, which the pauses of a host exceed.
/// assert_eq!(evolvent_drive::bridge_cycles(28_571), 71);
/// ```
#[must_use]
pub fn bridge_cycles(period_ns: u64) -> u32 {
    let cycles = SHORTEST_BRIDGED_NS.div_ceil(period_ns.max(1)).max(BRIDGED_CYCLES);
    u32::try_from(cycles).map_or(MAX_BRIDGE_CYCLES, |cycles| cycles.min(MAX_BRIDGE_CYCLES))
}

/// The limits of a follower. Lengths are mm or degrees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FollowerSettings {
    /// The period of the setpoints, ns.
    pub period_ns: u64,
    /// Number of periods for which the last motion continues if setpoints are missing: see [`bridge_cycles`].
    pub bridge_cycles: u32,
    /// Bit i set: axis i is driven.
    pub axes: AxisMask,
    /// Maximum velocity of each axis.
    pub max_velocity: [f64; AXES],
    /// Maximum acceleration.
    pub max_acceleration: [f64; AXES],
    /// Maximum jerk.
    pub max_jerk: [f64; AXES],
    /// Maximum distance of a setpoint from the axis at which following starts. It decays to zero within a
    /// twentieth of the axis' limits, in addition to the motion of the setpoints: no target steps.
    pub sync_tolerance: [f64; AXES],
}

impl FollowerSettings {
    pub(crate) fn check(&self) -> Result<(), SettingsError> {
        if !(1_000..=1_000_000_000).contains(&self.period_ns) {
            return Err(SettingsError::Period {
                period_ns: self.period_ns,
            });
        }
        if self.bridge_cycles > MAX_BRIDGE_CYCLES {
            return Err(SettingsError::BridgeCycles {
                cycles: self.bridge_cycles,
            });
        }
        for axis in self.axes.axes() {
            let limits = [
                self.max_velocity[axis],
                self.max_acceleration[axis],
                self.max_jerk[axis],
                self.sync_tolerance[axis],
            ];
            if let Some(&value) = limits.iter().find(|&&limit| !(limit.is_finite() && limit > 0.0)) {
                return Err(SettingsError::Limit { axis, value });
            }
        }
        Ok(())
    }

    /// Velocity, acceleration and jerk of an axis.
    pub(crate) const fn limits(&self, axis: usize) -> [f64; 3] {
        [
            self.max_velocity[axis],
            self.max_acceleration[axis],
            self.max_jerk[axis],
        ]
    }
}

/// Why settings are invalid.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum SettingsError {
    /// A value of an axis is not a valid limit.
    #[error("axis {axis} has {value} as a limit: it must be a positive number")]
    Limit {
        /// The axis.
        axis: usize,
        /// The number.
        value: f64,
    },
    /// The period is invalid.
    #[error("a period of {period_ns} ns is out of range: it must be 1000 ns to 1 s")]
    Period {
        /// The period in ns.
        period_ns: u64,
    },
    /// Too many periods without setpoints.
    #[error("{cycles} periods without setpoints are too many to continue: at most 100")]
    BridgeCycles {
        /// The number.
        cycles: u32,
    },
}
