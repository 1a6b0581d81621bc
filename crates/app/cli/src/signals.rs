//! What SIGINT, SIGTERM, SIGHUP and SIGQUIT mean to a command that moves axes.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use signal_hook::consts::{SIGHUP, SIGINT, SIGQUIT, SIGTERM, SIGTSTP};

use crate::CommandError;

/// How often signals are looked at.
const SIGNAL_POLL: Duration = Duration::from_millis(5);
/// Signals that follow the first within this are the same request: `timeout` sends one to the process and one
/// to its group, and a terminal and a shell may both send theirs. To end at the second would leave axes
/// moving.
const SAME_REQUEST: Duration = Duration::from_millis(500);

/// Calls `stop` at the first SIGINT, SIGTERM, SIGHUP or SIGQUIT. A second SIGINT or SIGTERM, [`SAME_REQUEST`]
/// later or more, ends the process at once, with exit code 1.
pub(crate) fn stop_at_first(stop: impl FnOnce() + Send + 'static) -> Result<(), CommandError> {
    let (signalled, ends) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(false)));
    let register = || {
        for signal in [SIGINT, SIGTERM] {
            signal_hook::flag::register_conditional_shutdown(signal, 1, Arc::clone(&ends))?;
            signal_hook::flag::register(signal, Arc::clone(&signalled))?;
        }
        // Who presses Ctrl-\ wants an end, but not of the process that holds the axes' request.
        signal_hook::flag::register(SIGQUIT, Arc::clone(&signalled))?;
        // Shells and kernels may both send it: a second one is no second request.
        signal_hook::flag::register(SIGHUP, Arc::clone(&signalled))
    };
    register().map_err(|error| cannot_be_caught(&error))?;
    thread::spawn(move || {
        while !signalled.load(Ordering::Relaxed) {
            thread::sleep(SIGNAL_POLL);
        }
        stop();
        thread::sleep(SAME_REQUEST);
        ends.store(true, Ordering::Relaxed);
    });
    Ok(())
}

/// Ctrl-Z does nothing from now on: it would freeze the axes wherever they are.
pub(crate) fn ignore_suspension() -> Result<(), CommandError> {
    signal_hook::flag::register(SIGTSTP, Arc::new(AtomicBool::new(false)))
        .map(drop)
        .map_err(|error| cannot_be_caught(&error))
}

fn cannot_be_caught(error: &std::io::Error) -> CommandError {
    CommandError::Failed(format!("signals cannot be caught: {error}"))
}
