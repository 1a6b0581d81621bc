//! Outputs and inputs of a run in real time, with a bridge on the bus that is independent of the core.

#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::{Duration, Instant};

use evolvent_bus::{ClientBus, ClientConfig, MachineInputs, MachineOutputs, remove_private_domain};
use evolvent_disturbance::unless_disturbed;
use evolvent_machine::{ControlRate, Machine};
use evolvent_motion::MotionState;
use evolvent_runtime::{
    Clock, Controls, Job, MonotonicClock, Notice, Outcome, RunObserver, RunOutcome, Setup, StartError, run,
};

const SIGNALS: &str = "
[[input]]
name = \"chain\"
number = 5
[[input]]
name = \"ready\"
number = 2
[[output]]
name = \"clamp\"
number = 0
safe_on = true
[[output]]
name = \"laser\"
kind = \"analog\"
number = 3
[estop]
input = \"chain\"
";

struct Silent;

impl RunObserver for Silent {
    fn progress(&mut self, _: &Controls) {}
    fn notice(&mut self, _: &Notice) {}
    fn note(&mut self, _: &str) {}
}

/// A separate prefix, removed at the end.
struct Prefix(String);

impl Prefix {
    fn new() -> Self {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        Self(format!("evsig{}-{number}-", std::process::id()))
    }
}

impl Drop for Prefix {
    fn drop(&mut self) {
        let _removed = remove_private_domain(&self.0);
    }
}

/// Messages that a bridge has received.
#[derive(Default)]
struct Received {
    outputs: Vec<MachineOutputs>,
    /// The first setpoint that differs from the start.
    begins: Option<u64>,
    last: Option<evolvent_bus::Setpoint>,
}

