//! The meaning of a line: its codes by modal group, its other words by letter, and the assignment of words to
//! codes.
//!
//! All errors of a line that are independent of the machine's state (except the inherited motion mode) are
//! found here, before anything is executed.

use evolvent_path::{AXES, AxisLetter};

use crate::codes::modal_groups::{
    Compensation, Cycle, FeedMode, GCode, GROUPS, Group, LengthOffset, MCode, Motion, NonModal, PathControl,
    Turning, fanuc_code, lathe_code,
};
use crate::diagnostics::diagnostic::{Fault, Span};
use crate::diagnostics::foreign_codes;
use crate::syntax::block::Block;
use crate::syntax::word_faults::{integer, negative, no_such_axis, two_codes_of_group};
use crate::{Code, SPINDLES, Settings};

/// The letters, and `@` `^` `$`.
pub(crate) const WORDS: usize = 29;

/// Codes and words of one line. Reused.
#[derive(Clone, Debug)]
pub(crate) struct Statement {
    /// The G code of each group, if any, its position and its number as written.
    g: [Option<(GCode, Span, f64)>; GROUPS],
    /// The M code of each group, if any, its position and its number.
    m: [Option<(MCode, Span, f64)>; GROUPS],
    values: [f64; WORDS],
    spans: [Span; WORDS],
    /// One bit per word.
    present: u32,
    any_m: bool,
    any_mode: bool,
    /// The motion: a code on the line, or the active motion mode if the line has words for it.
    motion: Option<Motion>,
}

const fn word_index(letter: u8) -> usize {
    match letter {
        b'@' => 26,
        b'^' => 27,
        b'$' => 28,
        _ => (letter - b'A') as usize,
    }
}

pub(crate) const fn letter_at(index: usize) -> u8 {
    match index {
        26 => b'@',
        27 => b'^',
        28 => b'$',
        _ => b'A' + index as u8,
    }
}

pub(crate) const fn bit(letter: u8) -> u32 {
    1 << word_index(letter)
}

/// The bits of several letters.
const fn bits(letters: &[u8]) -> u32 {
    let mut sum = 0;
    let mut index = 0;
    while index < letters.len() {
        sum |= bit(letters[index]);
        index += 1;
    }
    sum
}

/// Checks the number of a spindle.
fn spindle_exists(value: f64, span: Span, exists: &[bool; SPINDLES]) -> Result<(), Fault> {
    if value == -1.0 {
        return Ok(());
    }
    if value.fract() != 0.0 || !(0.0..SPINDLES as f64).contains(&value) {
        let message = format!("${value}: spindles have the numbers 0 to {}", SPINDLES - 1);
        return Err(Fault::new(Code::SpindleSelection, span, message).help("$-1 selects all spindles"));
    }
    if exists[value as usize] {
        return Ok(());
    }
    let names: Vec<String> = (0..SPINDLES)
        .filter(|&number| exists[number])
        .map(|number| format!("${number}"))
        .collect();
    let message = format!("${value}: the machine has no spindle {value}");
    let help = format!(
        "it has {}; to add one, write [[spindle]] with number = {value} in the machine file",
        names.join(", ")
    );
    Err(Fault::new(Code::SpindleSelection, span, message).help(help))
}

const POLAR_BITS: u32 = bits(b"@^");
const AXIS_BITS: u32 = bits(b"XYZABCUVW@^");
const CENTRE_BITS: u32 = bits(b"IJK");
const ALWAYS_USED: u32 = bits(b"FST");

impl Default for Statement {
    fn default() -> Self {
        Self {
            g: [None; GROUPS],
            m: [None; GROUPS],
            values: [0.0; WORDS],
            spans: [Span::at(0); WORDS],
            present: 0,
            any_m: false,
            any_mode: false,
            motion: None,
        }
    }
}

impl Statement {
    /// Fills in a line. `modal` is the active motion mode.
    pub(crate) fn fill(&mut self, block: &Block, modal: Motion, settings: &Settings) -> Result<(), Fault> {
        if self.any_mode || self.g[Group::Motion as usize].is_some() {
            self.g = [None; GROUPS];
        }
        if self.any_m {
            self.m = [None; GROUPS];
        }
        (self.any_m, self.any_mode) = (false, false);
        self.present = 0;
        self.motion = None;
        for word in &block.words {
            match word.letter {
                b'G' => self.add_g(word.value, word.span, settings)?,
                b'M' => self.add_m(word.value, word.span, &settings.features.user_codes)?,
                letter => self.add_word(letter, word.value, word.span, settings)?,
            }
        }
        self.select_motion(modal)?;
        if settings.features.lathe {
            self.check_increments(&settings.axes)?;
        }
        self.check_use()
    }

