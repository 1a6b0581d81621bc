//! The speeds that the spindles are commanded, setpoint by setpoint.

use evolvent_gcode::{Outputs, SPINDLES};
use evolvent_machine::{MAX_SPINDLES, SignalSettings};

use crate::due_setpoint::SpindleOverrides;

// A program names as many spindles as a machine may have.
const _: () = assert!(SPINDLES == MAX_SPINDLES as usize);

/// A speed that follows the radius is sent again where it has changed by more than this part of itself.
const LEAST_CHANGE: f64 = 0.001;

/// The speeds of the spindles with the setpoint that has left last.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SpindleCommands {
    max_rpm: [f64; SPINDLES],
    rpm: [f64; SPINDLES],
}

impl SpindleCommands {
    pub(crate) fn new(settings: &SignalSettings) -> Self {
        Self {
            max_rpm: settings.max_rpm(),
            rpm: [0.0; SPINDLES],
        }
    }

    /// With the override of the operator, rpm, not negative; that of a stopped spindle is kept for its next start.
    pub(crate) fn rpm(&self) -> [f64; SPINDLES] {
        self.rpm
    }

    /// Goes on to a setpoint with its X in machine coordinates, mm. `is_new`: the program has commanded something.
    pub(crate) fn follow(
        &mut self,
        outputs: &Outputs,
        x_mm: f64,
        overrides: &SpindleOverrides,
        is_new: bool,
    ) {
        for (number, spindle) in outputs.spindles.iter().enumerate() {
            let rpm = (spindle.speed().rpm_at(x_mm) * overrides[number]).min(self.max_rpm[number]);
            if is_new || (rpm - self.rpm[number]).abs() > LEAST_CHANGE * self.rpm[number] {
                self.rpm[number] = rpm;
            }
        }
    }
}

/// What the status shows, of the spindle with the lowest number: negative counter-clockwise, 0 where it is stopped.
pub(crate) fn shown_rpm(
    outputs: &Outputs,
    x_mm: f64,
    overrides: &SpindleOverrides,
    settings: &SignalSettings,
) -> f64 {
    let first = settings.spindles.iter().min_by_key(|spindle| spindle.number);
    let (number, most) = first.map_or((0, f64::INFINITY), |spindle| (spindle.number, spindle.max_rpm));
    (outputs.spindle(number).signed_rpm_at(x_mm) * overrides[number as usize]).clamp(-most, most)
}

#[cfg(test)]
mod tests {
    use evolvent_gcode::{SpindleDirection, SpindleOutput};
    use evolvent_path::SurfaceSpeed;

    use super::*;

    #[test]
    fn a_speed_that_follows_the_radius_is_told_in_steps_of_a_thousandth() {
        let surface = SurfaceSpeed {
            speed_m_min: 100.0,
            max_rpm: f64::INFINITY,
            centre_mm: 0.0,
        };
        let mut outputs = Outputs::default();
        outputs.spindles[1] = SpindleOutput {
            direction: SpindleDirection::Clockwise,
            surface: Some(surface),
            speed_rpm: 0.0,
        };
        let mut command = SpindleCommands {
            max_rpm: [3000.0; SPINDLES],
            rpm: [0.0; SPINDLES],
        };
        let (mut told, mut before) = (0, 0.0);
        for k in 0..=50_000 {
            let x_mm = 50.0 - 0.001 * f64::from(k);
            command.follow(&outputs, x_mm, &[1.0; SPINDLES], false);
            let exact = (1e5 / (std::f64::consts::TAU * x_mm)).min(3000.0);
            assert!(
                (command.rpm()[1] / exact - 1.0).abs() <= 0.0011,
                "{} at {x_mm}",
                command.rpm()[1]
            );
            told += u32::from(command.rpm()[1] != before);
            before = command.rpm()[1];
        }
        // ln(3000 / 318.3) / 0.001, and no more near the centre.
        assert!((1800..2400).contains(&told), "{told}");
        assert!((command.rpm()[1] / 3000.0 - 1.0).abs() < 0.0011);
        command.follow(&outputs, 50.0, &[1.0, 0.5, 1.0, 1.0], true);
        assert!((command.rpm()[1] - 159.155).abs() < 0.001);
    }
}
