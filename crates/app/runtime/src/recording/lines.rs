//! The texts of the lines of a program, for its blocks in the trace.

use std::io::{BufRead, BufReader, Cursor, Read};
use std::path::PathBuf;
use std::sync::Arc;

use evolvent_config::open_regular;

use crate::program_copy::{FromStart, ProgramText};

/// Source of the lines.
pub(super) enum LinesSource {
    /// A program that runs alone and was opened a moment ago.
    Path(PathBuf),
    Text(ProgramText),
}

/// Lines of the program by number, mostly in order.
pub(super) struct Lines {
    source: LinesSource,
    reader: Option<BufReader<Box<dyn Read>>>,
    pub(super) line: u32,
    pub(super) text: Vec<u8>,
}

impl Lines {
    pub(super) fn new(source: LinesSource) -> Self {
        Self {
            source,
            reader: None,
            line: 0,
            text: Vec::new(),
        }
    }

    /// Whether a copy is still in progress.
    pub(super) fn are_coming(&self) -> bool {
        matches!(&self.source, LinesSource::Text(ProgramText::Copy(copy)) if copy.poll().is_none())
    }

    pub(super) fn open(&self) -> Option<BufReader<Box<dyn Read>>> {
        let reader: Box<dyn Read> = match &self.source {
            LinesSource::Path(path) => Box::new(open_regular(path).ok()?),
            LinesSource::Text(ProgramText::Whole(text)) => Box::new(Cursor::new(Arc::clone(text))),
            LinesSource::Text(ProgramText::Copy(copy)) => {
                let file = copy.poll()?.ok()?;
                Box::new(FromStart { file, at: 0 })
            }
        };
        Some(BufReader::new(reader))
    }

    pub(super) fn text(&mut self, line: u32) -> String {
        if self.reader.is_none() || line < self.line {
            self.reader = self.open();
            self.line = 0;
        }
        let Some(reader) = &mut self.reader else {
            return String::new();
        };
        while self.line < line {
            self.text.clear();
            if reader.read_until(b'\n', &mut self.text).unwrap_or(0) == 0 {
                return String::new();
            }
            self.line += 1;
        }
        String::from_utf8_lossy(&self.text).trim_end().to_owned()
    }
}
