//! The last check of a setpoint before it is published.
//!
//! The guard does not know the plan: it differentiates the published positions and compares the results with
//! the limits of the axes. The summary of a run reports what it has measured.

use evolvent_machine::Limits;
use evolvent_path::{AXES, Axes, AxisLetter};

/// Factor by which a measured velocity or acceleration may exceed its limit.
pub(crate) const SLACK: f64 = 1.001;
/// The same for jerk, which is read from third differences.
const JERK_SLACK: f64 = 1.02;
/// Tolerance of the travel check for rounding of positions, mm or degrees.
pub(crate) const TRAVEL_SLACK: f64 = 1e-6;
/// Cycles after a joint of exact-path mode in which its step shows in second and third differences.
const JOINT_CYCLES: u32 = 3;

/// The limit that a setpoint would violate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BrokenLimit {
    /// Not a finite number.
    Finite,
    /// Travel of the axis.
    Travel,
    /// Velocity.
    Velocity,
    /// Acceleration.
    Acceleration,
    /// Jerk.
    Jerk,
}

/// A setpoint that must not be published.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("axis {}: {quantity:?} would be {value:.6e}, its limit is {limit:.6e}", axis.letter())]
pub struct Violation {
    /// The axis.
    pub axis: AxisLetter,
    /// The limit that is violated.
    pub quantity: BrokenLimit,
    /// The value.
    pub value: f64,
    /// The limit.
    pub limit: f64,
}

/// Maximum magnitudes measured in published positions, minus the possible rounding of a difference: far from
/// zero and at a high rate the rounding alone exceeds a jerk limit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extremes {
    /// First difference over the period, per s.
    pub velocity: Axes,
    /// Second difference, per s2.
    pub acceleration: Axes,
    /// Third difference, per s3, away from joints of exact-path mode.
    pub jerk: Axes,
    /// Third difference at joints of exact-path mode, per s3.
    pub jerk_at_joints: Axes,
    /// Distance between chord and curve from one setpoint to the next, mm.
    pub chord_error_mm: f64,
}

/// Differentiates published positions and checks the next one.
#[derive(Clone, Copy, Debug)]
pub struct Guard {
    limits: Limits,
    rate_hz: f64,
    /// The last three published positions, newest first.
    past: [Axes; 3],
    since_joint: u32,
    extremes: Extremes,
}

impl Guard {
    /// A guard at rest at `position`.
    #[must_use]
    pub fn new(limits: Limits, period_s: f64, position: Axes) -> Self {
        let none = Axes::zeros();
        let extremes = Extremes {
            velocity: none,
            acceleration: none,
            jerk: none,
            jerk_at_joints: none,
            chord_error_mm: 0.0,
        };
        Self {
            limits,
            rate_hz: 1.0 / period_s,
            past: [position; 3],
            since_joint: JOINT_CYCLES,
            extremes,
        }
    }

    /// A guard at rest at `position`, with the extremes measured before.
    pub(crate) fn resting(limits: Limits, period_s: f64, position: Axes, extremes: Extremes) -> Self {
        Self {
            extremes,
            ..Self::new(limits, period_s, position)
        }
    }

    /// What has been measured so far.
    #[must_use]
    pub fn extremes(&self) -> &Extremes {
        &self.extremes
    }

    /// The last three published positions, newest first.
    #[must_use]
    pub fn past(&self) -> &[Axes; 3] {
        &self.past
    }

    /// Velocity and acceleration that continue the published positions, independently of the plan: those of
    /// the parabola through the last three. `None` near a joint of exact-path mode, whose step they contain.
    /// Real-time safe.
    pub(crate) fn measured(&self) -> Option<(Axes, Axes)> {
        if self.since_joint < JOINT_CYCLES {
            return None;
        }
        let [p1, p2, p3] = &self.past;
        let (d1, d2) = (p1 - p2, p2 - p3);
        let f = self.rate_hz;
        Some(((d1 + (d1 - d2) * 0.5) * f, (d1 - d2) * (f * f)))
    }

