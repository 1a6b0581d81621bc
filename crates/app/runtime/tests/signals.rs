//! Outputs and inputs of runs with the virtual clock: which output changes with which setpoint, and what M66
//! waits for. Expected values come from the setpoints' positions, not from block numbers.

#![expect(
    clippy::unwrap_used,
    clippy::panic,
    reason = "helpers of tests fail as tests do"
)]

use evolvent_random::Random;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, mpsc};
use std::time::Duration;

use evolvent_machine::{ControlRate, Machine, PlannerKind};
use evolvent_motion::{MotionState, Setpoint};
use evolvent_runtime::{
    Controls, InputScript, Job, Notice, Outcome, RunObserver, RunOutcome, Setup, SignalChange, run,
};
use evolvent_trace::{EventKind, TraceFile};

const SIGNALS: &str = r#"
[[input]]
name = "ready"
number = 2
[[input]]
name = "chain"
number = 0
[[input]]
name = "pressure"
kind = "analog"
number = 1
min = 0
max = 10

[[output]]
name = "zero"
number = 0
[[output]]
name = "one"
number = 1
on_end = "safe"
[[output]]
name = "two"
number = 2
safe_on = true
on_stop = "safe"
[[output]]
name = "power"
kind = "analog"
number = 0
min = 0
max = 100
safe_value = 5
on_hold = "safe"
"#;

struct Silent;

impl RunObserver for Silent {
    fn progress(&mut self, _: &Controls) {}
    fn notice(&mut self, _: &Notice) {}
    fn note(&mut self, _: &str) {}
}

fn setup(extra: &str, rate: Option<f64>, planner: PlannerKind) -> Setup {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/machines/mill-3axis.toml");
    let text = format!("{}{SIGNALS}{extra}", std::fs::read_to_string(&file).unwrap());
    let mut machine = Machine::parse(&text, "signals.toml").unwrap();
    machine.path.planner = planner;
    Setup::new(
        machine,
        PathBuf::from("signals.toml"),
        text,
        rate.map(ControlRate::Hz),
    )
    .unwrap()
}

/// A run, its setpoints and the changes of signals in its trace.
struct Ran {
    outcome: RunOutcome,
    setpoints: Vec<Setpoint>,
    changes: Vec<SignalChange>,
    trace: PathBuf,
    _folder: tempfile::TempDir,
}

impl Ran {
    /// The setpoints with which an output changes, and its values.
    fn output(&self, code: u32) -> Vec<(u64, f64)> {
        let changes = self.changes.iter();
        changes
            .filter(|change| change.is_output && change.code() == code)
            .map(|change| (change.sequence, change.value.unwrap()))
            .collect()
    }

    /// The first setpoint beyond a position of X at rest; nothing moves back.
    fn leaves(&self, x: f64) -> u64 {
        // A move that begins just before a setpoint has moved only 1e-14 mm in it, but accelerates.
        let beyond = |setpoint: &Setpoint| {
            let past = setpoint.position[0] - x;
            past > 1e-12 || (past > -1e-12 && setpoint.acceleration[0] > 0.0)
        };
        self.setpoints.iter().position(beyond).unwrap() as u64
    }
}

fn drive(
    program: &str,
    setup: Setup,
    inputs: &str,
    operate: impl Fn(&Controls, &Setpoint) + Send + Sync + 'static,
) -> Ran {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("part.ngc");
    std::fs::write(&file, program).unwrap();
    let trace = folder.path().join("run.mcap");
    let script = (!inputs.is_empty())
        .then(|| InputScript::parse(inputs, "inputs.toml", &setup.machine.signals).unwrap());
    let job = Job {
        trace: Some(trace.clone()),
        inputs: script,
        ..Job::new(file, setup)
    };
    let setpoints = Arc::new(Mutex::new(Vec::new()));
    let recorded = Arc::clone(&setpoints);
    let controls = Arc::new(Controls::new(1.0));
    let operated = Arc::clone(&controls);
    let (sender, receiver) = mpsc::channel();
    // On a separate thread: a run that never ends would not fail the test.
    std::thread::spawn(move || {
        let outcome = run(&job, &operated, &mut Silent, |setpoint| {
            operate(&operated, setpoint);
            recorded.lock().unwrap().push(*setpoint);
        });
        sender.send(outcome.unwrap()).unwrap();
    });
    let outcome = receiver
        .recv_timeout(Duration::from_secs(60))
        .unwrap_or_else(|_| panic!("does not end:\n{program}"));
    let mut changes = Vec::new();
    for event in TraceFile::open(&trace).unwrap().events() {
        let event = event.unwrap();
        let is_output = event.kind == EventKind::Output;
        if is_output || event.kind == EventKind::Input {
            changes.push(SignalChange {
                sequence: event.sequence,
                is_output,
                name: SignalChange::of_code(event.code),
                value: event.value,
            });
        }
    }
    let setpoints = std::mem::take(&mut *setpoints.lock().unwrap());
    Ran {
        outcome,
        setpoints,
        changes,
        trace,
        _folder: folder,
    }
}

