//! One axis: its position from counts, its velocity command, and the power states of its drive.

use evolvent_drive::{
    Brake, BrakeState, Braking, Cia402, DriveEvents, DriveMachine, DriveState, GantryMotor, PowerRequest,
    QuickStopOption, Target,
};

use crate::board_settings::{Actuator, BoardAxis};

/// Fraction of the position error that a stepper removes in one period. If a rate applies for a whole period
/// after its reading, the error follows e' = e - g e(previous), whose roots are real up to g = 1/4: the
/// fastest response without overshoot.
const GAIN: f64 = 0.25;
/// Maximum velocity of the correction, as a fraction of the maximum velocity.
const CORRECTION: f64 = 0.2;
/// Maximum velocity command, as a fraction of the maximum velocity.
const MAX_RATIO: f64 = 1.2;
/// Maximum contribution of the integral, as a fraction of the maximum velocity.
const INTEGRAL: f64 = 0.2;

/// Maximum counts of an encoder between two readings: a 16-bit counter cannot distinguish directions at 32
/// 768 counts.
pub(crate) const MAX_COUNTS: f64 = 30_000.0;
/// Maximum steps between two readings: accumulators have 16 bits of whole steps.
const MAX_STEPS: f64 = 32_000.0;

/// Maximum time without a reading, s: at its maximum velocity the counter of the axis would then wrap
/// unnoticed.
pub(crate) fn longest_gap_s(axis: &BoardAxis, max_velocity: f64) -> f64 {
    let most = match axis.actuator {
        Actuator::Steps { .. } => MAX_STEPS,
        Actuator::Servo { .. } => MAX_COUNTS,
    };
    most / (MAX_RATIO * max_velocity * axis.per_unit)
}

/// Object 603Fh: external error, by the drive's fault output.
pub(crate) const EXTERNAL: u16 = 0x9000;
/// Object 603Fh: following error, of the motors of a gantry that differ too much.
pub(crate) const APART: u16 = 0x8611;
/// Object 603Fh: communication.
pub(crate) const COMMUNICATION: u16 = 0x7500;

/// The outputs of an axis for one period.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct AxisOrder {
    /// Steps/s, or -1 to 1 of a servo.
    pub(crate) value: f64,
    /// Whether its drive has torque.
    pub(crate) is_enabled: bool,
}

/// Limits of an axis, per second.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AxisLimits {
    pub(crate) max_velocity: f64,
    pub(crate) max_acceleration: f64,
    pub(crate) max_jerk: f64,
}

/// The bridge's state of one axis. May be called by the cycle.
#[derive(Clone, Copy, Debug)]
pub(crate) struct MesaAxis {
    settings: BoardAxis,
    limits: AxisLimits,
    machine: DriveMachine,
    controller: Cia402,
    raw: Option<u32>,
    /// 1/65536 of a step, or counts.
    total: i64,
    /// Machine coordinate minus position of the counts.
    offset: f64,
    velocity: f64,
    measured_ns: u64,
    /// The last commanded velocity, of the axis.
    commanded: f64,
    /// The axis's own ramp, and its elapsed time.
    ramp: Option<(Brake, f64)>,
    integral: f64,
    last_error: Option<f64>,
    has_fault: bool,
    is_lost: bool,
    /// The axis must stop with the other motor of its gantry.
    is_apart: bool,
    /// Offset from the setpoint, and its velocity, for a motor of a gantry.
    apart: (f64, f64),
    /// Position at which it waits in operation for the others: the one at which it has come into operation.
    hold: Option<f64>,
    switches: [bool; 3],
}

impl MesaAxis {
    pub(crate) const fn new(settings: BoardAxis, limits: AxisLimits) -> Self {
        Self {
            settings,
            limits,
            machine: DriveMachine::new(QuickStopOption::ThenDisabled),
            controller: Cia402::new(),
            raw: None,
            total: 0,
            offset: settings.zero,
            velocity: 0.0,
            measured_ns: 0,
            commanded: 0.0,
            ramp: None,
            integral: 0.0,
            last_error: None,
            has_fault: false,
            is_lost: false,
            is_apart: false,
            apart: (0.0, 0.0),
            hold: None,
            switches: [false; 3],
        }
    }

    pub(crate) const fn settings(&self) -> &BoardAxis {
        &self.settings
    }

    pub(crate) const fn index(&self) -> usize {
        self.settings.axis
    }

    pub(crate) const fn state(&self) -> DriveState {
        self.machine.state()
    }

    pub(crate) const fn status_word(&self) -> u16 {
        self.machine.status_word()
    }

    pub(crate) const fn error_code(&self) -> u16 {
        self.machine.error_code()
    }

    pub(crate) const fn has_torque(&self) -> bool {
        self.machine.has_torque()
    }

