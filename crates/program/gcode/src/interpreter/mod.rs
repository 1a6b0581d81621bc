//! The interpreter: selects the next line, executes it, and outputs its commands as an iterator.

pub(crate) mod assumed_contact;
pub(crate) mod block_matching;
pub(crate) mod calls;
pub(crate) mod capture;
pub(crate) mod control_flow;
pub(crate) mod current_line;
mod dialect_advice;
pub(crate) mod effects;
mod error_history;
pub(crate) mod execute_line;
pub(crate) mod modal;
pub(crate) mod next_line;
pub(crate) mod o_words;
pub(crate) mod output;
pub(crate) mod preceding_thread;
pub(crate) mod restart;
pub(crate) mod surface_feed;
pub(crate) mod tool_change;
pub(crate) mod uncertain_state;
pub(crate) mod volatile;

use std::collections::BTreeMap;
use std::io::BufRead;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use evolvent_path::{AXES, Axes};

use crate::codes::modal_groups::FeedMode;
use crate::diagnostics::diagnostic::{Fault, Span};
use crate::diagnostics::foreign;
use crate::execution::execute::{Executor, MAX_HELD_COMMANDS};
use crate::interpreter::capture::Capture;
use crate::interpreter::control_flow::ControlFlow;
use crate::interpreter::current_line::{CurrentLine, SourceLocation};
use crate::interpreter::error_history::{ErrorHistory, MAX_REPEATED_ERRORS, Report};
use crate::interpreter::o_words::Frame;
use crate::interpreter::output::Output;
use crate::interpreter::preceding_thread::PrecedingThread;
use crate::interpreter::surface_feed::SurfaceFeed;
use crate::interpreter::tool_change::LineContinuation;
use crate::interpreter::uncertain_state::UncertainState;
use crate::parameters::values::Parameters;
use crate::state::machine_state::{ProgrammedFeed, State};
use crate::state::scope::Scope;
use crate::syntax::reader::LineReader;
use crate::syntax::statement::Statement;
use crate::{Action, CanonicalCommand, Code, Diagnostic, Origin, Settings, ToolTable};

/// Number of lines between two checks of the interrupt flag.
const INTERRUPT_LINES: u64 = 1024;

/// Interprets a program line by line, as commands are requested. Memory is bounded by the longest line and,
/// for loops and subroutines, by [`crate::ProgramLimits::max_body_bytes`].
///
/// After an error the iterator continues with the next line; the modal state is that before the faulty line.
/// So one pass finds many errors. Errors that likely follow from an earlier one alone are not reported, such
/// as an arc after a rejected move. A consumer that moves a machine stops at the first error. The iterator
/// ends after [`Action::ProgramEnd`], or after a read error.
///
/// ```
/// use evolvent_gcode::{Action, Interpreter, Settings};
///
/// let program = &b"G21 F600\nG1 X10\nM2\n"[..];
/// let commands: Result<Vec<_>, _> = Interpreter::new(program, Settings::default()).collect();
/// let commands = commands?;
/// assert!(matches!(commands[0].action, Action::Move(step) if step.feed_mm_s == 10.0));
/// assert_eq!(commands[1].action, Action::ProgramEnd);
/// # Ok::<(), evolvent_gcode::Diagnostic>(())
/// ```
pub struct Interpreter<R> {
    pub(crate) reader: LineReader<R>,
    pub(crate) settings: Settings,
    pub(crate) state: State,
    /// The state before the present line, restored if the line has an error.
    state_before: State,
    pub(crate) parameters: Parameters,
    tools: Option<ToolTable>,
    control_points: Vec<[f64; 3]>,
    pub(crate) current: CurrentLine,
    pub(crate) flow: ControlFlow,
    pub(crate) output: Output,
    errors: ErrorHistory,
    /// Outputs as set by the lines before a restart, by kind and number.
    pub(crate) changed_outputs: BTreeMap<(bool, u32), Action>,
    /// A thread that the lines before a restart have started; `None` after the first command.
    pub(crate) preceding_thread: Option<PrecedingThread>,
    /// The tool whose change has just started.
    pub(crate) started_change: Option<u32>,
    /// The remainder of a line that was divided by its tool change.
    pub(crate) continuation: Option<LineContinuation>,
    /// The profile that is being read for a cycle.
    pub(crate) capture: Option<Box<Capture>>,
    /// Number of lines that start with `/`: skipped, executed.
    block_delete_lines: (u64, u64),
    /// Whether the program started with `%`; unknown before the first line that is not blank.
    percent: Option<bool>,
    interrupt: Option<Arc<AtomicBool>>,
    pub(crate) finished: bool,
}

