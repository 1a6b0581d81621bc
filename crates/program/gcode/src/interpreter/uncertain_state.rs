//! State that is unknown after a rejected line, or before the first line, so that errors caused by it alone
//! are not reported.
//!
//! A rejected line has no effect. The lines after it were written for its effect: arcs start at its end,
//! words have the meaning of its mode, moves use its feed. Errors that are likely caused by that alone are
//! not reported; the next run reports them if they remain.

use evolvent_path::{AXES, AxisLetter};

use crate::Code;
use crate::codes::modal_groups::{GCode, Group, Motion, NonModal};
use crate::state::machine_state::State;
use crate::syntax::block::{Block, Word};
use crate::syntax::statement::Statement;

/// State that is unknown after the lines so far.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct UncertainState {
    /// Axes still at a start position that is undefined.
    start: [bool; AXES],
    /// Axes with an offset that was set from such a position.
    offset: [bool; AXES],
    /// The position along X, Y and Z.
    position: [bool; 3],
    /// The motion mode.
    mode: bool,
    feed: bool,
    /// The contour to which cutter compensation applies.
    contour: bool,
    /// Parameters: the line may have set some.
    parameters: bool,
    /// The reference of coordinates: units, distance mode, offsets, tool length.
    frame: bool,
}

impl UncertainState {
    /// The state before the first line: the positions of these axes are undefined.
    pub(crate) const fn at_start(unknown: [bool; AXES]) -> Self {
        Self {
            start: unknown,
            offset: [false; AXES],
            position: [false; 3],
            mode: false,
            feed: false,
            contour: false,
            parameters: false,
            frame: false,
        }
    }

    pub(crate) fn is_uncertain(&self) -> bool {
        let has_position =
            self.position != [false; 3] || self.start != [false; AXES] || self.offset != [false; AXES];
        self.mode || self.feed || self.contour || self.parameters || self.frame || has_position
    }

    /// Adds what a rejected line would have changed: by its words if they could be read, otherwise by the
    /// letters of its text outside comments.
    #[cold]
    pub(crate) fn record_rejected(&mut self, code: Code, text: &[u8], block: &Block, state: &State) {
        if code == Code::ActiveComment {
            // Comments have no words: an (ABORT) that the check does not execute changes nothing.
            return;
        }
        let is_parsed = has_parsed_words(code);
        let code_text = if is_parsed {
            Vec::new()
        } else {
            outside_comments(text)
        };
        let has = |letter: u8| {
            if is_parsed {
                block.words.iter().any(|word| word.letter == letter)
            } else {
                code_text.contains(&letter)
            }
        };
        for (position, letter) in self.position.iter_mut().zip(*b"XYZ") {
            *position |= has(letter) || has(b'@') || has(b'^');
        }
        // An invalid code may be any code on the control for which the line was written.
        let may_set = |changes: fn(&GCode, &State) -> bool| {
            let sets = |word: &Word| code_of(word).is_none_or(|code| changes(&code, state));
            let mut codes = block.words.iter().filter(|word| word.letter == b'G');
            if is_parsed { codes.any(sets) } else { has(b'G') }
        };
        // The plane decides which words an arc needs.
        self.mode |= may_set(|code, state| {
            let changes_motion = code.group() == Group::Motion && *code != GCode::Motion(state.motion);
            changes_motion || code.group() == Group::Plane
        });
        self.feed |= has(b'F') || has(b'S');
        self.contour |= state.cutter.is_on() || may_set(|code, _| code.group() == Group::CutterCompensation);
        self.frame |= if is_parsed {
            block.words.iter().any(changes_frame)
        } else {
            has(b'T') || may_change_frame(&code_text)
        };
        self.parameters |= !block.assignments.is_empty() || has(b'=');
    }

