//! A board: its memory spaces, modules, pins, and the handling of packets.

mod registers;

use crate::beam::{Beam, BeamMotor};
use crate::encoder::Encoder;
use crate::fault::{Fault, FaultKind};
use crate::field_pins::{FieldOutputs, InputFilter};
use crate::layout::{BoardModel, PORT_WIDTH, tag};
use crate::lbp16::carry_out;
use crate::smart_serial::SmartSerial;
use crate::spindle::{Spindle, SpindleCommand};
use crate::step_generator::StepGenerator;
use crate::switch::Switch;

/// Clock of the modules, and of the fast ones (PWM), Hz.
const CLOCK_LOW: u32 = 100_000_000;
const CLOCK_HIGH: u32 = 200_000_000;
/// Period of the low clock, ns.
const CLOCK_NS: u64 = 10;
/// Flag of a timer value with which the watchdog does not count.
const WATCHDOG_OFF: u32 = 1 << 31;
/// Delay of replies with [`FaultKind::Delay`], ns.
const DELAY_NS: u64 = 5_000_000;
/// Time that a board needs to restart, ns.
const START_NS: u64 = 100_000_000;
const COOKIE: u32 = 0x55AA_CAFE;

/// One I/O port.
#[derive(Clone, Copy, Debug, Default)]
struct Port {
    output: u32,
    direction: u32,
    alternate: u32,
    open_drain: u32,
    invert: u32,
}

#[derive(Clone, Copy, Debug, Default)]
struct Pwm {
    value: u32,
    mode: u32,
}

impl Pwm {
    /// -1 to 1.
    fn duty(self) -> f64 {
        let bits = 9 + (self.mode & 3);
        let magnitude = f64::from(self.value >> 16 & 0xFFF) / f64::from((1_u32 << bits) - 1);
        let magnitude = magnitude.min(1.0);
        if self.value >> 31 == 1 {
            -magnitude
        } else {
            magnitude
        }
    }
}

/// Counts of packets and registers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    /// Packets received.
    pub packets: u64,
    /// Their bytes.
    pub bytes_in: u64,
    /// Replies sent.
    pub replies: u64,
    /// Their bytes.
    pub bytes_out: u64,
    /// HostMot2 registers read.
    pub reads: u64,
    /// HostMot2 registers written.
    pub writes: u64,
    /// Number of times that the watchdog was fed.
    pub feeds: u64,
    /// Invalid commands.
    pub refused: u64,
}

/// A simulated board. Time is an argument, in ns of any monotonic clock.
#[derive(Clone, Debug)]
pub struct Board {
    model: BoardModel,
    now_ns: u64,
    ports: Vec<Port>,
    /// External levels at the pins.
    levels: Vec<bool>,
    /// Pins that are wired to others: from, to.
    wires: Vec<(usize, usize)>,
    switches: Vec<Switch>,
    functions: Vec<(u8, u8, u8)>,
    step_generators: Vec<StepGenerator>,
    dds: u32,
    encoders: Vec<Encoder>,
    encoder_divider: u32,
    encoder_filter: u32,
    pwms: Vec<Pwm>,
    pwm_rate: u32,
    pdm_rate: u32,
    pwm_enable: u32,
    beam: Option<Beam>,
    spindle: Option<Spindle>,
    filter: Option<InputFilter>,
    field: FieldOutputs,
    serial: Option<SmartSerial>,
    leds: u32,
    watchdog_timer: u32,
    watchdog_left: u64,
    watchdog_bitten: bool,
    scratch: [u16; 8],
    pointers: [u16; 8],
    counters: [u16; 16],
    traffic: Traffic,
    faults: Vec<Fault>,
    /// First time that the watchdog was fed: time zero of the faults.
    armed_ns: Option<u64>,
    bite_is_over: bool,
    reset_is_over: bool,
    starts_ns: u64,
    half: bool,
    held: Option<Vec<u8>>,
    late: Vec<(u64, Vec<u8>)>,
    log: Option<Vec<(u16, bool)>>,
}

