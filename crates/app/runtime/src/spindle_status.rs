//! Status fields of the spindles: command, measured speed, override.

use evolvent_bus::Status;
use evolvent_gcode::SPINDLES;

use crate::periphery::Periphery;
use crate::signal_port::SignalPort;
use crate::spindle_command::SpindleCommands;

/// The spindles with the last published setpoint.
pub(crate) struct SpindleStatus<'a> {
    pub commands: &'a SpindleCommands,
    /// Reports of bridges, if the machine has signals.
    pub signals: Option<&'a SignalPort>,
    /// Spindles whose override the program has switched off.
    pub override_off_mask: u32,
    /// Time of CLOCK_MONOTONIC.
    pub now_ns: u64,
}

impl SpindleStatus<'_> {
    /// Fills the fields of a status.
    pub(crate) fn fill(&self, periphery: &Periphery, status: &mut Status) {
        let mask = self.commands.mask();
        status.spindle_mask = mask;
        status.spindle_override_off_mask = self.override_off_mask & mask;
        let signed = self.commands.signed_rpm(&periphery.outputs);
        for number in 0..SPINDLES {
            if mask >> number & 1 == 0 {
                continue;
            }
            status.spindle_command_rpm[number] = signed[number] as f32;
            let measured = self
                .signals
                .and_then(|signals| signals.measured_rpm(number as u32, self.now_ns));
            status.spindle_measured_rpm[number] = measured.map_or(f32::NAN, |rpm| rpm as f32);
        }
        // The speed of a ramp lags behind the command of the program.
        let first = mask.trailing_zeros() as usize;
        if self.commands.has_ramp(first) {
            status.spindle_rpm = signed[first];
        }
    }
}
