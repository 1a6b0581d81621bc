//! The wait-free queue from the planner to the cycle, and the cycle's requests back.
//!
//! Segments, marks and steps go through rings; what changes of steps that are already queued stands in a table of
//! atomics beside them.
//!
//! A classic plan raises the exit speed of queued runs, from the last run backwards, so whatever the cycle reads,
//! at whatever moment, can be brought to rest on the path.
//!
//! A near-optimal plan is a chain of pieces of a time law. After the committed pieces lies a *tail* that ends at
//! rest; the last committed step is *open*. When more has been planned, it is appended after the tail, and the open step is
//! *linked* to it: the tail is skipped. A cycle that comes to the end of what is committed before that claims the link, drives
//! the tail, and the planner's late link fails. Overrides come as a [`Request`] for a new plan from a place a few cycles ahead;
//! the [`Reply`] names the step to go on with there. A cycle that cannot take a reply over says that it has withdrawn the
//! request: then the planner drops that plan and goes on with the one that is driven.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use evolvent_planner::{
    BlockMark, ExitSpeeds, PENDING_SEGMENTS, PENDING_STEPS, PlanSink, Reply, Request, Segment, Step,
};
use rtrb::{Consumer, Producer, RingBuffer};

use crate::probing::Probing;
use crate::process_cycle::ProcessCycle;
use crate::takeover::{ProbingSender, ProcessSender, TakeoverReceiver, ThreadingSender, takeover_queue};
use crate::threading::Threading;

/// Steps that are final and waiting, beyond what the look-ahead needs for itself.
const READY_STEPS: usize = 28_608;
/// The same for segments: enough for [`STEPS_AHEAD`] runs of the most segments.
const READY_SEGMENTS: usize = 12_288;
/// Starts of blocks.
const MARKS: usize = 1 << 17;
/// Requests and replies; one at a time is open.
const REQUESTS: usize = 8;
/// The virtual clock, and every start from rest, waits until this many runs are final (or the plan is
/// complete), so that a cycle never enters a run that could still change.
pub const STEPS_AHEAD: u64 = 64;
/// A link that the cycle has claimed: it goes on with the step after.
const CLAIMED: u64 = u64::MAX;
/// A link that the planner has left open: the step after begins a tail.
const OPEN: u64 = u64::MAX - 1;
/// The link of a step that keeps the place of what follows a stop, until that has been appended.
const PLACE: u64 = u64::MAX - 2;
/// Bit of the link of such a step once it has: the others are the successor + 1.
const TAKEN: u64 = 1 << 63;

#[derive(Debug)]
struct Table {
    exits: Box<[[AtomicU64; 2]]>,
    /// Successor + 1 where it is not simply the next step; 0 where it is; [`OPEN`] or [`CLAIMED`] before a tail; [`PLACE`], or the
    /// successor + 1 with [`TAKEN`], of a step that keeps a place.
    links: Box<[AtomicU64]>,
    committed: AtomicU64,
    complete: AtomicU64,
    /// The last wait for an input, probing move or thread + 1: nothing comes after it before it is over.
    waits_at: AtomicU64,
    reached: AtomicU64,
    acknowledged: AtomicU64,
    withdrawn: AtomicU64,
}

impl Table {
    fn exit(&self, index: u64) -> &[AtomicU64; 2] {
        &self.exits[(index % self.exits.len() as u64) as usize]
    }

    fn link(&self, index: u64) -> &AtomicU64 {
        &self.links[(index % self.links.len() as u64) as usize]
    }
}

