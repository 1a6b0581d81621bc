//! Matching of O-words, such as sub and endsub: one error for each mistake.
//!
//! An end with the wrong name is either the intended end, or an extra line. The lines after it decide: they
//! are read ahead, which costs memory only if there is such an error.

use std::io::BufRead;

use crate::diagnostics::diagnostic::{Fault, Span};
use crate::interpreter::Interpreter;
use crate::interpreter::o_words::{Definition, OpenBlock, Skip, order_fault};
use crate::parameters::names::NameId;
use crate::syntax::block::{Keyword, OWord};
use crate::syntax::lines::Lines;
use crate::syntax::parser::{is_percent, o_word};
use crate::{Action, Code};

/// An open block: its first keyword, its line, and the keyword that ends it.
struct UnclosedBlock {
    name: NameId,
    begin: Keyword,
    line: u32,
    end: Keyword,
}

impl OpenBlock {
    fn begin(self) -> Keyword {
        match self {
            Self::If { .. } => Keyword::If,
            Self::While { .. } => Keyword::While,
            Self::Do { .. } => Keyword::Do,
            Self::Repeat { .. } => Keyword::Repeat,
        }
    }

    fn end(self) -> Keyword {
        end_of(self.begin())
    }
}

/// The keyword that ends a block.
fn end_of(begin: Keyword) -> Keyword {
    match begin {
        Keyword::If => Keyword::EndIf,
        Keyword::While => Keyword::EndWhile,
        Keyword::Do => Keyword::While,
        Keyword::Repeat => Keyword::EndRepeat,
        _ => Keyword::EndSub,
    }
}

impl<R: BufRead> Interpreter<R> {
    fn name_of(&self, name: NameId) -> String {
        self.flow.labels.name(name).unwrap_or_default().to_owned()
    }

    /// The line with which a condition or loop of the present frame starts.
    pub(crate) fn line_of(&self, open: OpenBlock) -> u32 {
        self.line_in_frame(self.flow.frames.len() - 1, open)
    }

    fn line_in_frame(&self, frame: usize, open: OpenBlock) -> u32 {
        if let OpenBlock::If { line, .. } = open {
            return line;
        }
        let lines = self
            .flow
            .frames
            .get(frame)
            .and_then(|frame| frame.lines.as_deref());
        let lines = lines.unwrap_or(&self.flow.line_buffer);
        let start_line = open.loop_start().and_then(|start| lines.get(start));
        start_line.map_or(self.current.number, |(_, line)| line)
    }

    /// The line with the sub of the active subroutine.
    fn line_of_sub(&self) -> Option<u32> {
        let frame = self.flow.frames.last()?;
        let lines = frame.lines.as_deref()?;
        match frame.first.checked_sub(1) {
            Some(index) => lines.get(index).map(|(_, line)| line),
            // The lines of a program are stored without it.
            None => lines.get(0).map(|(_, line)| line.saturating_sub(1)),
        }
    }

    /// Whether the present line is in a subroutine, not in a called file or program as a whole.
    pub(crate) fn is_in_subroutine(&self) -> bool {
        self.flow.frames.len() > 1
            && self.flow.frames.last().is_some_and(|frame| {
                let is_of_file = frame.lines.as_ref().is_some_and(|lines| lines.file.is_some());
                frame.has_own_parameters && !(is_of_file && frame.first == 0)
            })
    }

    /// The later line that ends the block with this name, before another such block starts.
    fn line_of_end(&mut self, name: NameId, begin: Keyword, end: Keyword) -> Option<u32> {
        self.line_of_end_in_frame(self.flow.frames.len() - 1, name, begin, end)
    }

    fn line_of_end_in_frame(
        &mut self,
        frame: usize,
        name: NameId,
        begin: Keyword,
        end: Keyword,
    ) -> Option<u32> {
        if self.flow.frames.len() == 1 && !self.flow.is_buffered {
            self.start_buffering();
        }
        let (index, mut line_index) = (frame, self.flow.frames.get(frame)?.next_index);
        let mut text = Vec::new();
        loop {
            let frame = self.flow.frames.get(index)?;
            let stored = match &frame.lines {
                Some(lines) => Some(lines.get(line_index)?),
                None => self.flow.line_buffer.get(line_index),
            };
            let line = if let Some((stored, line)) = stored {
                text.clear();
                text.extend_from_slice(stored);
                line
            } else {
                let is_full = self.flow.line_buffer.size() > self.settings.limits.max_body_bytes;
                if is_full || !matches!(self.reader.read_into(&mut text), Ok(true)) {
                    return None;
                }
                self.flow.line_buffer.push(self.reader.line(), &text);
                self.reader.line()
            };
            line_index += 1;
            if index == 0 && self.percent == Some(true) && is_percent(&text) {
                return None;
            }
            let Ok(Some(word)) = o_word(&text, &self.scope()) else {
                continue;
            };
            if ![begin, end].contains(&word.keyword) || self.label(&word).ok() != Some(name) {
                continue;
            }
            return (word.keyword == end).then_some(line);
        }
    }

