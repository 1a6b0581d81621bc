//! Runs a bridge on a thread while a test uses its core.

use core::fmt::Debug;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::atomic::{AtomicBool, Ordering};

use evolvent_bus::remove_private_domain;

use crate::messages::Messages;

/// Runs a bridge while a test uses a core of the same prefix, and returns the bridge's report. Removes the
/// bus afterwards, even if the test fails.
///
/// # Panics
/// If the test panics, or if the bridge ends with an error.
pub fn with_bridge<C, R, E>(
    prefix: &str,
    bridge: impl FnOnce(&AtomicBool, &Messages) -> Result<R, E> + Send,
    mut core: C,
    test: impl FnOnce(&mut C, &Messages),
) -> R
where
    R: Debug + Send,
    E: Debug + Send,
{
    let (stop, messages) = (AtomicBool::new(false), Messages::default());
    let (report, result) = std::thread::scope(|scope| {
        let running = scope.spawn(|| bridge(&stop, &messages));
        let result = catch_unwind(AssertUnwindSafe(|| test(&mut core, &messages)));
        stop.store(true, Ordering::Relaxed);
        (running.join().expect("no panic"), result)
    });
    drop(core);
    let _swept = remove_private_domain(prefix);
    println!("{messages:#?} {report:?}");
    if let Err(panic) = result {
        resume_unwind(panic);
    }
    report.expect("a bridge that fits")
}
