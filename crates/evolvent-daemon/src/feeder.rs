//! The planner's thread: program text in, plan out.

use std::collections::VecDeque;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Sender;

use evolvent_gcode::{
    Action, Code, Command, Diagnostic, Interpreter, Modal, Move, MoveKind, SpindleDirection,
};
use evolvent_machine::PlannerKind;
use evolvent_motion::QueueClosed;
use evolvent_path::{Axes, Curve};
use evolvent_plan::{
    Answer, BlockMark, ExitSpeeds, PathRules, PlanError, PlanSink, Planner, Request, Segment, Step,
};
use evolvent_trace::BlockKind;

use crate::job::Setup;
use crate::memory::ProgramMemory;
use crate::source::Commands;

/// Why a program cannot be run to its end.
#[derive(Debug, thiserror::Error)]
pub enum ProgramError {
    /// The file cannot be read.
    #[error("{file}: {source}; name a readable part program")]
    Read {
        /// The file.
        file: String,
        /// Why not.
        source: std::io::Error,
    },
    /// The text is wrong.
    #[error("{}", .diagnostic.render(.file))]
    Text {
        /// The file.
        file: String,
        /// What and where.
        diagnostic: Box<Diagnostic>,
    },
}

/// A planned block, for the trace.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct BlockPlan {
    pub block: u32,
    pub line: u32,
    pub kind: BlockKind,
    pub length_mm: f64,
    pub planned_s: f64,
}

/// When a notice takes effect.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Moment {
    /// At rest: when more actions than this have been counted.
    Rest(u32),
    /// In passing: with the first setpoint of this block or a later one.
    Block(u32),
}

impl Moment {
    /// Whether it has come, given the actions and blocks begun, and whether the plan has ended.
    pub(crate) fn has_come(self, actions: u32, blocks: u32, ended: bool) -> bool {
        match self {
            Self::Rest(action) => action < actions,
            Self::Block(block) => ended || block < blocks,
        }
    }
}

/// Something that takes effect between moves.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Notice {
    pub(crate) moment: Moment,
    /// Program line.
    pub line: u32,
    /// `true` for a message of the program to its operator.
    pub is_message: bool,
    /// What it is.
    pub text: String,
}

/// What the feeder tells the recorder and the person at the screen.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum FeederNews {
    Block(BlockPlan),
    Notice(Notice),
    /// A block was handed to the planner. Only for those who asked for it.
    Queued(QueuedBlock),
    /// From this block on these modes are in force. Only for those who asked for it.
    Modal(u32, Modal),
    /// The next program stop in the plan; only for those who asked for it.
    Stop(StopKind),
    /// From this block on blocks are of this file.
    File(u32, PathBuf),
    /// Something that is to be recorded at its setpoint.
    Outside(Outside),
}

/// A command or an alarm, and the setpoint with which it took effect.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Outside {
    pub sequence: u64,
    pub kind: OutsideKind,
    /// Number of the command or alarm.
    pub code: u32,
    pub text: String,
    pub value: Option<f64>,
}

/// What came from outside, or happened to the machine as a whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum OutsideKind {
    Command,
    Alarm,
    Warning,
}

/// Why the program stops and waits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum StopKind {
    /// M0, M1, M60, or the look at the way to a line in the middle.
    Program,
    /// A block has ended in single step.
    Step,
}

/// A block that waits to be driven.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct QueuedBlock {
    pub block: u32,
    /// Where it ends, machine coordinates.
    pub end: Axes,
    /// Programmed speed, mm/s; infinite for rapids.
    pub feed_mm_s: f64,
    /// Programmed path from the job's start to the block's end, mm.
    pub path_mm: f64,
}

/// What the feeder knows at the end.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct FeedReport {
    /// Largest distance of blends from the programmed path.
    pub deviation_mm: f64,
    /// Seconds at the programmed feed, without dwells.
    pub planned_s: f64,
    /// Moves planned.
    pub moves: u64,
    /// Numbers of the next block and action.
    pub next_block: u32,
    pub next_action: u32,
}

