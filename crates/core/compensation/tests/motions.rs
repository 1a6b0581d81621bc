//! Random errors and random motions at the planned limits: the corrected setpoints keep the limits of the
//! axes, and their derivatives are those of their positions.

use evolvent_compensation::{
    AxisErrors, AxisLimits, Design, MachineErrors, ScrewTable, Squareness, ThermalSettings,
};
use evolvent_path::{AXES, Axes, Jet};
use evolvent_random::{Random, cases};

use crate::curves::random_table;
use crate::profile::Profile;

/// Errors of a random machine, some of which cannot be corrected within the limits.
fn random_errors(random: &mut Random) -> MachineErrors {
    let mut errors = MachineErrors::default();
    for axis in &mut errors.axes[..3] {
        *axis = random_axis(random);
    }
    if random.below(2) == 0 {
        errors.squareness = Squareness {
            xy: random.between(-1e-3, 1e-3),
            xz: random.between(-1e-3, 1e-3),
            yz: random.between(-1e-3, 1e-3),
        };
    }
    errors
}

fn random_axis(random: &mut Random) -> AxisErrors {
    let table = (random.below(3) > 0).then(|| {
        let (positions, forward) = random_table(random);
        let lost = random.between(0.0, 0.02);
        let reverse: Vec<f64> = forward
            .iter()
            .map(|value| value - lost - random.between(0.0, 0.004))
            .collect();
        ScrewTable::new(
            &positions,
            &forward,
            (random.below(2) == 0).then_some(&reverse[..]),
        )
        .unwrap()
    });
    AxisErrors {
        backlash: if random.below(2) == 0 {
            0.0
        } else {
            random.log(1e-4, 0.1)
        },
        table,
        hysteresis: random.log(1e-5, 0.01),
        thermal: (random.below(3) == 0).then(|| ThermalSettings {
            max_offset: 0.1,
            max_offset_velocity: random.log(1e-4, 0.05),
        }),
    }
}

#[test]
fn corrected_setpoints_keep_the_limits() {
    let mut random = Random::seeded(16_704);
    let (mut run, mut refused, mut closest) = (0, 0, [0.0_f64; 3]);
    while run < cases(60) {
        let limits = AxisLimits {
            velocity: random.log(20.0, 600.0),
            acceleration: random.log(500.0, 10_000.0),
            jerk: random.log(20_000.0, 1_000_000.0),
        };
        let errors = random_errors(&mut random);
        let mut drives = [None; AXES];
        drives[..3].fill(Some(limits));
        let Ok(design) = Design::new(&errors, &drives) else {
            refused += 1;
            assert!(refused < 100 * cases(60), "almost no table can be corrected");
            continue;
        };
        run += 1;
        let period_s = random.log(0.0002, 0.002);
        let mut compensation = design.compensation(period_s, Axes::zeros());
        let chance = random.log(0.002, 0.2);
        let mut profiles: [Profile; 3] = std::array::from_fn(|i| {
            Profile::new(&design.planner_limits(i).unwrap(), period_s, chance, 300.0)
        });
        let mut past = [Axes::zeros(); 3];
        for cycle in 0..6000 {
            let mut ideal = Jet::at_rest(Axes::zeros());
            for (i, profile) in profiles.iter_mut().enumerate() {
                let at = profile.step(&mut random);
                (ideal.position[i], ideal.first[i], ideal.second[i], ideal.third[i]) =
                    (at[0], at[1], at[2], at[3]);
            }
            if random.below(500) == 0 {
                compensation.set_thermal_offset(random.below(3), random.between(-0.2, 0.2));
            }
            let corrected = compensation.step(&ideal);
            let again = compensation.corrected_position(&ideal.position);
            assert!((again - corrected.position).amax() < 1e-12);
            let back = compensation.ideal_position(&corrected.position);
            for i in 0..3 {
                assert!((back[i] - ideal.position[i]).abs() < 1e-10, "axis {i}: inverse");
            }
            let p = corrected.position;
            let d1 = (p - past[0]) / period_s;
            let d2 = (p - past[0] * 2.0 + past[1]) / period_s.powi(2);
            let d3 = (p - past[0] * 3.0 + past[1] * 3.0 - past[2]) / period_s.powi(3);
            if cycle >= 3 {
                for i in 0..3 {
                    let noise = 8.0 * f64::EPSILON * 300.0;
                    let ratios = [
                        (d1[i].abs() - noise / period_s) / limits.velocity,
                        (d2[i].abs() - 2.0 * noise / period_s.powi(2)) / limits.acceleration,
                        (d3[i].abs() - 4.0 * noise / period_s.powi(3)) / limits.jerk,
                    ];
                    for (closest, ratio) in closest.iter_mut().zip(ratios) {
                        *closest = closest.max(ratio);
                    }
                    let told = [
                        corrected.first[i].abs() / limits.velocity,
                        corrected.second[i].abs() / limits.acceleration,
                        corrected.third[i].abs() / limits.jerk,
                    ];
                    for ratio in ratios.into_iter().chain(told) {
                        assert!(
                            ratio <= 1.0 + 1e-9,
                            "axis {i}, cycle {cycle}: {ratios:?} {told:?}\n{errors:?}"
                        );
                    }
                }
            }
            past = [p, past[0], past[1]];
        }
    }
    // A lower ratio would mean an excessive reserve.
    assert!(closest.iter().all(|ratio| *ratio > 0.95), "{closest:?}");
}

