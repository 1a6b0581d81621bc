//! Converts characters into words with values.

use crate::Code;
use crate::diagnostics::diagnostic::{Fault, Span};
use crate::parameters::names::NormalizedName;
use crate::parameters::values::Parameters;
use crate::state::scope::Scope;
use crate::syntax::block::{Block, Keyword, OWord, Word};
use crate::syntax::expression::Evaluator;
use crate::syntax::expression::Target;
use crate::syntax::lexer::{Lexer, MAX_NUMBER};

/// Whether the line starts with `/`: with block delete on it is skipped unread.
pub(crate) fn is_block_delete(text: &[u8]) -> bool {
    first_character(text) == Some(b'/')
}

/// Whether the line consists of a `%`.
pub(crate) fn is_percent(text: &[u8]) -> bool {
    let mut rest = text.iter().filter(|byte| !matches!(byte, b' ' | b'\t'));
    rest.next() == Some(&b'%') && rest.next().is_none()
}

/// First character of a line that is not a space.
pub(crate) fn first_character(text: &[u8]) -> Option<u8> {
    text.iter().copied().find(|byte| !matches!(byte, b' ' | b'\t'))
}

/// Reads one line into `block`, replacing its contents.
pub(crate) fn parse(text: &[u8], block: &mut Block, scope: &Scope<'_>) -> Result<(), Fault> {
    block.clear();
    let mut lexer = Lexer::new(text);
    // What may still come at the start: `/`, then N, then O.
    let mut is_first = true;
    let mut has_line_number = false;
    while let Some(byte) = lexer.peek() {
        let start = lexer.position();
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'@' | b'^' | b'$' => {
                lexer.advance();
                let letter = byte.to_ascii_uppercase();
                let value = match Evaluator::new(&mut lexer, scope).value()? {
                    Some(value) => value,
                    None => return Err(no_value(&mut lexer, letter, start)),
                };
                let span = Span::new(start, lexer.position());
                if letter == b'N' {
                    line_number(value, span, has_line_number || !block.words.is_empty())?;
                    has_line_number = true;
                } else {
                    if value.abs() > MAX_NUMBER {
                        return Err(too_large(letter, value, span));
                    }
                    block.words.push(Word { letter, value, span });
                }
            }
            b'#' => assignment(&mut lexer, block, scope)?,
            b'(' => block.comments.push(lexer.comment()?),
            b';' => lexer.skip_rest(),
            b'/' if is_first => lexer.advance(),
            b'/' => {
                let message = "'/' is only permitted at the start of a line";
                return Err(Fault::new(Code::MisplacedBlockDelete, Span::at(start), message));
            }
            b'0'..=b'9' | b'.' | b'+' | b'-' => {
                lexer.number()?;
                let span = Span::new(start, lexer.position());
                return Err(Fault::new(
                    Code::LetterMissing,
                    span,
                    "a number without a letter before it",
                ));
            }
            other => return Err(lexer.unexpected(other)),
        }
        is_first = false;
    }
    Ok(())
}

fn line_number(number: f64, span: Span, is_misplaced: bool) -> Result<(), Fault> {
    if is_misplaced {
        let message = "N: a line number is only permitted once, at the start of a line";
        return Err(Fault::new(
            Code::MisplacedLineNumber,
            Span::at(span.start as usize),
            message,
        ));
    }
    if number < 0.0 {
        let message = format!("N{number}: a line number must not be negative");
        return Err(Fault::new(Code::Negative, span, message));
    }
    Ok(())
}

#[cold]
fn too_large(letter: u8, value: f64, span: Span) -> Fault {
    let message = format!("{}{value:e} is beyond {MAX_NUMBER:e}", char::from(letter));
    Fault::new(Code::NumberTooLarge, span, message).help("no machine travels that far")
}

#[cold]
fn no_value(lexer: &mut Lexer<'_>, letter: u8, start: usize) -> Fault {
    let letter_name = char::from(letter);
    match lexer.peek() {
        Some(byte) if !byte.is_ascii_alphabetic() && byte != b'(' && byte != b';' => {
            let mut fault = lexer.unexpected(byte);
            fault.message = format!("{letter_name} needs a number; {}", fault.message);
            fault
        }
        _ => Fault::new(
            Code::NumberMissing,
            Span::at(start),
            format!("{letter_name} needs a number directly after it"),
        ),
    }
}

/// `#5 = 3`; the next character is `#`.
fn assignment(lexer: &mut Lexer<'_>, block: &mut Block, scope: &Scope<'_>) -> Result<(), Fault> {
    let start = lexer.position();
    let mut evaluator = Evaluator::new(lexer, scope);
    let target = evaluator.target()?;
    let span = Span::new(start, evaluator.lexer.position());
    if !evaluator.lexer.take(b'=') {
        let message = "a parameter without a letter before it or '=' after it";
        return Err(
            Fault::new(Code::LetterMissing, span, message).help("write #5 = 3 to set it, X#5 to use it")
        );
    }
    let value = evaluator.required("after '='")?;
    match target {
        Target::Numbered(index) if Parameters::is_read_only(index) => {
            let message = format!("#{index} cannot be written");
            return Err(Fault::new(Code::ReadOnlyParameter, span, message));
        }
        Target::Named(inside) => {
            let name = evaluator.normalized_name(inside)?;
            if crate::parameters::system::System::of(name.as_str()).is_some() {
                let message = format!("#<{}> cannot be written", name.as_str());
                return Err(Fault::new(Code::ReadOnlyParameter, span, message)
                    .help("it shows the state of the interpreter; choose another name"));
            }
        }
        Target::Numbered(_) => {}
    }
    block.assignments.push((target, value));
    Ok(())
}

