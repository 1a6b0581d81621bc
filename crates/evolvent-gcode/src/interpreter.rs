//! The iterator that users see.

use std::collections::VecDeque;
use std::io::BufRead;

use evolvent_path::Axes;

use crate::block::Block;
use crate::comment;
use crate::diagnostic::Fault;
use crate::expression::Target;
use crate::names::Normal;
use crate::parameters::Parameters;
use crate::parser::{first_character, is_block_delete, is_percent, o_word, parse};
use crate::reader::LineReader;
use crate::scope::Scope;
use crate::state::State;
use crate::statement::Statement;
use crate::{Action, Code, Command, Diagnostic, Settings};

/// Interprets a program line by line, as commands are asked for. Memory is bounded by the longest line.
///
/// After an error the iterator goes on with the next line, with the modal state unchanged by the faulty one, so
/// that one pass finds many errors; whoever moves a machine stops at the first. It ends after
/// [`Action::ProgramEnd`], or after an error in reading.
///
/// ```
/// use evolvent_gcode::{Action, Interpreter, Settings};
///
/// let program = &b"G21 F600\nG1 X10\nM2\n"[..];
/// let commands: Result<Vec<_>, _> = Interpreter::new(program, Settings::default()).collect();
/// let commands = commands?;
/// assert!(matches!(commands[0].action, Action::Move(step) if step.feed == 10.0));
/// assert_eq!(commands[1].action, Action::ProgramEnd);
/// # Ok::<(), evolvent_gcode::Diagnostic>(())
/// ```
pub struct Interpreter<R> {
    reader: LineReader<R>,
    settings: Settings,
    state: State,
    block: Block,
    statement: Statement,
    parameters: Parameters,
    /// Commands of the last line that nobody has asked for yet.
    pending: VecDeque<Command>,
    /// Whether the program began with `%`; unknown before the first line that is not blank.
    percent: Option<bool>,
    finished: bool,
}

impl<R: BufRead> Interpreter<R> {
    /// Starts at the first line of `input`.
    pub fn new(input: R, settings: Settings) -> Self {
        let mut parameters = Parameters::new();
        for (index, value) in &settings.parameters {
            parameters.set_numbered(*index as usize, *value);
        }
        parameters.commit();
        Self {
            parameters,
            reader: LineReader::new(input, settings.max_line_bytes),
            state: State::new(&settings),
            settings,
            block: Block::default(),
            statement: Statement::new(),
            pending: VecDeque::new(),
            percent: None,
            finished: false,
        }
    }

    /// Where the machine will be after the lines read so far, in machine coordinates (mm, degrees).
    #[must_use]
    pub fn position(&self) -> Axes {
        self.state.position
    }

    /// Physical line read last, from 1; 0 before the first.
    #[must_use]
    pub fn line(&self) -> u32 {
        self.reader.line()
    }

    /// Reads and executes a line; its commands go to `pending`.
    fn advance(&mut self) -> Result<(), Diagnostic> {
        match self.reader.read() {
            Ok(true) => {}
            Ok(false) => {
                self.end();
                return Ok(());
            }
            Err(fault) => {
                self.finished = fault.code == Code::ReadFailed;
                return Err(fault.locate(self.reader.line(), self.reader.text()));
            }
        }
        self.interpret().map_err(|fault| {
            self.pending.clear();
            self.parameters.roll_back();
            fault.locate(self.reader.line(), self.reader.text())
        })
    }

    fn interpret(&mut self) -> Result<(), Fault> {
        let text = self.reader.text();
        if first_character(text).is_none() {
            return Ok(());
        }
        let opening = self.percent.is_none();
        if is_percent(text) && self.percent != Some(false) {
            self.percent = Some(true);
            if !opening {
                self.end();
            }
            return Ok(());
        }
        self.percent.get_or_insert(false);
        if self.settings.block_delete && is_block_delete(text) {
            return Ok(());
        }
        let line = self.reader.line();
        let scope = Scope {
            parameters: &self.parameters,
            state: &self.state,
            settings: &self.settings,
            line,
        };
        if let Some(word) = o_word(text, &scope)? {
            return Err(Fault::new(
                Code::OWord,
                word.span,
                "O: subroutines, loops and program numbers",
            )
            .help("O-words are not available yet"));
        }
        parse(text, &mut self.block, &scope)?;
        self.statement
            .fill(&self.block, self.state.motion, &self.settings.axes)?;

        for (target, value) in &self.block.assignments {
            match *target {
                Target::Numbered(index) => self.parameters.set_numbered(index, *value),
                Target::Named(inside) => {
                    let name = Normal::new(&text[inside.start as usize..inside.end as usize]);
                    if !name.is_some_and(|name| self.parameters.set_named(&name, *value)) {
                        let message = "there are too many names of parameters";
                        return Err(Fault::new(Code::BadName, inside, message));
                    }
                }
            }
        }
        let pending = &mut self.pending;
        let mut out = |action| pending.push_back(Command { line, action });
        for inside in &self.block.comments {
            if let Some(message) = comment::message(text, *inside)? {
                out(Action::Message(message));
            }
        }
        let mut state = self.state;
        state.execute(&self.statement, &self.settings, &mut out)?;
        self.state = state;
        self.parameters.commit();
        self.finished = state.ended;
        Ok(())
    }

    /// The end without M2.
    fn end(&mut self) {
        let line = self.reader.line();
        let pending = &mut self.pending;
        self.state
            .end(&mut |action| pending.push_back(Command { line, action }));
        self.finished = true;
    }
}

impl<R: BufRead> Iterator for Interpreter<R> {
    type Item = Result<Command, Diagnostic>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if let Some(command) = self.pending.pop_front() {
                return Some(Ok(command));
            }
            if self.finished {
                return None;
            }
            if let Err(diagnostic) = self.advance() {
                return Some(Err(diagnostic));
            }
        }
    }
}

impl<R: BufRead> std::iter::FusedIterator for Interpreter<R> {}

impl<R> std::fmt::Debug for Interpreter<R> {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter
            .debug_struct("Interpreter")
            .field("state", &self.state)
            .finish_non_exhaustive()
    }
}