/// Velocity and acceleration against central differences at 100 kHz, and jerk against differences of the
/// acceleration.
#[test]
fn derivatives_match_positions() {
    let mut random = Random::seeded(16_705);
    let mut run = 0;
    while run < 20 {
        let mut errors = random_errors(&mut random);
        errors.axes[0].thermal = None;
        run += u32::from(check_derivatives(&errors, &mut random));
    }
}

/// The same with a backlash that varies by 40 um over 30 mm, so that every term of the chain rule
/// contributes.
#[test]
fn derivatives_match_positions_with_varying_backlash() {
    let mut random = Random::seeded(16_706);
    let positions: Vec<f64> = (-20..=20).map(|i| f64::from(i) * 30.0).collect();
    let forward: Vec<f64> = (-20..=20).map(|i| 0.01 * f64::from(i & 1)).collect();
    let reverse: Vec<f64> = forward.iter().map(|value| -value).collect();
    let mut errors = MachineErrors::default();
    errors.axes[0] = AxisErrors {
        table: Some(ScrewTable::new(&positions, &forward, Some(&reverse)).unwrap()),
        hysteresis: 1e-4,
        ..AxisErrors::default()
    };
    for _ in 0..10 {
        assert!(check_derivatives(&errors, &mut random));
    }
}

/// Returns false if the errors cannot be corrected within the limits.
fn check_derivatives(errors: &MachineErrors, random: &mut Random) -> bool {
    let limits = AxisLimits {
        velocity: 300.0,
        acceleration: 4000.0,
        jerk: 100_000.0,
    };
    let mut drives = [None; AXES];
    drives[..3].fill(Some(limits));
    let Ok(design) = Design::new(errors, &drives) else {
        return false;
    };
    let period_s = 1e-5;
    let mut compensation = design.compensation(period_s, Axes::zeros());
    let mut profile = Profile::new(&design.planner_limits(0).unwrap(), period_s, 0.001, 20.0);
    let mut samples = Vec::new();
    for _ in 0..60_000 {
        let at = profile.step(random);
        let mut ideal = Jet::at_rest(Axes::zeros());
        (ideal.position[0], ideal.first[0], ideal.second[0], ideal.third[0]) = (at[0], at[1], at[2], at[3]);
        let corrected = compensation.step(&ideal);
        samples.push([
            corrected.position[0],
            corrected.first[0],
            corrected.second[0],
            corrected.third[0],
        ]);
    }
    let mut jumps = 0;
    // The acceleration of a cycle is compared where the jerk does not step.
    for three in samples.windows(3) {
        let difference = (three[2][0] - three[0][0]) / (2.0 * period_s);
        let bound = 0.6 * limits.jerk * period_s * period_s + 1e-7;
        assert!(
            (difference - three[1][1]).abs() <= bound,
            "{difference} and {three:?}"
        );
        let difference = (three[2][1] - three[0][1]) / (2.0 * period_s);
        let step = (three[2][3] - three[1][3]).abs() * period_s;
        assert!(
            (difference - three[1][2]).abs() <= 0.3 * step + 0.01,
            "{difference} and {three:?}"
        );
        let difference = (three[1][2] - three[0][2]) / period_s;
        // At a knot of the table the third derivative steps within the cycle.
        jumps += u32::from((difference - three[1][3]).abs() > 0.0005 * limits.jerk);
    }
    assert!(
        jumps < 100,
        "{jumps} cycles whose jerk differs from the difference of accelerations"
    );
    true
}
