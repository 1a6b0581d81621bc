//! The result of probing moves that a check assumes, and the consequences of that assumption.

use std::io::BufRead;

use evolvent_path::AXES;

use crate::codes::modal_groups::{Group, MCode, Motion, NonModal};
use crate::interpreter::Interpreter;
use crate::interpreter::error_history::MAX_REPEATED_ERRORS;
use crate::interpreter::o_words::OpenBlock;
use crate::parameters::assumption::Assumption;
use crate::parameters::values::{PROBE_TRIPPED, PROBED};
use crate::state::scope::Scope;
use crate::syntax::block::{Keyword, OWord};
use crate::syntax::parser::parse;
use crate::syntax::statement::Statement;
use crate::{Action, CanonicalCommand, Diagnostic};

impl<R: BufRead> Interpreter<R> {
    /// The axes along which the line read last moves from or to a position that depends on a probing move
    /// without a result ([`Settings::probes_succeed`](crate::Settings::probes_succeed)).
    #[must_use]
    pub fn assumed_axes(&self) -> [bool; AXES] {
        match &self.parameters.assumption {
            Some(assumption) => assumption.target,
            None => [false; AXES],
        }
    }

    /// Called before a line: records whether it is in a branch that depends on the result.
    #[cold]
    pub(super) fn begin_line_with_assumption(&mut self) {
        let Some(assumption) = &mut self.parameters.assumption else {
            return;
        };
        assumption.begin_line();
        let Some(frame) = self.flow.frames.last_mut() else {
            return;
        };
        frame.assumed_from = frame.assumed_from.filter(|from| *from <= frame.open_blocks.len());
        frame.exit_from = frame.exit_from.filter(|from| *from <= frame.open_blocks.len());
        assumption.is_in_branch = frame.assumed_from.is_some();
    }

    /// Whether the present line has read a value that depends on the result.
    pub(super) fn reads_assumed(&self) -> bool {
        let assumption = self.parameters.assumption.as_ref();
        assumption.is_some_and(|assumption| assumption.values_depend())
    }

    /// Records a line that is skipped because of the result. With another result it might leave the
    /// subroutine or a loop, and then the lines after it would not be executed.
    #[cold]
    pub(super) fn record_skipped_exit(&mut self, word: Option<&OWord>) {
        let leaves_subroutine = self.flow.frames.len() > 1
            && match word {
                Some(word) => word.keyword == Keyword::Return,
                None => self.returns_by_number(),
            };
        let from = match word {
            _ if leaves_subroutine => Some(0),
            Some(word) if matches!(word.keyword, Keyword::Break | Keyword::Continue) => {
                let Ok(name) = self.label(word) else { return };
                let is_loop = |open: &OpenBlock| open.is_loop() && open.name() == name;
                self.frame()
                    .open_blocks
                    .iter()
                    .rposition(is_loop)
                    .map(|index| index + 1)
            }
            _ => None,
        };
        let frame = self.frame();
        frame.exit_from = match (frame.exit_from, from) {
            (Some(outer), Some(from)) => Some(outer.min(from)),
            (outer, from) => outer.or(from),
        };
    }

    /// Whether a skipped line has M99.
    fn returns_by_number(&mut self) -> bool {
        let scope = Scope {
            parameters: &self.parameters,
            state: &self.state,
            settings: &self.settings,
            line: self.current.number,
        };
        let block = &mut self.current.block;
        if parse(&self.current.text, block, &scope).is_err() {
            // A value on the line may exist only with another result.
            let code = self.current.text.split(|byte| matches!(byte, b'(' | b';')).next();
            return code.is_some_and(|code| without_spaces(code).windows(3).any(|word| word == b"M99"));
        }
        block
            .words
            .iter()
            .any(|word| word.letter == b'M' && word.value == 99.0)
    }

    /// Called after a condition: its branch depends on the result if the condition has read it.
    pub(super) fn record_condition(&mut self) {
        let Some(assumption) = &mut self.parameters.assumption else {
            return;
        };
        if !assumption.values_depend() {
            return;
        }
        if let Some(frame) = self.flow.frames.last_mut() {
            frame.assumed_from.get_or_insert(frame.open_blocks.len());
        }
    }

    /// Whether lines of a subroutine that is called here depend on the result.
    pub(super) fn inherited_assumption(&self) -> Option<usize> {
        let assumption = self.parameters.assumption.as_ref()?;
        assumption.is_in_branch.then_some(0)
    }

    /// Whether the present line ends the program only with the assumed contact. The lines after it are then
    /// executed as if it had not been reached.
    #[inline]
    pub(super) fn skips_end(&self) -> bool {
        let Some(assumption) = &self.parameters.assumption else {
            return false;
        };
        let is_uncertain =
            assumption.is_in_branch || self.flow.frames.iter().any(|frame| frame.exit_from.is_some());
        is_uncertain
            && matches!(self.current.statement.m(Group::Stop), Some(MCode::End(_)))
            && assumption.repeated_skips < MAX_REPEATED_ERRORS
    }

    /// Warns of such a line, once per loop or subroutine.
    #[cold]
    pub(super) fn warn_of_skipped_end(&mut self) {
        let file = self.origin().map(|origin| origin.file);
        let location = (file, self.current.number);
        let Some(assumption) = &mut self.parameters.assumption else {
            return;
        };
        if assumption.skipped_ends.insert(location) {
            self.warn(
                "no contact is known: the program ends here; the lines after it are checked as if it \
                 continued"
                    .to_owned(),
            );
        } else {
            assumption.repeated_skips += 1;
        }
    }

