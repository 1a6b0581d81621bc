//! Characters to tokens.
//!
//! RS274/NGC, 3.3.2: letters in either case; blanks and tabs mean nothing anywhere outside comments, even inside
//! a number. Numbers have an optional sign, digits, at most one point, at least one digit and no exponent.

use crate::Code;
use crate::diagnostic::{Fault, Span};

/// Greatest magnitude of a number in a program. Ten thousand kilometres of mm leave a double its micrometres.
pub(crate) const LARGEST_NUMBER: f64 = 1e9;

const NO_FORMULAS: &str = "parameters, formulas and O-words are not available yet: write numbers";

/// A token.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Token {
    /// A letter, upper case.
    Letter(u8),
    /// A number; finite, at most [`LARGEST_NUMBER`].
    Number(f64),
    /// The inside of a `(comment)`.
    Comment(Span),
    /// `/`.
    Slash,
}

/// Walks along a line.
pub(crate) struct Lexer<'text> {
    text: &'text [u8],
    at: usize,
}

impl<'text> Lexer<'text> {
    pub(crate) fn new(text: &'text [u8]) -> Self {
        Self { text, at: 0 }
    }

    /// The next token and its place; `None` at the end of the line or at a `;`.
    #[inline]
    pub(crate) fn next(&mut self) -> Result<Option<(Token, Span)>, Fault> {
        let Some(byte) = self.peek() else { return Ok(None) };
        let start = self.at;
        let token = match byte {
            b'a'..=b'z' | b'A'..=b'Z' => {
                self.at += 1;
                Token::Letter(byte.to_ascii_uppercase())
            }
            b'0'..=b'9' | b'.' | b'+' | b'-' => Token::Number(self.number()?),
            b'(' => Token::Comment(self.comment()?),
            b';' => {
                self.at = self.text.len();
                return Ok(None);
            }
            b'/' => {
                self.at += 1;
                Token::Slash
            }
            _ => return Err(self.unexpected(byte)),
        };
        Ok(Some((token, Span::new(start, self.at))))
    }

    /// The number that must follow the letter that has just been read.
    #[inline]
    pub(crate) fn value(&mut self, letter: u8, place: Span) -> Result<(f64, Span), Fault> {
        let found = self.peek();
        let start = self.at;
        if let Some(b'0'..=b'9' | b'.' | b'+' | b'-') = found {
            let number = self.number()?;
            return Ok((number, Span::new(start, self.at)));
        }
        Err(self.value_missing(letter, place, found))
    }

    #[cold]
    fn value_missing(&self, letter: u8, place: Span, found: Option<u8>) -> Fault {
        let name = char::from(letter);
        match found {
            Some(byte @ (b'#' | b'[')) => self.unexpected(byte),
            Some(b'a'..=b'z' | b'A'..=b'Z') if self.function_follows() => {
                let message = format!("{name} is given by a function");
                Fault::new(Code::Expression, Span::at(self.at), message).help(NO_FORMULAS)
            }
            Some(byte) if !byte.is_ascii_alphabetic() && byte != b'(' && byte != b';' => {
                let mut fault = self.unexpected(byte);
                fault.message = format!("{name} needs a number; {}", fault.message);
                fault
            }
            _ => Fault::new(
                Code::NumberMissing,
                place,
                format!("{name} needs a number right after it"),
            ),
        }
    }

    /// Whether letters follow and then `[`: `SIN[`, `FUP[`.
    fn function_follows(&self) -> bool {
        let rest = self.text[self.at..]
            .iter()
            .filter(|byte| !matches!(byte, b' ' | b'\t'));
        rest.copied().find(|byte| !byte.is_ascii_alphabetic()) == Some(b'[')
    }

    /// The next character that means something, not taken.
    #[inline]
    fn peek(&mut self) -> Option<u8> {
        while let Some(&byte) = self.text.get(self.at) {
            if byte != b' ' && byte != b'\t' {
                return Some(byte);
            }
            self.at += 1;
        }
        None
    }

