//! Checks a program without moving anything.

use std::collections::{BTreeMap, BTreeSet};
use std::convert::Infallible;
use std::io::Read;
use std::path::Path;

use evolvent_config::open_regular;
use evolvent_gcode::{Action, CanonicalCommand, Code, Diagnostic, Interpreter, Move, Origin, Settings};
use evolvent_machine::Limits;
use evolvent_motion::ProbeMove;
use evolvent_path::{AXES, AxisLetter, AxisMask, Curve};
use evolvent_planner::{MoveValidator, PlanError, TRAVEL_SLACK};

use crate::check_bounds::{CheckBound, CheckBounds, Unchecked};
use crate::job::Setup;
use crate::log_file::log_objection;
use crate::periphery::{Changer, TOOL_CHANGE_CODE, nobody_changes, waits_for};
use crate::probing::{ProbeObjection, objection as probe_objection};
use crate::refusal::{about_line, about_line_with, at_origin, cannot_turn, explain};
use crate::signal_check::signal_objection;
use crate::source::reader_of;
use crate::threading::ThreadCheck;
use crate::turning::turning;
use crate::unlikely_feed::UnlikelyFeed;
use crate::user_code::UserCodes;

/// Result of a check.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Checked {
    /// Errors in the order in which a run would meet them: errors of the text, and commands that the machine
    /// rejects.
    pub errors: Vec<Diagnostic>,
    /// Lines that are valid but probably not intended.
    pub warnings: Vec<Warning>,
    /// The unchecked part, if a bound ended the check.
    pub unchecked: Option<Unchecked>,
}

/// A line that is valid but probably not intended.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Warning {
    /// The file, if it is that of a subroutine rather than the program itself.
    pub file: Option<String>,
    /// Physical line in the file, from 1.
    pub line: u32,
    /// What the line does, and what to write instead.
    pub message: String,
}

impl std::fmt::Display for Warning {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let file = self.file.as_deref().unwrap_or("the program");
        write!(formatter, "{file}:{}: {}", self.line, self.message)
    }
}

impl Warning {
    fn of(command: &CanonicalCommand, message: String) -> Self {
        let origin = command.origin.as_ref();
        Self {
            file: origin.map(|origin| origin.file.to_string()),
            line: origin.map_or(command.line, |origin| origin.line),
            message,
        }
    }
}

/// Reads a program as a run would, and checks for every command that the machine can carry it out. Nothing is
/// planned.
///
/// # Errors
/// The file cannot be read.
pub fn check(program: &Path, setup: &Setup, bounds: CheckBounds) -> std::io::Result<Checked> {
    check_while(program, setup, bounds, || true)
}

/// Like [`check`], but stops when `go_on` returns `false`; it is called for every command.
pub(crate) fn check_while(
    program: &Path,
    setup: &Setup,
    bounds: CheckBounds,
    mut go_on: impl FnMut() -> bool,
) -> std::io::Result<Checked> {
    let reader = reader_of(open_regular(program)?);
    let settings = Settings {
        // Waits for an input succeed, as on a machine that works.
        waits_succeed: true,
        probes_succeed: true,
        ..setup.interpreter_settings_for(program)
    };
    let mut check = ProgramCheck::new(program, setup, bounds);
    let mut interpreter = Interpreter::new(reader, settings);
    while let Some(command) = interpreter.next() {
        let step = match command {
            Ok(command) => {
                check.assumed = interpreter.assumed_axes();
                check.uncertain = interpreter.uncertain_axes();
                check.warn_of_feed(&command, interpreter.feed_per_minute());
                check.command(&command, &mut go_on)
            }
            Err(diagnostic) => check.error_in_text(diagnostic),
        };
        if step == CheckStep::End {
            break;
        }
    }
    if let Some(unchecked) = &mut check.checked.unchecked {
        unchecked.name_loop(interpreter.outermost_loop());
    }
    check.checked.warnings.extend(setup.missing_folders());
    if !holds_block(program)? {
        check.checked.warnings.push(Warning {
            file: None,
            line: 1,
            message: "the program contains no block; check that the file is complete".to_owned(),
        });
    }
    Ok(check.checked)
}

/// Whether a program has more than comments, blank lines and `%`. Reads only as far as the first block.
fn holds_block(program: &Path) -> std::io::Result<bool> {
    let mut comment_ends_at = None;
    for byte in reader_of(open_regular(program)?).bytes() {
        match (comment_ends_at, byte?) {
            (Some(end), byte) if byte == end || byte == b'\n' => comment_ends_at = None,
            (Some(_), _) => {}
            (None, b'(') => comment_ends_at = Some(b')'),
            (None, b';') => comment_ends_at = Some(b'\n'),
            (None, b'%') => {}
            (None, byte) if byte.is_ascii_whitespace() => {}
            (None, _) => return Ok(true),
        }
    }
    Ok(false)
}

