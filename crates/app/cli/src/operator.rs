//! The operator at the terminal: confirmation at program stops, and signals.

use std::io;
use std::sync::Arc;
use std::thread;
use std::time::Duration;

use evolvent_runtime::Controls;
use rustix::process::getpgrp;
use rustix::termios::{QueueSelector, tcflush, tcgetpgrp};

use crate::CommandError;
use crate::signals::{ignore_suspension, stop_at_first};

/// Poll interval of program stops.
const ANSWER_POLL: Duration = Duration::from_millis(20);

/// The first signal stops the run within the limits.
pub(crate) fn watch_signals(controls: &Arc<Controls>) -> Result<(), CommandError> {
    ignore_suspension()?;
    let controls = Arc::clone(controls);
    stop_at_first(move || controls.stop())
}

/// Continues after a program stop when Enter is pressed.
///
/// The terminal is read only at program stops, and only in the foreground: the system halts a background
/// process that reads its terminal, and the axes with it. Input typed before the stop does not confirm it.
pub(crate) fn resume_on_enter(controls: &Arc<Controls>) {
    let controls = Arc::clone(controls);
    thread::spawn(move || {
        let mut answered = None;
        loop {
            thread::sleep(ANSWER_POLL);
            let progress = controls.progress();
            let is_new = answered != Some(progress.resumes);
            if !(progress.at_program_stop && is_new && is_in_foreground()) {
                continue;
            }
            // If this fails, input typed too early counts, which does no harm.
            let _kept = tcflush(io::stdin(), QueueSelector::IFlush);
            match io::stdin().read_line(&mut String::new()) {
                Ok(bytes) if bytes > 0 => {
                    answered = Some(progress.resumes);
                    controls.resume();
                }
                // The terminal was closed.
                _ => return,
            }
        }
    });
}

fn is_in_foreground() -> bool {
    tcgetpgrp(io::stdin()).is_ok_and(|group| group == getpgrp())
}
