//! A program of any length runs in bounded memory.
#![expect(clippy::expect_used, reason = "helpers of tests fail and talk as tests do")]

use std::fmt::Write as _;
use std::fs;
use std::process::Child;
use std::time::Duration;

use evolvent_tests::{Launch, Workshop, unless_disturbed, wait};

/// Lines of the shorter and the longer program.
const LINES: [u64; 2] = [20_000, 200_000];
/// Maximum resident memory of a run, kB.
const MAX_KB: u64 = 200_000;
/// Maximum increase for ten times the lines, kB: memory that the allocator does not reuse, nothing that
/// grows.
const GROWTH_KB: u64 = 20_000;

/// Short lines to and fro along a wave.
fn wave(lines: u64) -> String {
    let mut text = "G21 G90 G94 G64 P0.01 F6000\n".to_owned();
    for line in 0..lines {
        // To and fro over 200 mm in steps of 0.1 mm.
        let step = line % 4000;
        let x = if step < 2000 { step } else { 4000 - step } as f64 * 0.1;
        let y = (x * 0.3).sin() * 5.0;
        writeln!(text, "G1 X{x:.4} Y{y:.4}").expect("text");
    }
    text + "M2\n"
}

/// Waits for the end of a process; returns the maximum resident memory, kB.
fn watch_memory(process: &mut Child) -> u64 {
    let status = format!("/proc/{}/status", process.id());
    let mut max_kb = 0;
    while process.try_wait().expect("a process").is_none() {
        let text = fs::read_to_string(&status).unwrap_or_default();
        let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        let kilobytes = line.and_then(|line| line.trim().strip_suffix("kB")?.trim().parse().ok());
        max_kb = max_kb.max(kilobytes.unwrap_or(0));
        std::thread::sleep(Duration::from_millis(2));
    }
    max_kb
}

#[test]
fn memory_does_not_grow_with_the_length_of_a_program() {
    unless_disturbed(|| {
        let workshop = Workshop::new();
        let machine = workshop.mill("long", &[]);
        let peaks = LINES.map(|lines| {
            let program = workshop.write("wave.ngc", wave(lines));
            let mut running = Launch::in_virtual_time(&program, &machine).no_trace().start();
            let peak = watch_memory(&mut running);
            let summary = wait(running).expect_code(&[0]).json();
            println!("{lines} lines: {peak} kB, {} cycles", summary["cycles"]);
            assert_eq!(summary["outcome"], "done");
            // A line whose target is the present position causes no motion.
            assert!(
                summary["moves"].as_u64().expect("a count") >= lines - lines / 4000 - 1,
                "{summary}"
            );
            peak
        });
        assert!(peaks[0] > 1000, "measured: {peaks:?}");
        assert!(peaks[1] <= MAX_KB, "{} kB", peaks[1]);
        assert!(
            peaks[1] <= peaks[0] + GROWTH_KB,
            "{peaks:?} kB: memory grows with the program"
        );
    });
}