/// Passes the plan on, and adds up how long each block is planned to take.
struct Tally<S> {
    sink: S,
    /// Parts of steps that are not final: for each step, its blocks and their shares of its length.
    open: VecDeque<(u32, f64)>,
    parts_of_step: VecDeque<u32>,
    parts: u32,
    finished: VecDeque<(u32, f64)>,
    planned_s: f64,
}

impl<S: PlanSink> PlanSink for Tally<S> {
    type Error = S::Error;

    fn segment(&mut self, segment: &Segment) -> Result<(), S::Error> {
        match self.open.back_mut() {
            Some(last) if self.parts > 0 && last.0 == segment.block => last.1 += segment.length,
            _ => {
                self.open.push_back((segment.block, segment.length));
                self.parts += 1;
            }
        }
        self.sink.segment(segment)
    }

    fn step(&mut self, step: &Step) -> Result<(), S::Error> {
        if matches!(step, Step::Flow(_) | Step::Wait) {
            // A near-optimal plan says itself what a block takes.
            self.open.clear();
            self.parts_of_step.clear();
        } else {
            self.parts_of_step.push_back(self.parts);
        }
        self.parts = 0;
        self.sink.step(step)
    }

    fn exit(&mut self, index: u64, speeds: ExitSpeeds) {
        self.sink.exit(index, speeds);
    }

    fn planned(&mut self, index: u64, duration: f64) {
        self.planned_s += duration;
        let parts = self.parts_of_step.pop_front().unwrap_or(0) as usize;
        let whole: f64 = self.open.iter().take(parts).map(|part| part.1).sum();
        for (block, length) in self.open.drain(..parts.min(self.open.len())) {
            let share = if whole > 0.0 {
                duration * length / whole
            } else {
                0.0
            };
            match self.finished.back_mut() {
                Some(last) if last.0 == block => last.1 += share,
                _ => self.finished.push_back((block, share)),
            }
        }
        self.sink.planned(index, duration);
    }

    fn finalise(&mut self, count: u64) {
        self.sink.finalise(count);
    }

    fn mark(&mut self, mark: &BlockMark) -> Result<(), S::Error> {
        self.sink.mark(mark)
    }

    fn link(&mut self, from: u64, to: u64) -> bool {
        self.sink.link(from, to)
    }

    fn planned_block(&mut self, block: u32, seconds: f64) {
        self.planned_s += seconds;
        match self.finished.back_mut() {
            Some(last) if last.0 == block => last.1 += seconds,
            _ => self.finished.push_back((block, seconds)),
        }
        self.sink.planned_block(block, seconds);
    }

    fn has_room(&self, steps: usize, segments: usize, marks: usize) -> bool {
        self.sink.has_room(steps, segments, marks)
    }

    fn wait(&mut self) -> Result<(), S::Error> {
        self.sink.wait()
    }

    fn request(&mut self) -> Option<Request> {
        self.sink.request()
    }

    fn answer(&mut self, answer: Answer) {
        self.sink.answer(answer);
    }

    fn taken(&self) -> u64 {
        self.sink.taken()
    }

    fn reached(&self) -> u64 {
        self.sink.reached()
    }
}

/// Blocks that have been handed to the planner and not yet reported.
struct Open {
    block: u32,
    line: u32,
    kind: BlockKind,
    length_mm: f64,
}

/// Feeds one program.
pub(crate) struct Feeder<'a, S> {
    file: String,
    setup: &'a Setup,
    planner: Planner<Tally<S>>,
    news: Vec<Sender<FeederNews>>,
    with_blocks: bool,
    optional_stop: bool,
    blocks: VecDeque<Open>,
    next_block: u32,
    actions: u32,
    moves: u64,
    /// For somebody who looks on block by block.
    onlooker: Option<Sender<FeederNews>>,
    single_step: Option<Arc<AtomicBool>>,
    last_line: u32,
    path_mm: f64,
    modal: Option<Modal>,
}

