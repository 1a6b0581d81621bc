//! A CiA 402 drive with its motor: cyclic synchronous position and velocity, homing, touch probe, following
//! error.

use core::f64::consts::TAU;

use evolvent_drive::{DriveEvents, DriveMachine, DriveState, QuickStopOption, bits};

use crate::digital_outputs::DigitalOutputs;
use crate::drive_settings::DriveSettings;
use crate::homing::{Homing, HomingState, Sight};
use crate::motor::TwoMass;
use crate::object::Dictionary;
use crate::probe::{Probe, ProbeSources};

/// The period of the drive's own control, ns.
pub(crate) const STEP_NS: u64 = 125_000;
/// [`STEP_NS`] in s.
const STEP_S: f64 = 125e-6;
/// Gain of the position loop, 1/s.
const POSITION_GAIN: f64 = 80.0;
/// Bandwidth of the speed loop, rad/s.
const SPEED_BANDWIDTH: f64 = TAU * 60.0;
/// Integral time of the speed loop, s.
const INTEGRAL_S: f64 = 0.02;
/// Maximum torque, as a multiple of the rated torque.
const PEAK_TORQUE: f64 = 3.0;
/// Speed below which the axis is at standstill, turns/s.
const STANDING: f64 = 0.01;
/// Steps of the self-test: 10 ms.
const SELF_TEST: u32 = 80;
/// Error codes of object 603Fh.
mod code {
    /// Following error.
    pub(super) const FOLLOWING: u16 = 0x8611;
    /// The fieldbus was lost under power.
    pub(super) const COMMUNICATION: u16 = 0x7500;
}

/// Modes of operation.
const CSP: i8 = 8;
const HOMING: i8 = 6;
const CSV: i8 = 9;

/// Simulated faults of a drive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct DriveTrouble {
    /// A fault with this code.
    pub(crate) fault: Option<u16>,
    /// Safe torque off.
    pub(crate) torque_off: bool,
    /// The load is blocked.
    pub(crate) blocked: bool,
    /// Both limit switches are pressed.
    pub(crate) limit: bool,
    /// The encoder gives no zero impulse.
    pub(crate) no_index: bool,
}

/// The last accepted outputs.
#[derive(Clone, Copy, Debug, Default)]
struct Orders {
    control_word: u16,
    mode: i8,
    target: i32,
    target_velocity: i32,
    velocity_offset: i32,
    torque_offset: i16,
    digital: DigitalOutputs,
}

/// Demand position of the axis, turns.
#[derive(Clone, Copy, Debug, Default)]
struct Demand {
    position: f64,
    velocity: f64,
}

/// One drive.
#[derive(Clone, Debug)]
pub struct Drive {
    settings: DriveSettings,
    machine: DriveMachine,
    masses: TwoMass,
    /// Reported position minus motor position, increments.
    offset: i64,
    orders: Orders,
    demand: Demand,
    /// Turns per step towards the newest target, and the remaining steps.
    stride: (f64, u32),
    /// Maximum distance between successive targets in operation, turns.
    longest_step_turns: f64,
    integral_n_m: f64,
    torque_n_m: f64,
    homing: Homing,
    probe: Probe,
    beyond_window_s: f64,
    /// Fault detected by the drive itself, until it is reset.
    own_fault: Option<u16>,
    was_operational: bool,
    was_supplied: bool,
    pub(crate) trouble: DriveTrouble,
    steps: u32,
}

