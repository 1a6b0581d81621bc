//! Reads the next line from the stream, from stored lines of loops, or from a subroutine, and processes the
//! end of each.

use std::io::BufRead;

use crate::Diagnostic;
use crate::diagnostics::diagnostic::Fault;
use crate::interpreter::Interpreter;
use crate::interpreter::o_words::Frame;
use crate::syntax::parser::is_percent;

impl<R: BufRead> Interpreter<R> {
    /// Number of the next line of the program.
    pub(crate) fn next_program_line(&self) -> u32 {
        match self.flow.line_buffer.get(self.flow.frames[0].next_index) {
            Some((_, line)) => line,
            None => self.reader.line() + 1,
        }
    }

    /// Reads the next line; false at the end of this frame.
    pub(super) fn next_line(&mut self) -> Result<bool, Fault> {
        let last = self.flow.frames.len() - 1;
        let frame = &mut self.flow.frames[last];
        if let Some(lines) = &frame.lines {
            let Some((text, line)) = lines.get(frame.next_index) else {
                return Ok(false);
            };
            self.current.text.clear();
            self.current.text.extend_from_slice(text);
            self.current.number = line;
            frame.next_index += 1;
            return Ok(true);
        }
        if let Some((text, line)) = self.flow.line_buffer.get(frame.next_index) {
            self.current.text.clear();
            self.current.text.extend_from_slice(text);
            self.current.number = line;
            frame.next_index += 1;
            self.flow.is_buffered = true;
            return Ok(true);
        }
        let needs_buffering = self.needs_buffering();
        if !needs_buffering && self.flow.line_buffer.len() > 0 {
            self.flow.line_buffer.clear();
            self.flow.frames[0].next_index = 0;
        }
        self.flow.is_buffered = false;
        let line_before = self.current.number;
        let read = self.reader.read_into(&mut self.current.text)?;
        self.current.number = self.reader.line();
        if !read && line_before != self.current.number {
            // The line of a subroutine, which has ended.
            self.current.text.clear();
        }
        if read && needs_buffering {
            self.flow
                .line_buffer
                .push(self.current.number, &self.current.text);
            self.flow.frames[0].next_index = self.flow.line_buffer.len();
            self.flow.is_buffered = true;
            if self.flow.line_buffer.size() > self.settings.limits.max_body_bytes {
                self.finished = true;
                return Err(self.body_too_long());
            }
        }
        Ok(read)
    }

    /// Processes the end of the lines of a frame.
    pub(super) fn end_of_lines(&mut self) -> Result<(), Box<Diagnostic>> {
        let fault_of_open_block = self.unclosed_block_error();
        if self.flow.frames.len() > 1 {
            let may_end_anywhere = self.flow.frames.last().is_some_and(Frame::is_plain_file);
            // A tool change that ends inside a condition is incomplete.
            let is_incomplete = self.flow.skip.is_some()
                || self.flow.definition.is_some()
                || !self.frame().open_blocks.is_empty();
            let is_tool_change = self.frame().tool_change.is_some();
            let fault = fault_of_open_block
                .filter(|_| !may_end_anywhere || is_incomplete && is_tool_change)
                .map(|fault| self.locate(fault));
            self.flow.skip = None;
            self.flow.definition = None;
            let returned = self.return_from(None).map_err(|fault| self.locate(fault));
            return fault.map_or(returned, Err);
        }
        let fault = fault_of_open_block.map(|fault| self.locate(fault));
        self.flow.skip = None;
        self.flow.definition = None;
        self.flow.frames[0].open_blocks.clear();
        self.end();
        fault.map_or(Ok(()), Err)
    }

    /// Whether the line read is the `%` at the end of a program that started with one: the program ends as at
    /// the end of its file.
    pub(super) fn ends_by_percent(&self) -> bool {
        self.percent == Some(true) && self.flow.frames.len() == 1 && is_percent(&self.current.text)
    }
}