    /// Handles an endsub whose name differs from that of the subroutine that is being collected.
    pub(crate) fn mismatched_end_of_definition(&mut self, word: &OWord) -> Result<(), Fault> {
        let Some(Definition { name, text, line, .. }) = &self.flow.definition else {
            return Ok(());
        };
        let (name, text, line) = (*name, text.clone(), *line);
        if self.is_rejected_sub(word) {
            return Ok(());
        }
        let fault = self.mismatched_end(word, name, &text, Some(line));
        match fault {
            (fault, true) => {
                self.end_definition();
                Err(fault)
            }
            (fault, false) => Err(fault),
        }
    }

    /// Handles an endsub whose name differs from that of the active subroutine.
    pub(crate) fn mismatched_end_of_active(&mut self, word: &OWord) -> Fault {
        let name = self.frame().name;
        let (text, line) = (self.name_of(name), self.line_of_sub());
        let (fault, ends_here) = self.mismatched_end(word, name, &text, line);
        if ends_here && let Err(unrestored) = self.return_from(None) {
            return unrestored;
        }
        fault
    }

    /// The error of an endsub with the wrong name, and whether it is the intended end.
    fn mismatched_end(
        &mut self,
        word: &OWord,
        name: NameId,
        text: &str,
        start_line: Option<u32>,
    ) -> (Fault, bool) {
        let other = word.name.as_str();
        let of_line = start_line.map_or_else(String::new, |line| format!(" of line {line}"));
        let end = self.line_of_end(name, Keyword::Sub, Keyword::EndSub);
        let (message, help) = match end {
            None => (
                format!("O<{other}> endsub, but O<{text}> sub{of_line} has to end here"),
                format!("write the same name twice: O<{text}> sub ... O<{text}> endsub"),
            ),
            Some(end) => (
                format!(
                    "O<{other}> endsub without O<{other}> sub, inside O<{text}> sub{of_line}, which ends in \
                     line {end}"
                ),
                format!("remove this line, or write O<{other}> sub where that subroutine starts"),
            ),
        };
        let fault = Fault::new(Code::OWordOrder, word.span, message).help(help);
        (fault, end.is_none())
    }

    fn is_rejected_sub(&mut self, word: &OWord) -> bool {
        let name = self.label(word).ok();
        name.is_some_and(|name| self.flow.rejected_subs.contains(&name))
    }

    /// Handles a sub among the lines of a subroutine that is being collected.
    pub(crate) fn sub_in_definition(&mut self, word: &OWord) -> Result<(), Fault> {
        let Some(Definition { name, text, line, .. }) = &self.flow.definition else {
            return Ok(());
        };
        let (outer, text, line) = (*name, text.clone(), *line);
        let name = self.label(word)?;
        if self.line_of_end(outer, Keyword::Sub, Keyword::EndSub).is_some() {
            self.reject_sub(name);
            if let Some(definition) = &mut self.flow.definition {
                definition.lines.push(self.current.number, &self.current.text);
            }
            return Err(nested(word, &text, Some(line)));
        }
        // The end of the outer subroutine was forgotten; this one is correct.
        let file = (self.flow.definition.as_ref()).and_then(|outer| outer.lines.file.clone());
        self.end_definition();
        self.reject_sub(outer);
        self.flow.definition = Some(Definition {
            name,
            text: word.name.as_str().to_owned(),
            line: self.current.number,
            lines: Lines::of_file(file),
        });
        Err(missing_endsub(word, &text, Some(line)))
    }

    /// Handles a sub among the lines of the active subroutine.
    pub(crate) fn nested_sub(&mut self, word: &OWord, name: NameId) -> Fault {
        let outer = self.frame().name;
        let (text, line) = (self.name_of(outer), self.line_of_sub());
        if self.line_of_end(outer, Keyword::Sub, Keyword::EndSub).is_some() {
            self.reject_sub(name);
            return nested(word, &text, line);
        }
        self.reject_sub(outer);
        match self.return_from(None) {
            Ok(()) => missing_endsub(word, &text, line),
            Err(unrestored) => unrestored,
        }
    }