impl Board {
    /// Creates a board that has just been supplied.
    #[must_use]
    pub fn new(model: BoardModel, now_ns: u64) -> Self {
        Self {
            model,
            now_ns,
            ports: vec![Port::default(); model.ports()],
            levels: vec![true; model.pins()],
            wires: Vec::new(),
            switches: Vec::new(),
            functions: model.pin_functions(),
            step_generators: vec![StepGenerator::default(); model.step_generators()],
            dds: u32::MAX,
            encoders: vec![Encoder::default(); model.encoders()],
            encoder_divider: 0,
            encoder_filter: 0xFFF,
            pwms: vec![Pwm::default(); model.pwms()],
            pwm_rate: 0,
            pdm_rate: 0,
            pwm_enable: 0,
            beam: None,
            spindle: None,
            filter: (model.filtered_inputs() > 0).then(|| InputFilter::new(model.filtered_inputs())),
            field: FieldOutputs::default(),
            serial: model.has_smart_serial().then(SmartSerial::new),
            leds: 0,
            watchdog_timer: u32::MAX,
            watchdog_left: 0,
            watchdog_bitten: false,
            scratch: [0; 8],
            pointers: [0; 8],
            counters: [0; 16],
            traffic: Traffic::default(),
            faults: Vec::new(),
            armed_ns: None,
            bite_is_over: false,
            reset_is_over: false,
            starts_ns: now_ns,
            half: false,
            held: None,
            late: Vec::new(),
            log: None,
        }
    }

    /// Adds a fault to the schedule.
    pub fn add_fault(&mut self, fault: Fault) {
        self.faults.push(fault);
    }

    /// Removes all faults, and permits single faults to occur again.
    pub fn clear_faults(&mut self) {
        self.faults.clear();
        (self.bite_is_over, self.reset_is_over) = (false, false);
    }

    /// Starts a fault now, for this duration.
    pub fn fault_now(&mut self, kind: FaultKind, duration_ns: Option<u64>) {
        (self.bite_is_over, self.reset_is_over) = (false, false);
        let armed_ns = *self.armed_ns.get_or_insert(self.now_ns);
        self.faults.push(Fault {
            kind,
            at_ns: self.now_ns - armed_ns,
            duration_ns,
        });
    }

    /// Steps that the motor of a step generator has turned; 0 if there is none.
    #[must_use]
    pub fn motor_steps(&self, unit: usize) -> f64 {
        self.step_generators
            .get(unit)
            .map_or(0.0, StepGenerator::motor_position)
    }

    /// Number of times that this motor has lost steps.
    #[must_use]
    pub fn motor_stalls(&self, unit: usize) -> u32 {
        self.step_generators
            .get(unit)
            .map_or(0, StepGenerator::motor_stalls)
    }

    /// Commanded rate of a step generator, steps/s.
    #[must_use]
    pub fn step_rate(&self, unit: usize) -> f64 {
        self.step_generators.get(unit).map_or(0.0, |generator| {
            f64::from(generator.rate as i32) * f64::from(CLOCK_LOW) / 4_294_967_296.0
        })
    }

    /// Returns the highest rate commanded since the last call, steps/s.
    pub fn take_fastest_rate(&mut self, unit: usize) -> f64 {
        self.step_generators.get_mut(unit).map_or(0.0, |generator| {
            f64::from(generator.take_fastest()) * f64::from(CLOCK_LOW) / 4_294_967_296.0
        })
    }

    /// Sets the limits of a step generator's motor: maximum rate, and maximum step change of the rate,
    /// steps/s.
    pub fn set_motor(&mut self, unit: usize, max_rate: f64, max_jump: f64) {
        if let Some(generator) = self.step_generators.get_mut(unit) {
            generator.set_motor(max_rate, max_jump);
        }
    }

