//! The machine's signals: outputs with the cycle in which they take effect, inputs with the time at which
//! they were read.

use crate::layout::{AXES, payload};

/// Maximum number of digital inputs, and of digital outputs, of a machine.
pub const DIGITAL_SIGNALS: usize = 64;
/// Maximum number of analog inputs, and of analog outputs, of a machine.
pub const ANALOG_SIGNALS: usize = 16;
/// Maximum number of spindles of a machine.
pub const SPINDLES: usize = 4;

payload! {
    /// The commanded state of all peripherals, from one setpoint on.
    ///
    /// Complete in itself: a bridge that has lost a message is correct again with the next. Sent at every
    /// change and every 50 ms.
    pub struct MachineOutputs = "evolvent.MachineOutputs.v1" {
        /// Grows by one per message.
        sequence: u64,
        /// The setpoint with which these values take effect.
        cycle: u64,
        /// Due time of that setpoint, as its `due_time_ns`.
        due_time_ns: u64,
        /// Bit i set: the machine has digital output i.
        digital_mask: u64,
        /// Bit i: state of digital output i.
        digital: u64,
        /// Bit i: state of digital output i that a bridge sets itself when it has lost its core.
        safe_digital: u64,
        /// Values of the analog outputs.
        analog: [f64; ANALOG_SIGNALS],
        /// The same for the analog outputs.
        safe_analog: [f64; ANALOG_SIGNALS],
        /// Bit i set: the machine has analog output i.
        analog_mask: u32,
        /// Bit i set: the machine has spindle i.
        spindle_mask: u32,
        /// Command of each spindle, a number of the list of spindle directions.
        spindle_direction: [u32; SPINDLES],
        /// Commanded speed of each spindle, rpm, not negative.
        spindle_rpm: [f64; SPINDLES],
        /// Bit 0 mist, bit 1 flood.
        coolant: u32,
        /// As `tool_change` of Status.
        tool_change: u32,
        /// As `tool_wanted` of Status.
        tool_wanted: u32,
        /// Tool in the spindle; 0 for none.
        tool: u32,
        /// Orientation angle of a spindle with direction ORIENT, degrees from its index pulse, 0 up to, not including, 360.
        spindle_angle: [f64; SPINDLES],
        /// Direction of the orientation, a number of the list of ways.
        spindle_way: [u32; SPINDLES],
        /// Zero; for later versions.
        reserved: [u64; 2],
    }
}

payload! {
    /// The machine's inputs at one instant. Sent at every change, and at least four times per
    /// `signals.input_timeout_ms` of the machine file: older ones are unknown to the core.
    pub struct MachineInputs = "evolvent.MachineInputs.v1" {
        /// Grows by one per message of the same bridge.
        sequence: u64,
        /// When the inputs were read, in ns of CLOCK_MONOTONIC.
        time_ns: u64,
        /// Differs at every start of the bridge.
        instance: u64,
        /// The `sequence` of the last outputs that were set; 0 for none.
        outputs_sequence: u64,
        /// Bit i set: digital input i was read.
        digital_mask: u64,
        /// Bit i: state of digital input i.
        digital: u64,
        /// Values of the analog inputs.
        analog: [f64; ANALOG_SIGNALS],
        /// Bit i set: analog input i was read.
        analog_mask: u32,
        /// State of the probe, a number of the list of probe states.
        probe: u32,
        /// Number of times that the probe has tripped since the start of the bridge.
        probe_trips: u64,
        /// When it last tripped or opened, in ns of CLOCK_MONOTONIC; 0 if unknown.
        probe_time_ns: u64,
        /// Positions that the drives latched at that time: mm, degrees for A B C.
        probe_position: [f64; AXES],
        /// Bit i set: the drive of axis i has latched its position.
        probe_latched_mask: u32,
        /// Zero; aligns the following fields to 8 bytes.
        unused: u32,
        /// Zero; for later versions.
        reserved: [u64; 8],
    }
}

payload! {
    /// Feedback of the encoder and drive of one spindle at one instant.
    pub struct SpindleFeedback = "evolvent.SpindleFeedback.v1" {
        /// Grows by one per message of the same spindle and bridge.
        sequence: u64,
        /// When the angle was sampled, in ns of CLOCK_MONOTONIC.
        time_ns: u64,
        /// Differs at every start of the bridge.
        instance: u64,
        /// Whole turns since the start of the bridge, decreasing counter-clockwise.
        turns: i64,
        /// The remaining angle as a fraction of a turn: 0 up to, not including, 1; from the index pulse.
        fraction: f64,
        /// Measured speed, rpm, negative counter-clockwise.
        speed_rpm: f64,
        /// The spindle, from 0.
        spindle: u32,
        /// Bits of the list of spindle flags.
        flags: u32,
        /// The `sequence` of the outputs that the spindle executes, 0 for none: the flags refer to these.
        outputs_sequence: u64,
        /// Zero; for later versions.
        reserved: [u64; 5],
    }
}