/// Makes a queue. `wait` is called while the queue is full; it returns `false` to give up.
#[must_use]
pub fn plan_queue<W: FnMut() -> bool>(wait: W) -> (PlanProducer<W>, PlanConsumer) {
    let steps = PENDING_STEPS + READY_STEPS;
    let (step_producer, step_consumer) = RingBuffer::new(steps);
    let (segment_producer, segment_consumer) = RingBuffer::new(PENDING_SEGMENTS + READY_SEGMENTS);
    let (mark_producer, mark_consumer) = RingBuffer::new(MARKS);
    let (request_producer, request_consumer) = RingBuffer::new(REQUESTS);
    let (reply_producer, reply_consumer) = RingBuffer::new(REQUESTS);
    let (process_sender, processes) = takeover_queue();
    let (probing_sender, probings) = takeover_queue();
    let (threading_sender, threadings) = takeover_queue();
    let table = Arc::new(Table {
        exits: (0..steps)
            .map(|_| [AtomicU64::new(0), AtomicU64::new(0)])
            .collect(),
        links: (0..steps).map(|_| AtomicU64::new(0)).collect(),
        committed: AtomicU64::new(0),
        complete: AtomicU64::new(0),
        waits_at: AtomicU64::new(0),
        reached: AtomicU64::new(0),
        acknowledged: AtomicU64::new(0),
        withdrawn: AtomicU64::new(0),
    });
    let producer = PlanProducer {
        steps: step_producer,
        segments: segment_producer,
        marks: mark_producer,
        requests: request_consumer,
        replies: reply_producer,
        processes: Some(process_sender),
        probings: Some(probing_sender),
        threadings: Some(threading_sender),
        table: Arc::clone(&table),
        appended: 0,
        wait,
    };
    let consumer = PlanConsumer {
        steps: step_consumer,
        segments: segment_consumer,
        marks: mark_consumer,
        requests: request_producer,
        replies: reply_consumer,
        processes,
        probings,
        threadings,
        table,
        taken_steps: 0,
        taken_segments: 0,
        taken_marks: 0,
    };
    (producer, consumer)
}

/// The consumer does not take more: it has gone, or the run was given up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the cycle has stopped taking the plan")]
pub struct QueueClosed;

/// The planner's end.
#[derive(Debug)]
pub struct PlanProducer<W> {
    steps: Producer<Step>,
    segments: Producer<Segment>,
    marks: Producer<BlockMark>,
    requests: Consumer<Request>,
    replies: Producer<Reply>,
    processes: Option<ProcessSender>,
    probings: Option<ProbingSender>,
    threadings: Option<ThreadingSender>,
    table: Arc<Table>,
    appended: u64,
    wait: W,
}

impl<W> PlanProducer<W> {
    /// The way of passes of threading to the cycle, once.
    pub fn take_threadings(&mut self) -> Option<ThreadingSender> {
        self.threadings.take()
    }

    /// The way of probing moves to the cycle, once.
    pub fn take_probings(&mut self) -> Option<ProbingSender> {
        self.probings.take()
    }

    /// The way of process cycles to the cycle, once.
    pub fn take_processes(&mut self) -> Option<ProcessSender> {
        self.processes.take()
    }
}

impl<W: FnMut() -> bool> PlanProducer<W> {
    fn append(&mut self, step: &Step, link: u64) -> Result<(), QueueClosed> {
        while self.steps.is_full() {
            self.wait()?;
        }
        for speed in self.table.exit(self.appended) {
            speed.store(0, Ordering::Release);
        }
        self.table.link(self.appended).store(link, Ordering::Release);
        if matches!(step, Step::End { .. }) {
            self.table.complete.store(self.appended + 1, Ordering::Release);
        }
        if matches!(
            step,
            Step::InputWait { .. } | Step::Probe { .. } | Step::Thread { .. }
        ) {
            self.table.waits_at.store(self.appended + 1, Ordering::Release);
        }
        self.appended += 1;
        self.steps.push(*step).map_err(|_| QueueClosed)
    }
}

impl<W: FnMut() -> bool> PlanSink for PlanProducer<W> {
    type Error = QueueClosed;

    fn segment(&mut self, segment: &Segment) -> Result<(), QueueClosed> {
        while self.segments.is_full() {
            self.wait()?;
        }
        self.segments.push(*segment).map_err(|_| QueueClosed)
    }

    fn step(&mut self, step: &Step) -> Result<(), QueueClosed> {
        self.append(step, 0)
    }

    fn exit(&mut self, index: u64, speeds: ExitSpeeds) {
        let [nominal, doubled] = self.table.exit(index);
        // In this order: who reads the new nominal speed reads no older doubled one, which would be below it.
        doubled.store(speeds.doubled.to_bits(), Ordering::Release);
        nominal.store(speeds.nominal.to_bits(), Ordering::Release);
    }

