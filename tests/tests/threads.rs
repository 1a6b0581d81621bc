//! Threads with a simulated spindle: phase according to its encoder, holds, faults, taps, and rejected
//! threads.
#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use std::path::{Path, PathBuf};

use evolvent_tests::{
    Cycle, Domain, Drives, Finished, Launch, Operator, Served, Workshop, angles, cycles, evolvent, phases,
    unless_disturbed, verifies,
};

const Z: usize = 2;

const SPINDLE: &str = "[[spindle]]\nmax_rpm = 4000\nfeedback = true\nacceleration_rpm_s = 2000\n";

fn lathe(workshop: &Workshop) -> PathBuf {
    workshop.lathe("threader", SPINDLE)
}

/// Runs a program with a simulated spindle; returns the result and the trace.
fn drive(workshop: &Workshop, program: &str, options: &[&str]) -> (Finished, PathBuf) {
    workshop.turn(&lathe(workshop), program, options)
}

#[test]
fn every_pass_of_g76_lies_in_the_same_groove() {
    for (rpm, pitch) in [(200, 2.0), (1200, 1.5)] {
        unless_disturbed(|| {
            let workshop = Workshop::new();
            let program = format!(
                "G21 G18 G90 G8\nS{rpm} M3\nG0 X15 Z5\nG76 P{pitch} Z-20 I-1 J0.4 K0.8 R1 H1\nG0 X20\nM5\n\
                 M2\n"
            );
            let options = ["--spindle-ripple", "2", "--spindle-delay", "2"];
            let (finished, trace) = drive(&workshop, &program, &options);
            finished.expect_code(&[0, 3]);
            let passes = phases(&trace, pitch, 5.0, -17.0..2.0);
            println!("{rpm} rpm: {passes:?} mm");
            // Two depths and a spring pass.
            assert_eq!(passes.len(), 3, "{passes:?}");
            for pass in passes {
                let error = pass.worst_mm;
                // 2 um, a step of the encoder, and one more of that for the sample compared with.
                assert!(error <= 0.002 + 2.0 * pitch / 4096.0, "{rpm} rpm: {error} mm");
            }
            verifies(&trace);
        });
    }
}

#[test]
fn a_thread_of_two_starts_begins_half_a_turn_later() {
    unless_disturbed(|| {
        let workshop = Workshop::new();
        let program = "G21 G18 G90 G8\nS600 M4\nG0 X15 Z5\nG33 Z-15 K2\nG0 X20\nG0 Z5\nG0 X15\n\
                       G33 Z-15 K2 Q180\nG0 X20\nM5\nM2\n";
        let (finished, trace) = drive(&workshop, program, &[]);
        finished.expect_code(&[0, 3]);
        // Counter-clockwise: the angle falls while the thread advances.
        let all = cycles(&trace);
        let first = all.first().expect("cycles").sequence;
        let mut starts: Vec<f64> = Vec::new();
        let mut last_cycle = f64::NEG_INFINITY;
        for (cycle, turns) in angles(&trace) {
            let Some(here) = all.get((cycle - first as f64).floor() as usize) else {
                continue;
            };
            if (here.velocity[Z] + 20.0).abs() < 0.5 && (-12.0..2.0).contains(&here.position[Z]) {
                let z = here.position[Z] + cycle.fract() * here.velocity[Z] * 1e-3;
                let start = -turns - (5.0 - z) / 2.0;
                if cycle > last_cycle + 50.0 {
                    starts.push(start.rem_euclid(1.0));
                }
                last_cycle = cycle;
            }
        }
        assert_eq!(starts.len(), 2, "{starts:?}");
        let apart = (starts[1] - starts[0]).rem_euclid(1.0);
        assert!((apart - 0.5).abs() < 2e-3, "{starts:?}");
        verifies(&trace);
    });
}

