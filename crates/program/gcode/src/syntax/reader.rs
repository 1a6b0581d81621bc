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

    /// Reads the next line into `buffer`, without its end; false at the end of the input. Reading can continue after
    /// [`Code::LineTooLong`], but not after [`Code::ReadFailed`].
    pub(crate) fn read_into(&mut self, buffer: &mut Vec<u8>) -> Result<bool, Fault> {
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
        let ended = buffer.ends_with(b"\n");
        if ended {
            buffer.pop();
        }
        if buffer.ends_with(b"\r") {
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