    /// Checks a position against every limit. While `braking` after a fault the speed may still exceed its
    /// limit, because it takes time to reduce it within acceleration and jerk. Real-time safe.
    ///
    /// # Errors
    /// The first limit that the position would violate.
    pub fn check(&self, position: &Axes, joint: bool, braking: bool) -> Result<(), Violation> {
        self.check_position(position)?;
        let (velocity, acceleration, jerk) = self.differences(position);
        let near_joint = joint || self.since_joint < JOINT_CYCLES;
        for i in 0..AXES {
            if !self.limits.present[i] {
                continue;
            }
            let axis = AxisLetter::ALL[i];
            let test = |quantity, value: f64, limit: f64, slack: f64, order: i32| {
                if value.abs() <= limit * slack + self.noise(position[i], order) {
                    Ok(())
                } else {
                    Err(Violation {
                        axis,
                        quantity,
                        value,
                        limit,
                    })
                }
            };
            if !braking {
                test(
                    BrokenLimit::Velocity,
                    velocity[i],
                    self.limits.velocity[i],
                    SLACK,
                    1,
                )?;
            }
            if !near_joint {
                test(
                    BrokenLimit::Acceleration,
                    acceleration[i],
                    self.limits.acceleration[i],
                    SLACK,
                    2,
                )?;
                test(BrokenLimit::Jerk, jerk[i], self.limits.jerk[i], JERK_SLACK, 3)?;
            }
        }
        Ok(())
    }

    /// The possible rounding of the difference of this order between positions.
    fn noise(&self, position: f64, order: i32) -> f64 {
        16.0 * f64::EPSILON * position.abs().max(1.0) * self.rate_hz.powi(order)
    }

    /// Checks only that a position is finite and within the travel. Real-time safe.
    ///
    /// # Errors
    /// The first axis that fails.
    pub fn check_position(&self, position: &Axes) -> Result<(), Violation> {
        (0..AXES).try_for_each(|i| self.check_axis(i, position[i]))
    }

    /// The same check for one axis. Real-time safe.
    pub(crate) fn check_axis(&self, i: usize, value: f64) -> Result<(), Violation> {
        let violation = |quantity, limit| Violation {
            axis: AxisLetter::ALL[i],
            quantity,
            value,
            limit,
        };
        if !value.is_finite() {
            return Err(violation(BrokenLimit::Finite, f64::NAN));
        }
        let (low, high) = (self.limits.travel_min[i], self.limits.travel_max[i]);
        if self.limits.present[i] && value < low - TRAVEL_SLACK {
            return Err(violation(BrokenLimit::Travel, low));
        }
        if self.limits.present[i] && value > high + TRAVEL_SLACK {
            return Err(violation(BrokenLimit::Travel, high));
        }
        Ok(())
    }

    /// Records a position as published. Real-time safe.
    pub fn publish(&mut self, position: &Axes, joint: bool) {
        let differences = self.differences(position);
        let [first, second, third] =
            [differences.0, differences.1, differences.2].map(|found| found.map(f64::abs));
        let noise = Axes::from_fn(|i, _| self.noise(position[i], 1));
        self.since_joint = if joint {
            0
        } else {
            self.since_joint.saturating_add(1)
        };
        let extremes = &mut self.extremes;
        let jerk_max = if self.since_joint < JOINT_CYCLES {
            &mut extremes.jerk_at_joints
        } else {
            &mut extremes.jerk
        };
        for i in 0..AXES {
            let noise = noise[i];
            extremes.velocity[i] = extremes.velocity[i].max(first[i] - noise);
            extremes.acceleration[i] = extremes.acceleration[i].max(second[i] - noise * self.rate_hz);
            jerk_max[i] = jerk_max[i].max(third[i] - noise * self.rate_hz * self.rate_hz);
        }
        extremes.chord_error_mm =
            extremes
                .chord_error_mm
                .max(sagitta(position, &self.past[0], &self.past[1]));
        self.past = [*position, self.past[0], self.past[1]];
    }

