//! Rejected lines of other dialects: the meaning of their words there, and the equivalent here.

use crate::diagnostics::diagnostic::{Fault, Span};
use crate::diagnostics::dialect_conflicts::tool_word_equivalent;
use crate::diagnostics::foreign_text::ForeignText;
use crate::syntax::block::Block;
use crate::{Code, SPINDLES};

/// The machine and the modes on which advice depends.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DialectContext {
    pub(crate) is_lathe: bool,
    /// G18.
    pub(crate) is_zx: bool,
    /// G7.
    pub(crate) is_diameter: bool,
}

/// A better error for a line of another dialect; `None` if the line is not recognized.
#[cold]
pub(crate) fn explain(text: &[u8], block: &Block, fault: &Fault, context: DialectContext) -> Option<Fault> {
    let line = String::from_utf8_lossy(text);
    let context = DialectContext {
        is_zx: span_of(block, b'G', 18.0).is_some() || context.is_zx && span_of(block, b'G', 17.0).is_none(),
        ..context
    };
    ForeignText::new(&line, fault)
        .explain()
        .or_else(|| explain_codes(block, fault, context))
        .or_else(|| explain_arc(block, fault, context))
}

fn has(block: &Block, letter: u8) -> bool {
    block.words.iter().any(|word| word.letter == letter)
}

fn value(block: &Block, letter: u8) -> Option<f64> {
    block
        .words
        .iter()
        .find(|word| word.letter == letter)
        .map(|word| word.value)
}

fn span_of(block: &Block, letter: u8, value: f64) -> Option<Span> {
    let mut words = block.words.iter();
    words
        .find(|word| word.letter == letter && word.value == value)
        .map(|word| word.span)
}

pub(super) fn replacement(
    fault: &Fault,
    message: impl Into<String>,
    help: impl Into<std::borrow::Cow<'static, str>>,
) -> Fault {
    Fault::new(fault.code, fault.span, message).help(help)
}

/// G50 and G15 alone, which end what this dialect does not have.
fn end_of_mode(block: &Block, fault: &Fault) -> Option<Fault> {
    if fault.code != Code::UnknownG || block.words.iter().any(|word| b"XYZIJKPRS".contains(&word.letter)) {
        return None;
    }
    let (number, mode) = [(50, "scaling"), (15, "polar coordinates")]
        .into_iter()
        .find(|(number, _)| span_of(block, b'G', f64::from(*number)) == Some(fault.span))?;
    Some(replacement(
        fault,
        format!("G{number} ends {mode} in other dialects; here there is none to end"),
        format!("delete G{number}"),
    ))
}

/// U and W, which are increments of X and Z on other lathes.
fn increments(block: &Block, fault: &Fault, context: DialectContext) -> Option<Fault> {
    let is_increment = |span: Span| {
        let mut words = block.words.iter();
        words.any(|word| matches!(word.letter, b'U' | b'W') && word.span == span)
    };
    if fault.code == Code::NoSuchAxis && context.is_lathe && is_increment(fault.span) {
        if let Some(span) = span_of(block, b'G', 28.0) {
            let message = "U and W with G28 are increments of X and Z on other lathes".to_owned();
            let help = "write G28 alone to move all axes there; G91 G28 X0, then G90, moves X only";
            return Some(Fault::new(fault.code, span, message).help(help.to_owned()));
        }
        return Some(replacement(
            fault,
            format!(
                "{}; on other lathes U and W are increments of X and Z",
                fault.message
            ),
            "write G91 with X and Z, and G90 after it",
        ));
    }
    None
}

