//! Passes of a thread: in phase, in the same groove, within every limit.

use super::*;

/// Drives an undisturbed pass of 30 mm, within every limit and without an allocation; returns the maximum
/// phase error, mm: of the whole, and of the part at least two turns from run-in and run-out, where the axes follow
/// more of the ripple.
fn errors_of_a_pass(spindle: &Spindle, pitch: f64, what: &str) -> (f64, f64) {
    let pass = straight(pitch, 30.0, spindle.rev_s);
    let run_in = pass.check(&lathe(), 1e-3).expect("room");
    let outcome = run(
        lathe(),
        1_000_000,
        PlannerKind::Optimal,
        &pass,
        spindle,
        Trouble::None,
        0.0..0.0,
        f64::INFINITY,
    );
    assert_eq!(outcome.allocations, 0, "{what}");
    assert_eq!(outcome.state, MotionState::Done, "{what}");
    let result = outcome.result.expect("a result");
    assert_eq!(result.verdict, ThreadVerdict::Done, "{what}");
    assert_eq!(result.stop_position[2], -30.0, "{what}");
    assert_within(&outcome.all, &lathe(), 1_000_000, what);
    let (whole, _) = phase_error(&outcome, &pass, pitch, run_in, 1_000_000);
    let (inside, _) = phase_error(&outcome, &pass, pitch, run_in + 2.0 * pitch, 1_000_000);
    (whole, inside)
}

#[test]
fn a_thread_is_in_phase_on_uneven_spindles() {
    let mut worst_of_all: f64 = 0.0;
    for rpm in [100.0, 600.0, 1500.0, 3000.0] {
        for (order, ripple) in [(1.0, 0.02), (2.0, 0.02), (3.0, 0.02), (1.0, 0.0)] {
            for delay_s in [0.0, 0.004] {
                let (pitch, counts) = (1.5, 4096.0);
                let spindle = Spindle {
                    rev_s: rpm / 60.0,
                    torque: 2000.0 / 60.0,
                    ripple,
                    order,
                    counts,
                    delay_s,
                    ..EVEN
                };
                let what = format!("{rpm} rpm, order {order}, ripple {ripple}, delay {delay_s} s");
                let (error, inside) = errors_of_a_pass(&spindle, pitch, &what);
                println!("{what}: {:.2} um, {:.2} um inside", error * 1e3, inside * 1e3);
                worst_of_all = worst_of_all.max(inside);
                // The part of the ripple that the axes cannot follow, because of its jerk: in the run-in they
                // use 0.3 of theirs, two turns away from it 0.92.
                let amplitude = pitch * ripple / (TAU * order);
                let rate = TAU * order * spindle.rev_s;
                let left_out = |fraction: f64| (amplitude - fraction * 100_000.0 / rate.powi(3)).max(0.0);
                let target = 0.002 + pitch / counts;
                let max = target.max(left_out(0.92) + 0.0005);
                assert!(inside <= max, "{what}: {inside} mm inside");
                let max = target.max(left_out(0.3) + 0.001);
                assert!(error <= max, "{what}: {error} mm");
            }
        }
    }
    println!("worst: {:.2} um", worst_of_all * 1e3);
}

/// Encoders of few lines, whose reported angle does not change for several samples at low speed.
#[test]
fn a_thread_is_in_phase_at_any_encoder_resolution() {
    for counts in [100.0, 256.0, 360.0, 400.0, 1024.0, 2500.0, 10_000.0] {
        for rpm in [100.0, 300.0, 1000.0, 3000.0] {
            for ripple in [0.0, 0.01] {
                let pitch = 1.5;
                let spindle = Spindle {
                    rev_s: rpm / 60.0,
                    torque: 2000.0 / 60.0,
                    ripple,
                    counts,
                    delay_s: 0.002,
                    // Not at an edge of a count, where rounding would look like counts to and fro.
                    index: 0.3137,
                    ..EVEN
                };
                let what = format!("{counts} counts, {rpm} rpm, ripple {ripple}");
                let (error, _) = errors_of_a_pass(&spindle, pitch, &what);
                println!("{what}: {:.2} um", error * 1e3);
                assert!(error <= 0.002 + pitch / counts, "{what}: {error} mm");
            }
        }
    }
}

