//! The wait-free queue from the planner to the cycle.
//!
//! Segments and steps go through rings; exit speeds through a table of atomics beside them, because the
//! look-ahead raises the exit speed of steps that are already queued. Speeds are raised from the last step
//! backwards, so whatever the cycle reads, at whatever moment, can be brought to rest on the path.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use evolvent_plan::{ExitSpeeds, PENDING_SEGMENTS, PENDING_STEPS, PlanSink, Segment, Step};
use rtrb::{Consumer, Producer, RingBuffer};

/// Steps that are final and waiting, beyond what the look-ahead needs for itself.
const READY_STEPS: usize = 4096;
/// The same for segments: enough for [`STEPS_AHEAD`] runs of the most segments.
const READY_SEGMENTS: usize = 12_288;
/// The virtual clock, and every start from rest, waits until this many steps are final (or the plan is
/// complete), so that a cycle never enters a step that could still change.
pub const STEPS_AHEAD: u64 = 64;

#[derive(Debug)]
struct Table {
    exits: Box<[[AtomicU64; 2]]>,
    finalised: AtomicU64,
    complete: AtomicU64,
}

impl Table {
    fn slot(&self, index: u64) -> &[AtomicU64; 2] {
        &self.exits[(index % self.exits.len() as u64) as usize]
    }
}

/// Makes a queue. `wait` is called while the queue is full; it returns `false` to give up.
#[must_use]
pub fn plan_queue<W: FnMut() -> bool>(wait: W) -> (PlanProducer<W>, PlanConsumer) {
    let steps = PENDING_STEPS + READY_STEPS;
    let (step_producer, step_consumer) = RingBuffer::new(steps);
    let (segment_producer, segment_consumer) = RingBuffer::new(PENDING_SEGMENTS + READY_SEGMENTS);
    let table = Arc::new(Table {
        exits: (0..steps)
            .map(|_| [AtomicU64::new(0), AtomicU64::new(0)])
            .collect(),
        finalised: AtomicU64::new(0),
        complete: AtomicU64::new(0),
    });
    let producer = PlanProducer {
        steps: step_producer,
        segments: segment_producer,
        table: Arc::clone(&table),
        appended: 0,
        wait,
    };
    let consumer = PlanConsumer {
        steps: step_consumer,
        segments: segment_consumer,
        table,
        taken: 0,
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
    table: Arc<Table>,
    appended: u64,
    wait: W,
}

impl<W: FnMut() -> bool> PlanSink for PlanProducer<W> {
    type Error = QueueClosed;

    fn segment(&mut self, segment: &Segment) -> Result<(), QueueClosed> {
        while self.segments.is_full() {
            if self.segments.is_abandoned() || !(self.wait)() {
                return Err(QueueClosed);
            }
        }
        self.segments.push(*segment).map_err(|_| QueueClosed)
    }

    fn step(&mut self, step: &Step) -> Result<(), QueueClosed> {
        while self.steps.is_full() {
            if self.steps.is_abandoned() || !(self.wait)() {
                return Err(QueueClosed);
            }
        }
        for speed in self.table.slot(self.appended) {
            speed.store(0, Ordering::Release);
        }
        if matches!(step, Step::End { .. }) {
            self.table.complete.store(self.appended + 1, Ordering::Release);
        }
        self.appended += 1;
        self.steps.push(*step).map_err(|_| QueueClosed)
    }

    fn exit(&mut self, index: u64, speeds: ExitSpeeds) {
        let [nominal, doubled] = self.table.slot(index);
        nominal.store(speeds.nominal.to_bits(), Ordering::Release);
        doubled.store(speeds.doubled.to_bits(), Ordering::Release);
    }

    fn finalise(&mut self, count: u64) {
        self.table.finalised.store(count, Ordering::Release);
    }
}

/// The cycle's end. Nothing here allocates, locks or waits.
#[derive(Debug)]
pub struct PlanConsumer {
    steps: Consumer<Step>,
    segments: Consumer<Segment>,
    table: Arc<Table>,
    taken: u64,
}

impl PlanConsumer {
    /// The `ahead`-th step not yet taken.
    pub fn step(&mut self, ahead: usize) -> Option<Step> {
        nth(&mut self.steps, ahead)
    }

    /// The `ahead`-th segment not yet taken.
    pub fn segment(&mut self, ahead: usize) -> Option<Segment> {
        nth(&mut self.segments, ahead)
    }

    /// Exit speeds of the `ahead`-th step not yet taken.
    #[must_use]
    pub fn exit(&self, ahead: usize) -> ExitSpeeds {
        let [nominal, doubled] = self.table.slot(self.taken + ahead as u64);
        ExitSpeeds {
            nominal: f64::from_bits(nominal.load(Ordering::Acquire)),
            doubled: f64::from_bits(doubled.load(Ordering::Acquire)),
        }
    }

    /// Whether the exit speed of the `ahead`-th step not yet taken is final.
    #[must_use]
    pub fn is_final(&self, ahead: usize) -> bool {
        self.table.finalised.load(Ordering::Acquire) > self.taken + ahead as u64
    }

    /// Whether a cycle can go on without meeting a step that could still change: the next
    /// [`STEPS_AHEAD`] steps are final, or the plan is complete.
    #[must_use]
    pub fn is_ready(&self) -> bool {
        let finalised = self.table.finalised.load(Ordering::Acquire);
        let complete = self.table.complete.load(Ordering::Acquire);
        finalised >= self.taken + STEPS_AHEAD || (complete > 0 && finalised >= complete)
    }

    /// Whether the planner has gone without completing the plan.
    #[must_use]
    pub fn is_abandoned(&self) -> bool {
        self.steps.is_abandoned() && self.table.complete.load(Ordering::Acquire) == 0
    }

    /// Takes steps and segments for good.
    pub fn take(&mut self, steps: usize, segments: usize) {
        self.taken += steps as u64;
        if let Ok(chunk) = self.steps.read_chunk(steps) {
            chunk.commit_all();
        }
        if let Ok(chunk) = self.segments.read_chunk(segments) {
            chunk.commit_all();
        }
    }
}

fn nth<T: Copy>(consumer: &mut Consumer<T>, ahead: usize) -> Option<T> {
    let chunk = consumer.read_chunk(ahead + 1).ok()?;
    let (first, second) = chunk.as_slices();
    first
        .get(ahead)
        .or_else(|| second.get(ahead - first.len()))
        .copied()
}
