//! Two machines for other tests: a mill, and a heavy one with 0.01 g.

use evolvent_drive::{FollowerSettings, bridge_cycles};
use evolvent_path::AxisMask;
use evolvent_wire::AXES;

/// Velocity, acceleration and jerk of every axis.
pub(crate) const MILL: [f64; 3] = [500.0, 5_000.0, 200_000.0];
pub(crate) const HEAVY: [f64; 3] = [16.7, 98.0, 5_000.0];

/// A follower of X and Y that begins within `sync_tolerance`, mm.
pub(crate) fn settings(
    period_ns: u64,
    [velocity, acceleration, jerk]: [f64; 3],
    sync_tolerance: f64,
) -> FollowerSettings {
    FollowerSettings {
        period_ns,
        bridge_cycles: bridge_cycles(period_ns),
        axes: AxisMask::from_bits(0b11),
        max_velocity: [velocity; AXES],
        max_acceleration: [acceleration; AXES],
        max_jerk: [jerk; AXES],
        sync_tolerance: [sync_tolerance; AXES],
    }
}