impl<'a, S: PlanSink<Error = QueueClosed>> Feeder<'a, S> {
    /// `with_blocks`: whether anyone wants to hear of blocks.
    pub(crate) fn new(
        file: &Path,
        setup: &'a Setup,
        feed_override: f64,
        sink: S,
        news: Vec<Sender<FeederNews>>,
        with_blocks: bool,
        optional_stop: bool,
    ) -> Self {
        let tally = Tally {
            sink,
            open: VecDeque::new(),
            parts_of_step: VecDeque::new(),
            parts: 0,
            finished: VecDeque::new(),
            planned_s: 0.0,
        };
        Self {
            file: file.display().to_string(),
            setup,
            planner: Planner::new(setup.path_limits(), setup.path_rules(feed_override), tally),
            news,
            with_blocks,
            optional_stop,
            blocks: VecDeque::new(),
            next_block: 0,
            actions: 0,
            moves: 0,
            onlooker: None,
            single_step: None,
            last_line: 0,
            path_mm: 0.0,
            modal: None,
        }
    }

    /// Numbers blocks and actions from these on, so that they go on from job to job.
    pub(crate) fn numbered_from(mut self, block: u32, action: u32) -> Self {
        (self.next_block, self.actions) = (block, action);
        self
    }

    /// Tells somebody of every block, of modes and of program stops.
    pub(crate) fn watched_by(mut self, onlooker: Sender<FeederNews>) -> Self {
        self.onlooker = Some(onlooker);
        self
    }

    /// Stops after each line that moves while this is set.
    pub(crate) fn stepping(mut self, single_step: Arc<AtomicBool>) -> Self {
        self.single_step = Some(single_step);
        self
    }

    /// Plans the program to its end, or to its first error: the plan then ends at rest before it, and `failed` is
    /// called before its end is handed on.
    pub(crate) fn feed(
        mut self,
        program: &Path,
        failed: impl FnOnce(),
    ) -> (FeedReport, Result<Option<ProgramMemory>, ProgramError>) {
        let result = self.feed_lines(program);
        if result.is_err() {
            failed();
        }
        let line = self.blocks.back().map_or(0, |open| open.line);
        // A consumer that has gone needs no end.
        let _gone = self.planner.finish(line);
        self.report_blocks(true);
        // Holds and overrides are answered as long as the program runs.
        self.planner.attend();
        let report = FeedReport {
            deviation_mm: self.planner.deviation_mm(),
            planned_s: self.planner.sink().planned_s,
            moves: self.moves,
            next_block: self.next_block,
            next_action: self.actions,
        };
        (report, result)
    }

    /// What a program that was read to its end leaves.
    fn feed_lines(&mut self, program: &Path) -> Result<Option<ProgramMemory>, ProgramError> {
        let mut commands = Commands::open(program, self.setup)?;
        if let Some(start) = commands.start() {
            let line = start.restart.line;
            let text = start.told();
            // Somebody who is there looks at the way before the machine takes it.
            if self.act(line, &text).is_err() || self.stop(line, StopKind::Program).is_err() {
                return Ok(None);
            }
        }
        while let Some(command) = commands.next() {
            let command = command.map_err(|diagnostic| ProgramError::Text {
                file: self.file.clone(),
                diagnostic: Box::new(diagnostic),
            })?;
            if let Some(what) = command.action.missing_ability() {
                let diagnostic = Box::new(refuse(what, program, command.line));
                return Err(ProgramError::Text {
                    file: self.file.clone(),
                    diagnostic,
                });
            }
            self.tell_modal(&commands);
            match self.execute(&command) {
                Ok(true) => {}
                Ok(false) => return Ok(Some(commands.left(&self.setup.memory))),
                Err(PlanError::Sink(_)) => break,
                Err(error) => {
                    let diagnostic = Box::new(explain(&error, program, command.line));
                    return Err(ProgramError::Text {
                        file: self.file.clone(),
                        diagnostic,
                    });
                }
            }
            self.report_blocks(false);
        }
        Ok(None)
    }