/// A bridge that sends its inputs every 5 ms; `inputs` computes them from the outputs in force and the last
/// setpoint.
fn bridge(
    prefix: &str,
    over: &AtomicBool,
    mut inputs: impl FnMut(&Received) -> Option<MachineInputs>,
) -> Received {
    let client = ClientBus::open(&ClientConfig {
        prefix: Some(prefix.to_owned()),
        wait: Duration::from_secs(30),
        ..ClientConfig::new("mill-3axis")
    })
    .unwrap();
    let mut setpoints = client.bridge_setpoints().unwrap();
    let mut outputs = client.outputs().unwrap();
    let mut sender = client.input_sender().unwrap();
    let (mut received, mut sequence) = (Received::default(), 0);
    while !over.load(Ordering::Acquire) {
        while let Ok(Some(setpoint)) = setpoints.receive() {
            if setpoint.position[0] > 0.0 {
                received.begins.get_or_insert(setpoint.sequence);
            }
            received.last = Some(setpoint);
        }
        while let Ok(Some(message)) = outputs.receive() {
            received.outputs.push(message);
        }
        if let Some(message) = inputs(&received) {
            sequence += 1;
            let message = MachineInputs {
                sequence,
                instance: 77,
                time_ns: MonotonicClock::now_ns(),
                ..message
            };
            sender.send(&message).unwrap();
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    received
}

fn read(chain: bool, ready: bool) -> MachineInputs {
    MachineInputs {
        digital_mask: 1 << 5 | 1 << 2,
        digital: u64::from(chain) << 5 | u64::from(ready) << 2,
        ..MachineInputs::default()
    }
}

fn drive(
    program: &str,
    inputs: impl FnMut(&Received) -> Option<MachineInputs> + Send,
) -> (Result<RunOutcome, StartError>, Received, Duration) {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/machines/mill-3axis.toml");
    let text = std::fs::read_to_string(&file).unwrap();
    let text = format!("{text}{SIGNALS}").replace("# max_late_cycles = 1000", "max_late_cycles = 0");
    let machine = Machine::parse(&text, "signals.toml").unwrap();
    let setup = Setup::new(
        machine,
        PathBuf::from("signals.toml"),
        text,
        Some(ControlRate::Hz(1000.0)),
    );
    let folder = tempfile::tempdir().unwrap();
    let part = folder.path().join("part.ngc");
    std::fs::write(&part, program).unwrap();
    let prefix = Prefix::new();
    let job = Job {
        clock: Clock::Realtime,
        bus: true,
        bus_prefix: Some(prefix.0.clone()),
        wait_for_subscribers: 1,
        ..Job::new(part, setup.unwrap())
    };
    let over = AtomicBool::new(false);
    let controls = Arc::new(Controls::new(1.0));
    let begun = Instant::now();
    let (outcome, received) = std::thread::scope(|scope| {
        let there = scope.spawn(|| bridge(&prefix.0, &over, inputs));
        let outcome = run(&job, &controls, &mut Silent, |_| {});
        over.store(true, Ordering::Release);
        (outcome, there.join().unwrap())
    });
    (outcome, received, begun.elapsed())
}

#[test]
fn the_bus_carries_outputs_with_setpoints_and_inputs() {
    unless_disturbed(|| {
        let program =
            "G21 F3000\nM63 P0\nM67 E3 Q2.5\nG1 X5\nM66 P2 L3 Q20\nM64 P0\nG1 X[10 + #5399]\nG4 P0.5\nM2\n";
        let mut off_since = None;
        let (outcome, received, _) = drive(program, move |received| {
            // The input follows the output 0.3 s later.
            let off = received
                .outputs
                .last()
                .is_some_and(|outputs| outputs.digital & 1 == 0);
            if off && off_since.is_none() {
                off_since = Some(Instant::now());
            }
            let ready = off_since.is_some_and(|since| since.elapsed() > Duration::from_millis(300));
            Some(read(true, ready))
        });
        let outcome = outcome.unwrap();
        assert_eq!(outcome.summary.outcome, Outcome::Done, "{:?}", outcome.summary);
        assert_eq!(outcome.summary.end_position[0], 11.0, "the input was on");
        let changed = received
            .outputs
            .iter()
            .find(|message| message.digital & 1 == 0)
            .unwrap();
        assert_eq!((Some(changed.cycle), changed.analog[3]), (received.begins, 2.5));
        let last = received.outputs.last().unwrap();
        assert_eq!(
            (last.digital & 1, last.digital_mask, last.analog_mask),
            (1, 1, 1 << 3)
        );
        assert_eq!((last.safe_digital, last.safe_analog[3]), (1, 0.0));
        assert!(last.cycle > changed.cycle && last.due_time_ns > changed.due_time_ns);
        let first = &received.outputs[0];
        assert_eq!((first.digital, first.analog[3]), (1, 0.0), "safe at the start");
    });
}

#[test]
fn an_open_chain_or_a_silent_bridge_stops_the_run() {
    unless_disturbed(|| {
        for silent in [false, true] {
            let program = "G21 F3000\nM63 P0\nM67 E3 Q9\nG1 X300\nM2\n";
            let (outcome, received, _) = drive(program, move |received| {
                let far = received.last.is_some_and(|last| last.position[0] > 20.0);
                (!far || !silent).then(|| read(!far, false))
            });
            let outcome = outcome.unwrap();
            assert_eq!(outcome.summary.alarm, Some(430), "{:?}", outcome.summary);
            assert!(outcome.summary.end_position[0] < 150.0, "{:?}", outcome.summary);
            let last = received.outputs.last().unwrap();
            assert_eq!((last.digital & 1, last.analog[3]), (1, 0.0), "safe");
            // The bridge may have ended before the last setpoint.
            let stops = [MotionState::Stopping as u32, MotionState::Stopped as u32];
            assert!(stops.contains(&received.last.unwrap().state));
        }
    });
}

#[test]
fn a_run_does_not_begin_with_an_open_chain() {
    unless_disturbed(|| {
        let (outcome, received, took) = drive("G21 F3000\nG1 X5\nM2\n", |_| Some(read(false, false)));
        match outcome {
            Err(StartError::ChainOpen) => {}
            other => panic!("{other:?}"),
        }
        assert!(
            received.last.is_none() && took < Duration::from_secs(60),
            "nothing has moved"
        );
    });
}
