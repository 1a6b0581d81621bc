//! Two motors of one axis in a session: carries out the decisions of a [`Gantry`].

use evolvent_path::AxisMask;
use evolvent_wire::Feedback;

use crate::follower::Target;
use crate::gantry::{Gantry, GantryFault, GantryInputs, GantrySettings, is_homed};

/// A motor of a bridge as a gantry uses it. Lengths are mm or degrees.
pub trait GantryMotor {
    /// The axis that it moves, 0 to 8.
    fn axis(&self) -> usize;
    /// Its coordinate.
    fn position(&self) -> f64;
    /// Its measured velocity, per second.
    fn velocity(&self) -> f64;
    /// The coordinate at which it waits for other motors, or its present one.
    fn held_position(&self) -> f64;
    /// Whether its home switch is closed.
    fn home_switch(&self) -> bool;
    /// Whether its drive reports its following error itself.
    fn has_following_error(&self) -> bool {
        false
    }
    /// Adds `shift` to its coordinate, without motion.
    fn rename(&mut self, shift: f64);
    /// Sets the offset added to setpoints from now on, and its velocity.
    fn set_apart(&mut self, distance: f64, velocity: f64);
    /// Sets whether it must stop because the two are too far apart.
    fn set_too_far_apart(&mut self, is_apart: bool);
}

/// Fault and squaring of a gantry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GantryEvent {
    /// Its axis.
    pub axis: usize,
    /// Why both motors have to stop.
    pub fault: Option<GantryFault>,
    /// Distance of the second motor from square, if the axis has just been homed by both switches.
    pub squared: Option<f64>,
}

/// Two motors of one axis among those of a session, by their indices in its list. May be used by a real-time
/// cycle.
#[derive(Clone, Copy, Debug)]
pub struct GantryPair {
    first: usize,
    second: usize,
    gantry: Gantry,
    has_switches: bool,
}

impl GantryPair {
    /// The motors at these indices, without power. `has_switches`: each has a home switch, and both square
    /// the beam.
    #[must_use]
    pub const fn new(first: usize, second: usize, settings: GantrySettings, has_switches: bool) -> Self {
        Self {
            first,
            second,
            gantry: Gantry::new(settings),
            has_switches,
        }
    }

    /// Their indices in that list.
    #[must_use]
    pub const fn indices(&self) -> [usize; 2] {
        [self.first, self.second]
    }

    /// Why both have to stop.
    #[must_use]
    pub const fn fault(&self) -> Option<GantryFault> {
        self.gantry.fault()
    }

    /// Writes the held position of the axis into the positions of all axes.
    pub fn hold<M: GantryMotor>(&self, motors: &[M], actual: &mut [f64]) {
        let first = &motors[self.first];
        actual[first.axis()] = self.gantry.position(first.held_position());
    }

    /// Aligns motors without a known position: the beam is assumed to be square.
    pub fn align<M: GantryMotor>(&self, motors: &mut [M]) {
        let positions = self.indices().map(|motor| motors[motor].position());
        motors[self.second].rename(self.gantry.alignment(positions));
    }

    /// Handles a change of datum: both motors were shifted with their axis, and receive the rest of their
    /// shift here.
    pub fn rename<M: GantryMotor>(&mut self, motors: &mut [M], shift: &[f64]) {
        let of_axis = shift[motors[self.first].axis()];
        let by = self.gantry.rename(of_axis, is_homed(shift, of_axis));
        for (motor, by) in self.indices().into_iter().zip(by) {
            motors[motor].rename(by - of_axis);
        }
    }

    /// Runs one period: moves both until the beam is square, and stops both if that is not possible.
    /// `strain`: the difference of the distances that they have moved, while their coordinates have no common
    /// zero.
    pub fn step<M: GantryMotor>(
        &mut self,
        motors: &mut [M],
        (is_enabled, target): (bool, &Target),
        strain: Option<f64>,
        period_s: f64,
    ) {
        let indices = self.indices();
        let switches = indices.map(|motor| motors[motor].home_switch());
        self.gantry.step(&GantryInputs {
            is_enabled,
            power: target.requested_power(),
            position: indices.map(|motor| motors[motor].position()),
            velocity: target.velocity[motors[self.first].axis()],
            switches: self.has_switches.then_some(switches),
            strain,
            period_s,
        });
        for (side, motor) in indices.into_iter().enumerate() {
            let motor = &mut motors[motor];
            motor.set_apart(self.gantry.offset(side), self.gantry.velocity(side));
            motor.set_too_far_apart(self.gantry.fault().is_some());
        }
    }

    /// Returns the events since the last call.
    pub fn take_event<M: GantryMotor>(&mut self, motors: &[M]) -> GantryEvent {
        GantryEvent {
            axis: motors[self.first].axis(),
            fault: self.gantry.fault(),
            squared: self.gantry.take_squared(),
        }
    }

    /// The limit switches of the motor at index `index` as reported to the core ([`Gantry::limits`]); `None`
    /// for any other motor.
    #[must_use]
    pub fn limits(&self, index: usize, pressed: [bool; 2]) -> Option<[bool; 2]> {
        let side = self.indices().iter().position(|motor| *motor == index)?;
        Some(self.gantry.limits(side, pressed))
    }

    /// Position, velocity, following error and home switch of the axis, instead of those of its first motor.
    pub fn describe<M: GantryMotor>(&self, motors: &[M], target: &Target, feedback: &mut Feedback) {
        let first = &motors[self.first];
        let axis = first.axis();
        let position = self.gantry.position(first.position());
        feedback.position[axis] = position;
        feedback.velocity[axis] = first.velocity() - self.gantry.velocity(0);
        if !first.has_following_error() {
            feedback.following_error[axis] = target.position[axis] - position;
        }
        if self.has_switches {
            feedback.home_switch_mask &= !AxisMask::one(axis).bits();
            feedback.home_switch_mask |= AxisMask::one_if(axis, self.gantry.home_switch()).bits();
        }
    }
}