impl Drive {
    /// Creates a drive that has just been supplied.
    #[must_use]
    pub(crate) fn new(settings: DriveSettings) -> Self {
        let start = (settings.start_turns * f64::from(settings.resolution)).floor() as i64;
        Self {
            settings,
            machine: DriveMachine::new(QuickStopOption::ThenDisabled),
            masses: TwoMass::at_turns(settings.start_turns),
            offset: i64::from(settings.start_increments) - start,
            orders: Orders::default(),
            demand: Demand {
                position: settings.start_turns,
                velocity: 0.0,
            },
            stride: (0.0, 0),
            longest_step_turns: 0.0,
            integral_n_m: 0.0,
            torque_n_m: 0.0,
            homing: Homing::default(),
            probe: Probe::at(settings.start_turns),
            beyond_window_s: 0.0,
            own_fault: None,
            was_operational: false,
            was_supplied: false,
            trouble: DriveTrouble::default(),
            steps: 0,
        }
    }

    /// Simulates a restart of the supply: only an absolute encoder keeps its position.
    pub(crate) fn restart(&mut self) {
        let (masses, settings) = (self.masses, self.settings);
        let counted = (masses.motor / TAU * f64::from(settings.resolution)).floor() as i64;
        // The first supply occurs when the ring is created.
        let keeps = settings.absolute || !self.was_supplied;
        let offset = if keeps { self.offset } else { -counted };
        *self = Self {
            masses: TwoMass {
                motor_speed: 0.0,
                load_speed: 0.0,
                ..masses
            },
            offset,
            was_supplied: true,
            // The step to the start position is no edge.
            probe: Probe::at(masses.motor / TAU),
            ..Self::new(settings)
        };
    }

    /// The settings of the drive.
    #[must_use]
    pub const fn settings(&self) -> &DriveSettings {
        &self.settings
    }

    /// The state of the CiA 402 state machine.
    #[must_use]
    pub const fn state(&self) -> DriveState {
        self.machine.state()
    }

    /// Turns of the motor.
    #[must_use]
    pub fn motor_turns(&self) -> f64 {
        self.masses.motor / TAU
    }

    /// Turns of the load.
    #[must_use]
    pub fn load_turns(&self) -> f64 {
        self.masses.load / TAU
    }

    /// Speed of the motor, turns/s.
    #[must_use]
    pub fn speed_turns_s(&self) -> f64 {
        self.masses.motor_speed / TAU
    }

    /// Object 6064h.
    #[must_use]
    pub fn position(&self) -> i32 {
        self.increments(self.motor_turns())
    }

    fn increments(&self, turns: f64) -> i32 {
        // Counters wrap around.
        ((turns * f64::from(self.settings.resolution)).floor() as i64).wrapping_add(self.offset) as i32
    }

    /// Converts a reported position to turns, choosing the counter turn nearest to the motor.
    fn turns(&self, increments: i32) -> f64 {
        let away = increments.wrapping_sub(self.position());
        let resolution = f64::from(self.settings.resolution);
        (self.motor_turns() * resolution).floor() / resolution + f64::from(away) / resolution
    }

    /// The limit switches: negative end, positive end.
    fn limits(&self) -> [bool; 2] {
        let [negative, positive] = self.settings.limits_turns;
        let at = self.load_turns();
        [
            at <= negative || self.trouble.limit,
            at >= positive || self.trouble.limit,
        ]
    }

    /// Accepts outputs. `cycle_ns` is the period of SYNC0, if it is on.
    pub(crate) fn take_outputs(&mut self, objects: &Dictionary, cycle_ns: Option<u64>) {
        let before = self.orders;
        self.orders = Orders {
            control_word: objects.integer(0x6040, 0) as u16,
            mode: objects.integer(0x6060, 0) as i8,
            target: objects.integer(0x607A, 0) as i32,
            target_velocity: objects.integer(0x60FF, 0) as i32,
            velocity_offset: objects.integer(0x60B1, 0) as i32,
            torque_offset: objects.integer(0x60B2, 0) as i16,
            digital: DigitalOutputs::requested(objects, self.settings.output_mask),
        };
        self.probe.set_function(objects.integer(0x60B8, 0) as u16);
        let interpolation_s =
            objects.integer(0x60C2, 1) as f64 * 10_f64.powi(objects.integer(0x60C2, 2) as i32);
        let cycle_s = cycle_ns.map_or(interpolation_s, |cycle_ns| cycle_ns as f64 * 1e-9);
        let steps = (cycle_s / STEP_S).round().clamp(1.0, 800.0);
        let away = self.turns(self.orders.target) - self.demand.position;
        self.stride = (away / steps, steps as u32);
        // Measured on the targets themselves, because the motor is slower.
        if self.machine.state() == DriveState::OperationEnabled
            && (before.mode, self.orders.mode) == (CSP, CSP)
        {
            let step = self.orders.target.wrapping_sub(before.target);
            let turns = f64::from(step).abs() / f64::from(self.settings.resolution);
            self.longest_step_turns = self.longest_step_turns.max(turns);
        }
    }