    /// Step length, step space, direction setup and hold of a step generator, in ns.
    #[must_use]
    pub fn step_times_ns(&self, unit: usize) -> [u64; 4] {
        self.step_generators.get(unit).map_or([0; 4], |generator| {
            [
                (u64::from(generator.step_length) + 1) * CLOCK_NS,
                (u64::from(generator.step_space) + 1) * CLOCK_NS,
                u64::from(generator.dir_setup) * CLOCK_NS,
                u64::from(generator.dir_hold) * CLOCK_NS,
            ]
        })
    }

    /// Counts of a shaft since the start.
    #[must_use]
    pub fn shaft(&self, unit: usize) -> f64 {
        self.encoders.get(unit).map_or(0.0, Encoder::shaft)
    }

    /// Sets the position of a shaft.
    pub fn set_shaft(&mut self, unit: usize, counts: f64) {
        if let Some(encoder) = self.encoders.get_mut(unit) {
            encoder.set_shaft(counts);
        }
    }

    /// Turns the shaft of an encoder by a number of counts, as by hand.
    pub fn turn_shaft(&mut self, unit: usize, counts: f64) {
        if let Some(encoder) = self.encoders.get_mut(unit) {
            encoder.turn(counts);
        }
    }

    /// Adds a beam between two motors.
    pub fn set_beam(&mut self, beam: Beam) {
        self.beam = Some(beam);
        self.move_beam();
    }

    /// The beam, if there is one.
    pub const fn beam(&mut self) -> Option<&mut Beam> {
        self.beam.as_mut()
    }

    /// Moves the beam with its motors, and updates its switches.
    fn move_beam(&mut self) {
        let Some(mut beam) = self.beam else { return };
        let motors = beam.sides().map(|side| match side.motor {
            BeamMotor::Steps(unit) => self.motor_steps(unit),
            BeamMotor::Shaft(unit) => self.shaft(unit),
        });
        for (pin, level) in beam.follow(motors) {
            self.set_level(pin, level);
        }
        for (side, of_beam) in beam.sides().iter().enumerate() {
            // The shaft of a stepper continues to turn: it has no encoder.
            if let BeamMotor::Shaft(unit) = of_beam.motor
                && let Some(encoder) = self.encoders.get_mut(unit)
            {
                encoder.hold(beam.is_held(side));
            }
        }
        self.beam = Some(beam);
    }

    /// Adds a spindle at one of the encoders.
    pub fn set_spindle(&mut self, spindle: Spindle) {
        let per_rpm = spindle.counts_per_turn as f64 / 60.0;
        if let Some(encoder) = self.encoders.get_mut(spindle.encoder) {
            encoder.set_drive(spindle.counts_per_turn, spindle.full_rpm * per_rpm);
            encoder.set_inertia(spindle.acceleration_rpm_s * per_rpm, spindle.ripple);
        }
        self.spindle = Some(spindle);
    }

    /// Command of the spindle's drive, -1 to 1.
    fn spindle_duty(&self, spindle: &Spindle) -> f64 {
        match spindle.command {
            SpindleCommand::SignedPwm { unit } => self.duty(unit),
            SpindleCommand::Contacts {
                unit,
                forward,
                reverse,
            } => match (self.level(forward), self.level(reverse)) {
                (true, false) => self.duty(unit).abs(),
                (false, true) => -self.duty(unit).abs(),
                _ => 0.0,
            },
            SpindleCommand::Field => match self.field_spindle() {
                (duty, false, true) => duty,
                (duty, true, true) => -duty,
                _ => 0.0,
            },
        }
    }

    /// Sets the counts per turn of a shaft, and counts/s at full duty of the PWM generator with the same
    /// number.
    pub fn set_drive(&mut self, unit: usize, counts_per_turn: i64, full_speed: f64) {
        if let Some(encoder) = self.encoders.get_mut(unit) {
            encoder.set_drive(counts_per_turn, full_speed);
        }
    }

    /// Sets the count within a turn at which the index input of an encoder is on.
    pub fn set_index(&mut self, unit: usize, count: i64) {
        if let Some(encoder) = self.encoders.get_mut(unit) {
            encoder.set_index(count);
        }
    }