    /// `false` at the program's end.
    fn execute(&mut self, command: &Command) -> Result<bool, PlanError<QueueClosed>> {
        let line = command.line;
        match &command.action {
            Action::Move(motion) => self.push_move(motion, line)?,
            Action::Dwell { seconds } => {
                self.planner
                    .rest(&Step::Dwell {
                        seconds: *seconds,
                        line,
                    })
                    .map_err(PlanError::Sink)?;
            }
            Action::ProgramStop { optional, .. } => {
                if !optional || self.optional_stop {
                    self.stop(line, StopKind::Program)?;
                }
            }
            Action::ProgramEnd => return Ok(false),
            other => {
                if let Some(text) = describe(other) {
                    // Neither a message nor the next tool's number is a reason to stop.
                    if matches!(
                        other,
                        Action::Message(_) | Action::Print(_) | Action::SelectTool(_)
                    ) {
                        let is_message = matches!(other, Action::Message(_) | Action::Print(_));
                        self.announce(Moment::Block(self.next_block), line, is_message, &text);
                    } else {
                        self.act(line, &text)?;
                    }
                }
            }
        }
        Ok(true)
    }

    /// Comes to rest and waits to be told to go on.
    fn stop(&mut self, line: u32, kind: StopKind) -> Result<(), PlanError<QueueClosed>> {
        if let Some(onlooker) = &self.onlooker {
            let _gone = onlooker.send(FeederNews::Stop(kind));
        }
        self.last_line = 0;
        self.planner
            .rest(&Step::ProgramStop { line })
            .map_err(PlanError::Sink)
    }

    fn tell_modal(&mut self, commands: &Commands) {
        let Some(onlooker) = &self.onlooker else { return };
        let modal = commands.modal();
        if self.modal != Some(modal) {
            self.modal = Some(modal);
            let _gone = onlooker.send(FeederNews::Modal(self.next_block, modal));
        }
    }

    fn push_move(&mut self, motion: &Move, line: u32) -> Result<(), PlanError<QueueClosed>> {
        let mut motion = *motion;
        let steps = self
            .single_step
            .as_ref()
            .is_some_and(|single_step| single_step.load(Ordering::Relaxed));
        // Behind another stop, and before the first move, there is nothing to stop behind.
        if steps && self.last_line != line && self.last_line > 0 {
            self.stop(self.last_line, StopKind::Step)?;
        }
        if motion.kind == MoveKind::Rapid && self.setup.rapid_override < 1.0 {
            motion.feed = self.setup.rapid_override * self.rapid_speed(&motion.curve);
        }
        if let (MoveKind::Feed, Some(most)) = (motion.kind, self.setup.machine.max_feed_mm_s) {
            motion.feed = motion.feed.min(most);
        }
        let block = self.next_block;
        self.planner.push(&motion, line, block)?;
        self.next_block += 1;
        self.moves += 1;
        self.last_line = line;
        self.path_mm += motion.curve.length();
        if let Some(onlooker) = &self.onlooker {
            let queued = QueuedBlock {
                block,
                end: motion.curve.end(),
                feed_mm_s: motion.feed,
                path_mm: self.path_mm,
            };
            let _gone = onlooker.send(FeederNews::Queued(queued));
        }
        if self.with_blocks {
            let kind = match (motion.kind, &motion.curve) {
                (MoveKind::Rapid, _) => BlockKind::Rapid,
                (_, Curve::Line(_)) => BlockKind::Line,
                (_, Curve::Arc(_)) => BlockKind::Arc,
                (_, Curve::Involute(_)) => BlockKind::Involute,
                (_, Curve::Blend(_) | Curve::Spline(_)) => BlockKind::Other,
            };
            self.blocks.push_back(Open {
                block,
                line,
                kind,
                length_mm: motion.curve.length(),
            });
        }
        Ok(())
    }