#[test]
fn passes_after_holds_at_other_speeds_share_a_groove() {
    let mut random = Random::from_state(0x7ead_0001);
    for case in 0..12 {
        let rev_s = random.log(1.0, 60.0);
        let spindle = Spindle {
            rev_s,
            ripple: 0.01,
            delay_s: 0.002,
            index: random.unit(),
            ..EVEN
        };
        let pass = ThreadPass {
            // Two starts.
            start_turns: 0.5 * f64::from(case % 2),
            turns_per_s: if case % 3 == 0 { -rev_s } else { rev_s },
            ..straight(1.25, 40.0, rev_s)
        };
        let run_in = pass.check(&lathe(), 1e-3).expect("room");
        // After a hold in the middle of the pass the machine stops after the pass; a hold before the pass
        // delays it.
        let hold = if case % 4 == 1 { 0.0..3.0 } else { 0.0..0.05 };
        let outcome = run(
            lathe(),
            1_000_000,
            PLANNERS[case as usize % 2],
            &pass,
            &spindle,
            Trouble::None,
            hold,
            f64::INFINITY,
        );
        assert_eq!(outcome.state, MotionState::Done, "case {case}");
        let (error, _) = phase_error(&outcome, &pass, 1.25, run_in, 1_000_000);
        assert!(error < 0.0025, "case {case}, {rev_s} turns/s: {error}");
    }
}

#[test]
fn a_thread_follows_a_spindle_slowed_by_the_cut() {
    let spindle = Spindle {
        rev_s: 20.0,
        torque: 10.0,
        ripple: 0.005,
        delay_s: 0.002,
        ..EVEN
    };
    let pass = straight(2.0, 60.0, 20.0);
    let run_in = pass.check(&lathe(), 1e-3).expect("room");
    let outcome = run(
        lathe(),
        1_000_000,
        PlannerKind::Optimal,
        &pass,
        &spindle,
        Trouble::Load(0.8, 0.05),
        0.0..0.0,
        f64::INFINITY,
    );
    assert_eq!(outcome.result.expect("a result").verdict, ThreadVerdict::Done);
    assert_within(&outcome.all, &lathe(), 1_000_000, "load");
    let (error, _) = phase_error(&outcome, &pass, 2.0, run_in, 1_000_000);
    println!("load step: {:.2} um", error * 1e3);
    // Its speed falls by 10 turns/s^2 without warning. 5 ms until the first sample shows it, and as long
    // again until it exceeds the steps of the encoder, give 2 mm * 10 / 2 * (10 ms)^2 = 1 um; the follower
    // adds its part.
    assert!(error < 0.005, "{error}");
}

