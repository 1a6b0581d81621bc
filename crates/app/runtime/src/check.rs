//! What is wrong with a program, without moving anything.

use std::collections::{BTreeMap, BTreeSet};
use std::convert::Infallible;
use std::path::Path;

use evolvent_config::open_regular;
use evolvent_gcode::{Action, Code, Command, Diagnostic, Interpreter, Move, Origin, Settings};
use evolvent_motion::ProbeMove;
use evolvent_planner::{MoveValidator, PlanError};

use crate::job::Setup;
use crate::log_file::log_objection;
use crate::periphery::{Changer, TOOL_CHANGE_CODE, nobody_changes, waits_for};
use crate::probing::{ProbeObjection, objection as probe_objection};
use crate::refusal::{about_line, about_line_with, at_origin, cannot_turn, explain};
use crate::signal_check::signal_objection;
use crate::source::reader_of;
use crate::threading::ThreadCheck;
use crate::turning::turning;
use crate::user_code::UserCodes;

/// How far a program is looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CheckBounds {
    /// Errors after which nothing more is looked at.
    pub errors: usize,
    /// Commands for the machine in all.
    pub commands: u64,
    /// Commands after which no line farther down has been reached: a loop that makes parts until somebody stops it would
    /// be followed for ever.
    pub round: u64,
    /// Whether the programs of the machine's own commands (M100 to M199) have to be there.
    pub user_codes: bool,
    /// Whether somebody can confirm a tool change by the operator.
    pub confirms_tools: bool,
}

impl CheckBounds {
    /// To its end, unless it goes round for a million commands.
    #[must_use]
    pub fn whole(errors: usize) -> Self {
        Self {
            errors,
            commands: u64::MAX,
            round: 1_000_000,
            user_codes: true,
            confirms_tools: true,
        }
    }

    /// As far as can be looked at while somebody waits, about a second at the most: a million commands, a hundred thousand
    /// of them in a loop.
    #[must_use]
    pub fn while_one_waits(errors: usize) -> Self {
        Self {
            errors,
            commands: 1_000_000,
            round: 100_000,
            user_codes: true,
            confirms_tools: true,
        }
    }
}

/// What was found.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Checked {
    /// Errors in the order in which a run would meet them: what the text gets wrong and what the machine refuses.
    pub errors: Vec<Diagnostic>,
    /// Lines that are right but probably not what was meant.
    pub warnings: Vec<Warning>,
    /// The line behind which nothing was looked at, where a bound ended it.
    pub up_to: Option<u32>,
}

/// A line that is right but probably not what was meant.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Warning {
    /// The file, where it is not the program itself but one of a subroutine.
    pub file: Option<String>,
    /// Physical line in the file, from 1.
    pub line: u32,
    /// What it does, and what to write if that was not meant.
    pub message: String,
}

impl Warning {
    fn of(command: &Command, message: String) -> Self {
        let origin = command.origin.as_ref();
        Self {
            file: origin.map(|origin| origin.file.to_string()),
            line: origin.map_or(command.line, |origin| origin.line),
            message,
        }
    }
}

/// Reads a program as a run would, and asks of every command whether the machine can do it. Nothing is planned.
///
/// # Errors
/// The file cannot be read.
pub fn check(program: &Path, setup: &Setup, bounds: CheckBounds) -> std::io::Result<Checked> {
    check_while(program, setup, bounds, || true)
}

