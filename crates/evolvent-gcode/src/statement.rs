//! What a line asks for: its codes by modal group, its other words by letter, and who uses which.
//!
//! Everything that can be wrong with a line whatever the machine's state (but for the motion mode that it
//! inherits) is found here, before anything is executed.

use evolvent_path::{AXES, AxisLetter};

use crate::Code;
use crate::block::Block;
use crate::codes::{GCode, GROUPS, Group, LengthOffset, MCode, Motion, Once, PathControl};
use crate::codes::{is_g_of_the_dialect, is_m_of_the_dialect};
use crate::diagnostic::{Fault, Span};

const LETTERS: usize = 26;

/// Codes and words of one line. Kept and filled again.
#[derive(Clone, Debug)]
pub(crate) struct Statement {
    /// The G code of each group, if any, its place and its number as written.
    g: [Option<(GCode, Span, f64)>; GROUPS],
    /// The M code of each group, if any, its place and its number.
    m: [Option<(MCode, Span, f64)>; GROUPS],
    values: [f64; LETTERS],
    spans: [Span; LETTERS],
    /// Bit per letter.
    present: u32,
    /// What moves: a code on the line, or the motion mode in force if there is something for it.
    motion: Option<Motion>,
}

const fn bit(letter: u8) -> u32 {
    1 << (letter - b'A')
}

const AXIS_BITS: u32 = {
    let mut bits = 0;
    let mut index = 0;
    while index < AXES {
        bits |= bit(AxisLetter::ALL[index].letter() as u8);
        index += 1;
    }
    bits
};
const CENTRE_BITS: u32 = bit(b'I') | bit(b'J') | bit(b'K');
const ALWAYS_USED: u32 = bit(b'F') | bit(b'S') | bit(b'T');

impl Statement {
    pub(crate) fn new() -> Self {
        Self {
            g: [None; GROUPS],
            m: [None; GROUPS],
            values: [0.0; LETTERS],
            spans: [Span::at(0); LETTERS],
            present: 0,
            motion: None,
        }
    }

    /// Fills in a line. `modal` is the motion mode in force, `axes` which axes exist.
    pub(crate) fn fill(&mut self, block: &Block, modal: Motion, axes: &[bool; AXES]) -> Result<(), Fault> {
        self.g = [None; GROUPS];
        self.m = [None; GROUPS];
        self.present = 0;
        self.motion = None;
        for word in &block.words {
            let value = word.value;
            match word.letter {
                b'G' => self.add_g(value, word.span)?,
                b'M' => self.add_m(value, word.span)?,
                b'@' | b'^' => {
                    let message = format!(
                        "'{}': polar coordinates are not available yet",
                        char::from(word.letter)
                    );
                    return Err(Fault::new(Code::PolarCoordinates, word.span, message).help("write X and Y"));
                }
                b'$' => {
                    let message = "'$': there is only one spindle";
                    return Err(Fault::new(Code::SpindleSelection, word.span, message).help("leave $ out"));
                }
                letter => self.add_word(letter, value, word.span, axes)?,
            }
        }
        self.settle_motion(modal)?;
        self.check_use()
    }

    /// The G code of a group.
    pub(crate) fn g(&self, group: Group) -> Option<GCode> {
        self.g[group as usize].map(|(code, ..)| code)
    }

    /// The M code of a group.
    pub(crate) fn m(&self, group: Group) -> Option<MCode> {
        self.m[group as usize].map(|(code, ..)| code)
    }

    /// The code of group 0.
    pub(crate) fn once(&self) -> Option<Once> {
        match self.g(Group::Once) {
            Some(GCode::Once(once)) => Some(once),
            _ => None,
        }
    }

    /// The tool length offset that stands on the line.
    pub(crate) fn length_offset(&self) -> Option<LengthOffset> {
        match self.g(Group::LengthOffset) {
            Some(GCode::LengthOffset(offset)) => Some(offset),
            _ => None,
        }
    }

    /// What moves.
    pub(crate) fn motion(&self) -> Option<Motion> {
        self.motion
    }

    /// The motion code that stands on the line.
    pub(crate) fn motion_code(&self) -> Option<Motion> {
        match self.g(Group::Motion) {
            Some(GCode::Motion(motion)) => Some(motion),
            _ => None,
        }
    }

    /// Value of a word, by upper-case letter.
    #[inline]
    pub(crate) fn word(&self, letter: u8) -> Option<f64> {
        self.has(letter).then(|| self.values[usize::from(letter - b'A')])
    }

    #[inline]
    pub(crate) fn has(&self, letter: u8) -> bool {
        self.present & bit(letter) != 0
    }

    /// Value of an axis' word, by the axis' index.
    #[inline]
    pub(crate) fn axis(&self, index: usize) -> Option<f64> {
        self.word(b"XYZABCUVW"[index])
    }

    pub(crate) fn has_axes(&self) -> bool {
        self.present & AXIS_BITS != 0
    }

    /// Place of a word on the line, or of the motion if there is no such word.
    pub(crate) fn span(&self, letter: u8) -> Span {
        if self.has(letter) {
            self.spans[usize::from(letter - b'A')]
        } else {
            self.motion_span()
        }
    }