    fn commit(&mut self, count: u64) {
        self.table.committed.store(count, Ordering::Release);
    }

    fn mark(&mut self, mark: &BlockMark) -> Result<(), QueueClosed> {
        while self.marks.is_full() {
            self.wait()?;
        }
        self.marks.push(*mark).map_err(|_| QueueClosed)
    }

    fn leave_open(&mut self, from: u64) {
        self.table.link(from).store(OPEN, Ordering::Release);
    }

    fn keep_place(&mut self) -> Result<(), QueueClosed> {
        self.append(&Step::Wait, PLACE)
    }

    fn link(&mut self, from: u64, to: u64) -> bool {
        let link = self.table.link(from);
        let exchange = |from, to| link.compare_exchange(from, to, Ordering::AcqRel, Ordering::Acquire);
        exchange(OPEN, to + 1).is_ok() || exchange(PLACE, (to + 1) | TAKEN).is_ok()
    }

    fn has_capacity(&self, steps: usize, segments: usize, marks: usize) -> bool {
        self.steps.slots() >= steps && self.segments.slots() >= segments && self.marks.slots() >= marks
    }

    fn wait(&mut self) -> Result<(), QueueClosed> {
        if self.steps.is_abandoned() || !(self.wait)() {
            return Err(QueueClosed);
        }
        Ok(())
    }

    fn request(&mut self) -> Option<Request> {
        // Only the last one is still open.
        let mut last = None;
        while let Ok(request) = self.requests.pop() {
            last = Some(request);
        }
        last
    }

    fn reply(&mut self, reply: Reply) {
        // A reply that finds no room is one that is not waited for.
        let _unheard = self.replies.push(reply);
    }

    fn acknowledged(&self) -> u64 {
        self.table.acknowledged.load(Ordering::Acquire)
    }

    fn withdrawn(&self) -> u64 {
        self.table.withdrawn.load(Ordering::Acquire)
    }

    fn reached(&self) -> u64 {
        self.table.reached.load(Ordering::Acquire)
    }
}

/// The cycle's end. Nothing here allocates, locks or waits.
#[derive(Debug)]
pub struct PlanConsumer {
    steps: Consumer<Step>,
    segments: Consumer<Segment>,
    marks: Consumer<BlockMark>,
    requests: Producer<Request>,
    replies: Consumer<Reply>,
    pub(crate) processes: TakeoverReceiver<dyn ProcessCycle>,
    pub(crate) probings: TakeoverReceiver<Probing>,
    pub(crate) threadings: TakeoverReceiver<Threading>,
    table: Arc<Table>,
    taken_steps: u64,
    taken_segments: u64,
    taken_marks: u64,
}

impl PlanConsumer {
    /// Step number `index`, counted from the first ever; none if it has not come or was taken.
    pub fn step(&mut self, index: u64) -> Option<Step> {
        nth(&mut self.steps, index.checked_sub(self.taken_steps)? as usize)
    }

    /// Segment number `index`.
    pub fn segment(&mut self, index: u64) -> Option<Segment> {
        nth(
            &mut self.segments,
            index.checked_sub(self.taken_segments)? as usize,
        )
    }

    /// Mark number `index`.
    pub fn mark(&mut self, index: u64) -> Option<BlockMark> {
        nth(&mut self.marks, index.checked_sub(self.taken_marks)? as usize)
    }

    /// Exit speeds of step `index`.
    #[must_use]
    pub fn exit(&self, index: u64) -> ExitSpeeds {
        let [nominal, doubled] = self.table.exit(index);
        ExitSpeeds {
            nominal: f64::from_bits(nominal.load(Ordering::Acquire)),
            doubled: f64::from_bits(doubled.load(Ordering::Acquire)),
        }
    }

    /// Whether step `index` is final.
    #[must_use]
    pub fn is_final(&self, index: u64) -> bool {
        self.table.committed.load(Ordering::Acquire) > index
    }