/// Whether the check continues.
#[derive(Clone, Copy, PartialEq, Eq)]
enum CheckStep {
    Next,
    End,
}

/// The check of one program, command by command.
struct ProgramCheck<'a> {
    program: &'a Path,
    setup: &'a Setup,
    bounds: CheckBounds,
    checked: Checked,
    limits: Limits,
    validator: MoveValidator,
    machine: MachineCheck<'a>,
    threads: ThreadCheck,
    /// Lines that the machine has rejected, to report each once: loops repeat them.
    reported: BTreeSet<(Option<Origin>, u32)>,
    /// Lines with a warning, by whether it was about an assumed contact.
    warned: BTreeSet<(Option<Origin>, u32, bool)>,
    /// Axes whose position depends on a probe contact that is only assumed.
    assumed: [bool; AXES],
    /// Axes whose position depends on lines with errors, which have no effect here.
    uncertain: [bool; AXES],
    /// Axes that are not homed and have not moved yet: their position is unknown.
    anywhere: AxisMask,
    /// A move beyond the travel was rejected.
    has_strayed: bool,
    /// The last such move depends on an assumed contact or on a line with an error.
    strayed_openly: bool,
    unlikely_feed: UnlikelyFeed,
    /// Number of commands.
    commands: u64,
    /// Number of commands since a new line was reached.
    round: u64,
    /// The last line reached.
    farthest: u32,
}

impl<'a> ProgramCheck<'a> {
    fn new(program: &'a Path, setup: &'a Setup, bounds: CheckBounds) -> Self {
        let limits = *setup.path_limits().axes();
        Self {
            program,
            setup,
            bounds,
            checked: Checked::default(),
            limits,
            validator: MoveValidator::new(&limits),
            machine: MachineCheck::new(setup, bounds),
            threads: ThreadCheck::new(setup),
            reported: BTreeSet::new(),
            warned: BTreeSet::new(),
            assumed: [false; AXES],
            uncertain: [false; AXES],
            anywhere: setup.unhomed,
            has_strayed: false,
            strayed_openly: false,
            unlikely_feed: UnlikelyFeed::new(&limits),
            commands: 0,
            round: 0,
            farthest: 0,
        }
    }

    /// Handles an error of the text.
    fn error_in_text(&mut self, diagnostic: Diagnostic) -> CheckStep {
        let line = diagnostic.line;
        // Nothing follows this error.
        let is_last = diagnostic.code == Code::TooManySteps;
        self.checked.errors.push(diagnostic);
        if is_last {
            return self.end_at(line, CheckBound::Errors);
        }
        self.end_if_full(line)
    }

    /// Checks a command whose text is correct.
    fn command(&mut self, command: &CanonicalCommand, go_on: &mut impl FnMut() -> bool) -> CheckStep {
        self.count(command);
        if let Some(bound) = self.bound_reached() {
            return self.end_at(self.farthest, bound);
        }
        if !go_on() {
            return self.end_at(self.farthest, CheckBound::Cancelled);
        }
        if let Action::Warning(text) = &command.action {
            self.warn(command, text.clone(), false);
            return CheckStep::Next;
        }
        if let Some((first, refusal)) = self.threads.observe(command, self.setup)
            && self.reported.insert(location_of(&first))
        {
            self.checked
                .errors
                .push(at_origin(&first, self.program, |file, line| {
                    refusal.diagnostic(file, line)
                }));
        }
        if let Action::Thread { curve, .. } = &command.action {
            self.validator.set_position(&curve.end());
        }
        // A curve starts at a programmed position, so its axes are known before it, even if the move to that
        // position was none because the axis was already there.
        let is_curve =
            matches!(&command.action, Action::Move(motion) if !matches!(motion.curve, Curve::Line(_)));
        if is_curve {
            self.know_where_sent();
        }
        let objection = self.objection(&command.action);
        if matches!(command.action, Action::Move(_)) {
            self.know_where_sent();
        }
        let Some(objection) = objection else {
            return CheckStep::Next;
        };
        if objection.is_of_travel(&self.uncertain) {
            return CheckStep::Next;
        }
        if objection.is_of_travel(&self.assumed) {
            let diagnostic = objection.diagnostic(self.program, command.line);
            self.warn(
                command,
                format!("no contact is known: {}", diagnostic.message),
                true,
            );
            return CheckStep::Next;
        }
        if !self.reported.insert(location_of(command)) {
            return CheckStep::Next;
        }
        self.checked
            .errors
            .push(at_origin(command, self.program, |file, line| {
                objection.diagnostic(file, line)
            }));
        self.end_if_full(command.line)
    }

