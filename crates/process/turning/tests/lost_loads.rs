//! A load that vanishes while there is stock: a broken insert, or a sensor that reads zero.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test may fail, and prints its figures"
)]

use evolvent_turning::{
    Blank, Reason, SensorFault, Simulation, TurningInputs, TurningSettings, TurningState,
};

use crate::common::{
    Limits, PERIOD_S, Random, TURN_S, cases, fast, literal, random_rough_stock, random_stock, safe,
};
use crate::protection::{RUN, run_for, run_out, simulation};

/// Runs on with a load of zero. Returns the reason of the fault, the longest time in revolutions for which
/// the tool was fed into stock without being drawn back, and whether the job ended as done.
fn lose_load(mut sim: Simulation, mut limits: Limits) -> (Option<Reason>, f64, bool) {
    let turn_s = sim.controller.settings().turn_s();
    let (mut reason, mut turns, mut max) = (None, 0.0, 0.0_f64);
    while !sim.controller.is_over() && sim.figures.time_s < 3000.0 {
        let (output, cut) = sim.step(RUN, Some(SensorFault::Zero));
        limits.check(&output);
        let cuts = cut.depth_mm > 0.5 && output.along.velocity > 0.0 && reason.is_none();
        turns += f64::from(u8::from(cuts)) * PERIOD_S / turn_s;
        // The tool has been drawn back; counting restarts when it enters again.
        if matches!(output.state, TurningState::Return | TurningState::ReEnter) {
            turns = 0.0;
        }
        max = max.max(turns);
        if let Some(transition) = output.transition
            && transition.to == TurningState::Fault
        {
            reason = Some(transition.reason);
        }
    }
    (reason, max, sim.controller.state() == TurningState::Done)
}

#[test]
fn a_load_that_goes_away_after_a_shoulder_is_a_fault() {
    for (case, settings) in [safe(), fast(), literal()].into_iter().enumerate() {
        for height in [5.5, 8.0, 10.0] {
            let mut sim = simulation(settings, Blank::uniform(height), case as u64);
            let mut limits = Limits::new(&settings);
            while sim.controller.state() != TurningState::BackOff {
                limits.check(&sim.step(RUN, None).0);
            }
            let (reason, turns, _) = lose_load(sim, limits);
            let what = format!("{height} mm, settings {case}: {reason:?} after {turns} revolutions");
            assert!(matches!(reason, Some(Reason::BrokenInsert { .. })), "{what}");
            assert!(turns < 1.5, "{what}");
        }
    }
}

#[test]
fn a_load_lost_after_slots_is_not_done() {
    // The mean of a revolution is far below the cut between the slots, so the height of the shoulder is not
    // sure.
    let blank = Blank {
        runout_mm: 0.3,
        slots: vec![(0.02, 0.18), (0.39, 0.50), (0.71, 0.75)],
        ..Blank::outline(&[(0.0, 9.1), (113.0, 2.7), (200.0, 2.7)])
    };
    for (case, settings) in [safe(), fast(), literal()].into_iter().enumerate() {
        let mut sim = simulation(settings, blank.clone(), 5);
        let mut limits = Limits::new(&settings);
        let mut before = TurningState::Idle;
        let mut shoulders = 0;
        while !sim.controller.is_over() {
            let (output, _) = sim.step(RUN, None);
            limits.check(&output);
            let leaves = before == TurningState::BackOff && output.state == TurningState::Approach;
            before = output.state;
            if leaves {
                let (reason, _, done) = lose_load(sim.clone(), limits.clone());
                let what = format!("settings {case}, shoulder {shoulders}: {reason:?}");
                assert!(!done && reason.is_some(), "{what}");
                shoulders += 1;
            }
        }
        assert_eq!(sim.controller.state(), TurningState::Done, "settings {case}");
        assert!(shoulders > 0, "settings {case}");
    }
}

