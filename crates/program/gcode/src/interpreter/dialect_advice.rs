//! Warnings and errors for lines that have another meaning on other controls, and the state on which advice
//! depends.

use std::io::BufRead;

use evolvent_path::Plane;

use crate::Interpreter;
use crate::diagnostics::diagnostic::Fault;
use crate::diagnostics::dialect_conflicts;
use crate::diagnostics::foreign_line::DialectContext;

impl<R: BufRead> Interpreter<R> {
    /// The state on which advice depends. A rejected line has set neither plane nor G7.
    pub(super) fn dialect_context(&self) -> DialectContext {
        DialectContext {
            is_lathe: self.settings.features.lathe,
            is_zx: self.state.plane() == Some(Plane::Zx),
            is_diameter: self.state.modes.diameter,
        }
    }

    /// Rejects a line that has another meaning on other lathes, or warns of it.
    pub(super) fn check_lathe_forms(&mut self) -> Result<(), Fault> {
        let (line, tools) = (&self.current.statement, self.tools.as_ref());
        if let Some(text) = dialect_conflicts::on_lathe(line, &mut self.state, tools)? {
            self.warn(text);
        }
        Ok(())
    }

    pub(super) fn warn_of_feed_before_unit(&mut self) {
        if let Some(text) = dialect_conflicts::feed_before_unit(&self.current.statement, &self.state) {
            self.warn(text);
        }
    }

    pub(super) fn warn_of_foreign_reads(&mut self) {
        if let Some(text) = self.parameters.foreign_reads.take() {
            self.warn(text);
        }
    }

    pub(super) fn warn_of_assignments(&mut self) {
        let block = &self.current.block;
        if let Some(text) = dialect_conflicts::assignment(&block.assignments, !block.comments.is_empty()) {
            self.warn(text);
        }
    }
}
