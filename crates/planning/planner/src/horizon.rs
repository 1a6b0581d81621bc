//! The receding horizon: path in, windows of a time-optimal plan out.
//!
//! The known path is planned in windows. The first part of each window is committed, the rest is a tail that
//! stops on known path; the next window starts at the end of the commitment and replaces the tail. Where the
//! path itself stops, a window ends and all of it is committed. Windows are divided by the content of the
//! path, never by time, so the same program gives the same plan.
//!
//! The cycle may request another plan from a position ahead of it: for another override, or after it has
//! executed a tail. Holds need none. Everything after that position is replanned; the previous plan is
//! dropped.

use std::collections::VecDeque;

use evolvent_machine::Limits;
use evolvent_path::{AXES, Feed};
use evolvent_timing::{
    Entry, Exit, FeedError, Grid, MAX_INTERVALS, Optimizer, PathLimits, PathPosition, PlanSnapshot,
    TimeLawPiece,
};

use crate::step::{BlockMark, PlanSink, ReplanRequest, Segment, Step, TimedSegment};
use crate::validate::{ratios, slow_down};

/// Maximum number of intervals of path and stops that wait for a plan (during a hold) before reading pauses.
const MAX_BACKLOG: u64 = 1 << 16;
/// Minimum and maximum fraction of a window's intervals that is committed.
const COMMITTED_FRACTION: (f64, f64) = (0.5, 0.9);
/// Maximum number of consecutive failures of windows from rest.
const MAX_FAILURES: u32 = 3;
/// Minimum number of intervals to which a window is shortened for lack of stations.
const MIN_WINDOW: u64 = 32;
/// Maximum number of steps of a window.
const WINDOW_STEPS: usize = 2 * MAX_INTERVALS + 3;
/// Steps reserved for windows that the cycle will need soon. Steps of plans that nobody executes stay in the
/// queue until the cycle has passed them, and it may be waiting for such a window.
const RESERVED_STEPS: usize = 4 * WINDOW_STEPS;
/// Steps that other windows leave free, enough also for the replies to two requests: the cycle may be waiting
/// for one, and then nothing else frees capacity.
const LEFT_STEPS: usize = RESERVED_STEPS + 2 * WINDOW_STEPS;
/// Maximum distance of the cycle from the end of the committed plan, in intervals, at which it needs the next
/// window soon.
const SOON: u64 = 4 * MAX_INTERVALS as u64;
/// Maximum number of marks of one segment. A segment has at least four intervals, so a window has at most 80
/// segments.
const MAX_MARKS: usize = 1024;
/// Minimum duration of the tail, as a multiple of the stopping time.
const MIN_TAIL_STOPS: f64 = 2.0;

/// A position at which the path stops.
#[derive(Clone, Copy, Debug)]
struct RestPoint {
    /// The grid interval that starts there.
    at: u64,
    /// The step at rest there, if any.
    step: Option<Step>,
    /// Number of steps at rest that the cycle has passed before this one.
    index: u64,
}

/// A window that was handed over, for plans that start from a position in it.
#[derive(Clone, Debug, Default)]
struct PlannedWindow {
    first_step: u64,
    snapshot: PlanSnapshot,
}

/// The end of the committed plan.
#[derive(Clone, Copy, Debug)]
struct PlanFrontier {
    position: PathPosition,
    entry: Entry,
    /// The step to which the next one is linked: the last committed one if a tail follows it now, or the Wait
    /// that reserves the link after a stop.
    link: Option<u64>,
    /// Index in `rests` of the next stop.
    rest: usize,
    feed_factor: f64,
    /// The cycle has been stopped or has left the plan: nothing is planned until it sends a request.
    is_waiting: bool,
}

/// The plan that a request in motion has cut off, kept until it is known whether the cycle has taken over the
/// reply.
#[derive(Clone, Copy, Debug)]
struct PendingBranch {
    id: u64,
    /// The frontier of the old plan.
    frontier: PlanFrontier,
    /// Number of windows of the new plan.
    windows: usize,
}