    /// Keeps T and M6 here and returns the rest of the line.
    pub(crate) fn split_at_tool_change(&mut self) -> Self {
        let mut rest = self.clone();
        rest.m[Group::ToolChange as usize] = None;
        rest.any_m = rest.m.iter().any(Option::is_some);
        rest.present &= !bit(b'T');
        let change = self.m[Group::ToolChange as usize];
        self.g = [None; GROUPS];
        self.m = [None; GROUPS];
        self.m[Group::ToolChange as usize] = change;
        self.present &= bit(b'T');
        self.any_mode = false;
        self.motion = None;
        rest
    }

    /// The G code of a group.
    #[inline]
    pub(crate) fn g(&self, group: Group) -> Option<GCode> {
        self.g[group as usize].map(|(code, ..)| code)
    }

    /// The M code of a group.
    #[inline]
    pub(crate) fn m(&self, group: Group) -> Option<MCode> {
        self.m[group as usize].map(|(code, ..)| code)
    }

    /// The code of group 0.
    pub(crate) fn non_modal(&self) -> Option<NonModal> {
        match self.g(Group::NonModal) {
            Some(GCode::NonModal(code)) => Some(code),
            _ => None,
        }
    }

    /// G92.1, G92.2 or G92.3.
    pub(crate) fn offset_switch(&self) -> Option<NonModal> {
        match self.g(Group::OffsetSwitch) {
            Some(GCode::NonModal(code)) => Some(code),
            _ => None,
        }
    }

    /// The tool length offset on the line.
    pub(crate) fn length_offset(&self) -> Option<LengthOffset> {
        match self.g(Group::LengthOffset) {
            Some(GCode::LengthOffset(offset)) => Some(offset),
            _ => None,
        }
    }

    /// The cutter compensation code on the line.
    pub(crate) fn compensation(&self) -> Option<Compensation> {
        match self.g(Group::CutterCompensation) {
            Some(GCode::Compensation(code)) => Some(code),
            _ => None,
        }
    }

    /// The motion.
    pub(crate) fn motion(&self) -> Option<Motion> {
        self.motion
    }

    /// The motion code on the line.
    pub(crate) fn motion_code(&self) -> Option<Motion> {
        match self.g(Group::Motion) {
            Some(GCode::Motion(motion)) => Some(motion),
            _ => None,
        }
    }

    /// Whether the line consists of a straight move and F.
    #[inline]
    pub(crate) fn is_plain_move(&self) -> bool {
        matches!(self.motion, Some(Motion::Rapid | Motion::Linear))
            && !self.any_m
            && !self.any_mode
            && self.present & !(AXIS_BITS | bit(b'F')) == 0
    }

    /// Value of a word, by upper-case letter.
    #[inline]
    pub(crate) fn word(&self, letter: u8) -> Option<f64> {
        self.has(letter).then(|| self.values[word_index(letter)])
    }

    #[inline]
    pub(crate) fn has(&self, letter: u8) -> bool {
        self.present & bit(letter) != 0
    }

    /// Value of an axis word, by axis index.
    #[inline]
    pub(crate) fn axis(&self, index: usize) -> Option<f64> {
        self.word(b"XYZABCUVW"[index])
    }

    /// The number of the spindle that `$` names; 0 without it.
    pub(crate) fn spindle(&self) -> usize {
        // A cast of -1 is 0: code for all spindles checks for it first.
        self.word(b'$').map_or(0, |number| number as usize)
    }

    /// Whether the line has `$-1`.
    pub(crate) fn selects_all_spindles(&self) -> bool {
        self.word(b'$') == Some(-1.0)
    }