    /// The step that stands in the place of step `index`, which is another one if that only keeps a place; none while nothing has taken it.
    pub fn occupant(&mut self, index: u64) -> Option<u64> {
        // One look, after the step has been seen: before it is there its link may be that of an older step.
        if !matches!(self.step(index), Some(Step::Wait)) {
            return Some(index);
        }
        match self.table.link(index).load(Ordering::Acquire) {
            PLACE => None,
            OPEN | CLAIMED => Some(index),
            link if link & TAKEN != 0 => Some((link & !TAKEN) - 1),
            _ => Some(index),
        }
    }

    /// Whether it is settled that the tail after step `index` is driven.
    #[must_use]
    pub fn is_claimed(&self, index: u64) -> bool {
        self.table.link(index).load(Ordering::Acquire) == CLAIMED
    }

    /// The step after step `index`, and whether it is final. Does not settle which way is taken.
    #[must_use]
    pub fn successor(&self, index: u64) -> (u64, bool) {
        // In this order: what is final was left open or linked before it was declared final.
        let committed = self.table.committed.load(Ordering::Acquire);
        match self.table.link(index).load(Ordering::Acquire) {
            0 => (index + 1, index + 1 < committed),
            OPEN | CLAIMED => (index + 1, false),
            // Only what is committed is linked, also where that has not been declared final yet.
            link => (link - 1, true),
        }
    }

    /// The same, and settles it: after this the planner cannot link step `index` elsewhere.
    pub fn claim_successor(&mut self, index: u64) -> (u64, bool) {
        let (next, is_final) = self.successor(index);
        if is_final {
            return (next, true);
        }
        let link = self.table.link(index);
        for from in [0, OPEN] {
            match link.compare_exchange(from, CLAIMED, Ordering::AcqRel, Ordering::Acquire) {
                Ok(_) | Err(CLAIMED) => return (index + 1, false),
                Err(0 | OPEN) => {}
                Err(link) => return (link - 1, true),
            }
        }
        (index + 1, false)
    }

    /// The step after step `index`, settled, and whether the planner had not linked one or not declared it final. With `tail` a
    /// step that was left open is followed by its tail all the same: a recorded run that drove it is computed again.
    pub(crate) fn settle_successor(&mut self, index: u64, tail: bool) -> (u64, bool) {
        let link = self.table.link(index);
        if tail && link.load(Ordering::Acquire) != 0 {
            link.store(CLAIMED, Ordering::Release);
            return (index + 1, true);
        }
        let (next, is_final) = self.claim_successor(index);
        (next, !is_final)
    }

    /// Whether the runs ahead of step `index` cannot change any more: the next [`STEPS_AHEAD`] steps are final, or
    /// all up to a wait for an input, or the plan is complete.
    #[must_use]
    pub fn has_final_ahead(&self, index: u64) -> bool {
        let committed = self.table.committed.load(Ordering::Acquire);
        let waits_at = self.table.waits_at.load(Ordering::Acquire);
        let up_to_wait = committed >= waits_at && waits_at > index;
        committed >= index + STEPS_AHEAD || up_to_wait || self.is_complete()
    }