    /// Removes what an executed line defines again.
    pub(crate) fn record_executed(&mut self, line: &Statement, state: &State) {
        let is_rotated = state.rotation[0] != 0.0;
        if matches!(line.motion(), Some(Motion::Rapid | Motion::Linear)) && !state.modes.incremental {
            for (position, letter) in self.position.iter_mut().zip(*b"XYZ") {
                *position &= !line.has(letter);
            }
            // In rotated coordinates X alone moves both axes of the machine, from an undefined Y.
            let has_both = line.has(b'X') && line.has(b'Y');
            for (index, (start, axis)) in self.start.iter_mut().zip(AxisLetter::ALL).enumerate() {
                let is_commanded = if is_rotated && index < 2 {
                    has_both
                } else {
                    line.has(axis.letter() as u8)
                };
                *start &= !is_commanded;
            }
        }
        // An offset that is set from an undefined position is undefined too.
        let sets_offset = match line.non_modal() {
            Some(NonModal::SetOffset) => true,
            Some(NonModal::SetData) => matches!(line.word(b'L'), Some(10.0 | 11.0 | 20.0)),
            _ => false,
        };
        if sets_offset {
            for (index, axis) in AxisLetter::ALL.into_iter().enumerate() {
                self.offset[index] |= self.start[index] && line.has(axis.letter() as u8);
            }
            if is_rotated && (line.has(b'X') || line.has(b'Y')) && (self.start[0] || self.start[1]) {
                (self.offset[0], self.offset[1]) = (true, true);
            }
        }
        self.mode &= line.motion_code().is_none();
        self.feed &= !line.has(b'F');
        self.contour &= state.cutter.is_on();
    }

    /// The axes along which a move may leave the travel only because of rejected lines or of the start.
    pub(crate) fn uncertain_axes(&self, text: &[u8], is_rotated: bool) -> [bool; AXES] {
        let all = self.frame || self.parameters && text.contains(&b'#');
        let level = is_rotated && (self.offset[0] || self.offset[1]);
        std::array::from_fn(|axis| {
            let is_unknown = self.start[axis] || self.offset[axis] || level && axis < 2;
            all || is_unknown || self.position.get(axis) == Some(&true)
        })
    }

    /// Whether the error of a line may be caused by unknown state alone.
    pub(crate) fn explains(&self, code: Code, block: &Block, state: &State) -> bool {
        let plane = state.plane().map_or([0, 1], |plane| {
            let (first, second, _) = plane.axes();
            [first, second]
        });
        let position = plane.iter().any(|axis| self.position[*axis] || self.start[*axis]);
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
            | Code::ProfileRefused => position,
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
            Code::UndefinedParameter | Code::Arithmetic => self.parameters,
            Code::FeedMissing | Code::FeedZero | Code::SpindleSpeedMissing => self.feed,
            _ => false,
        }
    }
}

/// Whether a word changes the reference of coordinates.
fn changes_frame(word: &Word) -> bool {
    match word.letter {
        b'T' => true,
        b'M' => word.value == 6.0 || word.value == 61.0,
        b'G' => is_frame_code(word.value),
        _ => false,
    }
}

/// Whether a G code changes the reference of coordinates.
fn is_frame_code(value: f64) -> bool {
    matches!(
        (10.0 * value).round() as u32,
        70 | 80 | 100 | 200 | 210 | 280 | 300 | 430..=432 | 490 | 520 | 540..=593 | 900 | 910 | 920..=923
    )
}

/// The text of a line in capitals without blanks, comments and names of parameters: letters outside of it
/// start no word.
fn outside_comments(text: &[u8]) -> Vec<u8> {
    let mut plain = Vec::new();
    let mut closing_byte = None;
    for byte in text {
        match (closing_byte, byte) {
            (Some(closing), byte) if *byte == closing => closing_byte = None,
            (Some(_), _) => {}
            (None, b';') => break,
            (None, b'(') => closing_byte = Some(b')'),
            (None, b'<') => closing_byte = Some(b'>'),
            (None, byte) if byte.is_ascii_whitespace() => {}
            (None, byte) => plain.push(byte.to_ascii_uppercase()),
        }
    }
    plain
}

/// Whether a line whose words could not be read may change the reference of coordinates: by the number of a G
/// code, or by a computed number.
fn may_change_frame(plain: &[u8]) -> bool {
    plain.split(|byte| *byte == b'G').skip(1).any(|after| {
        let digits = after
            .iter()
            .take_while(|byte| byte.is_ascii_digit() || **byte == b'.');
        let number: String = digits.map(|byte| char::from(*byte)).collect();
        number.parse().map_or(true, is_frame_code)
    })
}

fn is_motion(word: &Word) -> bool {
    word.letter == b'G' && code_of(word).is_some_and(|code| code.group() == Group::Motion)
}

/// The code of a G word.
fn code_of(word: &Word) -> Option<GCode> {
    GCode::from_tenths((10.0 * word.value + 0.5) as u32)
}

/// Whether the words of the rejected line could be read. Otherwise some may be missing.
fn has_parsed_words(code: Code) -> bool {
    code.as_str() >= Code::UnknownG.as_str()
}
