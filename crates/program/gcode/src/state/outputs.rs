//! Spindle and coolant: what a program switches on the machine.

use crate::{Action, SpindleDirection};

/// State of spindle and coolant, as the program has commanded it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outputs {
    /// Sense of rotation, or stopped.
    pub direction: SpindleDirection,
    /// Speed of the last S word in revolutions per minute, not negative; kept while the spindle is stopped.
    pub speed_rpm: f64,
    /// Mist coolant (M7) is on.
    pub mist: bool,
    /// Flood coolant (M8) is on.
    pub flood: bool,
}

impl Outputs {
    /// Takes over what an action switches. Returns whether it is an action of spindle or coolant.
    pub fn apply(&mut self, action: &Action) -> bool {
        match *action {
            Action::Spindle { direction, speed_rpm } => {
                (self.direction, self.speed_rpm) = (direction, speed_rpm);
            }
            Action::Coolant { mist, flood } => (self.mist, self.flood) = (mist, flood),
            _ => return false,
        }
        true
    }

    /// Commanded speed in revolutions per minute, negative counter-clockwise, 0 where the spindle is stopped.
    #[must_use]
    pub fn signed_rpm(&self) -> f64 {
        match self.direction {
            SpindleDirection::Stopped => 0.0,
            SpindleDirection::Clockwise => self.speed_rpm,
            SpindleDirection::CounterClockwise => -self.speed_rpm,
        }
    }
}
