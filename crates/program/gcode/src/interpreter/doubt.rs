//! What is not known behind a refused line, so that its successors are not blamed for it.
//!
//! A refused line has no effect. The lines behind it were written for its effect: arcs begin at its end, words have the meaning
//! of its mode, moves the feed of its F. Errors that are likely to come from there alone are not reported; they show in the next
//! run if they are errors of their own.

use crate::Code;
use crate::codes::modal_groups::{GCode, Group, Motion};
use crate::state::machine_state::State;
use crate::syntax::block::{Block, Word};
use crate::syntax::statement::Statement;

/// What the refused lines so far have left in doubt.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Doubt {
    /// The place along X, Y and Z.
    place: [bool; 3],
    /// The motion mode.
    mode: bool,
    feed: bool,
    /// The contour to which cutter compensation applies.
    contour: bool,
    /// Parameters: the line may have set some.
    values: bool,
}

impl Doubt {
    pub(crate) fn is_any(&self) -> bool {
        self.mode || self.feed || self.contour || self.values || self.place != [false; 3]
    }

    /// Adds what a refused line would have changed: by its words if it could be read, else by the letters in its text.
    #[cold]
    pub(crate) fn refuse(&mut self, code: Code, text: &[u8], block: &Block, state: &State) {
        let is_read = is_of_words(code);
        let has = |letter: u8| {
            if is_read {
                block.words.iter().any(|word| word.letter == letter)
            } else {
                text.iter().any(|byte| byte.to_ascii_uppercase() == letter)
            }
        };
        for (place, letter) in self.place.iter_mut().zip(*b"XYZ") {
            *place |= has(letter) || has(b'@') || has(b'^');
        }
        self.mode |= has(b'G');
        self.feed |= has(b'F') || has(b'S');
        self.contour |= state.cutter.is_on() || has(b'G');
        self.values |= !block.assignments.is_empty() || (!is_read && text.contains(&b'='));
    }

    /// Removes what an executed line has made known again.
    pub(crate) fn accept(&mut self, line: &Statement, state: &State) {
        if matches!(line.motion(), Some(Motion::Rapid | Motion::Linear)) && !state.modes.incremental {
            for (place, letter) in self.place.iter_mut().zip(*b"XYZ") {
                *place &= !line.has(letter);
            }
        }
        self.mode &= line.motion_code().is_none();
        self.feed &= !line.has(b'F');
        self.contour &= state.cutter.is_on();
    }

    /// Whether the error of a line may be due to what is in doubt alone.
    pub(crate) fn excuses(&self, code: Code, block: &Block, state: &State) -> bool {
        let plane = state.plane().map_or([0, 1], |plane| {
            let (first, second, _) = plane.axes();
            [first, second]
        });
        let place = plane.iter().any(|axis| self.place[*axis]);
        let mode = self.mode && !block.words.iter().any(is_motion);
        match code {
            Code::ArcNoChord
            | Code::ArcRadiusTooSmall
            | Code::ArcRadiusMismatch
            | Code::ArcRefused
            | Code::InvoluteRefused
            | Code::InvoluteInside
            | Code::InvoluteEqualRadii
            | Code::InvoluteMissed
            | Code::ProfileRefused => place,
            Code::CompensationEntry | Code::CompensationGouge => self.contour,
            Code::CompensationActive => self.contour || mode,
            Code::UnusedWord
            | Code::AxisWithoutMotion
            | Code::WordMissing
            | Code::ArcCentreMissing
            | Code::ArcEndMissing
            | Code::ArcOffsetAcrossPlane
            | Code::InvoluteEndMissing
            | Code::InvoluteCentreMissing
            | Code::InvoluteRadiusMissing => mode,
            Code::UndefinedParameter | Code::Arithmetic => self.values,
            Code::FeedMissing | Code::FeedZero | Code::SpindleSpeedMissing => self.feed,
            _ => false,
        }
    }
}

fn is_motion(word: &Word) -> bool {
    let code = (word.letter == b'G').then(|| GCode::from_tenths((10.0 * word.value + 0.5) as u32));
    code.flatten().is_some_and(|code| code.group() == Group::Motion)
}

/// Whether the words of the refused line could be read. Otherwise some may be missing.
fn is_of_words(code: Code) -> bool {
    code.as_str() >= Code::UnknownG.as_str()
}
