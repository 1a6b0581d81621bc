//! The wait-free queue from the planner to the cycle, and the cycle's requests back.
//!
//! Segments, marks and steps go through rings; what changes of steps that are already queued stands in a
//! table of atomics beside them.
//!
//! A classic plan raises the exit speed of queued runs, from the last run backwards, so whatever the cycle
//! reads, at whatever moment, can be brought to rest on the path.
//!
//! A near-optimal plan is a chain of pieces of a time law. After the committed pieces lies a *tail* that ends
//! at rest; the last committed step is *open*. When more has been planned, it is appended after the tail, and
//! the open step is *linked* to it: the tail is skipped. A cycle that comes to the end of what is committed
//! before that claims the link, drives the tail, and the planner's late link fails. Overrides come as a
//! [`Request`] for a new plan from a place a few cycles ahead; the [`Reply`] names the step to go on with
//! there. A cycle that cannot take a reply over says that it has withdrawn the request: then the planner
//! drops that plan and goes on with the one that is driven.

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
    /// Successor + 1 where it is not simply the next step; 0 where it is; [`OPEN`] or [`CLAIMED`] before a
    /// tail; [`PLACE`], or the successor + 1 with [`TAKEN`], of a step that keeps a place.
    links: Box<[AtomicU64]>,
    committed: AtomicU64,
    complete: AtomicU64,
    /// The last wait for an input, probing move or thread + 1: nothing comes after it before it is over.
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
        looks: Looks::default(),
        settled_up_to: 0,
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
    requests: Producer<Request>,
    replies: Consumer<Reply>,
    pub(crate) processes: TakeoverReceiver<dyn ProcessCycle>,
    pub(crate) probings: TakeoverReceiver<Probing>,
    pub(crate) threadings: TakeoverReceiver<Threading>,
    table: Arc<Table>,
    taken_steps: u64,
    taken_segments: u64,
    taken_marks: u64,
    looks: Looks,
    /// The step after the last end that was found continued: who looks at it again finds the same.
    settled_up_to: u64,
}

/// What a cycle has looked for in the plan. In real time it may come too early for something; when it is
/// computed again it meets the same.
#[derive(Debug, Default)]
struct Looks {
    /// Looks that found what they looked for. More than a cycle ever makes are not told apart.
    found: u8,
    /// Number of the look that found nothing: nothing is found after it.
    failed: Option<u8>,
    /// The same in the cycle that is computed again.
    recorded: Option<u8>,
}

impl PlanConsumer {
    /// Begins a cycle in which the look of number `failed_look` fails, as it did when the cycle was recorded.
    pub(crate) fn begin_cycle(&mut self, failed_look: Option<u8>) {
        self.looks = Looks {
            recorded: failed_look,
            ..Looks::default()
        };
    }

    /// Number of the look in this cycle that found nothing.
    pub(crate) fn failed_look(&self) -> Option<u8> {
        self.looks.failed
    }

    /// Counts a look at something that is there or not; whether the cycle finds it.
    pub(crate) fn look(&mut self, is_there: bool) -> bool {
        if self.fails_again() || !is_there {
            self.looks.failed.get_or_insert(self.looks.found);
            return false;
        }
        self.looks.found = self.looks.found.saturating_add(1);
        true
    }

    /// Whether the next look fails whatever is there.
    fn fails_again(&self) -> bool {
        let looks = &self.looks;
        looks.failed.is_some() || looks.recorded.is_some_and(|number| looks.found >= number)
    }

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

    /// The step that is executed at the position of step `index`: itself, the step linked to it if it keeps a
    /// place, or none until one is linked.
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

    /// The step after step `index`, settled, and whether the planner had not come so far: then that step is a
    /// tail, or it has to be waited for. `rests`: the axes rest between them.
    pub(crate) fn settle_successor(&mut self, index: u64, rests: bool) -> (u64, bool) {
        let is_left_open = self.table.link(index).load(Ordering::Acquire) != 0;
        let is_end = (is_left_open || rests) && index >= self.settled_up_to;
        if is_end && self.fails_again() {
            if is_left_open {
                self.table.link(index).store(CLAIMED, Ordering::Release);
            }
            self.look(false);
            return (index + 1, true);
        }
        let (next, is_final) = self.claim_successor(index);
        let occupant = self.occupant(next).filter(|_| is_final);
        if !is_end && occupant.is_some() {
            return (next, false);
        }
        if self.look(occupant.is_some()) {
            self.settled_up_to = index + 1;
        }
        (occupant.unwrap_or(next), occupant.is_none())
    }

    /// Whether the runs ahead of step `index` cannot change any more: the next [`STEPS_AHEAD`] steps are
    /// final, or all up to a wait for an input, or the plan is complete.
    #[must_use]
    pub fn has_final_ahead(&self, index: u64) -> bool {
        self.has_final(index, STEPS_AHEAD)
    }

    /// The same of the next `count` steps.
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

    /// Whether the planner has gone without completing the plan.
    #[must_use]
    pub fn is_abandoned(&self) -> bool {
        self.has_no_planner() && self.table.complete.load(Ordering::Acquire) == 0
    }

    /// Whether requests receive no replies any more.
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
