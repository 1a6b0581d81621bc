//! Reads lines from a stream in bounded memory.

use std::io::{BufRead, Read};

use crate::Code;
use crate::diagnostics::diagnostic::{Fault, Span};

/// Reads physical lines. Memory is bounded by the maximum length of a line.
pub(crate) struct LineReader<R> {
    input: R,
    max_line_bytes: usize,
    line: u32,
}

impl<R: BufRead> LineReader<R> {
    pub(crate) fn new(input: R, max_line_bytes: usize) -> Self {
        Self {
            input,
            max_line_bytes,
            line: 0,
        }
    }

    /// Number of the line read last, from 1.
    pub(crate) fn line(&self) -> u32 {
        self.line
    }

    /// Reads the next line into `buffer`, without its end; false at the end of the input. Reading can
    /// continue after [`Code::LineTooLong`], but not after [`Code::ReadFailed`].
    pub(crate) fn read_into(&mut self, buffer: &mut Vec<u8>) -> Result<bool, Fault> {
        if self.input.fill_buf().is_ok_and(<[u8]>::is_empty) {
            // The previous line is kept for errors at the end.
            return Ok(false);
        }
        buffer.clear();
        // Two more than permitted, for CR and LF.
        let limit = self.max_line_bytes.saturating_add(2) as u64;
        let read = self.input.by_ref().take(limit).read_until(b'\n', buffer);
        match read {
            Ok(0) => return Ok(false),
            Ok(_) => self.line = self.line.saturating_add(1),
            Err(error) => {
                self.line = self.line.saturating_add(1);
                return Err(Self::failed(&error));
            }
        }
        let mut ended = buffer.ends_with(b"\n");
        if ended {
            buffer.pop();
        } else if buffer.ends_with(b"\r") {
            ended = self.skip_returns().map_err(|error| Self::failed(&error))?;
        }
        // Some transfers insert CR before each CR LF.
        while ended && buffer.ends_with(b"\r") {
            buffer.pop();
        }
        if buffer.len() > self.max_line_bytes {
            if !ended {
                self.input
                    .skip_until(b'\n')
                    .map_err(|error| Self::failed(&error))?;
            }
            let message = format!("the line is longer than {} bytes", self.max_line_bytes);
            let span = Span::new(self.max_line_bytes, self.max_line_bytes);
            let help = "is this a part program? If so, split the line";
            return Err(Fault::new(Code::LineTooLong, span, message).help(help));
        }
        // The byte order mark that some editors write; columns are counted after it.
        if self.line == 1 && buffer.starts_with(b"\xef\xbb\xbf") {
            buffer.drain(..3);
        }
        Ok(true)
    }

    /// Skips carriage returns. Returns whether the line ends after them; otherwise more of it follows.
    fn skip_returns(&mut self) -> std::io::Result<bool> {
        loop {
            let Some(byte) = self.input.fill_buf()?.first().copied() else {
                return Ok(true);
            };
            match byte {
                b'\r' => self.input.consume(1),
                b'\n' => {
                    self.input.consume(1);
                    return Ok(true);
                }
                _ => return Ok(false),
            }
        }
    }

    fn failed(error: &std::io::Error) -> Fault {
        let message = format!("the program could not be read any further: {error}");
        Fault::new(Code::ReadFailed, Span::new(0, 0), message)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn line_ends_and_byte_order_marks_are_removed() {
        let mut text = Vec::new();
        let mut reader = LineReader::new(&b"\xef\xbb\xbfG0\r\n\nG1\nend"[..], 10);
        for expected in [&b"G0"[..], b"", b"G1", b"end"] {
            assert_eq!(reader.read_into(&mut text), Ok(true));
            assert_eq!(&text[..], expected);
        }
        assert_eq!(reader.read_into(&mut text), Ok(false));
        assert_eq!(reader.line(), 4);
    }

    #[test]
    fn returns_before_a_line_feed_end_one_line() {
        let mut text = Vec::new();
        // At every length of the buffer of the input, and at the maximum length of a line.
        for capacity in 1..12 {
            let input =
                std::io::BufReader::with_capacity(capacity, &b"G0\r\r\n12345\r\r\r\r\nG1\rX\r\nend\r\r"[..]);
            let mut reader = LineReader::new(input, 5);
            for (line, expected) in [&b"G0"[..], b"12345", b"G1\rX", b"end"].into_iter().enumerate() {
                assert_eq!(reader.read_into(&mut text), Ok(true));
                assert_eq!(
                    (reader.line() as usize, &text[..]),
                    (line + 1, expected),
                    "{capacity}"
                );
            }
            assert_eq!(reader.read_into(&mut text), Ok(false));
        }
        // Longer than permitted only by carriage returns.
        let mut reader = LineReader::new(&b"12345\r\rX\nG1\n"[..], 5);
        assert_eq!(
            reader.read_into(&mut text).map_err(|fault| fault.code),
            Err(Code::LineTooLong)
        );
        assert_eq!((reader.read_into(&mut text), &text[..]), (Ok(true), &b"G1"[..]));
    }

    #[test]
    fn the_maximum_line_length_is_exact() {
        let mut text = Vec::new();
        let mut reader = LineReader::new(&b"12345\r\n123456\r\n1234567890123\nG1"[..], 5);
        assert_eq!(reader.read_into(&mut text), Ok(true));
        assert_eq!(
            reader.read_into(&mut text).map_err(|fault| fault.code),
            Err(Code::LineTooLong)
        );
        assert_eq!(
            reader.read_into(&mut text).map_err(|fault| fault.code),
            Err(Code::LineTooLong)
        );
        assert_eq!(reader.read_into(&mut text), Ok(true));
        assert_eq!((reader.line(), &text[..]), (4, &b"G1"[..]));
    }
}
