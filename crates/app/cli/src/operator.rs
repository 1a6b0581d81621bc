//! The operator at the terminal: confirmation at program stops, and signals.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use evolvent_runtime::Controls;
use rustix::process::getpgrp;
use rustix::termios::{QueueSelector, tcflush, tcgetpgrp};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM, SIGTSTP};

use crate::CommandError;

/// Poll interval of signals.
const SIGNAL_POLL: Duration = Duration::from_millis(5);
/// Signals that follow the first within this time count as the same request: `timeout` sends its own to the
/// process and to its group.
const SAME_WISH: Duration = Duration::from_millis(500);
/// Poll interval of program stops.
const ANSWER_POLL: Duration = Duration::from_millis(20);

/// SIGINT, SIGTERM and a terminal that closes stop within the limits; a second SIGINT or SIGTERM,
/// [`SAME_WISH`] later or more, ends the process at once. Ctrl-Z does nothing, because it would freeze the
/// axes at their positions.
pub(crate) fn watch_signals(controls: &Arc<Controls>) -> Result<(), CommandError> {
    let (signalled, ends) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(false)));
    let register = || {
        for signal in [SIGINT, SIGTERM] {
            signal_hook::flag::register_conditional_shutdown(signal, 1, Arc::clone(&ends))?;
            signal_hook::flag::register(signal, Arc::clone(&signalled))?;
        }
        // Shells and kernels may both send it: the second one is not a second request.
        signal_hook::flag::register(SIGHUP, Arc::clone(&signalled))?;
        signal_hook::flag::register(SIGTSTP, Arc::new(AtomicBool::new(false)))
    };
    register().map_err(|error| CommandError::Failed(format!("signals cannot be caught: {error}")))?;
    let controls = Arc::clone(controls);
    thread::spawn(move || {
        while !signalled.load(Ordering::Relaxed) {
            thread::sleep(SIGNAL_POLL);
        }
        controls.stop();
        thread::sleep(SAME_WISH);
        ends.store(true, Ordering::Relaxed);
    });
    Ok(())
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
            // Without this, input typed too early counts; nothing worse.
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
