//! Code of other dialects and its equivalent here. Only consulted for lines with an error.

use crate::Code;
use crate::diagnostics::diagnostic::{Fault, Span};
use crate::diagnostics::foreign_line::{self, DialectContext};
use crate::syntax::block::Block;

/// Keywords with which lines of other dialects start.
const KEYWORDS: [(&str, &str, &str); 5] = [
    (
        "IF",
        "IF is not a keyword of this dialect: conditions are O-words",
        "write O1 if [#1 EQ 1], the dependent lines, O1 endif, in place of THEN and of GOTO",
    ),
    (
        "WHILE",
        "WHILE ... DO is not part of this dialect: loops are O-words",
        "write O1 while [#1 LT 3], the lines to repeat, O1 endwhile",
    ),
    (
        "END",
        "END is not a keyword of this dialect: loops end with an O-word",
        "write O1 endwhile, with the number or name of the O1 while that starts the loop",
    ),
    (
        "GOTO",
        "GOTO is not part of this dialect: there are no jumps to line numbers",
        "write O1 if [...] ... O1 endif to skip lines, O1 while [...] ... O1 endwhile to repeat them",
    ),
    (
        "THEN",
        "THEN is not a keyword of this dialect: conditions are O-words",
        "write O1 if [...], the dependent lines, O1 endif",
    ),
];

/// A G code that other dialects use with other words.
struct Form {
    code: f64,
    /// At least one of these words is on the line ...
    any: &'static [u8],
    /// ... and none of these, which mark the code of this dialect.
    none: &'static [u8],
    message: &'static str,
    help: &'static str,
}

const TWO_LINES: &str =
    "in this dialect a roughing cycle is one line, and its profile is a subroutine, not lines P to Q";
const PROFILE: &str =
    "write the profile as O1 sub ... O1 endsub, then G71 or G72 Q1 X.. Z.. D.., D the depth of a pass";

const FORMS: [Form; 6] = [
    Form {
        code: 5.0,
        any: b"P",
        none: b"XYIJ",
        message: "G5 is a cubic spline in this dialect, not a switch for high-speed machining",
        help: "remove the line: look-ahead is always on; G64 P.. sets the tolerance at corners",
    },
    Form {
        code: 50.0,
        any: b"S",
        none: b"",
        message: "G50 S, the highest spindle speed of G96, is the word D of G96 in this dialect",
        help: "write G96 D2000 S.., D the highest speed, 1/min",
    },
    Form {
        code: 92.0,
        any: b"S",
        none: b"XYZABCUVW",
        message: "G92 S, the highest spindle speed of G96, is the word D of G96 in this dialect",
        help: "write G96 D2000 S.., D the highest speed, 1/min",
    },
    Form {
        code: 70.0,
        any: b"PU",
        none: b"XZ",
        message: TWO_LINES,
        help: "write the profile as O1 sub ... O1 endsub, then G70 Q1 X.. Z..",
    },
    Form {
        code: 71.0,
        any: b"PUW",
        none: b"",
        message: TWO_LINES,
        help: PROFILE,
    },
    Form {
        code: 72.0,
        any: b"PUW",
        none: b"",
        message: TWO_LINES,
        help: PROFILE,
    },
];

/// Replaces the error of a line by a better one if the line is written in another dialect.
#[cold]
pub(crate) fn explain(text: &[u8], block: &Block, fault: Fault, context: DialectContext) -> Fault {
    let code = |form: &Form| {
        let has = |letter: &u8| block.words.iter().any(|word| word.letter == *letter);
        let mut codes = block.words.iter().filter(|word| word.letter == b'G');
        let code = codes.find(|word| word.value == form.code)?;
        (form.any.iter().any(has) && !form.none.iter().any(has)).then_some(code.span)
    };
    for form in &FORMS {
        if let Some(span) = code(form) {
            let better = Fault::new(fault.code, span, form.message);
            return match (form.code, value_of(block, b'S')) {
                (50.0 | 92.0, Some(max)) => better.help(format!(
                    "delete the line, and write D{max} on every line with G96, as in G96 D{max} S..: a G96 \
                     without D has no limit but the spindle's"
                )),
                _ => better.help(form.help),
            };
        }
    }
    if let Some(better) = shift_by_g50(block, &fault, context) {
        return better;
    }
    if let Some(better) = foreign_line::explain(text, block, &fault, context) {
        return better;
    }
    let Some((span, word)) = first_word(text) else {
        return fault;
    };
    let found = KEYWORDS.iter().find(|(keyword, ..)| *keyword == word);
    match found {
        Some((_, message, help)) => Fault::new(Code::OWord, span, *message).help(*help),
        None => fault,
    }
}

fn value_of(block: &Block, letter: u8) -> Option<f64> {
    let mut words = block.words.iter();
    words.find(|word| word.letter == letter).map(|word| word.value)
}

/// G50 with axis words, with which other lathes set their coordinates.
fn shift_by_g50(block: &Block, fault: &Fault, context: DialectContext) -> Option<Fault> {
    let mut codes = block.words.iter().filter(|word| word.letter == b'G');
    let span = codes.find(|word| word.value == 50.0)?.span;
    let absolute = [b'X', b'Z'].map(|letter| value_of(block, letter));
    let shifts = [b'U', b'W']
        .iter()
        .any(|letter| value_of(block, *letter).is_some());
    let is_absolute = absolute.iter().any(Option::is_some);
    if !context.is_lathe || !(is_absolute || shifts) {
        return None;
    }
    let help = if shifts {
        "write G92 X.. Z.. with the coordinates that the present position gets; G92.1 clears them".to_owned()
    } else {
        let words = ["X", "Z"].iter().zip(absolute);
        let words: Vec<String> = words
            .filter_map(|(letter, value)| value.map(|value| format!("{letter}{value}")))
            .collect();
        format!("write G92 {}; G92.1 clears it", words.join(" "))
    };
    Some(
        Fault::new(
            fault.code,
            span,
            "G50 with axis words, which sets the coordinates of the present position, is G92 in this dialect",
        )
        .help(help),
    )
}

/// The letters at the start of a line, after `/` and a line number, in capitals.
fn first_word(text: &[u8]) -> Option<(Span, String)> {
    let blank = |byte: &u8| matches!(byte, b' ' | b'\t');
    let skip = |mut position: usize, predicate: &dyn Fn(&u8) -> bool| {
        while text.get(position).is_some_and(predicate) {
            position += 1;
        }
        position
    };
    let mut position = skip(0, &|byte| blank(byte) || *byte == b'/');
    if matches!(text.get(position), Some(b'N' | b'n'))
        && text.get(position + 1).is_some_and(u8::is_ascii_digit)
    {
        position = skip(position + 1, &|byte| byte.is_ascii_digit() || blank(byte));
    }
    let end = skip(position, &u8::is_ascii_alphabetic);
    let word = text.get(position..end)?.to_ascii_uppercase();
    (end > position + 1).then(|| {
        (
            Span::new(position, end),
            String::from_utf8_lossy(&word).into_owned(),
        )
    })
}
