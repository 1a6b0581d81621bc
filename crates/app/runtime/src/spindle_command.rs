//! The speed that a spindle is commanded, setpoint by setpoint.

use evolvent_gcode::Outputs;
use evolvent_machine::SignalSettings;

/// A speed that follows the radius is sent again where it has changed by more than this part of itself.
const LEAST_CHANGE: f64 = 0.001;

/// The speed of the spindle of number 0 with the setpoint that has left last.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SpindleCommand {
    max_rpm: f64,
    rpm: f64,
}

impl SpindleCommand {
    pub(crate) fn new(settings: &SignalSettings) -> Self {
        Self {
            max_rpm: max_rpm(settings),
            rpm: 0.0,
        }
    }

    /// With the override of the operator, rpm, not negative; that of a stopped spindle is kept for its next start.
    pub(crate) fn rpm(&self) -> f64 {
        self.rpm
    }

    /// Goes on to a setpoint with its X in machine coordinates, mm. `is_new`: the program has commanded something.
    pub(crate) fn follow(&mut self, outputs: &Outputs, x_mm: f64, override_ratio: f64, is_new: bool) {
        let rpm = (outputs.speed().rpm_at(x_mm) * override_ratio).min(self.max_rpm);
        if is_new || (rpm - self.rpm).abs() > LEAST_CHANGE * self.rpm {
            self.rpm = rpm;
        }
    }
}

/// The highest speed of the spindle of number 0, rpm; infinite where it is not known.
pub(crate) fn max_rpm(settings: &SignalSettings) -> f64 {
    settings
        .spindle(0)
        .map_or(f64::INFINITY, |spindle| spindle.max_rpm)
}

/// What the status shows: negative counter-clockwise, 0 where the spindle is stopped.
pub(crate) fn shown_rpm(outputs: &Outputs, x_mm: f64, override_ratio: f64, settings: &SignalSettings) -> f64 {
    let most = max_rpm(settings);
    (outputs.signed_rpm_at(x_mm) * override_ratio).clamp(-most, most)
}

#[cfg(test)]
mod tests {
    use evolvent_gcode::SpindleDirection;
    use evolvent_path::SurfaceSpeed;

    use super::*;

    #[test]
    fn a_speed_that_follows_the_radius_is_told_in_steps_of_a_thousandth() {
        let surface = SurfaceSpeed {
            speed_m_min: 100.0,
            max_rpm: f64::INFINITY,
            centre_mm: 0.0,
        };
        let outputs = Outputs {
            direction: SpindleDirection::Clockwise,
            surface: Some(surface),
            ..Outputs::default()
        };
        let mut command = SpindleCommand {
            max_rpm: 3000.0,
            rpm: 0.0,
        };
        let (mut told, mut before) = (0, 0.0);
        for k in 0..=50_000 {
            let x_mm = 50.0 - 0.001 * f64::from(k);
            command.follow(&outputs, x_mm, 1.0, false);
            let exact = (1e5 / (std::f64::consts::TAU * x_mm)).min(3000.0);
            assert!(
                (command.rpm() / exact - 1.0).abs() <= 0.0011,
                "{} at {x_mm}",
                command.rpm()
            );
            told += u32::from(command.rpm() != before);
            before = command.rpm();
        }
        // ln(3000 / 318.3) / 0.001, and no more near the centre.
        assert!((1800..2400).contains(&told), "{told}");
        assert!((command.rpm() / 3000.0 - 1.0).abs() < 0.0011);
        command.follow(&outputs, 50.0, 0.5, true);
        assert!((command.rpm() - 159.155).abs() < 0.001);
    }
}
