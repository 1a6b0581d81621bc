//! How a simulated drive is set up.

use crate::motor::Mechanics;

/// What a drive has on its shaft and how it is set up. Positions are turns of the motor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriveSettings {
    /// Increments of the encoder a turn.
    pub resolution: u32,
    /// Motor and load.
    pub mechanics: Mechanics,
    /// Position of the axis at power-up.
    pub start_turns: f64,
    /// What the encoder names that position.
    pub start_increments: i32,
    /// Where the limit switches close.
    pub limits_turns: [f64; 2],
    /// Where the touch probe closes.
    pub probe_turns: f64,
    /// Where the encoder's zero impulse begins within each turn, 0 to below 1.
    pub index_turns: f64,
    /// By how much the speed changes in cyclic synchronous velocity, turns/s2.
    pub velocity_ramp_turns_s2: f64,
    /// The home switch (bit 2 of 60FDh) is on where the load is not beyond this.
    pub home_switch_turns: f64,
    /// The encoder knows its position when supply returns; otherwise it counts from 0 again.
    pub absolute: bool,
}

impl Default for DriveSettings {
    /// 2^20 increments, 400 turns between the switches, at rest in the middle.
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
        }
    }
}