    /// Whether an encoder is armed to latch the next index.
    #[must_use]
    pub fn index_is_armed(&self, unit: usize) -> bool {
        self.encoders.get(unit).is_some_and(Encoder::index_is_armed)
    }

    /// Duty at the pin of a PWM generator, -1 to 1.
    #[must_use]
    pub fn duty(&self, unit: usize) -> f64 {
        let runs = self.pwm_enable >> unit & 1 == 1 && self.is_connected(tag::PWM, unit, 0x81);
        if runs { self.pwms[unit].duty() } else { 0.0 }
    }

    /// Adds a switch in the travel of a step generator's motor.
    pub fn add_switch(&mut self, switch: Switch) {
        self.switches.push(switch);
    }

    /// Sets the external level at a pin.
    pub fn set_level(&mut self, pin: usize, on: bool) {
        if let Some(level) = self.levels.get_mut(pin) {
            *level = on;
        }
    }

    /// Sets an input of the 7I76 at the first smart-serial channel.
    pub fn set_field_input(&mut self, bit: u32, on: bool) {
        if let Some(serial) = &mut self.serial {
            serial.set_input(bit, on);
        }
    }

    /// Wires a field output of that 7I76 to a field input.
    pub fn wire_field(&mut self, from: u32, to: u32) {
        if let Some(serial) = &mut self.serial {
            serial.wire(from, to);
        }
    }

    /// Whether an output of that 7I76 is on.
    #[must_use]
    pub fn field_output_is_on(&self, bit: u32) -> bool {
        self.serial.as_ref().is_some_and(|serial| serial.output(bit))
    }

    /// The spindle of that 7I76: fraction of its analog output, reverse, enabled.
    #[must_use]
    pub fn field_spindle(&self) -> (f64, bool, bool) {
        self.serial
            .as_ref()
            .map_or((0.0, false, false), SmartSerial::spindle)
    }

    /// Number of process data exchanges of that 7I76.
    #[must_use]
    pub fn field_exchanges(&self) -> u64 {
        self.serial.as_ref().map_or(0, SmartSerial::exchanges)
    }

    /// Wires an output to an input.
    pub fn wire(&mut self, from: usize, to: usize) {
        self.wires.push((from, to));
    }

    /// The level at a pin; pins without a driver are high. For an isolated output: whether it is closed.
    #[must_use]
    pub fn level(&self, pin: usize) -> bool {
        if let Some(is_closed) = self.field_output(pin) {
            return is_closed;
        }
        let port = self.ports[pin / PORT_WIDTH];
        let bit = |register: u32| register >> (pin % PORT_WIDTH) & 1 == 1;
        if bit(port.open_drain) {
            return bit(port.output) ^ bit(port.invert);
        }
        if bit(port.direction) && !bit(port.alternate) {
            return bit(port.output) ^ bit(port.invert);
        }
        let wired = self.wires.iter().find(|(from, to)| *to == pin && *from != pin);
        wired.map_or(self.levels[pin], |(from, _)| {
            // A closed output lets current flow through the input, whose optocoupler then pulls the pin low.
            self.field_output(*from)
                .map_or_else(|| self.level(*from), |is_closed| !is_closed)
        })
    }

    /// The output of a module at a pin, if a module is connected to the pin.
    fn field_output(&self, pin: usize) -> Option<bool> {
        let (tag, unit, number) = self.functions[pin];
        if !matches!(tag, tag::RELAY | tag::SIMPLE_OUTPUT)
            || !self.is_connected(tag, usize::from(unit), number)
        {
            return None;
        }
        let bit = (number & 0x7F).wrapping_sub(1) & 31;
        Some(match tag {
            tag::RELAY => {
                let runs = self.field.relays_run() && self.is_connected(tag, usize::from(unit), 0xA0);
                runs && self.field.relays >> bit & 1 == 1
            }
            _ => self.field.simple >> bit & 1 == 1,
        })
    }

    /// Whether the board drives a pin.
    #[must_use]
    pub fn is_driven(&self, pin: usize) -> bool {
        self.ports[pin / PORT_WIDTH].direction >> (pin % PORT_WIDTH) & 1 == 1
    }