/// Names and numbers of `spindle_direction`.
pub const SPINDLE_DIRECTIONS: [(&str, u32); 4] = [
    ("STOPPED", 0),
    ("CLOCKWISE", 1),
    ("COUNTER_CLOCKWISE", 2),
    ("ORIENT", 3),
];

/// Names and numbers of `spindle_way`.
pub const SPINDLE_WAYS: [(&str, u32); 3] = [("SHORTER", 0), ("CLOCKWISE", 1), ("COUNTER_CLOCKWISE", 2)];

/// Names and numbers of `probe`.
pub const PROBE_STATES: [(&str, u32); 3] = [("NONE", 0), ("OPEN", 1), ("TRIPPED", 2)];

/// Bits of `flags` in [`SpindleFeedback`].
pub mod spindle_flags {
    /// The commanded speed is reached.
    pub const AT_SPEED: u32 = 1 << 0;
    /// The spindle's drive is in fault.
    pub const FAULT: u32 = 1 << 1;
    /// The index pulse has been seen: `fraction` refers to it.
    pub const INDEXED: u32 = 1 << 2;
    /// The spindle is at its orientation angle and holds it.
    pub const ORIENTED: u32 = 1 << 3;
}

/// Names and bits of `flags` in [`SpindleFeedback`].
pub const SPINDLE_FLAGS: [(&str, u32); 4] = [
    ("AT_SPEED", spindle_flags::AT_SPEED),
    ("FAULT", spindle_flags::FAULT),
    ("INDEXED", spindle_flags::INDEXED),
    ("ORIENTED", spindle_flags::ORIENTED),
];

/// A bit of a signal that is in the mask.
fn digital_of(mask: u64, bits: u64, number: u32) -> Option<bool> {
    (mask.checked_shr(number)? & 1 == 1).then_some(bits >> number & 1 == 1)
}

/// A finite value of a signal that is in the mask.
fn analog_of(mask: u32, values: &[f64], number: u32) -> Option<f64> {
    let is_listed = mask.checked_shr(number)? & 1 == 1;
    let value = values.get(number as usize).copied()?;
    (is_listed && value.is_finite()).then_some(value)
}

impl MachineOutputs {
    /// State of a digital output, if the machine has it. Real-time safe.
    #[must_use]
    pub fn digital_output(&self, number: u32) -> Option<bool> {
        digital_of(self.digital_mask, self.digital, number)
    }

    /// Value of an analog output, if the machine has it. Real-time safe.
    #[must_use]
    pub fn analog_output(&self, number: u32) -> Option<f64> {
        analog_of(self.analog_mask, &self.analog, number)
    }

    /// Commanded speed of a spindle, rpm, not negative, if the machine has it. Real-time safe.
    #[must_use]
    pub fn spindle_speed_rpm(&self, number: u32) -> Option<f64> {
        analog_of(self.spindle_mask, &self.spindle_rpm, number)
    }
}

impl MachineInputs {
    /// State of a digital input, if it was read. Real-time safe.
    ///
    /// ```
    /// use evolvent_wire::MachineInputs;
    ///
    /// let inputs = MachineInputs { digital_mask: 0b10, digital: 0b11, ..MachineInputs::default() };
    /// assert_eq!((inputs.digital_input(1), inputs.digital_input(0)), (Some(true), None));
    /// ```
    #[must_use]
    pub fn digital_input(&self, number: u32) -> Option<bool> {
        digital_of(self.digital_mask, self.digital, number)
    }

    /// Value of an analog input, if it was read and is finite. Real-time safe.
    #[must_use]
    pub fn analog_input(&self, number: u32) -> Option<f64> {
        analog_of(self.analog_mask, &self.analog, number)
    }

    /// Whether every analog value that was read, and every latched position, is finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        let read = |mask: u32, values: &[f64]| {
            values
                .iter()
                .enumerate()
                .all(|(index, value)| mask >> index & 1 == 0 || value.is_finite())
        };
        read(self.analog_mask, &self.analog) && read(self.probe_latched_mask, &self.probe_position)
    }
}

impl SpindleFeedback {
    /// Whether spindle and flags are known, and angle and speed are valid.
    #[must_use]
    pub fn is_valid(&self) -> bool {
        let known = SPINDLE_FLAGS.iter().fold(0, |sum, (_, bit)| sum | bit);
        (self.spindle as usize) < SPINDLES
            && self.flags & !known == 0
            && (0.0..1.0).contains(&self.fraction)
            && self.speed_rpm.is_finite()
    }
}
