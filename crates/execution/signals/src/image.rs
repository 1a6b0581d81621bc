//! All outputs, or all inputs, of one instant.

use evolvent_machine::{MAX_ANALOG, SignalKind};

const ANALOG: usize = MAX_ANALOG as usize;

/// The outputs with one setpoint.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct OutputImage {
    /// Bit i: state of digital output i.
    pub digital: u64,
    /// Values of the analog outputs.
    pub analog: [f64; ANALOG],
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
}

impl InputImage {
    /// The value of an input, 0 or 1 of a digital one; none while it is not known, or has no such number. Real-time safe.
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

    /// Sets the value of an input; none makes it unknown. Numbers that there are not are left alone. Real-time safe.
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