    pub(crate) const fn resets_done(&self) -> u32 {
        self.controller.resets_done()
    }

    pub(crate) const fn switches(&self) -> [bool; 3] {
        self.switches
    }

    pub(crate) const fn velocity(&self) -> f64 {
        self.velocity
    }

    /// Marks the axis as lost: its board no longer replies.
    pub(crate) const fn set_lost(&mut self) {
        self.is_lost = true;
    }

    /// The machine coordinate at which it waits for the others, or its present one.
    pub(crate) fn held_position(&self) -> f64 {
        self.hold.unwrap_or_else(|| self.position())
    }

    pub(crate) fn rename(&mut self, shift: f64) {
        self.offset += shift;
        self.hold = self.hold.map(|hold| hold + shift);
        if let Some((brake, time_s)) = &mut self.ramp {
            // The ramp uses the previous coordinates; it continues from its position.
            let state = brake.at(*time_s);
            *brake = Brake::new(
                BrakeState {
                    position: state.position + shift,
                    ..state
                },
                self.limits.max_acceleration,
                self.limits.max_jerk,
            );
            *time_s = 0.0;
        }
    }

    fn sign(&self) -> f64 {
        if self.settings.inverted { -1.0 } else { 1.0 }
    }

    fn counts_per_unit(&self) -> f64 {
        match self.settings.actuator {
            Actuator::Steps { .. } => 65536.0 * self.settings.per_unit,
            Actuator::Servo { .. } => self.settings.per_unit,
        }
    }

    /// The machine coordinate at the last reading.
    pub(crate) fn position(&self) -> f64 {
        self.sign() * self.total as f64 / self.counts_per_unit() + self.offset
    }

    /// The encoder of this axis, and whether the rising edge of its index input is the pulse.
    pub(crate) const fn index_source(&self) -> Option<(usize, bool)> {
        match self.settings.actuator {
            Actuator::Servo {
                encoder,
                index_rising,
                ..
            } => Some((encoder, index_rising)),
            Actuator::Steps { .. } => None,
        }
    }

    /// The machine coordinate of a count close to the last reading.
    pub(crate) fn position_of(&self, count: u16) -> f64 {
        let away = count.wrapping_sub(self.raw.unwrap_or(0) as u16) as i16;
        let counts = self.total + i64::from(away);
        self.sign() * counts as f64 / self.counts_per_unit() + self.offset
    }

    /// Maximum time without a reading, s.
    pub(crate) fn longest_gap_s(&self) -> f64 {
        longest_gap_s(&self.settings, self.limits.max_velocity)
    }

    /// Time from the last reading to one at this time, s.
    pub(crate) fn gap_s(&self, measured_ns: u64) -> f64 {
        match self.raw {
            Some(_) => measured_ns.saturating_sub(self.measured_ns) as f64 * 1e-9,
            None => 0.0,
        }
    }

    /// Evaluates a reading.
    pub(crate) fn take(&mut self, raw: u32, measured_ns: u64, has_fault: bool, switches: [bool; 3]) {
        let step = match (self.raw, self.settings.actuator) {
            (None, _) => 0,
            // The top of an accumulator of 16 bits of steps; a counter of 16 bits.
            (Some(last), Actuator::Steps { .. }) => i64::from(raw.wrapping_sub(last) as i32),
            (Some(last), Actuator::Servo { .. }) => i64::from((raw as u16).wrapping_sub(last as u16) as i16),
        };
        self.total += step;
        let time_s = measured_ns.saturating_sub(self.measured_ns) as f64 * 1e-9;
        if self.raw.is_some() && time_s > 0.0 {
            self.velocity = self.sign() * step as f64 / self.counts_per_unit() / time_s;
        }
        self.raw = Some(raw);
        self.measured_ns = measured_ns;
        self.has_fault = has_fault;
        self.switches = switches;
    }

