//! The reserve for corrections, and errors of the design.

use evolvent_compensation::{
    AxisErrors, AxisLimits, Design, DesignError, Excess, MachineErrors, ScrewTable, ThermalSettings,
};
use evolvent_path::AXES;

const LIMITS: AxisLimits = AxisLimits {
    velocity: 500.0,
    acceleration: 5000.0,
    jerk: 200_000.0,
};

fn design(errors: &MachineErrors) -> Result<Design, DesignError> {
    let mut drives = [None; AXES];
    drives[..3].fill(Some(LIMITS));
    Design::new(errors, &drives)
}

fn with_axis(axis: AxisErrors) -> MachineErrors {
    let mut errors = MachineErrors::default();
    errors.axes[0] = axis;
    errors
}

/// 8 (B/2)/T^3 = 0.1 J gives T = (0.08/20000)^(1/3) = 15.874 ms; by hand: 1.5 0.01/T = 0.9449 mm/s, 4
/// 0.01/T^2 = 158.74 mm/s2.
#[test]
fn the_reserve_for_backlash_follows_the_formula() {
    let design = design(&with_axis(AxisErrors {
        backlash: 0.02,
        ..AxisErrors::default()
    }))
    .unwrap();
    let planner_limits = design.planner_limits(0).unwrap();
    assert!((design.take_up_s(0).unwrap() - 3.0 * 0.015_874_01).abs() < 1e-7);
    assert!(
        (planner_limits.velocity - (500.0 - 0.944_941)).abs() < 1e-5,
        "{planner_limits:?}"
    );
    assert!(
        (planner_limits.acceleration - (5000.0 - 158.740)).abs() < 1e-2,
        "{planner_limits:?}"
    );
    assert!(
        (planner_limits.jerk - 180_000.0).abs() < 1e-6,
        "{planner_limits:?}"
    );
    assert_eq!(design.planner_limits(1), Some(LIMITS));
    assert_eq!(design.planner_limits(3), None);
    assert!((design.largest_correction()[0] - 0.01).abs() < 1e-15);
}

/// Two points, 8 um over 10 mm: the slope is 8e-4, and it fades to zero on both sides with at most 1.6e-4
/// 1/mm (half-way) and 3.2e-5 1/mm2. By the chain rule at 50 mm/s.
#[test]
fn the_reserve_for_a_table_follows_the_chain_rule() {
    let table = ScrewTable::new(&[0.0, 10.0], &[0.002, -0.006], None).unwrap();
    let errors = with_axis(AxisErrors {
        table: Some(table),
        ..AxisErrors::default()
    });
    let mut drives = [None; AXES];
    drives[0] = Some(AxisLimits {
        velocity: 50.0,
        ..LIMITS
    });
    let planner_limits = Design::new(&errors, &drives).unwrap().planner_limits(0).unwrap();
    let v = 50.0 / 1.0008;
    let a = (5000.0 - 1.6e-4 * v * v) / 1.0008;
    let j = (200_000.0 - 3.0 * 1.6e-4 * v * a - 3.2e-5 * v * v * v) / 1.0008;
    assert!((planner_limits.velocity - v).abs() < 1e-9);
    assert!(
        (planner_limits.acceleration - a).abs() < 1e-9,
        "{planner_limits:?} {a}"
    );
    assert!((planner_limits.jerk - j).abs() < 1e-6, "{planner_limits:?} {j}");
}

#[test]
fn no_errors_need_no_reserve() {
    let design = design(&MachineErrors::default()).unwrap();
    assert!(design.is_none());
    assert_eq!(design.planner_limits(2), Some(LIMITS));
}

#[test]
fn squareness_reserves_the_motion_of_the_other_axes() {
    let mut errors = MachineErrors::default();
    errors.squareness.xy = -1e-3;
    errors.squareness.yz = 2e-3;
    let design = design(&errors).unwrap();
    assert!((design.planner_limits(0).unwrap().velocity - (500.0 - 0.5 - 0.001)).abs() < 1e-9);
    assert!((design.planner_limits(1).unwrap().jerk - (200_000.0 - 400.0)).abs() < 1e-9);
    assert_eq!(design.planner_limits(2), Some(LIMITS));
}

#[test]
fn an_impossible_correction_is_rejected_with_its_axis() {
    let positions: Vec<f64> = (0..40).map(f64::from).collect();
    let mut values = vec![0.0; 40];
    values[23] = 0.015;
    let table = ScrewTable::new(&positions, &values, None).unwrap();
    let refused = design(&with_axis(AxisErrors {
        table: Some(table),
        ..AxisErrors::default()
    }));
    let Err(DesignError::Reserve {
        position: Some(position),
        ..
    }) = refused
    else {
        panic!("{refused:?}")
    };
    assert!((22.0..=24.0).contains(&position), "{position}");
    values[23] = 0.4;
    let table = ScrewTable::new(&positions, &values, None).unwrap();
    let refused = design(&with_axis(AxisErrors {
        table: Some(table),
        ..AxisErrors::default()
    }));
    assert!(matches!(refused, Err(DesignError::Slope { .. })), "{refused:?}");
    for backlash in [-0.01, f64::NAN, 11.0] {
        let refused = design(&with_axis(AxisErrors {
            backlash,
            ..AxisErrors::default()
        }));
        assert!(matches!(refused, Err(DesignError::Value { .. })));
    }
    let mut errors = MachineErrors::default();
    errors.squareness.xz = 0.02;
    assert!(design(&errors).is_err());
    let slow = AxisLimits {
        velocity: 0.02,
        ..LIMITS
    };
    let mut drives = [None; AXES];
    drives[0] = Some(slow);
    let thermal = with_axis(AxisErrors {
        thermal: Some(ThermalSettings {
            max_offset: 0.1,
            max_offset_velocity: 0.015,
        }),
        ..AxisErrors::default()
    });
    assert!(matches!(
        Design::new(&thermal, &drives),
        Err(DesignError::Reserve {
            quantity: Excess::Velocity,
            ..
        })
    ));
}
