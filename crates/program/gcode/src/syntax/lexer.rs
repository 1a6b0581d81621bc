//! Splits characters into tokens.
//!
//! RS274/NGC, 3.3.2: letters in either case; spaces and tabs have no meaning outside comments, even inside a
//! number. Numbers have an optional sign, digits, at most one point, at least one digit and no exponent.

use crate::Code;
use crate::diagnostics::diagnostic::{Fault, Span};
use crate::parameters::values::NUMBERED;

/// Maximum magnitude of a number in a program: 1000 km in mm, where a double still resolves micrometres.
pub(crate) const MAX_NUMBER: f64 = 1e9;

/// Reads a line character by character.
pub(crate) struct Lexer<'text> {
    text: &'text [u8],
    at: usize,
}

impl<'text> Lexer<'text> {
    pub(crate) fn new(text: &'text [u8]) -> Self {
        Self { text, at: 0 }
    }

    /// The present position.
    pub(crate) fn position(&self) -> usize {
        self.at
    }

    /// Skips the next character, which has been peeked.
    #[inline]
    pub(crate) fn advance(&mut self) {
        self.at += 1;
    }

    /// Continues at another position.
    pub(crate) fn seek(&mut self, position: usize) {
        self.at = position;
    }

    /// Skips the rest of the line.
    pub(crate) fn skip_rest(&mut self) {
        self.at = self.text.len();
    }

