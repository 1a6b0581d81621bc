//! The wait-free queue from the planner to the cycle, and the cycle's requests back.
//!
//! Segments, marks and steps pass through rings. Data of queued steps that can still change is in a table of
//! atomics.
//!
//! A classic plan raises the exit speeds of queued runs, starting from the last run, so whatever the cycle
//! reads at any moment can be stopped on the path.
//!
//! A time-optimal plan is a chain of timed segments. The committed segments are followed by a *tail* that
//! ends at rest; the last committed step is *open*. A continuation of the plan is appended after the tail,
//! and the open step is *linked* to it, which skips the tail. If the cycle reaches the end of the committed
//! steps first, it claims the link and drives the tail, and the late link of the planner fails. For another
//! override the cycle sends a [`ReplanRequest`] for a new plan from a position a few cycles ahead; the [`ReplanReply`]
//! names the step at which it continues there. A cycle that cannot take over a reply withdraws the request:
//! the planner then drops that plan and continues the one that is driven.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use evolvent_planner::{
    BlockMark, ExitSpeeds, PENDING_SEGMENTS, PENDING_STEPS, PlanSink, ReplanReply, ReplanRequest, Segment,
    Step,
};
use rtrb::{Consumer, Producer, RingBuffer};

use crate::probing::Probing;
use crate::process_cycle::ProcessCycle;
use crate::takeover::{ProbingSender, ProcessSender, TakeoverReceiver, ThreadingSender, takeover_queue};
use crate::threading::Threading;

/// Capacity for final steps, in addition to those that the look-ahead needs.
const READY_STEPS: usize = 28_608;
/// The same for segments: enough for [`STEPS_AHEAD`] runs with the maximum number of segments.
const READY_SEGMENTS: usize = 12_288;
/// Capacity for block starts.
const MARKS: usize = 1 << 17;
/// Capacity for requests and replies; one request is open at a time.
const REQUESTS: usize = 8;
/// The virtual clock, and every start from rest, waits until this many runs are final (or the plan is
/// complete), so that a cycle never enters a run that can still change.
pub const STEPS_AHEAD: u64 = 64;
/// A link that the cycle has claimed: it continues with the step after.
const CLAIMED: u64 = u64::MAX;
/// A link that the planner has left open: a tail follows.
const OPEN: u64 = u64::MAX - 1;
/// The link of a step that reserves a place for the step after a stop, until that step is linked.
const RESERVED: u64 = u64::MAX - 2;
/// Bit of the link of such a step once a step is linked: the other bits are the successor + 1.
const TAKEN: u64 = 1 << 63;

#[derive(Debug)]
struct Table {
    exits: Box<[[AtomicU64; 2]]>,
    /// The successor + 1 if it is not simply the next step, otherwise 0; [`OPEN`] or [`CLAIMED`] before a
    /// tail; for a step that reserves a place [`RESERVED`], or the successor + 1 with [`TAKEN`].
    links: Box<[AtomicU64]>,
    committed: AtomicU64,
    complete: AtomicU64,
    /// The last wait for an input, probing move or thread, + 1: nothing follows it in the plan until it is
    /// over.
    waits_at: AtomicU64,
    reached: AtomicU64,
    reached_step: AtomicU64,
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
        reached_step: AtomicU64::new(0),
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
        lookups: PlanLookups::default(),
        settled_up_to: 0,
    };
    (producer, consumer)
}

/// The consumer accepts no more steps: it has been dropped, or the run was given up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the cycle has stopped taking the plan")]
pub struct QueueClosed;

/// The planner's end.
#[derive(Debug)]
pub struct PlanProducer<W> {
    steps: Producer<Step>,
    segments: Producer<Segment>,
    marks: Producer<BlockMark>,
    requests: Consumer<ReplanRequest>,
    replies: Producer<ReplanReply>,
    processes: Option<ProcessSender>,
    probings: Option<ProbingSender>,
    threadings: Option<ThreadingSender>,
    table: Arc<Table>,
    appended: u64,
    wait: W,
}

impl<W> PlanProducer<W> {
    /// The sender of threading passes to the cycle; `Some` on the first call only.
    pub fn take_threadings(&mut self) -> Option<ThreadingSender> {
        self.threadings.take()
    }

    /// The sender of probing moves to the cycle; `Some` on the first call only.
    pub fn take_probings(&mut self) -> Option<ProbingSender> {
        self.probings.take()
    }

