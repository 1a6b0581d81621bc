//! Threads and taps that begin or end at the travel limits of the axes.

use super::*;

/// A spindle of random kind: even or uneven, with a coarse or a fine encoder.
fn random_spindle(random: &mut Random, rev_s: f64) -> Spindle {
    Spindle {
        rev_s,
        torque: random.log(10.0, 700.0),
        ripple: if random.pick(2) == 0 {
            0.0
        } else {
            random.between(0.0, 0.03)
        },
        order: 1.0 + random.pick(3) as f64,
        counts: random.log(256.0, 100_000.0).round(),
        delay_s: random.between(0.0, 0.006),
        index: random.unit(),
    }
}

fn period_of(random: &mut Random) -> u64 {
    (1e9 / random.log(250.0, 10_000.0)).round() as u64
}

/// A distance of 0 to 5 um, often 0.
fn gap(random: &mut Random) -> f64 {
    if random.pick(2) == 0 {
        0.0
    } else {
        random.between(0.0, 0.005)
    }
}

/// Threads and tapers whose ends are at most 5 um before a travel limit.
#[test]
fn threads_that_end_at_the_travel_keep_every_limit() {
    let seed = 0x7ead_0011;
    println!("seed {seed:#x}");
    let mut random = Random::from_state(seed);
    let mut driven = 0;
    for case in 0..150 {
        let period_ns = period_of(&mut random);
        let mut machine = limits(&mut random);
        let rev_s = random.log(0.8, 60.0);
        let pitch = random.log(0.2, 4.0);
        let spindle = random_spindle(&mut random, rev_s);
        let mut pass = straight(pitch, pitch * random.between(6.0, 20.0), rev_s);
        if case % 3 != 0 {
            // A taper to the limit of X, and in every third case back out of it.
            pass.legs[0].end[0] = random.between(-1.0, 1.0);
            if case % 3 == 2 {
                let mut end = pass.legs[0].end * 1.3;
                end[0] = 0.0;
                pass.legs = [
                    pass.legs[0],
                    ThreadLeg {
                        end,
                        turns: 5.0,
                        line: 3,
                    },
                ]
                .into();
            }
        }
        if pass.check(&machine, period_ns as f64 * 1e-9).is_err() {
            continue;
        }
        let far = machine;
        let ends = pass.legs.iter().map(|leg| leg.end);
        for axis in 0..AXES {
            let (low, high) = ends
                .clone()
                .fold((pass.start[axis], pass.start[axis]), |(low, high), end| {
                    (low.min(end[axis]), high.max(end[axis]))
                });
            machine.travel_min[axis] = low - gap(&mut random);
            // The axis X moves away by 3 mm afterwards.
            machine.travel_max[axis] = high + if axis == 0 { 3.0 } else { gap(&mut random) };
        }
        let end = pass.legs.last().expect("a leg").end;
        let what = format!("case {case}: {period_ns} ns, {spindle:?}, {pass:?}");
        let outcome = undisturbed(machine, period_ns, PLANNERS[case % 2], &pass, &spindle);
        let result = outcome.result.expect("a result");
        if matches!(result.verdict, ThreadVerdict::Refused(_)) {
            continue;
        }
        assert_within(&outcome.all, &machine, period_ns, &what);
        if result.verdict == ThreadVerdict::OutOfPhase {
            // These axes cannot follow this spindle anywhere.
            let far = undisturbed(far, period_ns, PLANNERS[case % 2], &pass, &spindle);
            assert_eq!(far.result.expect("a result").verdict, result.verdict, "{what}");
            continue;
        }
        driven += 1;
        assert_eq!(result.verdict, ThreadVerdict::Done, "{what}");
        assert_eq!(result.stop_position, end, "{what}");
        assert_eq!(outcome.allocations, 0, "{what}");
    }
    println!("{driven} threads");
    assert!(driven > 60, "{driven}");
}

