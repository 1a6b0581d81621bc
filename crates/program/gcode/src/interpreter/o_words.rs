//! O-words: subroutines, conditions and loops.
//!
//! A program is read once, as a stream. Only lines that may be repeated are stored: those of a loop while it
//! is active, and the bodies of subroutines. Branches that are not taken are skipped without being stored.

use std::io::BufRead;
use std::sync::Arc as Shared;

use crate::diagnostics::diagnostic::{Fault, Span};
use crate::execution::saved_modes::SavedModes;
use crate::interpreter::Interpreter;
use crate::interpreter::tool_change::SplitLine;
use crate::parameters::names::NameId;
use crate::syntax::block::{Keyword, OWord};
use crate::syntax::expression::Evaluator;
use crate::syntax::lexer::Lexer;
use crate::syntax::lines::Lines;
use crate::syntax::parser::o_word;
use crate::{CallChain, Code};

/// An active program or subroutine. The program itself has no lines here: they come from the stream.
#[derive(Debug, Default)]
pub(crate) struct Frame {
    pub(crate) lines: Option<Shared<Lines>>,
    /// Index of the next line in `lines` or in the line buffer.
    pub(crate) next_index: usize,
    pub(crate) open_blocks: Vec<OpenBlock>,
    /// Number of open blocks from which on lines depend on an assumed contact; 0 for all lines.
    pub(crate) assumed_from: Option<usize>,
    /// Number of open blocks from which on lines follow an exit that was skipped because of an assumed
    /// contact.
    pub(crate) exit_from: Option<usize>,
    /// The subroutine, and its first line.
    pub(crate) name: NameId,
    pub(crate) first: usize,
    /// The calls that led to its lines.
    pub(crate) calls: CallChain,
    /// Number of further repetitions (M98 L).
    pub(crate) repeats_left: u32,
    /// Whether it has its own parameters.
    pub(crate) has_own_parameters: bool,
    /// The modes saved by M70 or M73, and whether they are restored automatically.
    pub(crate) saved: Option<(SavedModes, bool)>,
    /// The line with M6 for which it changes the tool.
    pub(crate) tool_change: Option<Box<SplitLine>>,
}

impl Frame {
    /// Whether the lines are a file without a subroutine of its own, which may end anywhere.
    pub(crate) fn is_plain_file(&self) -> bool {
        self.first == 0 && (!self.has_own_parameters || self.tool_change.is_some())
    }
}

/// An open condition or loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum OpenBlock {
    /// Whether one of its branches has been executed, its line, and whether a condition has read an assumed
    /// contact.
    If {
        name: NameId,
        taken: bool,
        line: u32,
        assumed: bool,
    },
    /// `start` is the index of the line with `while`.
    While { name: NameId, start: usize },
    /// `start` is the first line of the body.
    Do { name: NameId, start: usize },
    /// `start` is the first line of the body; `remaining` includes the present repetition.
    Repeat {
        name: NameId,
        start: usize,
        remaining: f64,
    },
}

impl OpenBlock {
    pub(crate) fn name(self) -> NameId {
        match self {
            Self::If { name, .. }
            | Self::While { name, .. }
            | Self::Do { name, .. }
            | Self::Repeat { name, .. } => name,
        }
    }

    pub(crate) fn is_loop(self) -> bool {
        !matches!(self, Self::If { .. })
    }

    /// Index of the line with which a loop starts, among the lines of its frame.
    pub(crate) fn loop_start(self) -> Option<usize> {
        match self {
            Self::If { .. } => None,
            Self::While { start, .. } => Some(start),
            Self::Do { start, .. } | Self::Repeat { start, .. } => start.checked_sub(1),
        }
    }
}

/// Lines are skipped until an O-word with this name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Skip {
    /// The next branch or the end of a condition.
    Branch(NameId),
    /// The end of a finished loop, and the line with which the loop starts.
    End(NameId, Keyword, u32),
    /// The end of a loop that continues: its `endwhile`, `endrepeat` or, for a `do`, `while`, which is
    /// executed.
    Next(NameId, Keyword),
}

/// A subroutine whose lines are being collected.
#[derive(Debug)]
pub(crate) struct Definition {
    pub(crate) name: NameId,
    /// The name as written, and the line with `sub`.
    pub(crate) text: String,
    pub(crate) line: u32,
    pub(crate) lines: Lines,
}

impl<R: BufRead> Interpreter<R> {
    /// Whether lines of the program must be stored.
    pub(crate) fn needs_buffering(&self) -> bool {
        self.flow
            .frames
            .first()
            .is_some_and(|main| main.open_blocks.iter().any(|open| open.is_loop()))
    }