    /// Reads a number; the next character is a digit, a point or a sign.
    #[inline]
    fn number(&mut self) -> Result<f64, Fault> {
        let start = self.at;
        let negative = self.text[start] == b'-';
        if matches!(self.text[start], b'+' | b'-') {
            self.at += 1;
        }
        let mut mantissa: u64 = 0;
        let mut digits: u32 = 0;
        let mut decimals: usize = 0;
        let mut point = false;
        let mut exact = true;
        let mut end = self.at;
        while let Some(&byte) = self.text.get(self.at) {
            match byte {
                b'0'..=b'9' => {
                    digits += 1;
                    // Digits beyond these do not fit the fast way; they are read again below.
                    if mantissa < 100_000_000_000_000 {
                        mantissa = mantissa * 10 + u64::from(byte - b'0');
                        decimals += usize::from(point);
                    } else {
                        exact = false;
                    }
                }
                b'.' if !point => point = true,
                b'.' => {
                    let span = Span::new(start, self.at + 1);
                    return Err(Fault::new(
                        Code::BadNumber,
                        span,
                        "a number with two decimal points",
                    ));
                }
                b' ' | b'\t' => {
                    self.at += 1;
                    continue;
                }
                _ => break,
            }
            self.at += 1;
            end = self.at;
        }
        if digits == 0 {
            return Err(self.no_digits(start));
        }
        self.at = end;
        // Below 2^53 and with at most 22 decimals numerator and denominator are exact doubles, so the
        // quotient is the correctly rounded value of the decimal (Clinger 1990).
        let magnitude = match POWERS_OF_TEN.get(decimals) {
            Some(power) if exact => mantissa as f64 / power,
            _ => self.slow_number(start, end)?,
        };
        if magnitude > LARGEST_NUMBER {
            let message = format!("a number beyond {LARGEST_NUMBER:e}");
            return Err(Fault::new(Code::NumberTooLarge, Span::new(start, end), message)
                .help("no machine travels that far; is a decimal point missing?"));
        }
        Ok(if negative { -magnitude } else { magnitude })
    }

    #[cold]
    fn no_digits(&self, start: usize) -> Fault {
        let next = self.text.get(self.at).copied();
        if let Some(byte @ (b'#' | b'[')) = next {
            return self.unexpected(byte);
        }
        let end = if matches!(next, Some(b'+' | b'-')) {
            self.at + 1
        } else {
            self.at.max(start + 1)
        };
        let message = "a number without digits";
        Fault::new(Code::BadNumber, Span::new(start, end), message)
            .help("write one optional sign, digits and at most one decimal point, such as -12.5")
    }

    /// Magnitude of a number with many digits, correctly rounded.
    #[cold]
    fn slow_number(&self, start: usize, end: usize) -> Result<f64, Fault> {
        let digits: String = self.text[start..end]
            .iter()
            .filter(|byte| byte.is_ascii_digit() || **byte == b'.')
            .map(|byte| char::from(*byte))
            .collect();
        digits
            .parse::<f64>()
            .map_err(|error| Fault::new(Code::BadNumber, Span::new(start, end), error.to_string()))
    }

    /// Reads a comment; the next character is `(`. Whatever is inside may be any bytes.
    fn comment(&mut self) -> Result<Span, Fault> {
        let open = self.at;
        for (place, &byte) in self.text.iter().enumerate().skip(open + 1) {
            match byte {
                b')' => {
                    self.at = place + 1;
                    return Ok(Span::new(open + 1, place));
                }
                b'(' => {
                    let message = "a comment inside a comment";
                    return Err(Fault::new(Code::NestedComment, Span::at(place), message)
                        .help("close the first one with ) or write [ ] inside"));
                }
                _ => {}
            }
        }
        Err(Fault::new(
            Code::UnclosedComment,
            Span::at(open),
            "this comment is not closed",
        )
        .help("write ) at its end; a comment does not go on in the next line"))
    }

