//! The recorder's thread: cycles, events and blocks into the trace.

use std::collections::{BTreeMap, VecDeque};
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender};
use std::time::{Duration, Instant};

use evolvent_machine::OnFull;
use evolvent_motion::{State, flags};
use evolvent_trace::{BlockRecord, EventKind, EventRecord, RecordError, Recorder};
use rtrb::Consumer;

use crate::cycle::CycleSample;
use crate::feeder::{BlockPlan, FeederNews, Notice};
use crate::shared::Controls;

/// Nothing older than this is lost by a crash.
const FLUSH_EVERY: Duration = Duration::from_millis(250);
/// Time between two looks at an empty queue.
const NAP: Duration = Duration::from_millis(1);
/// Path time between two tool poses for viewers.
const POSE_EVERY_NS: u64 = 50_000_000;

/// Records one run.
pub(crate) struct Recording {
    pub recorder: Recorder,
    pub queue: Consumer<CycleSample>,
    pub news: Receiver<FeederNews>,
    pub on_full: OnFull,
    pub controls: Arc<Controls>,
    pub program: PathBuf,
}

/// What became of the trace.
pub(crate) struct RecordReport {
    pub result: Result<PathBuf, RecordError>,
    /// Records that came after the trace had failed.
    pub lost: u64,
}

/// The cycles of one block.
#[derive(Clone, Copy)]
struct Span {
    block: u32,
    start: u64,
    end: u64,
    time_ns: u64,
}

struct Tracks {
    plans: VecDeque<BlockPlan>,
    notices: VecDeque<Notice>,
    lines: Lines,
    period_s: f64,
    block: Option<Span>,
    closed: VecDeque<Span>,
    state: u8,
    feed_override: f64,
    starved: bool,
    late: bool,
    actions: u32,
    next_pose_ns: u64,
}

impl Recording {
    /// Records until the cycle has gone and the queue is empty, then finishes the file with what `summary`
    /// brings.
    pub(crate) fn run(
        mut self,
        period_ns: u64,
        summary: &Receiver<BTreeMap<String, String>>,
        failed: &Sender<RecordError>,
    ) -> RecordReport {
        let mut tracks = Tracks {
            plans: VecDeque::new(),
            notices: VecDeque::new(),
            lines: Lines::new(&self.program),
            period_s: period_ns as f64 * 1e-9,
            block: None,
            closed: VecDeque::new(),
            state: State::Idle as u8,
            feed_override: 1.0,
            starved: false,
            late: false,
            actions: 0,
            next_pose_ns: 0,
        };
        let mut failure: Option<RecordError> = None;
        let mut lost = 0;
        let mut flushed = Instant::now();
        let mut last_ns = 0;
        loop {
            let over = self.queue.is_abandoned();
            let mut count = 0;
            while let Ok(sample) = self.queue.pop() {
                count += 1;
                last_ns = sample.record.due_time_ns;
                if failure.is_some() {
                    lost += 1;
                    continue;
                }
                if count % 256 == 1 {
                    while let Ok(news) = self.news.try_recv() {
                        tracks.hear(news);
                    }
                }
                if let Err(error) = tracks.record(&mut self.recorder, &sample) {
                    lost += 1;
                    if self.on_full == OnFull::Stop {
                        self.controls.stop();
                    }
                    let _gone = failed.send(error.clone());
                    failure = Some(error);
                }
            }
            if failure.is_none() && flushed.elapsed() >= FLUSH_EVERY {
                flushed = Instant::now();
                failure = self.recorder.flush().err();
                if let Some(error) = &failure {
                    if self.on_full == OnFull::Stop {
                        self.controls.stop();
                    }
                    let _gone = failed.send(error.clone());
                }
            }
            if over && self.queue.is_empty() {
                break;
            }
            if count == 0 {
                std::thread::sleep(NAP);
            }
        }
        // The feeder ends soon after the cycle, and with it the news.
        while let Ok(news) = self.news.recv() {
            tracks.hear(news);
        }
        if failure.is_none() {
            failure = tracks.end(&mut self.recorder, last_ns).err();
        }
        let summary = summary.recv().unwrap_or_default();
        let result = match failure {
            None => self.recorder.finish(&summary),
            Some(error) => Err(error),
        };
        RecordReport { result, lost }
    }
}

impl Tracks {
    fn hear(&mut self, news: FeederNews) {
        match news {
            FeederNews::Block(plan) => self.plans.push_back(plan),
            FeederNews::Notice(notice) => self.notices.push_back(notice),
        }
    }