#[test]
fn load_lost_in_a_cut_faults_in_two_revolutions() {
    let mut random = Random::seeded(11);
    let (mut reported, mut max, mut silent) = (0, 0.0_f64, 0);
    let count = cases(6);
    for case in 0..count {
        let settings = [safe(), fast(), literal()][case % 3];
        let blank = random_stock(&mut random);
        let mut sim = simulation(settings, blank.clone(), case as u64);
        let mut limits = Limits::new(&settings);
        let mut next_s = random.between(0.0, 6.0);
        // Depths of the last revolution.
        let mut depths = vec![0.0; (TURN_S / PERIOD_S) as usize];
        while !sim.controller.is_over() {
            let (output, cut) = sim.step(RUN, None);
            limits.check(&output);
            depths.rotate_left(1);
            *depths.last_mut().unwrap() = cut.depth_mm;
            if sim.figures.time_s < next_s {
                continue;
            }
            let cutting = matches!(output.state, TurningState::Cut | TurningState::Engage);
            // A depth that an edge does not leave within a revolution, and stock that continues ahead.
            let ahead = sim.piece.height_mm((output.along.position + 8.0).min(199.9));
            if !cutting || depths.iter().any(|depth| *depth < 1.5) || ahead < output.out.position + 1.5 {
                continue;
            }
            next_s += random.between(2.0, 25.0);
            let before = sim.clone();
            let (reason, turns, done) = lose_load(sim.clone(), limits.clone());
            let what = format!(
                "case {case} at {:.3} s, {:?}, {:.2} mm deep at {:.3} mm/rev, {:.2} mm along, {blank:?}: \
                 {reason:?} after {turns:.2} revolutions",
                before.figures.time_s, output.state, cut.depth_mm, output.feed_mm_rev, output.along.position
            );
            assert!(!done, "{what}");
            assert!(matches!(reason, Some(Reason::BrokenInsert { .. })), "{what}");
            assert!(turns < 1.25, "{what}");
            max = max.max(turns);
            reported += 1;
        }
        silent += usize::from(sim.controller.state() != TurningState::Done);
    }
    println!(
        "{count} stocks: told {reported} times, after {max:.2} revolutions at most, {silent} jobs not done \
         without a loss"
    );
    assert!(reported > 2 * count && silent == 0, "{reported} {silent}");
}

#[test]
fn load_lost_just_before_a_cut_ends_is_a_fault() {
    // A mean depth that falls with the load is not a thin position, and a part of a revolution that exceeds
    // it is not a deeper cut.
    let stocks = [
        (
            fast(),
            Blank::outline(&[
                (0.0, 8.873),
                (107.16, 7.421),
                (156.18, 7.421),
                (156.18, 3.427),
                (200.0, 3.47),
            ]),
        ),
        (
            safe(),
            Blank::outline(&[
                (0.0, 5.039),
                (61.76, 5.039),
                (61.76, 1.789),
                (85.71, 1.484),
                (85.71, 6.764),
                (124.31, 6.764),
                (200.0, 3.4),
            ]),
        ),
        (safe(), Blank::uniform(4.9)),
    ];
    let (mut reported, mut max) = (0, 0.0_f64);
    for (case, (settings, blank)) in stocks.into_iter().enumerate() {
        let new = || simulation(settings, blank.clone(), case as u64);
        let mut sim = new();
        let mut leaves_s = Vec::new();
        let (_, _) = sim.run(3000.0, |output, _| {
            if let Some(transition) = output.transition
                && matches!(transition.reason, Reason::TooThin { .. } | Reason::TooDeep { .. })
                && transition.from == TurningState::Cut
            {
                leaves_s.push(transition.cycle as f64 * PERIOD_S);
            }
        });
        let mut sim = new();
        let mut limits = Limits::new(&settings);
        for leave_s in leaves_s {
            while sim.figures.time_s < leave_s - 1.3 * TURN_S {
                limits.check(&sim.step(RUN, None).0);
            }
            for before in 0..10 {
                run_for(&mut sim, 0.1 * TURN_S, &mut limits);
                let (output, cut) = sim.step(RUN, None);
                limits.check(&output);
                if output.state != TurningState::Cut || cut.depth_mm < 1.5 {
                    continue;
                }
                let (reason, turns, done) = lose_load(sim.clone(), limits.clone());
                let what = format!(
                    "stock {case}, left at {leave_s:.3} s, lost at {:.3} s ({before}), {:.2} mm deep: \
                     {reason:?} after {turns:.2} revolutions",
                    sim.figures.time_s, cut.depth_mm
                );
                assert!(
                    !done && matches!(reason, Some(Reason::BrokenInsert { .. })),
                    "{what}"
                );
                assert!(turns < 1.25, "{what}");
                max = max.max(turns);
                reported += 1;
            }
        }
    }
    println!("told {reported} times, after {max:.2} revolutions at most");
    assert!(reported > 20, "{reported}");
}

