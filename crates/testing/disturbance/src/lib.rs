//! For real-time tests: a failed trial is repeated if the host kept its processes from running.
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
//! [`report_pause`] adds pauses that a process of the trial has recorded itself.
#![expect(
    clippy::expect_used,
    clippy::print_stdout,
    reason = "helpers of tests fail and print as tests do"
)]

use std::any::Any;
use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// A longer pause explains a failure. Three quarters of the shortest time limit under test: a bridge that is
/// suspended for ten periods of 1 ms brakes by itself.
const PAUSE: Duration = Duration::from_micros(7500);
const ATTEMPTS: u32 = 5;
/// If the host suspends the test for this long in every attempt, the trial is not measured. In this time a jog
/// has to stop whose operator is lost, and inputs become unknown.
const STANDSTILL: Duration = Duration::from_millis(100);
/// Attempts of [`where_undisturbed`]. On a host that is never quiet for the length of a trial, every attempt
/// would fail.
const QUIET_ATTEMPTS: u32 = 3;

thread_local! {
    static REPORTED_NS: Cell<u64> = const { Cell::new(0) };
}

/// Adds a pause of another process of the test, as that process has recorded it, ns.
pub fn report_pause(pause_ns: u64) {
    REPORTED_NS.with(|reported| reported.set(reported.get().max(pause_ns)));
}

/// Runs a trial, at most five times: it is repeated if it fails while the host kept this process, the core or
/// the drives from running. A failure without such a pause counts at once, and broken code fails every time.
/// If the host stood still for 100 ms in each of five attempts, it prints that and panics; where it is the last
/// line of a test that `tools/test` runs alone, that does not count as a failure. Reported pauses do not lead
/// to it, since the code under test may have caused them.
///
/// # Panics
/// If the last attempt panics.
pub fn unless_disturbed<T>(trial: impl Fn() -> T) -> T {
    match play(PAUSE, ATTEMPTS, trial) {
        Played::Passed(result) => result,
        Played::Failed(panic) => resume_unwind(panic),
        Played::Disturbed { panic, shortest } => {
            if shortest >= STANDSTILL {
                // `tools/test` looks for this line.
                println!("the host stood still in every attempt, for {shortest:?} at least");
            }
            resume_unwind(panic)
        }
    }
}

/// Like [`unless_disturbed`] with at most three attempts, for properties that hold only while every cycle
/// runs in time: a pause longer than `pause` explains a failure. Returns `None`, and prints "not measured",
/// if every attempt failed while the host was busy.
///
/// # Panics
/// If the trial panics without such a pause.
pub fn where_undisturbed<T>(pause: Duration, trial: impl Fn() -> T) -> Option<T> {
    match play(pause, QUIET_ATTEMPTS, trial) {
        Played::Passed(result) => Some(result),
        Played::Failed(panic) => resume_unwind(panic),
        Played::Disturbed { .. } => {
            println!("not measured: this host kept the test from running for more than {pause:?} each time");
            None
        }
    }
}

/// Result of the attempts, with the panic of the last one.
enum Played<T> {
    Passed(T),
    Failed(Box<dyn Any + Send>),
    /// Every attempt failed while the host kept it from running. `shortest`: of the longest pauses of this
    /// process in each.
    Disturbed {
        panic: Box<dyn Any + Send>,
        shortest: Duration,
    },
}

fn play<T>(longest: Duration, attempts: u32, trial: impl Fn() -> T) -> Played<T> {
    let (mut attempt, mut shortest) = (1, Duration::MAX);
    loop {
        REPORTED_NS.with(|reported| reported.set(0));
        let (result, own) = watched(|| catch_unwind(AssertUnwindSafe(&trial)));
        let panic = match result {
            Ok(result) => return Played::Passed(result),
            Err(panic) => panic,
        };
        let pause = own.max(Duration::from_nanos(REPORTED_NS.with(Cell::get)));
        if pause < longest {
            return Played::Failed(panic);
        }
        shortest = shortest.min(own);
        if attempt == attempts {
            return Played::Disturbed { panic, shortest };
        }
        println!("attempt {attempt} was kept from running for {pause:?}: once more");
        attempt += 1;
    }
}

/// Runs the work and returns the longest delay of a thread beside it that sleeps for 2 ms at a time. Tests
/// use this to count only trials that the host did not disturb.
///
/// # Panics
/// If the work panics.
pub fn watched<T>(work: impl FnOnce() -> T) -> (T, Duration) {
    let over = Arc::new(AtomicBool::new(false));
    let is_over = Arc::clone(&over);
    let watch = std::thread::spawn(move || {
        let mut longest = Duration::ZERO;
        while !is_over.load(Ordering::Relaxed) {
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
                report_pause(pause_ns);
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
    fn a_failure_without_a_pause_is_one() {
        // The host may cause such pauses by itself.
        let (count, has_passed) = (0..20)
            .map(|_| attempts(1_000_000, |attempt| attempt == 1))
            .min()
            .unwrap_or_default();
        assert_eq!((count, has_passed), (1, false));
    }

    #[test]
    fn what_needs_a_quiet_host_is_not_measured_on_another() {
        let pause = Duration::from_secs(10);
        let trial = |pause_ns| {
            move || {
                report_pause(pause_ns);
                assert_eq!(pause_ns, 1, "out of phase");
            }
        };
        assert_eq!(where_undisturbed(pause, trial(1)), Some(()));
        assert_eq!(where_undisturbed(pause, trial(11_000_000_000)), None);
        let quiet = catch_unwind(|| where_undisturbed(pause, trial(2)));
        assert!(quiet.is_err(), "broken");
    }

    #[test]
    fn reported_pauses_are_no_standstill() {
        let played = play(PAUSE, 2, || {
            report_pause(1_000_000_000);
            assert_eq!(1, 2, "broken");
        });
        assert!(matches!(played, Played::Disturbed { shortest, .. } if shortest < Duration::from_secs(1)));
    }

    #[test]
    fn what_is_broken_fails_after_five_attempts() {
        assert_eq!(attempts(60_000_000, |_| true), (5, false));
    }
}