    /// Place of a group's code, or of the motion.
    pub(crate) fn group_span(&self, group: Group) -> Span {
        self.g[group as usize]
            .map(|(_, span, _)| span)
            .or_else(|| self.m[group as usize].map(|(_, span, _)| span))
            .unwrap_or_else(|| self.motion_span())
    }

    /// Place of the motion code; if it does not stand on the line, of the words that it moves.
    pub(crate) fn motion_span(&self) -> Span {
        if let Some((_, span, _)) = self.g[Group::Motion as usize] {
            return span;
        }
        let mut moved = self.present & (AXIS_BITS | CENTRE_BITS | bit(b'R'));
        if moved == 0 {
            moved = self.present;
        }
        let spans = (0..LETTERS)
            .filter(|letter| moved >> letter & 1 != 0)
            .map(|letter| self.spans[letter]);
        spans
            .min_by_key(|span| span.start)
            .unwrap_or_else(|| Span::new(0, 0))
    }

    fn add_g(&mut self, value: f64, span: Span) -> Result<(), Fault> {
        let tenths = (value * 10.0).round();
        let whole = (value * 10.0 - tenths).abs() < 1e-3 && (0.0..=999.0).contains(&tenths);
        let tenths = tenths as u32;
        let Some(code) = GCode::from_tenths(tenths).filter(|_| whole) else {
            if whole && is_g_of_the_dialect(tenths) {
                let message = format!("G{value} is not available yet");
                return Err(Fault::new(Code::UnsupportedG, span, message));
            }
            let message = format!("there is no G{value}");
            return Err(Fault::new(Code::UnknownG, span, message));
        };
        let group = code.group();
        if let Some((.., first)) = self.g[group as usize] {
            return Err(two_of_group(group, span, format!("G{first} and G{value}")));
        }
        self.g[group as usize] = Some((code, span, value));
        Ok(())
    }

    fn add_m(&mut self, value: f64, span: Span) -> Result<(), Fault> {
        let number = whole(value, "M", span)?;
        let Some(code) = MCode::from_number(number) else {
            return Err(if is_m_of_the_dialect(number) {
                Fault::new(
                    Code::UnsupportedM,
                    span,
                    format!("M{number} is not available yet"),
                )
            } else {
                Fault::new(Code::UnknownM, span, format!("there is no M{number}"))
            });
        };
        let group = code.group();
        if let Some((.., first)) = self.m[group as usize] {
            return Err(two_of_group(group, span, format!("M{first} and M{value}")));
        }
        self.m[group as usize] = Some((code, span, value));
        Ok(())
    }

    fn add_word(&mut self, letter: u8, value: f64, span: Span, axes: &[bool; AXES]) -> Result<(), Fault> {
        let name = char::from(letter);
        if self.has(letter) {
            let message = format!("{name} stands twice on this line");
            return Err(Fault::new(Code::RepeatedWord, span, message).help("only G and M may be repeated"));
        }
        if bit(letter) & AXIS_BITS != 0 {
            let exists = AxisLetter::from_letter(name).is_some_and(|axis| axes[axis.index()]);
            if !exists {
                let message = format!("{name}: this machine has no such axis");
                let present: String = AxisLetter::ALL
                    .iter()
                    .filter(|axis| axes[axis.index()])
                    .map(|axis| axis.letter())
                    .collect();
                return Err(
                    Fault::new(Code::NoSuchAxis, span, message).help(format!("its axes are {present}"))
                );
            }
        }
        if matches!(letter, b'F' | b'S') && value < 0.0 {
            let message = format!("{name}{value} is negative");
            return Err(Fault::new(Code::Negative, span, message));
        }
        if letter == b'T' {
            whole(value, "T", span)?;
        }
        self.values[usize::from(letter - b'A')] = value;
        self.spans[usize::from(letter - b'A')] = span;
        self.present |= bit(letter);
        Ok(())
    }

    /// Decides what moves, and that one code only wants the axis words.
    fn settle_motion(&mut self, modal: Motion) -> Result<(), Fault> {
        let code = self.motion_code();
        if self.once() == Some(Once::SetOffset) {
            if let Some(motion) = code.filter(|motion| *motion != Motion::None) {
                let message = format!("G92 and {} both want the axis words", motion.name());
                return Err(
                    Fault::new(Code::TwoUsers, self.motion_span(), message).help("write them on two lines")
                );
            }
            if !self.has_axes() {
                let span = self.group_span(Group::Once);
                return Err(
                    Fault::new(Code::OffsetAxesMissing, span, "G92 needs an axis word")
                        .help("G92 X0 makes the present position X0; G92.1 clears the offset"),
                );
            }
            return Ok(());
        }
        if matches!(
            self.length_offset(),
            Some(LengthOffset::Given | LengthOffset::Added)
        ) && self.has_axes()
        {
            if let Some(motion) = code.filter(|motion| *motion != Motion::None) {
                let message = format!("the tool offset and {} both want the axis words", motion.name());
                return Err(
                    Fault::new(Code::TwoUsers, self.motion_span(), message).help("write them on two lines")
                );
            }
            return Ok(());
        }
        let round = self.present & (CENTRE_BITS | bit(b'R')) != 0;
        let wanted = self.has_axes() || modal.is_round() && round;
        let motion = code
            .or(wanted.then_some(modal))
            .filter(|motion| *motion != Motion::None);
        if motion.is_none() && self.has_axes() {
            let message = "axis words, but no motion mode is active";
            let fault = Fault::new(Code::AxisWithoutMotion, self.first_axis_span(), message);
            return Err(fault.help("write G0, G1, G2 or G3 on this line"));
        }
        self.motion = motion;
        Ok(())
    }

