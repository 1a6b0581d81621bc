//! A spindle drive: CiA 402 in cyclic synchronous velocity, its position as the angle of the spindle.
//!
//! M19 is a position loop of the bridge that commands the velocity in the same mode. It works with every
//! drive that has mode 9, and avoids a change of mode under power, in which drives differ most.

use evolvent_bus::{MachineOutputs, SpindleFeedback};
use evolvent_drive::{
    Braking, Cia402, DriveState, PowerRequest, SpindleConditions, SpindleEncoder, SpindleEncoderFault,
    SpindleOrientation, SpindlePower, bits, control,
};
use evolvent_machine::Machine;

use crate::network::{Network, NetworkSpindle};
use crate::pdo::{DriveInputs, DriveOutputs};
use crate::zero_impulse::{Latched, ZeroImpulse};

/// Directions of a spindle on the bus.
const STOPPED: u32 = 0;
const CLOCKWISE: u32 = 1;
const COUNTER_CLOCKWISE: u32 = 2;
const ORIENT: u32 = 3;
/// Cyclic synchronous velocity.
const CSV: i8 = 9;
/// Object 603Fh: communication.
const COMMUNICATION: u16 = 0x7500;
/// Number of periods for which the fault reset bit is held.
const RESET_PERIODS: u32 = 5;

/// Maximum period that counts, s: the first one has no start time.
const MAX_PERIOD_S: f64 = 0.01;

/// Events of a spindle, for the user.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SpindleNotice {
    /// Its encoder has a fault.
    Encoder(SpindleEncoderFault),
    /// Its drive is in fault, with this code.
    DriveFault(u16),
    /// M19 was commanded, and nothing can turn the spindle to an angle.
    NotOriented,
}

/// One spindle drive. Nothing but the constructor allocates.
#[derive(Debug)]
pub(crate) struct SpindleDrive {
    settings: NetworkSpindle,
    controller: Cia402,
    /// Time of the last step, ns.
    stepped_ns: u64,
    inputs: DriveInputs,
    has_inputs: bool,
    encoder: SpindleEncoder,
    zero_impulse: ZeroImpulse,
    /// The latch of the zero impulse is armed.
    is_armed: bool,
    orientation: Option<SpindleOrientation>,
    power: SpindlePower,
    is_heard: bool,
    is_lost: bool,
    sent: SpindleFeedback,
    direction: u32,
    rpm: f64,
    outputs_sequence: u64,
    reset_periods: u32,
    reported: Option<SpindleNotice>,
    news: Option<SpindleNotice>,
}

impl SpindleDrive {
    /// The spindle drives of a network, in order.
    pub(crate) fn all(machine: &Machine, network: &Network, instance: u64) -> Vec<Self> {
        let settings = network.devices.iter().filter_map(|device| device.spindle);
        settings
            .map(|settings| {
                let known = machine.signals.spindle(settings.number as u32);
                Self {
                    settings,
                    controller: Cia402::new(),
                    stepped_ns: 0,
                    inputs: DriveInputs::default(),
                    has_inputs: false,
                    encoder: SpindleEncoder::new(settings.encoder),
                    zero_impulse: ZeroImpulse::new(),
                    is_armed: false,
                    orientation: settings.orientation.map(SpindleOrientation::new),
                    power: SpindlePower::default(),
                    is_heard: known.is_some_and(|known| known.has_feedback()),
                    is_lost: false,
                    sent: SpindleFeedback {
                        instance,
                        ..SpindleFeedback::default()
                    },
                    direction: STOPPED,
                    rpm: 0.0,
                    outputs_sequence: 0,
                    reset_periods: 0,
                    reported: None,
                    news: None,
                }
            })
            .collect()
    }

    /// Marks its device as lost: it does not reply, or is not in OP.
    pub(crate) const fn set_lost(&mut self) {
        self.is_lost = true;
    }

