//! Spindle and coolant: what a program switches on the machine.

use evolvent_path::{SpindleSpeed, SurfaceSpeed};

use crate::{Action, SpindleDirection};

/// State of spindle and coolant, as the program has commanded it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outputs {
    /// Sense of rotation, or stopped.
    pub direction: SpindleDirection,
    /// Speed of the last S word in revolutions per minute, not negative; kept while the spindle is stopped.
    pub speed_rpm: f64,
    /// The speed follows the radius (G96), and `speed_rpm` counts for nothing.
    pub surface: Option<SurfaceSpeed>,
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
                (self.direction, self.speed_rpm, self.surface) = (direction, speed_rpm, None);
            }
            Action::SurfaceSpeed { direction, surface } => {
                (self.direction, self.surface) = (direction, Some(surface));
            }
            Action::Coolant { mist, flood } => (self.mist, self.flood) = (mist, flood),
            _ => return false,
        }
        true
    }

    /// The speed of the spindle while it turns.
    #[must_use]
    pub fn speed(&self) -> SpindleSpeed {
        match self.surface {
            Some(surface) => SpindleSpeed::Surface(surface),
            None => SpindleSpeed::Constant { rpm: self.speed_rpm },
        }
    }

    /// Commanded speed in revolutions per minute, negative counter-clockwise; 0 where the spindle is stopped, or has no speed that is
    /// the same everywhere.
    #[must_use]
    pub fn constant_rpm(&self) -> f64 {
        match self.surface {
            Some(_) => 0.0,
            None => self.signed_rpm_at(0.0),
        }
    }

    /// Commanded speed in revolutions per minute where the tool is at X in machine coordinates, mm: negative counter-clockwise, 0
    /// where the spindle is stopped.
    #[must_use]
    pub fn signed_rpm_at(&self, x_mm: f64) -> f64 {
        match self.direction {
            SpindleDirection::Stopped => 0.0,
            SpindleDirection::Clockwise => self.speed().rpm_at(x_mm),
            SpindleDirection::CounterClockwise => -self.speed().rpm_at(x_mm),
        }
    }
}
