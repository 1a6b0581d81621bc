//! The settings of a board: the contents of a board file, checked.

use std::net::IpAddr;

use evolvent_drive::{GantrySettings, OrientationSettings, SpindleEncoderSettings};

/// A board file, checked.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardSettings {
    /// The name of the file, for messages.
    pub file: String,
    /// Address of the board.
    pub address: IpAddr,
    /// The required name of the board.
    pub name: Option<String>,
    /// Maximum number of consecutive lost packets.
    pub max_lost_packets: u32,
    /// Time of the watchdog, s.
    pub watchdog_s: f64,
    /// Frequency of the PWM generators, Hz.
    pub pwm_hz: f64,
    /// Short filter of inputs, s.
    pub input_filter_s: f64,
    /// Long filter of inputs, s.
    pub slow_filter_s: f64,
    /// Smart-serial devices.
    pub remotes: Vec<RemoteSettings>,
    /// The axes.
    pub axes: Vec<BoardAxis>,
    /// Inputs by name.
    pub inputs: Vec<InputPin>,
    /// Outputs by name.
    pub outputs: Vec<OutputPin>,
    /// The spindles.
    pub spindles: Vec<BoardSpindle>,
    /// The file has `[spindle]` instead of `[[spindle]]`, so that the spindle's key has no index.
    pub has_single_spindle: bool,
    /// Flood and mist.
    pub coolant: [Option<Pin>; 2],
}

/// A smart-serial device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RemoteSettings {
    /// Number of the module.
    pub port: usize,
    /// Channel.
    pub channel: usize,
    /// Required name.
    pub name: Option<String>,
    /// Mode.
    pub mode: u8,
}

/// A pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pin {
    /// Number on the board, or of a field input or output.
    pub pin: usize,
    /// The smart-serial device of the pin.
    pub remote: Option<usize>,
    /// Low is on.
    pub inverted: bool,
    /// An input with the long filter.
    pub slow: bool,
}

/// The source of an input.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum InputSource {
    /// From a pin.
    Pin(Pin),
    /// Counts of the encoder of this number since the start of the bridge; reversed if it is inverted.
    Encoder {
        /// Number.
        unit: usize,
        /// Whether the direction is reversed.
        inverted: bool,
    },
    /// A number from a smart-serial device, in the device's unit.
    Remote {
        /// The device.
        remote: usize,
        /// The number's name.
        data: String,
    },
}

/// An input.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InputPin {
    /// Name in the machine file.
    pub name: String,
    /// Its source.
    pub source: InputSource,
}

/// The target of an output.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum OutputTarget {
    /// To a pin.
    Pin(Pin),
    /// To a PWM generator.
    Pwm {
        /// Number.
        unit: usize,
        /// Value at full output.
        full: f64,
    },
}

/// An output.
#[derive(Clone, Debug, PartialEq)]
pub struct OutputPin {
    /// Name in the machine file.
    pub name: String,
    /// Its target.
    pub target: OutputTarget,
}

/// The output of a spindle's speed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SpindleSpeed {
    /// A PWM generator.
    Pwm {
        /// Number.
        unit: usize,
        /// Speed at full output, rpm.
        full_rpm: f64,
        /// Negative counter-clockwise.
        signed: bool,
    },
    /// The spindle outputs of a smart-serial device.
    Remote {
        /// The device.
        remote: usize,
        /// Speed at full output, rpm.
        full_rpm: f64,
    },
}

/// The encoder of a spindle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpindleAngleSource {
    /// Its number.
    pub encoder: usize,
    /// The rising edge of its index input is the index pulse; otherwise the falling one.
    pub index_rising: bool,
    /// Counts, gear, tolerances.
    pub settings: SpindleEncoderSettings,
}

impl SpindleAngleSource {
    /// Counts per turn of the spindle.
    pub(crate) fn counts_per_turn(&self) -> f64 {
        let [encoder, spindle] = self.settings.gear.map(f64::from);
        f64::from(self.settings.counts_per_turn) * encoder / spindle
    }
}

/// Orientation of a spindle (M19).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SpindleOrienting {
    /// A position loop of the bridge.
    Loop(OrientationSettings),
    /// The drive.
    Drive {
        /// Output that commands it.
        command: Pin,
        /// Input that reports that the spindle is at its angle.
        reached: Pin,
        /// The drive's angle, degrees.
        angle_deg: f64,
    },
}

/// A spindle, checked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoardSpindle {
    /// Number in the machine file.
    pub number: usize,
    /// Its speed.
    pub speed: Option<SpindleSpeed>,
    /// Clockwise.
    pub forward: Option<Pin>,
    /// Counter-clockwise.
    pub reverse: Option<Pin>,
    /// Enables the drive.
    pub enable: Option<Pin>,
    /// The drive's fault.
    pub fault: Option<Pin>,
    /// The drive's report that the speed is reached.
    pub at_speed: Option<Pin>,
    /// Its encoder.
    pub angle: Option<SpindleAngleSource>,
    /// M19.
    pub orienting: Option<SpindleOrienting>,
}

/// Times of a step generator, ns.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepTiming {
    /// Length of a pulse.
    pub length_ns: f64,
    /// Between two pulses.
    pub space_ns: f64,
    /// Direction before a step.
    pub setup_ns: f64,
    /// Direction after a step.
    pub hold_ns: f64,
}

/// Gains of the position loop of a servo axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gains {
    /// Proportional, 1/s.
    pub p: f64,
    /// Integral, 1/s2.
    pub i: f64,
    /// Derivative.
    pub d: f64,
}

/// Actuator of an axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Actuator {
    /// A stepper, or a servo with step and direction.
    Steps {
        /// Step generator.
        unit: usize,
        /// Times of its pulses.
        timing: StepTiming,
    },
    /// A servo with velocity as an analog value.
    Servo {
        /// Encoder.
        encoder: usize,
        /// The rising edge of its index input is the index pulse; otherwise the falling one.
        index_rising: bool,
        /// PWM generator.
        pwm: usize,
        /// Velocity at full output, per second.
        full_velocity: f64,
        /// The loop.
        gains: Gains,
    },
}

impl Actuator {
    /// The unit that counts its position, and its number.
    pub(crate) const fn counter(&self) -> (&'static str, usize) {
        match self {
            Self::Steps { unit, .. } => ("step generator", *unit),
            Self::Servo { encoder, .. } => ("encoder", *encoder),
        }
    }
}

/// An axis, checked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoardAxis {
    /// Index into X Y Z A B C U V W.
    pub axis: usize,
    /// Its actuator.
    pub actuator: Actuator,
    /// Steps or counts per mm or degree, positive.
    pub per_unit: f64,
    /// The motor turns against the axis.
    pub inverted: bool,
    /// Coordinate at the start.
    pub zero: f64,
    /// Switches the drive on.
    pub enable: Option<Pin>,
    /// The drive's fault.
    pub fault: Option<Pin>,
    /// Home switch, negative limit, positive limit.
    pub switches: [Option<Pin>; 3],
    /// Set for the second motor of its axis.
    pub gantry: Option<GantrySettings>,
}

impl BoardAxis {
    /// The encoder of a servo.
    #[must_use]
    pub const fn encoder(&self) -> Option<usize> {
        match self.actuator {
            Actuator::Servo { encoder, .. } => Some(encoder),
            Actuator::Steps { .. } => None,
        }
    }
}
