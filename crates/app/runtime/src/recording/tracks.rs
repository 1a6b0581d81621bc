//! Events and blocks that belong to recorded cycles.

use std::collections::VecDeque;
use std::path::Path;
use std::sync::Arc;

use evolvent_control::Alarm;
use evolvent_motion::{MotionState, flags};
use evolvent_trace::{
    BlockRecord, CycleRecord, EventKind, EventRecord, LogLevel, RecordError, Recorder, inputs,
};

use super::lines::{Lines, LinesSource};
use super::{POLL_INTERVAL, TURNING_STATES};
use crate::cycle_sample::CycleSample;
use crate::news::{BlockPlan, ExternalEvent, ExternalEventKind, FeederEvent, Notice, notices_due};
use crate::program_copy::{ProgramCopy, ProgramText};
use crate::switches::Switched;

/// Content of an attachment.
enum Content {
    Text(Vec<u8>),
    File(Arc<ProgramCopy>),
}

/// The cycles of one block.
#[derive(Clone, Copy)]
struct Span {
    block: u32,
    pub(super) start: u64,
    pub(super) end: u64,
    time_ns: u64,
}

pub(super) struct Tracks {
    plans: VecDeque<BlockPlan>,
    notices: VecDeque<Notice>,
    /// Files of later jobs, and the block with which each begins.
    pub(super) files: VecDeque<(u32, ProgramText)>,
    outside: VecDeque<ExternalEvent>,
    /// Changed switches with which planners continued, and their jobs.
    switched: VecDeque<(u32, Switched)>,
    /// Texts and files to attach, by name.
    attachments: VecDeque<(String, Content)>,
    pub(super) lines: Lines,
    period_s: f64,
    block: Option<Span>,
    closed: VecDeque<Span>,
    last_closed: Option<u32>,
    state: u8,
    feed_override: f64,
    starved: bool,
    late: bool,
    pub(super) actions: u32,
    pub(super) blocks: u32,
}

impl Tracks {
    pub(super) fn new(program: &Path, period_ns: u64) -> Self {
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
            state: MotionState::Idle as u8,
            feed_override: 1.0,
            starved: false,
            late: false,
            actions: 0,
            blocks: 0,
        }
    }

    pub(super) fn receive(&mut self, news: FeederEvent) {
        match news {
            FeederEvent::Block(plan) => self.plans.push_back(plan),
            FeederEvent::Notice(notice) => self.notices.push_back(notice),
            FeederEvent::File(block, file) => self.files.push_back((block, file)),
            FeederEvent::ExternalEvent(outside) => self.outside.push_back(outside),
            FeederEvent::Switched(job, switched) => self.switched.push_back((job, switched)),
            FeederEvent::Attach(name, text) => self.attachments.push_back((name, Content::Text(text))),
            FeederEvent::AttachFile(name, file) => self.attachments.push_back((name, Content::File(file))),
            // Only for the recorder itself, or not requested.
            FeederEvent::NextFile(_)
            | FeederEvent::Queued(_)
            | FeederEvent::Modal(..)
            | FeederEvent::Stop(..)
            | FeederEvent::Periphery(..) => {}
        }
    }

    pub(super) fn record(
        &mut self,
        recorder: &mut Recorder,
        sample: &CycleSample,
    ) -> Result<(), RecordError> {
        let cycle = &sample.record;
        recorder.cycle(cycle)?;
        if let Some(phase) = &sample.phase {
            recorder.phase(phase);
        }
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
            let text = "setpoints are published late".to_owned();
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
            // The leading digits of a state's number distinguish turning from the cycle.
            let code = TURNING_STATES + change.to as u32;
            recorder.event(&event(EventKind::State, code, text, Some(change.load)))?;
        }
        self.attach(recorder, cycle.due_time_ns)?;
        self.record_switched(recorder, cycle.due_time_ns, cycle.sequence)?;
        self.record_outside(recorder, cycle)?;
        self.actions = sample.actions;
        self.blocks = self.blocks.max(sample.blocks_begun());
        self.record_notices(recorder, cycle.due_time_ns, cycle.sequence)?;
        self.follow_block(recorder, sample)
    }

    /// Records the notices of a program up to its present position.
    fn record_notices(
        &mut self,
        recorder: &mut Recorder,
        time_ns: u64,
        sequence: u64,
    ) -> Result<(), RecordError> {
        let ended = self.state == MotionState::Done as u8;
        loop {
            let due = notices_due(&self.notices, self.actions, self.blocks, ended);
            if due == 0 {
                return Ok(());
            }
            for notice in self.notices.drain(..due) {
                recorder.event(&EventRecord {
                    time_ns,
                    sequence,
                    kind: if notice.is_message {
                        EventKind::Message
                    } else {
                        EventKind::Command
                    },
                    // The code of messages and actions is their line.
                    code: notice.line,
                    text: notice.text,
                    value: None,
                })?;
            }
        }
    }

    /// Records events from outside once their cycle is recorded.
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

    /// Records changed switches. The planner is ahead of the machine, so they are recorded where they arrive.
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

    /// Attaches the inputs of jobs, which must be there before the job's event.
    pub(super) fn attach(&mut self, recorder: &mut Recorder, time_ns: u64) -> Result<(), RecordError> {
        while let Some((name, content)) = self.attachments.front() {
            match content {
                Content::Text(text) => recorder.attach_text(name, time_ns, text)?,
                Content::File(copy) => match copy.poll() {
                    // The copy is still in progress and is not awaited.
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

    /// Waits for copies of programs that belong to the file that ends; each is given up if no data arrives.
    pub(super) fn wait_for_copies(&self) {
        let attached = self.attachments.iter().filter_map(|(_, content)| match content {
            Content::File(copy) => Some(copy),
            Content::Text(_) => None,
        });
        for copy in attached {
            while copy.poll().is_none() {
                std::thread::sleep(POLL_INTERVAL);
            }
        }
    }

    /// A block begins with the first setpoint that moves along it, and ends with the first of a later block,
    /// of a dwell or of a program stop.
    fn follow_block(&mut self, recorder: &mut Recorder, sample: &CycleSample) -> Result<(), RecordError> {
        let between =
            [MotionState::Idle, MotionState::Dwell, MotionState::ProgramStop].map(|state| state as u8);
        // A jog or homing shows the block of the preceding job, or of the next one if there was none.
        let is_steered = sample.record.inputs & inputs::STEERS != 0;
        if is_steered || between.contains(&sample.record.state) {
            self.close_block(sample.record.due_time_ns, sample.record.sequence);
            return self.write_blocks(recorder);
        }
        let open = self.block.map(|open| open.block).or(self.last_closed);
        // At rest between two steps, the setpoint already names the next block.
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

    /// Writes complete blocks whose plans have arrived. Blocks shorter than a cycle, which have no setpoint
    /// of their own, are written with no duration.
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

    pub(super) fn end(
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
        self.record_notices(recorder, time_ns, end.saturating_sub(1))?;
        // Events that took effect with the last setpoints.
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
            // Already recorded at the rejected cycle.
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
    let is = |state: MotionState| now == state as u8;
    let was_held = before == MotionState::Holding as u8 || before == MotionState::Held as u8;
    if is(MotionState::Holding) {
        (EventKind::Hold, "feed hold")
    } else if is(MotionState::Stopping) {
        (EventKind::Stop, "stop")
    } else if is(MotionState::Fault) && cycle.flags & flags::GUARD != 0 {
        (EventKind::Alarm, "the guard rejected a setpoint")
    } else if is(MotionState::Running) && was_held {
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
