//! Settings of a simulated drive.

use crate::motor::Mechanics;

/// The bit mask (60FEh:2) of the digital outputs of a drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OutputMask {
    /// Written by the MainDevice; at power-up it gives the bus no output.
    Writable,
    /// It cannot be written.
    Fixed(u32),
    /// There is none: the bus has all outputs.
    Absent,
}

/// Mechanics, encoder and switches of a drive. Positions are turns of the motor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriveSettings {
    /// Encoder increments per turn.
    pub resolution: u32,
    /// Motor and load.
    pub mechanics: Mechanics,
    /// Position of the axis at power-up.
    pub start_turns: f64,
    /// Encoder count at that position.
    pub start_increments: i32,
    /// Positions at which the limit switches close.
    pub limits_turns: [f64; 2],
    /// Position at which the touch probe closes.
    pub probe_turns: f64,
    /// Start of the encoder's zero impulse within each turn, 0 to below 1.
    pub index_turns: f64,
    /// Acceleration in cyclic synchronous velocity mode, turns/s2.
    pub velocity_ramp_turns_s2: f64,
    /// The home switch (bit 2 of 60FDh) is on up to this position of the load.
    pub home_switch_turns: f64,
    /// Whether the encoder is absolute; otherwise it counts from 0 again when the supply returns.
    pub absolute: bool,
    /// Maximum speed of the motor (6080h), rpm; without it the object is absent.
    pub max_motor_rpm: Option<u32>,
    /// Maximum profile velocity (607Fh), turns/s; without it the object is absent.
    pub max_profile_turns_s: Option<u32>,
    /// Maximum acceleration (60C5h), turns/s2; without it the object is absent.
    pub max_turns_s2: Option<u32>,
    /// Quick stop deceleration (6085h), turns/s2.
    pub quick_stop_turns_s2: u32,
    /// The bit mask of its digital outputs (60FEh).
    pub output_mask: OutputMask,
    /// What these outputs (60FEh:1) hold at power-up.
    pub start_outputs: u32,
}

impl Default for DriveSettings {
    /// 2^20 increments per turn, 400 turns between the limit switches, start in the middle. The quick stop is
    /// harder than the axes of the shipped machines.
    fn default() -> Self {
        Self {
            resolution: 1 << 20,
            mechanics: Mechanics::default(),
            start_turns: 0.0,
            start_increments: 0,
            limits_turns: [-200.0, 200.0],
            probe_turns: 1000.0,
            index_turns: 0.0,
            velocity_ramp_turns_s2: 2000.0 / 60.0,
            home_switch_turns: f64::NEG_INFINITY,
            absolute: false,
            max_motor_rpm: None,
            max_profile_turns_s: None,
            max_turns_s2: None,
            quick_stop_turns_s2: 1500,
            output_mask: OutputMask::Writable,
            start_outputs: 0,
        }
    }
}
