//! Orders to the cycle, and what the trace receives of them where they take effect.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::mpsc::Sender;

use evolvent_control::Command;
use evolvent_drive::PowerRequest;
use rtrb::{Producer, PushError};

use super::orders::{CycleCommand, Order};
use super::recorded::JobNotes;
use super::urgent::{Urgent, UrgentOrders};
use crate::news::{ExternalEvent, ExternalEventKind, FeederEvent};

/// The last part of the queue is for what the core orders by itself: with less, commands are refused that begin or change something.
const KEPT_FOR_THE_CORE: usize = 256;

/// A command on its way to the cycle.
struct PendingCommand {
    id: u64,
    code: u32,
    text: String,
    value: Option<f64>,
}

impl PendingCommand {
    fn new(id: u64, command: &Command) -> Self {
        Self {
            id,
            code: command.code() as u32,
            text: command.to_string(),
            value: command.value(),
        }
    }
}

/// An override: of many that come within one cycle only the newest is sent, so that they never fill the queue.
#[derive(Default)]
struct OverrideTrack {
    /// The order that the cycle has not taken yet.
    sent: Option<u64>,
    /// What replaces it once it has.
    next: Option<(CycleCommand, PendingCommand)>,
}

/// Sends orders, numbered from 1, and records commands, alarms and jobs.
pub(super) struct OrderBook {
    orders: Producer<Order>,
    urgent: Arc<UrgentOrders>,
    next_id: u64,
    pending: VecDeque<PendingCommand>,
    /// The same of urgent orders, which overtake the others.
    pending_urgent: VecDeque<(Urgent, PendingCommand)>,
    /// Of the feed, and of the spindles.
    overrides: [OverrideTrack; 2],
    /// What did not fit into the queue.
    lost: Vec<Order>,
    pub(super) recorder: Option<Sender<FeederEvent>>,
    /// What the trace receives of jobs.
    pub(super) notes: JobNotes,
}

impl OrderBook {
    pub(super) fn new(
        orders: Producer<Order>,
        urgent: Arc<UrgentOrders>,
        recorder: Option<Sender<FeederEvent>>,
    ) -> Self {
        Self {
            orders,
            urgent,
            next_id: 0,
            pending: VecDeque::new(),
            pending_urgent: VecDeque::new(),
            overrides: Default::default(),
            lost: Vec::new(),
            notes: JobNotes::new(recorder.is_some()),
            recorder,
        }
    }

    /// Sends an order. Returns its number.
    pub(super) fn order(&mut self, what: CycleCommand) -> u64 {
        if matches!(what, CycleCommand::Follow(_) | CycleCommand::Steer(_)) {
            // A job begins with the newest overrides.
            self.send_overrides(true);
        }
        self.next_id += 1;
        let id = self.next_id;
        if let Some(urgent) = urgent_of(&what) {
            self.urgent.order(urgent, id);
        } else if let Err(PushError::Full(order)) = self.orders.push(Order { id, what }) {
            // A cycle that takes no orders any more, or far too few: whatever it does must end.
            self.lost.push(order);
            self.next_id += 1;
            self.urgent.order(Urgent::Emergency, self.next_id);
        }
        id
    }

    /// An order that is recorded where it takes effect.
    pub(super) fn send(&mut self, what: CycleCommand, command: &Command) -> u64 {
        if let Some(which) = override_of(&what) {
            // Its number is given when it is sent.
            let waiting = (what, PendingCommand::new(0, command));
            self.overrides[which].next = Some(waiting);
            self.send_overrides(false);
            return 0;
        }
        let urgent = urgent_of(&what);
        let id = self.order(what);
        let pending = PendingCommand::new(id, command);
        match urgent {
            Some(urgent) => self.pending_urgent.push_back((urgent, pending)),
            None => self.pending.push_back(pending),
        }
        id
    }

    /// Sends the overrides that wait, where the cycle has taken the one before or `all` are wanted now.
    fn send_overrides(&mut self, all: bool) {
        for which in 0..self.overrides.len() {
            let track = &mut self.overrides[which];
            if track.sent.is_some() && !all {
                continue;
            }
            let Some((what, mut pending)) = track.next.take() else {
                continue;
            };
            pending.id = self.order(what);
            self.overrides[which].sent = Some(pending.id);
            self.pending.push_back(pending);
        }
    }

    /// Whether the cycle is behind with what it was ordered.
    pub(super) fn is_crowded(&self) -> bool {
        self.orders.slots() < KEPT_FOR_THE_CORE.min(self.orders.buffer().capacity() / 4)
    }

    /// What did not fit into the queue since the last call. The cycle has the order of an emergency stop then.
    pub(super) fn take_lost(&mut self) -> Vec<Order> {
        std::mem::take(&mut self.lost)
    }

    /// An order counts from this setpoint on: the command or job that it carries is recorded.
    pub(super) fn applied(&mut self, id: u64, sequence: u64) {
        if let Some(recorder) = &self.recorder {
            self.notes.applied(recorder, id, sequence);
        }
        let is_urgent = |(_, pending): &&(Urgent, PendingCommand)| pending.id == id;
        if let Some((kind, _)) = self.pending_urgent.iter().find(is_urgent) {
            let kind = *kind;
            // Older ones of its kind have counted together with it.
            while let Some(at) =
                (self.pending_urgent.iter()).position(|(other, pending)| *other == kind && pending.id <= id)
            {
                if let Some((_, pending)) = self.pending_urgent.remove(at) {
                    self.record_applied(pending, sequence);
                }
            }
            return;
        }
        for track in &mut self.overrides {
            track.sent.take_if(|sent| *sent <= id);
        }
        while self.pending.front().is_some_and(|pending| pending.id <= id) {
            if let Some(pending) = self.pending.pop_front()
                && pending.id == id
            {
                self.record_applied(pending, sequence);
            }
        }
        self.send_overrides(false);
    }

    fn record_applied(&self, pending: PendingCommand, sequence: u64) {
        self.record(ExternalEvent {
            sequence,
            kind: ExternalEventKind::Command,
            code: pending.code,
            text: pending.text,
            value: pending.value,
        });
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

/// What of it cannot wait.
const fn urgent_of(what: &CycleCommand) -> Option<Urgent> {
    match what {
        CycleCommand::Emergency => Some(Urgent::Emergency),
        CycleCommand::Stop => Some(Urgent::Stop),
        CycleCommand::Power(PowerRequest::Off) => Some(Urgent::PowerOff),
        _ => None,
    }
}

/// Which override it sets.
const fn override_of(what: &CycleCommand) -> Option<usize> {
    match what {
        CycleCommand::Override(_) => Some(0),
        CycleCommand::SpindleOverride(_) => Some(1),
        _ => None,
    }
}
