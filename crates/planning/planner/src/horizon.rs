//! The receding horizon: path in, windows of near-optimal plan out.
//!
//! The known path is planned in windows. Of each window the first part is committed, the rest is a tail that comes
//! to rest on known path; the next window starts where the last commitment ends and replaces the tail. Where the
//! path itself comes to rest, a window ends there and all of it is committed. Windows are cut by what is on the
//! path, never by time, so the same program gives the same plan.
//!
//! The cycle may request another plan from a position ahead of it: for another override, or because it has had to drive a
//! tail. Holds need none. Everything after that position is planned again; what had been planned is dropped.

use std::collections::VecDeque;

use evolvent_machine::Limits;
use evolvent_path::AXES;
use evolvent_timing::{
    Entry, Exit, FeedError, Grid, MAX_INTERVALS, Memory, Optimizer, PathLimits, Piece, Place,
};

use crate::step::{BlockMark, PlanSink, Request, Segment, Step, TimedSegment};
use crate::validate::{ratios, slow_down};

/// Intervals of path and stops that wait for a plan while none is made (during a hold) before no more is read.
const MAX_BACKLOG: u64 = 1 << 16;
/// Share of a window's intervals that is committed at least, and at most.
const COMMITTED: (f64, f64) = (0.5, 0.9);
/// Windows from rest in a row that may fail.
const MAX_FAILURES: u32 = 3;
/// Intervals that a window is not made shorter than for want of stations.
const MIN_WINDOW: u64 = 32;
/// Steps that windows leave free for the answers to two requests: the cycle may be waiting for one, and then nothing
/// else makes room.
const KEPT_FOR_ANSWERS: usize = 2 * (2 * MAX_INTERVALS + 3);
/// Marks of one segment at the most. A segment has four intervals at the least, so a window has 80 of them.
const MAX_MARKS: usize = 1024;
/// The tail takes at least so many times as long as stopping does.
const TAIL_STOPS: f64 = 2.0;

/// A place where the path comes to rest.
#[derive(Clone, Copy, Debug)]
struct Rest {
    /// Grid interval that starts there.
    at: u64,
    /// What happens there, if anything.
    step: Option<Step>,
    /// How many steps at rest the cycle has passed before this one.
    index: u64,
}

/// A window that was handed on, for plans from a place in it.
#[derive(Clone, Debug, Default)]
struct Planned {
    interval: u64,
    x: f64,
    memory: Memory,
}

/// How far the plan has come.
#[derive(Clone, Copy, Debug)]
struct PlanFrontier {
    place: Place,
    entry: Entry,
    /// The committed step that the next window is to follow, where a tail follows it now.
    link: Option<u64>,
    /// Index in `rests` of the next one.
    rest: usize,
    feed_factor: f64,
    /// The cycle has been brought to rest, or has left the plan: nothing is planned until it asks.
    waits: bool,
}

/// The plan that a request in motion has cut short, until it is known whether the cycle has taken over the answer.
#[derive(Clone, Copy, Debug)]
struct PendingBranch {
    id: u64,
    /// Where the old plan had come to.
    front: PlanFrontier,
    /// Windows of the new one.
    windows: usize,
}

/// Windows that were handed on.
#[derive(Debug, Default)]
struct PlannedWindows {
    /// Those that the cycle has not left, and the space of those that it has.
    planned: VecDeque<Planned>,
    spare: Vec<Planned>,
    /// A plan that may have been cut short, and its windows after the cut.
    fork: Option<PendingBranch>,
    cut: VecDeque<Planned>,
}

/// The path that the cycle has not left.
#[derive(Debug, Default)]
struct PathStore {
    /// Segments from number `first` on, with the path parameter at their start.
    segments: VecDeque<(f64, Segment)>,
    first: u64,
    /// How many the cycle has been handed.
    handed: u64,
    length: f64,
    marks: VecDeque<BlockMark>,
}