    /// Returns the maximum distance between successive targets in operation since the last call, turns.
    pub fn take_longest_step_turns(&mut self) -> f64 {
        core::mem::take(&mut self.longest_step_turns)
    }

    /// Discards the outputs, because the fieldbus is not in OP.
    pub(crate) fn forget_orders(&mut self) {
        self.orders.control_word = 0;
        self.orders.digital = DigitalOutputs::default();
    }

    /// The contacts of its digital outputs (60FEh); bit 0 is the brake.
    #[must_use]
    pub fn digital_outputs(&self) -> u32 {
        self.orders.digital.contacts(self.machine.has_torque())
    }

    /// Runs one control step. `operational`: the fieldbus is in OP.
    pub(crate) fn step(&mut self, objects: &Dictionary, operational: bool) {
        self.steps = self.steps.saturating_add(1);
        if self.was_operational && !operational && self.machine.has_torque() {
            self.own_fault = Some(code::COMMUNICATION);
        }
        self.was_operational = operational;
        let speed = self.speed_turns_s();
        let at_rest = speed.abs() < STANDING && self.demand.velocity.abs() < STANDING;
        let before = self.machine.state();
        let control_word = if !operational || self.trouble.torque_off {
            0
        } else {
            self.orders.control_word
        };
        let fault = self.trouble.fault.or(self.own_fault.take());
        self.machine.step(
            control_word,
            DriveEvents {
                ready: self.steps > SELF_TEST,
                fault,
                at_rest,
            },
        );
        let state = self.machine.state();
        if state == DriveState::OperationEnabled && before != state {
            self.demand = Demand {
                position: self.motor_turns(),
                velocity: 0.0,
            };
            self.stride = (0.0, 0);
            self.integral_n_m = 0.0;
        }
        // Demand and motor at the same instant: with the demand at the end of the step the motor would lead
        // by one step.
        self.torque_n_m = self.torque(state);
        self.advance_demand(objects, state);
        self.watch_following(objects, state);
        let load = self.masses.load;
        self.masses
            .step(&self.settings.mechanics, self.torque_n_m, STEP_S);
        if self.trouble.blocked {
            self.masses.block(load);
        }
        let sources = ProbeSources {
            input_turns: self.settings.probe_turns,
            impulse_turns: (!self.trouble.no_index).then_some(self.settings.index_turns),
            impulse_width_turns: 1.0 / f64::from(self.settings.resolution),
        };
        self.probe.step(self.motor_turns(), &sources);
    }

