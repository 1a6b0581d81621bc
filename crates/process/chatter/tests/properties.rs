//! Identities: symmetry, energy, convergence.

use evolvent_chatter::{
    Accuracy, Assessor, ChatterError, CuttingTool, Integrator, Mapper, Model, PrincipalAxis, Scanner, State,
    verify,
};
use nalgebra::SVector;

use crate::common::{campaign, near, steel, tool};

/// With equal axes every direction is a principal one: the angle has no effect.
#[test]
fn with_equal_axes_the_angle_does_not_matter() {
    let law = steel();
    let (mut random, cases) = campaign(0x0c4a_0001, 12);
    for _ in 0..cases {
        let axis = PrincipalAxis::with_ratio(
            random.between(2.0, 8.0),
            random.between(1e7, 3e7),
            random.between(0.005, 0.03),
        );
        let base = CuttingTool {
            axes: [axis; 2],
            speed_m_min: random.between(42.0, 60.0),
            depth_mm: random.between(1.0, 4.0),
            radial_ratio: random.between(0.1, 0.8),
            ..tool(60.0, 0.02)
        };
        let at = |beta_deg: f64| {
            let model = Model::new(CuttingTool { beta_deg, ..base }, &law).unwrap();
            let prediction = Scanner::new(3).scan(&model).unwrap();
            let speeds: Vec<(f64, f64, f64)> = prediction
                .cycles()
                .map(|cycle| {
                    (
                        cycle.frequency_hz,
                        cycle.speed_amplitude_m_min(&model),
                        cycle.depth_mm[0],
                    )
                })
                .collect();
            (prediction.equilibrium, prediction.branches.len(), speeds)
        };
        let (rest, branches, cycles) = at(0.0);
        let beta = random.between(-180.0, 180.0);
        let (turned, other_branches, other_cycles) = at(beta);
        near(turned.force_n, rest.force_n, 1e-12, "force");
        assert_eq!(
            (branches, cycles.len()),
            (other_branches, other_cycles.len()),
            "beta {beta}"
        );
        for (a, b) in rest.modes.iter().zip(&turned.modes) {
            assert!((a.growth_per_s - b.growth_per_s).abs() < 1e-6, "{a:?} {b:?}");
            near(b.frequency_hz, a.frequency_hz, 1e-9, "small frequency");
        }
        for (a, b) in cycles.iter().zip(&other_cycles) {
            near(b.0, a.0, 1e-9, "frequency");
            near(b.1, a.1, 1e-7, "amplitude");
        }
    }
}

/// Over a cycle the work of the force equals the energy that the dampers absorb.
#[test]
fn force_work_balances_damping_over_a_cycle() {
    let law = steel();
    let (mut random, cases) = campaign(0x0c4a_0002, 10);
    let mut count = 0;
    for _ in 0..cases {
        let case = CuttingTool {
            depth_mm: random.between(1.5, 4.0),
            beta_deg: random.between(0.0, 60.0),
            ..tool(random.between(42.0, 70.0), random.between(0.01, 0.02))
        };
        let model = Model::new(case, &law).unwrap();
        let prediction = Scanner::new(9).scan(&model).unwrap();
        for cycle in prediction.cycles() {
            let (mut work, mut loss) = (0.0, 0.0);
            for k in 0..256 {
                let state = cycle.state(f64::from(k) / 256.0);
                let rate = model.derivative(&state).unwrap();
                for i in 0..2 {
                    let axis = &case.axes[i];
                    let velocity = state[i + 2];
                    let damper = axis.damping_ns_m * velocity;
                    let force = axis.mass_kg * rate[i + 2] + damper + axis.stiffness_n_m * state[i];
                    work += force * velocity;
                    loss += damper * velocity;
                }
            }
            near(work, loss, 2e-4, "work over loss");
            count += 1;
        }
    }
    assert!(count > cases / 3);
}

/// At a vanishing amplitude the extra damping that balances the motion is twice the growth, except for
/// damping.
#[test]
fn branch_starts_at_growth_of_small_vibrations() {
    let law = steel();
    for speed in [30.0, 45.0, 60.0, 90.0] {
        let model = Model::new(tool(speed, 0.02), &law).unwrap();
        let prediction = Scanner::new(3).scan(&model).unwrap();
        for branch in &prediction.branches {
            // With additional damping proportional to mass, the equations are those of a shifted eigenvalue.
            let start = branch.points[0];
            near(start.extra_per_s, 2.0 * branch.mode.growth_per_s, 0.03, "start");
            assert_eq!(start.extra_per_s > 0.0, branch.mode.growth_per_s > 0.0);
        }
    }
}