/// Plans the path of one program.
#[derive(Debug)]
pub(crate) struct Horizon<S> {
    sink: S,
    grid: Grid,
    optimizer: Optimizer,
    limits: Limits,
    front: PlanFrontier,
    /// What the cycle has asked for and not been answered.
    request: Option<Request>,
    windows: PlannedWindows,
    rests: VecDeque<Rest>,
    rests_seen: u64,
    path: PathStore,
    /// Marks of blocks whose planned time is still growing.
    accounts: VecDeque<BlockMark>,
    accounted: f64,
    appended: u64,
    /// Windows from rest in a row that could not be planned.
    failures: u32,
    pieces: Vec<Piece>,
    /// Time that stopping takes per speed, and at the least, s.
    stopping: (f64, f64),
}

impl<S: PlanSink> Horizon<S> {
    pub(crate) fn new(limits: &PathLimits, feed_factor: f64, sink: S) -> Self {
        let axes = limits.axes();
        let least = |values: &evolvent_path::Axes| {
            (0..AXES)
                .filter(|&i| axes.present[i])
                .map(|i| values[i])
                .fold(f64::INFINITY, f64::min)
        };
        let (a, j) = (least(&axes.acceleration), least(&axes.jerk));
        Self {
            sink,
            grid: Grid::new(limits),
            optimizer: Optimizer::new(limits),
            limits: *axes,
            front: PlanFrontier {
                place: Place { interval: 0, x: 0.0 },
                entry: Entry::Rest,
                link: None,
                rest: 0,
                feed_factor,
                waits: false,
            },
            request: None,
            windows: PlannedWindows::default(),
            rests: VecDeque::new(),
            rests_seen: 0,
            failures: 0,
            path: PathStore::default(),
            accounts: VecDeque::new(),
            accounted: 0.0,
            appended: 0,
            pieces: Vec::with_capacity(2 * MAX_INTERVALS),
            stopping: (1.0 / a, a / j),
        }
    }

    pub(crate) fn sink(&self) -> &S {
        &self.sink
    }

    pub(crate) fn sink_mut(&mut self) -> &mut S {
        &mut self.sink
    }

    /// Appends a stretch of path; `feed` in the feed metric, infinite for rapids.
    pub(crate) fn segment(&mut self, segment: Segment, feed: f64) {
        self.thin_marks();
        self.grid.push(&segment.curve, segment.from, segment.length, feed);
        self.path.segments.push_back((self.path.length, segment));
        self.path.length += segment.length;
    }

    /// Bounds the speed at the present end; 0 is a stop.
    pub(crate) fn cap(&mut self, speed: f64) {
        if speed > 0.0 {
            self.grid.cap(speed);
        } else {
            self.stop_at_end(None);
        }
    }

    /// Leaves out marks of the next segment where it has so many blocks that a window's might not fit into any queue.
    fn thin_marks(&mut self) {
        let first = self
            .path
            .marks
            .partition_point(|mark| mark.start < self.path.length);
        let every = (self.path.marks.len() - first).div_ceil(MAX_MARKS);
        if every > 1 {
            let kept = (first..self.path.marks.len()).step_by(every);
            let count = first + kept.len();
            for (to, from) in (first..).zip(kept) {
                self.path.marks[to] = self.path.marks[from];
            }
            self.path.marks.truncate(count);
        }
    }

    pub(crate) fn mark(&mut self, mark: BlockMark) {
        self.path.marks.push_back(mark);
        self.accounts.push_back(mark);
    }

    /// Appends a step at rest.
    pub(crate) fn rest(&mut self, step: Step) {
        self.stop_at_end(Some(step));
    }

    fn stop_at_end(&mut self, step: Option<Step>) {
        self.rests.push_back(Rest {
            at: self.grid.end(),
            step,
            index: self.rests_seen,
        });
        self.rests_seen += u64::from(step.is_some());
    }

    /// Plans what can be planned of the path that is known.
    ///
    /// # Errors
    /// As the sink's.
    pub(crate) fn advance(&mut self) -> Result<(), S::Error> {
        self.forget();
        loop {
            if self.has_failed() {
                return Ok(());
            }
            self.serve()?;
            if self.front.waits {
                let stops = (self.rests.len() - self.front.rest) as u64;
                if self.grid.end() - self.front.place.interval + stops < MAX_BACKLOG {
                    return Ok(());
                }
                self.sink.wait()?;
                continue;
            }
            if !self.pass_rests()? {
                continue;
            }
            let Some((until, exit)) = self.window(&self.front) else {
                return Ok(());
            };
            let front = self.front;
            let Ok((until, exit)) = self.solve_some(&front, until, exit) else {
                // The tail in force ends at rest; from there the cycle asks again.
                self.give_up()?;
                continue;
            };
            if self.make_room()? {
                continue;
            }
            self.commit(until, exit)?;
            self.pieces.clear();
        }
    }