    /// The sender of process cycles to the cycle; `Some` on the first call only.
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
        // The order matters: a reader of the new nominal speed must not read an older doubled one, which
        // would be below it.
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

    fn reserve_link(&mut self) -> Result<(), QueueClosed> {
        self.append(&Step::Wait, RESERVED)
    }

    fn link(&mut self, from: u64, to: u64) -> bool {
        let link = self.table.link(from);
        let exchange = |from, to| link.compare_exchange(from, to, Ordering::AcqRel, Ordering::Acquire);
        exchange(OPEN, to + 1).is_ok() || exchange(RESERVED, (to + 1) | TAKEN).is_ok()
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

    fn request(&mut self) -> Option<ReplanRequest> {
        // Only the last request is still open.
        let mut last = None;
        while let Ok(request) = self.requests.pop() {
            last = Some(request);
        }
        last
    }

    fn reply(&mut self, reply: ReplanReply) {
        // A reply that does not fit belongs to a request that nobody waits for.
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

    fn reached_step(&self) -> u64 {
        self.table.reached_step.load(Ordering::Acquire)
    }
}

/// The cycle's end. Nothing here allocates, locks or waits.
#[derive(Debug)]
pub struct PlanConsumer {
    steps: Consumer<Step>,
    segments: Consumer<Segment>,
    marks: Consumer<BlockMark>,
    requests: Producer<ReplanRequest>,
    replies: Consumer<ReplanReply>,
    pub(crate) processes: TakeoverReceiver<dyn ProcessCycle>,
    pub(crate) probings: TakeoverReceiver<Probing>,
    pub(crate) threadings: TakeoverReceiver<Threading>,
    table: Arc<Table>,
    taken_steps: u64,
    taken_segments: u64,
    taken_marks: u64,
    lookups: PlanLookups,
    /// The step after the last end that was found continued: later looks at it give the same result.
    settled_up_to: u64,
}

/// The looks of a cycle at the plan. In real time the planner may not have finished what a look needs; a
/// recomputed cycle gets the same result as the recorded one.
#[derive(Debug, Default)]
struct PlanLookups {
    /// Number of successful looks. It saturates at a number that no cycle reaches.
    found: u8,
    /// Number of the first look that failed: all later ones fail too.
    failed: Option<u8>,
    /// The same number in the recorded cycle that is recomputed.
    recorded: Option<u8>,
}

impl PlanConsumer {
    /// Begins a cycle in which look number `failed_lookup` fails, as in the recorded cycle.
    pub(crate) fn begin_cycle(&mut self, failed_lookup: Option<u8>) {
        self.lookups = PlanLookups {
            recorded: failed_lookup,
            ..PlanLookups::default()
        };
    }

    /// Number of the look of this cycle that failed.
    pub(crate) fn failed_lookup(&self) -> Option<u8> {
        self.lookups.failed
    }

    /// Records a look; returns whether it succeeds.
    pub(crate) fn record_lookup(&mut self, is_there: bool) -> bool {
        if self.fails_again() || !is_there {
            self.lookups.failed.get_or_insert(self.lookups.found);
            return false;
        }
        self.lookups.found = self.lookups.found.saturating_add(1);
        true
    }

    /// Whether the next look fails regardless of the plan.
    fn fails_again(&self) -> bool {
        let lookups = &self.lookups;
        lookups.failed.is_some() || lookups.recorded.is_some_and(|number| lookups.found >= number)
    }

    /// Step number `index`, counted from the first step of the queue; `None` if it has not arrived or was
    /// taken.
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

    /// The step that is executed at the position of step `index`: itself, or for a reserved place the step
    /// linked to it, `None` until one is linked.
    pub fn occupant(&mut self, index: u64) -> Option<u64> {
        // The link is read once, after the step has been seen: before that it may belong to an older step.
        if !matches!(self.step(index), Some(Step::Wait)) {
            return Some(index);
        }
        match self.table.link(index).load(Ordering::Acquire) {
            RESERVED => None,
            OPEN | CLAIMED => Some(index),
            link if link & TAKEN != 0 => Some((link & !TAKEN) - 1),
            _ => Some(index),
        }
    }

    /// Whether the cycle has claimed the tail after step `index`.
    #[must_use]
    pub fn is_claimed(&self, index: u64) -> bool {
        self.table.link(index).load(Ordering::Acquire) == CLAIMED
    }

    /// The step after step `index`, and whether it is final. Does not settle the choice.
    #[must_use]
    pub fn successor(&self, index: u64) -> (u64, bool) {
        // The order matters: final steps were left open or linked before they were declared final.
        let committed = self.table.committed.load(Ordering::Acquire);
        match self.table.link(index).load(Ordering::Acquire) {
            0 => (index + 1, index + 1 < committed),
            OPEN | CLAIMED => (index + 1, false),
            // Only committed steps are linked, even if they have not been declared final yet.
            link => (link - 1, true),
        }
    }

    /// The same, and settles the choice: the planner can no longer link step `index` to another one.
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

    /// The step after step `index`, settled, and whether the planner had not got so far: then that step is a
    /// tail, or has to be waited for. `rests`: the axes rest between the two steps.
    pub(crate) fn settle_successor(&mut self, index: u64, rests: bool) -> (u64, bool) {
        let is_left_open = self.table.link(index).load(Ordering::Acquire) != 0;
        let is_end = (is_left_open || rests) && index >= self.settled_up_to;
        if is_end && self.fails_again() {
            if is_left_open {
                self.table.link(index).store(CLAIMED, Ordering::Release);
            }
            self.record_lookup(false);
            return (index + 1, true);
        }
        let (next, is_final) = self.claim_successor(index);
        let occupant = self.occupant(next).filter(|_| is_final);
        if !is_end && occupant.is_some() {
            return (next, false);
        }
        if self.record_lookup(occupant.is_some()) {
            self.settled_up_to = index + 1;
        }
        (occupant.unwrap_or(next), occupant.is_none())
    }

    /// Whether the runs after step `index` can no longer change: the next [`STEPS_AHEAD`] steps are final, or
    /// all steps up to a wait for an input, or the plan is complete.
    #[must_use]
    pub fn has_final_ahead(&self, index: u64) -> bool {
        self.has_final(index, STEPS_AHEAD)
    }

    /// The same for the next `count` steps.
    pub(crate) fn has_final(&self, index: u64, count: u64) -> bool {
        let committed = self.table.committed.load(Ordering::Acquire);
        let waits_at = self.table.waits_at.load(Ordering::Acquire);
        let up_to_wait = committed >= waits_at && waits_at > index;
        committed >= index + count || up_to_wait || self.is_complete()
    }

    /// Whether everything up to the program's end is final.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        let committed = self.table.committed.load(Ordering::Acquire);
        let complete = self.table.complete.load(Ordering::Acquire);
        complete > 0 && committed >= complete
    }

    /// Whether the planner has ended without completing the plan.
    #[must_use]
    pub fn is_abandoned(&self) -> bool {
        self.has_no_planner() && self.table.complete.load(Ordering::Acquire) == 0
    }

    /// Whether requests no longer get replies.
    #[must_use]
    pub fn has_no_planner(&self) -> bool {
        self.steps.is_abandoned()
    }

    /// Whether the queue has capacity for a request.
    #[must_use]
    pub fn can_request(&self) -> bool {
        !self.requests.is_full()
    }

    /// Sends a request to the planner. Returns `false` if the queue is full, which only happens without a
    /// planner.
    pub fn send_request(&mut self, request: ReplanRequest) -> bool {
        // Replies to withdrawn requests are not read, and must not take the capacity of the reply to this
        // one.
        while self.replies.pop().is_ok() {}
        self.requests.push(request).is_ok()
    }

    /// The reply to request `id`, if it has arrived; older ones are dropped.
    pub fn reply(&mut self, id: u64) -> Option<ReplanReply> {
        while let Ok(reply) = self.replies.peek().copied() {
            if reply.id == id {
                return Some(reply);
            }
            let _old = self.replies.pop();
        }
        None
    }

    /// Declares that no reply to request `id` or to an earlier one will be taken over.
    pub fn withdraw_request(&self, id: u64) {
        self.table.withdrawn.store(id, Ordering::Release);
    }

    /// Declares that the reply to request `id` has been taken over.
    pub fn acknowledge_replan(&mut self, id: u64) {
        self.table.acknowledged.store(id, Ordering::Release);
    }

    /// Removes everything before these indices. `interval` is the grid interval reached.
    pub fn take(&mut self, step: u64, segment: u64, mark: u64, interval: u64) {
        self.taken_steps += take(&mut self.steps, step.saturating_sub(self.taken_steps));
        self.taken_segments += take(&mut self.segments, segment.saturating_sub(self.taken_segments));
        self.taken_marks += take(&mut self.marks, mark.saturating_sub(self.taken_marks));
        self.table.reached.store(interval, Ordering::Release);
        self.table.reached_step.store(step, Ordering::Release);
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
mod tests;