fn done(program: &str, inputs: &str) -> Ran {
    let ran = drive(
        program,
        setup("", Some(1000.0), PlannerKind::Optimal),
        inputs,
        |_, _| {},
    );
    let summary = &ran.outcome.summary;
    assert_eq!(
        summary.outcome,
        Outcome::Done,
        "{:?} {:?}",
        summary.error,
        ran.outcome.program
    );
    ran
}

#[test]
fn synchronized_outputs_change_with_the_next_move() {
    for planner in [PlannerKind::Optimal, PlannerKind::Classic] {
        for rate in [250.0, 1000.0, 7919.0, 35_000.0] {
            let program = "G21 F3000\nM62 P0\nG61.1 G1 X3\nM62 P1\nM67 E0 Q40\nG1 X5\nM63 P0\nM67 E0 Q50\n\
                           M67 E0 Q60\nG1 X6\nM2\n";
            let ran = drive(program, setup("", Some(rate), planner), "", |_, _| {});
            assert_eq!(ran.outcome.summary.outcome, Outcome::Done);
            let (first, second, third) = (ran.leaves(0.0), ran.leaves(3.0), ran.leaves(5.0));
            let end = ran.setpoints.last().unwrap().sequence;
            assert!(first < second && second < third && third < end);
            assert_eq!(ran.output(0), [(first, 1.0), (third, 0.0)], "{planner:?} {rate}");
            assert_eq!(ran.output(1), [(second, 1.0), (end, 0.0)], "{planner:?} {rate}");
            // Of two values for one move, the last is used.
            assert_eq!(
                ran.output(64),
                [(second, 40.0), (third, 60.0)],
                "{planner:?} {rate}"
            );
        }
    }
}

#[test]
fn an_output_changes_at_its_block_without_slowing() {
    let lines: String = (1..40)
        .map(|k| format!("M6{} P0\nG1 X{}\n", 2 + (k + 1) % 2, k))
        .collect();
    let ran = done(&format!("G21 G61 F1200\n{lines}M2\n"), "");
    let changes = ran.output(0);
    assert_eq!(changes.len(), 39);
    for (k, (sequence, value)) in changes.into_iter().enumerate() {
        let before = sequence
            .checked_sub(1)
            .map_or(0.0, |before| ran.setpoints[before as usize].position[0]);
        let here = ran.setpoints[sequence as usize].position[0];
        let begins = k as f64;
        assert!(
            before <= begins + 1e-9 && begins - 1e-9 <= here && here > before,
            "{begins}: {before} {here}"
        );
        assert_eq!(value, f64::from((k + 1) % 2 == 1));
        // 20 mm/s: the motion has not slowed down.
        assert!(k == 0 || ran.setpoints[sequence as usize].feed_mm_s > 19.9, "{k}");
    }
}

#[test]
fn immediate_outputs_change_at_rest_in_program_order() {
    let ran = done(
        "G21 G64 F3000\nG1 X2\nM64 P0\nG1 X4\nM68 E0 Q7\nM65 P0\nM65 P2\nG4 P0.1\nM64 P1\nG1 X5\nM2\n",
        "",
    );
    let at = |sequence: u64| ran.setpoints[sequence as usize];
    let [(on, _), (off, _)] = ran.output(0)[..] else {
        panic!("{:?}", ran.output(0))
    };
    assert_eq!((at(on).position[0], at(off).position[0]), (2.0, 4.0));
    assert_eq!((at(on).velocity[0], at(off).velocity[0]), (0.0, 0.0));
    // Each change has its own setpoint.
    assert_eq!(ran.output(64), [(off - 1, 7.0)]);
    assert_eq!(ran.output(2), [(off + 1, 0.0)], "two is on where it is safe");
    let (one, _) = ran.output(1)[0];
    // The dwell is between them, and the move comes after both.
    let (dwell, period) = (one - off, ran.outcome.summary.period_ns);
    assert!(
        (dwell as f64 * period as f64 * 1e-9 - 0.1).abs() < 0.005,
        "{dwell}"
    );
    assert!(one < ran.leaves(4.0));
}