    /// Whether the watchdog has expired.
    #[must_use]
    pub const fn has_bitten(&self) -> bool {
        self.watchdog_bitten
    }

    /// The counts so far.
    #[must_use]
    pub const fn traffic(&self) -> Traffic {
        self.traffic
    }

    /// Starts a log of every access to a HostMot2 register: its address, and whether it was written.
    pub fn keep_log(&mut self) {
        self.log = Some(Vec::new());
    }

    /// Returns the accesses since the start of the log or the last call.
    pub fn take_log(&mut self) -> Vec<(u16, bool)> {
        self.log.as_mut().map(std::mem::take).unwrap_or_default()
    }

    fn is_active(&self, kind: FaultKind) -> bool {
        let Some(armed_ns) = self.armed_ns else {
            return self
                .faults
                .iter()
                .any(|fault| fault.kind == kind && fault.at_ns == 0);
        };
        let since_ns = self.now_ns.saturating_sub(armed_ns);
        self.faults
            .iter()
            .any(|fault| fault.kind == kind && fault.is_active(since_ns))
    }

    /// Whether a pin of a module is an output of that module.
    fn is_connected(&self, tag: u8, unit: usize, pin: u8) -> bool {
        let found = self
            .functions
            .iter()
            .position(|function| *function == (tag, unit as u8, pin));
        found.is_some_and(|pin| {
            let port = self.ports[pin / PORT_WIDTH];
            (port.direction & port.alternate) >> (pin % PORT_WIDTH) & 1 == 1
        })
    }

    /// Advances to `now_ns`.
    pub fn advance(&mut self, now_ns: u64) {
        let clocks = now_ns.saturating_sub(self.now_ns) / CLOCK_NS;
        if clocks == 0 {
            return;
        }
        self.now_ns += clocks * CLOCK_NS;
        // In two parts: before and after the watchdog expires.
        let is_awake = self.watchdog_timer & WATCHDOG_OFF == 0 && !self.watchdog_bitten;
        if is_awake && clocks > self.watchdog_left {
            let left = self.watchdog_left;
            self.turn(left);
            self.bite();
            self.turn(clocks - left);
        } else {
            if is_awake {
                self.watchdog_left -= clocks;
            }
            self.turn(clocks);
        }
        if self.is_active(FaultKind::Bite) && !self.bite_is_over {
            self.bite_is_over = true;
            self.bite();
        }
        if self.is_active(FaultKind::Reset) && !self.reset_is_over {
            self.reset_is_over = true;
            self.reset();
        }
    }

    fn actuate_switches(&mut self) {
        for i in 0..self.switches.len() {
            let switch = self.switches[i];
            let is_free = !switch.is_actuated(self.motor_steps(switch.unit));
            if self.model.has_smart_serial() {
                self.set_field_input(switch.input as u32, is_free);
            } else {
                self.set_level(switch.input, is_free);
            }
        }
    }

    fn turn(&mut self, clocks: u64) {
        let time_s = clocks as f64 / f64::from(CLOCK_LOW);
        self.actuate_switches();
        for unit in 0..self.step_generators.len() {
            let step = self.is_connected(tag::STEP_GENERATOR, unit, 0x81);
            let reaches = step && self.is_connected(tag::STEP_GENERATOR, unit, 0x82);
            self.step_generators[unit].advance(clocks, f64::from(CLOCK_LOW), reaches);
        }
        let is_off = self.is_active(FaultKind::FieldOff);
        if let Some(serial) = &mut self.serial {
            serial.set_off(is_off);
            serial.advance(self.now_ns);
        }
        let timestamp = (self.now_ns / 1000) as u16;
        let has_index = !self.is_active(FaultKind::IndexMissing);
        for unit in 0..self.encoders.len() {
            let spindle = self.spindle.filter(|spindle| spindle.encoder == unit);
            let duty = match &spindle {
                Some(spindle) => self.spindle_duty(spindle),
                None if unit < self.pwms.len() => self.duty(unit),
                None => 0.0,
            };
            if spindle.is_some() {
                let is_stalled = self.is_active(FaultKind::SpindleStall);
                let loss = match (
                    self.is_active(FaultKind::EncoderOff),
                    self.is_active(FaultKind::LostCounts),
                ) {
                    (true, _) => 1.0,
                    (false, true) => 0.02,
                    (false, false) => 0.0,
                };
                self.encoders[unit].hold(is_stalled);
                self.encoders[unit].set_loss(loss);
            }
            self.encoders[unit].set_has_index(has_index);
            self.encoders[unit].advance(time_s, duty, timestamp);
        }
        self.move_beam();
        if let Some(mut filter) = self.filter.take() {
            let inputs = 0..filter.width();
            let levels = inputs.fold(0, |levels, pin| {
                levels | u32::from(self.level(pin as usize)) << pin
            });
            filter.advance(clocks, levels);
            self.filter = Some(filter);
        }
    }