    /// Axes that the program has positioned are at a known position from here on.
    fn know_where_sent(&mut self) {
        for axis in self.anywhere.axes() {
            if !self.uncertain[axis] {
                self.anywhere = self.anywhere.without(AxisMask::one(axis));
            }
        }
    }

    fn warn(&mut self, command: &CanonicalCommand, text: String, is_assumed: bool) {
        let (origin, line) = location_of(command);
        if self.warned.insert((origin, line, is_assumed)) {
            self.checked.warnings.push(Warning::of(command, text));
        }
    }

    fn warn_of_feed(&mut self, command: &CanonicalCommand, feed: Option<(f64, f64)>) {
        if let Some(text) = self.unlikely_feed.warning(command, feed) {
            self.warn(command, text, false);
        }
    }

    fn count(&mut self, command: &CanonicalCommand) {
        self.commands += 1;
        self.round += 1;
        if command.line > self.farthest {
            (self.farthest, self.round) = (command.line, 0);
        }
    }

    fn bound_reached(&self) -> Option<CheckBound> {
        if self.round > self.bounds.round {
            return Some(CheckBound::Line {
                line: self.farthest,
                commands: self.bounds.round,
            });
        }
        let commands = self.bounds.commands;
        (self.commands > commands).then_some(CheckBound::Commands { commands })
    }

    fn end_at(&mut self, up_to: u32, bound: CheckBound) -> CheckStep {
        self.checked.unchecked = Some(Unchecked { up_to, bound });
        CheckStep::End
    }

    /// Ends the check once the maximum number of errors is found.
    fn end_if_full(&mut self, line: u32) -> CheckStep {
        if self.checked.errors.len() >= self.bounds.errors {
            self.end_at(line, CheckBound::Errors)
        } else {
            CheckStep::Next
        }
    }

    /// The machine's objection to an action, if any.
    fn objection(&mut self, action: &Action) -> Option<Objection> {
        match action {
            Action::Move(motion) => self.objection_to_move(motion),
            Action::Probe {
                curve,
                feed_mm_s: feed,
                toward,
                ..
            } => {
                // The next move begins where the probe stops.
                self.validator.set_position(&curve.end());
                let order = ProbeMove {
                    curve: *curve,
                    feed_mm_s: *feed,
                    toward: *toward,
                };
                probe_objection(&order, self.setup).map(Objection::Probe)
            }
            action => match signal_objection(&self.setup.machine.signals, action) {
                Some(objection) => Some(Objection::Tool(objection)),
                None => self.machine.objection(action),
            },
        }
    }

    fn objection_to_move(&mut self, motion: &Move) -> Option<Objection> {
        let refused = match self.validator.validate::<Infallible>(motion) {
            // A move after a rejected one starts elsewhere, which is no further error.
            Err(PlanError::Gap { .. }) => {
                self.validator = MoveValidator::new(&self.limits);
                self.validator.validate::<Infallible>(motion).err()
            }
            other => other.err(),
        };
        if let Some(error @ PlanError::Travel { axis, limit, .. }) = &refused {
            if self.anywhere.contains(axis.index()) {
                let own = self.leaves_elsewhere(motion);
                if own.is_some() {
                    (self.has_strayed, self.strayed_openly) = (true, false);
                }
                return own.map(Objection::Plan);
            }
            let is_open = |axis: usize| self.assumed[axis] || self.uncertain[axis];
            // If an earlier move beyond the travel was an assumption, one that certainly ends beyond it is a
            // separate error.
            let is_own =
                self.strayed_openly && !is_open(axis.index()) && ends_beyond(motion, axis.index(), *limit);
            let follows = self.has_strayed && was_there(error, motion) && !is_own;
            self.has_strayed = true;
            self.strayed_openly = is_open(axis.index());
            let own = if follows {
                self.leaves_elsewhere(motion)
            } else {
                refused
            };
            return own.map(Objection::Plan);
        }
        refused.map(Objection::Plan)
    }

    /// Of a move that was rejected because one axis was beyond its travel before: the first other axis that
    /// the move takes out of its travel. For an axis with unknown position only the end is checked.
    fn leaves_elsewhere(&self, motion: &Move) -> Option<PlanError<Infallible>> {
        let (low, high) = motion.curve.bounds(0.0, motion.curve.domain());
        let (start, end) = (motion.curve.start(), motion.curve.end());
        AxisLetter::ALL.into_iter().find_map(|axis| {
            let i = axis.index();
            let (lowest, highest) = (self.limits.travel_min[i], self.limits.travel_max[i]);
            let is_known = self.limits.present[i] && !self.assumed[i] && !self.uncertain[i];
            let comes_from_anywhere = self.anywhere.contains(i);
            if !is_known || !comes_from_anywhere && !(lowest..=highest).contains(&start[i]) {
                return None;
            }
            let (low, high) = match comes_from_anywhere {
                true => (end[i], end[i]),
                false => (low[i], high[i]),
            };
            let beyond = |reached: f64, limit: f64| PlanError::Travel { axis, reached, limit };
            if low < lowest - TRAVEL_SLACK {
                Some(beyond(low, lowest))
            } else {
                (high > highest + TRAVEL_SLACK).then(|| beyond(high, highest))
            }
        })
    }
}

