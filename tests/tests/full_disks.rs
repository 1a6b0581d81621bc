//! A full disk ends in a clear error and a readable file, while motion continues or stops, as configured. The
//! file size limit of the shell stands in for a full disk.
#![expect(clippy::print_stdout, reason = "helpers of tests fail and talk as tests do")]

use std::path::Path;

use evolvent_tests::{Cycle, Finished, Launch, Workshop, cycles, repository, run};

/// Files of at most 1 MB, without the signal that the system would send first.
const SMALL_DISK: &str = "trap '' XFSZ; ulimit -f 1024";

fn run_on_small_disk(workshop: &Workshop, on_full: &str) -> (Finished, Vec<Cycle>) {
    let rule = format!("on_full = {on_full:?}");
    let machine = workshop.mill("small", &[("on_full = \"continue\"", &rule)]);
    let program = repository().join("tests/programs/bore-200.ngc");
    let trace = workshop.path("run.mcap");
    let finished = Launch::in_virtual_time(&program, &machine)
        .trace(&trace)
        .finish_after(SMALL_DISK);
    println!("{:?} {}\n{:?}", finished.code, finished.err, workshop.files());
    // The recording has one of two names; a truncated one can be recovered.
    let part = workshop.path("run.mcap.part");
    if !trace.exists() {
        let recovery = run(["trace", "recover"].map(Path::new).into_iter().chain([
            part.as_path(),
            Path::new("-o"),
            &trace,
        ]));
        recovery.expect_code(&[0, 3]);
    }
    let found = cycles(&trace);
    assert!(found.len() > 1000, "only {} cycles", found.len());
    (finished, found)
}

#[test]
fn motion_continues_on_a_full_disk_if_configured() {
    let workshop = Workshop::new();
    let (finished, recorded) = run_on_small_disk(&workshop, "continue");
    let finished = finished.expect_code(&[3]);
    let summary = finished.json();
    assert_eq!(summary["outcome"], "done");
    let total = summary["cycles"].as_u64().expect("a count");
    let height = summary["end_position"][2].as_f64().expect("a number");
    assert!(
        (height - 5.0).abs() < 1e-9,
        "the program ends at Z5, not Z{height}"
    );
    assert!(total > recorded.len() as u64);
    assert!(
        finished.err.contains("run.mcap"),
        "the file is named: {}",
        finished.err
    );
}

#[test]
fn motion_stops_on_a_full_disk_if_configured() {
    let workshop = Workshop::new();
    let (finished, recorded) = run_on_small_disk(&workshop, "stop");
    let finished = finished.expect_code(&[1]);
    let summary = finished.json();
    assert_eq!(summary["outcome"], "stopped");
    assert!(summary["cycles"].as_u64().expect("a count") >= recorded.len() as u64);
    let height = summary["end_position"][2].as_f64().expect("a number");
    assert!(height < 0.0, "stopped while it cuts, not at Z{height}");
    assert!(
        finished.err.contains("run.mcap"),
        "the file is named: {}",
        finished.err
    );
}
