//! Passes that end on a cone: for any stock, the cone is at size in the end and is never undercut.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test may fail, and prints its figures"
)]

use evolvent_turning::{
    Blank, Cone, Figures, Reason, SensorFault, SettingsError, Simulation, TurningInputs, TurningSettings,
    TurningState,
};

use crate::common::{
    Limits, Part, Random, SET, cases, fast, law, literal, random_rough_stock, random_stock, safe, sensor,
};

/// Turns the blank and checks all but the load. Returns the figures, the largest load on the cone, and the
/// number of climbs; `None` if the stock ends in a fault without a cone as well.
fn turn(settings: TurningSettings, blank: &Blank, seed: u64) -> Option<(Figures, f64, usize)> {
    let cone = settings.cone.unwrap();
    let mut limits = Limits::new(&settings);
    let mut part = Part::new(&settings, blank);
    let mut simulation = Simulation::new(settings, blank.clone(), law(), sensor(seed)).unwrap();
    let (mut log, mut climbs) = (String::new(), 0);
    let mut peak = 0.0_f64;
    let (figures, _) = simulation.run(3000.0, |output, cut| {
        if output.state == TurningState::Climb {
            peak = peak.max(cut.load);
            let speed = output.along.velocity.hypot(output.out.velocity);
            assert!(
                speed <= 1.000_001 * settings.speed_mm_s(0.7),
                "{speed}: {output:?}"
            );
        }
        limits.check(output);
        part.cut(output.along.position, output.out.position);
        if let Some(transition) = output.transition {
            log += &format!("{transition:?}\n");
            climbs += usize::from(transition.to == TurningState::Climb);
        }
    });
    if !figures.done {
        let cylinder = TurningSettings {
            cone: None,
            ..settings
        };
        let mut simulation = Simulation::new(cylinder, blank.clone(), law(), sensor(seed)).unwrap();
        let (figures, _) = simulation.run(3000.0, |_, _| {});
        assert!(!figures.done, "{cone:?} {blank:?}\n{log}");
        return None;
    }
    assert!(
        part.deepest() <= 1e-9,
        "cut {} into the cone: {cone:?} {blank:?}\n{log}",
        part.deepest()
    );
    let left = part.left();
    assert!(left <= 0.1, "{left} mm left: {cone:?} {blank:?}\n{log}");
    Some((figures, peak, climbs))
}

fn with_cone(settings: TurningSettings, from_mm: f64, angle_deg: f64) -> TurningSettings {
    TurningSettings {
        cone: Some(Cone::new(from_mm, angle_deg)),
        ..settings
    }
}

#[test]
fn a_cylinder_and_a_cone_come_out_of_a_bar() {
    for settings in [safe(), fast(), literal()] {
        for (from, angle) in [
            (180.0, 15.0),
            (150.0, 5.0),
            (195.0, 45.0),
            (0.0, 2.0),
            (196.0, 58.9),
        ] {
            let settings = with_cone(settings, from, angle);
            let (figures, _, climbs) = turn(settings, &Blank::uniform(8.0), 5).unwrap();
            println!("{from} {angle}: {figures:?}, {climbs} climbs");
            assert!(climbs > 0);
            let literal = settings.overload_n > 5000.0;
            assert!(
                figures.peak <= if literal { 1.75 } else { 1.25 } * SET,
                "{figures:?}"
            );
        }
    }
}

