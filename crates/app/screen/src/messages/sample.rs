//! Setpoints for the scope, in binary.

use evolvent_wire::{AXES, Setpoint};

/// Bytes of a sample of a machine without spindles and signals; each of these has one more f32, three of them
/// a spindle. Little-endian: time (f64, s), line (u32), flags of the setpoint (u32), feed (f64, mm/s),
/// position, velocity, acceleration and following error of nine axes (f32), load (f32), measured velocity, actual
/// position and torque of nine axes (f32), phase error (f32, µs); then of each spindle commanded and measured speed (rpm, negative counter-clockwise) and
/// angle (degrees), and inputs and outputs in the order of the machine (f32). What nobody has told is NaN.
pub const SAMPLE_BYTES: usize = 24 + 65 * 4;

/// What drives, sensors and bridges have answered to a setpoint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SampleAnswer<'a> {
    /// Of each axis.
    pub following_error: &'a [f64; AXES],
    /// Measured, of each axis.
    pub velocity: &'a [f64; AXES],
    /// Actual, of each axis.
    pub position: &'a [f64; AXES],
    /// Torque or force as a ratio of the drive's rated value, of each axis.
    pub torque: &'a [f64; AXES],
    /// Time of the drives' clock minus time of the setpoint, µs.
    pub phase_error_us: f64,
    /// The cutting load.
    pub load: f64,
    /// Figures of spindles, then inputs and outputs.
    pub signals: &'a [f64],
}

/// Appends a setpoint, with what was answered to it.
pub fn put_sample(bytes: &mut Vec<u8>, setpoint: &Setpoint, answer: &SampleAnswer<'_>) {
    bytes.extend((setpoint.due_time_ns as f64 * 1e-9).to_le_bytes());
    bytes.extend(setpoint.line.to_le_bytes());
    bytes.extend(setpoint.flags.to_le_bytes());
    bytes.extend(setpoint.feed_mm_s.to_le_bytes());
    let lists = [
        &setpoint.position,
        &setpoint.velocity,
        &setpoint.acceleration,
        answer.following_error,
    ];
    for list in lists {
        for value in list {
            bytes.extend((*value as f32).to_le_bytes());
        }
    }
    let rest = [answer.load].into_iter().chain(*answer.velocity);
    let rest = rest.chain(*answer.position).chain(*answer.torque);
    let rest = rest.chain([answer.phase_error_us]);
    for value in rest.chain(answer.signals.iter().copied()) {
        bytes.extend((value as f32).to_le_bytes());
    }
}