/// Lines that are recognized by their codes.
fn explain_codes(block: &Block, fault: &Fault, context: DialectContext) -> Option<Fault> {
    if let Some(better) = end_of_mode(block, fault) {
        return Some(better);
    }
    if fault.code == Code::UnknownM && span_of(block, b'M', 97.0).is_some() {
        return Some(replacement(
            fault,
            "M97, a jump to a line number, is not a code of this dialect",
            "write the lines as O100 sub ... O100 endsub, and O100 call in place of M97 P100",
        ));
    }
    if fault.code == Code::UnknownM && span_of(block, b'M', 29.0).is_some() {
        // The pitch is F by S: without this S it would be another.
        let help = match value(block, b'S') {
            Some(speed) => {
                format!("write S{speed} M3 in its place (M4 before G74), because the pitch needs the speed")
            }
            None => "delete it".to_owned(),
        };
        return Some(replacement(
            fault,
            "M29, rigid tapping, is not a code of this dialect",
            format!(
                "{help}: G84 and G74 follow a spindle with feedback anyway; G33.1 Z.. K.. taps with the lead \
                 K"
            ),
        ));
    }
    if let Some(better) = unused_p(block, fault) {
        return Some(better);
    }
    if let Some(better) = spindle_by_p(block, fault) {
        return Some(better);
    }
    if let (Code::SubroutineMissing, Some(number), Some(_)) =
        (fault.code, value(block, b'P'), span_of(block, b'M', 98.0))
        && number >= 10_000.0
    {
        let (times, number) = ((number / 10_000.0).floor(), number % 10_000.0);
        return Some(replacement(
            fault,
            format!(
                "{}; in other dialects P has the repetitions before the last four digits",
                fault.message
            ),
            format!("write M98 P{number} L{times}, {times} repetitions of O{number}"),
        ));
    }
    if let (Code::UnknownTool, Some(number)) = (fault.code, value(block, b'T'))
        && context.is_lathe
        && (100.0..=9999.0).contains(&number)
    {
        let number = number as u32;
        return Some(replacement(
            fault,
            format!(
                "tool {number} is not in the tool table; T{number:04} is tool {} with offset {} on other \
                 lathes",
                number / 100,
                number % 100
            ),
            format!("write {}", tool_word_equivalent(number, context.is_diameter)),
        ));
    }
    repeated_profile(block, fault, context)
        .or_else(|| increments(block, fault, context))
        .or_else(|| corners(block, fault, context))
        .or_else(|| threads(block, fault, context))
        .or_else(|| grooves_and_holes(block, fault, context))
        .or_else(|| cycle_words(block, fault))
}

/// C, R and A of a straight move, which are a chamfer, a rounding and an angle on other lathes.
fn corners(block: &Block, fault: &Fault, context: DialectContext) -> Option<Fault> {
    let is_move = context.is_lathe
        && (has(block, b'X') || has(block, b'Z'))
        && !block.words.iter().any(|word| {
            word.letter == b'G'
                && word.value >= 2.0
                && !matches!(word.value, 17.0..=21.0 | 40.0..=42.0 | 90.0..=99.0)
        });
    let word = block
        .words
        .iter()
        .find(|word| word.span == fault.span)
        .filter(|_| is_move && matches!(fault.code, Code::NoSuchAxis | Code::UnusedWord))?;
    // The taper of a cycle of one pass.
    let is_cycle = [90.0, 92.0, 94.0]
        .iter()
        .any(|code| span_of(block, b'G', *code).is_some());
    let (meaning, help) = match word.letter {
        b'R' if is_cycle => return None,
        b'C' => ("a chamfer", "write the chamfer as a line: G1 X.. Z.."),
        b'R' => (
            "the rounding of a corner",
            "write the rounding as an arc: G2 or G3 with R",
        ),
        b'A' => ("the angle of a line", "write the end point: X.. Z.."),
        _ => return None,
    };
    let letter = char::from(word.letter);
    Some(replacement(
        fault,
        format!(
            "{}; on other lathes {letter} of a straight move is {meaning}",
            fault.message
        ),
        help,
    ))
}

