//! The limits of a bridge's follower.

use evolvent_drive::{FollowerSettings, bridge_cycles};
use evolvent_machine::Machine;
use evolvent_path::{AXES, AxisMask};

/// Maximum distance of a setpoint from the axis at which following starts, mm or degrees; less if the machine
/// permits only a smaller following error. The follower lets it decay within the limits of the axes.
const SYNC_TOLERANCE: f64 = 0.5;

/// Settings of a follower for `axes` with the limits of the machine file.
#[must_use]
pub fn follower_settings(machine: &Machine, axes: AxisMask, period_ns: u64) -> FollowerSettings {
    let mut settings = FollowerSettings {
        period_ns,
        bridge_cycles: bridge_cycles(period_ns),
        axes,
        max_velocity: [1.0; AXES],
        max_acceleration: [1.0; AXES],
        max_jerk: [1.0; AXES],
        sync_tolerance: [SYNC_TOLERANCE; AXES],
    };
    for axis in &machine.axes {
        let index = axis.letter.index();
        settings.max_velocity[index] = axis.max_velocity;
        settings.max_acceleration[index] = axis.max_acceleration;
        settings.max_jerk[index] = axis.max_jerk;
        settings.sync_tolerance[index] = SYNC_TOLERANCE.min(axis.following_error);
    }
    settings
}
