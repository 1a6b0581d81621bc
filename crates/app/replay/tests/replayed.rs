//! A replay is a core for its clients, and never moves drives with power.
#![allow(
    clippy::expect_used,
    clippy::print_stdout,
    reason = "tests fail and talk as tests do"
)]

use std::cell::Cell;
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use crate::common::{PROGRAM, cycles, record};
use evolvent_bus::{BusConfig, ClientBus, ClientConfig, CoreBus, Feedback, Setpoint, remove_private_domain};
use evolvent_inspect::Selection;
use evolvent_replay::{Pace, Replay, ReplayError, Replayed, replay};
use evolvent_runtime::Clock;

/// Longer than any host suspends a test.
const FOREVER: Duration = Duration::from_secs(60);

/// A separate prefix of shared memory.
struct Corner(String);

impl Corner {
    fn new() -> Self {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        Self(format!("evin{}-{number}-", std::process::id()))
    }

    fn client(&self) -> ClientBus {
        let config = ClientConfig {
            prefix: Some(self.0.clone()),
            wait: FOREVER,
            ..ClientConfig::new("mill-3axis")
        };
        ClientBus::open(&config).expect("a core on the bus")
    }
}

impl Drop for Corner {
    fn drop(&mut self) {
        let removed = remove_private_domain(&self.0);
        if !std::thread::panicking() {
            removed.expect("the corner to be swept");
        }
    }
}

fn options(corner: &Corner, pace: Pace) -> Replay {
    Replay {
        selection: Selection::default(),
        pace,
        machine_name: None,
        bus_prefix: Some(corner.0.clone()),
        wait_for_subscribers: 0,
        force: false,
        machine_is_on: false,
    }
}

/// Listens from before the first setpoint to the last. Returns the setpoints and the number lost.
fn listen(corner: &Corner) -> (Vec<Setpoint>, u64) {
    let client = corner.client();
    let mut reader = client.setpoints().expect("a place");
    let mut found = Vec::new();
    let begin = Instant::now();
    while begin.elapsed() < FOREVER {
        match reader.receive().expect("a connection") {
            Some(setpoint) => {
                let is_last = setpoint.flags & 128 != 0;
                found.push(setpoint);
                if is_last {
                    break;
                }
            }
            None => std::thread::sleep(Duration::from_millis(1)),
        }
    }
    (found, reader.lost())
}

fn replay_to_listener(trace: &Path, corner: &Corner, factor: f64) -> (Vec<Setpoint>, u64, Replayed) {
    let mut wanted = options(corner, Pace::Factor(factor));
    wanted.wait_for_subscribers = 1;
    std::thread::scope(|scope| {
        let listener = scope.spawn(move || listen(corner));
        let done = replay(trace, &wanted, |_| ControlFlow::Continue(7), || false).expect("a replay");
        let (found, lost) = listener.join().expect("a listener");
        (found, lost, done)
    })
}

#[test]
fn a_listener_gets_recorded_setpoints_on_time() {
    let folder = tempfile::tempdir().expect("a folder");
    let (trace, _) = record(folder.path(), "run", PROGRAM, Clock::Virtual, 1.0, |_| {});
    let all = cycles(&trace);
    let corner = Corner::new();
    // A listener that is suspended for a second loses setpoints, as on any bus.
    let mut attempts = 0;
    let (found, done) = loop {
        let (found, lost, done) = replay_to_listener(&trace, &corner, 1.0);
        if lost == 0 {
            break (found, done);
        }
        attempts += 1;
        assert!(attempts < 5, "setpoints were lost on the way: {lost}");
    };
    assert_eq!((found.len(), done.setpoints), (all.len(), all.len() as u64));
    for (setpoint, cycle) in found.iter().zip(&all) {
        assert_eq!(setpoint.sequence, cycle.sequence);
        assert_eq!(setpoint.position, cycle.position);
        assert_eq!(
            (setpoint.velocity, setpoint.acceleration),
            (cycle.velocity, cycle.acceleration)
        );
        assert_eq!(
            (setpoint.line, setpoint.state),
            (cycle.line, u32::from(cycle.state))
        );
    }
    let recorded_s = all.len() as f64 * 1e-3;
    assert!(
        done.seconds >= recorded_s * 0.99,
        "{} s for {recorded_s} s",
        done.seconds
    );
}