    pub(crate) fn has_torque(&self) -> bool {
        let state = DriveState::decode(self.inputs.status_word).filter(|_| !self.is_lost);
        state.is_some_and(DriveState::has_torque)
    }

    /// Takes the inputs of a period, and the time at which the drive sampled them.
    pub(crate) fn take(&mut self, inputs: DriveInputs, sampled_ns: u64) {
        self.inputs = inputs;
        self.has_inputs = true;
        self.encoder.read(inputs.position as u32, sampled_ns);
        if let Some(probe) = self.settings.index_probe {
            match self
                .zero_impulse
                .step(probe, inputs.probe_status, inputs.index_position)
            {
                Latched::Nothing => {}
                Latched::Armed => self.encoder.set_armed(),
                Latched::At(increments) => {
                    self.encoder.latch(increments as u32);
                    self.is_armed = false;
                }
            }
            // Every impulse is compared with the first.
            if !self.is_armed {
                self.zero_impulse.arm();
                self.is_armed = true;
            }
        }
        let news = match (self.encoder.fault(), self.is_in_fault()) {
            (Some(fault), _) => Some(SpindleNotice::Encoder(fault)),
            (None, true) => Some(SpindleNotice::DriveFault(self.error_code())),
            (None, false) => None,
        };
        self.tell(news);
    }

    fn is_in_fault(&self) -> bool {
        self.is_lost || self.inputs.status_word & bits::FAULT != 0
    }

    fn error_code(&self) -> u16 {
        if self.is_lost {
            COMMUNICATION
        } else {
            self.inputs.error_code
        }
    }

    fn tell(&mut self, news: Option<SpindleNotice>) {
        let is_same = match (&self.reported, &news) {
            (Some(SpindleNotice::Encoder(_)), Some(SpindleNotice::Encoder(_)))
            | (Some(SpindleNotice::NotOriented), None) => true,
            (reported, news) => reported == news,
        };
        if !is_same {
            (self.reported, self.news) = (news, news.or(self.news));
        }
    }

    /// Returns the number of the spindle and its next event, once each.
    pub(crate) fn take_news(&mut self) -> Option<(usize, SpindleNotice)> {
        Some((self.settings.number, self.news.take()?))
    }

