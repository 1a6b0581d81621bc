//! Calls: subroutines are collected as the program is read, found in files or later in the program, entered
//! and left.

use std::io::BufRead;
use std::sync::Arc as Shared;

use crate::Code;
use crate::diagnostics::diagnostic::{Fault, Span};
use crate::interpreter::Interpreter;
use crate::interpreter::o_words::{Definition, Frame};
use crate::interpreter::tool_change::LineContinuation;
use crate::parameters::names::{NameId, NormalizedName};
use crate::syntax::block::{Keyword, OWord};
use crate::syntax::lines::{FileFault, Lines, Subroutine, find_file};
use crate::syntax::parser::o_word;

/// Maximum number of arguments of a call.
const MAX_ARGUMENTS: usize = 30;

impl<R: BufRead> Interpreter<R> {
    /// Processes a line of a subroutine that is being collected.
    pub(crate) fn define(&mut self, word: Option<&OWord>) -> Result<(), Fault> {
        let label = match word {
            Some(word) => self.label(word).ok(),
            None => None,
        };
        let remaining = self
            .settings
            .limits
            .max_body_bytes
            .saturating_sub(self.flow.library.size);
        let Some(definition) = &mut self.flow.definition else {
            return Ok(());
        };
        if let Some(word) = word.filter(|word| word.keyword == Keyword::Sub) {
            return self.sub_in_definition(word);
        }
        definition.lines.push(self.current.number, &self.current.text);
        if definition.lines.size() > remaining {
            self.flow.definition = None;
            return Err(self.body_too_long());
        }
        match word {
            Some(word) if word.keyword == Keyword::EndSub && label == Some(definition.name) => {
                self.end_definition();
                Ok(())
            }
            Some(word) if word.keyword == Keyword::EndSub => self.mismatched_end_of_definition(word),
            _ => Ok(()),
        }
    }

    /// Completes the collected subroutine.
    pub(crate) fn end_definition(&mut self) {
        if let Some(Definition { name, lines, .. }) = self.flow.definition.take() {
            let lines = Shared::new(lines);
            self.flow.library.insert(name, Subroutine { lines, first: 0 });
        }
    }

    pub(crate) fn body_too_long(&self) -> Fault {
        let message = format!(
            "the bodies of loops and subroutines take more than {} bytes",
            self.settings.limits.max_body_bytes
        );
        Fault::new(Code::BodyTooLong, Span::new(0, self.current.text.len()), message)
            .help("lines inside a loop are stored to be repeated; make its body a subroutine or shorter")
    }

    pub(crate) fn call(&mut self, word: &OWord, name: NameId) -> Result<(), Fault> {
        self.values(word)?;
        if self.flow.arguments.len() > MAX_ARGUMENTS {
            let message = format!(
                "a call with {} values; {MAX_ARGUMENTS} are possible",
                self.flow.arguments.len()
            );
            return Err(Fault::new(Code::OWord, word.span, message));
        }
        self.enter(&word.name, name, word.span, true, 1)
    }

    /// M98: calls the subroutine with this number, `times` times.
    pub(crate) fn call_number(&mut self, number: u32, times: u32, span: Span) -> Result<(), Fault> {
        if times == 0 {
            return Ok(());
        }
        let text = NormalizedName::of_number(number);
        let Some(label) = self.flow.labels.intern_label(&text) else {
            return Err(Fault::new(
                Code::BadName,
                span,
                "there are too many names of O-words",
            ));
        };
        self.flow.arguments.clear();
        self.enter(&text, label, span, false, times)
    }

    /// M99: returns to the caller. False in the program itself.
    pub(crate) fn return_number(&mut self) -> Result<bool, Fault> {
        if self.flow.frames.len() == 1 {
            return Ok(false);
        }
        self.return_from(None)?;
        Ok(true)
    }

    pub(crate) fn enter(
        &mut self,
        text: &NormalizedName,
        name: NameId,
        span: Span,
        has_own_parameters: bool,
        times: u32,
    ) -> Result<(), Fault> {
        if self.flow.frames.len() > self.settings.limits.max_call_depth {
            let message = format!(
                "subroutines are nested deeper than {}",
                self.settings.limits.max_call_depth
            );
            return Err(Fault::new(Code::NestingTooDeep, span, message)
                .help("check for a subroutine that calls itself without end"));
        }
        let found = match self.flow.library.get(name) {
            Some(found) => Some(found.clone()),
            // The mistake is at the start of the subroutine.
            None if self.flow.rejected_subs.contains(&name) => return Ok(()),
            None => self.load(text, name, span)?,
        };
        let Some(found) = found else {
            let message = format!("there is no subroutine O<{}>", text.as_str());
            return Err(Fault::new(Code::SubroutineMissing, span, message).help(
                "define it by O<name> sub ... O<name> endsub in the program, or in a file name.ngc of a \
                 subroutine folder",
            ));
        };
        if has_own_parameters {
            self.parameters.enter(&self.flow.arguments);
            self.parameters.returned = None;
        }
        let calls = self
            .current
            .location
            .calls
            .called_from(self.current.location.file.clone(), self.current.number);
        self.flow.location_changed = true;
        let assumed_from = self.inherited_assumption();
        self.flow.frames.push(Frame {
            assumed_from,
            lines: Some(found.lines),
            next_index: found.first,
            name,
            first: found.first,
            calls,
            repeats_left: times - 1,
            has_own_parameters,
            ..Frame::default()
        });
        Ok(())
    }