#[test]
fn no_job_is_done_without_load_while_stock_stands() {
    let mut random = Random::seeded(12);
    let (mut reported, mut states) = (0, [0_u32; 10]);
    let count = cases(6);
    for case in 0..count {
        let settings = [safe(), fast(), literal()][case % 3];
        let mut blank = if case % 2 == 0 {
            random_stock(&mut random)
        } else {
            random_rough_stock(&mut random)
        };
        // In a gap, a dead sensor is indistinguishable from the gap.
        blank.grooves_mm.clear();
        let mut sim = simulation(settings, blank.clone(), case as u64);
        let mut limits = Limits::new(&settings);
        let mut next_s = random.between(0.0, 6.0);
        while !sim.controller.is_over() {
            let (output, _) = sim.step(RUN, None);
            limits.check(&output);
            if sim.figures.time_s < next_s {
                continue;
            }
            next_s += random.between(1.0, 15.0);
            let left_mm = sim.piece.residual_mm();
            if left_mm < 1.0 {
                continue;
            }
            let (reason, _, done) = lose_load(sim.clone(), limits.clone());
            let what = format!(
                "case {case} at {:.3} s, {:?} of pass {}, {:.2} mm along, {:.2} mm out, {left_mm:.2} mm \
                 stand, {blank:?}: {reason:?}",
                sim.figures.time_s, output.state, output.pass, output.along.position, output.out.position
            );
            assert!(!done && reason.is_some(), "{what}");
            reported += 1;
            states[output.state as usize] += 1;
        }
    }
    println!("{count} stocks: told {reported} times, by state {states:?}");
    assert!(reported > 5 * count, "{reported}");
}

#[test]
fn a_job_restarted_without_load_fails_again() {
    let settings = safe();
    for (fault, reading) in [(SensorFault::Zero, "zero"), (SensorFault::Lost, "nothing")] {
        let mut sim = simulation(settings, Blank::uniform(8.0), 3);
        run_for(&mut sim, 40.0, &mut Limits::new(&settings));
        while !sim.controller.is_over() {
            sim.step(RUN, Some(fault));
        }
        for _ in 0..3 {
            sim.step(TurningInputs { start: false, ..RUN }, Some(SensorFault::Zero));
            let (_, turns, done) = lose_load(sim.clone(), Limits::new(&settings));
            assert!(!done && turns < 6.0, "{reading}: {turns} revolutions");
        }
        // With a working sensor the job reaches its size.
        sim.step(TurningInputs { start: false, ..RUN }, None);
        let reason = run_out(&mut sim, &mut Limits::new(&settings));
        assert_eq!(reason, Some(Reason::AtSize), "{reading}");
        assert!(sim.piece.residual_mm() <= 0.1, "{reading}");
    }
}

#[test]
fn load_lost_between_passes_faults_on_short_stock() {
    let (mut reported, mut max) = (0, 0.0_f64);
    for length_mm in [2.0, 4.0, 6.0, 9.0, 14.0, 40.0] {
        for height in [1.5, 4.0, 7.0, 10.0] {
            for (case, base) in [safe(), fast(), literal()].into_iter().enumerate() {
                for beyond_mm in [0.0, f64::INFINITY] {
                    let settings = TurningSettings {
                        length_mm,
                        beyond_mm,
                        ..base
                    };
                    let mut sim = simulation(settings, Blank::uniform(height), case as u64);
                    let mut limits = Limits::new(&settings);
                    let mut before = TurningState::Idle;
                    while !sim.controller.is_over() {
                        let (output, _) = sim.step(RUN, None);
                        limits.check(&output);
                        let leaves = output.state != before
                            && matches!(output.state, TurningState::Return | TurningState::ReEnter)
                            && output.pass > 0;
                        before = output.state;
                        let left_mm = sim.piece.residual_mm();
                        if !leaves || left_mm < 1.0 {
                            continue;
                        }
                        let (reason, turns, done) = lose_load(sim.clone(), limits.clone());
                        let what = format!(
                            "{length_mm} mm, {height} mm high, settings {case}, wall {beyond_mm}, pass {}, \
                             {left_mm:.2} mm left: {reason:?} after {turns:.2} revolutions",
                            output.pass
                        );
                        assert!(
                            !done && matches!(reason, Some(Reason::BrokenInsert { .. })),
                            "{what}"
                        );
                        // Counted from where the outer end of the edge enters the stock, at a small feed.
                        assert!(turns < 6.0, "{what}");
                        reported += 1;
                        max = max.max(turns);
                    }
                    assert_eq!(sim.controller.state(), TurningState::Done);
                }
            }
        }
    }
    println!("told {reported} times, after {max:.2} revolutions at most");
    assert!(reported > 100, "{reported}");
}