    /// Whether no motion is found from rest: the machine stands, and nothing more can be planned.
    fn has_failed(&self) -> bool {
        self.failures > MAX_FAILURES
    }

    /// The line where that is, if so; 0 where it is not known.
    pub(crate) fn failed_at(&self) -> Option<u32> {
        self.has_failed().then(|| {
            let stretch = self.grid.stretch_of(self.front.place.interval);
            stretch
                .and_then(|(stretch, _)| {
                    self.path
                        .segments
                        .get(stretch.checked_sub(self.path.first)? as usize)
                })
                .map_or(0, |(_, segment)| segment.line)
        })
    }

    /// Serves requests until the consumer has gone, or nothing can be planned any more.
    ///
    /// # Errors
    /// As the sink's: the consumer has gone.
    pub(crate) fn attend(&mut self) -> Result<(), S::Error> {
        loop {
            self.advance()?;
            if self.has_failed() {
                return Ok(());
            }
            self.sink.wait()?;
        }
    }

    /// Hands on the steps at the place of rest where the plan stands. `false` if a request has come in between.
    fn pass_rests(&mut self) -> Result<bool, S::Error> {
        while let Some(&rest) = self.rests.get(self.front.rest) {
            if rest.at > self.front.place.interval || !matches!(self.front.entry, Entry::Rest) {
                break;
            }
            if let Some(step) = rest.step {
                if self.make_room()? {
                    return Ok(false);
                }
                self.sink.step(&step)?;
                self.appended += 1;
                self.sink.finalise(self.appended);
            }
            self.front.rest += 1;
        }
        Ok(true)
    }

    /// The next window's end, once enough path is known.
    fn window(&self, front: &PlanFrontier) -> Option<(u64, Exit)> {
        let start = front.place.interval;
        let rest = self.rests.get(front.rest).map(|rest| rest.at);
        let known = rest.unwrap_or_else(|| self.grid.end());
        let most = start + MAX_INTERVALS as u64;
        // At the end of what is known the path may yet turn out to rest.
        if known <= start || (rest.is_none() && known <= most) {
            return None;
        }
        if rest.is_some() && known <= most {
            return Some((known, Exit::Rest));
        }
        Some((most, Exit::Open))
    }

    fn solve(&mut self, front: &PlanFrontier, until: u64, exit: Exit) -> Result<(), FeedError> {
        self.pieces.clear();
        self.sink.solving();
        let solved = self.optimizer.plan(
            &self.grid,
            front.place,
            front.entry,
            until,
            exit,
            front.feed_factor,
            &mut self.pieces,
        );
        let proved = solved.and_then(|_| self.prove(front));
        self.sink.solved(self.optimizer.iterations());
        proved
    }

    /// Looks at what was solved once more. A plan from rest that exceeds a limit is slowed down; one in motion is
    /// not driven.
    fn prove(&mut self, front: &PlanFrontier) -> Result<(), FeedError> {
        let (v, a) = match front.entry {
            Entry::Rest => (0.0, 0.0),
            Entry::Moving { v, a } => (v, a),
        };
        for _ in 0..2 {
            let segment = |stretch: u64| {
                let index = stretch.checked_sub(self.path.first)? as usize;
                self.path.segments.get(index).map(|(_, segment)| segment)
            };
            let found = ratios(&self.pieces, (v, a), &self.limits, segment);
            if found.hold() {
                return Ok(());
            }
            let remedy = found.remedy();
            if !matches!(front.entry, Entry::Rest) || remedy <= 0.0 {
                break;
            }
            slow_down(&mut self.pieces, remedy);
            // The next window starts from a state of what is driven.
            self.optimizer.slow_down(remedy);
        }
        self.pieces.clear();
        Err(FeedError::NoMotion {
            interval: front.place.interval,
            x: front.place.x,
            v,
            a,
        })
    }

