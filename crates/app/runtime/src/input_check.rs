//! Why the core rejects a message of inputs, for clients that show it.

use evolvent_bus::MachineInputs;
use evolvent_drive::InputEntry;
use evolvent_machine::{SignalKind, SignalSettings};

/// A checker for the inputs of a machine file.
pub(crate) fn input_entry(settings: &SignalSettings) -> InputEntry {
    let inputs = |kind: SignalKind| settings.inputs.iter().filter(move |input| input.kind == kind);
    let digital = inputs(SignalKind::Digital).fold(0, |bits, input| bits | 1 << input.number);
    let timeout_ns = (settings.input_timeout_s * 1e9) as u64;
    inputs(SignalKind::Analog).fold(InputEntry::new(digital, timeout_ns), |entry, input| {
        entry.with_analog(input.number, input.range)
    })
}

/// The reason why a core with this machine file discards a message that arrives at `now_ns` of
/// CLOCK_MONOTONIC, if it does.
#[must_use]
pub fn objection_to_inputs(
    settings: &SignalSettings,
    message: &MachineInputs,
    now_ns: u64,
) -> Option<String> {
    let taken = input_entry(settings).take(message, now_ns);
    taken.err().map(|fault| fault.to_string())
}