    /// Whether everything up to the program's end is final.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        let committed = self.table.committed.load(Ordering::Acquire);
        let complete = self.table.complete.load(Ordering::Acquire);
        complete > 0 && committed >= complete
    }

    /// Whether the planner has gone without completing the plan.
    #[must_use]
    pub fn is_abandoned(&self) -> bool {
        self.has_no_planner() && self.table.complete.load(Ordering::Acquire) == 0
    }

    /// Whether requests are no longer answered.
    #[must_use]
    pub fn has_no_planner(&self) -> bool {
        self.steps.is_abandoned()
    }

    /// Whether there is room for a request.
    #[must_use]
    pub fn can_ask(&self) -> bool {
        !self.requests.is_full()
    }

    /// Sends a request to the planner; `false` if there is no room, which only a dead planner leaves.
    pub fn ask(&mut self, request: Request) -> bool {
        // Replies to requests that were withdrawn are not read, and must not take the room of this one's.
        while self.replies.pop().is_ok() {}
        self.requests.push(request).is_ok()
    }

    /// The reply to request `id`, if it has come; older ones are dropped.
    pub fn reply(&mut self, id: u64) -> Option<Reply> {
        while let Ok(reply) = self.replies.peek().copied() {
            if reply.id == id {
                return Some(reply);
            }
            let _old = self.replies.pop();
        }
        None
    }

    /// Says that no reply to request `id` will be taken over, nor to an earlier one.
    pub fn withdraw_request(&self, id: u64) {
        self.table.withdrawn.store(id, Ordering::Release);
    }

    /// Says that the reply to request `id` has been taken over.
    pub fn acknowledge_replan(&mut self, id: u64) {
        self.table.acknowledged.store(id, Ordering::Release);
    }

    /// Takes everything before these indices for good. `interval` is the grid interval reached.
    pub fn take(&mut self, step: u64, segment: u64, mark: u64, interval: u64) {
        self.taken_steps += take(&mut self.steps, step.saturating_sub(self.taken_steps));
        self.taken_segments += take(&mut self.segments, segment.saturating_sub(self.taken_segments));
        self.taken_marks += take(&mut self.marks, mark.saturating_sub(self.taken_marks));
        self.table.reached.store(interval, Ordering::Release);
    }
}

fn take<T>(consumer: &mut Consumer<T>, count: u64) -> u64 {
    if count > 0
        && let Ok(chunk) = consumer.read_chunk(count as usize)
    {
        chunk.commit_all();
        return count;
    }
    0
}