    fn reject_sub(&mut self, name: NameId) {
        if !self.flow.rejected_subs.contains(&name) {
            self.flow.rejected_subs.push(name);
        }
    }

    /// The error of an O-word that ends a condition or loop other than the innermost open one.
    pub(crate) fn unmatched_end(&mut self, word: &OWord) -> Fault {
        let begin = match word.keyword {
            Keyword::EndIf => Keyword::If,
            Keyword::EndRepeat => Keyword::Repeat,
            _ => Keyword::While,
        };
        let fault = order_fault(word, &format!("has no {} before it", begin.name()));
        let Some(open) = self.frame().open_blocks.last().copied() else {
            return fault;
        };
        if open.end() != word.keyword || self.line_of_end(open.name(), open.begin(), open.end()).is_some() {
            return fault;
        }
        let message = format!(
            "O<{}> {}, but O<{}> {} of line {} has to end here",
            word.name.as_str(),
            word.keyword.name(),
            self.name_of(open.name()),
            begin.name(),
            self.line_of(open)
        );
        // It ends here, so that the end of the text is not a second error.
        self.frame().open_blocks.pop();
        Fault::new(Code::OWordOrder, word.span, message).help("write the same name or number at both")
    }

    /// Warns of a condition or loop around the end of a program (M2) that no later line ends. It is valid,
    /// but its end was probably forgotten before M2: the lines of a loop are then executed once.
    pub(crate) fn warn_of_open_at_end(&mut self) {
        let frames = &self.flow.frames;
        if self.settings.is_mdi || frames.iter().all(|frame| frame.open_blocks.is_empty()) {
            return;
        }
        for frame in (0..self.flow.frames.len()).rev() {
            for open in self.flow.frames[frame].open_blocks.clone().into_iter().rev() {
                let (name, begin, end) = (open.name(), open.begin(), open.end());
                let is_ended = self.line_of_end_in_frame(frame, name, begin, end).is_some();
                if is_ended || self.flow.line_buffer.size() > self.settings.limits.max_body_bytes {
                    continue;
                }
                let text = self.unclosed_block_warning("the program ends", frame, open);
                self.warn_before_end(text);
                return;
            }
        }
    }

    /// Warns of a condition or loop around the end of a subroutine. It is valid too, but no line can end it
    /// any more.
    pub(crate) fn warn_of_open_at_endsub(&mut self) {
        if let Some(open) = self.frame().open_blocks.last().copied() {
            let text = self.unclosed_block_warning("the subroutine ends", self.flow.frames.len() - 1, open);
            self.warn(text);
        }
    }

    /// The warning for a condition or loop without an end.
    fn unclosed_block_warning(&self, ending: &str, frame: usize, open: OpenBlock) -> String {
        let (name, begin, end) = (self.name_of(open.name()), open.begin().name(), open.end().name());
        let lines = self.flow.frames.get(frame).and_then(|frame| frame.lines.as_ref());
        let file = lines.and_then(|lines| lines.file.as_deref());
        let of_file = file.map_or_else(String::new, |file| format!(" of {file}"));
        let note = if open.is_loop() {
            ", and its lines are not repeated"
        } else {
            ""
        };
        format!(
            "{ending} inside O<{name}> {begin} of line {}{of_file}, because O<{name}> {end} is \
             missing{note}: write O<{name}> {end} after the last line that belongs to it",
            self.line_in_frame(frame, open)
        )
    }

    /// Outputs a warning before the end of the program, because nothing may follow that.
    fn warn_before_end(&mut self, text: String) {
        self.warn(text);
        let pending = &mut self.output.pending;
        if let Some(end) = pending
            .iter()
            .rposition(|command| command.action == Action::ProgramEnd)
            && let Some(warning) = pending.pop_back()
        {
            pending.insert(end, warning);
        }
    }

    /// The innermost open block at the end of a frame.
    fn unclosed_block(&mut self) -> Option<UnclosedBlock> {
        if let Some(Skip::End(name, end, line)) = self.flow.skip {
            let begin = match end {
                Keyword::EndRepeat => Keyword::Repeat,
                Keyword::EndWhile => Keyword::While,
                _ => Keyword::Do,
            };
            return Some(UnclosedBlock {
                name,
                begin,
                line,
                end,
            });
        }
        if let Some(open) = self.frame().open_blocks.last().copied() {
            return Some(UnclosedBlock {
                name: open.name(),
                begin: open.begin(),
                line: self.line_of(open),
                end: open.end(),
            });
        }
        let frame = self.flow.frames.last()?;
        if self.flow.frames.len() == 1 || self.flow.rejected_subs.contains(&frame.name) {
            return None;
        }
        Some(UnclosedBlock {
            name: frame.name,
            begin: Keyword::Sub,
            line: self.line_of_sub().unwrap_or(self.current.number),
            end: Keyword::EndSub,
        })
    }