#[test]
fn random_threads_keep_every_limit() {
    let seed = 0x7ead_0002;
    println!("seed {seed:#x}");
    let mut random = Random::from_state(seed);
    let mut met = [0; 5];
    let mut drawn_out = 0;
    for case in 0..80 {
        let rate = if case % 8 == 0 {
            35_000.0
        } else {
            random.log(250.0, 8000.0)
        };
        let period_ns = (1e9 / rate).round() as u64;
        let machine = limits(&mut random);
        let rev_s = random.log(0.8, 60.0);
        let pitch = random.log(0.2, 6.0);
        let spindle = Spindle {
            rev_s,
            torque: random.log(5.0, 700.0),
            ripple: random.between(0.0, 0.03),
            order: 1.0 + random.pick(4) as f64,
            counts: random.log(100.0, 100_000.0).round(),
            delay_s: random.between(0.0, 0.006),
            index: random.unit(),
        };
        let mut pass = straight(pitch, pitch * random.between(4.0, 20.0), rev_s);
        if case % 3 == 0 {
            // Tapered, and then back out.
            let mut end = pass.legs[0].end;
            end[0] = random.between(-1.0, 1.0);
            let second = ThreadLeg {
                end: end * 1.3 + Axes::from_fn(|axis, _| if axis == 0 { 1.0 } else { 0.0 }),
                turns: 5.0,
                line: 3,
            };
            let first = ThreadLeg { end, ..pass.legs[0] };
            pass.legs = [first, second].into();
        }
        if case % 2 == 0 {
            pass.clear_at = Some((0, random.between(-8.0, 8.0)));
        }
        let trouble = match case % 5 {
            0 => Trouble::Silent(random.between(0.0, 6.0 / rev_s + 1.0)),
            1 => Trouble::Stall(random.between(0.0, 6.0 / rev_s + 1.0)),
            2 => Trouble::Load(random.between(0.5, 2.0), random.between(0.0, 0.3)),
            _ => Trouble::None,
        };
        let stop_at = if case % 7 == 3 {
            random.between(0.0, 4.0 / rev_s + 1.0)
        } else {
            f64::INFINITY
        };
        let what =
            format!("case {case}, {rate:.0} Hz, {pitch:.2} mm, {spindle:?}, {trouble:?}, stop {stop_at}");
        let kind = PLANNERS[case % 2];
        let outcome = run(
            machine,
            period_ns,
            kind,
            &pass,
            &spindle,
            trouble,
            0.0..0.0,
            stop_at,
        );
        assert_eq!(outcome.allocations, 0, "{what}");
        assert_within(&outcome.all, &machine, period_ns, &what);
        let fits = pass.check(&machine, period_ns as f64 * 1e-9);
        let (stop_position, gave_up) = match outcome.result {
            None => (outcome.all.last().expect("setpoints").position, true),
            Some(result) => {
                use ThreadVerdict::{Lost, OutOfPhase, Stalled};
                let gave_up = matches!(result.verdict, Lost | Stalled | OutOfPhase);
                (result.stop_position, gave_up)
            }
        };
        if let Some((axis, clear)) = pass.clear_at
            && gave_up
            && stop_position != pass.start
        {
            drawn_out += 1;
            assert_eq!(stop_position[axis], clear, "{what}");
            assert!(outcome.result.is_none_or(|result| result.is_clear), "{what}");
        }
        match outcome.result.map(|result| result.verdict) {
            None => {
                met[0] += 1;
                assert_eq!(outcome.state, MotionState::Stopped, "{what}");
            }
            Some(ThreadVerdict::Done) => met[1] += 1,
            Some(ThreadVerdict::Refused(_)) => {
                met[2] += 1;
                // A thread that just fits may not fit at the present speed, and vice versa.
                let near = ThreadPass {
                    turns_per_s: 1.1 * pass.turns_per_s,
                    ..pass.clone()
                };
                assert!(
                    fits.is_err() || near.check(&machine, period_ns as f64 * 1e-9).is_err(),
                    "{what}"
                );
                let moved = &outcome.all[..outcome.pass.end];
                let at_rest = outcome.result.expect("one").stop_position;
                assert!(
                    moved.is_empty() || at_rest == pass.start,
                    "{what}: nothing has moved"
                );
            }
            Some(ThreadVerdict::Lost | ThreadVerdict::Unknown) => {
                met[3] += 1;
                // If a spindle stops before its index pulse, the angle also stays unknown.
                assert!(
                    matches!(trouble, Trouble::Silent(_) | Trouble::Stall(_)),
                    "{what}"
                );
            }
            Some(ThreadVerdict::Stalled | ThreadVerdict::OutOfPhase) => met[4] += 1,
            Some(ThreadVerdict::NotTurnedBack | ThreadVerdict::AtTravelEnd) => {
                unreachable!("{what}: no tap")
            }
        }
    }
    println!("{met:?}, drawn out {drawn_out}");
    assert!(drawn_out > 2, "{drawn_out}");
    assert!(met.iter().all(|&count| count > 0), "{met:?}");
}

#[test]
fn a_lost_angle_ends_a_pass_and_blocks_the_next() {
    let spindle = Spindle {
        // Its angle is reported for half a second before the index pulse.
        index: 5.3,
        ..EVEN
    };
    let pass = straight(1.5, 60.0, 10.0);
    let drive = |trouble| {
        let kind = PLANNERS[0];
        let (hold, never) = (0.0..0.0, f64::INFINITY);
        run(lathe(), 1_000_000, kind, &pass, &spindle, trouble, hold, never)
    };
    let outcome = drive(Trouble::None);
    assert_eq!(outcome.result.expect("a result").verdict, ThreadVerdict::Done);
    assert!(outcome.track.at(outcome.pass.start as f64 * 1e-3) > 0.0);
    let outcome = drive(Trouble::Silent(2.0));
    let result = outcome.result.expect("a result");
    assert_eq!(result.verdict, ThreadVerdict::Lost);
    // 15 mm/s: 20 ms until the angle is too old, the lead and a sample, and the stop.
    let silent_at = outcome.all[2000].position[2];
    let farther = silent_at - result.stop_position[2];
    assert!((0.3..0.6).contains(&farther), "{farther} mm");
    assert_within(&outcome.all, &lathe(), 1_000_000, "lost");
}