    /// Processes the line if it is being skipped or collected, or is an O-word. False for an ordinary line.
    pub(crate) fn flow(&mut self) -> Result<bool, Fault> {
        if self.flow.definition.is_none() && self.flow.skip.is_none() {
            let found = o_word(&self.current.text, &self.scope())?;
            return match found {
                Some(word) => self.execute_o_word(&word).map(|()| true),
                None => Ok(false),
            };
        }
        // A name that cannot be evaluated does not match.
        let word = o_word(&self.current.text, &self.scope()).unwrap_or_default();
        if self.flow.definition.is_some() {
            self.define(word.as_ref())?;
        } else if let Some(skip) = self.flow.skip {
            if self.flow.skips_assumed {
                self.record_skipped_exit(word.as_ref());
            }
            if let Some(word) = word {
                self.skipped(skip, &word)?;
            }
        }
        Ok(true)
    }

    pub(crate) fn label(&mut self, word: &OWord) -> Result<NameId, Fault> {
        self.flow
            .labels
            .intern_label(&word.name)
            .ok_or_else(|| Fault::new(Code::BadName, word.span, "there are too many names of O-words"))
    }

    pub(crate) fn frame(&mut self) -> &mut Frame {
        // The frame of the program itself always exists.
        let last = self.flow.frames.len() - 1;
        &mut self.flow.frames[last]
    }

    /// Index of the present line among the lines of its frame. Lines of the program are stored from this one
    /// on.
    pub(crate) fn start_buffering(&mut self) -> usize {
        if self.flow.frames.len() == 1 && !self.flow.is_buffered {
            self.flow.line_buffer.clear();
            self.flow
                .line_buffer
                .push(self.current.number, &self.current.text);
            self.flow.is_buffered = true;
            self.frame().next_index = 1;
        }
        self.frame().next_index - 1
    }

    fn execute_o_word(&mut self, word: &OWord) -> Result<(), Fault> {
        let name = self.label(word)?;
        match word.keyword {
            Keyword::Sub if self.is_in_subroutine() => return Err(self.nested_sub(word, name)),
            Keyword::Sub => {
                self.expect_no_values(word)?;
                let file = self.frame().lines.as_ref().and_then(|lines| lines.file.clone());
                self.flow.definition = Some(Definition {
                    name,
                    text: word.name.as_str().to_owned(),
                    line: self.current.number,
                    lines: Lines::of_file(file),
                });
            }
            Keyword::EndSub => self.end_sub(word, name)?,
            Keyword::Return => {
                if self.flow.frames.len() == 1 {
                    return Err(order_fault(word, "is outside of any subroutine"));
                }
                let value = self.optional_value(word)?;
                self.return_from(value)?;
            }
            Keyword::Call => self.call(word, name)?,
            Keyword::If => self.begin_if(word, name)?,
            Keyword::ElseIf | Keyword::Else => {
                // Reached from above, so a branch has been executed.
                match self.frame().open_blocks.last().copied() {
                    Some(OpenBlock::If {
                        name: open, assumed, ..
                    }) if open == name => self.skip(Skip::Branch(name), assumed),
                    _ => return Err(order_fault(word, "has no if before it")),
                }
            }
            Keyword::EndIf => match self.frame().open_blocks.last() {
                Some(OpenBlock::If { name: open, .. }) if *open == name => {
                    self.expect_no_values(word)?;
                    self.frame().open_blocks.pop();
                }
                _ => return Err(self.unmatched_end(word)),
            },
            Keyword::While => self.begin_while(word, name)?,
            Keyword::EndWhile => match self.frame().open_blocks.last().copied() {
                Some(OpenBlock::While { name: open, start }) if open == name => {
                    self.expect_no_values(word)?;
                    self.frame().open_blocks.pop();
                    self.jump(start);
                }
                _ => return Err(self.unmatched_end(word)),
            },
            Keyword::Do => {
                self.expect_no_values(word)?;
                let start = self.start_buffering() + 1;
                self.frame().open_blocks.push(OpenBlock::Do { name, start });
            }
            Keyword::Repeat => self.begin_repeat(word, name)?,
            Keyword::EndRepeat => match self.frame().open_blocks.last().copied() {
                Some(OpenBlock::Repeat {
                    name: open,
                    start,
                    remaining,
                }) if open == name => {
                    self.expect_no_values(word)?;
                    self.next_repetition(name, start, remaining);
                }
                _ => return Err(self.unmatched_end(word)),
            },
            Keyword::Break | Keyword::Continue => self.leave_loop(word, name)?,
            // A program number has no effect.
            Keyword::Program => self.expect_no_values(word)?,
        }
        Ok(())
    }

