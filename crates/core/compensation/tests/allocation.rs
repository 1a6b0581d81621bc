//! The part that runs in the cycle neither allocates nor frees.

use evolvent_compensation::{AxisErrors, AxisLimits, Design, MachineErrors, ScrewTable, ThermalSettings};
use evolvent_counting::calls;
use evolvent_path::{AXES, Axes, Jet};

#[test]
fn a_step_and_its_inverse_do_not_allocate() {
    let mut errors = MachineErrors::default();
    errors.squareness.xy = 1e-4;
    errors.axes[0] = AxisErrors {
        backlash: 0.02,
        table: Some(ScrewTable::new(&[-100.0, 0.0, 100.0], &[0.0, 0.01, 0.0], None).unwrap()),
        hysteresis: 0.001,
        thermal: Some(ThermalSettings {
            max_offset: 0.1,
            max_offset_velocity: 0.01,
        }),
    };
    let mut drives = [None; AXES];
    drives[..3].fill(Some(AxisLimits {
        velocity: 100.0,
        acceleration: 1000.0,
        jerk: 50_000.0,
    }));
    let design = Design::new(&errors, &drives).unwrap();
    let mut compensation = design.compensation(0.001, Axes::zeros());
    let before = calls();
    for cycle in 0..10_000 {
        let mut ideal = Jet::at_rest(Axes::zeros());
        ideal.position[0] = 90.0 * (f64::from(cycle) * 0.001).sin();
        compensation.set_thermal_offset(0, f64::from(cycle) * 1e-5);
        let corrected = compensation.step(&ideal);
        std::hint::black_box(compensation.ideal_position(&corrected.position));
    }
    compensation.rebase_position(&Axes::zeros());
    assert_eq!(calls(), before);
}
