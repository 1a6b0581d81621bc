//! Late setpoints are an error only if a client waits for them.
#![expect(clippy::expect_used, reason = "tests fail as tests do")]

use std::time::{Duration, Instant};

use evolvent_tests::{Domain, Finished, Launch, Workshop, unless_disturbed, wait};
use rustix::process::{Pid, Signal, kill_process};

/// Runs a program and suspends the process for a third of a second in the middle of it.
fn interrupted(domain: &Domain, name: &str, with_client: bool) -> Finished {
    let workshop = Workshop::new();
    let machine = workshop.mill(name, &[]);
    let child = Launch::in_real_time(&workshop.long_program(6), &machine, domain)
        .no_trace()
        .start();
    let reader = with_client.then(|| domain.client(name).setpoints().expect("setpoints"));
    until_it_moves(domain, name);
    let process = Pid::from_raw(child.id().cast_signed()).expect("a process");
    kill_process(process, Signal::STOP).expect("stopped");
    std::thread::sleep(Duration::from_millis(350));
    kill_process(process, Signal::CONT).expect("going on");
    let finished = wait(child);
    drop(reader);
    finished
}

/// Waits for cycle 400 as a client that reads the status and no setpoints.
fn until_it_moves(domain: &Domain, name: &str) {
    let bus = domain.client(name);
    let mut status = bus.status().expect("the status");
    let begin = Instant::now();
    while status
        .latest()
        .expect("the status")
        .is_none_or(|status| status.cycles < 400)
    {
        assert!(begin.elapsed() < Duration::from_secs(120), "no cycles");
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn late_setpoints_that_nobody_waits_for_are_a_note() {
    unless_disturbed(|| {
        let domain = Domain::new();
        let finished = interrupted(&domain, "late-alone", false).expect_code(&[0]);
        let summary = finished.json();
        assert!(summary["late_cycles"].as_u64() > Some(50), "{summary}");
        assert_eq!(summary["listeners"], 0);
        let notes = summary["notes"].to_string();
        assert!(
            notes.contains("published late") && notes.contains("doctor"),
            "{notes}"
        );
    });
}

#[test]
fn late_setpoints_for_a_client_end_with_code_3() {
    unless_disturbed(|| {
        let domain = Domain::new();
        let summary = interrupted(&domain, "late-read", true).expect_code(&[3]).json();
        assert!(summary["late_cycles"].as_u64() > Some(50), "{summary}");
        assert_eq!(summary["listeners"], 1);
    });
}