    fn advance_demand(&mut self, objects: &Dictionary, state: DriveState) {
        let resolution = f64::from(self.settings.resolution);
        match state {
            DriveState::OperationEnabled if self.orders.mode == CSP => {
                self.homing.stop();
                self.demand.velocity = f64::from(self.orders.velocity_offset) / resolution;
                if self.stride.1 > 0 {
                    self.demand.position += self.stride.0;
                    self.stride.1 -= 1;
                }
            }
            DriveState::OperationEnabled if self.orders.mode == CSV => {
                self.homing.stop();
                let wanted = f64::from(self.orders.target_velocity) / resolution;
                let max_change = self.settings.velocity_ramp_turns_s2 * STEP_S;
                self.demand.velocity += (wanted - self.demand.velocity).clamp(-max_change, max_change);
                self.demand.position += self.demand.velocity * STEP_S;
            }
            DriveState::OperationEnabled if self.orders.mode == HOMING => {
                let speed = self.home(objects, resolution);
                let max_change = objects.integer(0x609A, 0) as f64 / resolution * STEP_S;
                self.demand.velocity += (speed - self.demand.velocity).clamp(-max_change, max_change);
                self.demand.position += self.demand.velocity * STEP_S;
            }
            DriveState::OperationEnabled => self.demand.velocity = 0.0,
            DriveState::QuickStopActive | DriveState::FaultReactionActive => {
                let max_change = objects.integer(0x6085, 0) as f64 / resolution * STEP_S;
                // The ramp begins at the actual speed of the axis.
                if self.demand.velocity == 0.0 && self.speed_turns_s().abs() > max_change {
                    self.demand.velocity = self.speed_turns_s();
                }
                self.demand.velocity -= self.demand.velocity.clamp(-max_change, max_change);
                self.demand.position += self.demand.velocity * STEP_S;
            }
            _ => {
                self.demand = Demand {
                    position: self.motor_turns(),
                    velocity: 0.0,
                }
            }
        }
    }

    /// The speed demanded by homing.
    fn home(&mut self, objects: &Dictionary, resolution: f64) -> f64 {
        let starts = self.orders.control_word >> 4 & 1 == 1;
        if !starts {
            self.homing.stop();
            return 0.0;
        }
        let mut found = None;
        if self.homing.state == HomingState::Idle {
            let method = objects.integer(0x6098, 0) as i8;
            self.homing
                .start(method, self.motor_turns() - self.settings.index_turns);
            if self.homing.state == HomingState::Attained {
                found = Some(self.motor_turns());
            }
        }
        let [negative_limit, positive_limit] = self.limits();
        let index_turns = self.settings.index_turns;
        let sight = Sight {
            negative_limit,
            positive_limit,
            turns: self.motor_turns() - index_turns,
            has_index: !self.trouble.no_index,
        };
        let fast = objects.integer(0x6099, 1) as f64 / resolution;
        let slow = objects.integer(0x6099, 2) as f64 / resolution;
        let (speed, home) = self.homing.step(sight, fast, slow);
        if let Some(turns) = found.or(home.map(|turns| turns + index_turns)) {
            let home_offset = objects.integer(0x607C, 0);
            self.offset = home_offset - (turns * resolution).floor() as i64;
        }
        speed
    }

    fn watch_following(&mut self, objects: &Dictionary, state: DriveState) {
        let window = objects.integer(0x6065, 0);
        let error = (self.demand.position - self.motor_turns()).abs() * f64::from(self.settings.resolution);
        let is_off = window != 0xFFFF_FFFF && state == DriveState::OperationEnabled && error > window as f64;
        self.beyond_window_s = if is_off {
            self.beyond_window_s + STEP_S
        } else {
            0.0
        };
        if self.beyond_window_s * 1000.0 > objects.integer(0x6066, 0) as f64 {
            self.own_fault = Some(code::FOLLOWING);
        }
    }

    fn torque(&mut self, state: DriveState) -> f64 {
        let mechanics = &self.settings.mechanics;
        let peak = PEAK_TORQUE * mechanics.rated_torque_n_m;
        let inertia = mechanics.motor_inertia_kg_m2 + mechanics.load_inertia_kg_m2;
        let gain = SPEED_BANDWIDTH * inertia;
        if !self.machine.has_torque() || self.trouble.torque_off {
            self.integral_n_m = 0.0;
            // The holding brake.
            return (-gain * self.masses.motor_speed)
                .clamp(-mechanics.rated_torque_n_m, mechanics.rated_torque_n_m);
        }
        let speed = POSITION_GAIN * (self.demand.position - self.motor_turns()) + self.demand.velocity;
        let error = speed * TAU - self.masses.motor_speed;
        let offset = if state == DriveState::OperationEnabled && self.orders.mode == CSP {
            f64::from(self.orders.torque_offset) / 1000.0 * mechanics.rated_torque_n_m
        } else {
            0.0
        };
        let wanted = gain * error + self.integral_n_m + offset;
        if wanted.abs() < peak {
            self.integral_n_m += gain * error * STEP_S / INTEGRAL_S;
        }
        wanted.clamp(-peak, peak)
    }