    /// The whole line.
    pub(crate) fn text(&self) -> &'text [u8] {
        self.text
    }

    /// Takes the next character if it is this one.
    #[inline]
    pub(crate) fn take(&mut self, byte: u8) -> bool {
        let is_next = self.peek() == Some(byte);
        if is_next {
            self.at += 1;
        }
        is_next
    }

    /// Takes consecutive letters, in lower case and without spaces between them; at most 15. Further letters
    /// are dropped, because no keyword is that long.
    pub(crate) fn take_letters(&mut self, into: &mut [u8; 16]) -> usize {
        let mut count = 0;
        while let Some(byte) = self.peek() {
            if !byte.is_ascii_alphabetic() {
                break;
            }
            if count < into.len() - 1 {
                into[count] = byte.to_ascii_lowercase();
                count += 1;
            }
            self.at += 1;
        }
        count
    }

    /// Takes the keyword if it comes next, in either case and with spaces anywhere.
    pub(crate) fn keyword(&mut self, keyword: &[u8]) -> bool {
        let start = self.at;
        for &letter in keyword {
            match self.peek() {
                Some(byte) if byte.to_ascii_lowercase() == letter => self.at += 1,
                _ => {
                    self.at = start;
                    return false;
                }
            }
        }
        true
    }

    /// The second next character that is not a space, without taking any.
    pub(crate) fn peek_second(&self) -> Option<u8> {
        let mut rest = self.text.get(self.at..)?.iter();
        let mut significant = rest
            .by_ref()
            .copied()
            .filter(|byte| !matches!(byte, b' ' | b'\t'));
        significant.next()?;
        significant.next()
    }

    /// The text between `<` and `>`; the next character is `<`.
    pub(crate) fn name(&mut self) -> Result<Span, Fault> {
        let open = self.at;
        let mut depth = 0_u32;
        for (index, &byte) in self.text.iter().enumerate().skip(open + 1) {
            match byte {
                b'>' if depth == 0 => {
                    self.at = index + 1;
                    return Ok(Span::new(open + 1, index));
                }
                b'[' => depth += 1,
                b']' => depth = depth.saturating_sub(1),
                b'(' | b'<' => break,
                _ => {}
            }
        }
        let message = "this name is not closed";
        Err(Fault::new(Code::BadName, Span::at(open), message).help("write > after it, as in #<width>"))
    }

    /// The next character that is not a space, without taking it.
    #[inline]
    pub(crate) fn peek(&mut self) -> Option<u8> {
        while let Some(&byte) = self.text.get(self.at) {
            if byte != b' ' && byte != b'\t' {
                return Some(byte);
            }
            self.at += 1;
        }
        None
    }

    /// The number of a parameter in its usual form: `#` and up to four digits, without spaces. `None`, and
    /// nothing taken, for any other form, and if the parameter does not exist. The next character is `#`.
    #[inline]
    pub(crate) fn index(&mut self) -> Option<usize> {
        let (index, end) = self.short_integer(self.at + 1)?;
        if !(1..NUMBERED).contains(&index) {
            return None;
        }
        self.at = end;
        Some(index)
    }

    /// An integer of up to four digits that is not followed by a space, and its end.
    #[inline]
    pub(crate) fn short_integer(&self, start: usize) -> Option<(usize, usize)> {
        let mut end = start;
        let mut value = 0;
        while let Some(byte @ b'0'..=b'9') = self.text.get(end) {
            if end - start == 4 {
                return None;
            }
            value = 10 * value + usize::from(byte - b'0');
            end += 1;
        }
        let continues = matches!(self.text.get(end), Some(b'.' | b' ' | b'\t'));
        (end > start && !continues).then_some((value, end))
    }

    /// Reads a number; the next character is a digit, a point or a sign.
    #[inline]
    pub(crate) fn number(&mut self) -> Result<f64, Fault> {
        match self.plain_number() {
            Some(value) => Ok(value),
            None => self.any_number(),
        }
    }

    /// A number in its usual form: up to 15 digits without spaces between them. `None`, and nothing taken,
    /// for any other form.
    #[inline]
    fn plain_number(&mut self) -> Option<f64> {
        let text = self.text;
        let mut at = self.at;
        let is_negative = text.get(at) == Some(&b'-');
        if matches!(text.get(at), Some(b'+' | b'-')) {
            at += 1;
        }
        // Sums wrap if there are more digits than permitted, and are not used then.
        let mut mantissa: u64 = 0;
        let first = at;
        let digits = |mut at: usize, mantissa: &mut u64| {
            while let Some(byte) = text.get(at) {
                let digit = byte.wrapping_sub(b'0');
                if digit > 9 {
                    break;
                }
                *mantissa = mantissa.wrapping_mul(10).wrapping_add(u64::from(digit));
                at = at.wrapping_add(1);
            }
            at
        };
        at = digits(at, &mut mantissa);
        let mut count = at - first;
        let mut decimals = 0;
        if text.get(at) == Some(&b'.') {
            let point = at + 1;
            at = digits(point, &mut mantissa);
            decimals = at - point;
            count += decimals;
        }
        if !(1..=15).contains(&count) {
            return None;
        }
        // A number may continue after spaces.
        let mut next = at;
        while matches!(text.get(next), Some(b' ' | b'\t')) {
            next += 1;
        }
        if matches!(text.get(next), Some(b'0'..=b'9' | b'.')) {
            return None;
        }
        // As below: both are exact, so the quotient is correctly rounded.
        let magnitude = mantissa as f64 / POWERS_OF_TEN.get(decimals)?;
        if magnitude > MAX_NUMBER {
            return None;
        }
        self.at = at;
        Some(if is_negative { -magnitude } else { magnitude })
    }

    fn any_number(&mut self) -> Result<f64, Fault> {
        let start = self.at;
        let is_negative = self.text[start] == b'-';
        if matches!(self.text[start], b'+' | b'-') {
            self.at += 1;
        }
        let mut mantissa: u64 = 0;
        let mut digits: u32 = 0;
        let mut decimals: usize = 0;
        let mut has_point = false;
        let mut is_exact = true;
        let mut end = self.at;
        while let Some(&byte) = self.text.get(self.at) {
            match byte {
                b'0'..=b'9' => {
                    digits += 1;
                    // Further digits do not fit the fast path; they are read again below.
                    if mantissa < 100_000_000_000_000 {
                        mantissa = mantissa * 10 + u64::from(byte - b'0');
                        decimals += usize::from(has_point);
                    } else {
                        is_exact = false;
                    }
                }
                b'.' if !has_point => has_point = true,
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
            Some(power) if is_exact => mantissa as f64 / power,
            _ => self.slow_number(start, end)?,
        };
        if magnitude > MAX_NUMBER {
            let message = format!("a number beyond {MAX_NUMBER:e}");
            return Err(Fault::new(Code::NumberTooLarge, Span::new(start, end), message)
                .help("no machine travels that far; is a decimal point missing?"));
        }
        Ok(if is_negative { -magnitude } else { magnitude })
    }

    #[cold]
    fn no_digits(&self, start: usize) -> Fault {
        let next = self.text.get(self.at).copied();
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

    /// Reads a comment; the next character is `(`. It may contain any bytes.
    pub(crate) fn comment(&mut self) -> Result<Span, Fault> {
        let open = self.at;
        for (index, &byte) in self.text.iter().enumerate().skip(open + 1) {
            match byte {
                b')' => {
                    self.at = index + 1;
                    return Ok(Span::new(open + 1, index));
                }
                b'(' => {
                    let message = "a comment inside a comment";
                    return Err(Fault::new(Code::NestedComment, Span::at(index), message)
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
        .help("write ) at its end; a comment does not continue on the next line"))
    }

    #[cold]
    pub(crate) fn unexpected(&self, byte: u8) -> Fault {
        let span = Span::at(self.at);
        match byte {
            b'[' => Fault::new(
                Code::LetterMissing,
                span,
                "an expression without a letter before it",
            )
            .help("write a letter before the value, as in X[1 + 2]"),
            b']' => {
                Fault::new(Code::Expression, span, "']' closes nothing").help("is a [ missing before it?")
            }
            b')' => Fault::new(
                Code::StrayParenthesis,
                span,
                "')' closes a comment that was not opened",
            ),
            b'%' => Fault::new(Code::StrayPercent, span, "'%' in the middle of a program")
                .help("% must be alone on the first line and on the last"),
            b'\r' => Fault::new(Code::StrayReturn, span, "a carriage return inside a line")
                .help("end lines with LF or CR LF"),
            b' '..=b'~' => {
                let message = format!("'{}' has no meaning here", char::from(byte));
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
        let bytes = &self.text[self.at..self.text.len().min(self.at + 4)];
        // Windows marks UTF-16 by its first two bytes.
        let help = if self.text.starts_with(&[0xFF, 0xFE]) || self.text.starts_with(&[0xFE, 0xFF]) {
            "the file is UTF-16; save it as plain text or UTF-8"
        } else {
            "outside comments a program must be plain ASCII"
        };
        match String::from_utf8_lossy(bytes).chars().next() {
            Some(character) if character != char::REPLACEMENT_CHARACTER => {
                let span = Span::new(self.at, self.at + character.len_utf8());
                let shown = character.escape_debug();
                Fault::new(Code::NotAscii, span, format!("'{shown}' has no meaning here")).help(help)
            }
            _ => {
                let message = format!("byte 0x{byte:02x}, which is not valid UTF-8");
                Fault::new(Code::NotAscii, Span::at(self.at), message).help(help)
            }
        }
    }
}

/// The powers of ten that a double represents exactly and a number of 15 digits needs.
const POWERS_OF_TEN: [f64; 16] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15,
];

#[cfg(test)]
mod tests {
    use super::*;

    fn number(text: &str) -> Result<f64, Code> {
        let mut lexer = Lexer::new(text.as_bytes());
        lexer.peek();
        let value = lexer.number().map_err(|fault| fault.code)?;
        assert_eq!(lexer.peek(), None, "{text:?} is not read to its end");
        Ok(value)
    }

    #[test]
    fn standard_numbers_are_parsed() {
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
    fn numbers_are_correctly_rounded() {
        // Independent: the decimal conversion of the standard library is exact to the last bit.
        let mut random = evolvent_random::Random::from_state(0x9e37_79b9_7f4a_7c15);
        for _ in 0..20_000 {
            let state = random.bits();
            let decimals = (state % 25) as usize;
            let text = format!("{}.{:0decimals$}", state % 1_000_000, state >> 20);
            assert_eq!(number(&text), Ok(text.parse::<f64>().unwrap()), "{text:?}");
        }
    }

    #[test]
    fn invalid_numbers_are_rejected() {
        for (text, expected) in [
            (".", Code::BadNumber),
            ("+-1", Code::BadNumber),
            ("--1", Code::BadNumber),
            ("1.2.3", Code::BadNumber),
            ("-", Code::BadNumber),
            ("1000000001", Code::NumberTooLarge),
            (&"9".repeat(400), Code::NumberTooLarge),
        ] {
            assert_eq!(number(text), Err(expected), "{text:?}");
        }
    }
}
