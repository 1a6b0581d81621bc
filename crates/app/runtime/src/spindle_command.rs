//! Commanded speeds of the spindles, setpoint by setpoint.

use evolvent_gcode::{Outputs, SPINDLES, SpindleDirection};
use evolvent_machine::{MAX_SPINDLES, SignalSettings};

use crate::due_setpoint::SpindleOverrides;

// A program can use as many spindles as a machine may have.
const _: () = assert!(SPINDLES == MAX_SPINDLES as usize);

/// A surface-speed command is sent again when it has changed by more than this fraction.
const MIN_CHANGE: f64 = 0.001;

/// Time between two steps of a ramp, ns: drives do not read their commands faster.
const RAMP_STEP_NS: u64 = 1_000_000;

/// The command to a spindle with one setpoint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SpindleCommand {
    /// Including the operator's override, rpm, not negative. The speed of a stopped spindle is kept for its
    /// next start.
    pub rpm: f64,
    /// The direction while a ramp is in progress; `None` if it is that of the program.
    pub passing: Option<SpindleDirection>,
}

/// A speed that changes at a limited rate.
#[derive(Clone, Copy, Debug)]
struct Ramp {
    /// Change per step, rpm.
    step_rpm: f64,
    /// Number of setpoints between steps, and since the last one.
    every: u64,
    passed: u64,
    /// Present speed, rpm, negative counter-clockwise.
    rpm: f64,
    target_rpm: f64,
}

impl Ramp {
    fn new(rate_rpm_s: f64, period_ns: u64) -> Self {
        let every = (RAMP_STEP_NS / period_ns.max(1)).max(1);
        Self {
            step_rpm: rate_rpm_s * (every * period_ns) as f64 * 1e-9,
            every,
            passed: 0,
            rpm: 0.0,
            target_rpm: 0.0,
        }
    }

    /// Advances by one setpoint.
    fn follow(&mut self, target_rpm: f64, is_at_once: bool) {
        self.target_rpm = target_rpm;
        self.passed += 1;
        if is_at_once {
            self.rpm = target_rpm;
        } else if self.passed >= self.every {
            self.passed = 0;
            self.rpm += (target_rpm - self.rpm).clamp(-self.step_rpm, self.step_rpm);
        }
    }

    fn command(&self) -> SpindleCommand {
        let direction = match self.rpm {
            rpm if rpm > 0.0 => SpindleDirection::Clockwise,
            rpm if rpm < 0.0 => SpindleDirection::CounterClockwise,
            _ => SpindleDirection::Stopped,
        };
        SpindleCommand {
            rpm: self.rpm.abs(),
            passing: (self.rpm != self.target_rpm).then_some(direction),
        }
    }
}

/// The commands to the spindles with the last published setpoint.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SpindleCommands {
    mask: u32,
    max_rpm: [f64; SPINDLES],
    rpm: [f64; SPINDLES],
    ramps: [Option<Ramp>; SPINDLES],
}

impl SpindleCommands {
    /// `period_ns` is the time between setpoints.
    pub(crate) fn new(settings: &SignalSettings, period_ns: u64) -> Self {
        Self {
            mask: settings.spindle_mask(),
            max_rpm: settings.max_rpm(),
            rpm: [0.0; SPINDLES],
            ramps: std::array::from_fn(|number| {
                let rate_rpm_s = settings.spindle(number as u32)?.ramp_rpm_s?;
                Some(Ramp::new(rate_rpm_s, period_ns))
            }),
        }
    }

    pub(crate) fn now(&self) -> [SpindleCommand; SPINDLES] {
        std::array::from_fn(|number| match &self.ramps[number] {
            Some(ramp) => ramp.command(),
            None => SpindleCommand {
                rpm: self.rpm[number],
                passing: None,
            },
        })
    }

    /// Mask of the machine's spindles.
    pub(crate) fn mask(&self) -> u32 {
        self.mask
    }

    /// Whether the command of a spindle has a ramp.
    pub(crate) fn has_ramp(&self, number: usize) -> bool {
        self.ramps.get(number).is_some_and(Option::is_some)
    }

    /// The present commands in these directions, rpm, negative counter-clockwise, 0 if stopped.
    pub(crate) fn signed_rpm(&self, outputs: &Outputs) -> [f64; SPINDLES] {
        let now = self.now();
        std::array::from_fn(|number| {
            let command = now[number];
            match command.passing.unwrap_or(outputs.spindles[number].direction) {
                SpindleDirection::Stopped => 0.0,
                SpindleDirection::Clockwise => command.rpm,
                SpindleDirection::CounterClockwise => -command.rpm,
            }
        })
    }

    /// Advances to a setpoint with its X in machine coordinates, mm. `is_new`: the program has sent a
    /// command.
    pub(crate) fn follow(
        &mut self,
        outputs: &Outputs,
        x_mm: f64,
        overrides: &SpindleOverrides,
        is_new: bool,
    ) {
        for (number, spindle) in outputs.spindles.iter().enumerate() {
            let rpm = spindle
                .speed()
                .overridden_rpm_at(x_mm, overrides[number], self.max_rpm[number]);
            if is_new || (rpm - self.rpm[number]).abs() > MIN_CHANGE * self.rpm[number] {
                self.rpm[number] = rpm;
            }
            let target_rpm = match spindle.direction {
                SpindleDirection::Stopped => 0.0,
                SpindleDirection::Clockwise => self.rpm[number],
                SpindleDirection::CounterClockwise => -self.rpm[number],
            };
            if let Some(ramp) = &mut self.ramps[number] {
                ramp.follow(target_rpm, false);
            }
        }
    }

