//! Tokens to the syntax tree of a line.

use crate::Code;
use crate::block::{Block, Value, Word};
use crate::diagnostic::{Fault, Span};
use crate::lexer::{Lexer, Token};

/// Whether the line begins with `/`: with block delete on it is left out without being looked at.
pub(crate) fn is_block_delete(text: &[u8]) -> bool {
    first_character(text) == Some(b'/')
}

/// Whether the line is a `%` and nothing else.
pub(crate) fn is_percent(text: &[u8]) -> bool {
    let mut rest = text.iter().filter(|byte| !matches!(byte, b' ' | b'\t'));
    rest.next() == Some(&b'%') && rest.next().is_none()
}

/// First character of a line that is not blank.
pub(crate) fn first_character(text: &[u8]) -> Option<u8> {
    text.iter().copied().find(|byte| !matches!(byte, b' ' | b'\t'))
}

/// Reads one line into `block`, whatever was in there before.
pub(crate) fn parse(text: &[u8], block: &mut Block) -> Result<(), Fault> {
    block.clear();
    let mut lexer = Lexer::new(text);
    // What may still come at the beginning: `/`, then N.
    let mut first = true;
    let mut numbered = false;
    while let Some((token, place)) = lexer.next()? {
        match token {
            Token::Letter(b'O') => {
                return Err(
                    Fault::new(Code::OWord, place, "O: subroutines, loops and program numbers")
                        .help("O-words are not available yet"),
                );
            }
            Token::Letter(b'N') => {
                if numbered || !block.words.is_empty() {
                    let message = "N: a line number only stands at the beginning of a line, once";
                    return Err(Fault::new(Code::MisplacedLineNumber, place, message));
                }
                numbered = true;
                let (number, span) = lexer.value(b'N', place)?;
                if number < 0.0 {
                    let message = format!("N{number}: a line number is not negative");
                    return Err(Fault::new(
                        Code::Negative,
                        Span {
                            start: place.start,
                            ..span
                        },
                        message,
                    ));
                }
            }
            Token::Letter(letter) => {
                let (number, span) = lexer.value(letter, place)?;
                let span = Span {
                    start: place.start,
                    end: span.end,
                };
                block.words.push(Word {
                    letter,
                    value: Value::Literal(number),
                    span,
                });
            }
            Token::Comment(inside) => block.comments.push(inside),
            Token::Slash if first => {}
            Token::Slash => {
                let message = "'/' only stands at the beginning of a line";
                return Err(Fault::new(Code::MisplacedBlockDelete, place, message));
            }
            Token::Number(_) => {
                return Err(Fault::new(
                    Code::LetterMissing,
                    place,
                    "a number without a letter before it",
                ));
            }
        }
        first = false;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(text: &str) -> Vec<(char, f64)> {
        let mut block = Block::default();
        parse(text.as_bytes(), &mut block).unwrap();
        block
            .words
            .iter()
            .map(|word| (char::from(word.letter), word.value.evaluate()))
            .collect()
    }

    #[test]
    fn case_and_blanks_mean_nothing() {
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
        parse(b"G1 x - 2 . 5 Y3", &mut block).unwrap();
        assert_eq!(block.words[1].span, Span::new(3, 12));
    }

    #[test]
    fn percent_lines_hold_nothing_else() {
        assert!(is_percent(b" % \t"));
        assert!(!is_percent(b"%1") && !is_percent(b"") && !is_percent(b"%%"));
    }
}