#[test]
fn a_factor_makes_recorded_time_go_by_faster() {
    let folder = tempfile::tempdir().expect("a folder");
    let (trace, _) = record(folder.path(), "run", PROGRAM, Clock::Virtual, 1.0, |_| {});
    let all = cycles(&trace);
    let corner = Corner::new();
    let (found, _, done) = replay_to_listener(&trace, &corner, 4.0);
    assert_eq!(done.setpoints, all.len() as u64);
    // Compares due times, whatever was lost: a busy host is late, and so is a listener on it.
    assert!(found.len() > 1, "{} setpoints", found.len());
    let start_ns = |setpoint: &Setpoint| {
        let cycle = &all[(setpoint.sequence - all[0].sequence) as usize];
        setpoint.due_time_ns - (cycle.due_time_ns - all[0].due_time_ns) / 4
    };
    for setpoint in &found {
        assert_eq!(start_ns(setpoint), start_ns(&found[0]), "{}", setpoint.sequence);
    }
    let recorded_s = all.len() as f64 * 1e-3;
    assert!(
        done.seconds >= recorded_s / 4.0 * 0.99,
        "{} s for {recorded_s} s at four times the speed",
        done.seconds
    );
}

#[test]
fn a_part_is_stepped_through_as_the_caller_says() {
    let folder = tempfile::tempdir().expect("a folder");
    let (trace, _) = record(folder.path(), "run", PROGRAM, Clock::Virtual, 1.0, |_| {});
    let corner = Corner::new();
    let mut wanted = options(&corner, Pace::Step);
    wanted.selection.lines = 6..=u32::MAX;
    let mut received = Vec::new();
    let done = replay(
        &trace,
        &wanted,
        |record| {
            received.push((record.sequence, record.line));
            if received.len() == 4 {
                ControlFlow::Break(())
            } else {
                ControlFlow::Continue(10)
            }
        },
        || false,
    )
    .expect("a replay");
    assert_eq!(done.setpoints, 30);
    assert_eq!(received[0].1, 6, "from the line on");
    assert_eq!(received[1].0, received[0].0 + 10);
    wanted.selection.time_s = 1e6..=2e6;
    let nothing = replay(&trace, &wanted, |_| ControlFlow::Continue(1), || false);
    assert!(matches!(nothing, Err(ReplayError::Nothing)));
}

#[test]
fn a_core_that_lives_is_not_replaced() {
    let folder = tempfile::tempdir().expect("a folder");
    let (trace, _) = record(folder.path(), "run", PROGRAM, Clock::Virtual, 1.0, |_| {});
    let corner = Corner::new();
    let mut config = BusConfig::new("mill-3axis", "XYZ", 1_000_000);
    config.prefix = Some(corner.0.clone());
    let core = CoreBus::open(&config).expect("a core");
    for said in [false, true] {
        let mut wanted = options(&corner, Pace::Factor(100.0));
        (wanted.force, wanted.machine_is_on) = (said, said);
        let refused = replay(&trace, &wanted, |_| ControlFlow::Continue(1), || false);
        assert!(matches!(refused, Err(ReplayError::Bus(_))), "{refused:?}");
    }
    drop(core);
}

