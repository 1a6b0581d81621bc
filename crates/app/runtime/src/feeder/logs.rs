//! Files written by the program.

use evolvent_gcode::LogAction;
use evolvent_motion::QueueClosed;
use evolvent_planner::PlanSink;

use super::Feeder;
use crate::log_file::{LogFiles, LogKind, log_objection};
use crate::source::Commands;

/// The error of a log file that cannot be written, with its remedy.
fn no_log(message: String) -> (String, String) {
    let help = "check the folder of the log files, program.log_folder of the machine file";
    (message, help.to_owned())
}

impl<S: PlanSink<Error = QueueClosed>> Feeder<'_, S> {
    /// Carries out a comment about log files. Returns the error, if any.
    pub(super) fn log(&mut self, log: &LogAction, line: u32) -> Option<(String, String)> {
        if let Some(objection) = log_objection(log) {
            return Some(objection);
        }
        let Some(folder) = &self.setup.log_folder else {
            if matches!(
                log,
                LogAction::Open(_) | LogAction::Append(_) | LogAction::OpenProbes(_)
            ) && self.reporter.warned.insert(line)
            {
                let text = "warning: time is virtual: the log file is not written";
                self.reporter.announce_in_passing(line, true, text);
            }
            return None;
        };
        let logs = self.logs.get_or_insert_with(|| LogFiles::new(folder.clone()));
        if matches!(log, LogAction::Line(_)) && !logs.is_open(LogKind::Lines) {
            if self.reporter.warned.insert(line) {
                let text = "warning: no log file is open, so this line is not written: write (LOGOPEN,name) \
                            before it";
                self.reporter.announce_in_passing(line, true, text);
            }
            return None;
        }
        logs.act(log).err().map(no_log)
    }

    /// Writes the position of a probe contact if a file for it is open.
    pub(super) fn log_probe(&mut self, commands: &Commands, tripped: bool) -> Option<(String, String)> {
        let logs = self.logs.as_mut().filter(|_| tripped)?;
        let text = commands.probed().map(|value| format!("{value:.6}")).join(" ");
        logs.line(LogKind::Probes, text).err().map(no_log)
    }

    /// Closes the files that the program has left open, and waits for the disk.
    pub(super) fn finish_logs(&mut self) {
        if let Some(Err(text)) = self.logs.take().map(LogFiles::finish) {
            let text = format!("warning: {text}");
            self.reporter.announce_in_passing(self.last_line, true, &text);
        }
    }
}