    #[cold]
    fn unexpected(&self, byte: u8) -> Fault {
        let span = Span::at(self.at);
        match byte {
            b'#' => Fault::new(Code::Parameter, span, "'#': a parameter").help(NO_FORMULAS),
            b'[' => Fault::new(Code::Expression, span, "'[': an expression").help(NO_FORMULAS),
            b'@' | b'^' => {
                let message = format!("'{}': polar coordinates are not available yet", char::from(byte));
                Fault::new(Code::PolarCoordinates, span, message).help("write X and Y")
            }
            b'$' => {
                Fault::new(Code::SpindleSelection, span, "'$': there is only one spindle").help("leave $ out")
            }
            b')' => Fault::new(
                Code::StrayParenthesis,
                span,
                "')' closes a comment that was not opened",
            ),
            b'%' => Fault::new(Code::StrayPercent, span, "'%' in the middle of a program")
                .help("% stands alone, on the first line and on the last"),
            b'\r' => Fault::new(Code::StrayReturn, span, "a carriage return inside a line")
                .help("end lines with LF or CR LF"),
            b' '..=b'~' => {
                let message = format!("'{}' means nothing here", char::from(byte));
                Fault::new(Code::UnexpectedCharacter, span, message)
            }
            0..=0x7f => {
                let message = format!("control character 0x{byte:02x}");
                Fault::new(Code::UnexpectedCharacter, span, message).help("is this a part program?")
            }
            _ => self.not_ascii(byte),
        }
    }

    fn not_ascii(&self, byte: u8) -> Fault {
        let piece = &self.text[self.at..self.text.len().min(self.at + 4)];
        let help = "outside comments a program is plain ASCII";
        match String::from_utf8_lossy(piece).chars().next() {
            Some(character) if character != char::REPLACEMENT_CHARACTER => {
                let span = Span::new(self.at, self.at + character.len_utf8());
                let shown = character.escape_debug();
                Fault::new(Code::NotAscii, span, format!("'{shown}' means nothing here")).help(help)
            }
            _ => {
                let message = format!("byte 0x{byte:02x}, which is not even UTF-8");
                Fault::new(Code::NotAscii, Span::at(self.at), message).help(help)
            }
        }
    }
}

/// The powers of ten that a double holds exactly and a number of 15 digits needs.
const POWERS_OF_TEN: [f64; 16] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15,
];

#[cfg(test)]
mod tests {
    use super::*;

    fn number(text: &str) -> Result<f64, Code> {
        let mut lexer = Lexer::new(text.as_bytes());
        let value = lexer.value(b'X', Span::at(0)).map_err(|fault| fault.code)?;
        assert!(
            lexer.next().is_ok_and(|token| token.is_none()),
            "{text:?} is not read to its end"
        );
        Ok(value.0)
    }

    #[test]
    fn numbers_of_the_standard_are_read() {
        for (text, expected) in [
            ("0", 0.0),
            ("+0012.50", 12.5),
            ("-.5", -0.5),
            ("5.", 5.0),
            (" - 1 2 . 3\t4 ", -12.34),
            ("000000000000000000000000000000012", 12.0),
            ("999999999.999999", 999_999_999.999_999),
        ] {
            assert_eq!(number(text), Ok(expected), "{text:?}");
        }
    }

    #[test]
    fn numbers_are_correctly_rounded_like_the_standard_library_s() {
        // Independent: the standard library's decimal conversion is exact to the last bit.
        let mut state = 0x9e37_79b9_7f4a_7c15_u64;
        for _ in 0..20_000 {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            let decimals = (state % 25) as usize;
            let text = format!("{}.{:0decimals$}", state % 1_000_000, state >> 20);
            assert_eq!(number(&text), Ok(text.parse::<f64>().unwrap()), "{text:?}");
        }
    }

    #[test]
    fn what_is_no_number_is_refused() {
        for (text, expected) in [
            ("", Code::NumberMissing),
            (".", Code::BadNumber),
            ("+-1", Code::BadNumber),
            ("--1", Code::BadNumber),
            ("1.2.3", Code::BadNumber),
            ("-", Code::BadNumber),
            ("1000000001", Code::NumberTooLarge),
            (&"9".repeat(400), Code::NumberTooLarge),
            ("-#1", Code::Parameter),
            ("-[1]", Code::Expression),
            ("SIN[30]", Code::Expression),
        ] {
            assert_eq!(number(text), Err(expected), "{text:?}");
        }
    }
}
