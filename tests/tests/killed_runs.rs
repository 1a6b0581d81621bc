//! Runs that end early: killed at any moment, or stopped by a signal.
#![expect(clippy::expect_used, reason = "helpers of tests fail and talk as tests do")]

use std::path::Path;
use std::process::Child;
use std::thread::sleep;
use std::time::{Duration, Instant};

use evolvent_bus::{Setpoint, SetpointReader};
use evolvent_tests::{Cycle, Domain, Launch, Random, Workshop, cycles, run, unless_disturbed, wait};
use rustix::process::{Pid, Signal, kill_process};

/// Number of kills; the environment variable EVOLVENT_KILLS raises it.
const KILLS: usize = 12;
/// The state of a cycle that brakes for a stop.
const STOPPING: u8 = 4;
/// Cycles that may be missing at the end of a recovered trace, s: data not flushed yet (250 ms), data in the
/// queue and in the chunk being written; and the recorder, a thread of normal priority, may have to wait for
/// a busy processor.
const LOST_S: f64 = 0.75;

fn signal(process: &Child, signal: Signal) {
    let pid = Pid::from_child(process);
    kill_process(pid, signal).expect("a process that can be signalled");
}

/// Reads for a while, from the first setpoint on; returns the last.
fn read_for(reader: &mut SetpointReader, time: Duration) -> Setpoint {
    let (begin, mut first, mut last) = (Instant::now(), None, None);
    loop {
        while let Some(setpoint) = reader.receive().expect("the bus") {
            first.get_or_insert_with(Instant::now);
            last = Some(setpoint);
        }
        if let (Some(first), Some(last)) = (first, last)
            && first.elapsed() >= time
        {
            return last;
        }
        assert!(
            begin.elapsed() < Duration::from_secs(120),
            "the run does not begin"
        );
        sleep(Duration::from_micros(500));
    }
}

/// Every other run is killed while it starts or has just started, when there may be nothing to recover yet.
#[test]
fn a_killed_run_loses_250_ms_and_leaves_a_usable_bus() {
    unless_disturbed(|| {
        let kills = std::env::var("EVOLVENT_KILLS")
            .ok()
            .and_then(|text| text.parse().ok())
            .unwrap_or(KILLS);
        let mut random = Random::new();
        let domain = Domain::new();
        let workshop = Workshop::new();
        let (program, machine) = (workshop.long_program(60), workshop.mill("killed", &[]));
        for kill in 0..kills {
            let trace = workshop.path(&format!("{kill}.mcap"));
            let mut running = Launch::in_real_time(&program, &machine, &domain)
                .trace(&trace)
                .start();
            let last = if kill % 2 == 0 {
                let mut reader = domain.client("killed").setpoints().expect("a subscription");
                Some(read_for(
                    &mut reader,
                    Duration::from_secs_f64(random.between(0.6, 1.8)),
                ))
            } else {
                sleep(Duration::from_secs_f64(random.between(0.0, 0.2)));
                None
            };
            signal(&running, Signal::KILL);
            assert_eq!(running.wait().expect("its end").code(), None, "killed, not ended");

            let part = workshop.path(&format!("{kill}.mcap.part"));
            assert!(!trace.exists(), "a killed run has no finished trace");
            let recovery = run(["trace", "recover", "--json"]
                .map(Path::new)
                .into_iter()
                .chain([part.as_path()]));
            let Some(last) = last else {
                // Either not started, or started and recovered; both without a crash.
                let recovery = recovery.expect_code(&[0, 1, 2, 3]);
                assert_eq!(
                    recovery.code.map(|code| code == 0 || code == 3),
                    Some(trace.exists()),
                    "{}",
                    recovery.err
                );
                continue;
            };
            let recovered = recovery.expect_code(&[0, 3]).json();
            assert_eq!(recovered["gaps"], 0, "{recovered}");
            assert_eq!(recovered["has_run"], true);
            let found = cycles(&trace);
            let lost = (last.sequence + 1).saturating_sub(found.len() as u64);
            let lost_s = lost as f64 * last.period_ns as f64 * 1e-9;
            println!(
                "kill {kill}: {} cycles recovered, {} seen on the bus, {lost_s:.3} s lost",
                found.len(),
                last.sequence + 1
            );
            assert!(lost_s <= LOST_S, "{lost_s} s lost");
        }
        let (short, trace) = (workshop.short_program(), workshop.path("after.mcap"));
        Launch::in_real_time(&short, &machine, &domain)
            .trace(&trace)
            .finish()
            .expect_code(&[0, 3]);
        assert!(!cycles(&trace).is_empty());
    });
}