#[test]
fn random_stocks_leave_a_cone_at_size_and_whole() {
    let seed = 0x5eed_c0e5_u64;
    let mut random = Random::from_state(seed);
    let (mut worst, mut backed, mut faults) = (0.0_f64, 0, 0);
    for case in 0..cases(60) {
        let blank = if random.unit() < 0.3 {
            random_rough_stock(&mut random)
        } else {
            random_stock(&mut random)
        };
        let base = if random.unit() < 0.5 { safe() } else { fast() };
        let base = TurningSettings {
            strategy: match random.unit() {
                x if x < 0.5 => base.strategy,
                _ => evolvent_turning::Strategy::fast(&base.regime, false),
            },
            ..base
        };
        let angle = 0.5 + 58.0 * random.unit().powi(2);
        let longest = (10.0 / angle.to_radians().tan()).min(199.0);
        let settings = with_cone(base, 200.0 - longest * random.unit(), angle);
        let Some((figures, peak, _)) = turn(settings, &blank, case as u64) else {
            faults += 1;
            continue;
        };
        backed += figures.back_offs;
        if peak / SET > worst {
            worst = peak / SET;
            println!("case {case}: peak {worst:.3} {:?} {blank:?}", settings.cone);
        }
    }
    println!(
        "seed {seed:#x}: worst load on the cone {worst:.3}, {backed} times backed off, {faults} stocks that \
         fault without a cone as well"
    );
    assert!(50 * faults <= cases(60), "{faults}");
    assert!(worst <= 1.4, "{worst}");
}

#[test]
fn a_cone_that_the_edge_would_cut_into_is_refused() {
    let settings = with_cone(safe(), 150.0, 59.5);
    assert!(matches!(
        settings.check(),
        Err(SettingsError::Cone(error)) if (error.max_deg - 59.0).abs() < 1e-9
    ));
    assert!(with_cone(safe(), 196.0, 58.9).check().is_ok());
    assert!(with_cone(safe(), 201.0, 30.0).check().is_err());
    assert!(with_cone(safe(), 150.0, f64::NAN).check().is_err());
}

#[test]
fn a_hold_on_the_cone_stands_on_it_and_goes_on() {
    let settings = with_cone(safe(), 180.0, 20.0);
    let blank = Blank::uniform(7.0);
    let mut simulation = Simulation::new(settings, blank.clone(), law(), sensor(3)).unwrap();
    let mut limits = Limits::new(&settings);
    let mut part = Part::new(&settings, &blank);
    let (mut holds, mut climbing, mut hold) = (0, 0, 0);
    let mut before = TurningState::Idle;
    for _ in 0..1_000_000 {
        let inputs = TurningInputs {
            hold: hold > 0,
            ..TurningInputs::default()
        };
        let (output, _) = simulation.step(inputs, None);
        limits.check(&output);
        part.cut(output.along.position, output.out.position);
        hold = (hold - 1).max(0);
        if output.state == TurningState::Climb && before == TurningState::Held {
            assert!(output.feed_mm_rev <= 0.2, "{output:?}");
        }
        before = output.state;
        climbing = if output.state == TurningState::Climb {
            climbing + 1
        } else {
            0
        };
        if climbing == 300 {
            (hold, holds) = (400, holds + 1);
        }
        if simulation.controller.is_over() {
            break;
        }
    }
    assert_eq!(simulation.controller.state(), TurningState::Done);
    assert!(holds >= 2, "{holds}");
    assert!(
        part.deepest() <= 1e-9 && part.left() <= 0.1,
        "{} {}",
        part.deepest(),
        part.left()
    );
}

