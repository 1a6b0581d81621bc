//! The recorder's thread: cycles, events and blocks into the trace.

use std::collections::{BTreeMap, VecDeque};
use std::io::{BufRead, BufReader, Cursor, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{self, Receiver, Sender};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use evolvent_config::open_regular;
use evolvent_machine::OnFull;
use evolvent_motion::{State, flags};
use evolvent_trace::{
    BlockRecord, CycleRecord, EventKind, EventRecord, LogLevel, RecordError, Recorder, RunInfo, inputs,
};
use rtrb::Consumer;

use crate::cycle_sample::CycleSample;
use crate::news::{BlockPlan, ExternalEvent, ExternalEventKind, FeederEvent, Notice, notices_due};
use crate::program_copy::{FromStart, ProgramCopy, ProgramText};
use crate::serve::{FileProgress, TraceSeries};
use crate::shared::Controls;
use crate::signal_recorder::SignalRecorder;
use crate::switches::Switched;
use evolvent_control::Alarm;

/// Nothing older than this is lost by a crash.
const FLUSH_EVERY: Duration = Duration::from_millis(250);
/// Codes of the events of a turning cycle's states begin after this.
const TURNING_STATES: u32 = 100;
/// How long the last news of a feeder are waited for.
const LAST_NEWS: Duration = Duration::from_secs(10);
/// Time between two looks at an empty queue.
const POLL_INTERVAL: Duration = Duration::from_millis(1);

/// Records one run.
pub(crate) struct Recording {
    pub recorder: Recorder,
    pub queue: Consumer<CycleSample>,
    /// Inputs and outputs that change, where the machine has any.
    pub signals: Option<SignalRecorder>,
    pub lines: RecorderLines,
    pub on_full: OnFull,
    pub controls: Arc<Controls>,
    pub program: PathBuf,
    /// How the trace goes on in further files; none for a single one.
    pub further: Option<Further>,
}

/// The files of a trace after the first.
pub(crate) struct Further {
    pub series: TraceSeries,
    /// What each says of itself.
    pub info: RunInfo,
    /// For whoever decides when the next one begins.
    pub progress: Arc<FileProgress>,
    /// Files that are being finished.
    pub finishing: Vec<JoinHandle<Result<PathBuf, RecordError>>>,
}

impl Further {
    /// Goes on in the next file; the present one is finished by a thread of its own, because its index and the disk take time.
    fn go_on(&mut self, recorder: &mut Recorder, sequence: u64) -> Result<(), RecordError> {
        let path = self.series.file_of_now();
        self.info.extra.insert(CONTINUES.to_owned(), sequence.to_string());
        let next = Recorder::create(&path, &self.info)?;
        let old = std::mem::replace(recorder, next);
        self.progress.bytes.store(0, Ordering::Relaxed);
        self.progress.files.fetch_add(1, Ordering::Release);
        let series = self.series.clone();
        let finished = std::thread::Builder::new()
            .name("finisher".into())
            .spawn(move || {
                let summary = BTreeMap::from([
                    ("outcome".to_owned(), "served".to_owned()),
                    ("continued_in".to_owned(), path.display().to_string()),
                ]);
                let result = old.finish(&summary);
                // The next file reports a folder that cannot be read.
                let _left = series.trim(&path);
                result
            });
        // Without a thread it stays a part file, which the next start recovers.
        self.finishing.extend(finished.ok());
        self.finishing.retain(|thread| !thread.is_finished());
        Ok(())
    }
}

/// Metadata of a file that goes on where another one ends: its first setpoint.
pub(crate) const CONTINUES: &str = "continues_at";

/// The recorder's ends of its channels.
pub(crate) struct RecorderLines {
    news: Receiver<FeederEvent>,
    closing: Receiver<Closing>,
    failed: Sender<RecordError>,
}

impl RecorderLines {
    /// Theirs and the ends of whoever is recorded.
    pub(crate) fn new() -> (Self, RecordedLines) {
        let (news_sender, news) = mpsc::channel();
        let (closing_sender, closing) = mpsc::channel();
        let (failed, failures) = mpsc::channel();
        let recorder = Self {
            news,
            closing,
            failed,
        };
        let recorded = RecordedLines {
            news: news_sender,
            closing: closing_sender,
            failures,
        };
        (recorder, recorded)
    }
}

/// The ends of whoever is recorded.
pub(crate) struct RecordedLines {
    /// What planners have read.
    pub news: Sender<FeederEvent>,
    /// How the trace ends, once no more news is sent.
    pub closing: Sender<Closing>,
    /// Why the trace has ended early, as soon as it has.
    pub failures: Receiver<RecordError>,
}

/// What the trace says of the run as a whole, at its end.
pub(crate) struct Closing {
    /// Names and values of the metadata.
    pub summary: BTreeMap<String, String>,
    /// Why the run ended early: number and text.
    pub alarm: Option<(Alarm, String)>,
}

/// What became of the trace.
pub(crate) struct RecordReport {
    pub result: Result<PathBuf, RecordError>,
    /// Records that came after the trace had failed.
    pub lost: u64,
}

/// What is attached.
enum Content {
    Text(Vec<u8>),
    File(Arc<ProgramCopy>),
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
    /// Files of later jobs, and the block with which each begins.
    files: VecDeque<(u32, ProgramText)>,
    outside: VecDeque<ExternalEvent>,
    /// Switches that planners have read on with, and their jobs.
    switched: VecDeque<(u32, Switched)>,
    /// Texts and files to attach, by name.
    attachments: VecDeque<(String, Content)>,
    lines: Lines,
    period_s: f64,
    block: Option<Span>,
    closed: VecDeque<Span>,
    last_closed: Option<u32>,
    state: u8,
    feed_override: f64,
    starved: bool,
    late: bool,
    actions: u32,
    blocks: u32,
}

impl Recording {
    /// Records until the cycle has gone and the queue is empty, then finishes the file with what its closing brings.
    pub(crate) fn run(self, period_ns: u64) -> RecordReport {
        let mut underway = RecordingUnderway {
            tracks: Tracks::new(&self.program, period_ns),
            recording: self,
            failure: None,
            lost: 0,
            flushed: Instant::now(),
            last_ns: 0,
            next_file: None,
        };
        loop {
            let over = underway.recording.queue.is_abandoned();
            let count = underway.drain_queue();
            underway.flush_when_due();
            if over && underway.recording.queue.is_empty() {
                break;
            }
            if count == 0 {
                std::thread::sleep(POLL_INTERVAL);
            }
        }
        underway.finish()
    }
}

/// A recording from its first sample to its last.
struct RecordingUnderway {
    recording: Recording,
    tracks: Tracks,
    /// Why nothing more is recorded.
    failure: Option<RecordError>,
    /// Samples that came after that.
    lost: u64,
    flushed: Instant,
    /// When the last sample was due.
    last_ns: u64,
    /// The next file begins after this setpoint.
    next_file: Option<u64>,
}

impl RecordingUnderway {
    /// Records what is in the queue. Returns the number of samples.
    fn drain_queue(&mut self) -> usize {
        let mut count = 0;
        while let Ok(sample) = self.recording.queue.pop() {
            count += 1;
            self.last_ns = sample.record.due_time_ns;
            if self.failure.is_some() {
                self.lost += 1;
                continue;
            }
            if let Err(error) = self.begin_file_when_due(&sample.record) {
                self.lost += 1;
                self.fail(error);
                continue;
            }
            // What an action is called was told before the action went into the plan.
            let news = sample.actions > self.tracks.actions || sample.blocks_begun() > self.tracks.blocks;
            if count % 256 == 1 || news {
                self.take_news();
            }
            if let Err(error) = self.record(&sample) {
                self.lost += 1;
                self.stop_if_configured();
                self.fail(error);
            }
        }
        count
    }

    /// Goes on in the next file where one was ordered and `cycle` is the first of it.
    fn begin_file_when_due(&mut self, cycle: &CycleRecord) -> Result<(), RecordError> {
        let Recording {
            recorder,
            signals,
            further: Some(further),
            ..
        } = &mut self.recording
        else {
            return Ok(());
        };
        if self.next_file.is_none_or(|last| cycle.sequence <= last) {
            return Ok(());
        }
        self.next_file = None;
        self.tracks.wait_for_copies();
        self.tracks.attach(recorder, self.last_ns)?;
        further.go_on(recorder, cycle.sequence)?;
        match signals {
            Some(signals) => signals.repeat(recorder, cycle),
            None => Ok(()),
        }
    }

    /// Takes the news there are. What follows the order for a new file is for that file.
    fn take_news(&mut self) {
        while self.next_file.is_none()
            && let Ok(news) = self.recording.lines.news.try_recv()
        {
            match news {
                FeederEvent::NextFile(last) => {
                    self.next_file = self.recording.further.is_some().then_some(last);
                }
                news => self.tracks.receive(news),
            }
        }
    }

    fn record(&mut self, sample: &CycleSample) -> Result<(), RecordError> {
        let Recording {
            recorder, signals, ..
        } = &mut self.recording;
        self.tracks.record(recorder, sample)?;
        match signals {
            Some(signals) => signals.record(recorder, &sample.record),
            None => Ok(()),
        }
    }

    fn flush_when_due(&mut self) {
        if self.failure.is_some() || self.flushed.elapsed() < FLUSH_EVERY {
            return;
        }
        self.flushed = Instant::now();
        let recorder = &mut self.recording.recorder;
        if let Some(further) = &self.recording.further {
            further.progress.bytes.store(recorder.bytes(), Ordering::Relaxed);
        }
        if let Err(error) = recorder.flush() {
            self.stop_if_configured();
            self.fail(error);
        }
    }

    /// Stops the motion that can no longer be recorded, where the machine file says so.
    fn stop_if_configured(&self) {
        if self.recording.on_full == OnFull::Stop {
            self.recording.controls.stop();
        }
    }

    /// Records nothing more, and tells whoever is recorded why.
    fn fail(&mut self, error: RecordError) {
        let _gone = self.recording.lines.failed.send(error.clone());
        self.failure = Some(error);
    }

    fn finish(mut self) -> RecordReport {
        let Recording {
            mut recorder,
            lines,
            further,
            ..
        } = self.recording;
        // The feeder ends soon after the cycle, and with it the news; one that hangs in a file system is not waited for.
        while let Ok(news) = lines.news.recv_timeout(LAST_NEWS) {
            self.tracks.receive(news);
        }
        let ended = lines.closing.recv().ok();
        if self.failure.is_none() {
            let alarm = ended.as_ref().and_then(|closing| closing.alarm.as_ref());
            self.failure = self.tracks.end(&mut recorder, self.last_ns, alarm).err();
        }
        let summary = ended.map(|closing| closing.summary).unwrap_or_default();
        let result = match self.failure {
            None => recorder.finish(&summary),
            Some(error) => Err(error),
        };
        for thread in further.into_iter().flat_map(|further| further.finishing) {
            // What failed there is a part file, which the next start recovers.
            let _result = thread.join();
        }
        RecordReport {
            result,
            lost: self.lost,
        }
    }
}

impl Tracks {
    fn new(program: &Path, period_ns: u64) -> Self {
        Self {
            plans: VecDeque::new(),
            notices: VecDeque::new(),
            files: VecDeque::new(),
            outside: VecDeque::new(),
            switched: VecDeque::new(),
            attachments: VecDeque::new(),
            lines: Lines::new(LinesSource::Path(program.to_owned())),
            period_s: period_ns as f64 * 1e-9,
            block: None,
            closed: VecDeque::new(),
            last_closed: None,
            state: State::Idle as u8,
            feed_override: 1.0,
            starved: false,
            late: false,
            actions: 0,
            blocks: 0,
        }
    }

    fn receive(&mut self, news: FeederEvent) {
        match news {
            FeederEvent::Block(plan) => self.plans.push_back(plan),
            FeederEvent::Notice(notice) => self.notices.push_back(notice),
            FeederEvent::File(block, file) => self.files.push_back((block, file)),
            FeederEvent::ExternalEvent(outside) => self.outside.push_back(outside),
            FeederEvent::Switched(job, switched) => self.switched.push_back((job, switched)),
            FeederEvent::Attach(name, text) => self.attachments.push_back((name, Content::Text(text))),
            FeederEvent::AttachFile(name, file) => self.attachments.push_back((name, Content::File(file))),
            // They are not requested here.
            FeederEvent::NextFile(_)
            | FeederEvent::Queued(_)
            | FeederEvent::Modal(..)
            | FeederEvent::Stop(..)
            | FeederEvent::Periphery(..) => {}
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
            let (kind, text) = describe(self.state, cycle);
            let is_guard = kind == EventKind::Alarm;
            let code = if is_guard {
                Alarm::Guard.number()
            } else {
                u32::from(cycle.state)
            };
            recorder.event(&event(kind, code, text.to_owned(), None))?;
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
        if let Some(change) = &sample.turning {
            let text = format!(
                "turning, pass {}: {} to {} at {:.2} mm along and {:.3} mm out: {}",
                change.pass,
                change.from.name(),
                change.to.name(),
                change.along_mm,
                change.out_mm,
                change.reason.text()
            );
            // States of turning are told apart from those of the cycle by what their numbers begin with.
            let code = TURNING_STATES + change.to as u32;
            recorder.event(&event(EventKind::State, code, text, Some(change.load)))?;
        }
        self.attach(recorder, cycle.due_time_ns)?;
        self.record_switched(recorder, cycle.due_time_ns, cycle.sequence)?;
        self.record_outside(recorder, cycle)?;
        self.actions = sample.actions;
        self.blocks = self.blocks.max(sample.blocks_begun());
        let ended = cycle.state == State::Done as u8;
        loop {
            let due = notices_due(&self.notices, self.actions, self.blocks, ended);
            if due == 0 {
                break;
            }
            for notice in self.notices.drain(..due) {
                let kind = if notice.is_message {
                    EventKind::Message
                } else {
                    EventKind::Command
                };
                // Messages and commands are marked with their line.
                recorder.event(&event(kind, notice.line, notice.text, None))?;
            }
        }
        self.follow_block(recorder, sample)
    }

    /// What came from outside, once its cycle has been recorded.
    fn record_outside(&mut self, recorder: &mut Recorder, cycle: &CycleRecord) -> Result<(), RecordError> {
        while self
            .outside
            .front()
            .is_some_and(|outside| outside.sequence <= cycle.sequence)
        {
            let Some(outside) = self.outside.pop_front() else {
                break;
            };
            let ago = (cycle.sequence - outside.sequence) as f64 * self.period_s * 1e9;
            recorder.event(&EventRecord {
                time_ns: cycle.due_time_ns.saturating_sub(ago as u64),
                sequence: outside.sequence,
                kind: match outside.kind {
                    ExternalEventKind::Command => EventKind::Command,
                    ExternalEventKind::Alarm => EventKind::Alarm,
                    ExternalEventKind::Warning => EventKind::Warning,
                    ExternalEventKind::Output => EventKind::Message,
                    ExternalEventKind::Job => EventKind::Job,
                },
                code: outside.code,
                text: outside.text,
                value: outside.value,
            })?;
        }
        Ok(())
    }

    /// What planners have read on with. It is ahead of the machine, so it stands where it was heard.
    fn record_switched(
        &mut self,
        recorder: &mut Recorder,
        time_ns: u64,
        sequence: u64,
    ) -> Result<(), RecordError> {
        while let Some((job, switched)) = self.switched.pop_front() {
            recorder.event(&EventRecord {
                time_ns,
                sequence,
                kind: EventKind::Switched,
                code: job,
                text: switched.to_string(),
                value: None,
            })?;
        }
        Ok(())
    }

    /// Attaches what jobs have begun with. It has to be there before the job's event is.
    fn attach(&mut self, recorder: &mut Recorder, time_ns: u64) -> Result<(), RecordError> {
        while let Some((name, content)) = self.attachments.front() {
            match content {
                Content::Text(text) => recorder.attach_text(name, time_ns, text)?,
                Content::File(copy) => match copy.look() {
                    // Nothing waits for it.
                    None => return Ok(()),
                    Some(Ok(file)) => recorder.attach_program(name, time_ns, &copy.path, &file)?,
                    Some(Err(reason)) => {
                        let text = format!("{}: {reason}; it is not attached", copy.path.display());
                        recorder.log(time_ns, LogLevel::Warning, &text)?;
                    }
                },
            }
            self.attachments.pop_front();
        }
        Ok(())
    }

    /// Waits for copies of programs that belong to the file that ends; each is given up where nothing comes.
    fn wait_for_copies(&self) {
        let attached = self.attachments.iter().filter_map(|(_, content)| match content {
            Content::File(copy) => Some(copy),
            Content::Text(_) => None,
        });
        for copy in attached {
            while copy.look().is_none() {
                std::thread::sleep(POLL_INTERVAL);
            }
        }
    }

    /// A block begins with the first setpoint that moves along it, and ends with that of a later one, a dwell or a program stop.
    fn follow_block(&mut self, recorder: &mut Recorder, sample: &CycleSample) -> Result<(), RecordError> {
        let between = [State::Idle, State::Dwell, State::ProgramStop].map(|state| state as u8);
        // A jog or homing shows the block of the job before, or that of the next where there was none.
        let is_steered = sample.record.inputs & inputs::STEERS != 0;
        if is_steered || between.contains(&sample.record.state) {
            self.close_block(sample.record.due_time_ns, sample.record.sequence);
            return self.write_blocks(recorder);
        }
        let open = self.block.map(|open| open.block).or(self.last_closed);
        // At rest between two steps the next block is named already.
        let moves = sample.record.feed_mm_s > 0.0;
        if !moves || open.is_some_and(|open| open >= sample.block) {
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
            self.last_closed = Some(open.block);
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
            while self.files.front().is_some_and(|(first, _)| *first <= plan.block) {
                if let Some((_, text)) = self.files.pop_front() {
                    self.lines = Lines::new(LinesSource::Text(text));
                }
            }
            if self.lines.are_coming() {
                return Ok(());
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

    fn end(
        &mut self,
        recorder: &mut Recorder,
        time_ns: u64,
        alarm: Option<&(Alarm, String)>,
    ) -> Result<(), RecordError> {
        let end = recorder.statistics().cycles;
        self.wait_for_copies();
        self.close_block(time_ns, end);
        self.write_blocks(recorder)?;
        self.attach(recorder, time_ns)?;
        self.record_switched(recorder, time_ns, end.saturating_sub(1))?;
        // What took effect with the last setpoints.
        while let Some(sequence) = self.outside.front().map(|outside| outside.sequence) {
            let last = CycleRecord {
                sequence,
                due_time_ns: time_ns,
                ..CycleRecord::default()
            };
            self.record_outside(recorder, &last)?;
        }
        let Some((alarm, text)) = alarm else {
            return Ok(());
        };
        recorder.log(time_ns, LogLevel::Error, text)?;
        if *alarm == Alarm::Guard {
            // Recorded at the cycle that was refused.
            return Ok(());
        }
        recorder.event(&EventRecord {
            time_ns,
            sequence: end.saturating_sub(1),
            kind: EventKind::Alarm,
            code: alarm.number(),
            text: text.clone(),
            value: None,
        })
    }
}

fn describe(before: u8, cycle: &CycleRecord) -> (EventKind, &'static str) {
    let now = cycle.state;
    let is = |state: State| now == state as u8;
    let was_held = before == State::Holding as u8 || before == State::Held as u8;
    if is(State::Holding) {
        (EventKind::Hold, "feed hold")
    } else if is(State::Stopping) {
        (EventKind::Stop, "stop")
    } else if is(State::Fault) && cycle.flags & flags::GUARD != 0 {
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
            8 => "fault",
            9 => "done",
            _ => "unknown",
        };
        (EventKind::State, name)
    }
}

/// Where lines come from.
enum LinesSource {
    /// A program that is run by itself, and was opened a moment ago.
    Path(PathBuf),
    Text(ProgramText),
}

/// Lines of the program by number, mostly in order.
struct Lines {
    source: LinesSource,
    reader: Option<BufReader<Box<dyn Read>>>,
    line: u32,
    text: Vec<u8>,
}

impl Lines {
    fn new(source: LinesSource) -> Self {
        Self {
            source,
            reader: None,
            line: 0,
            text: Vec::new(),
        }
    }

    /// A copy is still being made.
    fn are_coming(&self) -> bool {
        matches!(&self.source, LinesSource::Text(ProgramText::Copy(copy)) if copy.look().is_none())
    }

    fn open(&self) -> Option<BufReader<Box<dyn Read>>> {
        let reader: Box<dyn Read> = match &self.source {
            LinesSource::Path(path) => Box::new(open_regular(path).ok()?),
            LinesSource::Text(ProgramText::Whole(text)) => Box::new(Cursor::new(Arc::clone(text))),
            LinesSource::Text(ProgramText::Copy(copy)) => {
                let file = copy.look()?.ok()?;
                Box::new(FromStart { file, at: 0 })
            }
        };
        Some(BufReader::new(reader))
    }

    fn text(&mut self, line: u32) -> String {
        if self.reader.is_none() || line < self.line {
            self.reader = self.open();
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