/// A damped oscillator has a closed form.
#[test]
fn the_integrator_keeps_its_accuracy() {
    let (zeta, omega) = (0.01, 1600.0);
    let exact = |t: f64| {
        let damped = omega * f64::sqrt(1.0 - zeta * zeta);
        let decay = f64::exp(-zeta * omega * t);
        decay * (f64::cos(damped * t) + zeta * omega / damped * f64::sin(damped * t))
    };
    let mut rate = |x: &SVector<f64, 2>| {
        Ok::<_, ChatterError>(SVector::<f64, 2>::new(
            x[1],
            -omega * omega * x[0] - 2.0 * zeta * omega * x[1],
        ))
    };
    let mut errors = Vec::new();
    for relative in [1e-5, 1e-7, 1e-9] {
        let mut integrator = Integrator::<2>::new(Accuracy {
            relative,
            absolute: 1e-3 * relative,
            longest_step_s: 1.0,
        });
        let end = integrator
            .run(SVector::<f64, 2>::new(1.0, 0.0), 0.1, &mut rate, &|_| 1.0)
            .unwrap();
        let error = (end[0] - exact(0.1)).abs();
        // 25 oscillations.
        assert!(error < 300.0 * relative, "{relative}: {error}");
        errors.push(error);
    }
    assert!(errors[2] < 1e-3 * errors[0]);
}

/// A ball on an elastic floor (inaccurate without events): the stages must not straddle the corner.
#[test]
fn steps_end_at_events() {
    // Falls freely, pushed back by a spring below zero: energy is conserved.
    let mut rate = |x: &SVector<f64, 2>| {
        Ok::<_, ChatterError>(SVector::<f64, 2>::new(
            x[1],
            if x[0] < 0.0 { -9.81 - 1e6 * x[0] } else { -9.81 },
        ))
    };
    let event = |x: &SVector<f64, 2>| x[0];
    let accuracy = Accuracy {
        relative: 1e-9,
        absolute: 1e-12,
        longest_step_s: 0.05,
    };
    let energy = |x: &SVector<f64, 2>| 0.5 * x[1] * x[1] + 9.81 * x[0] + 0.5e6 * x[0].min(0.0).powi(2);
    let start = SVector::<f64, 2>::new(1.0, 0.0);
    let mut with = Integrator::<2>::new(accuracy);
    let end = with.run(start, 5.0, &mut rate, &event).unwrap();
    let lost = (energy(&end) / energy(&start) - 1.0).abs();
    let mut without = Integrator::<2>::new(accuracy);
    let end = without.run(start, 5.0, &mut rate, &|_| 1.0).unwrap();
    let lost_without = (energy(&end) / energy(&start) - 1.0).abs();
    assert!(lost < 1e-7 && lost < 0.5 * lost_without, "{lost} {lost_without}");
}

/// The multipliers of the verification equal those of a finite difference of the motion.
#[test]
fn leading_multiplier_matches_disturbed_motion() {
    let law = steel();
    let model = Model::new(tool(100.0, 0.008), &law).unwrap();
    let prediction = Scanner::new(9).scan(&model).unwrap();
    let cycle = prediction.cycles().next().unwrap();
    let exact = verify(&model, cycle, 1e-10).unwrap();
    let accuracy = Accuracy {
        relative: 1e-11,
        absolute: 1e-16,
        longest_step_s: 1e-4,
    };
    let run = |start: State, periods: f64| {
        let mut rate = |state: &State| model.derivative(state);
        let mut integrator = Integrator::<4>::new(accuracy);
        integrator
            .run(start, periods / exact.frequency_hz, &mut rate, &|_| 1.0)
            .unwrap()
    };
    // Let the fast component decay first.
    let disturbed = run(exact.state + State::new(0.0, 1e-9, 0.0, 0.0), 30.0);
    let (undisturbed, later) = (run(exact.state, 30.0), run(disturbed, 20.0));
    let rate = model.derivative(&undisturbed).unwrap();
    let across = |difference: State| {
        // Without the component along the motion, in comparable units.
        let unit = State::new(1.0, 1.0, 1.0 / 1600.0, 1.0 / 1600.0);
        let (d, r) = (difference.component_mul(&unit), rate.component_mul(&unit));
        (d - r * (d.dot(&r) / r.dot(&r))).norm()
    };
    let growth = across(later - run(undisturbed, 20.0)) / across(disturbed - undisturbed);
    near(
        growth.powf(0.05),
        exact.multipliers[0].re,
        1e-3,
        "growth a period",
    );
}

/// Two roots that one harmonic misses, because its extra damping only comes near zero there.
#[test]
fn cycles_that_only_graze_zero_are_found() {
    let law = steel();
    let mut mapper = Mapper::new(5);
    for (speed, depth) in [
        (108.103_448_275_862_06, 1.4),
        (112.758_620_689_655_17, 1.4),
        (122.068_965_517_241_38, 1.6),
    ] {
        let case = CuttingTool {
            depth_mm: depth,
            ..tool(speed, 0.002)
        };
        let model = Model::new(case, &law).unwrap();
        let whole = Assessor::new(5).assess(&model).unwrap();
        assert_eq!(
            mapper.cell(case, &law).verdict,
            Some(whole.verdict),
            "{speed} m/min"
        );
        assert!(whole.largest_stable().is_some());
    }
}