/// Windows that were handed over.
#[derive(Debug, Default)]
struct PlannedWindows {
    /// Those that the cycle has not left, and the memory of those that it has.
    planned: VecDeque<PlannedWindow>,
    spare: Vec<PlannedWindow>,
    /// A plan that may have been cut off, and its windows after the cut.
    pending_branch: Option<PendingBranch>,
    cut: VecDeque<PlannedWindow>,
}

/// The path that the cycle has not left.
#[derive(Debug, Default)]
struct PathStore {
    /// Segments from number `first` on, with the path parameter at their start.
    segments: VecDeque<(f64, Segment)>,
    first: u64,
    /// Number of segments handed to the cycle.
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
    frontier: PlanFrontier,
    /// The request of the cycle that has no reply yet.
    request: Option<ReplanRequest>,
    windows: PlannedWindows,
    rests: VecDeque<RestPoint>,
    rests_seen: u64,
    path: PathStore,
    /// Marks of blocks whose planned time is still growing.
    accounts: VecDeque<BlockMark>,
    accounted: f64,
    appended: u64,
    /// Consecutive failures of windows from rest.
    failures: u32,
    pieces: Vec<TimeLawPiece>,
    /// Stopping time per speed, and its minimum, s.
    stopping: (f64, f64),
}

impl<S: PlanSink> Horizon<S> {
    pub(crate) fn new(limits: &PathLimits, feed_factor: f64, sink: S) -> Self {
        let axes = limits.axes();
        let min = |values: &evolvent_path::Axes| {
            (0..AXES)
                .filter(|&i| axes.present[i])
                .map(|i| values[i])
                .fold(f64::INFINITY, f64::min)
        };
        let (a, j) = (min(&axes.acceleration), min(&axes.jerk));
        Self {
            sink,
            grid: Grid::new(limits),
            optimizer: Optimizer::new(limits),
            limits: *axes,
            frontier: PlanFrontier {
                position: PathPosition { interval: 0, x: 0.0 },
                entry: Entry::Rest,
                link: None,
                rest: 0,
                feed_factor,
                is_waiting: false,
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

    /// Appends a path segment and its feed.
    pub(crate) fn segment(&mut self, segment: Segment, feed: Feed) {
        self.limit_marks();
        self.grid.push(&segment.curve, segment.from, segment.length, feed);
        self.path.segments.push_back((self.path.length, segment));
        self.path.length += segment.length;
    }

    /// Limits the speed at the present end; 0 is a stop.
    pub(crate) fn cap(&mut self, speed_u_s: f64) {
        if speed_u_s > 0.0 {
            self.grid.cap(speed_u_s);
        } else {
            self.stop_at_end(None);
        }
    }

    /// Drops marks of the next segment if it has so many blocks that the marks of a window might not fit into
    /// any queue.
    fn limit_marks(&mut self) {
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
        self.rests.push_back(RestPoint {
            at: self.grid.end(),
            step,
            index: self.rests_seen,
        });
        self.rests_seen += u64::from(step.is_some());
    }

    /// Plans as much of the known path as possible.
    ///
    /// # Errors
    /// Those of the sink.
    pub(crate) fn advance(&mut self) -> Result<(), S::Error> {
        self.forget();
        loop {
            if self.has_failed() {
                return Ok(());
            }
            self.serve()?;
            if self.frontier.is_waiting {
                let stops = (self.rests.len() - self.frontier.rest) as u64;
                if self.grid.end() - self.frontier.position.interval + stops < MAX_BACKLOG {
                    return Ok(());
                }
                self.sink.wait()?;
                continue;
            }
            if !self.pass_rests()? {
                continue;
            }
            let Some((until, exit)) = self.window(&self.frontier) else {
                return Ok(());
            };
            let frontier = self.frontier;
            let Ok((until, exit)) = self.solve_shorter(&frontier, until, exit) else {
                // The present tail ends at rest; from there the cycle sends a request again.
                self.fall_back_to_tail()?;
                continue;
            };
            if self.wait_for_capacity()? {
                continue;
            }
            self.commit(until, exit)?;
            self.pieces.clear();
        }
    }

    /// Whether no motion from rest was found, so that nothing more can be planned.
    fn has_failed(&self) -> bool {
        self.failures > MAX_FAILURES
    }

    /// The line of that failure, if there is one; 0 if unknown.
    pub(crate) fn failed_at(&self) -> Option<u32> {
        self.has_failed().then(|| {
            let segment = self.grid.segment_of(self.frontier.position.interval);
            segment
                .and_then(|(segment, _)| {
                    self.path
                        .segments
                        .get(segment.checked_sub(self.path.first)? as usize)
                })
                .map_or(0, |(_, segment)| segment.line)
        })
    }

    /// Serves requests until the consumer has gone or nothing more can be planned.
    ///
    /// # Errors
    /// Those of the sink: the consumer has gone.
    pub(crate) fn serve_until_closed(&mut self) -> Result<(), S::Error> {
        loop {
            self.advance()?;
            if self.has_failed() {
                return Ok(());
            }
            self.sink.wait()?;
        }
    }

    /// Hands over the steps at the stop at the frontier. False if a request came in between.
    fn pass_rests(&mut self) -> Result<bool, S::Error> {
        while let Some(&rest) = self.rests.get(self.frontier.rest) {
            if rest.at > self.frontier.position.interval || !matches!(self.frontier.entry, Entry::Rest) {
                break;
            }
            if let Some(step) = rest.step {
                if self.wait_for_capacity()? {
                    return Ok(false);
                }
                self.sink.step(&step)?;
                self.appended += 1;
                self.sink.commit(self.appended);
                self.link_reserved(self.appended - 1);
            }
            self.frontier.rest += 1;
        }
        Ok(true)
    }

    /// The end of the next window, once enough path is known.
    fn window(&self, frontier: &PlanFrontier) -> Option<(u64, Exit)> {
        let start = frontier.position.interval;
        let rest = self.rests.get(frontier.rest).map(|rest| rest.at);
        let known = rest.unwrap_or_else(|| self.grid.end());
        let max = start + MAX_INTERVALS as u64;
        // At the end of the known path a stop may follow.
        if known <= start || (rest.is_none() && known <= max) {
            return None;
        }
        if rest.is_some() && known <= max {
            return Some((known, Exit::Rest));
        }
        Some((max, Exit::Open))
    }

    fn solve(&mut self, frontier: &PlanFrontier, until: u64, exit: Exit) -> Result<(), FeedError> {
        self.pieces.clear();
        self.sink.solving();
        let solved = self.optimizer.plan(
            &self.grid,
            frontier.position,
            frontier.entry,
            until,
            exit,
            frontier.feed_factor,
            &mut self.pieces,
        );
        let proved = solved.and_then(|_| self.validate_window(frontier));
        self.sink.solved(self.optimizer.iterations());
        proved
    }

    /// Validates the solution independently. A plan from rest that exceeds a limit is slowed down; one from
    /// motion is rejected.
    fn validate_window(&mut self, frontier: &PlanFrontier) -> Result<(), FeedError> {
        let (v, a) = match frontier.entry {
            Entry::Rest => (0.0, 0.0),
            Entry::Moving { v, a } => (v, a),
        };
        for _ in 0..2 {
            let segment = |number: u64| {
                let index = number.checked_sub(self.path.first)? as usize;
                self.path.segments.get(index).map(|(_, segment)| segment)
            };
            let found = ratios(&self.pieces, (v, a), &self.limits, segment);
            if found.are_within_limits() {
                return Ok(());
            }
            let slowdown = found.required_slowdown();
            if !matches!(frontier.entry, Entry::Rest) || slowdown <= 0.0 {
                break;
            }
            slow_down(&mut self.pieces, slowdown);
            // The next window starts at a state of the plan that is executed.
            self.optimizer.slow_down(slowdown);
        }
        self.pieces.clear();
        Err(FeedError::NoMotion {
            interval: frontier.position.interval,
            x: frontier.position.x,
            v,
            a,
        })
    }

    /// Solves a window, or a shorter one if that needs too many stations.
    fn solve_shorter(
        &mut self,
        frontier: &PlanFrontier,
        until: u64,
        exit: Exit,
    ) -> Result<(u64, Exit), FeedError> {
        let (mut until, mut exit) = (until, exit);
        loop {
            match self.solve(frontier, until, exit) {
                Ok(()) => return Ok((until, exit)),
                Err(error)
                    if until - frontier.position.interval > MIN_WINDOW
                        && (matches!(error, FeedError::Window { .. })
                            || matches!(frontier.entry, Entry::Rest)) =>
                {
                    until = frontier.position.interval + (until - frontier.position.interval) / 2;
                    exit = Exit::Open;
                }
                Err(error) => return Err(error),
            }
        }
    }

    /// Waits until the whole solution can be appended at once. True if a request received its reply
    /// meanwhile, which discards the solution.
    fn wait_for_capacity(&mut self) -> Result<bool, S::Error> {
        loop {
            if self.serve()? {
                return Ok(true);
            }
            let ahead = self
                .frontier
                .position
                .interval
                .saturating_sub(self.sink.reached());
            let left = if ahead < SOON { 0 } else { LEFT_STEPS };
            let steps = self.pieces.len() + 2 + left;
            if self
                .sink
                .has_capacity(steps, self.segments_needed(), self.marks_needed())
            {
                return Ok(false);
            }
            self.sink.wait()?;
        }
    }

    fn segments_needed(&self) -> usize {
        self.pieces.last().map_or(0, |piece| {
            (piece.segment + 1).saturating_sub(self.path.handed) as usize
        })
    }

    fn marks_needed(&self) -> usize {
        self.pieces.last().map_or(0, |piece| {
            let end = self.path_at(piece) + piece.length;
            self.path.marks.partition_point(|mark| mark.start <= end)
        })
    }

    /// Path parameter at the start of a piece.
    fn path_at(&self, piece: &TimeLawPiece) -> f64 {
        self.path.segments[(piece.segment - self.path.first) as usize].0 + piece.from
    }

    /// Hands over the solved window: the first part final, the rest as a tail.
    fn commit(&mut self, until: u64, exit: Exit) -> Result<(), S::Error> {
        self.failures = 0;
        self.remember();
        let first = self.appended;
        let committed = match exit {
            Exit::Rest => self.pieces.len(),
            Exit::Open => self.committed_pieces(),
        };
        self.append_pieces()?;
        let feed_factor = self.frontier.feed_factor;
        let next = match self.pieces.get(committed) {
            Some(piece) => {
                self.sink.step(&Step::Wait)?;
                self.appended += 1;
                self.sink.leave_open(first + committed as u64 - 1);
                let (state, _) = piece.law.at(0.0);
                PlanFrontier {
                    position: PathPosition {
                        interval: piece.interval,
                        x: piece.from - self.interval_start(piece.interval),
                    },
                    entry: Entry::Moving {
                        v: state.v,
                        a: state.a,
                    },
                    link: Some(first + committed as u64 - 1),
                    ..self.frontier
                }
            }
            None => PlanFrontier {
                position: PathPosition {
                    interval: until,
                    x: 0.0,
                },
                entry: Entry::Rest,
                link: None,
                ..self.frontier
            },
        };
        // Commit before linking: a cycle that reaches the link must not take its second piece for a tail.
        self.sink.commit(first + committed as u64);
        let follows = match self.frontier.link {
            Some(link) => self.sink.link(link, first),
            None => true,
        };
        if !follows {
            // The cycle already executes the tail and will send a request; plans from there cannot use this
            // window.
            self.windows.spare.extend(self.windows.planned.pop_back());
            if let Some(pending_branch) = &mut self.windows.pending_branch {
                pending_branch.windows = pending_branch.windows.saturating_sub(1);
            }
            self.restore_optimizer();
            return self.fall_back_to_tail();
        }
        self.add_planned_time(committed);
        self.frontier = PlanFrontier { feed_factor, ..next };
        Ok(())
    }

    /// Saves the solved window.
    fn remember(&mut self) {
        let mut planned = self.windows.spare.pop().unwrap_or_default();
        planned.first_step = self.appended;
        self.optimizer.save(&mut planned.snapshot);
        self.windows.planned.push_back(planned);
        if let Some(pending_branch) = &mut self.windows.pending_branch {
            pending_branch.windows += 1;
        }
    }

    /// Number of windows handed over up to the one that a plan step is in.
    fn windows_up_to(&self, step: u64) -> usize {
        self.windows.planned.partition_point(|one| one.first_step <= step)
    }

    /// Hands over all pieces, with their segments and marks.
    fn append_pieces(&mut self) -> Result<(), S::Error> {
        for piece in &self.pieces {
            while self.path.handed <= piece.segment {
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

    /// Number of pieces to commit: as many as leave a tail that is long enough not to slow down the motion.
    fn committed_pieces(&self) -> usize {
        let intervals = |k: usize| self.pieces[k].interval - self.pieces[0].interval;
        let last = self.pieces.len().saturating_sub(1);
        let whole = intervals(last) as f64;
        let (min, max) = (COMMITTED_FRACTION.0 * whole, COMMITTED_FRACTION.1 * whole);
        let mut tail = 0.0;
        let mut k = last;
        while k > 1 {
            let piece = &self.pieces[k];
            tail += piece.duration_s;
            let speed = piece.law.at(0.0).0.v;
            let stopping = speed * self.stopping.0 + self.stopping.1;
            let starts_interval = piece.interval != self.pieces[k - 1].interval;
            let fraction = intervals(k) as f64;
            if starts_interval && fraction <= max && (tail >= MIN_TAIL_STOPS * stopping || fraction <= min) {
                break;
            }
            k -= 1;
        }
        k.max(1)
    }

    /// Adds the planned time of the first `count` pieces to their blocks.
    fn add_planned_time(&mut self, count: usize) {
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
                self.sink.planned_block(mark.block, piece.duration_s);
            }
        }
    }

    /// Without a plan, or with a late one, the cycle stops at the end of the tail and sends a request from
    /// there.
    fn fall_back_to_tail(&mut self) -> Result<(), S::Error> {
        self.sink.commit(self.appended);
        match self.frontier.link {
            // No other step will be linked. If the cycle already executes the tail, nothing changes.
            Some(link) if matches!(self.frontier.entry, Entry::Moving { .. }) => {
                let _is_in_time = self.sink.link(link, link + 1);
            }
            _ => {
                // At rest with nothing to follow: the cycle waits and sends a request.
                self.append_wait()?;
                self.link_reserved(self.appended - 1);
                self.failures += 1;
            }
        }
        self.frontier.is_waiting = true;
        Ok(())
    }

    /// Links step `step` after the stop at the frontier, in place of the Wait that reserves the link.
    fn link_reserved(&mut self, step: u64) {
        if let Some(wait) = self.frontier.link.take() {
            let _is_free = self.sink.link(wait, step);
        }
    }

    fn append_wait(&mut self) -> Result<(), S::Error> {
        self.sink.step(&Step::Wait)?;
        self.appended += 1;
        self.sink.commit(self.appended);
        Ok(())
    }

    /// Offset of an interval from the start of its segment.
    fn interval_start(&self, interval: u64) -> f64 {
        self.grid.segment_of(interval).map_or(0.0, |segment| segment.1)
    }

    /// Drops what the consumer has passed.
    fn forget(&mut self) {
        let (reached, reached_step) = (self.sink.reached(), self.sink.reached_step());
        self.grid.release(reached);
        if self
            .windows
            .pending_branch
            .is_some_and(|pending_branch| self.sink.acknowledged() >= pending_branch.id)
        {
            self.settle();
        }
        while self.windows.pending_branch.is_none()
            && self.windows.planned.len() > 1
            && self.windows.planned[1].first_step < reached_step
        {
            self.windows.spare.extend(self.windows.planned.pop_front());
        }
        while self.frontier.rest > 0 && self.rests.front().is_some_and(|rest| rest.at < reached) {
            self.rests.pop_front();
            self.frontier.rest -= 1;
            if let Some(pending_branch) = &mut self.windows.pending_branch {
                pending_branch.frontier.rest = pending_branch.frontier.rest.saturating_sub(1);
            }
        }
        if let Some((segment, _)) = self.grid.segment_of(reached) {
            while self.path.first < segment && self.path.first < self.path.handed {
                self.path.segments.pop_front();
                self.path.first += 1;
            }
        }
    }
}

mod requests;
#[cfg(test)]
mod tests;
