//! Executes the line that was read.

use std::io::BufRead;

use crate::diagnostics::diagnostic::Fault;
use crate::interpreter::Interpreter;
use crate::state::scope::Scope;
use crate::syntax::parser::{first_character, is_block_delete, is_percent, parse};

impl<R: BufRead> Interpreter<R> {
    /// Executes the present line: an O-word, assignments and comments, or a statement.
    pub(super) fn interpret(&mut self) -> Result<(), Fault> {
        if first_character(&self.current.text).is_none() {
            return Ok(());
        }
        if self.parameters.assumption.is_some() {
            self.begin_line_with_assumption();
        }
        if self.flow.frames.len() > 1 {
            // The delimiters of a file have no meaning inside the program.
            if is_percent(&self.current.text) {
                return Ok(());
            }
        } else {
            if self.percent.is_none() && is_percent(&self.current.text) {
                self.percent = Some(true);
                return Ok(());
            }
            self.percent.get_or_insert(false);
            if self.flow.frames[0].lines.is_none() {
                self.current.calling_line = self.current.number;
            }
        }
        if is_block_delete(&self.current.text) {
            let (skipped, executed) = &mut self.block_delete_lines;
            if self.settings.block_delete {
                *skipped += 1;
                return Ok(());
            }
            *executed += 1;
        }
        if self.flow()? {
            self.warn_of_foreign_reads();
            return Ok(());
        }
        let scope = Scope {
            parameters: &self.parameters,
            state: &self.state,
            settings: &self.settings,
            line: self.current.number,
        };
        parse(&self.current.text, &mut self.current.block, &scope)?;
        self.warn_of_foreign_reads();
        let is_profile = self.capture.is_some();
        if is_profile {
            self.read_corner()?;
        }
        if self.current.block.words.is_empty() {
            // Parameters and comments alone produce no command.
            self.assign()?;
            self.warn_of_assignments();
            let number = self.program_line();
            self.execute_comments(number)?;
            self.parameters.commit();
            return Ok(());
        }
        let modal = self.state.motion;
        self.current
            .statement
            .fill(&self.current.block, modal, &self.settings)?;
        self.warn_of_feed_before_unit();
        if self.settings.features.lathe {
            self.check_lathe_forms()?;
        }
        self.assign()?;
        let number = self.program_line();
        if !self.current.block.comments.is_empty() {
            self.execute_comments(number)?;
        }
        if self.needs_split()? {
            return self.split_at_tool_change();
        }
        self.execute_statement()?;
        if is_profile {
            self.record_profile_line();
        }
        Ok(())
    }

    /// Executes the present statement; if it fails, the state is as before.
    pub(crate) fn execute_statement(&mut self) -> Result<(), Fault> {
        // A line with only a straight move changes little of the state, and long programs consist of such
        // lines.
        let is_plain = self.current.statement.is_plain_move() && self.state.is_plain();
        let plain_move_state = self.state.plain_move_state();
        if !is_plain {
            self.state_before = self.state;
        }
        let skips_end = self.skips_end();
        let request = self.executor_of_line(skips_end).run();
        let result = request.and_then(|request| match request {
            Some(request) => self.handle_request(request),
            None => Ok(()),
        });
        if result.is_err() {
            if is_plain {
                self.state.restore_plain_move_state(plain_move_state);
            } else {
                self.state = self.state_before;
            }
            return result;
        }
        self.parameters.commit();
        self.finished |= self.state.ended;
        if self.state.ended {
            self.warn_of_open_at_end();
        }
        if skips_end {
            self.warn_of_skipped_end();
        }
        if self.settings.probes_succeed {
            self.update_assumption();
        }
        if self.errors.uncertain_state.is_uncertain() {
            self.errors
                .uncertain_state
                .record_executed(&self.current.statement, &self.state);
        }
        Ok(())
    }
}
