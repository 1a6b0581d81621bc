//! Changes of inputs and outputs on their way into the trace.

use std::collections::BTreeMap;

use evolvent_machine::SignalSettings;
use evolvent_trace::{CycleRecord, EventKind, EventRecord, RecordError, Recorder};
use rtrb::Consumer;

use crate::signal_loop::SignalChange;

/// Records each change with the cycle from which it counts.
pub(crate) struct SignalRecorder {
    changes: Consumer<SignalChange>,
    settings: SignalSettings,
    /// The last change of each, by direction and number in the trace.
    last: BTreeMap<(bool, u32), SignalChange>,
}

impl SignalRecorder {
    /// Changes come in order, each before its cycle; `settings` say how the machine calls them.
    pub(crate) fn new(changes: Consumer<SignalChange>, settings: SignalSettings) -> Self {
        Self {
            changes,
            settings,
            last: BTreeMap::new(),
        }
    }

    /// Records what has changed up to a cycle.
    pub(crate) fn record(&mut self, recorder: &mut Recorder, cycle: &CycleRecord) -> Result<(), RecordError> {
        while let Ok(change) = self.changes.peek()
            && change.sequence <= cycle.sequence
        {
            recorder.event(&self.event(change, cycle))?;
            self.last.insert((change.is_output, change.code()), *change);
            let _taken = self.changes.pop();
        }
        Ok(())
    }

    /// Records what is in force where a file begins that goes on from another one.
    pub(crate) fn repeat(&self, recorder: &mut Recorder, cycle: &CycleRecord) -> Result<(), RecordError> {
        for change in self.last.values() {
            let now = SignalChange {
                sequence: cycle.sequence,
                ..*change
            };
            recorder.event(&self.event(&now, cycle))?;
        }
        Ok(())
    }

    fn event(&self, change: &SignalChange, cycle: &CycleRecord) -> EventRecord {
        EventRecord {
            time_ns: cycle.due_time_ns,
            sequence: change.sequence,
            kind: if change.is_output {
                EventKind::Output
            } else {
                EventKind::Input
            },
            code: change.code(),
            text: change.text(&self.settings),
            value: change.value,
        }
    }
}