    fn record(&mut self, recorder: &mut Recorder, sample: &CycleSample) -> Result<(), RecordError> {
        let cycle = &sample.record;
        recorder.cycle(cycle)?;
        let event = |kind, code, text: String, value| EventRecord {
            time_ns: cycle.due_time_ns,
            sequence: cycle.sequence,
            kind,
            code,
            text,
            value,
        };
        if cycle.override_ != self.feed_override {
            self.feed_override = cycle.override_;
            let text = format!("feed override {:.0} %", 100.0 * cycle.override_);
            recorder.event(&event(EventKind::Override, 0, text, Some(cycle.override_)))?;
        }
        if cycle.state != self.state {
            let (kind, text) = describe(self.state, cycle.state);
            recorder.event(&event(kind, u32::from(cycle.state), text.to_owned(), None))?;
            self.state = cycle.state;
        }
        let starved = cycle.flags & flags::STARVED != 0;
        if starved && !self.starved {
            let text = "the planner had not finished the next run".to_owned();
            recorder.event(&event(EventKind::Starvation, 0, text, None))?;
        }
        self.starved = starved;
        let late = cycle.flags & flags::LATE != 0;
        if late && !self.late {
            let text = "setpoints leave after they are due".to_owned();
            recorder.event(&event(
                EventKind::Late,
                0,
                text,
                Some(cycle.wake_lateness_ns as f64),
            ))?;
        }
        self.late = late;
        while self.actions < sample.actions {
            let notice = self
                .notices
                .iter()
                .position(|notice| notice.action == self.actions);
            if let Some(notice) = notice.and_then(|at| self.notices.remove(at)) {
                let kind = if notice.is_message {
                    EventKind::Message
                } else {
                    EventKind::Command
                };
                recorder.event(&event(kind, notice.line, notice.text, None))?;
            }
            self.actions += 1;
        }
        self.follow_block(recorder, sample)?;
        if cycle.due_time_ns >= self.next_pose_ns {
            self.next_pose_ns = cycle.due_time_ns + POSE_EVERY_NS;
            let [x, y, z, ..] = cycle.position;
            recorder.pose(cycle.due_time_ns, [x, y, z])?;
        }
        Ok(())
    }

    /// A block begins with its first setpoint and ends with that of a later one.
    fn follow_block(&mut self, recorder: &mut Recorder, sample: &CycleSample) -> Result<(), RecordError> {
        let moving = sample.record.line > 0 && sample.record.state != State::Dwell as u8;
        if !moving || self.block.is_some_and(|open| open.block >= sample.block) {
            return Ok(());
        }
        self.close_block(sample.record.due_time_ns, sample.record.sequence);
        self.block = Some(Span {
            block: sample.block,
            start: sample.record.sequence,
            end: 0,
            time_ns: 0,
        });
        self.write_blocks(recorder)
    }

    fn close_block(&mut self, time_ns: u64, end: u64) {
        if let Some(open) = self.block.take() {
            self.closed.push_back(Span { end, time_ns, ..open });
        }
    }

    /// Writes the blocks that are closed and whose plans have come; those shorter than a cycle, which have no
    /// setpoint of their own, with no duration.
    fn write_blocks(&mut self, recorder: &mut Recorder) -> Result<(), RecordError> {
        while let (Some(plan), Some(span)) = (self.plans.front().copied(), self.closed.front().copied()) {
            if plan.block > span.block {
                self.closed.pop_front();
                continue;
            }
            self.plans.pop_front();
            let mut cycles = 0;
            if plan.block == span.block {
                self.closed.pop_front();
                cycles = span.end.saturating_sub(span.start);
            }
            recorder.block(&BlockRecord {
                time_ns: span.time_ns,
                line: plan.line,
                text: self.lines.text(plan.line),
                kind: plan.kind,
                length_mm: plan.length_mm,
                planned_duration_s: plan.planned_s,
                true_duration_s: cycles as f64 * self.period_s,
                start_sequence: span.start,
            })?;
        }
        Ok(())
    }

    fn end(&mut self, recorder: &mut Recorder, time_ns: u64) -> Result<(), RecordError> {
        let end = recorder.statistics().cycles;
        self.close_block(time_ns, end);
        self.write_blocks(recorder)
    }
}

fn describe(before: u8, now: u8) -> (EventKind, &'static str) {
    let is = |state: State| now == state as u8;
    let was_held = before == State::Holding as u8 || before == State::Held as u8;
    if is(State::Holding) {
        (EventKind::Hold, "feed hold")
    } else if is(State::Stopping) {
        (EventKind::Stop, "stop")
    } else if is(State::Fault) {
        (EventKind::Alarm, "the guard refused a setpoint")
    } else if is(State::Running) && was_held {
        (EventKind::Resume, "resume")
    } else {
        let name = match now {
            0 => "idle",
            1 => "running",
            3 => "held",
            5 => "stopped",
            6 => "dwell",
            7 => "program stop",
            9 => "done",
            _ => "unknown",
        };
        (EventKind::State, name)
    }
}

/// Lines of the program by number, mostly in order.
struct Lines {
    path: PathBuf,
    reader: Option<BufReader<File>>,
    line: u32,
    text: Vec<u8>,
}

impl Lines {
    fn new(path: &Path) -> Self {
        Self {
            path: path.to_owned(),
            reader: None,
            line: 0,
            text: Vec::new(),
        }
    }

    fn text(&mut self, line: u32) -> String {
        if self.reader.is_none() || line < self.line {
            self.reader = File::open(&self.path).ok().map(BufReader::new);
            self.line = 0;
        }
        let Some(reader) = &mut self.reader else {
            return String::new();
        };
        while self.line < line {
            self.text.clear();
            if reader.read_until(b'\n', &mut self.text).unwrap_or(0) == 0 {
                return String::new();
            }
            self.line += 1;
        }
        String::from_utf8_lossy(&self.text).trim_end().to_owned()
    }
}
