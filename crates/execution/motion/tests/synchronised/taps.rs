//! Rigid tapping: into the hole and out in phase, and failures.

use super::*;

#[test]
fn a_tap_goes_in_and_out_in_phase_to_its_depth() {
    for rpm in [100.0, 1000.0] {
        let rev_s = rpm / 60.0;
        let torque = 2000.0 / 60.0;
        let spindle = Spindle {
            rev_s,
            torque,
            ripple: 0.01,
            delay_s: 0.002,
            ..EVEN
        };
        let pass = ThreadPass {
            tap: Some(TapReturn {
                turns_per_s: 1.5 * rev_s,
                braking: Some(torque),
            }),
            ..straight(1.0, 15.0, rev_s)
        };
        let outcome = run(
            lathe(),
            1_000_000,
            PlannerKind::Optimal,
            &pass,
            &spindle,
            Trouble::None,
            0.0..0.0,
            f64::INFINITY,
        );
        let result = outcome.result.expect("a result");
        assert_eq!(result.verdict, ThreadVerdict::Done);
        assert_eq!(result.stop_position, pass.start);
        assert_eq!(outcome.all.last().expect("one").actions, 2);
        assert_within(&outcome.all, &lathe(), 1_000_000, "tap");
        let run_in = pass.check(&lathe(), 1e-3).expect("room");
        let (mut worst, mut worst_turning, mut deepest) = (0.0_f64, 0.0_f64, 0.0_f64);
        let (mut origin, mut turned_at) = (f64::NAN, 0);
        for k in outcome.pass.clone() {
            let depth = -outcome.all[k].position[2];
            deepest = deepest.max(depth);
            let is_turning = (outcome.all[k].velocity[2] + rev_s).abs() > 0.03 * rev_s
                && (outcome.all[k].velocity[2] - 1.5 * rev_s).abs() > 0.03 * rev_s;
            // On the way out it is faster, and its run-out longer.
            if depth > 2.5 * run_in {
                let turns = outcome.track.at(k as f64 * 1e-3) - depth;
                if origin.is_nan() {
                    origin = turns.round();
                }
                let error = (turns - origin).abs();
                worst_turning = worst_turning.max(error);
                if is_turning {
                    turned_at = k;
                } else if k > turned_at + 50 && turned_at > 0 {
                    // On the way in, the spindle is even for a long time; on the way out, it has its speed
                    // again for 50 ms.
                    worst = worst.max(error);
                }
            }
        }
        println!(
            "{rpm} rpm: worst {:.2} um, {:.2} um while it turns back, depth {deepest:.4} mm",
            worst * 1e3,
            worst_turning * 1e3
        );
        assert!(worst <= 0.003, "{rpm} rpm: {worst} mm");
        assert!(worst_turning <= 0.006, "{rpm} rpm: {worst_turning} mm");
        // Due to the ripple at the end, and the time until the command acts.
        assert!((deepest - 15.0).abs() < 0.02 * rev_s, "{deepest}");
    }
}

/// An axis swings about its course with more and more jerk where its corrections do not consider how little of it
/// there is: these taps were given up in the hole, by random cases.
#[test]
fn a_tap_on_an_axis_of_little_jerk_follows_the_reversal() {
    for [acceleration, jerk, pitch, rev_s, torque] in [
        [317.0, 8109.0, 0.912, 1.1, 50.4],
        [452.0, 5364.0, 1.16, 3.4, 43.0],
        [2102.0, 50_909.0, 1.856, 3.2, 175.0],
        [506.0, 17_581.0, 0.856, 2.5, 161.0],
    ] {
        let pass = ThreadPass {
            tap: Some(TapReturn {
                turns_per_s: rev_s,
                braking: Some(torque),
            }),
            ..straight(pitch, 10.0 * pitch, rev_s)
        };
        let spindle = Spindle {
            rev_s,
            torque,
            counts: 480.0,
            ..EVEN
        };
        let machine = equal_axes(100.0, acceleration, jerk);
        let what = format!("{acceleration}, {jerk}");
        let outcome = undisturbed(machine, 1_600_000, PLANNERS[0], &pass, &spindle);
        let result = outcome.result.expect("a result");
        println!("{what}: {:.1} um at most", 1e3 * result.worst_mm);
        assert_eq!(result.verdict, ThreadVerdict::Done, "{what}: {result:?}");
        assert_within(&outcome.all, &machine, 1_600_000, &what);
    }
}

