//! Setpoints for the scope, in binary.

use evolvent_wire::{AXES, Setpoint};

/// Bytes of a sample. Little-endian: time (f64, s), line (u32), flags of the setpoint (u32), feed (f64, mm/s), position, velocity,
/// acceleration and following error of nine axes (f32), load (f32). What nobody has told is NaN.
pub const SAMPLE_BYTES: usize = 24 + 37 * 4;

/// Appends a setpoint, with what drives and sensors have answered to it.
pub fn put_sample(bytes: &mut Vec<u8>, setpoint: &Setpoint, following_error: &[f64; AXES], load: f64) {
    bytes.extend((setpoint.due_time_ns as f64 * 1e-9).to_le_bytes());
    bytes.extend(setpoint.line.to_le_bytes());
    bytes.extend(setpoint.flags.to_le_bytes());
    bytes.extend(setpoint.feed_mm_s.to_le_bytes());
    let lists = [
        &setpoint.position,
        &setpoint.velocity,
        &setpoint.acceleration,
        following_error,
    ];
    for list in lists {
        for value in list {
            bytes.extend((*value as f32).to_le_bytes());
        }
    }
    bytes.extend((load as f32).to_le_bytes());
}
