//! Effect of SIGINT, SIGTERM, SIGHUP and SIGQUIT on a command that moves axes.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use signal_hook::consts::{SIGHUP, SIGINT, SIGQUIT, SIGTERM, SIGTSTP};

use crate::CommandError;

/// Poll interval of signals.
const SIGNAL_POLL: Duration = Duration::from_millis(5);
/// Signals that follow the first within this time are the same request: `timeout` sends one to the process
/// and one to its group, and a terminal and a shell may each send one. Ending at the second would leave axes
/// in motion.
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
        // Ctrl-\ is a request to end, but must not kill the process that controls the axes.
        signal_hook::flag::register(SIGQUIT, Arc::clone(&signalled))?;
        // Shells and kernels may both send it, so a second one is not a second request.
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

/// Ignores Ctrl-Z, which would freeze the axes in motion.
pub(crate) fn ignore_suspension() -> Result<(), CommandError> {
    signal_hook::flag::register(SIGTSTP, Arc::new(AtomicBool::new(false)))
        .map(drop)
        .map_err(|error| cannot_be_caught(&error))
}

fn cannot_be_caught(error: &std::io::Error) -> CommandError {
    CommandError::Failed(format!("signals cannot be caught: {error}"))
}
