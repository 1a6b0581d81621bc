//! Outputs wired to the inputs of the same numbers.

use evolvent_bus::{ANALOG_SIGNALS, MachineInputs, MachineOutputs};

use crate::input_messages::Signalling;

/// Inputs that outputs are wired to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoopbackInputs {
    /// Digital inputs, one bit each.
    pub digital: u64,
    /// Analog inputs, one bit each.
    pub analog: u32,
    /// Lowest and highest value of each analog input.
    pub ranges: [[f64; 2]; ANALOG_SIGNALS],
    /// Digital inputs that are always on, for example a closed emergency-stop chain. They take precedence
    /// over the outputs.
    pub closed: u64,
}

impl LoopbackInputs {
    /// All inputs, with unlimited ranges: for a bridge without a machine file.
    #[must_use]
    pub fn all() -> Self {
        Self {
            digital: u64::MAX,
            analog: u32::MAX,
            ranges: [[f64::NEG_INFINITY, f64::INFINITY]; ANALOG_SIGNALS],
            closed: 0,
        }
    }
}

/// Reads each digital and analog output back as the input of the same number, if that input exists: the core
/// discards a message with an input that the machine file does not have. Analog values are clamped to the
/// range of the input.
#[must_use]
pub fn loopback(inputs: LoopbackInputs) -> Signalling {
    Box::new(move |_, outputs: &MachineOutputs| {
        let digital_mask = outputs.digital_mask & inputs.digital;
        let mut analog = outputs.analog;
        for (value, [low, high]) in analog.iter_mut().zip(&inputs.ranges) {
            *value = value.max(*low).min(*high);
        }
        MachineInputs {
            digital_mask: digital_mask | inputs.closed,
            digital: outputs.digital & digital_mask | inputs.closed,
            analog_mask: outputs.analog_mask & inputs.analog,
            analog,
            ..MachineInputs::default()
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn output_without_input_of_its_number_is_not_looped() {
        let mut inputs = LoopbackInputs {
            digital: 0b0011,
            analog: 0b01,
            closed: 0b1_0000,
            ..LoopbackInputs::all()
        };
        inputs.ranges[0] = [0.0, 5.0];
        let mut outputs = MachineOutputs {
            digital_mask: 0b0110,
            digital: 0b0110,
            analog_mask: 0b11,
            ..MachineOutputs::default()
        };
        (outputs.analog[0], outputs.analog[1]) = (7.0, 9.0);
        let read = loopback(inputs)(None, &outputs);
        assert_eq!((read.digital_mask, read.digital), (0b1_0010, 0b1_0010));
        assert_eq!((read.analog_mask, read.analog[0]), (0b01, 5.0));
    }
}