fn period_s(cycles: &[Cycle]) -> f64 {
    (cycles[1].due_time_ns - cycles[0].due_time_ns) as f64 * 1e-9
}

/// Maximum magnitudes of the first three differences of the positions of one axis, per s, s2 and s3.
fn extremes(cycles: &[Cycle], axis: usize) -> [f64; 3] {
    let period_s = period_s(cycles);
    let mut values: Vec<f64> = cycles.iter().map(|cycle| cycle.position[axis]).collect();
    [0; 3].map(|_| {
        values = values
            .windows(2)
            .map(|pair| (pair[1] - pair[0]) / period_s)
            .collect();
        values.iter().fold(0.0, |max: f64, value| max.max(value.abs()))
    })
}

/// The program goes to and fro along Y = X / 2 at 6000 mm/min on an X axis of 5000 mm/s2 and 200000 mm/s3.
#[test]
fn sigterm_and_sigint_stop_on_the_path_within_limits() {
    unless_disturbed(|| {
        let mut random = Random::new();
        for stop in [Signal::TERM, Signal::INT] {
            let domain = Domain::new();
            let workshop = Workshop::new();
            let (program, machine) = (workshop.long_program(60), workshop.mill("stopped", &[]));
            let trace = workshop.path("run.mcap");
            let running = Launch::in_real_time(&program, &machine, &domain)
                .trace(&trace)
                .start();
            let mut reader = domain.client("stopped").setpoints().expect("a subscription");
            read_for(&mut reader, Duration::from_secs_f64(random.between(0.5, 1.0)));
            signal(&running, stop);
            let signalled = Instant::now();
            let finished = wait(running).expect_code(&[1]);
            println!("ended {:?} after the signal", signalled.elapsed());
            let summary = finished.json();
            assert_eq!(summary["outcome"], "stopped");
            assert!(finished.err.contains("stopped"), "{}", finished.err);

            let found = cycles(&trace);
            assert_eq!(summary["cycles"], found.len());
            assert_eq!(workshop.files(), ["long.ngc", "run.mcap", "stopped.toml"]);
            let last = found.last().expect("cycles");
            assert_eq!(last.feed_mm_s, 0.0, "at rest");
            assert_eq!(last.velocity, [0.0; 9], "at rest");
            // During the motion, not at the end of the program.
            let begins = found.iter().position(|cycle| cycle.state == STOPPING);
            let stop_s = (found.len() - begins.unwrap_or(found.len())) as f64 * period_s(&found);
            assert!(stop_s < 0.3, "it stops for {stop_s} s");
            assert!(
                found.len() as f64 * period_s(&found) < 50.0,
                "the program was over"
            );
            for cycle in &found {
                let off = (cycle.position[1] - 0.5 * cycle.position[0]).abs();
                assert!(off < 1e-9, "cycle {} is {off:e} mm off the path", cycle.sequence);
            }
            let [velocity, acceleration, jerk] = extremes(&found, 0);
            assert!(velocity <= 100.0 * 1.001, "{velocity} mm/s");
            assert!(acceleration <= 5000.0 * 1.001, "{acceleration} mm/s2");
            assert!(jerk <= 200_000.0 * 1.02, "{jerk} mm/s3");
        }
    });
}
