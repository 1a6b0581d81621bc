//! Inputs and outputs of a recorded run are recomputed exactly.
#![allow(clippy::expect_used, clippy::panic, reason = "tests fail as tests do")]

use std::path::{Path, PathBuf};
use std::sync::Arc;

use evolvent_machine::{ControlRate, Machine};
use evolvent_replay::verify;
use evolvent_runtime::{Clock, Controls, InputScript, Job, Notice, RunObserver, Setup, run};
use evolvent_trace::{EventKind, TraceFile};

use crate::common::{altered, machine_file};

const SIGNALS: &str = "
[[input]]
name = \"ready\"
number = 2
[[output]]
name = \"clamp\"
number = 0
[[output]]
name = \"laser\"
kind = \"analog\"
number = 1
on_hold = \"safe\"
";

const PROGRAM: &str = "G21 G64 P0.02 F3000\nM62 P0\nG1 X10\nM67 E1 Q3\nG1 X20 Y5\nM66 P2 L3 Q5\n\
                       O1 if [#5399 EQ 1]\nM63 P0\nG1 X30\nO1 endif\nM64 P0\nM68 E1 Q1\nM66 P2 L2 Q0.3\n\
                       G1 X[30 + #5399]\nM2\n";

const INPUTS: &str =
    "[[change]]\ninput = \"ready\"\non = false\n[[change]]\ninput = \"ready\"\non = true\nat_s = 1\n";

struct Silent;

impl RunObserver for Silent {
    fn progress(&mut self, _: &Controls) {}
    fn notice(&mut self, _: &Notice) {}
    fn note(&mut self, _: &str) {}
}

fn record(folder: &Path, name: &str, clock: Clock) -> PathBuf {
    let text = std::fs::read_to_string(machine_file()).expect("the shipped mill");
    let text = format!("{text}{SIGNALS}").replace("# max_late_cycles = 1000", "max_late_cycles = 0");
    let machine = Machine::parse(&text, "signals.toml").expect("a machine");
    let inputs = InputScript::parse(INPUTS, "inputs.toml", &machine.signals).expect("inputs");
    let setup = Setup::new(
        machine,
        PathBuf::from("signals.toml"),
        text,
        Some(ControlRate::Hz(1000.0)),
    );
    let program = folder.join(format!("{name}.ngc"));
    std::fs::write(&program, PROGRAM).expect("a program");
    let trace = folder.join(format!("{name}.mcap"));
    let job = Job {
        clock,
        feed_override: 0.9,
        trace: Some(trace.clone()),
        inputs: Some(inputs),
        ..Job::new(program, setup.expect("a rate"))
    };
    let controls = Arc::new(Controls::new(0.9));
    let operated = Arc::clone(&controls);
    run(&job, &controls, &mut Silent, move |setpoint| {
        // A hold in motion, and one in the first wait.
        let hold = [80..180, 600..1200]
            .iter()
            .any(|span| span.contains(&setpoint.sequence));
        operated.set_hold(hold);
    })
    .expect("a run");
    trace
}

#[test]
fn a_run_with_signals_recomputes_with_either_clock() {
    let folder = tempfile::tempdir().expect("a folder");
    for (name, clock) in [("virtual", Clock::Virtual), ("real", Clock::Realtime)] {
        let trace = record(folder.path(), name, clock);
        let events = TraceFile::open(&trace)
            .expect("a trace")
            .events()
            .filter(|event| {
                let kind = event.as_ref().expect("an event").kind;
                matches!(kind, EventKind::Input | EventKind::Output)
            })
            .count();
        assert!(events >= 8, "{events} changes prove little");
        let verified = verify(&trace).expect("a readable trace");
        assert!(verified.holds() && verified.recomputed, "{name}: {verified:#?}");
        assert_eq!(verified.compared, verified.cycles, "{name}");
    }
}

#[test]
fn a_trace_without_its_signals_differs_and_ends() {
    let folder = tempfile::tempdir().expect("a folder");
    let trace = record(folder.path(), "whole", Clock::Virtual);
    let bare = altered(&trace, "bare", |_| {}, |_| true);
    let verified = verify(&bare).expect("a readable trace");
    assert!(!verified.holds(), "{verified:#?}");
    let first = verified.first_difference.expect("a difference");
    assert!(first.quantity.contains("clamp"), "{first:?}");
}