#[test]
fn an_output_before_no_move_does_not_change() {
    let ran = done("G21 F1000\nG1 X1\nM62 P0\nM2\n", "");
    assert_eq!(ran.output(0), []);
}

#[test]
fn waits_end_on_their_edge_or_level_and_set_5399() {
    // Each case: the word L, changes of the input, and the X that shows #5399.
    let on = |at: f64| format!("[[change]]\ninput = \"ready\"\non = true\nat_s = {at}\n");
    let off = |at: f64| format!("[[change]]\ninput = \"ready\"\non = false\nat_s = {at}\n");
    let begins = |on: bool| format!("[[change]]\ninput = \"ready\"\non = {on}\n");
    let cases = [
        ("L0", begins(true), 1.0, 0.0),
        ("L0", begins(false), 0.0, 0.0),
        ("L0", String::new(), -1.0, 0.0),
        ("L3 Q5", begins(false) + &on(1.5), 1.0, 1.5),
        ("L3 Q5", begins(true), 1.0, 0.0),
        ("L3 Q0.5", begins(false) + &on(1.5), -1.0, 0.0),
        ("L4 Q5", begins(true) + &off(1.5), 0.0, 1.5),
        ("L1 Q5", begins(true) + &off(1.0) + &on(1.5), 1.0, 1.5),
        ("L2 Q5", begins(false) + &on(1.0) + &off(1.5), 0.0, 1.5),
        // A pulse within one setpoint is an edge.
        ("L1 Q5", begins(false) + &on(1.5) + &off(1.5), 1.0, 1.5),
        // High from the beginning is not a rising edge.
        ("L1 Q0.5", begins(true), -1.0, 0.0),
        ("L3 Q0.5", String::new(), -1.0, 0.0),
    ];
    for (word, inputs, result, seconds) in cases {
        let program = format!(
            "G21 F3000\nG1 X10\nM66 P2 {word}\nG1 X[20 + #5399]\nO100 if [#5399 LT 0]\nG1 Y3\nO100 endif\n\
             M2\n"
        );
        let ran = done(&program, &inputs);
        let last = ran.setpoints.last().unwrap().position;
        assert_eq!(last[0], 20.0 + result, "{word} {inputs}");
        assert_eq!(last[1], if result < 0.0 { 3.0 } else { 0.0 }, "{word} {inputs}");
        if seconds > 0.0 {
            let at = ran.leaves(10.0) as f64 * 1e-3;
            assert!((seconds..seconds + 0.01).contains(&at), "{word}: {at} s");
        }
    }
}

#[test]
fn analog_inputs_are_read_and_consecutive_waits_work() {
    let inputs = "[[change]]\ninput = \"pressure\"\nvalue = 2.5\n[[change]]\ninput = \"pressure\"\n\
                  value = 7.25\nat_s = 0.3\n[[change]]\ninput = \"ready\"\non = true\nat_s = 1\n[[change]]\n\
                  input = \"ready\"\non = false\nat_s = 1.2\n";
    let program = "G21 F3000\nM66 E1 L0\nG1 X#5399\nG4 P0.5\nM66 E1 L0\nG1 Y#5399\nM66 P2 L3 Q9\n\
                   M66 P2 L4 Q9\nM64 P0\nM66 P2 L0\nG1 Z[#5399 - 2]\nM2\n";
    let ran = done(program, inputs);
    let last = ran.setpoints.last().unwrap().position;
    assert_eq!([last[0], last[1], last[2]], [2.5, 7.25, -2.0]);
    let (on, _) = ran.output(0)[0];
    assert!((1200..1210).contains(&on), "{on}");
}