#[test]
fn a_reversal_that_an_axis_cannot_follow_is_refused_at_rest() {
    let tap = |rate| ThreadPass {
        tap: Some(TapReturn {
            turns_per_s: 10.0,
            braking: Some(rate),
        }),
        ..straight(1.5, 15.0, 10.0)
    };
    assert!(tap(2600.0).check(&lathe(), 1e-3).is_ok());
    let refused = ThreadObjection::ReversalTooFast {
        axis: 2,
        needed: 4500.0,
        permitted: 4000.0,
    };
    assert_eq!(tap(3000.0).check(&lathe(), 1e-3), Err(refused));
    // With this jerk it lags by more than a quarter of the pitch.
    let soft = equal_axes(300.0, 4000.0, 10_000.0);
    let check = |rate| tap(rate).check(&soft, 1e-3);
    assert!(check(200.0).is_ok());
    let Err(ThreadObjection::ReversalTooSudden {
        axis: 2,
        lag_mm,
        permitted_mm: 0.375,
    }) = check(1000.0)
    else {
        unreachable!("{:?}", check(1000.0))
    };
    assert!((lag_mm - 1.25).abs() < 0.01, "{lag_mm}");
}

/// Taps that begin at most 5 um from a travel limit, and whose spindle stops before the other one.
#[test]
fn taps_that_begin_at_the_travel_keep_every_limit() {
    let seed = 0x7ead_0012;
    println!("seed {seed:#x}");
    let mut random = Random::from_state(seed);
    let (mut driven, mut refused) = (0, 0);
    for case in 0..150 {
        let period_ns = period_of(&mut random);
        let mut machine = limits(&mut random);
        let rev_s = random.log(0.8, 50.0);
        let pitch = random.log(0.2, 3.0);
        let spindle = random_spindle(&mut random, rev_s);
        let braking = (random.pick(2) == 0).then_some(spindle.torque);
        let pass = ThreadPass {
            tap: Some(TapReturn {
                turns_per_s: rev_s * random.between(0.8, 1.5),
                braking,
            }),
            ..straight(pitch, pitch * random.between(4.0, 20.0), rev_s)
        };
        if pass.check(&machine, period_ns as f64 * 1e-9).is_err() {
            continue;
        }
        let (depth, far) = (pass.legs[0].end[2], machine);
        machine.travel_max[2] = gap(&mut random);
        // From the depth on, up to twice what is needed.
        let room = random.between(0.0, 0.4) * rev_s * pitch;
        machine.travel_min[2] = depth - room;
        let what = format!("case {case}: {period_ns} ns, {spindle:?}, {pass:?}, room {room}");
        if let Err(objection) = pass.check(&machine, period_ns as f64 * 1e-9) {
            let ThreadObjection::NoOverrun {
                axis: 2,
                needed_mm,
                available_mm,
            } = objection
            else {
                unreachable!("{what}: {objection:?}")
            };
            assert!(
                needed_mm > available_mm && (available_mm - room).abs() < 1e-9,
                "{what}"
            );
            refused += 1;
            continue;
        }
        let outcome = undisturbed(machine, period_ns, PLANNERS[case % 2], &pass, &spindle);
        let result = outcome.result.expect("a result");
        assert_within(&outcome.all, &machine, period_ns, &what);
        match result.verdict {
            ThreadVerdict::Refused(_) => {}
            // The spindle needs more than expected; the axes have stopped within every limit.
            ThreadVerdict::AtTravelEnd => {
                assert!(braking.is_none(), "{what}: {result:?}");
                assert!(spindle.torque < rev_s / 0.2, "{what}: {result:?}");
            }
            ThreadVerdict::Done => {
                driven += 1;
                assert_eq!(result.stop_position, pass.start, "{what}");
                if braking.is_some() {
                    let deepest = outcome.all.iter().map(|at| at.position[2]).fold(0.0, f64::min);
                    assert!(
                        deepest <= depth + 0.02 * rev_s * pitch,
                        "{what}: it has reached {deepest}"
                    );
                }
            }
            // These axes cannot follow this spindle anywhere.
            verdict => {
                // A tap is given up for a quarter of its pitch.
                let tolerance = (0.25 * pitch).max(0.1);
                let is_in_phase = verdict == ThreadVerdict::OutOfPhase && result.worst_mm <= tolerance;
                assert!(!is_in_phase, "given up in phase: {what}: {result:?}");
                // Some axes lag more than they must, but not many times as much; but the speed of a spindle that
                // reverses within 20 samples is overestimated meanwhile.
                let needed = pitch * spindle.torque;
                let (acceleration, jerk) = (machine.acceleration[2], machine.jerk[2]);
                let lag = 2.0 / 3.0 * needed.powi(3) / (jerk * jerk);
                let is_abrupt = 2.0 * rev_s < 20.0 * SAMPLE_S * spindle.torque;
                let may_lag =
                    braking.is_none() || is_abrupt || 2.0 * needed > acceleration || lag > 0.03 * tolerance;
                assert!(may_lag, "{lag} mm: {what}: {result:?}");
                let far = undisturbed(far, period_ns, PLANNERS[case % 2], &pass, &spindle);
                assert_eq!(far.result.expect("a result").verdict, verdict, "{what}");
            }
        }
    }
    println!("{driven} taps, {refused} refused");
    assert!(driven > 40 && refused > 15, "{driven}, {refused}");
}