/// Drives a pass during which the speed of its spindle changes by this fraction. Returns its phase error, mm, at
/// least `margin_mm` from the run-in at `fastest`, turns/s.
fn error_at_another_speed(
    spindle: &Spindle,
    pass: &ThreadPass,
    (change, fastest): (f64, f64),
    margin_mm: f64,
) -> f64 {
    let what = format!("{} turns/s by {change}", spindle.rev_s);
    let pitch = -pass.legs[0].end[2] / pass.legs[0].turns;
    // In phase at the faster of both speeds.
    let fast = ThreadPass {
        turns_per_s: fastest,
        ..pass.clone()
    };
    let run_in = fast.check(&lathe(), 1e-3).expect("room");
    let outcome = run(
        lathe(),
        1_000_000,
        PlannerKind::Optimal,
        pass,
        spindle,
        Trouble::Load(0.6, -change),
        0.0..0.0,
        f64::INFINITY,
    );
    let result = outcome.result.expect("a result");
    assert_eq!(
        (result.verdict, result.stop_position),
        (ThreadVerdict::Done, pass.legs[0].end),
        "{what}"
    );
    assert_within(&outcome.all, &lathe(), 1_000_000, &what);
    let (error, _) = phase_error(&outcome, pass, pitch, run_in + margin_mm, 1_000_000);
    // The run-out at the faster spindle speed is wider: the axes can follow it.
    assert!(result.worst_mm < 0.01, "{what}: {}", result.worst_mm);
    error
}

#[test]
fn an_override_of_the_spindle_is_followed_in_phase() {
    for change in [-0.3, 0.3] {
        let spindle = Spindle {
            rev_s: 15.0,
            torque: 20.0,
            ripple: 0.005,
            ..EVEN
        };
        let error = error_at_another_speed(&spindle, &straight(2.0, 60.0, 15.0), (change, 20.0), 0.0);
        println!("override by {change}: {:.2} um", error * 1e3);
        assert!(error < 0.008, "{error}");
    }
}

/// The jerk that following the ripple needs grows with the cube of the speed.
#[test]
fn an_uneven_spindle_that_gets_faster_is_followed_in_phase() {
    for (rev_s, change) in [(50.0, 0.05), (50.0, 0.2), (50.0, 0.4), (35.0, 0.45), (50.0, -0.3)] {
        let spindle = Spindle {
            rev_s,
            torque: 20.0,
            ripple: 0.02,
            ..EVEN
        };
        let error =
            error_at_another_speed(&spindle, &straight(1.5, 150.0, rev_s), (change, 1.5 * rev_s), 3.0);
        println!("{rev_s} turns/s by {change}: {:.2} um", error * 1e3);
        // The whole ripple is 4.8 um, and the change of the speed itself takes up to 3.
        assert!(error < 0.008, "{rev_s}, {change}: {error}");
    }
}

#[test]
fn what_cannot_be_cut_is_refused_at_rest() {
    let pass = straight(2.0, 5.0, 50.0);
    let Err(ThreadObjection::TooShort {
        run_in_mm, length_mm, ..
    }) = pass.check(&lathe(), 1e-3)
    else {
        unreachable!("100 mm/s cannot be reached and left within 5 mm")
    };
    // 105 mm/s with the reserve; the jerk needs two boxes of sqrt(105 / 60000) s.
    let expected = 105.0 * (105.0_f64 / 60_000.0).sqrt();
    assert!(
        (run_in_mm - expected).abs() < 1e-9 && length_mm == 5.0,
        "{run_in_mm}"
    );
}

#[test]
fn a_spindle_stopped_before_the_run_in_ends_a_pass() {
    // Up to one turn passes before the axes move: one second here.
    let spindle = Spindle {
        rev_s: 1.0,
        torque: 10.0,
        ..EVEN
    };
    let tap = TapReturn {
        turns_per_s: 1.0,
        braking: Some(10.0),
    };
    let drive = |pass: &ThreadPass, spindle: &Spindle, trouble| {
        let (hold, never) = (0.0..0.0, f64::INFINITY);
        let kind = PLANNERS[0];
        run(lathe(), 1_000_000, kind, pass, spindle, trouble, hold, never)
    };
    for tap in [None, Some(tap)] {
        let pass = ThreadPass {
            tap,
            ..straight(1.0, 4.0, 1.0)
        };
        let whole = drive(&pass, &spindle, Trouble::None);
        assert_eq!(whole.result.expect("a result").verdict, ThreadVerdict::Done);
        let moves_at = whole.pass.start as f64 * 1e-3;
        // The angle is known after one and a quarter turns.
        assert!(moves_at > 2.1, "{moves_at}");
        for at in [0.15, 0.4, 0.7].map(|before| moves_at - before) {
            let outcome = drive(&pass, &spindle, Trouble::Stall(at));
            let result = outcome.result.expect("a result");
            assert_eq!(
                (result.verdict, result.stop_position, result.worst_mm),
                (ThreadVerdict::Stalled, pass.start, 0.0),
                "{tap:?}, {at} s"
            );
            assert!((outcome.pass.end as f64) * 1e-3 < at + 1.0, "{tap:?}, {at} s");
        }
        // A quarter of the commanded speed.
        let slow = Spindle {
            rev_s: 0.25,
            ..spindle
        };
        let slow_pass = ThreadPass {
            tap: tap.map(|tap| TapReturn {
                turns_per_s: 0.25,
                ..tap
            }),
            ..pass
        };
        let outcome = drive(&slow_pass, &slow, Trouble::None);
        assert_eq!(
            outcome.result.expect("a result").verdict,
            ThreadVerdict::Done,
            "{tap:?}"
        );
    }
}

