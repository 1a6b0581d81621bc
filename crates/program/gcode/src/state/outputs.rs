//! Spindles and coolant as commanded by a program.

use evolvent_path::{SpindleSpeed, SurfaceSpeed};

use crate::{Action, SpindleDirection};

/// Maximum number of spindles: `$0` to `$3`.
pub const SPINDLES: usize = 4;

/// State of one spindle, as commanded by the program.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SpindleOutput {
    /// Direction of rotation, or stopped.
    pub direction: SpindleDirection,
    /// Speed of the last S word in revolutions per minute, not negative; kept while the spindle is stopped.
    pub speed_rpm: f64,
    /// Constant surface speed (G96); `speed_rpm` is then ignored.
    pub surface: Option<SurfaceSpeed>,
}

/// State of spindles and coolant, as commanded by the program.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outputs {
    /// The spindles, by number.
    pub spindles: [SpindleOutput; SPINDLES],
    /// Mist coolant (M7) is on.
    pub mist: bool,
    /// Flood coolant (M8) is on.
    pub flood: bool,
}

impl Outputs {
    /// Applies an action. Returns whether it concerns spindles or coolant.
    pub fn apply(&mut self, action: &Action) -> bool {
        match *action {
            Action::Spindle {
                spindle,
                direction,
                speed_rpm,
            } => {
                let Some(output) = self.spindles.get_mut(spindle as usize) else {
                    return false;
                };
                *output = SpindleOutput {
                    direction,
                    speed_rpm,
                    surface: None,
                };
            }
            Action::SurfaceSpeed {
                spindle,
                direction,
                surface,
            } => {
                let Some(output) = self.spindles.get_mut(spindle as usize) else {
                    return false;
                };
                (output.direction, output.surface) = (direction, Some(surface));
            }
            Action::Coolant { mist, flood } => (self.mist, self.flood) = (mist, flood),
            _ => return false,
        }
        true
    }

    /// The spindle with this number; a stopped one if the number does not exist.
    #[must_use]
    pub fn spindle(&self, number: u32) -> SpindleOutput {
        self.spindles.get(number as usize).copied().unwrap_or_default()
    }

    /// Stops every spindle. Constant speeds are kept. A surface speed ends (G97, S0), because a following MDI
    /// block could not distinguish it from the revolutions per minute that an operator means by S.
    pub fn stop_spindles(&mut self) {
        for spindle in &mut self.spindles {
            spindle.direction = SpindleDirection::Stopped;
            if spindle.surface.take().is_some() {
                spindle.speed_rpm = 0.0;
            }
        }
    }

    /// Whether a spindle has a surface speed (G96).
    #[must_use]
    pub fn has_surface_speed(&self) -> bool {
        self.spindles.iter().any(|spindle| spindle.surface.is_some())
    }
}

impl SpindleOutput {
    /// Speed while the spindle rotates.
    #[must_use]
    pub fn speed(&self) -> SpindleSpeed {
        match self.surface {
            Some(surface) => SpindleSpeed::Surface(surface),
            None => SpindleSpeed::Constant { rpm: self.speed_rpm },
        }
    }

    /// Whether it is not stopped.
    #[must_use]
    pub fn is_rotating(&self) -> bool {
        self.direction != SpindleDirection::Stopped
    }

    /// The action that commands this state of the spindle with this number.
    #[must_use]
    pub fn action(&self, spindle: u32) -> Action {
        let direction = self.direction;
        match self.surface {
            Some(surface) => Action::SurfaceSpeed {
                spindle,
                direction,
                surface,
            },
            None => Action::Spindle {
                spindle,
                direction,
                speed_rpm: self.speed_rpm,
            },
        }
    }

    /// Commanded speed in revolutions per minute, negative counter-clockwise; 0 if the spindle is stopped or
    /// its speed depends on the position.
    #[must_use]
    pub fn constant_rpm(&self) -> f64 {
        match self.surface {
            Some(_) => 0.0,
            None => self.signed_rpm_at(0.0, 1.0, f64::INFINITY),
        }
    }

    /// Commanded speed in revolutions per minute with the tool at X in machine coordinates, mm, an override
    /// (`ratio`, 1 at 100 %) and the maximum of the spindle: negative counter-clockwise, 0 if the spindle is
    /// stopped.
    #[must_use]
    pub fn signed_rpm_at(&self, x_mm: f64, ratio: f64, max_rpm: f64) -> f64 {
        let rpm = self.speed().overridden_rpm_at(x_mm, ratio, max_rpm);
        match self.direction {
            SpindleDirection::Stopped => 0.0,
            SpindleDirection::Clockwise => rpm,
            SpindleDirection::CounterClockwise => -rpm,
        }
    }
}
