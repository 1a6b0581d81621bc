//! The errors so far, and which further ones are reported.

use std::collections::BTreeSet;
use std::sync::Arc as Shared;

use crate::interpreter::current_line::CurrentLine;
use crate::interpreter::uncertain_state::UncertainState;
use crate::state::machine_state::State;
use crate::{Code, Diagnostic};

/// Number of errors after which a program is abandoned.
const MAX_ERRORS: usize = 1000;

/// Number of repeated errors, from lines reported before, after which a program is abandoned: loops repeat
/// them. About 50 ms.
pub(super) const MAX_REPEATED_ERRORS: u32 = 10_000;

/// The errors so far, which decide whether a further one is reported.
#[derive(Default)]
pub(super) struct ErrorHistory {
    /// State that rejected lines have left unknown.
    pub(super) uncertain_state: UncertainState,
    /// Number of repeated errors.
    pub(super) repeated: u32,
    /// Positions of the errors so far: a loop reports each once.
    pub(super) reported: BTreeSet<(Option<Shared<str>>, u32)>,
    /// Files with a carriage return inside a line: usually every line has one.
    returns: BTreeSet<Option<Shared<str>>>,
}

/// The treatment of an error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Report {
    /// It is reported.
    New,
    /// It is reported, and the program is abandoned.
    Last,
    /// It follows from an earlier one, or repeats one.
    Skipped,
    /// As `Skipped`, and errors have been repeated too often: the program is abandoned.
    TooOften,
}

impl ErrorHistory {
    /// No errors so far; `uncertain_state` is the state that is unknown before the first line.
    pub(super) fn with_initial_state(uncertain_state: UncertainState) -> Self {
        Self {
            uncertain_state,
            ..Self::default()
        }
    }

    /// Records an error of a line. `is_finished` is true if the program has ended with it anyway.
    pub(super) fn record(
        &mut self,
        diagnostic: &Diagnostic,
        line: &CurrentLine,
        state: &State,
        is_finished: bool,
    ) -> Report {
        let file: Option<Shared<str>> = diagnostic.file.as_deref().map(Shared::from);
        let follows = self.uncertain_state.explains(diagnostic.code, &line.block, state);
        self.uncertain_state
            .record_rejected(diagnostic.code, &line.text, &line.block, state);
        let follows = follows || diagnostic.code == Code::StrayReturn && !self.returns.insert(file.clone());
        let is_new = !follows && self.reported.insert((file, diagnostic.line));
        if is_finished || self.reported.len() >= MAX_ERRORS {
            return Report::Last;
        }
        if is_new {
            return Report::New;
        }
        self.repeated += 1;
        if self.repeated >= MAX_REPEATED_ERRORS {
            Report::TooOften
        } else {
            Report::Skipped
        }
    }
}
