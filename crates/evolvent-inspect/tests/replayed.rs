//! A replay is a core to whoever listens, and never moves drives that are on.
#![allow(
    clippy::expect_used,
    clippy::print_stdout,
    reason = "tests fail and talk as tests do"
)]

mod common;

use std::ops::ControlFlow;
use std::path::Path;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc;
use std::time::{Duration, Instant};

use common::{PROGRAM, cycles, record};
use evolvent_bus::{BusConfig, ClientBus, ClientConfig, CoreBus, Feedback, Setpoint, remove_private_domain};
use evolvent_daemon::Clock;
use evolvent_inspect::{Pace, Replay, ReplayError, Selection, replay};

/// A corner of shared memory of its own.
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
            wait: Duration::from_secs(20),
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

/// Listens from before the first setpoint to the last.
fn listen(corner: &Corner, ready: &mpsc::Sender<()>) -> Vec<Setpoint> {
    let client = corner.client();
    let mut reader = client.setpoints().expect("a place");
    ready.send(()).expect("somebody waits");
    let mut found = Vec::new();
    let end = Instant::now() + Duration::from_secs(30);
    while Instant::now() < end {
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
    assert_eq!(reader.lost(), 0, "setpoints were lost on the way");
    found
}

fn replay_to_listener(
    trace: &Path,
    corner: &Corner,
    options: &Replay,
) -> (Vec<Setpoint>, evolvent_inspect::Replayed) {
    std::thread::scope(|scope| {
        let (ready, _waiting) = mpsc::channel();
        let listener = scope.spawn(move || listen(corner, &ready));
        let done = replay(trace, options, |_| ControlFlow::Continue(7), || false).expect("a replay");
        (listener.join().expect("a listener"), done)
    })
}

#[test]
fn a_listener_sees_the_recorded_setpoints_bit_for_bit_and_in_their_time() {
    let folder = tempfile::tempdir().expect("a folder");
    let (trace, _) = record(folder.path(), "run", PROGRAM, Clock::Virtual, 1.0, |_| {});
    let all = cycles(&trace);
    let corner = Corner::new();
    let mut wanted = options(&corner, Pace::Factor(4.0));
    wanted.wait_for_subscribers = 1;
    let (found, done) = replay_to_listener(&trace, &corner, &wanted);
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
    let mut asked = Vec::new();
    let done = replay(
        &trace,
        &wanted,
        |record| {
            asked.push((record.sequence, record.line));
            if asked.len() == 4 {
                ControlFlow::Break(())
            } else {
                ControlFlow::Continue(10)
            }
        },
        || false,
    )
    .expect("a replay");
    assert_eq!(done.setpoints, 30);
    assert_eq!(asked[0].1, 6, "from the line on");
    assert_eq!(asked[1].0, asked[0].0 + 10);
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

#[test]
fn drives_that_are_on_are_moved_only_if_it_is_said_twice() {
    let folder = tempfile::tempdir().expect("a folder");
    let (trace, _) = record(folder.path(), "run", PROGRAM, Clock::Virtual, 1.0, |_| {});
    let corner = Corner::new();
    let attempt = |force: bool, machine_is_on: bool, status_word: u32| {
        let over = std::sync::atomic::AtomicBool::new(false);
        std::thread::scope(|scope| {
            let (over, corner) = (&over, &corner);
            // A bridge that answers, whatever it hears.
            scope.spawn(move || {
                // The core may have gone before the bridge has found it.
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
                while !over.load(Ordering::Relaxed) {
                    let mut feedback = Feedback::default();
                    feedback.status_word[1] = status_word;
                    let _ = sender.send(&feedback);
                    std::thread::sleep(Duration::from_millis(5));
                }
            });
            let mut wanted = options(corner, Pace::Factor(1000.0));
            (wanted.force, wanted.machine_is_on) = (force, machine_is_on);
            let result = replay(&trace, &wanted, |_| ControlFlow::Continue(1), || false);
            over.store(true, Ordering::Relaxed);
            result
        })
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