    /// Checks that a code of the line uses `$`, and that none of them needs one spindle if all are named.
    fn check_spindle(&self) -> Result<(), Fault> {
        let span = self.span(b'$');
        let needs_one_spindle = self.motion.is_some_and(Motion::uses_spindle)
            || self.m(Group::Spindle) == Some(MCode::SpindleOrient)
            || self.m(Group::Override) == Some(MCode::SpindleOverride)
            || self.g(Group::SpindleMode).is_some()
            || self.g(Group::FeedMode) == Some(GCode::FeedMode(FeedMode::PerRevolution));
        let has_feed_mode = self.g(Group::FeedMode).is_some();
        if (needs_one_spindle || has_feed_mode) && self.selects_all_spindles() {
            let message = "$-1 selects all spindles, and this line is for a single one";
            return Err(Fault::new(Code::SpindleSelection, span, message)
                .help("write the number of the spindle; $-1 is for S, M3, M4 and M5"));
        }
        if !needs_one_spindle && self.m(Group::Spindle).is_none() && !self.has(b'S') {
            let message = "no code on this line uses $, the spindle";
            return Err(Fault::new(Code::UnusedWord, span, message).help(
                "it selects the spindle of S, M3, M4, M5, M19, M51, G33, G33.1, G76, G95, G96, G97 and of \
                 cycles that turn the spindle",
            ));
        }
        Ok(())
    }

    pub(crate) fn has_axes(&self) -> bool {
        self.present & AXIS_BITS != 0
    }

    /// Whether there is any M code.
    #[inline]
    pub(crate) fn has_m(&self) -> bool {
        self.any_m
    }

    /// Whether there is any G code other than a motion.
    #[inline]
    pub(crate) fn has_g_modes(&self) -> bool {
        self.any_mode
    }

    pub(crate) fn has_polar(&self) -> bool {
        self.present & POLAR_BITS != 0
    }

    /// A word that must be a non-negative integer.
    pub(crate) fn integer(&self, letter: u8) -> Result<Option<u32>, Fault> {
        match self.word(letter) {
            Some(value) => integer(value, char::from(letter), self.span(letter)).map(Some),
            None => Ok(None),
        }
    }

    /// Span of a word on the line, or of the motion if the word is absent.
    pub(crate) fn span(&self, letter: u8) -> Span {
        if self.has(letter) {
            self.spans[word_index(letter)]
        } else {
            self.motion_span()
        }
    }

    /// Span of a group's code, or of the motion.
    pub(crate) fn group_span(&self, group: Group) -> Span {
        self.g[group as usize]
            .map(|(_, span, _)| span)
            .or_else(|| self.m[group as usize].map(|(_, span, _)| span))
            .unwrap_or_else(|| self.motion_span())
    }

    /// Span of the motion code, or of the words that it moves if it is not on the line.
    pub(crate) fn motion_span(&self) -> Span {
        if let Some((_, span, _)) = self.g[Group::Motion as usize] {
            return span;
        }
        let mut words = self.present & (AXIS_BITS | CENTRE_BITS | bit(b'R'));
        if words == 0 {
            words = self.present;
        }
        self.first_span(words)
    }

    fn first_span(&self, words: u32) -> Span {
        let spans = (0..WORDS).filter(|index| words >> index & 1 != 0);
        spans
            .map(|index| self.spans[index])
            .min_by_key(|span| span.start)
            .unwrap_or_else(|| Span::new(0, 0))
    }

    /// U and W are increments of X and Z in the turning cycles of a lathe without such axes.
    fn check_increments(&self, axes: &[bool; AXES]) -> Result<(), Fault> {
        if matches!(self.motion, Some(Motion::Turning(_))) {
            return Ok(());
        }
        for letter in [b'U', b'W'] {
            let name = char::from(letter);
            if self.has(letter) && !AxisLetter::from_letter(name).is_some_and(|axis| axes[axis.index()]) {
                return Err(no_such_axis(name, self.span(letter), axes));
            }
        }
        Ok(())
    }

