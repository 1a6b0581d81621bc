//! Recorded inputs and outputs.

use evolvent_inspect::InspectError;
use evolvent_runtime::SignalChange;
use evolvent_trace::{EventKind, TraceFile};

use super::{Difference, Verified};

/// All changes, in order.
pub(super) struct RecordedSignals {
    pub(super) inputs: Vec<SignalChange>,
    pub(super) outputs: Vec<SignalChange>,
}

impl RecordedSignals {
    pub(super) fn read(trace: &mut TraceFile) -> Result<Self, InspectError> {
        let (mut inputs, mut outputs) = (Vec::new(), Vec::new());
        for event in trace.events() {
            let event = event?;
            let is_output = event.kind == EventKind::Output;
            if !is_output && event.kind != EventKind::Input {
                continue;
            }
            let change = SignalChange {
                sequence: event.sequence,
                is_output,
                name: SignalChange::of_code(event.code),
                value: event.value,
            };
            if is_output {
                outputs.push(change);
            } else {
                inputs.push(change);
            }
        }
        Ok(Self { inputs, outputs })
    }
}

/// Reports an output that differs, if it is the first difference.
pub(super) fn tell_difference(difference: Difference, verified: &mut Verified) {
    let is_first = verified
        .first_difference
        .as_ref()
        .is_none_or(|known| difference.sequence < known.sequence);
    if is_first {
        verified.first_difference = Some(difference);
    }
}