/// The spindle needs longer to stop than the machine file says, and the travel ends: the axes stop there.
#[test]
fn a_tap_that_overruns_to_the_travel_limit_stops_within_the_limits() {
    for period_ns in [100_000, 1_000_000, 4_000_000] {
        let spindle = Spindle {
            rev_s: 16.0,
            torque: 20.0,
            ripple: 0.01,
            delay_s: 0.002,
            ..EVEN
        };
        let mut machine = lathe();
        let pass = ThreadPass {
            tap: Some(TapReturn {
                turns_per_s: 16.0,
                braking: Some(100.0),
            }),
            ..straight(1.0, 15.0, 16.0)
        };
        machine.travel_min[2] = -15.5;
        pass.check(&machine, period_ns as f64 * 1e-9)
            .expect("room for what is known");
        let outcome = undisturbed(machine, period_ns, PlannerKind::Optimal, &pass, &spindle);
        let result = outcome.result.expect("a result");
        assert_eq!(result.verdict, ThreadVerdict::AtTravelEnd);
        assert!(result.stop_position[2] < -15.4, "{result:?}");
        assert_within(&outcome.all, &machine, period_ns, "overrun");
    }
}

/// A spindle that becomes faster than an axis can follow: the axis stays at its velocity, and the pass ends
/// when it is too far behind.
#[test]
fn a_thread_of_a_spindle_that_is_too_fast_keeps_the_velocity() {
    for period_ns in [100_000, 1_000_000, 4_000_000] {
        let spindle = Spindle {
            rev_s: 50.0,
            torque: 60.0,
            ripple: 0.01,
            delay_s: 0.002,
            ..EVEN
        };
        // 1.05 times 50 turns/s times 5.7 mm: 299.25 of 300 mm/s.
        let pass = straight(5.7, 300.0, 50.0);
        let machine = lathe();
        pass.check(&machine, period_ns as f64 * 1e-9).expect("room");
        let (faster, never) = (Trouble::Load(0.8, -0.3), f64::INFINITY);
        let kind = PlannerKind::Optimal;
        let outcome = run(machine, period_ns, kind, &pass, &spindle, faster, 0.0..0.0, never);
        let result = outcome.result.expect("a result");
        assert_eq!(result.verdict, ThreadVerdict::OutOfPhase);
        assert_within(&outcome.all, &machine, period_ns, "too fast");
    }
}

/// A spindle that brakes over more turns than the tap has is reversed before the axes start: the tap still
/// reaches its depth, and stops there.
#[test]
fn a_tap_shorter_than_the_braking_of_its_spindle_reaches_its_depth() {
    for (rev_s, torque) in [(20.0, 12.0), (20.0, 8.0), (45.0, 33.0)] {
        let spindle = Spindle {
            rev_s,
            torque,
            delay_s: 0.002,
            ..EVEN
        };
        let pass = ThreadPass {
            tap: Some(TapReturn {
                turns_per_s: rev_s,
                braking: Some(torque),
            }),
            ..straight(1.0, 10.0, rev_s)
        };
        pass.check(&lathe(), 1e-3).expect("room");
        let outcome = undisturbed(lathe(), 1_000_000, PlannerKind::Optimal, &pass, &spindle);
        let result = outcome.result.expect("a result");
        assert_eq!(result.verdict, ThreadVerdict::Done);
        let deepest = outcome.all.iter().map(|at| at.position[2]).fold(0.0, f64::min);
        println!("{rev_s} turns/s, {torque} turns/s2: {deepest} mm");
        assert!((deepest + 10.0).abs() < 0.01 * rev_s, "{deepest}");
        assert_within(&outcome.all, &lathe(), 1_000_000, "short");
    }
}