    /// Writes the inputs into the dictionary.
    pub(crate) fn give_inputs(&self, objects: &mut Dictionary) {
        let resolution = f64::from(self.settings.resolution);
        let [negative, positive] = self.limits();
        let mut status = self.machine.status_word();
        if self.trouble.torque_off {
            status &= !bits::VOLTAGE_ENABLED;
        }
        if negative || positive {
            status |= bits::INTERNAL_LIMIT;
        }
        if self.orders.mode == HOMING {
            status &= !(bits::FOLLOWS_TARGET | bits::FOLLOWING_ERROR);
            let standing = self.demand.velocity == 0.0;
            match self.homing.state {
                HomingState::Attained if standing => status |= 1 << 10 | 1 << 12,
                HomingState::Failed => status |= 1 << 10 | 1 << 13,
                _ => {}
            }
        } else if !matches!(self.orders.mode, CSP | CSV) {
            status &= !bits::FOLLOWS_TARGET;
        } else if self.beyond_window_s > 0.0 {
            status |= bits::FOLLOWING_ERROR;
        }
        let following = (self.demand.position - self.motor_turns()) * resolution;
        let probe_input = self.motor_turns() >= self.settings.probe_turns;
        let home = self.load_turns() <= self.settings.home_switch_turns;
        let inputs = i64::from(negative)
            | i64::from(positive) << 1
            | i64::from(home) << 2
            | i64::from(probe_input) << 16;
        let torque = self.torque_n_m / self.settings.mechanics.rated_torque_n_m * 1000.0;
        let values = [
            (0x603F, i64::from(self.machine.error_code())),
            (0x6041, i64::from(status)),
            (0x6061, i64::from(self.orders.mode)),
            (0x6064, i64::from(self.position())),
            (0x606C, (self.speed_turns_s() * resolution) as i64),
            (0x6077, torque as i64),
            (0x60B9, i64::from(self.probe.status)),
            (0x60F4, following as i64),
            (0x60FD, inputs),
        ];
        for (index, value) in values {
            objects.set_integer(index, 0, value);
        }
        for (index, caught) in (0x60BA..).zip(self.probe.caught) {
            if let Some(turns) = caught {
                objects.set_integer(index, 0, i64::from(self.increments(turns)));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drive_objects::add_drive_objects;

    /// A drive with its objects, which receives outputs every ms.
    struct Axis {
        drive: Drive,
        objects: Dictionary,
    }

    impl Axis {
        fn new(settings: DriveSettings) -> Self {
            let (drive, mut objects) = (Drive::new(settings), Dictionary::default());
            add_drive_objects(&settings, &mut objects);
            let mut axis = Self { drive, objects };
            axis.objects.set_integer(0x6060, 0, i64::from(CSP));
            axis.run(20);
            axis
        }

        fn run(&mut self, milliseconds: u32) {
            for _ in 0..milliseconds {
                self.drive.take_outputs(&self.objects, None);
                for _ in 0..8 {
                    self.drive.step(&self.objects, true);
                }
                self.drive.give_inputs(&mut self.objects);
            }
        }

        fn switch_on(&mut self) {
            for control_word in [0x06, 0x07, 0x0F] {
                let actual = self.objects.integer(0x6064, 0);
                self.objects.set_integer(0x607A, 0, actual);
                self.objects.set_integer(0x6040, 0, control_word);
                self.run(2);
            }
            assert_eq!(self.drive.state(), DriveState::OperationEnabled);
        }

        /// Moves at a constant speed. Returns the maximum following error after the first 100 ms, turns.
        fn go(&mut self, turns_s: f64, milliseconds: u32, feed_forward: bool) -> f64 {
            let resolution = f64::from(self.drive.settings.resolution);
            let start = self.objects.integer(0x607A, 0) as f64;
            let mut max_error = 0.0_f64;
            for millisecond in 1..=milliseconds {
                let target = start + turns_s * resolution * f64::from(millisecond) * 1e-3;
                self.objects.set_integer(0x607A, 0, target as i64);
                let speed = if feed_forward { turns_s * resolution } else { 0.0 };
                self.objects.set_integer(0x60B1, 0, speed as i64);
                self.run(1);
                if millisecond > 100 {
                    max_error = max_error.max(self.objects.integer(0x60F4, 0).abs() as f64 / resolution);
                }
            }
            self.objects.set_integer(0x60B1, 0, 0);
            max_error
        }
    }

    /// A position loop lags a ramp by speed divided by gain, and by almost nothing with velocity
    /// feed-forward.
    #[test]
    fn the_lag_is_speed_over_gain() {
        let mut axis = Axis::new(DriveSettings::default());
        axis.switch_on();
        let trail = axis.go(5.0, 500, false);
        assert!((trail / (5.0 / POSITION_GAIN) - 1.0).abs() < 0.1, "{trail}");
        axis.run(300);
        let trail = axis.go(5.0, 500, true);
        assert!(trail < 0.01, "{trail}");
        assert!((axis.drive.motor_turns() - 5.0).abs() < 0.02);
    }

    #[test]
    fn homing_methods_find_switches_and_index() {
        for (method, expected) in [
            (17, -10.2),
            (18, 12.3),
            (1, -10.0),
            (2, 12.0),
            (33, -1.0),
            (34, 0.0),
            (35, -0.3),
            (37, -0.3),
        ] {
            let mut axis = Axis::new(DriveSettings {
                limits_turns: [-10.2, 12.3],
                start_turns: -0.3,
                start_increments: 777,
                ..DriveSettings::default()
            });
            let resolution = f64::from(axis.drive.settings.resolution);
            axis.objects.set_integer(0x6098, 0, method);
            axis.objects.set_integer(0x607C, 0, 5000);
            axis.objects.set_integer(0x6060, 0, i64::from(HOMING));
            axis.switch_on();
            axis.objects.set_integer(0x6040, 0, 0x1F);
            let mut milliseconds = 0;
            while axis.objects.integer(0x6041, 0) >> 12 & 1 == 0 {
                axis.run(1);
                milliseconds += 1;
                assert!(milliseconds < 8000, "method {method}: {:?}", axis.drive.homing);
            }
            assert_eq!(axis.objects.integer(0x6041, 0) >> 10 & 1, 1);
            let home =
                axis.drive.motor_turns() - (axis.objects.integer(0x6064, 0) - 5000) as f64 / resolution;
            // The switch is on the load, the encoder on the motor.
            let tolerance = if matches!(method, 17 | 18) { 0.01 } else { 1e-5 };
            assert!((home - expected).abs() < tolerance, "method {method}: {home}");
        }
    }

    #[test]
    fn the_probe_catches_the_first_edge_where_it_is() {
        let mut axis = Axis::new(DriveSettings {
            probe_turns: 0.7,
            ..DriveSettings::default()
        });
        axis.switch_on();
        axis.objects.set_integer(0x60B8, 0, 0x11);
        axis.run(1);
        assert_eq!(axis.objects.integer(0x60B9, 0), 1);
        axis.go(2.0, 500, true);
        assert_eq!(axis.objects.integer(0x60B9, 0), 0b11);
        let expected = (0.7 * f64::from(axis.drive.settings.resolution)) as i64;
        assert!((axis.objects.integer(0x60BA, 0) - expected).abs() <= 1);
        assert_eq!(axis.objects.integer(0x60FD, 0) >> 16 & 1, 1);
    }

    /// Touch probe 2 at the zero impulse together with touch probe 1 at its input: each latches its own
    /// position, in both directions, at the first edge only. A new arming latches the next impulse. Without
    /// an impulse nothing is latched.
    #[test]
    fn zero_impulse_latches_once_per_arming_beside_input() {
        for direction in [1.0, -1.0] {
            let mut axis = Axis::new(DriveSettings {
                probe_turns: 0.6 * direction,
                index_turns: 0.25,
                ..DriveSettings::default()
            });
            let resolution = f64::from(axis.drive.settings.resolution);
            axis.switch_on();
            axis.objects.set_integer(0x60B8, 0, 0x3031 | 0x0500);
            axis.run(1);
            assert_eq!(axis.objects.integer(0x60B9, 0), 0x0101);
            axis.go(2.0 * direction, 1000, true);
            let (first, second) = if direction > 0.0 {
                (0.25, 2.25)
            } else {
                (-0.75, -2.75)
            };
            let input = if direction > 0.0 { 0x60BA } else { 0x60BB };
            for (index, turns) in [(0x60BC, first), (0x60BD, first), (input, 0.6 * direction)] {
                let caught = axis.objects.integer(index, 0) as f64;
                assert!((caught - turns * resolution).abs() <= 1.0, "{index:X}h {caught}");
            }
            assert_eq!(axis.objects.integer(0x60B9, 0) >> 8, 0b111);
            axis.objects.set_integer(0x60B8, 0, 0);
            axis.run(1);
            assert_eq!(axis.objects.integer(0x60B9, 0), 0);
            axis.objects.set_integer(0x60B8, 0, 0x1500);
            axis.run(1);
            axis.go(2.0 * direction, 400, true);
            let caught = axis.objects.integer(0x60BC, 0) as f64;
            assert!((caught - second * resolution).abs() <= 1.0, "{caught}");
            axis.objects.set_integer(0x60B8, 0, 0);
            axis.run(1);
            axis.objects.set_integer(0x60B8, 0, 0x1500);
            axis.drive.trouble.no_index = true;
            axis.go(2.0 * direction, 1500, true);
            assert_eq!(axis.objects.integer(0x60B9, 0), 0x0100, "no impulse");
        }
    }

    #[test]
    fn a_blocked_load_is_a_following_error() {
        let mut axis = Axis::new(DriveSettings::default());
        axis.switch_on();
        axis.drive.trouble.blocked = true;
        axis.go(20.0, 400, true);
        assert_eq!(axis.drive.state(), DriveState::Fault);
        assert_eq!(axis.objects.integer(0x603F, 0), 0x8611);
        axis.drive.trouble.blocked = false;
        for control_word in [0, 0x80, 0] {
            axis.objects.set_integer(0x6040, 0, control_word);
            axis.run(2);
        }
        assert_eq!(
            (axis.drive.state(), axis.objects.integer(0x603F, 0)),
            (DriveState::SwitchOnDisabled, 0)
        );
    }

    #[test]
    fn without_the_fieldbus_it_brakes_and_faults() {
        let mut axis = Axis::new(DriveSettings::default());
        axis.switch_on();
        axis.go(10.0, 300, true);
        for _ in 0..8000 {
            axis.drive.step(&axis.objects, false);
        }
        axis.drive.give_inputs(&mut axis.objects);
        assert_eq!(
            (axis.drive.state(), axis.objects.integer(0x603F, 0)),
            (DriveState::Fault, 0x7500)
        );
        assert!(axis.drive.speed_turns_s().abs() < STANDING);
    }
}
