//! Rigid tapping: into the hole and out in phase, and what ends it.

use super::*;

#[test]
fn a_tap_goes_in_and_out_in_phase_and_stops_at_its_depth() {
    for rpm in [100.0, 1000.0] {
        let rev_s = rpm / 60.0;
        let torque = 2000.0 / 60.0;
        let spindle = Spindle {
            rev_s,
            torque,
            ripple: 0.01,
            order: 1.0,
            counts: 4096.0,
            delay_s: 0.002,
            index: 0.3,
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
        assert_eq!(result.stands_at, pass.start);
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
            // Out of the hole it is faster, and its run-out longer.
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
                    // In, the spindle is even for long; out, it has its speed again for 50 ms.
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
        // By the ripple at the end, and the time that the order takes.
        assert!((deepest - 15.0).abs() < 0.02 * rev_s, "{deepest}");
    }
}

#[test]
fn a_tap_whose_spindle_does_not_turn_back_stops() {
    for braking in [None, Some(33.0)] {
        let spindle = Spindle {
            rev_s: 10.0,
            torque: 33.0,
            ripple: 0.0,
            order: 1.0,
            counts: 4096.0,
            delay_s: 0.001,
            index: 0.3,
        };
        let pass = ThreadPass {
            tap: Some(TapReturn {
                turns_per_s: 10.0,
                braking,
            }),
            ..straight(1.0, 15.0, 10.0)
        };
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
        // Two turns and the way of its braking, or half a second, and the stop.
        assert!((-23.0..-15.0).contains(&result.stands_at[2]), "{result:?}");
        assert_within(&outcome.all, &lathe(), 1_000_000, "stubborn");
    }
}