    fn add_g(&mut self, value: f64, span: Span, settings: &Settings) -> Result<(), Fault> {
        let tenths = (value * 10.0).round();
        let is_tenth = (value * 10.0 - tenths).abs() < 1e-3;
        let is_supported = is_tenth && (0.0..=999.0).contains(&tenths);
        let tenths = tenths as u32;
        let lathe = settings.features.lathe.then(|| lathe_code(tenths)).flatten();
        let fanuc = settings
            .features
            .fanuc_threads
            .then(|| fanuc_code(tenths))
            .flatten();
        let machine_code = lathe.or(fanuc);
        let Some(code) = machine_code
            .or_else(|| GCode::from_tenths(tenths))
            .filter(|_| is_supported)
        else {
            if is_supported && tenths == 750 {
                return Err(Fault::new(
                    Code::UnsupportedG,
                    span,
                    "G75 is a turning cycle, and this machine is a mill",
                )
                .help("machines with kind = \"lathe\" support it"));
            }
            if let Some((message, help)) = foreign_codes::g_code(tenths).filter(|_| is_tenth) {
                return Err(Fault::new(Code::UnknownG, span, message).help(help));
            }
            let message = format!("there is no G{value}");
            return Err(Fault::new(Code::UnknownG, span, message));
        };
        let group = code.group();
        if let Some((before, _, first)) = self.g[group as usize] {
            // G80 cancels a cycle and leaves the words to the other code.
            if code == GCode::Motion(Motion::None) && before != code {
                return Ok(());
            }
            if before == GCode::Motion(Motion::None) && before != code {
                self.g[group as usize] = Some((code, span, value));
                return Ok(());
            }
            return Err(two_codes_of_group(group, span, format!("G{first} and G{value}")));
        }
        self.any_mode |= group != Group::Motion;
        self.g[group as usize] = Some((code, span, value));
        Ok(())
    }

    fn add_m(&mut self, value: f64, span: Span, user_codes: &[u32]) -> Result<(), Fault> {
        let number = integer(value, 'M', span)?;
        let code = MCode::from_number(number);
        if matches!(code, Some(MCode::User(_))) && !user_codes.contains(&number) {
            let message = format!("M{number} is not configured");
            return Err(Fault::new(Code::UnsupportedM, span, message).help(
                "M100 to M199 are user-defined codes; [program] user_codes in the machine file lists those \
                 that exist",
            ));
        }
        let Some(code) = code else {
            return Err(match foreign_codes::m_code(number) {
                Some((message, help)) => Fault::new(Code::UnknownM, span, message).help(help),
                None => Fault::new(Code::UnknownM, span, format!("there is no M{number}")),
            });
        };
        let group = code.group();
        if let Some((.., first)) = self.m[group as usize] {
            return Err(two_codes_of_group(group, span, format!("M{first} and M{value}")));
        }
        self.any_m = true;
        self.m[group as usize] = Some((code, span, value));
        Ok(())
    }

    fn add_word(&mut self, letter: u8, value: f64, span: Span, settings: &Settings) -> Result<(), Fault> {
        let axes = &settings.axes;
        let name = char::from(letter);
        if self.has(letter) {
            let message = format!("{name} occurs twice on this line");
            return Err(Fault::new(Code::RepeatedWord, span, message).help("only G and M may be repeated"));
        }
        if bit(letter) & AXIS_BITS & !POLAR_BITS != 0 {
            let exists = AxisLetter::from_letter(name).is_some_and(|axis| axes[axis.index()]);
            let is_increment = settings.features.lathe && matches!(letter, b'U' | b'W');
            if !exists && !is_increment {
                return Err(no_such_axis(name, span, axes));
            }
        }
        match letter {
            b'F' if value < 0.0 => return Err(negative('F', value, span)),
            b'S' if value < 0.0 => return Err(negative('S', value, span)),
            b'T' => {
                integer(value, 'T', span)?;
            }
            b'$' => spindle_exists(value, span, &settings.features.spindles)?,
            _ => {}
        }
        self.values[word_index(letter)] = value;
        self.spans[word_index(letter)] = span;
        self.present |= bit(letter);
        Ok(())
    }

