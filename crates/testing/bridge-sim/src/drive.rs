//! One simulated drive: state machine, servo loop, encoder, switches.

use evolvent_drive::{
    Brake, BrakeState, Braking, Cia402, DriveEvents, DriveMachine, DriveState, PowerRequest, QuickStopOption,
};
use evolvent_path::TURN_DEG;

use crate::servo::Servo;
use crate::settings::SimAxis;

/// Velocity below which an axis counts as standing, mm/s or degrees/s.
const STANDING: f64 = 0.05;
/// The home switch of an unlimited rotary axis is closed over this part of each turn.
const CAM_DEG: f64 = 20.0;
/// Duration of the self-test, periods.
const SELF_TEST: u32 = 10;
/// Object 603Fh of a simulated fault: following error (8611h), which drives report when an axis is blocked.
const ERROR_CODE: u16 = 0x8611;

/// Faults of one drive in one period.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct DriveTrouble {
    pub faulted: bool,
    pub disabled: bool,
    pub blocked: bool,
    /// State of the home switch, independent of the axis.
    pub home_switch: Option<bool>,
    /// The encoder has no index pulses.
    pub without_index: bool,
}

/// One drive with its axis.
#[derive(Clone, Debug)]
pub struct SimDrive {
    axis: SimAxis,
    machine: DriveMachine,
    controller: Cia402,
    servo: Servo,
    /// The position that the encoder shows, minus the true position of the axis.
    offset: f64,
    /// The last target, as a true position.
    target: f64,
    /// The drive's own ramp: quick stop, fault reaction, friction.
    ramp: Option<(Brake, f64)>,
    periods: u32,
    /// The index pulse that was passed in the last period, in the coordinates of the encoder.
    index: Option<f64>,
    /// State of the home switch, faults included.
    switch: Option<bool>,
}

impl SimDrive {
    /// Creates a drive that has just been supplied, with its axis at rest.
    #[must_use]
    pub const fn new(axis: SimAxis) -> Self {
        Self {
            machine: DriveMachine::new(QuickStopOption::ThenDisabled),
            controller: Cia402::new(),
            servo: Servo::at(axis.start),
            offset: axis.reference_offset,
            target: axis.start,
            ramp: None,
            periods: 0,
            index: None,
            switch: None,
            axis,
        }
    }

    /// The simulated axis.
    #[must_use]
    pub const fn axis(&self) -> &SimAxis {
        &self.axis
    }

    /// The state of the CiA 402 state machine.
    #[must_use]
    pub const fn state(&self) -> DriveState {
        self.machine.state()
    }

    /// Object 6041h.
    #[must_use]
    pub const fn status_word(&self) -> u16 {
        self.machine.status_word()
    }

    /// Object 603Fh.
    #[must_use]
    pub const fn error_code(&self) -> u16 {
        self.machine.error_code()
    }

    /// Number of the core's last reset that was carried out.
    #[must_use]
    pub const fn resets_done(&self) -> u32 {
        self.controller.resets_done()
    }

    /// True position, velocity and acceleration of the axis.
    #[must_use]
    pub const fn servo(&self) -> &Servo {
        &self.servo
    }

    /// The position that the encoder shows, on its grid, in the datum in force.
    #[must_use]
    pub fn shown(&self) -> f64 {
        let step = self.axis.encoder_step;
        let named = self.servo.position + self.offset;
        if step > 0.0 {
            (named / step).round() * step
        } else {
            named
        }
    }

    /// The index pulse that was passed in the last period, in the coordinates of the encoder.
    #[must_use]
    pub const fn passed_index(&self) -> Option<f64> {
        self.index
    }

    /// Shifts the datum: adds `shift` to every position.
    pub fn rename(&mut self, shift: f64) {
        self.offset += shift;
    }

    /// Torque as a ratio of the rated torque: the maximum acceleration of the axis takes half of it, the
    /// maximum velocity a tenth.
    #[must_use]
    pub fn torque_ratio(&self) -> f64 {
        0.5 * self.servo.acceleration / self.axis.max_acceleration
            + 0.1 * self.servo.velocity / self.axis.max_velocity
    }

    /// Whether the home switch is pressed.
    #[must_use]
    pub fn at_home_switch(&self) -> bool {
        let beyond = self.servo.position - self.axis.home_switch;
        if let Some(switch) = self.switch {
            switch
        } else if self.axis.unlimited {
            let into = if self.axis.home_switch_is_below {
                -beyond
            } else {
                beyond
            };
            into.rem_euclid(TURN_DEG) <= CAM_DEG
        } else if self.axis.home_switch_is_below {
            self.servo.position <= self.axis.home_switch
        } else {
            self.servo.position >= self.axis.home_switch
        }
    }

    /// Whether the limit switches are pressed: negative end, positive end.
    #[must_use]
    pub fn at_limit_switches(&self) -> [bool; 2] {
        if self.axis.unlimited {
            return [false; 2];
        }
        let [low, high] = self.axis.limit_switches();
        [self.servo.position <= low, self.servo.position >= high]
    }

    /// Simulates one period. `setpoint` is a position in the datum in force. Returns the target that the
    /// drive has followed.
    pub(crate) fn step(
        &mut self,
        setpoint: f64,
        power: PowerRequest,
        fault_reset: Option<u32>,
        trouble: DriveTrouble,
        period_s: f64,
    ) -> f64 {
        self.periods = self.periods.saturating_add(1);
        let order = self.controller.step(
            self.machine.status_word(),
            power,
            fault_reset,
            setpoint,
            self.shown(),
            Braking {
                period_s,
                is_standing: Some(self.servo.velocity.abs() < STANDING),
            },
        );
        let control_word = if trouble.disabled { 0 } else { order.control_word };
        let before = self.machine.state();
        self.machine.step(
            control_word,
            DriveEvents {
                ready: self.periods > SELF_TEST,
                fault: trouble.faulted.then_some(ERROR_CODE),
                at_rest: self.servo.velocity.abs() < STANDING,
            },
        );
        let state = self.machine.state();
        let from = self.target;
        if state == DriveState::OperationEnabled {
            self.ramp = None;
            self.target = if order.follows {
                order.target_position - self.offset
            } else {
                self.servo.position
            };
        } else {
            if self.ramp.is_none() || before == DriveState::OperationEnabled {
                self.ramp = Some((self.own_ramp(state), 0.0));
            }
            if let Some((ramp, time_s)) = &mut self.ramp {
                *time_s += period_s;
                self.target = ramp.at(*time_s).position;
            }
        }
        let held = self.servo;
        self.servo.step(&self.axis.servo, from, self.target, period_s);
        if trouble.blocked {
            self.servo = Servo::at(held.position);
        }
        self.switch = trouble.home_switch;
        let pulses = self.axis.index.filter(|_| !trouble.without_index);
        let passed = pulses.and_then(|index| index.between(held.position, self.servo.position));
        self.index = passed.map(|pulse| pulse + self.offset);
        self.target + self.offset
    }

    /// The ramp of the axis without setpoints: within the limits under torque, by friction without torque.
    fn own_ramp(&self, state: DriveState) -> Brake {
        let torque = matches!(
            state,
            DriveState::QuickStopActive | DriveState::FaultReactionActive
        );
        let limit = if torque { 1.0 } else { 0.5 } * self.axis.max_acceleration;
        // Starts at the last target, with the velocity of the axis, so that the loop sees no step.
        let start = BrakeState {
            position: self.target,
            velocity: self.servo.velocity,
            acceleration: self.servo.acceleration.clamp(-limit, limit),
        };
        Brake::new(start, limit, self.axis.max_jerk)
    }
}