    /// Called after an executed line: records which values it leaves unknown, and which are known again.
    pub(super) fn update_assumption(&mut self) {
        let line = &self.current.statement;
        if let Some(Motion::Probe { .. }) = line.motion()
            && self.settings.probes_succeed
        {
            self.assume_contact();
            return;
        }
        let Some(assumption) = &mut self.parameters.assumption else {
            return;
        };
        let state = &self.state;
        let rotated = state.rotation[0] != 0.0;
        update(assumption, line, state.modes.incremental, rotated);
    }

    /// The results of the probing move of this line, as if it made contact at its end.
    #[cold]
    fn assume_contact(&mut self) {
        for axis in 0..AXES {
            let value = self.state.program_position(axis);
            self.parameters.set_numbered(PROBED + axis, value);
        }
        self.parameters.set_numbered(PROBE_TRIPPED, 1.0);
        self.parameters.commit();
        if self.parameters.assumption.is_none() {
            self.parameters.assumption = Some(Box::default());
            let text = "no contact is known: the check assumes contact at the end of every probing move; an \
                        (ABORT), an error or the end of the travel that depends on it is only a warning";
            self.warn(text.to_owned());
        }
        let Some(assumption) = &mut self.parameters.assumption else {
            return;
        };
        let (line, modes) = (&self.current.statement, &self.state.modes);
        update(assumption, line, modes.incremental, self.state.rotation[0] != 0.0);
        let rotated = self.state.rotation[0] != 0.0;
        for axis in 0..AXES {
            let moves =
                line.axis(axis).is_some() || rotated && axis < 2 && (line.has(b'X') || line.has(b'Y'));
            // The move leads to its end at most; it stops before.
            assumption.position[axis] |= moves || line.has_polar() && axis < 2;
        }
    }

    /// Outputs a warning of the present line.
    pub(crate) fn warn(&mut self, text: String) {
        let (line, origin) = (self.program_line(), self.origin());
        self.output.pending.push_back(CanonicalCommand {
            line,
            action: Action::Warning(text),
            origin,
            calls: self.current.location.calls.clone(),
            feed_mm_rev: None,
            feed_spindle: 0,
            continues: false,
        });
    }

    /// Whether an error may be caused by an assumed contact alone.
    #[cold]
    pub(super) fn is_assumed(&self, diagnostic: &Diagnostic) -> bool {
        let Some(assumption) = &self.parameters.assumption else {
            return false;
        };
        let plane = self.state.plane().map_or([0, 1], |plane| {
            let (first, second, _) = plane.axes();
            [first, second]
        });
        let has_axes = self
            .current
            .block
            .words
            .iter()
            .any(|word| b"XYZABCUVW@^".contains(&word.letter));
        assumption.explains(diagnostic.code, plane, has_axes)
    }

    /// Outputs a warning in place of an error that may be caused by an assumed contact.
    #[cold]
    pub(super) fn warn_of_assumed(&mut self, diagnostic: &Diagnostic) {
        self.warn(format!("no contact is known: {}", diagnostic.message));
    }
}

/// The form in which words are compared: in capitals.
fn without_spaces(code: &[u8]) -> Vec<u8> {
    code.iter()
        .filter(|byte| !byte.is_ascii_whitespace())
        .map(u8::to_ascii_uppercase)
        .collect()
}

/// The positions and offsets that an executed line leaves unknown.
#[cold]
fn update(assumption: &mut Assumption, line: &Statement, incremental: bool, rotated: bool) {
    let line_depends = assumption.line_depends();
    let non_modal = line.non_modal();
    let sets_offset = matches!(
        non_modal,
        Some(NonModal::SetData | NonModal::SetOffset | NonModal::LocalOffset)
    ) || line.length_offset().is_some();
    if sets_offset {
        for axis in 0..AXES {
            assumption.offset[axis] |=
                line.axis(axis).is_some() && (line_depends || assumption.position[axis]);
        }
        if line.has(b'R') && line_depends {
            (assumption.offset[0], assumption.offset[1]) = (true, true);
        }
        if line.motion().is_none() {
            assumption.target = assumption.position;
            return;
        }
    }
    let start = assumption.position;
    match non_modal {
        Some(NonModal::SetHome(_)) => assumption.home |= assumption.position.contains(&true),
        Some(NonModal::Home(_)) => {
            for axis in 0..AXES {
                if line.axis(axis).is_some() || !line.has_axes() {
                    assumption.position[axis] = assumption.home;
                }
            }
        }
        _ => {}
    }
    let Some(motion) = line.motion() else {
        assumption.target = std::array::from_fn(|axis| start[axis] || assumption.position[axis]);
        return;
    };
    let in_machine_coordinates = non_modal == Some(NonModal::MachineCoordinates);
    let has_both = line.has(b'X') && line.has(b'Y');
    for axis in 0..AXES {
        let is_coupled = rotated && axis < 2 && !in_machine_coordinates;
        let has_offset = !in_machine_coordinates
            && (assumption.offset[axis] || is_coupled && (assumption.offset[0] || assumption.offset[1]));
        if line.axis(axis).is_some() {
            let is_given = !incremental && !has_offset && (!is_coupled || has_both);
            assumption.position[axis] = line_depends || !is_given && (start[axis] || has_offset);
        } else if is_coupled && (line.has(b'X') || line.has(b'Y')) || line.has_polar() && axis < 2 {
            assumption.position[axis] |= line_depends || start[0] || start[1];
        }
    }
    let end = assumption.position;
    let is_straight = matches!(motion, Motion::Rapid | Motion::Linear | Motion::Probe { .. });
    assumption.target = std::array::from_fn(|axis| {
        let uses_plane = line_depends && line.has_axes();
        end[axis] || !is_straight && (start[axis] || uses_plane || assumption.offset[axis])
    });
}
