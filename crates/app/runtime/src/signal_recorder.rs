//! Writes changes of inputs and outputs to the trace.

use std::collections::BTreeMap;

use evolvent_machine::SignalSettings;
use evolvent_trace::{CycleRecord, EventKind, EventRecord, RecordError, Recorder};
use rtrb::Consumer;

use crate::signal_loop::SignalChange;

/// Records each change with the cycle from which it is in effect.
pub(crate) struct SignalRecorder {
    changes: Consumer<SignalChange>,
    settings: SignalSettings,
    /// The last change of each signal, by direction and number in the trace.
    last: BTreeMap<(bool, u32), SignalChange>,
}

impl SignalRecorder {
    /// `changes` arrive in order, each before its cycle; `settings` contain the names of the signals.
    pub(crate) fn new(changes: Consumer<SignalChange>, settings: SignalSettings) -> Self {
        Self {
            changes,
            settings,
            last: BTreeMap::new(),
        }
    }

    /// Records the changes up to a cycle.
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

    /// Records the values in force at the start of a file that continues another one.
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

#[cfg(test)]
mod tests {
    use evolvent_machine::SignalKind;
    use evolvent_trace::{RunInfo, TraceFile};
    use rtrb::RingBuffer;

    use super::*;
    use crate::signal_loop::SignalName;

    fn cycle(sequence: u64) -> CycleRecord {
        CycleRecord {
            sequence,
            due_time_ns: 1_000_000 * sequence,
            ..CycleRecord::default()
        }
    }

    #[test]
    fn a_file_that_goes_on_begins_with_what_is_in_force() {
        let folder = tempfile::tempdir().unwrap();
        let recorder = |name: &str| {
            let info = RunInfo {
                axes: vec![evolvent_path::AxisLetter::X],
                period_ns: 1_000_000,
                ..RunInfo::default()
            };
            Recorder::create(&folder.path().join(name), &info).unwrap()
        };
        let (mut first, mut second) = (recorder("first.mcap"), recorder("second.mcap"));
        let (mut producer, changes) = RingBuffer::new(8);
        let mut signals = SignalRecorder::new(changes, SignalSettings::default());
        let change = |sequence, is_output, number, value| SignalChange {
            sequence,
            is_output,
            name: SignalName::Signal(SignalKind::Digital, number),
            value,
        };
        for change in [
            change(2, true, 3, Some(1.0)),
            change(2, false, 3, Some(1.0)),
            change(4, true, 3, Some(0.0)),
            change(9, false, 3, None),
        ] {
            producer.push(change).unwrap();
        }
        for sequence in 0..6 {
            signals.record(&mut first, &cycle(sequence)).unwrap();
        }
        signals.repeat(&mut second, &cycle(6)).unwrap();
        for sequence in 6..12 {
            signals.record(&mut second, &cycle(sequence)).unwrap();
        }
        let events = |recorder: Recorder| {
            let path = recorder.finish(&BTreeMap::new()).unwrap();
            let mut trace = TraceFile::open(&path).unwrap();
            let events = trace.events().map(|event| {
                let event = event.unwrap();
                (
                    event.sequence,
                    event.kind == EventKind::Output,
                    event.code,
                    event.value,
                )
            });
            events.collect::<Vec<_>>()
        };
        let of_first = [
            (2, true, 3, Some(1.0)),
            (2, false, 3, Some(1.0)),
            (4, true, 3, Some(0.0)),
        ];
        assert_eq!(events(first), of_first);
        let of_second = [
            (6, false, 3, Some(1.0)),
            (6, true, 3, Some(0.0)),
            (9, false, 3, None),
        ];
        assert_eq!(events(second), of_second);
    }
}
