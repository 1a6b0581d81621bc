//! The angle of a spindle with the virtual clock when no encoder reports one.

use evolvent_machine::SpindleSettings;
use evolvent_path::SpindleSpeed;

use crate::spindle_tracker::AngleJet;

/// Time in which a spindle reaches its speed from rest if the machine file gives no rate, s.
const SPEED_UP_S: f64 = 0.25;

/// The target of a spindle from a moment on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpindleTarget {
    /// Number of the spindle.
    pub spindle: u32,
    /// 1 clockwise, -1 counter-clockwise, 0 stopped.
    pub sign: f64,
    /// Its speed.
    pub speed: SpindleSpeed,
}

/// A spindle that turns as commanded: it changes its speed at a constant rate, and its angle continues from
/// pass to pass. The angle is 0 at the start of the run. It depends only on the commands and the number of
/// setpoints, so the same program gives the same bits.
#[derive(Clone, Copy, Debug)]
pub(crate) struct VirtualSpindle {
    /// Turns, turns/s and turns/s^2; negative counter-clockwise.
    motion: AngleJet,
    sign: f64,
    speed: SpindleSpeed,
    max_rpm: f64,
    /// Turns/s^2, from the machine file.
    rate: Option<f64>,
    /// Maximum of the speeds since the last command and the speed at the command, turns/s. It determines the
    /// rate if the machine file gives none.
    fastest: f64,
}

impl VirtualSpindle {
    /// A spindle at rest. `settings` are those of the machine file, if it has this spindle.
    pub(crate) fn new(settings: Option<&SpindleSettings>) -> Self {
        Self {
            motion: [0.0; 3],
            sign: 0.0,
            speed: SpindleSpeed::Constant { rpm: 0.0 },
            max_rpm: settings.map_or(f64::INFINITY, |settings| settings.max_rpm),
            rate: settings
                .and_then(SpindleSettings::braking_rpm_s)
                .map(|rate| rate / 60.0),
            fastest: 0.0,
        }
    }

    /// Angle, speed and acceleration.
    pub(crate) const fn motion(&self) -> AngleJet {
        self.motion
    }

    /// Sets the target from the next setpoint on.
    pub(crate) fn command(&mut self, target: &SpindleTarget) {
        (self.sign, self.speed) = (target.sign, target.speed);
        self.fastest = self.motion[1].abs();
    }

    /// Advances by one period, with the tool at X in machine coordinates, mm.
    pub(crate) fn advance(&mut self, x_mm: f64, period_s: f64) {
        let [turns, speed, _] = self.motion;
        let wanted = self.sign * self.speed.overridden_rpm_at(x_mm, 1.0, self.max_rpm) / 60.0;
        self.fastest = self.fastest.max(wanted.abs());
        let max_change = self.rate.unwrap_or(self.fastest / SPEED_UP_S) * period_s;
        let change = (wanted - speed).clamp(-max_change, max_change);
        // The speed ends at exactly the commanded value: a sum could miss it by the last bit, and the spindle
        // would never stop.
        let next = if change == wanted - speed {
            wanted
        } else {
            speed + change
        };
        self.motion = [turns + 0.5 * (speed + next) * period_s, next, change / period_s];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_S: f64 = 1e-3;

    fn target(sign: f64, rpm: f64) -> SpindleTarget {
        SpindleTarget {
            spindle: 0,
            sign,
            speed: SpindleSpeed::Constant { rpm },
        }
    }

    fn advance(spindle: &mut VirtualSpindle, cycles: u32) {
        for _ in 0..cycles {
            spindle.advance(0.0, PERIOD_S);
        }
    }

    #[test]
    fn without_a_rate_it_reaches_its_speed_in_250_ms() {
        let mut spindle = VirtualSpindle::new(None);
        spindle.command(&target(1.0, 800.0));
        advance(&mut spindle, 249);
        assert!(spindle.motion()[1] < 800.0 / 60.0);
        advance(&mut spindle, 3);
        assert_eq!(spindle.motion()[1..], [800.0 / 60.0, 0.0]);
        let before = spindle.motion()[0];
        advance(&mut spindle, 3000);
        assert!((spindle.motion()[0] - before - 40.0).abs() < 1e-9);
        // The other direction: 0.25 s to rest, and 0.25 s to the speed.
        spindle.command(&target(-1.0, 800.0));
        advance(&mut spindle, 250);
        assert!(spindle.motion()[1].abs() < 1e-9, "{:?}", spindle.motion());
        advance(&mut spindle, 252);
        assert_eq!(spindle.motion()[1..], [-800.0 / 60.0, 0.0]);
        // It stops, and keeps its angle.
        spindle.command(&target(0.0, 800.0));
        advance(&mut spindle, 252);
        let at_rest = spindle.motion();
        assert_eq!(at_rest[1..], [0.0, 0.0]);
        advance(&mut spindle, 100);
        assert_eq!(spindle.motion(), at_rest);
    }

    #[test]
    fn a_surface_speed_goes_by_the_radius() {
        let mut spindle = VirtualSpindle::new(None);
        let surface = evolvent_path::SurfaceSpeed {
            speed_m_min: 100.0,
            max_rpm: 2000.0,
            centre_mm: 0.0,
        };
        spindle.command(&SpindleTarget {
            spindle: 0,
            sign: 1.0,
            speed: SpindleSpeed::Surface(surface),
        });
        for x_mm in [20.0, 40.0, 1.0] {
            for _ in 0..1000 {
                spindle.advance(x_mm, PERIOD_S);
            }
            let expected = SpindleSpeed::Surface(surface).rpm_at(x_mm) / 60.0;
            assert_eq!(spindle.motion()[1], expected, "X {x_mm}");
        }
    }
}