impl<R: BufRead> Interpreter<R> {
    /// Starts at the first line of `input`.
    pub fn new(input: R, settings: Settings) -> Self {
        let unhomed = settings.unhomed;
        let mut state = State::new(&settings);
        let mut parameters = Parameters::new();
        for (index, value) in &settings.parameters {
            if value.is_finite() {
                parameters.set_numbered(*index as usize, *value);
            }
        }
        state.publish(&settings, &mut parameters);
        state.load_work(&parameters);
        let tools = settings.tools.as_ref();
        if let Some(tool) = tools.and_then(|tools| tools.get(settings.tool)) {
            parameters.publish_tool(tool);
        }
        parameters.commit();
        let mut surface_feed = SurfaceFeed::default();
        for spindle in 0..crate::SPINDLES {
            surface_feed.set_speed(&state.spindle_action(spindle));
        }
        Self {
            reader: LineReader::new(input, settings.limits.max_line_bytes),
            state_before: state,
            state,
            parameters,
            tools: settings.tools.clone(),
            control_points: Vec::new(),
            settings,
            current: CurrentLine::default(),
            flow: ControlFlow::default(),
            output: Output {
                surface_feed,
                ..Output::default()
            },
            errors: ErrorHistory::with_initial_state(UncertainState::at_start(unhomed)),
            changed_outputs: BTreeMap::new(),
            preceding_thread: None,
            started_change: None,
            continuation: None,
            capture: None,
            block_delete_lines: (0, 0),
            percent: None,
            interrupt: None,
            finished: false,
        }
    }

    /// Position of the machine after the lines read so far, in machine coordinates (mm, degrees).
    #[must_use]
    pub fn position(&self) -> Axes {
        self.state.position
    }

    /// Last physical line read, from 1; 0 before the first.
    #[must_use]
    pub fn line(&self) -> u32 {
        self.reader.line()
    }

    /// Enables or disables block delete (skipping lines that start with `/`) from the next line read.
    pub fn set_block_delete(&mut self, on: bool) {
        self.settings.block_delete = on;
    }

    /// Number of lines that start with `/` so far: skipped with block delete on, executed with block delete
    /// off.
    #[must_use]
    pub fn block_delete_lines(&self) -> (u64, u64) {
        self.block_delete_lines
    }

    /// Sets a flag with which another thread can stop the interpreter: the next item is then the error
    /// [`Code::Interrupted`], and the last. This also stops a program that computes for a long time without
    /// motion.
    pub fn set_interrupt(&mut self, flag: Arc<AtomicBool>) {
        self.interrupt = Some(flag);
    }

    /// The axes along which the line read last may leave the travel only because earlier lines with errors
    /// had no effect, or because no line so far defines the position of an axis of [`Settings::unhomed`].
    #[must_use]
    pub fn uncertain_axes(&self) -> [bool; AXES] {
        let is_rotated = self.state.rotation[0] != 0.0;
        self.errors
            .uncertain_state
            .uncertain_axes(&self.current.text, is_rotated)
    }

    /// The active F word after the lines read so far, and its feed for linear axes, mm/s; `None` except in
    /// G94.
    #[must_use]
    pub fn feed_per_minute(&self) -> Option<(f64, f64)> {
        match self.state.modes.feed? {
            ProgrammedFeed::PerMinute { word, linear_mm_s }
                if self.state.modes.feed_mode == FeedMode::PerMinute =>
            {
                Some((word, linear_mm_s))
            }
            _ => None,
        }
    }