    /// Whether a spindle with a ramp turns, or is about to turn.
    pub(crate) fn ramps_turn(&self) -> bool {
        self.ramps
            .iter()
            .flatten()
            .any(|ramp| ramp.rpm != 0.0 || ramp.target_rpm != 0.0)
    }

    /// Ends every ramp at its target: the drives lose power and slow down on their own.
    pub(crate) fn end_ramps(&mut self) {
        for ramp in self.ramps.iter_mut().flatten() {
            ramp.follow(ramp.target_rpm, true);
        }
    }
}

/// The speed for the status, of the spindle with the lowest number, rpm: negative counter-clockwise, 0 if
/// stopped.
pub(crate) fn shown_rpm(
    outputs: &Outputs,
    x_mm: f64,
    overrides: &SpindleOverrides,
    settings: &SignalSettings,
) -> f64 {
    let first = settings.spindles.iter().min_by_key(|spindle| spindle.number);
    let (number, most) = first.map_or((0, f64::INFINITY), |spindle| (spindle.number, spindle.max_rpm));
    outputs
        .spindle(number)
        .signed_rpm_at(x_mm, overrides[number as usize], most)
}

#[cfg(test)]
mod tests {
    use evolvent_gcode::SpindleOutput;
    use evolvent_path::SurfaceSpeed;

    use super::*;

    #[test]
    fn surface_speed_is_commanded_in_steps_of_0_1_percent() {
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
            mask: 2,
            max_rpm: [3000.0; SPINDLES],
            rpm: [0.0; SPINDLES],
            ramps: [None; SPINDLES],
        };
        let (mut changes, mut before) = (0, 0.0);
        for k in 0..=50_000 {
            let x_mm = 50.0 - 0.001 * f64::from(k);
            command.follow(&outputs, x_mm, &[1.0; SPINDLES], false);
            let exact = (1e5 / (std::f64::consts::TAU * x_mm)).min(3000.0);
            assert!(
                (command.now()[1].rpm / exact - 1.0).abs() <= 0.0011,
                "{} at {x_mm}",
                command.now()[1].rpm
            );
            changes += u32::from(command.now()[1].rpm != before);
            before = command.now()[1].rpm;
        }
        // ln(3000 / 318.3) / 0.001, and no more close to the centre.
        assert!((1800..2400).contains(&changes), "{changes}");
        assert!((command.now()[1].rpm / 3000.0 - 1.0).abs() < 0.0011);
        command.follow(&outputs, 50.0, &[1.0, 0.5, 1.0, 1.0], true);
        assert!((command.now()[1].rpm - 159.155).abs() < 0.001);
    }

    /// By definition of 500 rpm/s: half a revolution per minute each millisecond, also through zero.
    #[test]
    fn a_ramp_keeps_its_rate_and_ends_without_power() {
        let mut commands = SpindleCommands {
            mask: 1,
            max_rpm: [3000.0; SPINDLES],
            rpm: [0.0; SPINDLES],
            ramps: [Some(Ramp::new(500.0, 250_000)), None, None, None],
        };
        let outputs = |direction, speed_rpm| {
            let mut outputs = Outputs::default();
            outputs.spindles[0].direction = direction;
            outputs.spindles[0].speed_rpm = speed_rpm;
            outputs
        };
        let signed = |commands: &SpindleCommands, end: SpindleDirection| {
            let command = commands.now()[0];
            match command.passing.unwrap_or(end) {
                SpindleDirection::CounterClockwise => -command.rpm,
                _ => command.rpm,
            }
        };
        let mut at = 0.0_f64;
        for (direction, target) in [
            (SpindleDirection::Clockwise, 100.0_f64),
            (SpindleDirection::CounterClockwise, -60.0),
            (SpindleDirection::Stopped, 0.0),
        ] {
            let cycles = ((target - at).abs() / 500.0 * 4000.0) as u32;
            for cycle in 1..=cycles {
                commands.follow(
                    &outputs(direction, target.abs()),
                    0.0,
                    &[1.0; SPINDLES],
                    cycle == 1,
                );
                let due = f64::from(cycle / 4) * 0.5 * (target - at).signum();
                assert!(
                    (signed(&commands, direction) - at - due).abs() < 1e-9,
                    "{cycle} to {target}"
                );
                assert_eq!(
                    commands.now()[0].passing.is_none(),
                    cycle == cycles,
                    "{cycle} to {target}"
                );
            }
            at = target;
        }
        commands.follow(
            &outputs(SpindleDirection::Clockwise, 900.0),
            0.0,
            &[1.0; SPINDLES],
            true,
        );
        assert!(commands.now()[0].passing.is_some());
        commands.end_ramps();
        assert_eq!(
            commands.now()[0],
            SpindleCommand {
                rpm: 900.0,
                passing: None
            }
        );
    }
}