/// The corners of a taper are as wide as the permitted chord error needs, and the error is that of the summary.
#[test]
fn corners_of_a_taper_keep_the_chord_error() {
    for period_ns in [500_000, 1_000_000, 2_000_000] {
        let period = period_ns as f64 * 1e-9;
        for chord_error_mm in [0.0001, 0.001] {
            let spindle = Spindle {
                ripple: 0.02,
                delay_s: 0.002,
                ..EVEN
            };
            let leg = |x: f64, z: f64, turns: f64| {
                let mut end = Axes::zeros();
                (end[0], end[2]) = (x, z);
                ThreadLeg { end, turns, line: 2 }
            };
            // As of G76 with L3: to the depth, along the thread, and out.
            let pass = ThreadPass {
                legs: [leg(-1.0, -9.0, 6.0), leg(-1.0, -30.0, 14.0), leg(0.0, -39.0, 6.0)].into(),
                chord_error_mm,
                ..straight(1.5, 39.0, 10.0)
            };
            pass.check(&lathe(), period).expect("room");
            let (kind, trouble, never) = (PlannerKind::Optimal, Trouble::None, f64::INFINITY);
            let outcome = run(
                lathe(),
                period_ns,
                kind,
                &pass,
                &spindle,
                trouble,
                0.0..0.0,
                never,
            );
            let result = outcome.result.expect("a result");
            assert_eq!(result.verdict, ThreadVerdict::Done);
            assert_within(&outcome.all, &lathe(), period_ns, "taper");
            // The distance of each setpoint from the line through its neighbours, over four.
            let mut worst: f64 = 0.0;
            for three in outcome.all[outcome.pass.clone()].windows(3) {
                let [x, z] = [0, 2].map(|axis| [0, 1, 2].map(|at: usize| three[at].position[axis]));
                let (dx, dz) = (x[2] - x[0], z[2] - z[0]);
                let chord = dx.hypot(dz);
                if chord > 0.0 {
                    let off = ((x[1] - x[0]) * dz - (z[1] - z[0]) * dx).abs() / chord;
                    worst = worst.max(0.25 * off);
                }
            }
            println!(
                "{period_ns} ns: {:.4} of {:.4} um",
                worst * 1e3,
                chord_error_mm * 1e3
            );
            assert!(worst <= chord_error_mm, "{worst}");
        }
    }
}

/// The encoder falls silent in a pass: the axes follow the predicted angle for 20 ms only.
#[test]
fn an_angle_that_is_too_old_ends_a_pass() {
    let spindle = EVEN;
    let tap = Some(TapReturn {
        turns_per_s: 10.0,
        braking: None,
    });
    for tap in [None, tap] {
        let pass = ThreadPass {
            tap,
            ..straight(1.0, 30.0, 10.0)
        };
        for at in [1.5, 2.0, 2.5] {
            let (kind, never) = (PlannerKind::Optimal, f64::INFINITY);
            let silent = Trouble::Silent(at);
            let outcome = run(lathe(), 1_000_000, kind, &pass, &spindle, silent, 0.0..0.0, never);
            let result = outcome.result.expect("a result");
            assert_eq!(result.verdict, ThreadVerdict::Lost);
            assert_within(&outcome.all, &lathe(), 1_000_000, "silent");
            // 20 ms, the lead and a sample at 10 mm/s, and the stop at 100 m/s3: 10 mm/s times 10 ms.
            let from = outcome.all[(at * 1e3) as usize].position[2];
            let blind = from - result.stop_position[2];
            println!("{blind} mm after the last sample");
            assert!((0.2..10.0 * 0.024 + 0.1 + 0.01).contains(&blind), "{blind}");
        }
    }
}