    /// The error of a subroutine file that does not define its subroutine; its lines were executed from the
    /// first one.
    fn file_without_subroutine(&mut self) -> Option<Fault> {
        let frame = self.flow.frames.last()?;
        let lines = frame
            .lines
            .as_ref()
            .filter(|_| frame.first == 0 && frame.open_blocks.is_empty())?;
        let file = lines.file.as_deref()?;
        let name = self.flow.labels.name(frame.name)?;
        let inside = (0..lines.len()).find_map(|index| {
            let (text, line) = lines.get(index)?;
            let word = o_word(text, &self.scope()).ok()??;
            (word.keyword == Keyword::Sub).then_some((word.name, line))
        });
        let message = format!("O<{name}> sub is missing in {file}");
        let help = match inside {
            Some((other, line)) => format!(
                "line {line} has O<{}> sub: write the name of the file there and at its endsub, or call the \
                 other name",
                other.as_str()
            ),
            None => format!("write O<{name}> sub before its first line, and O<{name}> endsub after the last"),
        };
        Some(self.error_at_end(message, help))
    }

    /// The error of blocks that are still open at the end of a frame.
    pub(crate) fn unclosed_block_error(&mut self) -> Option<Fault> {
        if let Some(Definition { text, line, .. }) = &self.flow.definition {
            let start = self.block_start_description(*line);
            let message =
                format!("the text ends, but O<{text}> endsub is missing: O<{text}> sub starts in {start}");
            let help = format!("write O<{text}> endsub after the last line of the subroutine");
            return Some(self.error_at_end(message, help));
        }
        if let Some(fault) = self.file_without_subroutine() {
            return Some(fault);
        }
        let block = self.unclosed_block()?;
        let (name, begin, end) = (self.name_of(block.name), block.begin.name(), block.end.name());
        let message = format!(
            "the text ends, but O<{name}> {end} is missing: O<{name}> {begin} starts in {}",
            self.block_start_description(block.line)
        );
        let help = format!("write O<{name}> {end} after the last line that belongs to it");
        Some(self.error_at_end(message, help))
    }

    /// Description of a block's start. An MDI block starts with lines that the user has not written.
    fn block_start_description(&self, line: u32) -> String {
        if self.settings.is_mdi && self.flow.frames.len() == 1 {
            "this block, and MDI executes one line".to_owned()
        } else {
            format!("line {line}")
        }
    }

    /// An error of the end of a frame, with its last line.
    fn error_at_end(&mut self, message: String, help: String) -> Fault {
        let frame = self.flow.frames.last().and_then(|frame| frame.lines.as_deref());
        let collected = self.flow.definition.as_ref().map(|definition| &definition.lines);
        // If no line is stored, the line read last is still available.
        let lines = frame.or(collected).unwrap_or(&self.flow.line_buffer);
        let last = (0..lines.len()).rev().filter_map(|index| lines.get(index));
        if let Some((text, line)) = last.into_iter().find(|(text, _)| !text.is_empty()) {
            self.current.text.clear();
            self.current.text.extend_from_slice(text);
            self.current.number = line;
        }
        Fault::new(Code::OWordOpen, Span::new(0, self.current.text.len()), message).help(help)
    }
}

fn missing_endsub(word: &OWord, outer: &str, start_line: Option<u32>) -> Fault {
    let of_line = start_line.map_or_else(String::new, |line| {
        format!(": O<{outer}> sub starts in line {line}")
    });
    let message = format!("O<{outer}> endsub is missing before this line{of_line}");
    let help = format!("write O<{outer}> endsub after the last line of the subroutine");
    Fault::new(Code::OWordOpen, word.span, message).help(help)
}

fn nested(word: &OWord, outer: &str, start_line: Option<u32>) -> Fault {
    let of_line = start_line.map_or_else(String::new, |line| format!(" of line {line}"));
    order_fault(
        word,
        &format!("starts inside another subroutine, O<{outer}> sub{of_line}"),
    )
    .help(format!("write O<{outer}> endsub before it"))
}