    /// The value of a numbered parameter after the lines read so far, lengths of offsets in mm; 0 for numbers
    /// that do not exist. To keep parameters from run to run, read them here and supply them in
    /// [`Settings::parameters`].
    #[must_use]
    pub fn parameter(&self, number: u32) -> f64 {
        self.scope().stored(number as usize)
    }

    /// The tool table after the lines read so far; G10 writes it.
    #[must_use]
    pub fn tools(&self) -> Option<&ToolTable> {
        self.tools.as_ref()
    }

    /// Number of subroutine files read so far.
    #[must_use]
    pub fn subroutine_file_count(&self) -> usize {
        self.flow.library.file_count()
    }

    /// The subroutine files read so far, in order: name and text as read. Stored with the program they allow
    /// running it again without the folders.
    pub fn subroutine_files(&self) -> impl Iterator<Item = (&str, Vec<u8>)> {
        self.flow.library.files()
    }

    pub(crate) fn state(&self) -> &State {
        &self.state
    }

    pub(crate) fn is_finished(&self) -> bool {
        self.finished
    }

    /// Whether a subroutine is active, or lines are being skipped or collected.
    pub(crate) fn is_inside(&self) -> bool {
        self.flow.frames.len() > 1
            || self.flow.skip.is_some()
            || self.flow.definition.is_some()
            || self.continuation.is_some()
    }

