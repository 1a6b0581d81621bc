//! The selection of the next line.

use std::io::BufRead;

use crate::Interpreter;
use crate::interpreter::o_words::{Definition, Frame, Skip};
use crate::parameters::names::{NameId, Names};
use crate::syntax::lines::{Library, Lines};

/// The start of a loop.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LoopStart {
    /// The subroutine file; `None` for the program itself.
    pub file: Option<String>,
    /// Its line there, from 1.
    pub line: u32,
}

/// The state that selects the next line: subroutines, loops and branches.
pub(crate) struct ControlFlow {
    /// Whether a subroutine has started or ended since [`CurrentLine::location`] was recorded.
    pub(crate) location_changed: bool,
    /// Lines of the program that may be repeated, and whether the present line is among them.
    pub(crate) line_buffer: Lines,
    pub(crate) is_buffered: bool,
    /// The program, and on top of it the active subroutines.
    pub(crate) frames: Vec<Frame>,
    pub(crate) skip: Option<Skip>,
    /// Whether lines are skipped only because of an assumed contact.
    pub(crate) skips_assumed: bool,
    pub(crate) definition: Option<Definition>,
    /// Subroutines whose start was rejected: errors that follow from that are not reported.
    pub(crate) rejected_subs: Vec<NameId>,
    pub(crate) library: Library,
    pub(crate) labels: Names,
    /// Values after an O-word.
    pub(crate) arguments: Vec<f64>,
}

impl Default for ControlFlow {
    fn default() -> Self {
        Self {
            location_changed: true,
            line_buffer: Lines::default(),
            is_buffered: false,
            frames: vec![Frame::default()],
            skip: None,
            skips_assumed: false,
            definition: None,
            rejected_subs: Vec::new(),
            library: Library::default(),
            labels: Names::default(),
            arguments: Vec::new(),
        }
    }
}

impl<R: BufRead> Interpreter<R> {
    /// The start of the outermost loop that contains the line read last, in the program or in a subroutine.
    #[must_use]
    pub fn outermost_loop(&self) -> Option<LoopStart> {
        self.flow.outermost_loop()
    }
}

impl ControlFlow {
    /// The start of the outermost active loop.
    pub(crate) fn outermost_loop(&self) -> Option<LoopStart> {
        self.frames.iter().find_map(|frame| {
            let start = frame.open_blocks.iter().find_map(|open| open.loop_start())?;
            let lines = frame.lines.as_deref().unwrap_or(&self.line_buffer);
            Some(LoopStart {
                file: lines.file.as_deref().map(str::to_owned),
                line: lines.get(start)?.1,
            })
        })
    }
}