fn nth<T: Copy>(consumer: &mut Consumer<T>, ahead: usize) -> Option<T> {
    let chunk = consumer.read_chunk(ahead + 1).ok()?;
    let (first, second) = chunk.as_slices();
    first
        .get(ahead)
        .or_else(|| second.get(ahead - first.len()))
        .copied()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::expect_used, reason = "a test may fail")]

    use std::cell::Cell;
    use std::rc::Rc;

    use super::*;

    fn dwell(line: u32) -> Step {
        Step::Dwell { seconds: 0.1, line }
    }

    fn request(id: u64) -> Request {
        Request {
            id,
            segment: 0,
            offset: 0.0,
            interval: 0,
            v: 0.0,
            a: 0.0,
            rests: 0,
            rate: 1.0,
            feed_factor: 1.0,
        }
    }

    /// Four steps, the first two of them final, the others a tail.
    fn four() -> (PlanProducer<fn() -> bool>, PlanConsumer) {
        let (mut producer, consumer) = plan_queue((|| false) as fn() -> bool);
        for line in 0..4 {
            producer.step(&dwell(line)).expect("room");
        }
        producer.leave_open(1);
        producer.commit(2);
        (producer, consumer)
    }

    #[test]
    fn a_linked_step_is_followed_by_what_it_is_linked_to_and_that_is_final() {
        let (mut producer, mut consumer) = four();
        assert_eq!(consumer.successor(0), (1, true));
        assert_eq!(consumer.successor(1), (2, false), "the tail may yet be replaced");
        assert!(producer.link(1, 3));
        assert_eq!(consumer.successor(1), (3, true));
        assert_eq!(consumer.claim_successor(1), (3, true));
        assert!(!consumer.is_claimed(1), "there was nothing to settle");
    }

    #[test]
    fn a_tail_that_was_claimed_cannot_be_skipped_any_more() {
        let (mut producer, mut consumer) = four();
        assert!(!consumer.is_claimed(1));
        assert_eq!(consumer.claim_successor(1), (2, false));
        assert!(consumer.is_claimed(1));
        assert!(!producer.link(1, 3), "the link comes too late");
        assert_eq!(consumer.successor(1), (2, false));
        assert_eq!(consumer.claim_successor(1), (2, false), "a second time");
    }

    #[test]
    fn a_tail_stays_a_tail_when_what_was_appended_after_it_is_declared_final() {
        let (mut producer, consumer) = four();
        producer.step(&dwell(4)).expect("room");
        producer.commit(5);
        assert_eq!(consumer.successor(1), (2, false));
        assert_eq!(consumer.successor(2), (3, true), "within the tail");
        assert!(producer.link(1, 4), "taken up again");
        assert_eq!(consumer.successor(1), (4, true));
        let (mut producer, mut consumer) = four();
        producer.commit(4);
        assert_eq!(consumer.settle_successor(1, false), (2, true), "a tail");
        assert!(!producer.link(1, 3));
        assert_eq!(consumer.settle_successor(0, false), (1, false), "final");
    }

    #[test]
    fn a_step_that_was_not_left_open_is_not_linked() {
        let (mut producer, consumer) = four();
        assert!(!producer.link(0, 2));
        assert_eq!(consumer.successor(0), (1, true));
    }

    #[test]
    fn a_place_that_is_kept_after_a_stop_is_that_of_the_step_that_is_linked_to_it() {
        let (mut producer, mut consumer) = plan_queue(|| false);
        producer.step(&dwell(0)).expect("room");
        producer.keep_place().expect("room");
        producer.commit(2);
        assert_eq!((consumer.occupant(0), consumer.occupant(1)), (Some(0), None));
        // The plan of a reply that is not taken over, and what follows the stop.
        for line in 2..4 {
            producer.step(&dwell(line)).expect("room");
        }
        producer.commit(4);
        assert_eq!((consumer.successor(0), consumer.occupant(1)), ((1, true), None));
        assert!(producer.link(1, 3));
        assert!(!producer.link(1, 2), "there is one");
        assert_eq!(consumer.occupant(1), Some(3));
        assert_eq!(consumer.occupant(3), Some(3), "any other step stands for itself");
        assert_eq!(consumer.occupant(4), Some(4), "also one that has not come");
        producer.step(&Step::Wait).expect("room");
        assert_eq!(consumer.occupant(4), Some(4), "an ordinary wait");
    }

    #[test]
    fn a_step_that_has_not_come_has_no_link_of_an_old_one() {
        let (mut producer, mut consumer) = plan_queue(|| false);
        let size = (PENDING_STEPS + READY_STEPS) as u64;
        producer.keep_place().expect("room");
        for k in 1..size {
            producer.step(&dwell(k as u32)).expect("room");
        }
        consumer.take(1, 0, 0, 0);
        assert_eq!(consumer.occupant(size), Some(size));
        producer.step(&Step::Wait).expect("room");
        assert_eq!(consumer.occupant(size), Some(size));
    }

    #[test]
    fn the_planner_hears_which_request_was_withdrawn() {
        let (producer, consumer) = four();
        assert_eq!(producer.withdrawn(), 0);
        consumer.withdraw_request(3);
        assert_eq!(producer.withdrawn(), 3);
    }

    #[test]
    fn a_recorded_look_ahead_meets_its_tail_again() {
        let (mut producer, mut consumer) = four();
        assert!(producer.link(1, 3));
        assert_eq!(consumer.settle_successor(1, true), (2, true));
        assert_eq!(consumer.claim_successor(1), (2, false));
    }

    #[test]
    fn answers_that_nobody_read_leave_room_for_the_next() {
        let (mut producer, mut consumer) = four();
        for id in 1..=2 * REQUESTS as u64 {
            assert!(consumer.ask(request(id)));
            assert!(producer.request().is_some());
            producer.reply(Reply { id, step: Some(3) });
        }
        let last = 2 * REQUESTS as u64;
        assert!(consumer.reply(last).is_some());
    }

    #[test]
    fn a_claim_of_a_step_whose_successor_is_final_settles_nothing() {
        let (_producer, mut consumer) = four();
        assert_eq!(consumer.claim_successor(0), (1, true));
        assert!(!consumer.is_claimed(0));
    }

    #[test]
    fn a_step_in_the_place_of_an_old_one_has_no_link_and_no_exit_of_it() {
        let (mut producer, mut consumer) = plan_queue(|| false);
        let size = (PENDING_STEPS + READY_STEPS) as u64;
        producer.step(&dwell(0)).expect("room");
        producer.exit(
            0,
            ExitSpeeds {
                nominal: 1.0,
                doubled: 2.0,
            },
        );
        assert_eq!((consumer.exit(0).nominal, consumer.exit(0).doubled), (1.0, 2.0));
        producer.leave_open(0);
        assert!(producer.link(0, 5));
        for k in 1..size {
            producer.step(&dwell(k as u32)).expect("room");
        }
        consumer.take(1, 0, 0, 0);
        producer.step(&dwell(7)).expect("room");
        assert_eq!(consumer.successor(size), (size + 1, false));
        assert_eq!(consumer.exit(size), ExitSpeeds::REST);
    }

    #[test]
    fn a_full_queue_waits_until_something_is_taken_and_says_so_if_nobody_takes() {
        let waits = Rc::new(Cell::new(0));
        let counted = Rc::clone(&waits);
        let (mut producer, consumer) = plan_queue(move || {
            counted.set(counted.get() + 1);
            counted.get() < 3
        });
        let size = PENDING_STEPS + READY_STEPS;
        for k in 0..size {
            assert!(producer.has_capacity(1, 0, 0));
            producer.step(&dwell(k as u32)).expect("room");
        }
        assert!(!producer.has_capacity(1, 0, 0) && producer.has_capacity(0, 1, 1));
        assert_eq!(waits.get(), 0);
        assert_eq!(producer.step(&dwell(0)), Err(QueueClosed));
        assert_eq!(waits.get(), 3);
        drop(consumer);
        assert_eq!(producer.wait(), Err(QueueClosed));
        assert_eq!(waits.get(), 3, "a consumer that has gone is not waited for");
    }

    #[test]
    fn what_is_taken_is_gone_and_the_rest_keeps_its_numbers() {
        let (_producer, mut consumer) = four();
        assert_eq!(consumer.step(2), Some(dwell(2)));
        consumer.take(2, 0, 0, 17);
        assert_eq!(consumer.step(1), None);
        assert_eq!(
            (consumer.step(2), consumer.step(3)),
            (Some(dwell(2)), Some(dwell(3)))
        );
        assert_eq!(consumer.step(4), None);
        assert_eq!(_producer.reached(), 17);
    }

    #[test]
    fn a_planner_that_has_gone_is_noticed_and_what_it_left_can_be_read() {
        let (mut producer, mut consumer) = four();
        assert!(!consumer.has_no_planner() && !consumer.is_abandoned());
        producer.step(&Step::End { line: 9 }).expect("room");
        assert!(!consumer.is_complete());
        producer.commit(5);
        assert!(consumer.is_complete() && consumer.has_final_ahead(4));
        drop(producer);
        assert!(consumer.has_no_planner());
        assert!(!consumer.is_abandoned(), "the plan is complete");
        assert_eq!(consumer.step(4), Some(Step::End { line: 9 }));
        let (producer, consumer) = four();
        drop(producer);
        assert!(consumer.is_abandoned() && !consumer.is_complete());
    }

    #[test]
    fn only_the_last_request_is_open_and_only_its_answer_is_heard() {
        let (mut producer, mut consumer) = four();
        assert_eq!(producer.request(), None);
        assert!(consumer.ask(request(1)) && consumer.ask(request(2)));
        assert_eq!(producer.request(), Some(request(2)));
        assert_eq!(producer.request(), None, "asked once");
        for id in [1, 2] {
            producer.reply(Reply {
                id,
                step: Some(10 + id),
            });
        }
        let reply = consumer.reply(2).expect("a reply");
        assert_eq!((reply.id, reply.step), (2, Some(12)));
        assert_eq!(consumer.reply(2).map(|reply| reply.id), Some(2), "it stays");
        assert_eq!(consumer.reply(3), None);
        assert_eq!(producer.acknowledged(), 0);
        consumer.acknowledge_replan(2);
        assert_eq!(producer.acknowledged(), 2);
    }

    #[test]
    fn requests_that_a_dead_planner_does_not_read_are_refused_when_there_is_no_room() {
        let (_producer, mut consumer) = four();
        let sent = (1..=20).take_while(|&id| consumer.ask(request(id))).count();
        assert_eq!(sent, REQUESTS);
    }
}
