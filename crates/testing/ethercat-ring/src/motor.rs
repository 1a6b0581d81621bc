//! A motor and its load, joined by a shaft that twists.

use core::f64::consts::TAU;

/// The mechanics of one axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mechanics {
    /// Inertia of the motor, kg m2.
    pub motor_inertia_kg_m2: f64,
    /// Inertia of the load, referred to the motor.
    pub load_inertia_kg_m2: f64,
    /// Stiffness of the shaft, N m/rad.
    pub stiffness_n_m_rad: f64,
    /// Damping of the shaft, N m s/rad.
    pub damping_n_m_s_rad: f64,
    /// Friction of the load that does not depend on its speed, N m.
    pub friction_n_m: f64,
    /// Rated torque; the drive gives at most three times as much.
    pub rated_torque_n_m: f64,
}

impl Default for Mechanics {
    /// A servo motor of 750 W with twice its inertia as load: antiresonance at 252 Hz, resonance at 436 Hz.
    fn default() -> Self {
        Self {
            motor_inertia_kg_m2: 1e-4,
            load_inertia_kg_m2: 2e-4,
            stiffness_n_m_rad: 500.0,
            damping_n_m_s_rad: 0.02,
            friction_n_m: 0.05,
            rated_torque_n_m: 2.4,
        }
    }
}

/// Angles in rad and speeds in rad/s of motor and load.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct TwoMass {
    pub(crate) motor: f64,
    pub(crate) motor_speed: f64,
    pub(crate) load: f64,
    pub(crate) load_speed: f64,
}

impl TwoMass {
    pub(crate) fn at_turns(turns: f64) -> Self {
        Self {
            motor: turns * TAU,
            load: turns * TAU,
            ..Self::default()
        }
    }

    fn derivative(&self, mechanics: &Mechanics, torque_n_m: f64) -> Self {
        let twist = mechanics.stiffness_n_m_rad * (self.motor - self.load)
            + mechanics.damping_n_m_s_rad * (self.motor_speed - self.load_speed);
        // Smooth near zero speed, where the exact law has a jump.
        let friction = mechanics.friction_n_m * (self.load_speed / 0.5).tanh();
        Self {
            motor: self.motor_speed,
            motor_speed: (torque_n_m - twist) / mechanics.motor_inertia_kg_m2,
            load: self.load_speed,
            load_speed: (twist - friction) / mechanics.load_inertia_kg_m2,
        }
    }

    fn plus(&self, slope: &Self, time_s: f64) -> Self {
        Self {
            motor: self.motor + time_s * slope.motor,
            motor_speed: self.motor_speed + time_s * slope.motor_speed,
            load: self.load + time_s * slope.load,
            load_speed: self.load_speed + time_s * slope.load_speed,
        }
    }

    /// Advances by one fourth-order Runge-Kutta step at constant torque.
    pub(crate) fn step(&mut self, mechanics: &Mechanics, torque_n_m: f64, time_s: f64) {
        let k1 = self.derivative(mechanics, torque_n_m);
        let k2 = self.plus(&k1, time_s / 2.0).derivative(mechanics, torque_n_m);
        let k3 = self.plus(&k2, time_s / 2.0).derivative(mechanics, torque_n_m);
        let k4 = self.plus(&k3, time_s).derivative(mechanics, torque_n_m);
        for (slope, weight) in [(k1, 1.0), (k2, 2.0), (k3, 2.0), (k4, 1.0)] {
            *self = self.plus(&slope, weight * time_s / 6.0);
        }
    }

    /// Blocks the load at a position.
    pub(crate) const fn block(&mut self, load: f64) {
        self.load = load;
        self.load_speed = 0.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Without torque the two masses oscillate against each other at `sqrt(k (1/Jm + 1/Jl)) / 2 pi`.
    #[test]
    fn the_shaft_resonates_where_theory_says() {
        let mechanics = Mechanics {
            damping_n_m_s_rad: 0.0,
            friction_n_m: 0.0,
            ..Mechanics::default()
        };
        let mut masses = TwoMass {
            motor: 0.01,
            ..TwoMass::default()
        };
        let (mut crossings, mut last) = (0, 1.0);
        let step_s = 125e-6;
        for _ in 0..80_000 {
            masses.step(&mechanics, 0.0, step_s);
            let twist = masses.motor - masses.load;
            crossings += u32::from(twist * last < 0.0);
            last = twist;
        }
        let inverse = 1.0 / mechanics.motor_inertia_kg_m2 + 1.0 / mechanics.load_inertia_kg_m2;
        let expected_hz = (mechanics.stiffness_n_m_rad * inverse).sqrt() / TAU;
        let found_hz = f64::from(crossings) / 20.0;
        assert!(
            (found_hz / expected_hz - 1.0).abs() < 2e-3,
            "{found_hz} {expected_hz}"
        );
    }
}