    fn end_sub(&mut self, word: &OWord, name: NameId) -> Result<(), Fault> {
        let is_active = self.flow.frames.len() > 1 && self.frame().name == name;
        if !is_active && self.flow.rejected_subs.contains(&name) {
            // Its start was rejected, and that is the mistake.
            return Ok(());
        }
        if self.flow.frames.len() == 1 {
            return Err(order_fault(
                word,
                "ends a subroutine that has not started: there is no sub with this name before it",
            ));
        }
        if self.frame().name != name {
            return Err(self.mismatched_end_of_active(word));
        }
        let value = self.optional_value(word)?;
        self.warn_of_open_at_endsub();
        self.return_from(value)
    }

    fn begin_if(&mut self, word: &OWord, name: NameId) -> Result<(), Fault> {
        let condition = self.condition(word);
        let (line, assumed) = (self.current.number, self.reads_assumed());
        let open = |taken| OpenBlock::If {
            name,
            taken,
            line,
            assumed,
        };
        let taken = match condition {
            Ok(taken) => taken,
            Err(fault) => {
                // The end of the block must not be a second error.
                self.frame().open_blocks.push(open(true));
                self.skip(Skip::Branch(name), assumed);
                return Err(fault);
            }
        };
        self.frame().open_blocks.push(open(taken));
        self.record_condition();
        if !taken {
            self.skip(Skip::Branch(name), assumed);
        }
        Ok(())
    }

    fn begin_repeat(&mut self, word: &OWord, name: NameId) -> Result<(), Fault> {
        let times = match self.value(word) {
            // As in LinuxCNC.
            Ok(times) => times.round_ties_even(),
            Err(fault) => {
                self.skip_loop(name, Keyword::EndRepeat);
                return Err(fault);
            }
        };
        if times < 1.0 {
            self.skip_loop(name, Keyword::EndRepeat);
        } else {
            let start = self.start_buffering() + 1;
            let remaining = times;
            self.frame().open_blocks.push(OpenBlock::Repeat {
                name,
                start,
                remaining,
            });
            self.record_condition();
        }
        Ok(())
    }

    fn begin_while(&mut self, word: &OWord, name: NameId) -> Result<(), Fault> {
        let end_of_do = match self.frame().open_blocks.last() {
            Some(OpenBlock::Do { name: open, start }) if *open == name => Some(*start),
            _ => None,
        };
        if let Some(start) = end_of_do {
            let condition = self.condition(word);
            self.record_condition();
            if matches!(condition, Ok(true)) {
                self.jump(start);
            } else {
                self.frame().open_blocks.pop();
            }
            return condition.map(drop);
        }
        match self.condition(word) {
            Ok(true) => {
                let start = self.start_buffering();
                self.frame().open_blocks.push(OpenBlock::While { name, start });
                self.record_condition();
                Ok(())
            }
            other => {
                self.skip_loop(name, Keyword::EndWhile);
                other.map(drop)
            }
        }
    }

    /// Skips the following lines; `assumed` if this depends on an assumed contact.
    fn skip(&mut self, skip: Skip, assumed: bool) {
        (self.flow.skip, self.flow.skips_assumed) = (Some(skip), assumed);
    }

    /// Skips the body of the loop that starts on the present line.
    fn skip_loop(&mut self, name: NameId, end: Keyword) {
        let assumed = self.reads_assumed();
        self.skip(Skip::End(name, end, self.current.number), assumed);
    }

    /// Starts the next repetition of a repeat, or ends it; the present line is the end of its body.
    fn next_repetition(&mut self, name: NameId, start: usize, remaining: f64) {
        self.frame().open_blocks.pop();
        if remaining > 1.0 {
            let remaining = remaining - 1.0;
            self.frame().open_blocks.push(OpenBlock::Repeat {
                name,
                start,
                remaining,
            });
            self.jump(start);
        }
    }

    fn leave_loop(&mut self, word: &OWord, name: NameId) -> Result<(), Fault> {
        self.expect_no_values(word)?;
        let open = &self.frame().open_blocks;
        let Some(index) = open
            .iter()
            .rposition(|open| open.is_loop() && open.name() == name)
        else {
            return Err(order_fault(word, "is not inside a loop with this name"));
        };
        let found = open[index];
        let line = self.line_of(found);
        self.frame().open_blocks.truncate(index + 1);
        let end = match found {
            OpenBlock::While { .. } => Keyword::EndWhile,
            OpenBlock::Repeat { .. } => Keyword::EndRepeat,
            OpenBlock::Do { .. } | OpenBlock::If { .. } => Keyword::While,
        };
        let assumed = self.inherited_assumption().is_some();
        if word.keyword == Keyword::Break {
            self.frame().open_blocks.pop();
            self.skip(Skip::End(name, end, line), assumed);
        } else {
            self.skip(Skip::Next(name, end), assumed);
        }
        Ok(())
    }

