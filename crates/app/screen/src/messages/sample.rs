//! Setpoints for the scope, in binary.

use evolvent_wire::Setpoint;

/// Bytes of a sample. Little-endian: time (f64, s), line (u32), 0 (u32), feed (f64, mm/s), position, velocity and
/// acceleration of nine axes (f32).
pub const SAMPLE_BYTES: usize = 24 + 27 * 4;

/// Appends a setpoint.
pub fn put_sample(bytes: &mut Vec<u8>, setpoint: &Setpoint) {
    bytes.extend((setpoint.due_time_ns as f64 * 1e-9).to_le_bytes());
    bytes.extend(setpoint.line.to_le_bytes());
    bytes.extend(0_u32.to_le_bytes());
    bytes.extend(setpoint.feed_mm_s.to_le_bytes());
    for list in [&setpoint.position, &setpoint.velocity, &setpoint.acceleration] {
        for value in list {
            bytes.extend((*value as f32).to_le_bytes());
        }
    }
}