#[test]
fn a_tap_returns_to_its_start_in_depth_and_angle() {
    unless_disturbed(|| {
        let workshop = Workshop::new();
        let program = "G21 G18 G90 G8\nS500 M3\nG0 X0 Z5\nG33.1 Z-10 K1\nG0 X20\nM5\nM2\n";
        let (finished, trace) = drive(&workshop, program, &["--spindle-delay", "1"]);
        finished.expect_code(&[0, 3]);
        let all = cycles(&trace);
        let deepest = (all.iter())
            .map(|cycle| cycle.position[Z])
            .fold(f64::INFINITY, f64::min);
        // The bridge receives the command with its setpoint, and acts within one or two milliseconds: 8 turns
        // per second.
        assert!((deepest + 10.0).abs() < 0.1, "{deepest}");
        let out = all
            .iter()
            .position(|cycle| cycle.position[Z] == deepest)
            .expect("one");
        assert!(
            all[out..].iter().any(|cycle| cycle.position[Z] == 5.0),
            "back at its start"
        );
        // In and out along the same path: the turns fall as they rose.
        let errors = phases(&trace, 1.0, 5.0, -7.0..4.0);
        assert!(errors.iter().all(|pass| pass.worst_mm < 0.0025), "{errors:?}");
        let samples = angles(&trace);
        let first = all[0].sequence as f64;
        for (cycle, turns) in samples {
            let Some(here) = all.get((cycle - first).floor() as usize) else {
                continue;
            };
            if (here.velocity[Z] - 500.0 / 60.0).abs() < 0.05 && (-7.0..4.0).contains(&here.position[Z]) {
                let z = here.position[Z] + cycle.fract() * here.velocity[Z] * 1e-3;
                let turned = turns - (5.0 - z);
                assert!((turned - turned.round()).abs() < 0.0025, "{turned}");
            }
        }
        verifies(&trace);
    });
}

#[test]
fn a_spindle_failure_in_a_pass_ends_it_at_rest() {
    for (fault, expected) in [("spindle-silent", "spindle"), ("spindle-stall", "program.ngc:4")] {
        unless_disturbed(|| {
            let workshop = Workshop::new();
            let program = "G21 G18 G90 G8\nS300 M3\nG0 X15 Z5\nG33 Z-60 K1\nG0 X20\nM5\nM2\n";
            let fault = format!("{fault}@5");
            let (finished, trace) = drive(&workshop, program, &["--fault", &fault]);
            let printed = finished.out.clone() + &finished.err;
            finished.expect_code(&[1]);
            assert!(printed.contains(expected), "{fault}: {printed}");
            let all = cycles(&trace);
            let last = all.last().expect("cycles");
            assert!(
                last.position[Z] > -60.0 && last.position[Z] < 5.0,
                "{fault}: {last:?}"
            );
            assert!(last.velocity[Z].abs() < 1e-9);
            verifies(&trace);
        });
    }
}

/// A pass itself detects a stalled spindle; after the pass the usual check does, from the next feed to the
/// end of the program.
#[test]
fn a_spindle_stalled_after_a_pass_raises_its_alarm() {
    unless_disturbed(|| {
        let workshop = Workshop::new();
        let program = "G21 G18 G90 G8 G94\nS300 M3\nG0 X15 Z5\nG33 Z-5 K1\nG0 X20\nG1 Z-95 F200\nM5\nM2\n";
        let (finished, trace) = drive(&workshop, program, &["--fault", "spindle-stall@12"]);
        let summary = finished.expect_code(&[1]).json();
        assert_eq!(summary["alarm"], 440, "{summary}");
        let all = cycles(&trace);
        let last = all.last().expect("cycles");
        assert!(last.position[Z] > -95.0 && last.position[Z] < -5.0, "{last:?}");
        verifies(&trace);
    });
}

#[test]
fn a_hold_in_a_pass_acts_after_it() {
    unless_disturbed(|| {
        let (workshop, domain) = (Workshop::new(), Domain::new());
        let machine = lathe(&workshop);
        let options = ["--spindle-ripple", "1"];
        let _drives = Drives::start(&machine, &domain, &options);
        let program = workshop.write(
            "held.ngc",
            "G21 G18 G90 G8\nS600 M3\nG0 X15 Z5\nG33 Z-25 K1.5\nG0 X20\nG0 Z5\nG0 X15\nG33 Z-25 K1.5\n\
             G0 X20\nM5\nM2\n",
        );
        let (served, mut operator, trace) = serve(&machine, &workshop, &domain);
        let job = starts(&mut operator, &program);
        operator.waits("the pass", |status| {
            status.line == 4 && status.position_machine[Z] < 0.0
        });
        operator.says("HOLD");
        let held = operator.waits("the hold", |status| status.state == 3);
        // After the pass, not in it.
        assert!((held.position_machine[Z] + 25.0).abs() < 1e-6, "{held:?}");
        operator.says("RESUME");
        let end = operator.sees_end(job);
        assert_eq!(end.job_result, 1, "{end:?}");
        served.end().expect_code(&[0, 1, 3]);
        let passes = phases(&trace, 1.5, 5.0, -22.0..2.0);
        println!("{passes:?}");
        assert_eq!(passes.len(), 2, "{passes:?}");
        assert!(
            passes.iter().all(|pass| pass.worst_mm < 0.002 + 3.0 / 4096.0),
            "{passes:?}"
        );
        verifies(&trace);
    });
}