    /// The speed in the feed metric at which the first axis is at its limit, along the chord of a rapid. Never 0.
    fn rapid_speed(&self, curve: &Curve) -> f64 {
        let limits = self.setup.machine.limits();
        let way = curve.end() - curve.start();
        let length = curve.length();
        let mut speed = f64::INFINITY;
        for axis in 0..way.len() {
            if limits.present[axis] && way[axis] != 0.0 {
                speed = speed.min(limits.velocity[axis] * length / way[axis].abs());
            }
        }
        if speed.is_finite() { speed.max(1e-3) } else { 1.0 }
    }

    /// Something of the periphery's that takes effect at rest.
    fn act(&mut self, line: u32, text: &str) -> Result<(), PlanError<QueueClosed>> {
        let action = self.actions;
        self.actions += 1;
        self.announce(Moment::Rest(action), line, false, text);
        self.planner
            .rest(&Step::Action { action, line })
            .map_err(PlanError::Sink)
    }

    fn announce(&self, moment: Moment, line: u32, is_message: bool, text: &str) {
        for news in self.news.iter().chain(&self.onlooker) {
            let notice = Notice {
                moment,
                line,
                is_message,
                text: text.to_owned(),
            };
            // Whoever does not listen any more misses nothing.
            let _gone = news.send(FeederNews::Notice(notice));
        }
    }

    /// Reports blocks whose plan is final.
    fn report_blocks(&mut self, all: bool) {
        let finished = &mut self.planner.sink_mut().finished;
        let keep = usize::from(!all);
        while finished.len() > keep {
            let Some((block, planned_s)) = finished.pop_front() else {
                break;
            };
            while let Some(open) = self.blocks.front() {
                if open.block > block {
                    break;
                }
                let plan = BlockPlan {
                    block: open.block,
                    line: open.line,
                    kind: open.kind,
                    length_mm: open.length_mm,
                    planned_s: if open.block == block { planned_s } else { 0.0 },
                };
                self.blocks.pop_front();
                for news in &self.news {
                    let _gone = news.send(FeederNews::Block(plan));
                }
            }
        }
    }
}

fn describe(action: &Action) -> Option<String> {
    Some(match action {
        Action::SelectTool(tool) => format!("select tool {tool}"),
        Action::ChangeTool(tool) => format!("change to tool {tool}"),
        Action::Spindle { direction, speed_rpm } => match direction {
            SpindleDirection::Stopped => "spindle stop".to_owned(),
            SpindleDirection::Clockwise => format!("spindle clockwise {speed_rpm} rpm"),
            SpindleDirection::CounterClockwise => format!("spindle counter-clockwise {speed_rpm} rpm"),
        },
        Action::Coolant { mist, flood } => {
            let word = |on: bool| if on { "on" } else { "off" };
            format!("mist {}, flood {}", word(*mist), word(*flood))
        }
        Action::ToolNumber(tool) => format!("tool {tool} is in the spindle"),
        Action::Message(text) | Action::Print(text) => text.clone(),
        _ => return None,
    })
}

/// Every error of a program, in the order of its lines, at most `limit` of them: what the text gets wrong and
/// what the machine refuses.
///
/// # Errors
/// The file cannot be read.
pub fn check(program: &Path, setup: &Setup, limit: usize) -> std::io::Result<Vec<Diagnostic>> {
    let reader = BufReader::with_capacity(256 * 1024, File::open(program)?);
    // Nothing is planned in earnest: the classic planner is enough to check moves.
    let rules = PathRules {
        planner: PlannerKind::Classic,
        ..setup.path_rules(1.0)
    };
    let mut planner = Planner::new(setup.path_limits(), rules, Nowhere);
    let mut errors = Vec::new();
    let mut block = 0;
    for command in Interpreter::new(reader, setup.interpreter_settings_for(program)) {
        let error = match command {
            Err(diagnostic) => Some(diagnostic),
            Ok(Command {
                line,
                action: Action::Move(motion),
            }) => {
                block += 1;
                match planner.push(&motion, line, block) {
                    Ok(()) => None,
                    // A move after one that was refused starts elsewhere: nothing new.
                    Err(PlanError::Gap { .. } | PlanError::Sink(_)) => {
                        planner = Planner::new(setup.path_limits(), rules, Nowhere);
                        planner
                            .push(&motion, line, block)
                            .err()
                            .map(|error| explain(&error, program, line))
                    }
                    Err(error) => Some(explain(&error, program, line)),
                }
            }
            Ok(_) => None,
        };
        errors.extend(error);
        if errors.len() >= limit {
            break;
        }
    }
    Ok(errors)
}

