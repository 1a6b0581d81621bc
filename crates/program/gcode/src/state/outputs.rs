//! Spindle and coolant as commanded by a program.

use evolvent_path::{SpindleSpeed, SurfaceSpeed};

use crate::{Action, SpindleDirection};

/// State of spindle and coolant, as commanded by the program.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outputs {
    /// Direction of rotation, or stopped.
    pub direction: SpindleDirection,
    /// Speed of the last S word in revolutions per minute, not negative; kept while the spindle is stopped.
    pub speed_rpm: f64,
    /// Constant surface speed (G96); `speed_rpm` is then ignored.
    pub surface: Option<SurfaceSpeed>,
    /// Mist coolant (M7) is on.
    pub mist: bool,
    /// Flood coolant (M8) is on.
    pub flood: bool,
}

impl Outputs {
    /// Applies an action. Returns whether it concerns spindle or coolant.
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

    /// Spindle speed while it rotates.
    #[must_use]
    pub fn speed(&self) -> SpindleSpeed {
        match self.surface {
            Some(surface) => SpindleSpeed::Surface(surface),
            None => SpindleSpeed::Constant { rpm: self.speed_rpm },
        }
    }

    /// Commanded speed in revolutions per minute, negative counter-clockwise; 0 if the spindle is stopped or its speed depends on
    /// the position.
    #[must_use]
    pub fn constant_rpm(&self) -> f64 {
        match self.surface {
            Some(_) => 0.0,
            None => self.signed_rpm_at(0.0),
        }
    }

    /// Commanded speed in revolutions per minute with the tool at X in machine coordinates, mm: negative counter-clockwise, 0 if the
    /// spindle is stopped.
    #[must_use]
    pub fn signed_rpm_at(&self, x_mm: f64) -> f64 {
        match self.direction {
            SpindleDirection::Stopped => 0.0,
            SpindleDirection::Clockwise => self.speed().rpm_at(x_mm),
            SpindleDirection::CounterClockwise => -self.speed().rpm_at(x_mm),
        }
    }
}