    fn first_axis_span(&self) -> Span {
        let spans = (0..LETTERS).filter(|letter| self.present & AXIS_BITS & 1 << letter != 0);
        spans
            .map(|letter| self.spans[letter])
            .min_by_key(|span| span.start)
            .unwrap_or_else(|| Span::new(0, 0))
    }

    /// Every word has a user, and P only one.
    fn check_use(&self) -> Result<(), Fault> {
        let dwell = self.once() == Some(Once::Dwell);
        let blend = self.g(Group::PathControl) == Some(GCode::Path(PathControl::Blend));
        let arc = matches!(self.motion, Some(Motion::Arc(_)));
        let mut used = ALWAYS_USED | AXIS_BITS;
        if self.motion.is_some_and(Motion::is_round) {
            used |= CENTRE_BITS | bit(b'R');
        }
        if dwell || blend || arc {
            used |= bit(b'P');
        }
        if blend {
            used |= bit(b'Q');
        }
        if matches!(
            self.length_offset(),
            Some(LengthOffset::Table | LengthOffset::Added)
        ) {
            used |= bit(b'H');
        }
        let unused = self.present & !used;
        if unused != 0 {
            return Err(self.unused(unused));
        }
        if self.has(b'P') && u8::from(dwell) + u8::from(blend) + u8::from(arc) > 1 {
            let message = "P could belong to more than one code on this line";
            let fault = Fault::new(Code::TwoUsers, self.span(b'P'), message);
            return Err(fault.help("G4, G64 and arcs use P: write them on two lines"));
        }
        if dwell {
            match self.word(b'P') {
                None => {
                    let span = self.group_span(Group::Once);
                    return Err(Fault::new(
                        Code::DwellTimeMissing,
                        span,
                        "G4 needs P, the time in seconds",
                    ));
                }
                Some(seconds) => not_negative('P', seconds, self.span(b'P'))?,
            }
        }
        if blend {
            for letter in [b'P', b'Q'] {
                if let Some(value) = self.word(letter) {
                    not_negative(char::from(letter), value, self.span(letter))?;
                }
            }
        }
        Ok(())
    }

    #[cold]
    fn unused(&self, unused: u32) -> Fault {
        let first = (0..LETTERS as u8)
            .map(|index| b'A' + index)
            .filter(|letter| unused & bit(*letter) != 0)
            .min_by_key(|letter| self.span(*letter).start)
            .unwrap_or(b'A');
        let name = char::from(first);
        let message = format!("nothing on this line uses {name}");
        let fault = Fault::new(Code::UnusedWord, self.span(first), message);
        match first {
            b'E' => fault.help("numbers have no exponent: write all digits"),
            b'I' | b'J' | b'K' => fault.help(format!("{name} belongs to G2, G3, G2.2 or G3.2")),
            b'R' => fault.help("R belongs to G2, G3, G2.2 or G3.2"),
            b'P' => fault.help("P belongs to G4, G64, G2 or G3"),
            b'Q' => fault.help("Q belongs to G64"),
            b'H' => fault.help("H belongs to G43 and G43.2"),
            b'D' => fault.help("D belongs to G41 and G42, which are not available yet"),
            _ => fault,
        }
    }
}

#[cold]
fn two_of_group(group: Group, span: Span, mut message: String) -> Fault {
    message.push_str(" are both ");
    message.push_str(group.name());
    Fault::new(Code::ModalGroup, span, message)
        .help("one of a kind per line: write them on two lines, or leave one out")
}

fn not_negative(letter: char, value: f64, span: Span) -> Result<(), Fault> {
    if value < 0.0 {
        return Err(Fault::new(
            Code::Negative,
            span,
            format!("{letter}{value} is negative"),
        ));
    }
    Ok(())
}

/// A whole number that is not negative. As in LinuxCNC a rounding error of 1e-4 passes.
pub(crate) fn whole(value: f64, name: &str, span: Span) -> Result<u32, Fault> {
    let rounded = value.round();
    if (value - rounded).abs() > 1e-4 {
        return Err(Fault::new(
            Code::NotInteger,
            span,
            format!("{name}{value}: {name} must be a whole number"),
        ));
    }
    if rounded < 0.0 {
        return Err(Fault::new(
            Code::Negative,
            span,
            format!("{name}{value} is negative"),
        ));
    }
    // The lexer lets no number beyond 1e9 pass, so this fits.
    Ok(rounded as u32)
}