    /// Computes the outputs of a period. `is_silent`: the core is silent, or the session ends.
    pub(crate) fn outputs(
        &mut self,
        wanted: &MachineOutputs,
        is_silent: bool,
        fault_reset: Option<u32>,
        now_ns: u64,
    ) -> DriveOutputs {
        let number = self.settings.number;
        let direction = if is_silent {
            STOPPED
        } else {
            wanted.spindle_direction[number]
        };
        (self.direction, self.rpm) = (direction, wanted.spindle_rpm[number]);
        self.outputs_sequence = if is_silent { 0 } else { wanted.sequence };
        if direction != ORIENT {
            if let Some(orientation) = &mut self.orientation {
                orientation.end();
            }
            if self.reported == Some(SpindleNotice::NotOriented) {
                self.reported = None;
            }
        }
        let stands = self.encoder.is_standing();
        if direction == STOPPED && stands && self.encoder.fault().is_some() {
            // The alarm has stopped it: the next motion begins with a new zero.
            self.encoder.reset();
            (self.is_armed, _) = (false, self.zero_impulse.disarm());
        }
        let rpm = match direction {
            CLOCKWISE => self.rpm,
            COUNTER_CLOCKWISE => -self.rpm,
            ORIENT => match &mut self.orientation {
                Some(orientation) => orientation.step(
                    wanted.spindle_angle[number],
                    wanted.spindle_way[number],
                    &self.encoder,
                    now_ns,
                ),
                None => {
                    self.tell(Some(SpindleNotice::NotOriented));
                    0.0
                }
            },
            _ => 0.0,
        };
        let turns = matches!(direction, CLOCKWISE | COUNTER_CLOCKWISE)
            || direction == ORIENT && self.orientation.is_some();
        // Uses the last inputs even if the drive is lost, because it may still receive.
        let had_torque = DriveState::decode(self.inputs.status_word).is_some_and(DriveState::has_torque);
        let is_on = self.power.step(turns, stands, had_torque);
        let power = match (is_on, is_silent) {
            // It brakes in operation, with speed zero; without a core it brakes by its quick stop.
            (true, false) => PowerRequest::On,
            (true, true) => PowerRequest::QuickStop,
            (false, _) => PowerRequest::Off,
        };
        let since_ns = now_ns.saturating_sub(std::mem::replace(&mut self.stepped_ns, now_ns));
        let braking = Braking {
            period_s: (since_ns as f64 * 1e-9).min(MAX_PERIOD_S),
            is_standing: Some(stands),
        };
        let order = (self.controller).step(self.inputs.status_word, power, fault_reset, 0.0, 0.0, braking);
        if order.control_word == control::FAULT_RESET {
            self.reset_periods = RESET_PERIODS;
        }
        let state = DriveState::decode(self.inputs.status_word);
        let holds_reset = self.reset_periods > 0 && state == Some(DriveState::Fault);
        self.reset_periods = self.reset_periods.saturating_sub(1);
        let sign = if self.settings.inverted { -1.0 } else { 1.0 };
        let velocity = sign * rpm * self.settings.velocity_per_rpm;
        DriveOutputs {
            control_word: if holds_reset {
                control::FAULT_RESET
            } else {
                order.control_word
            },
            mode: CSV,
            target: if state == Some(DriveState::OperationEnabled) {
                velocity.round().clamp(f64::from(i32::MIN), f64::from(i32::MAX)) as i32
            } else {
                0
            },
            probe_function: (self.settings.index_probe).map_or(0, |probe| self.zero_impulse.function(probe)),
            ..DriveOutputs::default()
        }
    }

    /// The message of the newest inputs, if the machine file has the spindle with feedback.
    pub(crate) fn feedback(&mut self) -> Option<SpindleFeedback> {
        if !self.is_heard || !self.has_inputs {
            return None;
        }
        let time_ns = self.encoder.read_at_ns()?;
        if self.sent.sequence > 0 && time_ns <= self.sent.time_ns {
            return None;
        }
        let is_oriented = self.direction == ORIENT
            && self
                .orientation
                .is_some_and(|orientation| orientation.is_oriented());
        let message = self.encoder.feedback(&SpindleConditions {
            spindle: self.settings.number as u32,
            direction: self.direction,
            rpm: self.rpm,
            outputs_sequence: self.outputs_sequence,
            at_speed_input: None,
            has_drive_fault: self.is_in_fault(),
            is_oriented,
        });
        self.sent = SpindleFeedback {
            sequence: self.sent.sequence + 1,
            instance: self.sent.instance,
            ..message
        };
        Some(self.sent)
    }
}

#[cfg(test)]
mod tests {
    use evolvent_drive::{DriveEvents, DriveMachine, QuickStopOption};
    use evolvent_random::Random;

    use super::*;

    const MS: u64 = 1_000_000;

    /// The spindle of the shipped lathe, its drive's state machine, and a shaft.
    struct Bench {
        spindle: SpindleDrive,
        machine: DriveMachine,
        wanted: MachineOutputs,
        /// Increments.
        shaft: f64,
        now_ns: u64,
        fault_reset: Option<u32>,
        /// Number of times that the drive has come into operation.
        switch_ons: u32,
        word: u16,
    }

    impl Bench {
        fn new() -> Self {
            let shipped = evolvent_file_tests::shipped;
            let machine = Machine::parse(&shipped("machines/lathe-ethercat.toml"), "lathe.toml").unwrap();
            let network = Network::parse(&shipped("networks/sim-lathe.toml"), "lathe.toml").unwrap();
            Self {
                spindle: SpindleDrive::all(&machine, &network, 1).remove(0),
                machine: DriveMachine::new(QuickStopOption::ThenDisabled),
                wanted: MachineOutputs::default(),
                shaft: 0.0,
                now_ns: MS,
                fault_reset: None,
                switch_ons: 0,
                word: 0,
            }
        }

