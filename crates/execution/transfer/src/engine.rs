//! The only module that names ruckig.
//!
//! What this module guards against:
//! - *Waypoints.* The published build sends `intermediate_positions` in plain HTTP to a server of the vendor.
//!   No function here takes waypoints, the list is emptied before every call, and the solver is created with
//!   a capacity of none.
//! - *Short vectors.* The C++ side reads one number per axis, whatever the length of the vector: every vector
//!   is built here from the same tasks.
//! - *Units.* The tolerances of ruckig are absolute (1e-8 for position and velocity): tasks are scaled to
//!   numbers around 1.
//! - *Failures.* ruckig may fail, and it returns only samples of position, velocity and acceleration;
//!   `recover` finds the pieces.

use ruckig::{ControlInterface, InputParameter, Result as Answer, Ruckig, Synchronization, Trajectory};

use crate::landing::Steps;
use crate::recover::{Recorded, recover};
use crate::state::{AxisState, AxisTask};

/// Units of the problem for ruckig: one of time, and one of length for each axis.
#[derive(Clone, Debug)]
pub(crate) struct Units {
    pub second: f64,
    pub length: Vec<f64>,
}

/// The fastest synchronised move, as steps in s and the units of the tasks; `None` if ruckig finds no
/// solution.
pub(crate) fn fastest(tasks: &[AxisTask], units: &Units, limit_fraction: f64) -> Option<Vec<Steps>> {
    let count = tasks.len();
    if count == 0 || units.length.len() != count {
        return None;
    }
    let mut input = InputParameter::new(count);
    input.control_interface = ControlInterface::Position;
    input.synchronization = Synchronization::Time;
    let t = units.second;
    let scaled = |value: &dyn Fn(&AxisTask) -> f64, power: i32| -> Vec<f64> {
        tasks
            .iter()
            .zip(&units.length)
            .map(|(task, length)| value(task) * t.powi(power) / length)
            .collect()
    };
    // Positions are relative to the start, so a large position causes no rounding.
    input.current_position = vec![0.0; count];
    input.current_velocity = scaled(&|task| task.from.v, 1);
    input.current_acceleration = scaled(&|task| task.from.a, 2);
    input.target_position = scaled(&|task| task.to.p - task.from.p, 0);
    input.target_velocity = scaled(&|task| task.to.v, 1);
    input.target_acceleration = scaled(&|task| task.to.a, 2);
    input.max_velocity = scaled(&|task| task.usable(limit_fraction).v, 1);
    input.max_acceleration = scaled(&|task| task.usable(limit_fraction).a, 2);
    input.max_jerk = scaled(&|task| task.usable(limit_fraction).j, 3);
    input.intermediate_positions.clear();

    let mut trajectory = Trajectory::new_direct(count);
    let answer = Ruckig::new_direct_and_offline(count).calculate(&mut input, &mut trajectory);
    if answer != Answer::Working && answer != Answer::Finished {
        return None;
    }
    let duration = trajectory.get_duration();
    if !(duration >= 0.0) || !duration.is_finite() {
        return None;
    }
    let jerks = input.max_jerk.clone();
    let mut recorded = Recorded::new(count, |time| {
        let (p, v, a) = trajectory.at_time(time);
        (0..count)
            .map(|k| {
                let number = |values: &[f64]| values.get(k).copied().unwrap_or(f64::NAN);
                AxisState {
                    p: number(&p),
                    v: number(&v),
                    a: number(&a),
                }
            })
            .collect()
    });
    let mut all = Vec::with_capacity(count);
    for (axis, (length, jerk)) in units.length.iter().zip(jerks).enumerate() {
        let mut steps = recover(&mut recorded, axis, duration, jerk)?;
        for step in &mut steps {
            step.0 *= t;
            step.1 *= length / t.powi(3);
        }
        all.push(steps);
    }
    Some(all)
}