/// A bridge that replies to anything once it is enabled; `sent` counts.
fn answer_always(
    corner: &Corner,
    status_word: u32,
    starts: &AtomicBool,
    sent: &AtomicU64,
    over: &AtomicBool,
) {
    // The core may have ended before the bridge finds it.
    let config = ClientConfig {
        prefix: Some(corner.0.clone()),
        wait: Duration::from_millis(50),
        ..ClientConfig::new("mill-3axis")
    };
    let mut sender = loop {
        let opened = ClientBus::open(&config).and_then(|client| client.feedback_sender());
        match opened {
            Ok(sender) => break sender,
            Err(_) if over.load(Ordering::Relaxed) => return,
            Err(_) => {}
        }
    };
    let mut feedback = Feedback::default();
    feedback.status_word[1] = status_word;
    while !over.load(Ordering::Relaxed) {
        if starts.load(Ordering::Relaxed) && sender.send(&feedback).is_ok() {
            sent.fetch_add(1, Ordering::Relaxed);
        }
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// Replays to such a bridge. `pause`: time for which the host suspends both when the replay starts to listen.
fn replay_to_drives(
    trace: &Path,
    corner: &Corner,
    (force, machine_is_on): (bool, bool),
    status_word: u32,
    pause: Duration,
) -> Result<Replayed, ReplayError> {
    let (starts, over) = (AtomicBool::new(pause.is_zero()), AtomicBool::new(false));
    let sent = AtomicU64::new(0);
    let mut wanted = options(corner, Pace::Factor(1000.0));
    (wanted.force, wanted.machine_is_on) = (force, machine_is_on);
    std::thread::scope(|scope| {
        scope.spawn(|| answer_always(corner, status_word, &starts, &sent, &over));
        let times = Cell::new(0);
        // Called before each poll.
        let stop = || {
            times.set(times.get() + 1);
            match times.get() {
                1 => std::thread::sleep(pause),
                2 => {
                    starts.store(true, Ordering::Relaxed);
                    // One reply may have begun before the core existed.
                    let (begin, before) = (Instant::now(), sent.load(Ordering::Relaxed));
                    while sent.load(Ordering::Relaxed) < before + 2 && begin.elapsed() < FOREVER {
                        std::thread::sleep(Duration::from_millis(1));
                    }
                }
                _ => {}
            }
            false
        };
        let result = replay(trace, &wanted, |_| ControlFlow::Continue(1), stop);
        over.store(true, Ordering::Relaxed);
        result
    })
}

#[test]
fn drives_with_power_move_only_with_both_options() {
    let folder = tempfile::tempdir().expect("a folder");
    let (trace, _) = record(folder.path(), "run", PROGRAM, Clock::Virtual, 1.0, |_| {});
    let corner = Corner::new();
    let attempt = |force: bool, machine_is_on: bool, status_word: u32| {
        let said = (force, machine_is_on);
        replay_to_drives(&trace, &corner, said, status_word, Duration::ZERO)
    };
    // 0x0237: operation enabled. 0x0250: switch on disabled.
    for (force, is_on) in [(false, false), (true, false), (false, true)] {
        let refused = attempt(force, is_on, 0x0237);
        assert!(
            matches!(refused, Err(ReplayError::MachineIsOn { axis: 1, .. })),
            "{refused:?}"
        );
    }
    assert!(attempt(true, true, 0x0237).is_ok(), "said twice");
    assert!(
        attempt(false, false, 0x0250).is_ok(),
        "drives that are off stay off"
    );
}

#[test]
fn a_suspended_replay_still_listens_for_drives() {
    let folder = tempfile::tempdir().expect("a folder");
    let (trace, _) = record(folder.path(), "run", PROGRAM, Clock::Virtual, 1.0, |_| {});
    let corner = Corner::new();
    // Longer than the replay listens.
    let pause = Duration::from_millis(600);
    let refused = replay_to_drives(&trace, &corner, (false, false), 0x0237, pause);
    assert!(
        matches!(refused, Err(ReplayError::MachineIsOn { axis: 1, .. })),
        "{refused:?}"
    );
}

#[test]
fn a_replay_stops_while_listening_waiting_or_playing() {
    let folder = tempfile::tempdir().expect("a folder");
    let (trace, _) = record(folder.path(), "run", PROGRAM, Clock::Virtual, 1.0, |_| {});
    let corner = Corner::new();
    let ended = |options: &Replay, after: Duration| {
        let begun = Instant::now();
        let stop = || begun.elapsed() >= after;
        let done = replay(&trace, options, |_| ControlFlow::Continue(1), stop).expect("an end, and no error");
        (done, begun.elapsed())
    };
    // While it listens for drives.
    let (done, _) = ended(&options(&corner, Pace::Factor(1.0)), Duration::ZERO);
    assert!(done.stopped && done.setpoints == 0, "{done:?}");
    // While it waits for clients that never come: less than the ten seconds that it would wait.
    let mut wanted = options(&corner, Pace::Factor(1.0));
    wanted.wait_for_subscribers = 1;
    let (done, took) = ended(&wanted, Duration::from_secs(1));
    assert!(done.stopped && done.setpoints == 0, "{done:?}");
    assert!(took < Duration::from_secs(8), "{took:?}");
    // While it publishes, which takes hours at this speed. A listener confirms it.
    let mut wanted = options(&corner, Pace::Factor(0.001));
    wanted.wait_for_subscribers = 1;
    let (is_heard, begun) = (AtomicBool::new(false), Instant::now());
    let done = std::thread::scope(|scope| {
        scope.spawn(|| {
            let client = corner.client();
            let mut reader = client.setpoints().expect("a place");
            while reader.receive().expect("a connection").is_none() && begun.elapsed() < FOREVER {
                std::thread::sleep(Duration::from_millis(1));
            }
            is_heard.store(true, Ordering::Relaxed);
        });
        let stop = || is_heard.load(Ordering::Relaxed) || begun.elapsed() >= FOREVER;
        replay(&trace, &wanted, |_| ControlFlow::Continue(1), stop).expect("an end, and no error")
    });
    assert!(done.stopped && done.setpoints > 0, "{done:?}");
    // To its end.
    let (done, _) = ended(&options(&corner, Pace::Factor(1000.0)), FOREVER);
    assert!(!done.stopped, "{done:?}");
}