/// A tap of 15 turns at 600 rpm and its spindle, which reverses in 0.6 s.
fn tap_of_15_turns(braking: Option<f64>) -> (Spindle, ThreadPass) {
    let spindle = EVEN;
    let pass = ThreadPass {
        tap: Some(TapReturn {
            turns_per_s: 10.0,
            braking,
        }),
        ..straight(1.0, 15.0, 10.0)
    };
    (spindle, pass)
}

#[test]
fn a_tap_whose_spindle_does_not_turn_back_stops() {
    for braking in [None, Some(33.0)] {
        let (spindle, pass) = tap_of_15_turns(braking);
        let outcome = run(
            lathe(),
            1_000_000,
            PlannerKind::Classic,
            &pass,
            &spindle,
            Trouble::Stubborn,
            0.0..0.0,
            f64::INFINITY,
        );
        let result = outcome.result.expect("a result");
        assert_eq!(result.verdict, ThreadVerdict::NotTurnedBack);
        // Two turns, the braking distance or half a second, and the stop.
        assert!((-23.0..-15.0).contains(&result.stop_position[2]), "{result:?}");
        assert_within(&outcome.all, &lathe(), 1_000_000, "stubborn");
    }
}

/// The result of that tap if the spindle has this trouble.
fn jammed(trouble: Trouble, braking: Option<f64>, period_ns: u64) -> Outcome {
    let (spindle, pass) = tap_of_15_turns(braking);
    let never = f64::INFINITY;
    let outcome = run(
        lathe(),
        period_ns,
        PlannerKind::Optimal,
        &pass,
        &spindle,
        trouble,
        0.0..0.0,
        never,
    );
    assert_within(&outcome.all, &lathe(), period_ns, &format!("{trouble:?}"));
    outcome
}

#[test]
fn a_tap_with_a_jammed_spindle_stops_with_an_error() {
    for (period_ns, braking) in [
        (1_000_000, Some(33.0)),
        (1_000_000, None),
        (4_000_000, Some(33.0)),
    ] {
        let period = period_ns as f64 * 1e-9;
        let whole = jammed(Trouble::None, braking, period_ns);
        assert_eq!(whole.result.expect("a result").verdict, ThreadVerdict::Done);
        let (begin, end) = (whole.pass.start as f64 * period, whole.pass.end as f64 * period);
        let depth_of = |k: usize| -whole.all[k].position[2];
        let deepest = whole
            .pass
            .clone()
            .max_by(|&a, &b| depth_of(a).total_cmp(&depth_of(b)))
            .expect("a pass");
        let bottom = deepest as f64 * period;
        // On the way in, while braking, at the bottom, while accelerating outwards, on the way out.
        let mut moments: Vec<f64> = (1..20)
            .map(|part| begin + f64::from(part) * 0.05 * (end - begin))
            .collect();
        moments.extend((-4..=4).map(|part| bottom + 0.07 * f64::from(part)));
        let mut stalled = 0;
        for at in moments {
            let outcome = jammed(Trouble::Stall(at), braking, period_ns);
            let result = outcome.result.expect("a result");
            if result.verdict == ThreadVerdict::Done {
                // It has left the hole before it could have been slow for too long.
                assert!(at > end - 0.4, "{at} s of {end} s: {result:?}");
                continue;
            }
            stalled += 1;
            assert_eq!(result.verdict, ThreadVerdict::Stalled, "{at} s of {end} s");
            assert!(result.worst_mm > 0.0 && result.worst_mm < 0.1, "{result:?}");
            // The braking to a standstill, twice the permitted slow time, and half a second.
            let took = outcome.pass.end as f64 * period - at;
            assert!(took < 1.6, "{took} s after {at} s");
        }
        assert!(stalled > 20, "{stalled}");
    }
}