/// The O-word at the start of a line; `None` for any other line.
#[inline]
pub(crate) fn o_word(text: &[u8], scope: &Scope<'_>) -> Result<Option<OWord>, Fault> {
    match first_character(text) {
        Some(b'o' | b'O' | b'n' | b'N' | b'/') => read_o_word(text, scope),
        _ => Ok(None),
    }
}

fn read_o_word(text: &[u8], scope: &Scope<'_>) -> Result<Option<OWord>, Fault> {
    let mut lexer = Lexer::new(text);
    if lexer.peek() == Some(b'/') {
        lexer.advance();
    }
    if matches!(lexer.peek(), Some(b'n' | b'N')) {
        lexer.advance();
        // An invalid line number is reported when the line is read as an ordinary one.
        if !matches!(lexer.peek(), Some(b'0'..=b'9' | b'.')) || lexer.number().is_err() {
            return Ok(None);
        }
    }
    let start = match lexer.peek() {
        Some(b'o' | b'O') => lexer.position(),
        _ => return Ok(None),
    };
    lexer.advance();
    let malformed = |lexer: &Lexer<'_>, message: &str| {
        Fault::new(
            Code::OWord,
            Span::new(start, lexer.position()),
            message.to_owned(),
        )
        .help("write O and a number or a <name>, then sub, call, if, while, do, repeat ...")
    };
    let name = match lexer.peek() {
        Some(b'<') => {
            let inside = lexer.name()?;
            NormalizedName::new(&text[inside.start as usize..inside.end as usize])
        }
        Some(b'0'..=b'9' | b'#' | b'[') => {
            if let Some((number, end)) = lexer.short_integer(lexer.position()) {
                lexer.seek(end);
                Some(NormalizedName::of_number(number as u32))
            } else {
                let number = Evaluator::new(&mut lexer, scope).value()?.unwrap_or(-1.0);
                let is_integer = (number - number.round()).abs() <= 1e-4;
                if !(0.0..=f64::from(u32::MAX)).contains(&number) || !is_integer {
                    return Err(malformed(
                        &lexer,
                        "the number of an O-word must be an integer of at least 0",
                    ));
                }
                Some(NormalizedName::of_number(number.round() as u32))
            }
        }
        _ => return Err(malformed(&lexer, "O without a number or a name")),
    };
    let Some(name) = name else {
        return Err(malformed(&lexer, "this is not a valid name for an O-word"));
    };
    let span = Span::new(start, lexer.position());
    let mut letters = [0; 16];
    lexer.peek();
    let keyword_start = lexer.position();
    let length = lexer.take_letters(&mut letters);
    let keyword = match Keyword::of(&letters[..length]) {
        Some(keyword) => keyword,
        None => {
            let shown = String::from_utf8_lossy(&letters[..length]).into_owned();
            let span = Span::new(keyword_start, lexer.position());
            return Err(
                Fault::new(Code::OWord, span, format!("there is no O-word {shown}")).help(
                    "O-words are sub endsub call return, if elseif else endif, while endwhile do, repeat \
                 endrepeat, break continue",
                ),
            );
        }
    };
    Ok(Some(OWord {
        span,
        name,
        keyword,
        rest: lexer.position(),
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::state::scope::tests::with_scope;

    fn words(text: &str) -> Vec<(char, f64)> {
        let mut block = Block::default();
        with_scope(|scope| parse(text.as_bytes(), &mut block, scope)).unwrap();
        block
            .words
            .iter()
            .map(|word| (char::from(word.letter), word.value))
            .collect()
    }

    #[test]
    fn words_ignore_case_and_blanks() {
        // The standard's own example, 3.3.2.
        assert_eq!(words("g0x +0. 12 34y 7"), words("G0 X+0.1234 Y7"));
        assert_eq!(words("g0x +0. 12 34y 7"), [('G', 0.0), ('X', 0.1234), ('Y', 7.0)]);
    }

    #[test]
    fn comments_and_line_numbers_leave_no_words() {
        assert_eq!(words("/ (a) N0010 (b) G1(c)X1 ; G2 [#"), [('G', 1.0), ('X', 1.0)]);
        assert_eq!(words("(only) ; this"), []);
        assert_eq!(words(""), []);
    }

    #[test]
    fn spans_cover_letter_and_number() {
        let mut block = Block::default();
        with_scope(|scope| parse(b"G1 x - 2 . 5 Y3", &mut block, scope)).unwrap();
        assert_eq!(block.words[1].span, Span::new(3, 12));
    }

    #[test]
    fn percent_lines_contain_nothing_else() {
        assert!(is_percent(b" % \t"));
        assert!(!is_percent(b"%1") && !is_percent(b"") && !is_percent(b"%%"));
    }
}