/// The file and line of a command. A subroutine's line is the same for every caller.
fn location_of(command: &CanonicalCommand) -> (Option<Origin>, u32) {
    match &command.origin {
        Some(origin) => (Some(origin.clone()), 0),
        None => (None, command.line),
    }
}

/// Whether a move that starts beyond a limit also ends beyond it.
fn ends_beyond(motion: &Move, axis: usize, limit: f64) -> bool {
    let (start, end) = (motion.curve.start()[axis], motion.curve.end()[axis]);
    (end - limit).signum() == (start - limit).signum() && end != limit
}

/// Whether a move is beyond the travel only because it starts at the end of a rejected move.
fn was_there(error: &PlanError<Infallible>, motion: &Move) -> bool {
    let PlanError::Travel { axis, reached, limit } = error else {
        return false;
    };
    let start = motion.curve.start()[axis.index()];
    (start - limit).signum() == (reached - limit).signum() && (reached - limit).abs() <= (start - limit).abs()
}

/// The machine's objection to a command.
enum Objection {
    Plan(PlanError<Infallible>),
    Words(String),
    Tool((String, String)),
    Turning(String),
    Probe(ProbeObjection),
}

impl Objection {
    /// Whether one of these axes would leave its travel.
    fn is_of_travel(&self, axes: &[bool; AXES]) -> bool {
        match self {
            Self::Plan(PlanError::Travel { axis, .. })
            | Self::Probe(ProbeObjection::Travel(PlanError::Travel { axis, .. })) => axes[axis.index()],
            _ => false,
        }
    }

    fn diagnostic(self, file: &Path, line: u32) -> Diagnostic {
        match self {
            Self::Plan(error) => explain(&error, file, line),
            Self::Words(text) => about_line(text, file, line),
            Self::Tool((message, help)) => about_line_with(message, Some(help), file, line),
            Self::Turning(what) => cannot_turn(what, file, line),
            Self::Probe(objection) => objection.diagnostic(file, line),
        }
    }
}

/// What the machine can do, command by command.
struct MachineCheck<'a> {
    setup: &'a Setup,
    bounds: CheckBounds,
    codes: UserCodes,
    /// Executables of user-defined M codes; each is looked up once.
    programs: BTreeMap<u32, Option<String>>,
    /// The tool in the spindle.
    tool: u32,
    /// Whether the tool in the spindle is known.
    is_tool_named: bool,
}

impl<'a> MachineCheck<'a> {
    fn new(setup: &'a Setup, bounds: CheckBounds) -> Self {
        Self {
            setup,
            bounds,
            codes: UserCodes::of(setup),
            programs: BTreeMap::new(),
            tool: setup.tool,
            is_tool_named: setup.tool_unknown.is_none(),
        }
    }

    /// The executable of a user-defined M code, or of M6.
    fn program(&mut self, number: u32) -> Option<Objection> {
        if !self.bounds.user_codes {
            return None;
        }
        let found = self.programs.entry(number);
        let objection = found.or_insert_with(|| self.codes.objection(number)).clone();
        objection.map(Objection::Words)
    }

    fn objection(&mut self, action: &Action) -> Option<Objection> {
        match action {
            Action::ToolNumber(number) => {
                self.tool = *number;
                self.is_tool_named = true;
            }
            Action::BeginToolChange(_) | Action::ChangeTool(_) if !self.is_tool_named => {
                // Reported once: the check then continues as if the tool were known.
                self.is_tool_named = true;
                let text = self.setup.tool_unknown.clone().unwrap_or_default();
                return Some(Objection::Words(text));
            }
            Action::ChangeTool(number) => {
                let present = std::mem::replace(&mut self.tool, *number);
                match waits_for(self.setup.machine.program.tool_change, *number, present) {
                    Some(Changer::Operator) if !self.bounds.confirms_tools => {
                        return Some(Objection::Tool(nobody_changes(*number, present)));
                    }
                    Some(Changer::Program) => return self.program(TOOL_CHANGE_CODE),
                    _ => {}
                }
            }
            Action::UserCommand { number, .. } => return self.program(*number),
            Action::Log(log) => return log_objection(log).map(Objection::Tool),
            Action::Turning(cycle) => return turning(cycle, self.setup).err().map(Objection::Turning),
            _ => {}
        }
        None
    }
}
