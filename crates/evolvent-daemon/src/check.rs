//! What is wrong with a program, without moving anything.

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::fs::File;
use std::path::Path;

use evolvent_gcode::{Action, Diagnostic, Interpreter};
use evolvent_plan::{Admission, PlanError};

use crate::job::Setup;
use crate::refusal::{about_line, cannot_turn, explain, refuse};
use crate::source::reader_of;
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
        }
    }
}

/// What was found.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Checked {
    /// Errors in the order in which a run would meet them: what the text gets wrong and what the machine refuses.
    pub errors: Vec<Diagnostic>,
    /// The line behind which nothing was looked at, where a bound ended it.
    pub up_to: Option<u32>,
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
    let reader = reader_of(File::open(program)?);
    let limits = *setup.path_limits().axes();
    let mut admission = Admission::new(&limits);
    let mut checked = Checked::default();
    let codes = UserCodes::of(setup);
    // Each program is looked for once, however often it is called.
    let mut objections: BTreeMap<u32, Option<String>> = BTreeMap::new();
    let (mut commands, mut round, mut farthest) = (0, 0, 0);
    for command in Interpreter::new(reader, setup.interpreter_settings_for(program)) {
        let error = match command {
            Err(diagnostic) => Some(diagnostic),
            Ok(command) => {
                commands += 1;
                round += 1;
                if command.line > farthest {
                    (farthest, round) = (command.line, 0);
                }
                if commands > bounds.commands || round > bounds.round || !go_on() {
                    checked.up_to = Some(farthest);
                    break;
                }
                let line = command.line;
                match (&command.action, command.action.missing_ability()) {
                    (_, Some(what)) => Some(refuse(what, program, line)),
                    (Action::Move(motion), None) => match admission.admit::<Infallible>(motion) {
                        Ok(()) => None,
                        // A move after one that was refused starts elsewhere: nothing new.
                        Err(PlanError::Gap { .. }) => {
                            admission = Admission::new(&limits);
                            let again = admission.admit::<Infallible>(motion).err();
                            again.map(|error| explain(&error, program, line))
                        }
                        Err(error) => Some(explain(&error, program, line)),
                    },
                    (Action::UserCommand { number, .. }, None) if bounds.user_codes => objections
                        .entry(*number)
                        .or_insert_with(|| codes.objection(*number))
                        .clone()
                        .map(|objection| about_line(objection, program, line)),
                    (Action::Turning(cycle), None) => turning(cycle, setup)
                        .err()
                        .map(|what| cannot_turn(what, program, line)),
                    _ => None,
                }
            }
        };
        checked.errors.extend(error);
        if checked.errors.len() >= bounds.errors {
            checked.up_to = Some(checked.errors.last().map_or(farthest, |error| error.line));
            break;
        }
    }
    Ok(checked)
}
