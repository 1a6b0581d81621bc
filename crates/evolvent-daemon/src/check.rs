//! What is wrong with a program: found without moving anything, and told with its place.

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;

use evolvent_gcode::{Action, Code, Command, Diagnostic, Interpreter};
use evolvent_machine::PlannerKind;
use evolvent_motion::QueueClosed;
use evolvent_plan::{ExitSpeeds, PathRules, PlanError, PlanSink, Planner, Segment, Step};

use crate::job::Setup;
use crate::turning::turning;

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

/// Every error of a program, in the order of its lines, at most `limit` of them: what the text gets wrong and
/// what the machine refuses.
///
/// # Errors
/// The file cannot be read.
pub fn check(program: &Path, setup: &Setup, limit: usize) -> std::io::Result<Vec<Diagnostic>> {
    check_while(program, setup, limit, || true)
}

/// The same as long as `go_on` says so; it is asked at every command.
pub(crate) fn check_while(
    program: &Path,
    setup: &Setup,
    limit: usize,
    mut go_on: impl FnMut() -> bool,
) -> std::io::Result<Vec<Diagnostic>> {
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
            Ok(Command {
                line,
                action: Action::Turning(cycle),
            }) => turning(&cycle, setup)
                .err()
                .map(|what| cannot_turn(what, program, line)),
            Ok(Command { line, action }) => action.missing_ability().map(|what| refuse(what, program, line)),
        };
        errors.extend(error);
        if errors.len() >= limit || !go_on() {
            break;
        }
    }
    Ok(errors)
}

/// Takes a plan and forgets it.
pub(crate) struct Nowhere;

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
pub(crate) fn refuse(what: &str, program: &Path, line: u32) -> Diagnostic {
    about_line(format!("{what}: not possible on this machine yet"), program, line)
}

/// Something that cannot be done in this line.
pub(crate) fn about_line(message: String, program: &Path, line: u32) -> Diagnostic {
    let text = line_text(program, line).unwrap_or_default();
    Diagnostic::about_line(Code::MissingAbility, line, &text, None, message)
}

/// A turning cycle that does not fit, with its place.
pub(crate) fn cannot_turn(what: String, program: &Path, line: u32) -> Diagnostic {
    let text = line_text(program, line).unwrap_or_default();
    Diagnostic::about_line(Code::MoveRefused, line, &text, Some('Q'), what)
}

/// A refused move with its place.
pub(crate) fn explain(error: &PlanError<QueueClosed>, program: &Path, line: u32) -> Diagnostic {
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