#[test]
fn a_run_with_signals_repeats_with_either_planner() {
    let inputs = "[[change]]\ninput = \"ready\"\non = true\nat_path_mm = 5\n[[change]]\ninput = \"ready\"\n\
                  on = false\nat_line = 6\n";
    let program =
        "G21 F3000\nM62 P0\nG1 X10\nM66 P2 L3 Q5\nM63 P0\nG1 X20 Y5\nM66 P2 L4 Q5\nM64 P1\nG1 X0\nM2\n";
    for planner in [PlannerKind::Optimal, PlannerKind::Classic] {
        let once = drive(program, setup("", Some(2000.0), planner), inputs, |_, _| {});
        let again = drive(program, setup("", Some(2000.0), planner), inputs, |_, _| {});
        assert_eq!(once.outcome.summary.outcome, Outcome::Done);
        assert_eq!(once.changes, again.changes);
        assert!(once.setpoints == again.setpoints, "{planner:?}");
    }
}

#[test]
fn outputs_keep_their_rules_in_holds_stops_and_at_end() {
    let program = "G21 F3000\nM64 P0\nM64 P1\nM65 P2\nM68 E0 Q50\nG1 X100\nM2\n";
    let hold = |controls: &Controls, setpoint: &Setpoint| {
        if setpoint.path_mm > 20.0 && setpoint.state == MotionState::Running {
            controls.set_hold(true);
        }
        if setpoint.state == MotionState::Held && setpoint.sequence.is_multiple_of(50) {
            controls.set_hold(false);
            controls.set_override(0.999);
        }
    };
    // After one hold, the continued run is not held again.
    let held_once = Arc::new(std::sync::atomic::AtomicBool::new(false));
    let once = Arc::clone(&held_once);
    let ran = drive(
        program,
        setup("", Some(1000.0), PlannerKind::Optimal),
        "",
        move |controls, setpoint| {
            if !once.load(std::sync::atomic::Ordering::Relaxed) {
                hold(controls, setpoint);
                if setpoint.state == MotionState::Held && setpoint.sequence.is_multiple_of(50) {
                    once.store(true, std::sync::atomic::Ordering::Relaxed);
                }
            }
        },
    );
    let held: Vec<u64> = ran
        .setpoints
        .iter()
        .filter(|setpoint| setpoint.state == MotionState::Held)
        .map(|setpoint| setpoint.sequence)
        .collect();
    let (first, last) = (held[0], *held.last().unwrap());
    let power = ran.output(64);
    assert_eq!(power[1..], [(first, 5.0), (last + 1, 50.0)], "safe while held");
    let end = ran.setpoints.last().unwrap().sequence;
    assert_eq!(ran.output(1).last(), Some(&(end, 0.0)), "safe at the end");
    assert_eq!(ran.output(0).len(), 1, "kept");
    assert_eq!(ran.output(2).len(), 1, "kept at the end");

    let ran = drive(
        program,
        setup("", Some(1000.0), PlannerKind::Optimal),
        "",
        |controls, setpoint| {
            if setpoint.path_mm > 20.0 {
                controls.stop();
            }
        },
    );
    assert_eq!(ran.outcome.summary.outcome, Outcome::Stopped);
    let end = ran.setpoints.last().unwrap().sequence;
    assert_eq!(ran.output(2).last(), Some(&(end, 1.0)), "safe after a stop");
    assert_eq!(
        (ran.output(0).len(), ran.output(1).len(), ran.output(64).len()),
        (1, 1, 1),
        "kept"
    );
}

#[test]
fn an_open_chain_stops_and_makes_every_output_safe() {
    let estop = "[estop]\ninput = \"chain\"\n";
    let program = "G21 F3000\nM64 P0\nM65 P2\nM68 E0 Q50\nG1 X100\nM2\n";
    for (change, at) in [("on = false", 0.5), ("unknown = true", 0.5)] {
        let inputs = format!("[[change]]\ninput = \"chain\"\n{change}\nat_s = {at}\n");
        let ran = drive(
            program,
            setup(estop, Some(1000.0), PlannerKind::Optimal),
            &inputs,
            |_, _| {},
        );
        assert_eq!(ran.outcome.summary.alarm, Some(430), "{:?}", ran.outcome.summary);
        let last = ran.setpoints.last().unwrap();
        assert!(
            last.position[0] < 50.0 && last.state == MotionState::Stopped,
            "{last:?}"
        );
        for (code, safe) in [(0, 0.0), (2, 1.0), (64, 5.0)] {
            assert_eq!(
                ran.output(code).last(),
                Some(&(500, safe)),
                "at once, while the axes still move"
            );
        }
        assert!(ran.setpoints[501].velocity[0] > 0.0);
    }
    // Without a file the chain is closed, because there is no machine.
    let ran = drive(
        program,
        setup(estop, Some(1000.0), PlannerKind::Optimal),
        "",
        |_, _| {},
    );
    assert_eq!(ran.outcome.summary.outcome, Outcome::Done);
}

