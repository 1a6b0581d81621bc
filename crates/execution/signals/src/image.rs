//! All outputs, or all inputs, of one instant.

use evolvent_machine::{MAX_ANALOG, MAX_SPINDLES, SignalKind};

use crate::probe_image::ProbeImage;
use crate::schedule::{OutputChange, SignalMoment};
use crate::spindle_state::SpindleState;
use crate::spindle_tracker::SpindleAngle;

const ANALOG: usize = MAX_ANALOG as usize;

/// The outputs of one setpoint.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct OutputImage {
    /// Bit i: state of digital output i.
    pub digital: u64,
    /// Values of the analog outputs.
    pub analog: [f64; ANALOG],
}

impl OutputImage {
    /// The value of an output: 0 or 1 for a digital one, 0 for a number that does not exist. Real-time safe.
    #[must_use]
    pub fn value(&self, kind: SignalKind, number: u32) -> f64 {
        match kind {
            SignalKind::Digital => self
                .digital
                .checked_shr(number)
                .map_or(0.0, |bits| (bits & 1) as f64),
            SignalKind::Analog => self.analog.get(number as usize).copied().unwrap_or(0.0),
        }
    }

    /// Sets the value of an output. Numbers that do not exist are ignored. Real-time safe.
    pub fn set(&mut self, kind: SignalKind, number: u32, value: f64) {
        let mut change = OutputChange::at(SignalMoment::Rest(0));
        match kind {
            SignalKind::Digital => change.set_digital(number, value != 0.0),
            SignalKind::Analog => change.set_analog(number, value),
        }
        self.apply(&change);
    }

    pub(crate) fn apply(&mut self, change: &OutputChange) {
        self.digital = self.digital & !change.off | change.on;
        for (index, value) in self.analog.iter_mut().enumerate() {
            if change.analog_mask >> index & 1 == 1 {
                *value = change.analog[index];
            }
        }
    }
}

/// The inputs that a cycle uses. Unknown inputs have no value.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct InputImage {
    /// Bit i set: the state of digital input i is known.
    pub digital_known: u64,
    /// Bit i: state of digital input i; 0 if unknown.
    pub digital: u64,
    /// Bit i set: the value of analog input i is known.
    pub analog_known: u32,
    /// Values of the analog inputs; 0 if unknown.
    pub analog: [f64; ANALOG],
    /// States of the spindles; `None` if unknown.
    pub spindles: [Option<SpindleState>; MAX_SPINDLES as usize],
    /// The newest sample of the angle of the spindle that motion follows; `None` if it is not reported.
    pub angle: Option<SpindleAngle>,
    /// The spindle of that sample.
    pub angle_spindle: u32,
    /// Speed of each spindle, rpm, never negative; `None` if it is not reported.
    pub speeds_rpm: [Option<f64>; MAX_SPINDLES as usize],
    /// State of the probe.
    pub probe: ProbeImage,
}

impl InputImage {
    /// The value of an input, 0 or 1 for a digital one; `None` while it is unknown or if the number does not
    /// exist. Real-time safe.
    #[must_use]
    pub fn value(&self, kind: SignalKind, number: u32) -> Option<f64> {
        let index = number as usize;
        match kind {
            SignalKind::Digital if number < u64::BITS && self.digital_known >> number & 1 == 1 => {
                Some((self.digital >> number & 1) as f64)
            }
            SignalKind::Analog if index < ANALOG && self.analog_known >> number & 1 == 1 => {
                Some(self.analog[index])
            }
            _ => None,
        }
    }

    /// The state of a spindle; `None` while it is unknown or if the number does not exist. Real-time safe.
    #[must_use]
    pub fn spindle(&self, number: u32) -> Option<SpindleState> {
        self.spindles.get(number as usize).copied().flatten()
    }

    /// Sets the state of a spindle; `None` makes it unknown. Numbers that do not exist are ignored. Real-time
    /// safe.
    pub fn set_spindle(&mut self, number: u32, state: Option<SpindleState>) {
        if let Some(slot) = self.spindles.get_mut(number as usize) {
            *slot = state;
        }
    }

    /// Sets the value of an input; `None` makes it unknown. Numbers that do not exist are ignored. Real-time
    /// safe.
    pub fn set(&mut self, kind: SignalKind, number: u32, value: Option<f64>) {
        match kind {
            SignalKind::Digital if number < u64::BITS => {
                let bit = 1 << number;
                self.digital_known &= !bit;
                self.digital &= !bit;
                if let Some(value) = value {
                    self.digital_known |= bit;
                    self.digital |= if value == 0.0 { 0 } else { bit };
                }
            }
            SignalKind::Analog if (number as usize) < ANALOG => {
                self.analog_known &= !(1 << number);
                self.analog[number as usize] = 0.0;
                if let Some(value) = value {
                    self.analog_known |= 1 << number;
                    self.analog[number as usize] = value;
                }
            }
            _ => {}
        }
    }
}