    /// Determines the motion, and checks that only one code uses the axis words.
    fn select_motion(&mut self, modal: Motion) -> Result<(), Fault> {
        let code = self.motion_code();
        let new_motion = code.filter(|motion| *motion != Motion::None);
        let user = match self.non_modal() {
            Some(non_modal) if non_modal.uses_axes() => Some(non_modal.name()),
            _ => match self.length_offset() {
                Some(LengthOffset::Dynamic) => Some("G43.1"),
                Some(LengthOffset::Additional) if self.has_axes() && !self.has(b'H') => Some("G43.2"),
                _ => None,
            },
        };
        if let Some(user) = user {
            if self.has_polar() {
                let message = format!("@ and ^ have no meaning for {user}");
                return Err(Fault::new(
                    Code::PolarCoordinates,
                    self.first_span(self.present & POLAR_BITS),
                    message,
                ));
            }
            if let Some(motion) = new_motion {
                let message = format!("{user} and {} both use the axis words", motion.name());
                let help = match (self.non_modal(), motion) {
                    (Some(NonModal::Home(_)), Motion::Rapid) => {
                        format!("leave G0 out: {user} moves at rapid")
                    }
                    _ => "write them on two lines".to_owned(),
                };
                return Err(Fault::new(Code::TwoUsers, self.motion_span(), message).help(help));
            }
            if !self.has_axes()
                && matches!(
                    self.non_modal(),
                    Some(NonModal::SetOffset | NonModal::LocalOffset)
                )
            {
                let span = self.group_span(Group::NonModal);
                return Err(Fault::new(
                    Code::OffsetAxesMissing,
                    span,
                    format!("{user} needs an axis word"),
                )
                .help("G92 X0 makes the present position X0; G92.1 clears the offset"));
            }
            return Ok(());
        }
        // R of M19 is its angle.
        let radius_bit = match self.m(Group::Spindle) {
            Some(MCode::SpindleOrient) => 0,
            _ => bit(b'R'),
        };
        let has_arc_words = self.present & (CENTRE_BITS | radius_bit) != 0;
        let is_wanted = self.has_axes() || modal.is_round() && has_arc_words && self.non_modal().is_none();
        let motion = code
            .or(is_wanted.then_some(modal))
            .filter(|motion| *motion != Motion::None);
        if self.non_modal() == Some(NonModal::Dwell) && self.has_axes() && !self.has(b'P') && code.is_none() {
            let message = "G4 with an axis word: a dwell takes its time from P";
            return Err(Fault::new(
                Code::DwellTimeMissing,
                self.first_span(self.present & AXIS_BITS),
                message,
            )
            .help("write G4 P1.5 for 1.5 seconds"));
        }
        if let Some(
            non_modal @ (NonModal::SetHome(_)
            | NonModal::ClearOffset
            | NonModal::SuspendOffset
            | NonModal::RestoreOffset),
        ) = self.non_modal()
            && self.has_axes()
            && code.is_none()
        {
            let message = format!(
                "{} takes no axis words: they would be a move in the active mode",
                non_modal.name()
            );
            let span = self.first_span(self.present & AXIS_BITS);
            return Err(Fault::new(Code::UnusedWord, span, message)
                .help("write the move on a line of its own, with its code"));
        }
        if motion.is_none() && self.has_axes() {
            let message = "axis words, but no motion mode is active";
            let fault = Fault::new(
                Code::AxisWithoutMotion,
                self.first_span(self.present & AXIS_BITS),
                message,
            );
            return Err(fault.help("write G0, G1, G2 or G3 on this line; G80 ends the motion mode"));
        }
        self.motion = motion;
        Ok(())
    }

    /// Checks that a code uses every word, and that only one uses each of P, Q, R, L, D, E and H.
    fn check_use(&self) -> Result<(), Fault> {
        let always_used = ALWAYS_USED | AXIS_BITS;
        if self.present & !always_used == 0 && self.non_modal().is_none() {
            return Ok(());
        }
        let mut used = always_used;
        if self.has(b'$') {
            self.check_spindle()?;
            used |= bit(b'$');
        }
        let mut claimed_twice = 0;
        let mut claim = |letters: u32| {
            claimed_twice |= used & letters & !always_used;
            used |= letters;
        };
        claim(self.motion_words());
        match self.non_modal() {
            Some(NonModal::Dwell) => claim(bit(b'P')),
            Some(NonModal::SetData) => claim(match self.word(b'L') {
                Some(2.0) => bits(b"LPR"),
                Some(20.0) => bits(b"LP"),
                // Words of a tool; L0 accepts all as in LinuxCNC, and an unknown L is a separate error.
                _ => bits(b"LPRIJQ"),
            }),
            _ => {}
        }
        if self.g(Group::PathControl) == Some(GCode::Path(PathControl::Blend)) {
            claim(bits(b"PQ"));
        }
        if matches!(
            self.length_offset(),
            Some(LengthOffset::Table | LengthOffset::Additional)
        ) {
            claim(bit(b'H'));
        }
        if let Some(Compensation::On { dynamic, .. }) = self.compensation() {
            claim(bits(if dynamic { b"DL" } else { b"D" }));
        }
        if self.g(Group::SpindleMode) == Some(GCode::ConstantSurfaceSpeed(true)) {
            claim(bit(b'D'));
        }
        for (code, ..) in self.m.iter().flatten() {
            claim(match code {
                MCode::SpindleOrient => bits(b"RQP"),
                MCode::ToolNumber => bit(b'Q'),
                MCode::FeedOverride | MCode::SpindleOverride | MCode::AdaptiveFeed | MCode::FeedStop => {
                    bit(b'P')
                }
                MCode::Output { .. } => bit(b'P'),
                MCode::Input => bits(b"PELQ"),
                MCode::AnalogOutput(_) => bits(b"EQ"),
                MCode::User(_) => bits(b"PQ"),
                MCode::Call => bits(b"PL"),
                _ => 0,
            });
        }
        let unused = self.present & !used;
        if unused != 0 {
            return Err(self.unused(unused));
        }
        let claimed_twice = claimed_twice & self.present;
        if claimed_twice != 0 {
            let letter = (0..WORDS)
                .find(|index| claimed_twice >> index & 1 != 0)
                .map_or(b'P', letter_at);
            let name = char::from(letter);
            let message = format!("{name} could belong to more than one code on this line");
            return Err(
                Fault::new(Code::TwoUsers, self.span(letter), message).help("write the codes on two lines")
            );
        }
        self.check_values()
    }