#[test]
fn a_load_that_dies_on_the_cone_is_a_fault() {
    let seed = 0x5eed_dead_u64;
    let mut random = Random::from_state(seed);
    let (mut count, mut faults) = (0, 0);
    for case in 0..cases(40) {
        let settings = with_cone(safe(), 175.0, 5.0 + 16.0 * random.unit());
        let blank = Blank::uniform(4.0 + 4.0 * random.unit());
        let mut simulation = Simulation::new(settings, blank, law(), sensor(case as u64)).unwrap();
        let (mut cut_s, mut dead, mut fault_at) = (0.0, None, None);
        // In a third of the cases from the first cycle of the climb: nothing has been felt on the cone yet.
        let wait = match random.unit() {
            x if x < 0.33 => 0.0,
            x => 0.3 + x,
        };
        let mut depth = 0.0;
        for _ in 0..2_000_000 {
            let fault = dead.map(|_| SensorFault::Zero);
            let (output, cut) = simulation.step(TurningInputs::default(), fault);
            // Stock before the tip, even while no chip has formed.
            let depth_here = simulation.piece.height_mm(output.along.position + 1.0) - output.out.position;
            if output.state == TurningState::Climb {
                cut_s += settings.period_s;
            } else {
                cut_s = 0.0;
            }
            if dead.is_none() && cut_s > wait && depth_here.max(cut.depth_mm) > 2.5 {
                (dead, depth) = (Some(output.along.position), depth_here.max(cut.depth_mm));
            }
            if output.state == TurningState::Fault {
                fault_at = Some((output.along.position, output.transition.map(|t| t.reason)));
                break;
            }
            if simulation.controller.is_over() {
                break;
            }
        }
        if let Some(at) = dead {
            count += 1;
            let Some((fault, reason)) = fault_at else {
                panic!("case {case}: no fault though {depth} mm stood at {at}");
            };
            faults += 1;
            assert!(
                matches!(reason, Some(Reason::BrokenInsert { .. } | Reason::Sensor(_))),
                "{reason:?}"
            );
            assert!(fault - at < 2.0 * 0.7, "{at} to {fault}");
        }
    }
    println!("seed {seed:#x}: {faults} of {count}");
    assert!(count >= 10, "{count}");
}

#[test]
fn stock_steeper_than_the_cone_causes_backing_off() {
    let blank = Blank::outline(&[(0.0, 3.0), (150.0, 3.0), (170.0, 10.0), (200.0, 10.0)]);
    for settings in [safe(), fast()] {
        let settings = with_cone(settings, 140.0, 2.0);
        let (figures, peak, _) = turn(settings, &blank, 11).unwrap();
        assert!(peak <= 1.3 * SET && figures.back_offs > 0, "{peak} {figures:?}");
        let mut simulation = Simulation::new(settings, blank.clone(), law(), sensor(11)).unwrap();
        let mut from_cone = 0;
        simulation.run(3000.0, |output, _| {
            if let Some(change) = output.transition
                && (change.from, change.to) == (TurningState::Climb, TurningState::BackOff)
            {
                from_cone += 1;
            }
        });
        assert!(from_cone > 0);
    }
}

#[test]
fn a_jam_on_the_cone_retracts_and_can_continue() {
    let settings = with_cone(safe(), 175.0, 15.0);
    let blank = Blank::uniform(6.0);
    let mut simulation = Simulation::new(settings, blank.clone(), law(), sensor(2)).unwrap();
    let mut limits = Limits::new(&settings);
    let mut part = Part::new(&settings, &blank);
    let (mut climbing, mut jammed, mut start) = (0, None, true);
    let mut drawn_mm = 0.0_f64;
    for _ in 0..1_000_000 {
        let inputs = TurningInputs {
            start,
            ..TurningInputs::default()
        };
        let (output, _) = simulation.step(inputs, None);
        limits.check(&output);
        part.cut(output.along.position, output.out.position);
        climbing += u32::from(output.state == TurningState::Climb);
        if jammed.is_none() && climbing > 500 {
            simulation.jam(2.0 * SET);
            if output.state == TurningState::Fault {
                jammed = Some((output.along.position, output.out.position));
            }
        }
        if let Some((along, out)) = jammed
            && output.state == TurningState::Fault
        {
            assert!(output.along.position <= along + 0.5, "{output:?}");
            drawn_mm = drawn_mm.max(output.out.position - out);
            // Released once, then pressed again.
            start = !(simulation.controller.is_over() && start);
        } else {
            start = true;
        }
        if output.state == TurningState::Done {
            break;
        }
    }
    assert!(drawn_mm >= settings.clear_out_mm, "{drawn_mm}");
    assert_eq!(simulation.controller.state(), TurningState::Done);
    assert!(part.deepest() <= 1e-9 && part.left() <= 0.1);
}