/// The same as long as `go_on` says so; it is asked at every command.
pub(crate) fn check_while(
    program: &Path,
    setup: &Setup,
    bounds: CheckBounds,
    mut go_on: impl FnMut() -> bool,
) -> std::io::Result<Checked> {
    let reader = reader_of(open_regular(program)?);
    let limits = *setup.path_limits().axes();
    let mut admission = MoveValidator::new(&limits);
    let mut checked = Checked::default();
    let mut machine = MachineCheck::new(setup, bounds);
    // Places that the machine has refused or that were warned of: loops come by again and again.
    let mut told = BTreeSet::new();
    let mut has_strayed = false;
    let mut threads = ThreadCheck::new(setup);
    let (mut commands, mut round, mut farthest) = (0, 0, 0);
    let settings = Settings {
        // What waits for an input goes on as on a machine that does its part.
        waits_succeed: true,
        ..setup.interpreter_settings_for(program)
    };
    for command in Interpreter::new(reader, settings) {
        let command = match command {
            Err(diagnostic) => {
                let line = diagnostic.line;
                // Nothing comes after it.
                let is_last = diagnostic.code == Code::TooManySteps;
                checked.errors.push(diagnostic);
                if is_last || checked.errors.len() >= bounds.errors {
                    checked.up_to = Some(line);
                    break;
                }
                continue;
            }
            Ok(command) => command,
        };
        commands += 1;
        round += 1;
        if command.line > farthest {
            (farthest, round) = (command.line, 0);
        }
        if commands > bounds.commands || round > bounds.round || !go_on() {
            checked.up_to = Some(farthest);
            break;
        }
        let place = || place_of(&command);
        if let Action::Warning(text) = &command.action {
            if told.insert(place()) {
                checked.warnings.push(Warning::of(&command, text.clone()));
            }
            continue;
        }
        if let Some((first, refusal)) = threads.see(&command, setup)
            && told.insert(place_of(&first))
        {
            checked
                .errors
                .push(at_origin(&first, program, |file, line| refusal.told(file, line)));
        }
        if let Action::Thread { curve, .. } = &command.action {
            admission.stand_at(&curve.end());
        }
        let objection = match &command.action {
            Action::Move(motion) => {
                let refused = match admission.admit::<Infallible>(motion) {
                    // A move after one that was refused starts elsewhere: nothing new.
                    Err(PlanError::Gap { .. }) => {
                        admission = MoveValidator::new(&limits);
                        admission.admit::<Infallible>(motion).err()
                    }
                    other => other.err(),
                };
                let follows = has_strayed && refused.as_ref().is_some_and(|error| was_there(error, motion));
                has_strayed |= matches!(refused, Some(PlanError::Travel { .. }));
                refused.filter(|_| !follows).map(Objection::Plan)
            }
            Action::Probe {
                curve, feed, toward, ..
            } => {
                // What follows begins where the probe stops.
                admission.stand_at(&curve.end());
                let order = ProbeMove {
                    curve: *curve,
                    feed: *feed,
                    toward: *toward,
                };
                probe_objection(&order, setup).map(Objection::Probe)
            }
            action => match signal_objection(&setup.machine.signals, action) {
                Some(objection) => Some(Objection::Tool(objection)),
                None => machine.objection(action),
            },
        };
        let Some(objection) = objection else { continue };
        if !told.insert(place()) {
            continue;
        }
        checked.errors.push(at_origin(&command, program, |file, line| {
            objection.told(file, line)
        }));
        if checked.errors.len() >= bounds.errors {
            checked.up_to = Some(command.line);
            break;
        }
    }
    Ok(checked)
}

/// The line of a command: the same of a subroutine's file, whoever calls it.
fn place_of(command: &Command) -> (Option<Origin>, u32) {
    match &command.origin {
        Some(origin) => (Some(origin.clone()), 0),
        None => (None, command.line),
    }
}

/// Whether a move is beyond the travel only because it starts where a refused move was to lead.
fn was_there(error: &PlanError<Infallible>, motion: &Move) -> bool {
    let PlanError::Travel { axis, reached, limit } = error else {
        return false;
    };
    let start = motion.curve.start()[axis.index()];
    (start - limit).signum() == (reached - limit).signum() && (reached - limit).abs() <= (start - limit).abs()
}

/// What the machine has against a command.
enum Objection {
    Plan(PlanError<Infallible>),
    Words(String),
    Tool((String, String)),
    Turning(String),
    Probe(ProbeObjection),
}

impl Objection {
    fn told(self, file: &Path, line: u32) -> Diagnostic {
        match self {
            Self::Plan(error) => explain(&error, file, line),
            Self::Words(text) => about_line(text, file, line),
            Self::Tool((message, help)) => about_line_with(message, Some(help), file, line),
            Self::Turning(what) => cannot_turn(what, file, line),
            Self::Probe(objection) => objection.told(file, line),
        }
    }
}

/// What the machine can do, command after command.
struct MachineCheck<'a> {
    setup: &'a Setup,
    bounds: CheckBounds,
    codes: UserCodes,
    /// Each program is looked for once, however often it is called.
    programs: BTreeMap<u32, Option<String>>,
    /// The tool in the spindle.
    tool: u32,
    /// Which tool that is, is known.
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
                // Once: what follows goes on as if it were known.
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
