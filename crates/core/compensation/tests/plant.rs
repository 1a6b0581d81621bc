//! A machine with backlash and a screw of wrong pitch, driven with and without correction.

use evolvent_compensation::{AxisErrors, AxisLimits, Design, MachineErrors, ScrewTable, Squareness};
use evolvent_path::{AXES, Axes, Jet};

const PERIOD_S: f64 = 0.001;
const BACKLASH: f64 = 0.02;

/// A nut with backlash on a screw of wrong pitch; X and Y are not perpendicular.
struct Plant {
    slides: [f64; 2],
    squareness: Squareness,
}

fn screw_error(position: f64) -> f64 {
    0.008 * (position / 25.0).sin() + 0.00004 * position
}

impl Plant {
    fn drive(&mut self, motors: &Axes) -> [f64; 2] {
        for (slide, motor) in self.slides.iter_mut().zip(motors.iter()) {
            *slide = slide.clamp(motor - 0.5 * BACKLASH, motor + 0.5 * BACKLASH);
        }
        let [x, y] = self.slides.map(|slide| slide + screw_error(slide));
        [x + self.squareness.xy * y, y]
    }
}

fn errors() -> MachineErrors {
    let positions: Vec<f64> = (-20..=20).map(|i| f64::from(i) * 5.0).collect();
    let corrections: Vec<f64> = positions.iter().map(|position| -screw_error(*position)).collect();
    let axis = AxisErrors {
        backlash: BACKLASH,
        table: Some(ScrewTable::new(&positions, &corrections, None).unwrap()),
        hysteresis: 0.0005,
        thermal: None,
    };
    let mut errors = MachineErrors::default();
    errors.axes[..2].fill(axis);
    errors.squareness.xy = 2e-4;
    errors
}

/// Maximum deviations from the circle: away from the reversals of an axis, and near them.
fn circle(errors: &MachineErrors) -> [f64; 2] {
    let limits = AxisLimits {
        velocity: 500.0,
        acceleration: 5000.0,
        jerk: 200_000.0,
    };
    let mut drives = [None; AXES];
    drives[..2].fill(Some(limits));
    let design = Design::new(errors, &drives).unwrap();
    let mut compensation = design.compensation(PERIOD_S, Axes::zeros());
    let mut plant = Plant {
        slides: [0.0; 2],
        squareness: Squareness {
            xy: 2e-4,
            ..Squareness::default()
        },
    };
    let (radius, rate) = (40.0, 1.0);
    let mut max = [0.0_f64; 2];
    // From the centre to the circle, then several revolutions.
    let (mut angle, mut reach) = (0.0_f64, 0.0_f64);
    for _ in 0..20_000 {
        reach = (reach + 0.05).min(radius);
        angle += rate * PERIOD_S;
        let mut ideal = Jet::at_rest(Axes::zeros());
        (ideal.position[0], ideal.position[1]) = (reach * angle.cos(), reach * angle.sin());
        let motors = compensation.step(&ideal).position;
        let [x, y] = plant.drive(&motors);
        if angle > 7.0 {
            let off = (x.hypot(y) - radius).abs();
            let quarter = std::f64::consts::FRAC_PI_2;
            let near = (angle / quarter - (angle / quarter).round()).abs() * quarter < 0.08;
            max[usize::from(near)] = max[usize::from(near)].max(off);
        }
    }
    max
}

#[test]
fn a_circle_of_an_inaccurate_machine_is_round() {
    let without = circle(&MachineErrors::default());
    assert!(without[0] > 0.012, "{without:?}");
    let [away, near] = circle(&errors());
    // The curve between the points of the table, and the second-order term error times slope.
    assert!(away < 0.0002, "{away}");
    // The take-up lasts 48 ms; meanwhile part of the backlash remains, almost all of it in the radial
    // direction.
    assert!(near < 0.021, "{near}");
}
