//! Orders to the cycle, and what the trace receives of them where they take effect.

use std::collections::VecDeque;
use std::sync::mpsc::Sender;

use evolvent_control::Command;
use rtrb::Producer;

use super::orders::{CycleCommand, Order};
use super::recorded::JobNotes;
use crate::news::{ExternalEvent, ExternalEventKind, FeederEvent};

/// A command on its way to the cycle.
struct PendingCommand {
    id: u64,
    code: u32,
    text: String,
    value: Option<f64>,
}

/// Sends orders, numbered from 1, and records commands, alarms and jobs.
pub(super) struct OrderBook {
    orders: Producer<Order>,
    next_id: u64,
    pending: VecDeque<PendingCommand>,
    pub(super) recorder: Option<Sender<FeederEvent>>,
    /// What the trace receives of jobs.
    pub(super) notes: JobNotes,
}

impl OrderBook {
    pub(super) fn new(orders: Producer<Order>, recorder: Option<Sender<FeederEvent>>) -> Self {
        Self {
            orders,
            next_id: 0,
            pending: VecDeque::new(),
            notes: JobNotes::new(recorder.is_some()),
            recorder,
        }
    }

    pub(super) fn order(&mut self, what: CycleCommand) -> u64 {
        self.next_id += 1;
        let id = self.next_id;
        // The queue holds more than can be requested between two cycles; a cycle that takes none has ended.
        let _full = self.orders.push(Order { id, what });
        id
    }

    /// An order that is recorded where it takes effect.
    pub(super) fn send(&mut self, what: CycleCommand, command: &Command) -> u64 {
        let id = self.order(what);
        self.pending.push_back(PendingCommand {
            id,
            code: command.code() as u32,
            text: command.to_string(),
            value: command.value(),
        });
        id
    }

    /// An order counts from this setpoint on: the command or job that it carries is recorded.
    pub(super) fn applied(&mut self, id: u64, sequence: u64) {
        if let Some(recorder) = &self.recorder {
            self.notes.applied(recorder, id, sequence);
        }
        while self.pending.front().is_some_and(|pending| pending.id <= id) {
            if let Some(pending) = self.pending.pop_front()
                && pending.id == id
            {
                self.record(ExternalEvent {
                    sequence,
                    kind: ExternalEventKind::Command,
                    code: pending.code,
                    text: pending.text,
                    value: pending.value,
                });
            }
        }
    }

    pub(super) fn record(&self, event: ExternalEvent) {
        if let Some(recorder) = &self.recorder {
            let _gone = recorder.send(FeederEvent::ExternalEvent(event));
        }
    }

    /// The trace goes on in another file after this setpoint.
    pub(super) fn begin_file(&mut self, sequence: u64) {
        if let Some(recorder) = &self.recorder {
            self.notes.begin_file();
            let _gone = recorder.send(FeederEvent::NextFile(sequence));
        }
    }
}
