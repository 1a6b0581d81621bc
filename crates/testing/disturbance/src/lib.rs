//! For tests of real time: a trial that failed is played again where the host kept its processes from running.
//!
//! ```
//! use std::time::Duration;
//!
//! let woke = evolvent_disturbance::unless_disturbed(|| {
//!     let begin = std::time::Instant::now();
//!     std::thread::sleep(Duration::from_millis(1));
//!     // Fails on a host that stops this process for longer; that is no fault of the code under test.
//!     assert!(begin.elapsed() < Duration::from_millis(200));
//!     true
//! });
//! assert!(woke);
//! ```
//!
//! A process that the trial started and that records its own pauses is heard through [`tell_pause`].
#![expect(
    clippy::expect_used,
    clippy::print_stdout,
    reason = "helpers of tests fail and talk as tests do"
)]

use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Whatever is kept waiting for longer explains a failure. Half the shortest patience that is tested, the dead-man's.
const PAUSE: Duration = Duration::from_millis(50);
const ATTEMPTS: u32 = 5;

thread_local! {
    static TOLD_NS: Cell<u64> = const { Cell::new(0) };
}

/// Says that a process of the test was kept from running for so long, by what it recorded itself.
pub fn tell_pause(pause_ns: u64) {
    TOLD_NS.with(|told| told.set(told.get().max(pause_ns)));
}

/// Plays a trial, and again (at most five times) where it failed while the host kept this process, the core or the drives from
/// running. What fails on a host that let them run fails at once, and what is broken fails each time.
///
/// # Panics
/// As the trial does.
pub fn unless_disturbed<T>(trial: impl Fn() -> T) -> T {
    let mut attempt = 1;
    loop {
        TOLD_NS.with(|told| told.set(0));
        let (result, own) = watched(|| catch_unwind(AssertUnwindSafe(&trial)));
        let panic = match result {
            Ok(result) => return result,
            Err(panic) => panic,
        };
        let pause = own.max(Duration::from_nanos(TOLD_NS.with(Cell::get)));
        if attempt == ATTEMPTS || pause < PAUSE {
            resume_unwind(panic);
        }
        println!("attempt {attempt} was kept from running for {pause:?}: once more");
        attempt += 1;
    }
}

/// The longest time that a thread beside the work, which sleeps for 2 ms at a time, was kept waiting.
fn watched<T>(work: impl FnOnce() -> T) -> (T, Duration) {
    let over = Arc::new(AtomicBool::new(false));
    let told = Arc::clone(&over);
    let watch = std::thread::spawn(move || {
        let mut longest = Duration::ZERO;
        while !told.load(Ordering::Relaxed) {
            let begin = Instant::now();
            std::thread::sleep(Duration::from_millis(2));
            longest = longest.max(begin.elapsed());
        }
        longest
    });
    let result = work();
    over.store(true, Ordering::Relaxed);
    (result, watch.join().expect("a watch"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn attempts(pause_ns: u64, fails: impl Fn(u32) -> bool) -> (u32, bool) {
        let count = Cell::new(0);
        let result = catch_unwind(AssertUnwindSafe(|| {
            unless_disturbed(|| {
                count.set(count.get() + 1);
                tell_pause(pause_ns);
                assert!(!fails(count.get()));
            });
        }));
        (count.get(), result.is_ok())
    }

    #[test]
    fn a_trial_that_passes_is_played_once() {
        assert_eq!(attempts(1_000_000_000, |_| false), (1, true));
    }

    #[test]
    fn a_failure_is_tried_again_after_a_pause() {
        assert_eq!(attempts(60_000_000, |attempt| attempt < 3), (3, true));
    }

    #[test]
    fn what_is_broken_fails_after_five_attempts() {
        assert_eq!(attempts(60_000_000, |_| true), (5, false));
    }
}