    fn differences(&self, p: &Axes) -> (Axes, Axes, Axes) {
        let [p1, p2, p3] = &self.past;
        let (d1, d2, d3) = (p - p1, p1 - p2, p2 - p3);
        let (dd1, dd2) = (d1 - d2, d2 - d3);
        let f = self.rate_hz;
        (d1 * f, dd1 * (f * f), (dd1 - dd2) * (f * f * f))
    }
}

/// Height of the arc through three XYZ points over the chord of two neighbouring points, for points close
/// together: an eighth of the component of the second difference across the chord.
fn sagitta(p0: &Axes, p1: &Axes, p2: &Axes) -> f64 {
    let (mut along, mut dd, mut chord) = (0.0, 0.0, 0.0);
    for i in 0..3 {
        let (second, across) = (p0[i] - 2.0 * p1[i] + p2[i], p0[i] - p2[i]);
        along += second * across;
        dd += second * second;
        chord += across * across;
    }
    if chord <= 0.0 {
        return 0.0;
    }
    0.125 * (dd - along * along / chord).max(0.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A rotary axis at constant speed after a hundred turns: its measured jerk is rounding only.
    #[test]
    fn rounding_far_from_zero_is_no_jerk() {
        let none = Axes::zeros();
        let limits = Limits {
            present: std::array::from_fn(|i| i == 3),
            home: none,
            travel_min: none.map(|_| f64::NEG_INFINITY),
            travel_max: none.map(|_| f64::INFINITY),
            velocity: none.map(|_| 60.0),
            acceleration: none.map(|_| 600.0),
            jerk: none.map(|_| 7200.0),
        };
        let at = |cycle: u32| {
            Axes::from_fn(|i, _| {
                if i == 3 {
                    36_000.1 + f64::from(cycle) / 1e3
                } else {
                    0.0
                }
            })
        };
        let mut guard = Guard::new(limits, 1.0 / 35_000.0, at(0));
        // The first differences are those of an instantaneous start.
        guard.past = [at(2), at(1), at(0)];
        for cycle in 3..10_000 {
            guard.check(&at(cycle), false, false).expect("within the limits");
            guard.publish(&at(cycle), false);
        }
        let extremes = guard.extremes();
        // Rounding is subtracted, so what is reported has been reached.
        assert!(
            (34.999..=35.0).contains(&extremes.velocity[3]),
            "{}",
            extremes.velocity[3]
        );
        assert_eq!((extremes.acceleration[3], extremes.jerk[3]), (0.0, 0.0));
    }

    /// A chord of an arc of radius R and angle a has the sagitta R (1 - cos(a / 2)). The speed along the
    /// circle changes from chord to chord, which must not count.
    #[test]
    fn sagitta_is_that_of_the_arc_at_any_speed() {
        let at = |angle: f64| {
            let mut point = Axes::zeros();
            (point[0], point[1], point[2]) = (10.0 * angle.cos(), 7.0, 10.0 * angle.sin());
            point
        };
        for angle in [0.001, 0.01, 0.03] {
            let exact = 10.0 * (1.0 - f64::cos(0.5 * angle));
            let found = sagitta(&at(2.0 * angle), &at(angle), &at(0.0));
            assert!((found / exact - 1.0).abs() < 1e-3, "{angle}: {found} of {exact}");
            let faster = sagitta(&at(2.1 * angle), &at(angle), &at(0.0));
            assert!(
                (faster / exact - 1.0).abs() < 0.12,
                "{angle}: {faster} of {exact}"
            );
        }
        let straight = |x: f64| {
            let mut point = Axes::zeros();
            (point[0], point[1]) = (x, 0.5 * x);
            point
        };
        assert!(sagitta(&straight(3.0), &straight(1.0), &straight(0.0)) < 1e-9);
        assert_eq!(sagitta(&straight(1.0), &straight(1.0), &straight(1.0)), 0.0);
    }
}