/// Words of drilling cycles with another letter, or without a meaning.
fn cycle_words(block: &Block, fault: &Fault) -> Option<Fault> {
    let is_cycle = |word: &crate::syntax::block::Word| {
        word.letter == b'G'
            && (word.value == 73.0 || word.value == 74.0 || (81.0..=89.0).contains(&word.value))
    };
    let cycle = block.words.iter().find(|word| is_cycle(word))?;
    let word = block
        .words
        .iter()
        .find(|word| word.span == fault.span)
        .filter(|_| fault.code == Code::UnusedWord)?;
    let (number, value) = (cycle.value, word.value);
    let has_depths = has(block, b'I') || has(block, b'J');
    match word.letter {
        b'K' if !has_depths => Some(replacement(
            fault,
            "K, the repetitions of a cycle on other controls, is L in this dialect",
            if value == 0.0 {
                "K0 stores the words of the cycle without a hole: write them on the line of the first hole, and \
                 delete this line"
                    .to_owned()
            } else {
                format!("write L{value} in place of K{value}")
            },
        )),
        b'P' => Some(replacement(
            fault,
            format!("G{number} has no dwell in this dialect"),
            format!("delete P{value}; G82 drills with a dwell of P seconds at the bottom"),
        )),
        b'I' | b'J' | b'K' => Some(replacement(
            fault,
            format!("G{number} has the same depth for each peck in this dialect"),
            "write Q, the depth of a peck, in place of I, J and K",
        )),
        _ => None,
    }
}

/// G73 of other lathes.
fn repeated_profile(block: &Block, fault: &Fault, context: DialectContext) -> Option<Fault> {
    let is_word_error = matches!(
        fault.code,
        Code::NoSuchAxis | Code::UnusedWord | Code::WordMissing
    );
    let span = span_of(block, b'G', 73.0).filter(|_| context.is_lathe && is_word_error)?;
    b"UW".iter().any(|letter| has(block, *letter)).then(|| {
        Fault::new(
            fault.code,
            span,
            "G73 drills in pecks in this dialect, and does not repeat a profile",
        )
        .help(
            "write the profile as O1 sub ... O1 endsub, then G71 Q1 X.. Z.. D.., D the depth of a pass, and G70 \
             Q1 X.. Z..",
        )
    })
}

fn threads(block: &Block, fault: &Fault, context: DialectContext) -> Option<Fault> {
    if let (Some(span), Some(lead)) = (span_of(block, b'G', 33.0), value(block, b'F'))
        && !has(block, b'K')
    {
        return Some(
            Fault::new(
                fault.code,
                span,
                "G33 takes its lead from K in this dialect, not from F",
            )
            .help(format!("write K{lead} in place of F{lead}")),
        );
    }
    let span = span_of(block, b'G', 76.0)?;
    if !context.is_lathe && has(block, b'R') && !has(block, b'I') {
        return Some(
            Fault::new(
                fault.code,
                span,
                "G76 is a threading cycle in this dialect, not fine boring",
            )
            .help(
                "write G86, which stops the spindle at the bottom, or G1 to the bottom, M19 R0, a small \
                 move aside and G0 out",
            ),
        );
    }
    let is_foreign = has(block, b'X') || has(block, b'F') || has(block, b'P') && !has(block, b'K');
    is_foreign.then(|| {
        let help = "write G76 P1.5 Z-20 I-1 J0.3 R1 K0.92 Q29.5 E0.5 L0: P lead, Z end, I thread crest \
                     beside the start, J first depth, K full depth; the start is the position before it";
        Fault::new(
            fault.code,
            span,
            "G76 is one line with other words in this dialect: P is the lead, and \
                                      depths are in I, J and K",
        )
        .help(help)
    })
}

fn grooves_and_holes(block: &Block, fault: &Fault, context: DialectContext) -> Option<Fault> {
    let span_of_g = |number: f64| span_of(block, b'G', number);
    let located = |span: Span, message: &str, help: &str| {
        Some(Fault::new(fault.code, span, message).help(help.to_owned()))
    };
    if !context.is_lathe {
        return None;
    }
    if let Some(span) = span_of_g(75.0)
        && (fault.code == Code::UnusedWord && b"IPR".iter().any(|letter| has(block, *letter))
            || fault.code == Code::WordMissing && has(block, b'K') && has(block, b'F'))
    {
        let help =
            "write each peck as G1 X.. F.. and G0 X.., or as a loop: O1 while [#1 GT 0] ... O1 endwhile";
        return located(
            span,
            "G75 is a load-adaptive or plain facing cycle here, not grooving in pecks",
            help,
        );
    }
    if let Some(span) = span_of_g(74.0)
        && (has(block, b'K') || has(block, b'R') && !has(block, b'Z'))
    {
        let help = "write G17 G83 Z-20 R2 Q5 F.., then G18; Q is the depth of a peck";
        return located(
            span,
            "G74 is left-hand tapping in this dialect, not drilling in pecks",
            help,
        );
    }
    let cycle = [73.0, 74.0, 81.0, 82.0, 83.0, 84.0, 85.0, 86.0, 88.0, 89.0]
        .into_iter()
        .find_map(|number| span_of_g(number).map(|span| (number, span)));
    if let Some((number, span)) = cycle
        && context.is_zx
        && matches!(fault.code, Code::WordMissing | Code::NoSuchAxis)
        && !has(block, b'Y')
    {
        let message = format!("G{number} drills along Y in G18; along Z it needs G17");
        let help = format!("write G17 G{number} with the same words, and G18 after the holes");
        return located(span, &message, &help);
    }
    None
}