    /// Whether M2 or M30 has been executed.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        self.state.ended
    }

    /// Executes a line and discards its commands. Returns the line number of a probing move among them, whose
    /// result is unknown.
    pub(crate) fn execute_without_output(&mut self) -> Result<Option<u32>, Box<Diagnostic>> {
        let mut probed = None;
        self.advance()?;
        if self.state.cutter.held.is_none() && self.capture.is_none() {
            let thread = self.preceding_thread.get_or_insert_default();
            for command in self.output.pending.drain(..) {
                thread.observe(&command.action, command.line);
                match command.action {
                    Action::Output { index, on, .. } => {
                        let synchronised = false;
                        let action = Action::Output {
                            index,
                            on,
                            synchronised,
                        };
                        self.changed_outputs.insert((false, index), action);
                    }
                    Action::AnalogOutput { index, value, .. } => {
                        let synchronised = false;
                        let action = Action::AnalogOutput {
                            index,
                            value,
                            synchronised,
                        };
                        self.changed_outputs.insert((true, index), action);
                    }
                    Action::Probe { .. } => probed = Some(command.line),
                    _ => {}
                }
            }
            self.output.contour_checker.discard();
            self.output.lines_without_command = 0;
        }
        Ok(probed)
    }

    pub(crate) fn scope(&self) -> Scope<'_> {
        Scope {
            parameters: &self.parameters,
            state: &self.state,
            settings: &self.settings,
            line: self.current.number,
        }
    }

    /// Executes another statement on its own state.
    pub(crate) fn executor<'a>(
        &'a mut self,
        statement: &'a Statement,
        state: &'a mut State,
        number: u32,
    ) -> Executor<'a> {
        Executor {
            state,
            line: statement,
            number,
            ..self.executor_of_line(false)
        }
    }

    /// Executes the present statement.
    #[inline]
    pub(crate) fn executor_of_line(&mut self, skips_end: bool) -> Executor<'_> {
        let number = self.program_line();
        let (origin, calls) = (self.origin(), self.current.location.calls.clone());
        Executor {
            origin,
            calls,
            state: &mut self.state,
            line: &self.current.statement,
            settings: &self.settings,
            tools: &mut self.tools,
            parameters: &mut self.parameters,
            control_points: &mut self.control_points,
            commands: &mut self.output.pending,
            changed: &mut self.output.changed,
            contour_checker: &mut self.output.contour_checker,
            skips_end,
            number,
        }
    }

    /// The line number for commands: of the program, not of another file.
    pub(crate) fn program_line(&self) -> u32 {
        if self.current.location.is_of_program {
            self.current.number
        } else {
            self.current.calling_line
        }
    }

    /// The present line if it is not in the program itself.
    #[inline]
    pub(crate) fn origin(&self) -> Option<Origin> {
        Some(Origin {
            file: self.current.location.file.clone()?,
            line: self.current.number,
        })
    }

    /// Records the position of the following lines.
    #[cold]
    fn record_location(&mut self) {
        let file_of = |frame: &Frame| frame.lines.as_ref().and_then(|lines| lines.file.clone());
        let Some(frame) = self.flow.frames.last() else {
            return;
        };
        self.current.location = SourceLocation {
            file: file_of(frame),
            calls: frame.calls.clone(),
            is_of_program: self.flow.frames.iter().all(|frame| file_of(frame).is_none()),
        };
        self.flow.location_changed = false;
    }

    /// Reads and executes a line; its commands go to `pending`.
    fn advance(&mut self) -> Result<(), Box<Diagnostic>> {
        let result = self.execute_next_line();
        if self.capture.is_some() {
            result.and(self.finish_profile())
        } else {
            result
        }
    }

    fn execute_next_line(&mut self) -> Result<(), Box<Diagnostic>> {
        self.output.lines_without_command += 1;
        if let Some(fault) = self.check_limits() {
            self.finished = true;
            return Err(self.locate(fault));
        }
        if let Some(continuation) = self.continuation.take() {
            return self.with_rollback(|interpreter| interpreter.continue_line(continuation));
        }
        if self.flow.location_changed {
            self.record_location();
        }
        self.current.block.clear();
        match self.next_line() {
            Ok(true) if self.ends_by_percent() => return self.end_of_lines(),
            Ok(true) => {}
            Ok(false) => return self.end_of_lines(),
            Err(fault) => {
                self.finished = fault.code == Code::ReadFailed;
                return Err(Box::new(fault.locate(self.reader.line(), &self.current.text)));
            }
        }
        self.with_rollback(Self::interpret)
    }

    /// Executes a part of a line; if it fails, the line has no effect.
    fn with_rollback(
        &mut self,
        execute: impl FnOnce(&mut Self) -> Result<(), Fault>,
    ) -> Result<(), Box<Diagnostic>> {
        let (length_before, mark) = (self.output.pending.len(), self.output.contour_checker.mark());
        let is_g99_alone = self.state.is_g99_alone;
        self.output.changed.clear();
        self.parameters.foreign_reads.begin();
        execute(self).map_err(|fault| {
            self.output.contour_checker.roll_back(mark);
            let fault = foreign::explain(
                &self.current.text,
                &self.current.block,
                fault,
                self.dialect_context(),
            );
            let removed = self
                .output
                .changed
                .iter()
                .filter(|changed| changed.removed)
                .count();
            self.output.pending.truncate(length_before - removed);
            while let Some(changed) = self.output.changed.pop() {
                if changed.removed {
                    self.output.pending.insert(changed.index, changed.command);
                } else if let Some(command) = self.output.pending.get_mut(changed.index) {
                    *command = changed.command;
                }
            }
            self.parameters.roll_back();
            // With the commands of the line its warnings are removed: they are given with the next line that
            // has cause for them.
            self.parameters.foreign_reads.roll_back();
            self.state.is_g99_alone = is_g99_alone;
            self.locate(fault)
        })
    }

    fn locate(&self, fault: Fault) -> Box<Diagnostic> {
        let mut diagnostic = Box::new(fault.locate(self.current.number, &self.current.text));
        diagnostic.file = self.current.location.file.as_deref().map(Box::from);
        diagnostic.calls = self.current.location.calls.innermost_first();
        diagnostic
    }

    /// The error of too many lines without a command, or of too many commands that wait for a move in the
    /// plane.
    fn check_limits(&self) -> Option<Fault> {
        let span = Span::new(0, self.current.text.len());
        if self.output.lines_without_command > self.settings.limits.max_silent_lines {
            let message = format!(
                "{} lines without a command for the machine: an endless loop",
                self.settings.limits.max_silent_lines
            );
            return Some(
                Fault::new(Code::TooManySteps, span, message)
                    .help("check whether the condition of the loop ever changes"),
            );
        }
        if self.output.pending.len() > MAX_HELD_COMMANDS {
            let message =
                format!("more than {MAX_HELD_COMMANDS} commands between two moves with cutter compensation");
            return Some(Fault::new(Code::BodyTooLong, span, message).help("write G40 before them"));
        }
        let interrupted = self.output.lines_without_command % INTERRUPT_LINES == 1
            && self
                .interrupt
                .as_ref()
                .is_some_and(|flag| flag.load(Ordering::Relaxed));
        interrupted.then(|| Fault::new(Code::Interrupted, span, "the interpreter was interrupted"))
    }

    /// The error of a loop that repeats lines with errors.
    fn too_many_repeats(&self) -> Fault {
        let span = Span::new(0, self.current.text.len());
        let message = format!(
            "lines with errors were executed {MAX_REPEATED_ERRORS} more times in loops; lines after this one \
             were not checked"
        );
        Fault::new(Code::TooManySteps, span, message).help("correct the errors reported before this one")
    }

    fn pop_pending(&mut self) -> Option<CanonicalCommand> {
        let command = self.output.pending.pop_front()?;
        let held = &mut self.state.cutter.held;
        *held = held.map(|held| held - 1);
        self.output.contour_checker.output(&command);
        Some(self.output.surface_feed.split(command))
    }

    /// The end without M2.
    pub(crate) fn end(&mut self) {
        let mut state = self.state;
        let statement = Statement::default();
        let number = self.reader.line();
        let is_mdi = self.settings.is_mdi;
        let mut executor = self.executor(&statement, &mut state, number);
        if is_mdi {
            executor.end_mdi();
        } else {
            executor.end();
        }
        self.parameters.commit();
        self.state = state;
        self.finished = true;
    }
}