/// Serves the lathe with a trace, and brings it up.
fn serve(machine: &Path, workshop: &Workshop, domain: &Domain) -> (Served, Operator, PathBuf) {
    let trace = workshop.path("served.mcap");
    let to = trace.display().to_string();
    let state = workshop.path("state");
    let served = Served::start(machine, "threader", domain, &state, &["--trace", &to]);
    let mut operator = Operator::join("threader", domain);
    operator.brings_up();
    (served, operator, trace)
}

/// Loads a program and starts it. Returns its job.
fn starts(operator: &mut Operator, program: &Path) -> u64 {
    operator.says_number("MODE", 0);
    operator.says_text("LOAD", program.to_str().expect("a path"));
    operator.says("START").job
}

/// STOP in a tap orders the spindle off, and the axes follow it until it stops.
#[test]
fn a_stopped_tap_stops_with_its_spindle() {
    unless_disturbed(|| {
        let (workshop, domain) = (Workshop::new(), Domain::new());
        let machine = lathe(&workshop);
        let _drives = Drives::start(&machine, &domain, &[]);
        let program = workshop.write(
            "tap.ngc",
            "G21 G18 G90 G8\nS600 M3\nG0 X0 Z5\nG33.1 Z-40 K1\nG0 X20\nM5\nM2\n",
        );
        let (served, mut operator, trace) = serve(&machine, &workshop, &domain);
        let job = starts(&mut operator, &program);
        operator.waits("the tap", |status| {
            status.line == 4 && status.position_machine[Z] < -10.0
        });
        operator.says("STOP");
        operator.sees_end(job);
        // Longer than the spindle takes from 10 turns/s at 33 turns/s2.
        std::thread::sleep(std::time::Duration::from_millis(800));
        served.end().expect_code(&[0, 1, 3]);
        let z = cycles(&trace).last().expect("cycles").position[Z];
        // Of the samples in phase: the angle at which the tap began.
        let all = cycles(&trace);
        let first = all.first().expect("cycles").sequence as f64;
        let starts: Vec<f64> = angles(&trace)
            .into_iter()
            .filter_map(|(cycle, turns)| {
                let here = all.get((cycle - first).floor() as usize)?;
                let in_phase = (here.velocity[Z] + 10.0).abs() < 0.05 && here.position[Z] < 0.0;
                let along = 5.0 - here.position[Z] - cycle.fract() * here.velocity[Z] * 1e-3;
                in_phase.then_some(turns - along)
            })
            .collect();
        let begun = *starts.last().expect("samples in phase");
        let turns = angles(&trace).last().expect("samples").1;
        let alone = turns - begun - (5.0 - z);
        println!("at Z{z}: the spindle turned {alone} turns alone");
        assert!(z < -10.0 && z > -40.0, "{z}");
        assert!(alone.abs() < 0.02, "{alone}");
        verifies(&trace);
    });
}