    /// Solves a window, or a shorter one where that needs more stations than there is room for.
    fn solve_some(&mut self, front: &PlanFrontier, until: u64, exit: Exit) -> Result<(u64, Exit), FeedError> {
        let (mut until, mut exit) = (until, exit);
        loop {
            match self.solve(front, until, exit) {
                Ok(()) => return Ok((until, exit)),
                Err(error)
                    if until - front.place.interval > MIN_WINDOW
                        && (matches!(error, FeedError::Window { .. })
                            || matches!(front.entry, Entry::Rest)) =>
                {
                    until = front.place.interval + (until - front.place.interval) / 2;
                    exit = Exit::Open;
                }
                Err(error) => return Err(error),
            }
        }
    }

    /// Waits until everything solved can be appended at once. `true` if a request was answered meanwhile, so that
    /// what was solved is gone.
    fn make_room(&mut self) -> Result<bool, S::Error> {
        loop {
            if self.serve()? {
                return Ok(true);
            }
            let steps = self.pieces.len() + 2 + KEPT_FOR_ANSWERS;
            if self
                .sink
                .has_room(steps, self.segments_needed(), self.marks_needed())
            {
                return Ok(false);
            }
            self.sink.wait()?;
        }
    }

    fn segments_needed(&self) -> usize {
        self.pieces.last().map_or(0, |piece| {
            (piece.stretch + 1).saturating_sub(self.path.handed) as usize
        })
    }

    fn marks_needed(&self) -> usize {
        self.pieces.last().map_or(0, |piece| {
            let end = self.path_at(piece) + piece.length;
            self.path.marks.partition_point(|mark| mark.start <= end)
        })
    }

    /// Path parameter at a piece's start.
    fn path_at(&self, piece: &Piece) -> f64 {
        self.path.segments[(piece.stretch - self.path.first) as usize].0 + piece.from
    }

    /// Hands on the window that was solved: the first part final, the rest as a tail.
    fn commit(&mut self, until: u64, exit: Exit) -> Result<(), S::Error> {
        self.failures = 0;
        self.remember();
        let first = self.appended;
        let committed = match exit {
            Exit::Rest => self.pieces.len(),
            Exit::Open => self.committed_pieces(),
        };
        self.append_pieces()?;
        let feed_factor = self.front.feed_factor;
        let next = match self.pieces.get(committed) {
            Some(piece) => {
                self.sink.step(&Step::Wait)?;
                self.appended += 1;
                let (state, _) = piece.law.at(0.0);
                PlanFrontier {
                    place: Place {
                        interval: piece.interval,
                        x: piece.from - self.interval_start(piece.interval),
                    },
                    entry: Entry::Moving {
                        v: state.v,
                        a: state.a,
                    },
                    link: Some(first + committed as u64 - 1),
                    ..self.front
                }
            }
            None => PlanFrontier {
                place: Place {
                    interval: until,
                    x: 0.0,
                },
                entry: Entry::Rest,
                link: None,
                ..self.front
            },
        };
        let follows = match self.front.link {
            Some(link) => self.sink.link(link, first),
            None => true,
        };
        if !follows {
            // The cycle drives the tail already, and will ask: for plans from there this window is none.
            self.windows.spare.extend(self.windows.planned.pop_back());
            if let Some(fork) = &mut self.windows.fork {
                fork.windows = fork.windows.saturating_sub(1);
            }
            if let Some(planned) = self.windows.planned.back() {
                self.optimizer.recall(&planned.memory);
            }
            return self.give_up();
        }
        self.account(committed);
        self.sink.finalise(first + committed as u64);
        self.front = PlanFrontier { feed_factor, ..next };
        Ok(())
    }

    /// Sets the window that was solved aside.
    fn remember(&mut self) {
        let mut planned = self.windows.spare.pop().unwrap_or_default();
        (planned.interval, planned.x) = (self.front.place.interval, self.front.place.x);
        self.optimizer.remember(&mut planned.memory);
        self.windows.planned.push_back(planned);
        if let Some(fork) = &mut self.windows.fork {
            fork.windows += 1;
        }
    }

    /// How many windows handed on start at or before a place.
    fn planned_until(&self, place: Place) -> usize {
        self.windows
            .planned
            .partition_point(|one| (one.interval, one.x) <= (place.interval, place.x))
    }