#[test]
fn missing_signals_are_an_error_before_motion() {
    for (line, part) in [
        ("M62 P7", "no digital output 7"),
        ("M65 P63", "no digital output 63"),
        ("M67 E3 Q1", "no analog output 3"),
        ("M68 E0 Q101", "power takes 0 to 100"),
        ("M66 P9 L0", "no digital input 9"),
        ("M66 E0 L0", "no analog input 0"),
    ] {
        let program = format!("G21 F1000\nG1 X1\n{line}\nG1 X2\nM2\n");
        let ran = drive(
            &program,
            setup("", Some(1000.0), PlannerKind::Optimal),
            "",
            |_, _| {},
        );
        let message = ran.outcome.program.unwrap_err().to_string();
        assert!(
            message.contains(part) && message.contains("machine file"),
            "{message}"
        );
        assert_eq!(ran.setpoints.last().unwrap().position[0], 1.0);
    }
}

#[test]
fn a_trace_is_left() {
    let ran = done("G21 F1000\nM64 P0\nG1 X1\nM2\n", "");
    assert!(ran.trace.is_file());
}

/// Moves along X, each farther than the one before, with outputs set in between. Returns the program and, for
/// each synchronized change of an output, the X at which its move begins, its number in the trace and its
/// value. These follow from the rules of the language alone, not from the core.
fn random_program(random: &mut Random) -> (String, Vec<(f64, u32, f64)>) {
    let mode = ["G61", "G61.1", "G64 P0.01", "G64"][random.below(4)];
    let mut text = format!("G21 {mode} F{}\n", 300 + random.below(6000));
    let (mut x, mut expected) = (0.0_f64, Vec::new());
    // The initial values, which are safe: only a different value is a change.
    let mut state = [0.0, 0.0, 1.0, 5.0];
    for _ in 0..3 + random.below(12) {
        let mut pending: [Option<f64>; 4] = [None; 4];
        for _ in 0..random.below(5) {
            match random.below(8) {
                0..=3 => {
                    let (number, on) = (random.below(3), random.below(2));
                    text += &format!("M{} P{number}\n", 63 - on);
                    pending[number] = Some(on as f64);
                }
                4 | 5 => {
                    let value = random.below(100);
                    text += &format!("M67 E0 Q{value}\n");
                    pending[3] = Some(value as f64);
                }
                6 => text += "M3 S100\n",
                _ => text += "G4 P0.003\n",
            }
        }
        for (index, value) in pending.into_iter().enumerate() {
            if let Some(value) = value.filter(|value| *value != state[index]) {
                state[index] = value;
                expected.push((x, if index == 3 { 64 } else { index as u32 }, value));
            }
        }
        x += (1 + random.below(40)) as f64 * 0.1;
        let rapid = random.below(6) == 0;
        text += &format!("G{} X{x:.1}\n", u8::from(!rapid));
    }
    (text + "M2\n", expected)
}

#[test]
fn random_synchronized_outputs_change_with_their_move() {
    let (mut changes, mut runs) = (0, 0);
    for seed in 1..=40_u64 {
        let mut random = Random::mixed(seed);
        let (program, expected) = random_program(&mut random);
        let rate = [250.0, 1000.0, 3333.0, 8000.0, 35_000.0][random.below(5)];
        let planner = [PlannerKind::Optimal, PlannerKind::Classic][random.below(2)];
        // A hold in between changes nothing.
        let hold_at = random.below(1500) as u64;
        let operate = move |controls: &Controls, setpoint: &Setpoint| {
            controls.set_hold((hold_at..hold_at + 40).contains(&setpoint.sequence));
            controls.set_override(if setpoint.sequence > hold_at / 2 { 0.7 } else { 1.0 });
        };
        let ran = drive(&program, setup("", Some(rate), planner), "", operate);
        assert_eq!(
            ran.outcome.summary.outcome,
            Outcome::Done,
            "seed {seed}:\n{program}"
        );
        let end = ran.setpoints.last().unwrap().sequence;
        for (x, code, value) in expected {
            // A blend begins and ends beside the programmed corner, on a straight line at the same path
            // length.
            let wanted = ran.leaves(x + 1e-9);
            let first = ran.leaves(x);
            let found = ran.output(code);
            let is_there = found
                .iter()
                .any(|&(at, to)| to == value && (first..=wanted).contains(&at) && at < end);
            assert!(
                is_there,
                "seed {seed}, {rate} Hz, {planner:?}: {code} to {value} at {x}, setpoint {wanted}: \
                 {found:?}\n{program}"
            );
            changes += 1;
        }
        runs += 1;
    }
    assert!(
        runs == 40 && changes > 200,
        "{changes} changes in {runs} runs prove little"
    );
}