    fn jump(&mut self, index: usize) {
        self.frame().next_index = index;
    }

    /// Processes an O-word among skipped lines.
    fn skipped(&mut self, skip: Skip, word: &OWord) -> Result<(), Fault> {
        let Ok(name) = self.label(word) else { return Ok(()) };
        match skip {
            Skip::Branch(awaited) if awaited == name => {
                let taken = matches!(
                    self.frame().open_blocks.last(),
                    Some(OpenBlock::If { taken: true, .. })
                );
                let is_entered = match word.keyword {
                    Keyword::EndIf => {
                        self.frame().open_blocks.pop();
                        self.flow.skip = None;
                        return self.expect_no_values(word);
                    }
                    Keyword::Else => !taken,
                    Keyword::ElseIf => {
                        let is_entered = !taken && self.condition(word)?;
                        self.record_condition();
                        self.flow.skips_assumed |= self.reads_assumed();
                        is_entered
                    }
                    _ => false,
                };
                if is_entered {
                    let is_assumed = self.flow.skips_assumed;
                    if let Some(OpenBlock::If { taken, assumed, .. }) = self.frame().open_blocks.last_mut() {
                        (*taken, *assumed) = (true, is_assumed);
                    }
                    self.flow.skip = None;
                }
            }
            Skip::End(awaited, end, _) if awaited == name && word.keyword == end => self.flow.skip = None,
            Skip::Next(awaited, end) if awaited == name && word.keyword == end => {
                self.flow.skip = None;
                return self.execute_o_word(word);
            }
            _ => {}
        }
        Ok(())
    }

    /// All values in brackets after the keyword.
    pub(crate) fn values(&mut self, word: &OWord) -> Result<(), Fault> {
        self.flow.arguments.clear();
        let text = std::mem::take(&mut self.current.text);
        let values = std::mem::take(&mut self.flow.arguments);
        let result = self.values_of(word, &text, values);
        self.current.text = text;
        match result {
            Ok(values) => {
                self.flow.arguments = values;
                Ok(())
            }
            Err(fault) => Err(fault),
        }
    }

    fn values_of(&self, word: &OWord, text: &[u8], mut values: Vec<f64>) -> Result<Vec<f64>, Fault> {
        let scope = self.scope();
        let mut lexer = Lexer::new(text);
        lexer.seek(word.rest);
        loop {
            match lexer.peek() {
                Some(b'[') => values.push(Evaluator::new(&mut lexer, &scope).bracket()?),
                Some(b'(') => {
                    lexer.comment()?;
                }
                None | Some(b';') => return Ok(values),
                Some(_) => {
                    let span = Span::at(lexer.position());
                    let message = format!(
                        "after {} only values in [ ] and comments follow",
                        word.keyword.name()
                    );
                    return Err(Fault::new(Code::OWord, span, message));
                }
            }
        }
    }

    fn value(&mut self, word: &OWord) -> Result<f64, Fault> {
        self.values(word)?;
        match self.flow.arguments[..] {
            [value] => Ok(value),
            _ => {
                let message = format!("{} needs one value in brackets", word.keyword.name());
                Err(Fault::new(Code::OWord, word.span, message).help("as in O1 while [#1 LT 10]"))
            }
        }
    }

    fn condition(&mut self, word: &OWord) -> Result<bool, Fault> {
        let value = self.value(word);
        if let Some(assumption) = &mut self.parameters.assumption {
            assumption.has_branched |= assumption.values_depend();
        }
        value.map(|value| value != 0.0)
    }

    fn optional_value(&mut self, word: &OWord) -> Result<Option<f64>, Fault> {
        self.values(word)?;
        match self.flow.arguments[..] {
            [] => Ok(None),
            [value] => Ok(Some(value)),
            _ => Err(order_fault(word, "returns at most one value")),
        }
    }

    fn expect_no_values(&mut self, word: &OWord) -> Result<(), Fault> {
        self.values(word)?;
        if self.flow.arguments.is_empty() {
            return Ok(());
        }
        Err(order_fault(word, "takes no value"))
    }
}

#[cold]
pub(crate) fn order_fault(word: &OWord, what: &str) -> Fault {
    let message = format!("O<{}> {} {what}", word.name.as_str(), word.keyword.name());
    Fault::new(Code::OWordOrder, word.span, message)
}