impl<R: BufRead> Iterator for Interpreter<R> {
    type Item = Result<CanonicalCommand, Diagnostic>;

    fn next(&mut self) -> Option<Self::Item> {
        if let Some(piece) = self.output.surface_feed.next() {
            return Some(Ok(piece));
        }
        loop {
            // A move that cutter compensation may still change is held, with everything after it.
            let held = self.state.cutter.held;
            if held != Some(0)
                && self.capture.is_none()
                && let Some(command) = self
                    .output
                    .contour_checker
                    .finding()
                    .or_else(|| self.pop_pending())
            {
                self.output.lines_without_command = 0;
                if let Some(mut thread) = self.preceding_thread.take()
                    && let Some(first) = thread.observe(&command.action, command.line)
                {
                    self.finished = true;
                    return Some(Err(self.inside_thread(first)));
                }
                return Some(Ok(command));
            }
            if self.finished {
                return None;
            }
            if let Err(diagnostic) = self.advance() {
                let is_assumed = self.is_assumed(&diagnostic);
                // The program continues as if it were not aborted.
                self.finished &= !(is_assumed && diagnostic.code == Code::ActiveComment);
                let report = self
                    .errors
                    .record(&diagnostic, &self.current, &self.state, self.finished);
                self.finished |= matches!(report, Report::Last | Report::TooOften);
                match report {
                    Report::New | Report::Last if is_assumed => self.warn_of_assumed(&diagnostic),
                    Report::New | Report::Last => return Some(Err(*diagnostic)),
                    Report::TooOften => return Some(Err(*self.locate(self.too_many_repeats()))),
                    Report::Skipped => {}
                }
            }
        }
    }
}

impl<R: BufRead> std::iter::FusedIterator for Interpreter<R> {}

impl<R> std::fmt::Debug for Interpreter<R> {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter
            .debug_struct("Interpreter")
            .field("state", &self.state)
            .finish_non_exhaustive()
    }
}