/// Takes a plan and forgets it.
struct Nowhere;

impl PlanSink for Nowhere {
    type Error = QueueClosed;
    fn segment(&mut self, _: &Segment) -> Result<(), QueueClosed> {
        Ok(())
    }
    fn step(&mut self, _: &Step) -> Result<(), QueueClosed> {
        Ok(())
    }
    fn exit(&mut self, _: u64, _: ExitSpeeds) {}
    fn finalise(&mut self, _: u64) {}
}

/// Something that the core cannot do yet, with its place.
fn refuse(what: &str, program: &Path, line: u32) -> Diagnostic {
    let text = line_text(program, line).unwrap_or_default();
    let message = format!("{what}: not possible on this machine yet");
    Diagnostic::about_line(Code::MissingAbility, line, &text, None, message)
}

/// A refused move with its place.
fn explain(error: &PlanError<QueueClosed>, program: &Path, line: u32) -> Diagnostic {
    let (code, letter) = match error {
        PlanError::Travel { axis, .. } => (Code::BeyondTravel, Some(axis.letter())),
        _ => (Code::MoveRefused, None),
    };
    // The planner is behind the line that is being read.
    let line = match error {
        PlanError::NoMotion { line } if *line > 0 => *line,
        _ => line,
    };
    let text = line_text(program, line).unwrap_or_default();
    Diagnostic::about_line(code, line, &text, letter, error.to_string())
}

/// The text of one line of a file; empty where there is none.
fn line_text(program: &Path, line: u32) -> std::io::Result<Vec<u8>> {
    let mut reader = BufReader::new(File::open(program)?);
    let mut bytes = Vec::new();
    for _ in 0..line {
        bytes.clear();
        if reader.read_until(b'\n', &mut bytes)? == 0 {
            break;
        }
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use evolvent_gcode::PathMode;
    use evolvent_machine::Machine;
    use evolvent_path::{Axes, Line};

    use super::*;

    #[test]
    fn the_tally_of_a_long_near_optimal_plan_does_not_grow() {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/machines/mill-3axis.toml");
        let mut machine = Machine::load(&file).unwrap();
        machine.path.planner = PlannerKind::Optimal;
        let setup = Setup::new(machine, file, String::new(), None).unwrap();
        let program = Path::new("none.ngc");
        let mut feeder = Feeder::new(program, &setup, 1.0, Nowhere, Vec::new(), false, false);
        let at = |k: u32| {
            let mut point = Axes::zeros();
            (point[0], point[1]) = (f64::from(k % 7), f64::from(k % 5));
            point
        };
        for k in 0..500 {
            let motion = Move {
                curve: Curve::Line(Line::new(at(k), at(k + 1)).unwrap()),
                kind: MoveKind::Feed,
                feed: 50.0,
                path_mode: PathMode::ExactPath,
            };
            let action = Action::Move(motion);
            assert!(feeder.execute(&Command { line: k, action }).unwrap());
        }
        let tally = feeder.planner.sink();
        assert!(tally.planned_s > 10.0, "{} s", tally.planned_s);
        let (parts, steps) = (tally.open.len(), tally.parts_of_step.len());
        assert!(parts < 100 && steps < 100, "{parts} parts, {steps} steps");
    }
}