    /// Runs one period at a time of the bus's clock.
    pub(crate) fn step(
        &mut self,
        target: &Target,
        power: PowerRequest,
        now_ns: u64,
        period_s: f64,
    ) -> AxisOrder {
        let axis = self.settings.axis;
        let setpoint = target.position[axis] + self.apart.0;
        let order = self.controller.step(
            self.machine.status_word(),
            power,
            target.fault_reset,
            setpoint,
            0.0,
            // The machine here leaves its ramp by itself.
            Braking {
                period_s,
                is_standing: None,
            },
        );
        let ramp_ends = self
            .ramp
            .is_none_or(|(brake, time_s)| time_s >= brake.duration_s());
        let fault = match (self.is_lost, self.has_fault, self.is_apart) {
            (true, ..) => Some(COMMUNICATION),
            (_, true, _) => Some(EXTERNAL),
            (.., true) => Some(APART),
            (false, false, false) => None,
        };
        let before = self.machine.state();
        let state = self.machine.step(
            order.control_word,
            DriveEvents {
                ready: self.raw.is_some(),
                fault,
                at_rest: before != DriveState::OperationEnabled && ramp_ends,
            },
        );
        // A vertical axis would sag if its target followed its position.
        let waits = state == DriveState::OperationEnabled && !target.state.has_targets();
        self.hold = waits.then(|| self.held_position());
        let setpoint = self.hold.unwrap_or(setpoint);
        let velocity = match state {
            DriveState::OperationEnabled => {
                self.ramp = None;
                if order.follows && before == DriveState::OperationEnabled {
                    let velocity = target.velocity[axis] + self.apart.1;
                    let acceleration = target.acceleration[axis];
                    self.follow(setpoint, velocity, acceleration, now_ns, period_s)
                } else {
                    0.0
                }
            }
            DriveState::QuickStopActive | DriveState::FaultReactionActive => {
                if self.ramp.is_none() {
                    let limit = self.limits.max_acceleration;
                    let start = BrakeState {
                        position: self.position(),
                        velocity: self.commanded,
                        acceleration: target.acceleration[axis].clamp(-limit, limit),
                    };
                    self.ramp = Some((Brake::new(start, limit, self.limits.max_jerk), 0.0));
                }
                match &mut self.ramp {
                    Some((brake, time_s)) => {
                        let state = brake.at(*time_s);
                        *time_s += period_s;
                        self.follow(
                            state.position,
                            state.velocity,
                            state.acceleration,
                            now_ns,
                            period_s,
                        )
                    }
                    None => 0.0,
                }
            }
            _ => {
                (self.ramp, self.integral, self.last_error) = (None, 0.0, None);
                0.0
            }
        };
        self.commanded = velocity;
        let velocity = self.sign() * velocity;
        let is_enabled = self.machine.has_torque();
        AxisOrder {
            value: match self.settings.actuator {
                Actuator::Steps { .. } => velocity * self.settings.per_unit,
                Actuator::Servo { full_velocity, .. } => (velocity / full_velocity).clamp(-1.0, 1.0),
            },
            is_enabled,
        }
    }

    /// The velocity that brings the axis to a moving target. The reading and the setpoint have different
    /// times: the setpoint is evaluated at the time of the reading.
    fn follow(&mut self, position: f64, velocity: f64, acceleration: f64, now_ns: u64, period_s: f64) -> f64 {
        let later_s = (self.measured_ns as i128 - i128::from(now_ns)) as f64 * 1e-9;
        // An old reading, of a packet before the last, is extrapolated with the commanded velocity.
        let (later_s, here) = if later_s < 0.0 {
            (0.0, self.position() - later_s * self.commanded)
        } else {
            (later_s.min(period_s), self.position())
        };
        let error = position + velocity * later_s - here;
        let most = self.limits.max_velocity;
        // Beyond its timing limits a step generator counts steps that its pins do not show.
        let possible = match self.settings.actuator {
            Actuator::Steps { timing, .. } => {
                0.999e9 / (timing.length_ns + timing.space_ns + 20.0) / self.settings.per_unit
            }
            Actuator::Servo { full_velocity, .. } => full_velocity,
        };
        let wanted = match self.settings.actuator {
            Actuator::Steps { .. } => {
                let correction = (GAIN / period_s * error).clamp(-CORRECTION * most, CORRECTION * most);
                velocity + 0.5 * acceleration * period_s + correction
            }
            Actuator::Servo { gains, .. } => {
                self.integral =
                    (self.integral + gains.i * error * period_s).clamp(-INTEGRAL * most, INTEGRAL * most);
                // The first error after a time without torque has no rate relative to the one before.
                let rate = self.last_error.map_or(0.0, |last| (error - last) / period_s);
                self.last_error = Some(error);
                velocity + gains.p * error + self.integral + gains.d * rate
            }
        };
        let highest = (MAX_RATIO * most).min(possible);
        wanted.clamp(-highest, highest)
    }
}

impl GantryMotor for MesaAxis {
    fn axis(&self) -> usize {
        self.index()
    }

    fn position(&self) -> f64 {
        self.position()
    }

    fn velocity(&self) -> f64 {
        self.velocity()
    }

    fn held_position(&self) -> f64 {
        self.held_position()
    }

    fn home_switch(&self) -> bool {
        self.switches()[0]
    }

    fn rename(&mut self, shift: f64) {
        self.rename(shift);
    }

    fn set_apart(&mut self, distance: f64, velocity: f64) {
        self.apart = (distance, velocity);
    }

    fn set_too_far_apart(&mut self, is_apart: bool) {
        self.is_apart = is_apart;
    }
}