    /// The words other than axes that the motion uses.
    fn motion_words(&self) -> u32 {
        match self.motion {
            None
            | Some(Motion::None | Motion::Rapid | Motion::Linear | Motion::NurbsEnd | Motion::Probe { .. }) => {
                0
            }
            Some(Motion::Arc(_)) => CENTRE_BITS | bits(b"RP"),
            Some(Motion::Involute(_)) => CENTRE_BITS | bit(b'R'),
            Some(Motion::CubicSpline) => bits(b"IJPQ"),
            Some(Motion::QuadraticSpline) => bits(b"IJ"),
            Some(Motion::Nurbs) => bits(b"PL"),
            Some(Motion::Hole(_)) => bits(b"DEIJKQR"),
            Some(Motion::Thread) => bits(b"KQ"),
            Some(Motion::FanucThread) => bit(b'Q'),
            Some(Motion::FanucThreadCycle) => bits(b"RQ"),
            Some(Motion::RigidTap) => bits(b"KI"),
            Some(Motion::ThreadCycle) => bits(b"DPIJKRQHEL"),
            Some(Motion::Rough(_)) => bits(b"QDEIRP"),
            Some(Motion::Turning(Turning::Longitudinal)) => bits(b"RLDHQ"),
            Some(Motion::Turning(Turning::Facing)) => bits(b"KHEQ"),
            Some(Motion::Cycle(cycle)) => {
                bits(b"RL")
                    | match cycle {
                        Cycle::ChipBreak | Cycle::Peck => bit(b'Q'),
                        Cycle::DrillDwell
                        | Cycle::BoreStop
                        | Cycle::BoreManual
                        | Cycle::BoreDwell
                        | Cycle::Tap
                        | Cycle::TapLeft => bits(b"P"),
                        Cycle::BackBore => CENTRE_BITS,
                        Cycle::Drill | Cycle::BoreFeed => 0,
                    }
            }
        }
    }

    /// Values that are invalid in any state.
    fn check_values(&self) -> Result<(), Fault> {
        let is_dwell = self.non_modal() == Some(NonModal::Dwell);
        let is_blend = self.g(Group::PathControl) == Some(GCode::Path(PathControl::Blend));
        if is_dwell {
            match self.word(b'P') {
                None => {
                    let span = self.group_span(Group::NonModal);
                    return Err(Fault::new(
                        Code::DwellTimeMissing,
                        span,
                        "G4 needs P, the time in seconds",
                    ));
                }
                Some(seconds) if seconds < 0.0 => return Err(negative('P', seconds, self.span(b'P'))),
                Some(_) => {}
            }
        }
        if is_blend {
            for letter in [b'P', b'Q'] {
                if let Some(value) = self.word(letter)
                    && value < 0.0
                {
                    return Err(negative(char::from(letter), value, self.span(letter)));
                }
            }
        }
        Ok(())
    }
}
