//! Outputs that are wired to the inputs of the same numbers.

use evolvent_bus::{MachineInputs, MachineOutputs};

use crate::input_messages::Signalling;

/// Reads each digital and analog output back as the input of its number. `closed`: digital inputs that are on besides, as a
/// closed emergency-stop chain is; they win.
#[must_use]
pub fn loopback(closed: u64) -> Signalling {
    Box::new(move |_, outputs: &MachineOutputs| MachineInputs {
        digital_mask: outputs.digital_mask | closed,
        digital: outputs.digital & outputs.digital_mask | closed,
        analog_mask: outputs.analog_mask,
        analog: outputs.analog,
        ..MachineInputs::default()
    })
}