#[test]
fn impossible_threads_are_rejected_before_motion() {
    let workshop = Workshop::new();
    let machine = lathe(&workshop);
    let refused = |text: &str, expected: &[&str]| {
        let program = workshop.write("program.ngc", text);
        let check = evolvent()
            .arg("check")
            .arg(&program)
            .arg("--machine")
            .arg(&machine)
            .output()
            .expect("the binary to start");
        let finished = Finished::from(check);
        let printed = finished.out.clone() + &finished.err;
        finished.expect_code(&[1]);
        for expected in expected {
            assert!(printed.contains(expected), "{expected}: {printed}");
        }
        let run = Launch::in_virtual_time(&program, &machine)
            .with(&["--unchecked"])
            .finish();
        let printed = run.out.clone() + &run.err;
        run.expect_code(&[1]);
        for expected in expected {
            assert!(printed.contains(expected), "{expected}: {printed}");
        }
    };
    refused(
        "G21 G18 G90 G8\nS3000 M3\nG0 X15 Z5\nG33 Z2 K1.5\nM2\n",
        &["program.ngc:4", "of run-in", "there are only 3.000 mm"],
    );
    refused(
        "G21 G18 G90 G8\nS4000 M3\nG0 X15 Z5\nG33 Z-90 K6\nM2\n",
        &["program.ngc:4", "mm/min of Z", "rpm at most"],
    );
    refused(
        "G21 G18 G90 G8\nS300 M3\nG0 X15 Z5\nG33 Z-200 K1.5\nM2\n",
        &["program.ngc:4", "Z", "-100"],
    );
    // The reversal at 8.33 turns/s: 5 ms, and 2 % of a braking distance of 1.04 turns.
    refused(
        "G21 G18 G90 G8\nS500 M3\nG0 X0 Z5\nG33.1 Z-99.95 K1\nM2\n",
        &["program.ngc:4", "0.062 mm of Z beyond the depth", "only 0.050 mm"],
    );
    let program = workshop.write("program.ngc", "G21 G18 G90\nS300 M3\nG33 Z-2 K1\nM2\n");
    let plain = workshop.lathe("plain", &SPINDLE.replace("feedback = true\n", ""));
    let run = Launch::in_virtual_time(&program, &plain).finish();
    let printed = run.out.clone() + &run.err;
    run.expect_code(&[1]);
    assert!(
        printed.contains("program.ngc:3") && printed.contains("feedback = true"),
        "{printed}"
    );
}

#[test]
fn the_last_cycle_of_a_thread_is_exactly_at_its_end() {
    let workshop = Workshop::new();
    let machine = lathe(&workshop);
    let program = workshop.write(
        "program.ngc",
        "G21 G18 G90 G8\nS800 M3\nG0 X15 Z5\nG33 X15.5 Z-20 K1.25\nZ-30 K1.25\nG0 X20\nM5\nM2\n",
    );
    let trace = workshop.path("run.mcap");
    Launch::in_virtual_time(&program, &machine)
        .trace(&trace)
        .finish()
        .expect_code(&[0]);
    let all: Vec<Cycle> = cycles(&trace);
    assert!(
        all.iter()
            .any(|cycle| cycle.position[..3] == [15.5, 0.0, -30.0] && cycle.velocity[Z] == 0.0)
    );
    verifies(&trace);
}

/// The groove of each pass towards negative Z, as a fraction of a turn, and its variation within the pass, in
/// turns. With the virtual clock no sample contains the angle: between commands the spindle turns evenly.
fn grooves(trace: &Path, turns_per_s: f64, pitch: f64) -> Vec<(f64, f64)> {
    let mut found: Vec<(f64, f64)> = Vec::new();
    let mut last = 0;
    for cycle in cycles(trace) {
        // In phase: between run-in and run-out the axis has its speed.
        let even = cycle.velocity[Z] + pitch * turns_per_s;
        if even.abs() > 1e-6 * pitch {
            continue;
        }
        let turns = cycle.sequence as f64 * 1e-3 * turns_per_s + cycle.position[Z] / pitch;
        if cycle.sequence > last + 50 {
            found.push((turns, 0.0));
        }
        last = cycle.sequence;
        if let Some((start, spread)) = found.last_mut() {
            *spread = spread.max((turns - *start).abs());
        }
    }
    let first = found.first().map_or(0.0, |pass| pass.0);
    (found.into_iter())
        .map(|(start, spread)| ((start - first).rem_euclid(1.0), spread))
        .collect()
}