    /// Hands on all pieces, and the segments and marks that they need.
    fn append_pieces(&mut self) -> Result<(), S::Error> {
        for piece in &self.pieces {
            while self.path.handed <= piece.stretch {
                let index = (self.path.handed - self.path.first) as usize;
                let Some((_, segment)) = self.path.segments.get(index) else {
                    break;
                };
                self.sink.segment(segment)?;
                self.path.handed += 1;
            }
            let path = self.path_at(piece);
            while let Some(mark) = self.path.marks.front() {
                if mark.start > path + piece.length {
                    break;
                }
                self.sink.mark(mark)?;
                self.path.marks.pop_front();
            }
            self.sink
                .step(&Step::TimedSegment(TimedSegment { piece: *piece, path }))?;
            self.appended += 1;
        }
        Ok(())
    }

    /// How many pieces to commit: as many as leave a tail long enough that its end cannot be felt.
    fn committed_pieces(&self) -> usize {
        let intervals = |k: usize| self.pieces[k].interval - self.pieces[0].interval;
        let last = self.pieces.len().saturating_sub(1);
        let whole = intervals(last) as f64;
        let (least, most) = (COMMITTED.0 * whole, COMMITTED.1 * whole);
        let mut tail = 0.0;
        let mut k = last;
        while k > 1 {
            let piece = &self.pieces[k];
            tail += piece.duration;
            let speed = piece.law.at(0.0).0.v;
            let stopping = speed * self.stopping.0 + self.stopping.1;
            let starts_interval = piece.interval != self.pieces[k - 1].interval;
            let share = intervals(k) as f64;
            if starts_interval && share <= most && (tail >= TAIL_STOPS * stopping || share <= least) {
                break;
            }
            k -= 1;
        }
        k.max(1)
    }

    /// Adds the planned time of the first `count` pieces to their blocks.
    fn account(&mut self, count: usize) {
        for piece in &self.pieces[..count] {
            let start = self.path_at(piece);
            let middle = start + 0.5 * piece.length;
            if middle < self.accounted {
                continue;
            }
            self.accounted = start + piece.length;
            while self.accounts.len() > 1 && self.accounts[1].start <= middle {
                self.accounts.pop_front();
            }
            if let Some(mark) = self.accounts.front() {
                self.sink.planned_block(mark.block, piece.duration);
            }
        }
    }

    /// No plan was found, or it came too late: the cycle comes to rest at the end of the tail and asks from there.
    fn give_up(&mut self) -> Result<(), S::Error> {
        if self.front.link.is_none() {
            // At rest, with nothing to follow: let it stand and ask.
            self.append_wait()?;
            self.failures += 1;
        }
        self.sink.finalise(self.appended);
        self.front.waits = true;
        Ok(())
    }

    fn append_wait(&mut self) -> Result<(), S::Error> {
        self.sink.step(&Step::Wait)?;
        self.appended += 1;
        self.sink.finalise(self.appended);
        Ok(())
    }

    /// Offset of an interval from the start of its stretch.
    fn interval_start(&self, interval: u64) -> f64 {
        self.grid.stretch_of(interval).map_or(0.0, |stretch| stretch.1)
    }

    /// Forgets what the consumer has passed.
    fn forget(&mut self) {
        let reached = self.sink.reached();
        self.grid.release(reached);
        if self.windows.fork.is_some_and(|fork| self.sink.taken() >= fork.id) {
            self.settle();
        }
        while self.windows.fork.is_none()
            && self.windows.planned.len() > 1
            && self.windows.planned[1].interval < reached
        {
            self.windows.spare.extend(self.windows.planned.pop_front());
        }
        while self.front.rest > 0 && self.rests.front().is_some_and(|rest| rest.at < reached) {
            self.rests.pop_front();
            self.front.rest -= 1;
            if let Some(fork) = &mut self.windows.fork {
                fork.front.rest = fork.front.rest.saturating_sub(1);
            }
        }
        if let Some((stretch, _)) = self.grid.stretch_of(reached) {
            while self.path.first < stretch && self.path.first < self.path.handed {
                self.path.segments.pop_front();
                self.path.first += 1;
            }
        }
    }
}

mod requests;
#[cfg(test)]
mod tests;