    /// Leaves a subroutine, or starts its next repetition. It is left even if its modes cannot be restored.
    pub(crate) fn return_from(&mut self, value: Option<f64>) -> Result<(), Fault> {
        if self.frame().repeats_left > 0 {
            let frame = self.frame();
            frame.repeats_left -= 1;
            frame.next_index = frame.first;
            frame.open_blocks.clear();
            frame.exit_from = None;
            return match frame.saved.take() {
                Some((saved, true)) => self.restore_saved(saved),
                _ => Ok(()),
            };
        }
        let Some(frame) = self.flow.frames.pop() else {
            return Ok(());
        };
        self.flow.location_changed = true;
        if frame.has_own_parameters {
            self.parameters.leave();
            self.parameters.returned = value;
        }
        let restored = match frame.saved {
            Some((saved, true)) => self.restore_saved(saved),
            _ => Ok(()),
        };
        if let Some(change) = frame.tool_change {
            self.continuation = Some(LineContinuation::ToolChanged(change));
        }
        restored
    }

    /// Searches a subroutine in files, then further on in the program.
    fn load(&mut self, text: &NormalizedName, name: NameId, span: Span) -> Result<Option<Subroutine>, Fault> {
        let max_bytes = self
            .settings
            .limits
            .max_body_bytes
            .saturating_sub(self.flow.library.size);
        match find_file(text.as_str(), &self.settings.subroutine_folders, max_bytes) {
            Ok(Some(lines)) => {
                let lines = Shared::new(lines);
                self.flow.library.record_file(text.as_str(), &lines);
                self.index(&lines);
                if self.flow.library.get(name).is_none() {
                    // A file with a main program: all of it, for M98.
                    let subroutine = Subroutine { lines, first: 0 };
                    self.flow.library.insert(name, subroutine);
                }
                return Ok(self.flow.library.get(name).cloned());
            }
            Ok(None) => {}
            Err(FileFault::Io(path, error)) => {
                let message = format!("{} cannot be read: {error}", path.display());
                return Err(Fault::new(Code::SubroutineFile, span, message));
            }
            Err(FileFault::TooLong(path)) => {
                let message = format!("{} is longer than {max_bytes} bytes", path.display());
                return Err(Fault::new(Code::SubroutineFile, span, message));
            }
        }
        self.look_ahead(name)
    }

    /// Registers the subroutines of a file.
    fn index(&mut self, lines: &Shared<Lines>) {
        for index in 0..lines.len() {
            let Some((text, _)) = lines.get(index) else {
                continue;
            };
            let Ok(Some(word)) = o_word(text, &self.scope()) else {
                continue;
            };
            if matches!(word.keyword, Keyword::Sub | Keyword::Program)
                && let Ok(name) = self.label(&word)
            {
                let subroutine = Subroutine {
                    lines: Shared::clone(lines),
                    first: index + 1,
                };
                self.flow.library.insert(name, subroutine);
            }
        }
    }

    /// Reads ahead in the program, storing the lines, until the subroutine has been found.
    fn look_ahead(&mut self, name: NameId) -> Result<Option<Subroutine>, Fault> {
        if self.flow.frames.len() == 1 && !self.flow.is_buffered {
            self.start_buffering();
        }
        let mut found: Option<(Keyword, Lines)> = None;
        // Stored lines that are not executed yet may contain it too.
        let mut index = self.flow.frames[0].next_index.min(self.flow.line_buffer.len());
        let mut text = Vec::new();
        loop {
            let line = if let Some((stored, line)) = self.flow.line_buffer.get(index) {
                text.clear();
                text.extend_from_slice(stored);
                line
            } else {
                if !matches!(self.reader.read_into(&mut text), Ok(true)) {
                    // An unreadable line ahead is reported when it is reached; here the call has no target.
                    break;
                }
                let line = self.reader.line();
                self.flow.line_buffer.push(line, &text);
                if self.flow.line_buffer.size() > self.settings.limits.max_body_bytes {
                    return Err(self.body_too_long());
                }
                line
            };
            index += 1;
            let word = o_word(&text, &self.scope()).unwrap_or_default();
            let label = match &word {
                Some(word) => self.label(word).ok(),
                None => None,
            };
            let keyword = word.map(|word| word.keyword);
            match &mut found {
                None => {
                    if let Some(keyword @ (Keyword::Sub | Keyword::Program)) = keyword
                        && label == Some(name)
                    {
                        found = Some((keyword, Lines::default()));
                    }
                }
                Some((Keyword::Sub, lines)) => {
                    lines.push(line, &text);
                    if keyword == Some(Keyword::EndSub) && label == Some(name) {
                        break;
                    }
                }
                Some((_, lines)) => {
                    if keyword == Some(Keyword::Program) || crate::syntax::parser::is_percent(&text) {
                        break;
                    }
                    lines.push(line, &text);
                }
            }
        }
        if let Some((_, lines)) = found {
            let lines = Shared::new(lines);
            self.flow.library.insert(name, Subroutine { lines, first: 0 });
        }
        Ok(self.flow.library.get(name).cloned())
    }
}