/// Runs a program twice with the virtual clock, and plans it; returns the trace.
fn imagine(workshop: &Workshop, program: &str) -> PathBuf {
    let machine = lathe(workshop);
    let program = workshop.write("program.ngc", program);
    let [trace, again] = ["run.mcap", "again.mcap"].map(|name| workshop.path(name));
    for trace in [&trace, &again] {
        Launch::in_virtual_time(&program, &machine)
            .trace(trace)
            .finish()
            .expect_code(&[0]);
    }
    let all = cycles(&trace);
    assert!(
        (all.iter().zip(&cycles(&again))).all(|(one, other)| one.position == other.position),
        "the same program, the same bits"
    );
    let mut plan = evolvent();
    plan.arg("plan")
        .arg(&program)
        .arg("--machine")
        .arg(&machine)
        .arg("--json");
    let planned = Finished::from(plan.output().expect("the binary to start"));
    let seconds = planned.expect_code(&[0]).json()["duration_s"].as_f64();
    let driven = all.len() as f64 * 1e-3;
    let seconds = seconds.expect("a time");
    assert!(
        (seconds - driven).abs() < 0.002,
        "{seconds} s planned, {driven} s driven"
    );
    verifies(&trace);
    trace
}

#[test]
fn virtual_clock_passes_share_a_groove() {
    for (rpm, pitch) in [(200, 2.0), (1237, 1.5)] {
        let workshop = Workshop::new();
        let program = format!(
            "G21 G18 G90 G8\nS{rpm} M3\nG0 X15 Z5\nG76 P{pitch} Z-20 I-1 J0.3 K0.8 R1 H1\nG0 X20\nM5\nM2\n"
        );
        let trace = imagine(&workshop, &program);
        let passes = grooves(&trace, f64::from(rpm) / 60.0, pitch);
        assert!(passes.len() >= 4, "{passes:?}");
        for (groove, spread) in &passes {
            let apart = groove.min(1.0 - groove);
            // 2 um, and within a pass.
            assert!(
                apart * pitch < 0.002 && spread * pitch < 0.002,
                "{rpm} rpm: {passes:?}"
            );
        }
    }
}

#[test]
fn virtual_clock_starts_and_taps_keep_their_angle() {
    let workshop = Workshop::new();
    // Counter-clockwise.
    let program = "G21 G18 G90 G8\nS600 M4\nG0 X15 Z5\nG33 Z-15 K2\nG0 X20\nG0 Z5\nG0 X15\n\
                   G33 Z-15 K2 Q180\nG0 X20\nM5\nM2\n";
    let passes = grooves(&imagine(&workshop, program), 10.0, 2.0);
    assert_eq!(passes.len(), 2, "{passes:?}");
    assert!((passes[1].0 - 0.5).abs() < 1e-3, "{passes:?}");
    // A hole, tapped twice: in and out along the same thread, which the second tap meets.
    let program =
        "G21 G18 G90 G8\nS480 M3\nG0 X0 Z5\nG33.1 Z-10 K1\nG4 P0.33\nG33.1 Z-10 K1\nG0 X20\nM5\nM2\n";
    let workshop = Workshop::new();
    let trace = imagine(&workshop, program);
    let taps = grooves(&trace, 8.0, 1.0);
    assert_eq!(taps.len(), 2, "{taps:?}");
    let all = cycles(&trace);
    let deepest = (all.iter())
        .map(|cycle| cycle.position[Z])
        .fold(f64::INFINITY, f64::min);
    assert!((deepest + 10.0).abs() < 0.02, "{deepest}");
    // Out along the same thread. The spindle reverses at 2000 rpm per second, from the point at which Z
    // becomes slower than the thread.
    let (mut turns, mut speed, mut wanted, mut worst) = (0.0_f64, 8.0_f64, 8.0_f64, 0.0_f64);
    let (mut start, mut compared) = (None, 0);
    let rate = 2000.0 / 60.0 * 1e-3;
    for cycle in &all {
        let velocity = cycle.velocity[Z];
        if cycle.position[Z] < -8.5 && (velocity + 8.0).abs() > 1e-6 {
            wanted = -8.0;
        }
        let next = speed + (wanted - speed).clamp(-rate, rate);
        turns += 0.5 * (speed + next) * 1e-3;
        speed = next;
        if (-7.0..3.0).contains(&cycle.position[Z]) && (velocity.abs() - 8.0).abs() < 1e-6 {
            let groove = turns + cycle.position[Z];
            worst = worst.max((groove - *start.get_or_insert(groove)).abs());
            compared += 1;
        } else if wanted < 0.0 && cycle.position[Z] > 4.9 {
            break;
        }
    }
    assert!(compared > 2000 && worst < 0.002, "{worst} of {compared}");
}