/// Arcs.
fn explain_arc(block: &Block, fault: &Fault, context: DialectContext) -> Option<Fault> {
    let with_help = |text: String| {
        let mut better = Fault::new(fault.code, fault.span, fault.message.clone());
        better.help = Some(text.into());
        Some(better)
    };
    let advice = fault
        .help
        .as_deref()
        .unwrap_or_else(|| fault.code.hint())
        .to_owned();
    match fault.code {
        Code::ArcOffsetAcrossPlane => {
            let zero = block
                .words
                .iter()
                .find(|word| b"IJK".contains(&word.letter) && word.span == fault.span && word.value == 0.0)?;
            let name = char::from(zero.letter);
            with_help(format!(
                "delete {name}0: even 0 is not permitted for a centre across the plane"
            ))
        }
        Code::ArcRadiusMismatch | Code::ArcRadiusTooSmall
            if context.is_lathe && context.is_zx && !context.is_diameter =>
        {
            with_help(format!(
                "{advice}; X is a radius in G8: if the program has diameters, write G7 before its first move"
            ))
        }
        _ => None,
    }
}

/// A P that selects something in other dialects.
fn unused_p(block: &Block, fault: &Fault) -> Option<Fault> {
    let p = value(block, b'P').filter(|_| fault.code == Code::UnusedWord)?;
    let has_g = |number: f64| span_of(block, b'G', number).is_some();
    if span_of(block, b'M', 99.0).is_some() {
        return Some(replacement(
            fault,
            "M99 P, a return to another line, is not part of this dialect",
            "write the lines that it jumps to as a subroutine, and decide with O1 if [..] ... O1 endif",
        ));
    }
    if has_g(30.0) || has_g(28.0) {
        return Some(replacement(
            fault,
            "P of G28 and G30 chooses a reference position in other dialects; here each has one",
            "delete P; G28.1 and G30.1 store the present position",
        ));
    }
    if has_g(8.0) {
        return Some(replacement(
            fault,
            "G8 P, look-ahead, is G64 in this dialect, and always on",
            "delete the line; G8 is the radius of a lathe here",
        ));
    }
    (54..=59).any(|number| has_g(f64::from(number))).then(|| {
        replacement(
            fault,
            format!("G54 P{p} chooses a further work offset in other dialects; here there are nine"),
            "write G54 to G59, G59.1, G59.2 or G59.3",
        )
    })
}

/// M3, M4 or M5 with P for the spindle.
fn spindle_by_p(block: &Block, fault: &Fault) -> Option<Fault> {
    let code = [3.0, 4.0, 5.0]
        .into_iter()
        .find(|code| span_of(block, b'M', *code).is_some())?;
    let number = value(block, b'P')?;
    let span = span_of(block, b'P', number)?;
    if fault.code != Code::UnusedWord || fault.span != span {
        return None;
    }
    let help = if number.fract() == 0.0 && (0.0..SPINDLES as f64).contains(&number) {
        format!("write M{code} ${number} in place of M{code} P{number}; spindles count from 0")
    } else {
        format!(
            "write M{code} $1 for spindle 1, for example; spindles count from 0 to {}",
            SPINDLES - 1
        )
    };
    Some(
        Fault::new(
            fault.code,
            span,
            format!("M{code} selects the spindle by $ in this dialect, not by P"),
        )
        .help(help),
    )
}