        /// Runs periods of 1 ms at a speed of the shaft.
        fn turn(&mut self, periods: u32, mut rpm: impl FnMut() -> f64, events: DriveEvents) {
            for _ in 0..periods {
                self.now_ns += MS;
                self.shaft += rpm() * 1_048_576.0 / 60e3;
                let inputs = DriveInputs {
                    status_word: self.machine.status_word(),
                    position: self.shaft as i32,
                    ..DriveInputs::default()
                };
                self.spindle.take(inputs, self.now_ns);
                let outputs = self
                    .spindle
                    .outputs(&self.wanted, false, self.fault_reset, self.now_ns);
                let before = self.machine.state();
                let state = self.machine.step(outputs.control_word, events);
                let is_new = state != before && state == DriveState::OperationEnabled;
                self.switch_ons += u32::from(is_new);
                self.word = outputs.control_word;
            }
        }
    }

    const READY: DriveEvents = DriveEvents {
        ready: true,
        fault: None,
        at_rest: true,
    };

    #[test]
    fn only_a_command_switches_the_drive_on() {
        let mut bench = Bench::new();
        // Turned by hand, then an encoder at rest with noise of two increments.
        bench.turn(2000, || 5.0, READY);
        let mut random = Random::new();
        bench.turn(2000, || random.between(-2.0, 2.0) * 60e3 / 1_048_576.0, READY);
        assert_eq!(bench.switch_ons, 0);
        // M3, then M5: it brakes in operation until standstill, and is off then.
        (bench.wanted.spindle_direction[0], bench.wanted.spindle_rpm[0]) = (CLOCKWISE, 300.0);
        bench.turn(500, || 300.0, READY);
        bench.wanted.spindle_direction[0] = STOPPED;
        bench.turn(500, || 100.0, READY);
        assert_eq!((bench.switch_ons, bench.word), (1, control::ENABLE_OPERATION));
        bench.turn(500, || 0.0, READY);
        assert_eq!(bench.machine.state(), DriveState::SwitchOnDisabled);
        bench.turn(2000, || 5.0, READY);
        assert_eq!(bench.switch_ons, 1);
    }

    #[test]
    fn coasting_spindle_after_sto_stays_without_torque() {
        let mut bench = Bench::new();
        (bench.wanted.spindle_direction[0], bench.wanted.spindle_rpm[0]) = (CLOCKWISE, 300.0);
        bench.turn(500, || 300.0, READY);
        assert_eq!(bench.switch_ons, 1);
        // The chain opens, and the core stops the spindle.
        bench.machine = DriveMachine::new(QuickStopOption::ThenDisabled);
        bench.wanted.spindle_direction[0] = STOPPED;
        bench.turn(
            500,
            || 200.0,
            DriveEvents {
                ready: false,
                ..READY
            },
        );
        bench.turn(2000, || 100.0, READY);
        assert_eq!(bench.switch_ons, 1);
    }
    #[test]
    fn a_fault_is_reset_by_growth_of_the_counter_only() {
        let mut bench = Bench::new();
        let fault = DriveEvents {
            fault: Some(0x2310),
            ..READY
        };
        bench.turn(5, || 0.0, READY);
        bench.turn(5, || 0.0, fault);
        // A core that has reset three faults before this session, and one that has restarted.
        for count in [None, Some(3), None, Some(0)] {
            bench.fault_reset = count;
            bench.turn(20, || 0.0, READY);
            assert_eq!(bench.machine.state(), DriveState::Fault, "{count:?}");
        }
        bench.fault_reset = Some(1);
        bench.turn(20, || 0.0, READY);
        assert_eq!(bench.machine.state(), DriveState::SwitchOnDisabled);
    }
}