    /// Makes all pins inputs, as the expired watchdog does; the modules keep running.
    fn bite(&mut self) {
        self.watchdog_bitten = true;
        for port in &mut self.ports {
            (port.direction, port.open_drain) = (0, 0);
        }
    }

    fn reset(&mut self) {
        self.starts_ns = self.now_ns + START_NS;
        self.ports.fill(Port::default());
        self.step_generators.iter_mut().for_each(StepGenerator::reset);
        self.encoders.iter_mut().for_each(Encoder::reset);
        self.pwms.fill(Pwm::default());
        self.field = FieldOutputs::default();
        if let Some(filter) = &mut self.filter {
            filter.reset();
        }
        if let Some(serial) = &mut self.serial {
            serial.reset();
        }
        (self.pwm_enable, self.leds) = (0, 0);
        (self.watchdog_timer, self.watchdog_bitten) = (u32::MAX, false);
        (self.scratch, self.counters, self.pointers) = ([0; 8], [0; 16], [0; 8]);
    }

    /// Handles a received packet. Passes immediate replies to `send`; see [`Board::due`] for delayed ones.
    pub fn receive(&mut self, now_ns: u64, packet: &[u8], mut send: impl FnMut(&[u8])) {
        self.advance(now_ns);
        self.half = !self.half;
        let is_lost = self.is_active(FaultKind::LossIn)
            || self.now_ns < self.starts_ns
            || self.is_active(FaultKind::Half) && self.half;
        if is_lost {
            return;
        }
        self.traffic.packets += 1;
        self.traffic.bytes_in += packet.len() as u64;
        self.counters[4] = self.counters[4].wrapping_add(1);
        self.counters[5] = self.counters[5].wrapping_add(1);
        let (mut reply, mut pointers) = (Vec::new(), self.pointers);
        carry_out(packet, &mut pointers, self, &mut reply);
        self.pointers = pointers;
        if reply.is_empty() {
            return;
        }
        self.counters[7] = self.counters[7].wrapping_add(1);
        self.counters[8] = self.counters[8].wrapping_add(1);
        if self.is_active(FaultKind::LossOut) {
            return;
        }
        if self.is_active(FaultKind::Short) {
            reply.truncate(reply.len() / 2);
        }
        self.traffic.replies += 1;
        self.traffic.bytes_out += reply.len() as u64;
        if self.is_active(FaultKind::Delay) {
            self.late.push((self.now_ns + DELAY_NS, reply));
        } else if self.is_active(FaultKind::Reorder) && self.held.is_none() {
            self.held = Some(reply);
        } else {
            send(&reply);
            if let Some(held) = self.held.take() {
                send(&held);
            }
        }
    }

    /// Passes delayed replies that are due to `send`.
    pub fn due(&mut self, now_ns: u64, mut send: impl FnMut(&[u8])) {
        self.advance(now_ns);
        self.late.retain(|(due_ns, reply)| {
            if *due_ns <= now_ns {
                send(reply);
            }
            *due_ns > now_ns
        });
    }
}