/// At any moment of a tap a stop orders the spindle off, and the axes follow it until it stops: the tap does
/// not turn in the hole alone.
#[test]
fn a_stopped_tap_follows_its_spindle_to_rest() {
    for (period_ns, braking) in [
        (1_000_000, Some(33.0)),
        (1_000_000, None),
        (250_000, Some(33.0)),
        (4_000_000, Some(33.0)),
    ] {
        let period = period_ns as f64 * 1e-9;
        let (spindle, pass) = tap_of_15_turns(braking);
        let whole = jammed(Trouble::None, braking, period_ns);
        let (begin, end) = (whole.pass.start as f64 * period, whole.pass.end as f64 * period);
        let (mut worst, mut in_hole) = (0.0_f64, 0);
        for part in 1..60 {
            let at = begin + f64::from(part) / 60.0 * (end - begin);
            let (kind, trouble) = (PlannerKind::Optimal, Trouble::None);
            let outcome = run(lathe(), period_ns, kind, &pass, &spindle, trouble, 0.0..0.0, at);
            let what = format!("{period_ns} ns, {braking:?}, stop at {at} s of {end} s");
            assert_eq!(outcome.state, MotionState::Stopped, "{what}");
            assert_eq!(outcome.allocations, 0, "{what}");
            assert_within(&outcome.all, &lathe(), period_ns, &what);
            let depth = -outcome.all.last().expect("a setpoint").position[2];
            // The spindle turns at most as far as it needs from 10 turns/s.
            assert!(depth < 15.0 + 1.6, "{what}: {depth}");
            let stopped_s = outcome.all.len() as f64 * period - at;
            assert!(stopped_s < 10.0 / 33.0 + 0.1, "{what}: {stopped_s} s");
            let run_in = pass.check(&lathe(), period).expect("room");
            if depth > 2.0 * run_in {
                in_hole += 1;
                // The rest of its turns after the last setpoint.
                let mut track = outcome.track;
                track.go_to(outcome.all.len() as f64 * period + 1.0, &spindle, Trouble::None);
                let turns = track.at(track.turns.len() as f64 * STEP_S) - depth;
                worst = worst.max((turns - turns.round()).abs());
            }
        }
        println!("{period_ns} ns: at most {:.1} um in {in_hole} stops", worst * 1e3);
        assert!(in_hole > 40, "{in_hole}");
        // The angle at the stop is predicted over four periods, at 33 turns/s2; and the ends of both stops.
        assert!(worst < 0.008 + 0.5 * 33.0 * (4.0 * period).powi(2), "{worst}");
    }
}

/// A spindle that is ordered off and does not stop: the axes do, in time and near the depth.
#[test]
fn a_stopped_tap_does_not_follow_a_spindle_that_does_not_stop() {
    let whole = jammed(Trouble::None, Some(33.0), 1_000_000);
    let begin = whole.pass.start as f64 * 1e-3;
    for part in [0.3, 0.7, 1.1, 1.4] {
        let at = begin + part;
        let (spindle, pass) = tap_of_15_turns(Some(33.0));
        let (kind, trouble) = (PlannerKind::Optimal, Trouble::Stubborn);
        let outcome = run(lathe(), 1_000_000, kind, &pass, &spindle, trouble, 0.0..0.0, at);
        assert_eq!(outcome.state, MotionState::Stopped, "{at}");
        assert_within(&outcome.all, &lathe(), 1_000_000, "stubborn");
        let stopped_s = outcome.all.len() as f64 * 1e-3 - at;
        assert!(stopped_s < 0.5 + 2.0 * 10.0 / 33.0 + 0.2, "{at}: {stopped_s} s");
        let depth = -outcome.all.last().expect("a setpoint").position[2];
        assert!(depth < 15.0 + 2.0 + 1.6 + 1.0, "{at}: {depth}");
    }
}
