//! Orders to the cycle, and their records in the trace where they take effect.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::mpsc::Sender;

use evolvent_control::OperatorCommand;
use evolvent_drive::PowerRequest;
use rtrb::{Producer, PushError};

use super::orders::{CycleCommand, Order};
use super::recorded::JobNotes;
use super::urgent::{Urgent, UrgentOrders};
use crate::news::{ExternalEvent, ExternalEventKind, FeederEvent};

/// Entries of the queue reserved for orders of the core itself. When no more than these are free, commands
/// that begin or change something are rejected.
const KEPT_FOR_THE_CORE: usize = 256;

/// A command on its way to the cycle.
struct PendingCommand {
    code: u32,
    text: String,
    value: Option<f64>,
}

impl PendingCommand {
    fn new(command: &OperatorCommand) -> Self {
        Self {
            code: command.code() as u32,
            text: command.to_string(),
            value: command.value(),
        }
    }
}

/// An override. If several arrive within one cycle, only the newest is sent, so they never fill the queue.
#[derive(Default)]
struct OverrideTrack {
    /// The order that the cycle has not taken yet.
    sent: Option<u64>,
    /// Sent once the cycle has taken that order.
    next: Option<(CycleCommand, PendingCommand)>,
}

/// Sends orders, numbered from 1, and records commands, alarms and jobs.
pub(super) struct OrderBook {
    orders: Producer<Order>,
    urgent: Arc<UrgentOrders>,
    next_id: u64,
    /// Commands whose orders the cycle has not taken, with the numbers of their orders.
    pending: VecDeque<(u64, PendingCommand)>,
    /// Urgent orders, which overtake the others, including those without a command: the report of one covers
    /// all earlier ones of its kind, and none of the queue.
    pending_urgent: VecDeque<(Urgent, u64, Option<PendingCommand>)>,
    /// The feed override, and the spindle override.
    overrides: [OverrideTrack; 2],
    /// Holds and stops of steered motions that the cycle has not taken yet. Repeating one needs no further
    /// order.
    repeatable: [Option<u64>; 2],
    /// Orders that did not fit into the queue.
    lost: Vec<Order>,
    pub(super) recorder: Option<Sender<FeederEvent>>,
    /// The records of jobs in the trace.
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
            repeatable: [None; 2],
            lost: Vec::new(),
            notes: JobNotes::new(recorder.is_some()),
            recorder,
        }
    }

    /// Sends an order. Returns its number, or that of a pending order with the same effect.
    pub(super) fn order(&mut self, what: CycleCommand) -> u64 {
        self.push(what, None)
    }

    /// Sends an order that is recorded where it takes effect.
    pub(super) fn send(&mut self, what: CycleCommand, command: &OperatorCommand) -> u64 {
        let command = PendingCommand::new(command);
        if let Some(which) = override_of(&what) {
            // Its number is assigned when it is sent.
            self.overrides[which].next = Some((what, command));
            self.send_overrides(false);
            return 0;
        }
        self.push(what, Some(command))
    }

    fn push(&mut self, what: CycleCommand, command: Option<PendingCommand>) -> u64 {
        if matches!(what, CycleCommand::Follow(_) | CycleCommand::Steer(_)) {
            // A job begins with the newest overrides.
            self.send_overrides(true);
        }
        let repeatable = repeatable_of(&what);
        if let Some(id) = repeatable.and_then(|which| self.repeatable[which]) {
            if let Some(command) = command {
                // It takes effect together with the pending order, which later ones may have followed.
                let at = self.pending.partition_point(|(known, _)| *known <= id);
                self.pending.insert(at, (id, command));
            }
            return id;
        }
        if ends_repetition(&what) {
            self.repeatable = [None; 2];
        }
        self.next_id += 1;
        let id = self.next_id;
        if let Some(urgent) = urgent_of(&what) {
            self.push_urgent(urgent, command);
            return id;
        }
        if let Err(PushError::Full(order)) = self.orders.push(Order { id, what }) {
            // The cycle takes no orders any more, or far too few, so it must stop.
            self.lost.push(order);
            self.next_id += 1;
            self.push_urgent(Urgent::Emergency, None);
            return id;
        }
        if let Some(which) = repeatable {
            self.repeatable[which] = Some(id);
        }
        if let Some(command) = command {
            self.pending.push_back((id, command));
        }
        id
    }

    /// Sends the newest number outside the queue.
    fn push_urgent(&mut self, urgent: Urgent, command: Option<PendingCommand>) {
        self.pending_urgent.push_back((urgent, self.next_id, command));
        self.urgent.order(urgent, self.next_id);
    }

    /// Sends waiting overrides if the cycle has taken the preceding one, or in any case with `all`.
    fn send_overrides(&mut self, all: bool) {
        for which in 0..self.overrides.len() {
            let track = &mut self.overrides[which];
            if self.orders.is_full() || (track.sent.is_some() && !all) {
                // The next order that the cycle takes calls this function again.
                continue;
            }
            let Some((what, command)) = track.next.take() else {
                continue;
            };
            self.overrides[which].sent = Some(self.push(what, Some(command)));
        }
    }

    /// Whether the cycle lags behind its orders.
    pub(super) fn is_crowded(&self) -> bool {
        self.orders.slots() < KEPT_FOR_THE_CORE.min(self.orders.buffer().capacity() / 4)
    }

    /// Whether the next order for the queue does not fit.
    #[cfg(test)]
    pub(super) fn is_full(&self) -> bool {
        self.orders.is_full()
    }

    /// Orders that did not fit into the queue since the last call. The cycle has then received an emergency
    /// stop.
    pub(super) fn take_lost(&mut self) -> Vec<Order> {
        std::mem::take(&mut self.lost)
    }

    /// Notes that an order took effect with this setpoint, and records its command or job.
    pub(super) fn applied(&mut self, id: u64, sequence: u64) {
        if let Some(recorder) = &self.recorder {
            self.notes.applied(recorder, id, sequence);
        }
        if let Some((kind, ..)) = self.pending_urgent.iter().find(|(_, known, _)| *known == id) {
            let kind = *kind;
            // Older orders of its kind took effect with it. Those of the queue take effect when the cycle
            // takes them.
            while let Some(at) =
                (self.pending_urgent.iter()).position(|(other, known, _)| *other == kind && *known <= id)
            {
                if let Some((.., Some(command))) = self.pending_urgent.remove(at) {
                    self.record_applied(command, sequence);
                }
            }
            return;
        }
        for track in &mut self.overrides {
            track.sent.take_if(|sent| *sent <= id);
        }
        for sent in &mut self.repeatable {
            sent.take_if(|sent| *sent <= id);
        }
        while self.pending.front().is_some_and(|(known, _)| *known <= id) {
            if let Some((known, command)) = self.pending.pop_front()
                && known == id
            {
                self.record_applied(command, sequence);
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

    /// Begins another trace file after this setpoint.
    pub(super) fn begin_file(&mut self, sequence: u64) {
        if let Some(recorder) = &self.recorder {
            self.notes.begin_file();
            let _gone = recorder.send(FeederEvent::NextFile(sequence));
        }
    }
}

/// The part of a command that bypasses the queue.
const fn urgent_of(what: &CycleCommand) -> Option<Urgent> {
    match what {
        CycleCommand::Emergency => Some(Urgent::Emergency),
        CycleCommand::Stop => Some(Urgent::Stop),
        CycleCommand::Power(PowerRequest::Off) => Some(Urgent::PowerOff),
        _ => None,
    }
}

/// Which override a command sets.
const fn override_of(what: &CycleCommand) -> Option<usize> {
    match what {
        CycleCommand::Override(_) => Some(0),
        CycleCommand::SpindleOverride(_) => Some(1),
        _ => None,
    }
}

/// Which kind of repeatable order a command is.
const fn repeatable_of(what: &CycleCommand) -> Option<usize> {
    match what {
        CycleCommand::Hold => Some(0),
        CycleCommand::StopSteering => Some(1),
        _ => None,
    }
}

/// Whether a hold or stop ordered after this command is a new one: the command permits motion or ends a hold.
const fn ends_repetition(what: &CycleCommand) -> bool {
    matches!(
        what,
        CycleCommand::Follow(_)
            | CycleCommand::Steer(_)
            | CycleCommand::Turn { .. }
            | CycleCommand::Retrace { .. }
            | CycleCommand::Resume(_)
    )
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::{Receiver, channel};

    use rtrb::{Consumer, RingBuffer};

    use super::*;

    /// A book with its queue and its records.
    struct BookFixture {
        book: OrderBook,
        queue: Consumer<Order>,
        recorded: Receiver<FeederEvent>,
    }

    impl BookFixture {
        fn new(slots: usize) -> Self {
            let (orders, queue) = RingBuffer::new(slots);
            let (recorder, recorded) = channel();
            let book = OrderBook::new(orders, Arc::default(), Some(recorder));
            Self {
                book,
                queue,
                recorded,
            }
        }

        /// Commands recorded since the last call, with their setpoints.
        fn records(&self) -> Vec<(String, u64)> {
            let events = self.recorded.try_iter().filter_map(|event| match event {
                FeederEvent::ExternalEvent(event) => Some((event.text, event.sequence)),
                _ => None,
            });
            events.collect()
        }
    }

    fn records_of(commands: &[(&OperatorCommand, u64)]) -> Vec<(String, u64)> {
        let texts = commands
            .iter()
            .map(|(command, sequence)| (command.to_string(), *sequence));
        texts.collect()
    }

    /// ESTOP during a job: its stop has no command of its own. The cycle reports it before the override,
    /// which the cycle took from the queue earlier.
    #[test]
    fn a_stop_without_a_command_discards_no_queued_one() {
        let mut fixture = BookFixture::new(64);
        let turn = OperatorCommand::FeedOverride(0.5);
        fixture.book.send(CycleCommand::Override(0.5), &turn);
        let stop = fixture.book.order(CycleCommand::Stop);
        let emergency = fixture
            .book
            .send(CycleCommand::Emergency, &OperatorCommand::Estop);
        assert_eq!((stop, emergency), (2, 3));
        for id in [stop, emergency, 1] {
            fixture.book.applied(id, 10);
        }
        assert_eq!(
            fixture.records(),
            records_of(&[(&OperatorCommand::Estop, 10), (&turn, 10)])
        );
    }

    #[test]
    fn a_stop_is_recorded_with_a_later_one_of_its_kind() {
        let mut fixture = BookFixture::new(64);
        fixture.book.send(CycleCommand::Stop, &OperatorCommand::Stop);
        let off = fixture
            .book
            .send(CycleCommand::Power(PowerRequest::Off), &OperatorCommand::Off);
        let newer = fixture.book.order(CycleCommand::Stop);
        fixture.book.applied(newer, 10);
        assert_eq!(fixture.records(), records_of(&[(&OperatorCommand::Stop, 10)]));
        fixture.book.applied(off, 11);
        assert_eq!(
            fixture.records(),
            records_of(&[(&OperatorCommand::Off, 11)]),
            "another kind counts by itself"
        );
    }

    /// An order that does not fit causes an emergency stop, which does not affect orders that did fit.
    #[test]
    fn a_full_queue_discards_none_of_its_commands() {
        let mut fixture = BookFixture::new(1);
        let first = fixture
            .book
            .send(CycleCommand::Clear, &OperatorCommand::ClearAlarms);
        let lost = fixture
            .book
            .send(CycleCommand::LeaveEstop, &OperatorCommand::EstopReset);
        assert_eq!((fixture.queue.slots(), fixture.book.take_lost().len()), (1, 1));
        fixture.book.applied(lost + 1, 10);
        fixture.book.applied(first, 11);
        assert_eq!(
            fixture.records(),
            records_of(&[(&OperatorCommand::ClearAlarms, 11)])
        );
    }

    /// However often HOLD arrives before the cycle takes it, it is one order, and each HOLD is recorded.
    #[test]
    fn a_pending_hold_is_not_ordered_twice() {
        let mut fixture = BookFixture::new(64);
        let turn = OperatorCommand::FeedOverride(0.5);
        let first = fixture.book.send(CycleCommand::Hold, &OperatorCommand::Hold);
        let stop = fixture
            .book
            .send(CycleCommand::StopSteering, &OperatorCommand::JogStop);
        fixture.book.send(CycleCommand::Override(0.5), &turn);
        assert_eq!(
            fixture.book.send(CycleCommand::Hold, &OperatorCommand::Hold),
            first
        );
        assert_eq!(fixture.book.order(CycleCommand::StopSteering), stop);
        assert_eq!(fixture.queue.slots(), 3);
        // A hold after this one is a new order.
        let resume = fixture
            .book
            .send(CycleCommand::Resume(None), &OperatorCommand::Resume);
        let again = fixture.book.send(CycleCommand::Hold, &OperatorCommand::Hold);
        assert!(resume > stop && again > resume);
        for id in 1..=again {
            fixture.book.applied(id, 10 + id);
        }
        assert_eq!(
            fixture.records(),
            records_of(&[
                (&OperatorCommand::Hold, 11),
                (&OperatorCommand::Hold, 11),
                (&OperatorCommand::JogStop, 12),
                (&turn, 13),
                (&OperatorCommand::Resume, 14),
                (&OperatorCommand::Hold, 15),
            ])
        );
        // The cycle may have ended the hold meanwhile.
        assert!(fixture.book.order(CycleCommand::Hold) > again);
    }

    /// The command was accepted, so it takes effect once there is capacity; changing an override stops
    /// nothing.
    #[test]
    fn an_override_waits_while_the_queue_is_full() {
        let mut fixture = BookFixture::new(1);
        let turn = OperatorCommand::FeedOverride(0.5);
        let first = fixture
            .book
            .send(CycleCommand::Clear, &OperatorCommand::ClearAlarms);
        assert!(fixture.book.is_full());
        fixture.book.send(CycleCommand::Override(0.5), &turn);
        assert!(fixture.book.take_lost().is_empty());
        let taken = fixture.queue.pop().unwrap();
        fixture.book.applied(taken.id, 10);
        let sent = fixture.queue.pop().unwrap();
        assert!(sent.id > first && matches!(sent.what, CycleCommand::Override(0.5)));
        fixture.book.applied(sent.id, 11);
        assert_eq!(
            fixture.records(),
            records_of(&[(&OperatorCommand::ClearAlarms, 10), (&turn, 11)])
        );
    }
}