const PROBE: &str = "[probe]\n";
const PROBING: &str = "G21\nG38.2 Z-10 F600\nG1 X[0-#5063] F600\nG1 Y#5070\nM2\n";

fn probes(program: &str, inputs: &str, planner: PlannerKind, rate: f64) -> Ran {
    drive(program, setup(PROBE, Some(rate), planner), inputs, |_, _| {})
}

#[test]
fn a_program_continues_from_the_probe_contact() {
    for planner in [PlannerKind::Optimal, PlannerKind::Classic] {
        for rate in [250.0, 1000.0, 35_000.0] {
            let trip = "[[change]]\ninput = \"probe\"\non = true\nat_s = 0.5\n";
            let ran = probes(PROBING, trip, planner, rate);
            let context = format!("{planner:?} {rate} {:?}", ran.outcome.program);
            assert_eq!(ran.outcome.summary.outcome, Outcome::Done, "{context}");
            let period_s = (1e9 / rate).round() * 1e-9;
            let before = |setpoint: &&Setpoint| (setpoint.sequence as f64) * period_s < 0.5;
            let contact = ran.setpoints.iter().rfind(before).unwrap().position;
            assert!((-5.0..-4.0).contains(&contact[2]), "{context}: {}", contact[2]);
            let last = ran.setpoints.last().unwrap();
            // The program's X is the Z that the probe reported, and Y shows that there was contact.
            assert!(
                (last.position[0] + contact[2]).abs() < 1e-9,
                "{context}: {} {}",
                last.position[0],
                contact[2]
            );
            assert_eq!(last.position[1], 1.0, "{context}");
            assert!(
                last.position[2] < contact[2] && last.position[2] > contact[2] - 1.0,
                "{context}"
            );
        }
    }
}

#[test]
fn g38_2_without_contact_is_an_error_with_its_line() {
    let open = "[[change]]\ninput = \"probe\"\non = false\n";
    let ran = probes(PROBING, open, PlannerKind::Optimal, 1000.0);
    assert_eq!(ran.outcome.summary.outcome, Outcome::Failed);
    let error = ran.outcome.program.unwrap_err().to_string();
    assert!(
        error.contains(":2:") && error.contains("without contact"),
        "{error}"
    );
    let ran = probes(
        &PROBING.replace("G38.2", "G38.3"),
        open,
        PlannerKind::Optimal,
        1000.0,
    );
    assert_eq!(ran.outcome.summary.outcome, Outcome::Done);
    let last = ran.setpoints.last().unwrap().position;
    assert_eq!((last[0], last[1], last[2]), (10.0, 0.0, -10.0));
    // Tripped before the move: nothing moves.
    let tripped = "[[change]]\ninput = \"probe\"\non = true\n";
    let ran = probes(PROBING, tripped, PlannerKind::Optimal, 1000.0);
    let error = ran.outcome.program.unwrap_err().to_string();
    assert!(error.contains("tripped before"), "{error}");
    assert!(ran.setpoints.iter().all(|setpoint| setpoint.position[2] == 0.0));
}

#[test]
fn an_unknown_probe_does_not_end_the_move() {
    let ran = probes(PROBING, "", PlannerKind::Optimal, 1000.0);
    assert_eq!(
        ran.outcome.summary.outcome,
        Outcome::Done,
        "{:?}",
        ran.outcome.program
    );
    assert_eq!(ran.setpoints.last().unwrap().position[2], -10.0);
}