#[cfg(test)]
mod tests {
    use evolvent_drive::{Follower, FollowerSettings};
    use evolvent_path::{AXES, AxisMask};

    use super::*;
    use crate::board_settings::BoardSettings;

    const PERIOD_NS: u64 = 1_000_000;

    /// An analog servo with 4000 counts per mm, as X.
    fn servo() -> MesaAxis {
        servo_with("")
    }

    /// [`servo`] with more lines in its board file.
    fn servo_with(lines: &str) -> MesaAxis {
        let board = evolvent_file_tests::shipped("boards/7i96s-router.toml");
        let (head, _axes) = board.split_once("[[axis]]").expect("axes");
        let axis = "[[axis]]\nletter = \"X\"\nencoder = 0\ncounts_per_unit = 4000\npwm = 0\n\
                    full_velocity = 200\np_gain = 40\n";
        let board =
            BoardSettings::parse(&format!("{head}{axis}{lines}"), "board.toml").expect("a board file");
        let limits = AxisLimits {
            max_velocity: 100.0,
            max_acceleration: 1000.0,
            max_jerk: 40_000.0,
        };
        MesaAxis::new(board.axes[0], limits)
    }

    /// The follower's target while not all axes are in operation.
    fn target_at(position: f64) -> Target {
        let mut follower = Follower::new(FollowerSettings {
            period_ns: PERIOD_NS,
            bridge_cycles: 10,
            axes: AxisMask::one(0),
            max_velocity: [100.0; AXES],
            max_acceleration: [1000.0; AXES],
            max_jerk: [40_000.0; AXES],
            sync_tolerance: [0.5; AXES],
        })
        .expect("settings");
        follower.step(PERIOD_NS, false, &[position; AXES])
    }

    #[test]
    fn a_servo_that_waits_for_the_others_holds_its_place() {
        let mut axis = servo();
        // 1 mm down in 4000 periods, from 2 mm.
        let mut value = 0.0;
        for period in 0..4010_u64 {
            let now_ns = period * PERIOD_NS;
            let counts = 8000 - period.saturating_sub(10) as u32;
            axis.take(counts, now_ns, false, [false; 3]);
            let target = target_at(axis.position());
            value = axis.step(&target, PowerRequest::On, now_ns, 1e-3).value;
        }
        assert_eq!(axis.state(), DriveState::OperationEnabled);
        // The gain times 1 mm.
        assert!((value - 40.0 / 200.0).abs() < 0.001, "{value}");
        assert!((axis.held_position() - axis.position() - 1.0).abs() < 1e-3);
        // With another coordinate the position is the same.
        axis.rename(7.0);
        assert!((axis.held_position() - axis.position() - 1.0).abs() < 1e-3);
    }

    /// The value in each period of an enabled servo that is pushed away from its position at 0.25 mm/s.
    fn pushed(axis: &mut MesaAxis) -> Vec<f64> {
        (0..200_u64)
            .map(|period| {
                let now_ns = period * PERIOD_NS;
                axis.take(8000 - period.saturating_sub(10) as u32, now_ns, false, [false; 3]);
                let target = target_at(axis.position());
                axis.step(&target, PowerRequest::On, now_ns, 1e-3).value
            })
            .collect()
    }

    #[test]
    fn the_derivative_gain_acts_on_the_rate_of_the_error() {
        let (proportional, both) = (pushed(&mut servo()), pushed(&mut servo_with("d_gain = 0.8\n")));
        let added: Vec<f64> = both
            .iter()
            .zip(&proportional)
            .map(|(both, one)| both - one)
            .collect();
        assert_eq!(added[..10], [0.0; 10], "it stands");
        // One count per period is 0.25 mm/s, of 200 mm/s at full output.
        for value in &added[20..] {
            assert!((value - 0.8 * 0.25 / 200.0).abs() < 1e-9, "{value}");
        }
    }

    /// The error before power-off must not contribute to the rate afterwards.
    #[test]
    fn the_derivative_gain_gives_no_kick_as_power_returns() {
        let mut axis = servo_with("d_gain = 0.8\n");
        let pushed = pushed(&mut axis);
        assert!(pushed[199] > 0.005, "an error has built up: {}", pushed[199]);
        for (power, periods) in [(PowerRequest::Off, 200..210), (PowerRequest::On, 210..260)] {
            for period in periods {
                let now_ns = period * PERIOD_NS;
                axis.take(8000 - 190, now_ns, false, [false; 3]);
                let target = target_at(axis.position());
                let order = axis.step(&target, power, now_ns, 1e-3);
                if power == PowerRequest::On {
                    assert!(order.value.abs() < 1e-9, "period {period}: {}", order.value);
                }
            }
        }
        assert_eq!(axis.state(), DriveState::OperationEnabled);
    }
}
