//! All outputs, or all inputs, of one instant.

use evolvent_machine::{MAX_ANALOG, MAX_SPINDLES, SignalKind};

use crate::probe_image::ProbeImage;
use crate::schedule::{Change, Moment};
use crate::spindle_state::SpindleState;
use crate::spindle_tracker::SpindleAngle;

const ANALOG: usize = MAX_ANALOG as usize;

/// The outputs with one setpoint.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct OutputImage {
    /// Bit i: state of digital output i.
    pub digital: u64,
    /// Values of the analog outputs.
    pub analog: [f64; ANALOG],
}

impl OutputImage {
    /// The value of an output, 0 or 1 of a digital one; 0 of a number that there is not. Real-time safe.
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

    /// Sets the value of an output. Numbers that there are not are left alone. Real-time safe.
    pub fn set(&mut self, kind: SignalKind, number: u32, value: f64) {
        let mut change = Change::at(Moment::Rest(0));
        match kind {
            SignalKind::Digital => change.set_digital(number, value != 0.0),
            SignalKind::Analog => change.set_analog(number, value),
        }
        self.apply(&change);
    }

    pub(crate) fn apply(&mut self, change: &Change) {
        self.digital = self.digital & !change.off | change.on;
        for (index, value) in self.analog.iter_mut().enumerate() {
            if change.analog_mask >> index & 1 == 1 {
                *value = change.analog[index];
            }
        }
    }
}

/// The inputs that a cycle goes by. What is not known has no value.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct InputImage {
    /// Bit i set: the state of digital input i is known.
    pub digital_known: u64,
    /// Bit i: state of digital input i; 0 where it is not known.
    pub digital: u64,
    /// Bit i set: the value of analog input i is known.
    pub analog_known: u32,
    /// Values of the analog inputs; 0 where they are not known.
    pub analog: [f64; ANALOG],
    /// How the spindles are; none of one that is not known.
    pub spindles: [Option<SpindleState>; MAX_SPINDLES as usize],
    /// The newest sample of the angle of the spindle that motion follows; none where it is not reported.
    pub angle: Option<SpindleAngle>,
    /// The spindle of that sample.
    pub angle_spindle: u32,
    /// How fast each spindle turns, rpm, never negative; none where it is not reported.
    pub speeds_rpm: [Option<f64>; MAX_SPINDLES as usize],
    /// What the probe says.
    pub probe: ProbeImage,
}

impl InputImage {
    /// The value of an input, 0 or 1 of a digital one; none while it is not known, or has no such number.
    /// Real-time safe.
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

    /// How a spindle is; none while it is not known, or of a number that there is not. Real-time safe.
    #[must_use]
    pub fn spindle(&self, number: u32) -> Option<SpindleState> {
        self.spindles.get(number as usize).copied().flatten()
    }

    /// Sets how a spindle is; none makes it unknown. Numbers that there are not are left alone. Real-time
    /// safe.
    pub fn set_spindle(&mut self, number: u32, state: Option<SpindleState>) {
        if let Some(slot) = self.spindles.get_mut(number as usize) {
            *slot = state;
        }
    }

    /// Sets the value of an input; none makes it unknown. Numbers that there are not are left alone.
    /// Real-time safe.
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
