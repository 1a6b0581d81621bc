//! The registers of a board that are written once, read every cycle, and written every cycle.

mod error;
mod pins;

pub use self::error::PlanError;
use crate::axis::{MAX_COUNTS, longest_gap_s};
use crate::board_settings::{
    Actuator, BoardAxis, BoardSettings, BoardSpindle, InputSource, OutputTarget, Pin, SpindleSpeed,
};
use crate::description::{Description, Module, tag};
use crate::encoder_index::{INDEX_RISING, IndexCommand, QUADRATURE};
use crate::field_pins::{FieldOutputs, FieldPins, InputLocation, MAX_FIELD_UNITS, OutputLocation};
use crate::packet::{Packet, PacketFull, Space};
use crate::smart_serial::{Element, MAX_REMOTES, SerialInputs, SerialOutputs, SmartSerial};
use evolvent_bus::SPINDLES;

/// Maximum number of ports.
pub(crate) const MAX_PORTS: usize = 8;
/// Maximum number of pins of HostMot2.
const MAX_PINS: usize = 144;
/// Maximum number of instances of one module.
pub(crate) const MAX_UNITS: usize = 16;
/// Scratch words of the timer space: number of the write packet, of the read packet, of the session, and of
/// the last arming of each index latch.
pub(crate) const SCRATCH: u16 = 0x10;
const INDEX_SCRATCH: u16 = SCRATCH + 6;
/// Number of index latches: one for the axes, then one for each spindle.
pub(crate) const INDEX_SLOTS: usize = 1 + SPINDLES;
pub(crate) const SPINDLE_SLOT: usize = 1;
/// Feeds the watchdog.
const FEED: u32 = 0x5A00_0000;
/// Pins of modules.
const STEP: u8 = 0x81;
const DIRECTION: u8 = 0x82;
const PWM_OUT: u8 = 0x81;
const PWM_DIRECTION: u8 = 0x82;
const PWM_ENABLE: u8 = 0x83;
/// Maximum time of a step generator, clocks.
const MAX_CLOCKS: f64 = 16_383.0;
/// 12 bits, sawtooth, sign and magnitude.
const PWM_MODE: u32 = 3;

/// Values written every cycle.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Outputs {
    /// Rate of each step generator, steps/s.
    pub(crate) rates: [f64; MAX_UNITS],
    /// Duty of each PWM generator, -1 to 1.
    pub(crate) duties: [f64; MAX_UNITS],
    /// Bit i: PWM generator i is enabled.
    pub(crate) pwm_enable: u32,
    /// Output registers of the ports.
    pub(crate) ports: [u32; MAX_PORTS],
    /// Data of SSR and OutM outputs.
    pub(crate) field: FieldOutputs,
    /// Process data of smart-serial devices.
    pub(crate) serial: SerialOutputs,
    /// Index latches that are to be armed.
    pub(crate) index: [Option<IndexCommand>; INDEX_SLOTS],
}

/// Values read every cycle.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Inputs {
    pub(crate) write_number: u16,
    pub(crate) read_number: u16,
    pub(crate) session: u16,
    /// Number of the last arming of each index latch.
    pub(crate) index_numbers: [u16; INDEX_SLOTS],
    /// Control registers of the encoders whose index pulses are awaited.
    pub(crate) index_controls: [u32; INDEX_SLOTS],
    pub(crate) has_bitten: bool,
    pub(crate) ports: [u32; MAX_PORTS],
    pub(crate) accumulators: [u32; MAX_UNITS],
    pub(crate) counts: [u32; MAX_UNITS],
    /// Filtered inputs.
    pub(crate) filtered: [u32; MAX_FIELD_UNITS],
    /// Process data of smart-serial devices.
    pub(crate) serial: SerialInputs,
}

/// The spindle outputs of a smart-serial device.
#[derive(Clone, Debug)]
pub(crate) struct RemoteSpindle {
    remote: usize,
    speed: Element,
    enable: Option<Element>,
    reverse: Option<Element>,
}

impl RemoteSpindle {
    /// Sets the fraction of the full speed, whether the spindle turns, and whether it turns
    /// counter-clockwise.
    pub(crate) fn put(&self, outputs: &mut Outputs, fraction: f64, turns: bool, backwards: bool) {
        let words = &mut outputs.serial.words[self.remote];
        self.speed
            .put_fraction(words, if turns { fraction.abs() } else { 0.0 });
        for (element, on) in [(&self.enable, turns), (&self.reverse, turns && backwards)] {
            if let Some(element) = element {
                element.put_fraction(words, f64::from(u8::from(on)));
            }
        }
    }
}

/// Register addresses and counts for one board and one board file.
#[derive(Clone, Debug)]
pub(crate) struct Plan {
    watchdog: Module,
    port: Module,
    ports: usize,
    port_width: usize,
    step: Option<(Module, usize)>,
    encoder: Option<(Module, usize)>,
    pwm: Option<(Module, usize)>,
    field: FieldPins,
    serial: Option<SmartSerial>,
    /// Those of the board file that are on smart serial.
    spindles: [Option<RemoteSpindle>; SPINDLES],
    /// Index latches in use.
    index_slots: usize,
    /// Elements of analog inputs: index in the board file's list, device, element.
    numbers: Vec<(usize, usize, Element)>,
    /// Bits of field inputs and field outputs, by device and number.
    remote_bits: [[[usize; MAX_PINS]; MAX_REMOTES]; 2],
    /// Register bits of the pins that a module reads or sets.
    reads: [Option<InputLocation>; MAX_PINS],
    sets: [Option<OutputLocation>; MAX_PINS],
    /// Bits of driven pins, and of those driven by modules.
    driven: [u32; MAX_PORTS],
    alternate: [u32; MAX_PORTS],
    /// Driven pins, and what drives each.
    drivers: Vec<(usize, String)>,
}

impl Plan {
    pub(crate) fn new(
        board: &Description,
        settings: &BoardSettings,
        serial: Option<SmartSerial>,
        max_velocity: &[f64],
        max_rpm: &[f64],
        period_s: f64,
    ) -> Result<Self, PlanError> {
        check_name(board, settings)?;
        // It is fed once per period, and sometimes slightly later.
        if settings.watchdog_s < 2.0 * period_s {
            return Err(PlanError::Watchdog {
                watchdog_ms: settings.watchdog_s * 1e3,
                period_ms: period_s * 1e3,
            });
        }
        let mut plan = Self {
            watchdog: module(board, tag::WATCHDOG, "watchdog", 0, 3)?,
            port: module(board, tag::IO_PORT, "I/O port", 0, 5)?,
            ports: board.ports.min(MAX_PORTS),
            port_width: board.port_width as usize,
            step: None,
            encoder: None,
            pwm: None,
            field: FieldPins::default(),
            serial,
            spindles: [const { None }; SPINDLES],
            index_slots: SPINDLE_SLOT,
            numbers: Vec::new(),
            remote_bits: [[[0; MAX_PINS]; MAX_REMOTES]; 2],
            reads: [None; MAX_PINS],
            sets: [None; MAX_PINS],
            driven: [0; MAX_PORTS],
            alternate: [0; MAX_PORTS],
            drivers: Vec::new(),
        };
        for pin in plan
            .serial
            .iter()
            .flat_map(|serial| serial.pins(board))
            .collect::<Vec<_>>()
        {
            plan.function(board, pin)?;
            let (port, bit) = plan.take(pin, "smart serial")?;
            plan.alternate[port] |= bit;
        }
        for (axis, max_velocity) in settings.axes.iter().zip(max_velocity) {
            plan.use_actuator(board, axis, *max_velocity)?;
            let (what, unit) = axis.actuator.counter();
            let longest_s = longest_gap_s(axis, *max_velocity);
            check_gap(what, unit, longest_s, period_s, settings.max_lost_packets)?;
        }
        for (listed, input) in settings.inputs.iter().enumerate() {
            plan.use_input(board, listed, &input.source)?;
        }
        for output in &settings.outputs {
            if let OutputTarget::Pwm { unit, .. } = output.target {
                plan.use_pwm(board, unit)?;
            }
        }
        for (listed, spindle) in settings.spindles.iter().enumerate() {
            let rpm = max_rpm.get(spindle.number).copied();
            plan.use_spindle(board, listed, spindle)?;
            if let (Some(angle), Some(rpm)) = (&spindle.angle, rpm.filter(|rpm| rpm.is_finite())) {
                // Missing readings are a fault of the spindle if it turns fast enough.
                let counts = rpm / 60.0 * angle.counts_per_turn() * period_s;
                if counts > MAX_COUNTS {
                    return Err(PlanError::Counts {
                        unit: angle.encoder,
                        counts,
                    });
                }
            }
        }
        plan.use_pins(board, settings)?;
        Ok(plan)
    }

    /// Reserves the modules of an axis, which must be fast enough for it.
    fn use_actuator(
        &mut self,
        board: &Description,
        axis: &BoardAxis,
        max_velocity: f64,
    ) -> Result<(), PlanError> {
        match axis.actuator {
            Actuator::Steps { unit, timing } => {
                let found = module(board, tag::STEP_GENERATOR, "step generator", unit, 10)?;
                grow(&mut self.step, found, unit);
                self.connect(
                    board,
                    tag::STEP_GENERATOR,
                    "step generator",
                    unit,
                    &[STEP, DIRECTION],
                )?;
                let clock_hz = f64::from(found.clock_hz);
                for (what, time_ns) in [
                    ("step_length_ns", timing.length_ns),
                    ("step_space_ns", timing.space_ns),
                    ("direction_setup_ns", timing.setup_ns),
                    ("direction_hold_ns", timing.hold_ns),
                ] {
                    if time_ns * 1e-9 * clock_hz > MAX_CLOCKS {
                        let most_ns = MAX_CLOCKS / clock_hz * 1e9;
                        return Err(PlanError::Time {
                            what,
                            time_ns,
                            most_ns,
                        });
                    }
                }
                let pulse = clocks(timing.length_ns, clock_hz) + clocks(timing.space_ns, clock_hz);
                let (needed, possible) = (axis.per_unit * max_velocity, clock_hz / f64::from(pulse));
                if needed > possible {
                    return Err(PlanError::StepRate {
                        unit,
                        needed,
                        possible,
                    });
                }
            }
            Actuator::Servo { encoder, pwm, .. } => {
                let found = module(board, tag::ENCODER, "encoder", encoder, 5)?;
                grow(&mut self.encoder, found, encoder);
                self.use_pwm(board, pwm)?;
            }
        }
        Ok(())
    }

    /// Reserves the modules of a spindle; its pins follow separately.
    fn use_spindle(
        &mut self,
        board: &Description,
        listed: usize,
        spindle: &BoardSpindle,
    ) -> Result<(), PlanError> {
        match spindle.speed {
            None => {}
            Some(SpindleSpeed::Pwm { unit, .. }) => self.use_pwm(board, unit)?,
            Some(SpindleSpeed::Remote { remote, .. }) => {
                if let (Some(found), Some(slot)) = (
                    self.serial.as_ref().and_then(|serial| serial.remotes.get(remote)),
                    self.spindles.get_mut(listed),
                ) {
                    *slot = Some(RemoteSpindle {
                        remote,
                        speed: found.element(true, "SpinOut")?.clone(),
                        enable: found.element(true, "SpinEna").ok().cloned(),
                        reverse: found.element(true, "SpinDir").ok().cloned(),
                    });
                }
            }
        }
        if let Some(angle) = spindle.angle {
            let found = module(board, tag::ENCODER, "encoder", angle.encoder, 5)?;
            grow(&mut self.encoder, found, angle.encoder);
            self.index_slots = self.index_slots.max((SPINDLE_SLOT + listed + 1).min(INDEX_SLOTS));
        }
        Ok(())
    }

    /// Reserves the source of an input of the board file's list, unless it is a pin.
    fn use_input(
        &mut self,
        board: &Description,
        listed: usize,
        source: &InputSource,
    ) -> Result<(), PlanError> {
        match source {
            InputSource::Pin(_) => {}
            InputSource::Remote { remote, data } => {
                if let Some(found) = self.remote(*remote) {
                    let element = found.element(false, data)?.clone();
                    self.numbers.push((listed, *remote, element));
                }
            }
            &InputSource::Encoder { unit, .. } => {
                let found = module(board, tag::ENCODER, "encoder", unit, 5)?;
                grow(&mut self.encoder, found, unit);
            }
        }
        Ok(())
    }

    /// Port and bit of a pin.
    const fn port_bit(&self, pin: usize) -> (usize, usize) {
        (pin / self.port_width, pin % self.port_width)
    }

    /// A smart-serial device by its number in the board file.
    fn remote(&self, remote: usize) -> Option<&crate::smart_serial::Remote> {
        self.serial.as_ref().and_then(|serial| serial.remotes.get(remote))
    }

    /// Smart serial, if the board file uses it.
    pub(crate) const fn serial(&self) -> Option<&SmartSerial> {
        self.serial.as_ref()
    }

    /// A spindle of the board file's list that is on smart serial.
    pub(crate) fn spindle(&self, listed: usize) -> Option<&RemoteSpindle> {
        self.spindles.get(listed).and_then(Option::as_ref)
    }

    /// The value of an analog input on smart serial, by its index in the board file's list.
    pub(crate) fn number(&self, listed: usize, inputs: &Inputs) -> f64 {
        let found = self.numbers.iter().find(|(index, ..)| *index == listed);
        found.map_or(0.0, |(_, remote, element)| {
            element.value(&inputs.serial.words[*remote])
        })
    }

    /// The register bit of an input.
    pub(crate) fn input_location(&self, pin: Pin) -> InputLocation {
        if let Some(remote) = pin.remote {
            let bit = self.remote_bits[0][remote][pin.pin];
            return InputLocation::Remote { remote, bit };
        }
        let (port, bit) = self.port_bit(pin.pin);
        self.reads[pin.pin].unwrap_or(InputLocation::Port { port, bit })
    }

    /// The register bit of an output.
    pub(crate) fn output_location(&self, pin: Pin) -> OutputLocation {
        if let Some(remote) = pin.remote {
            let bit = self.remote_bits[1][remote][pin.pin];
            return OutputLocation::Remote { remote, bit };
        }
        let (port, bit) = self.port_bit(pin.pin);
        self.sets[pin.pin].unwrap_or(OutputLocation::Port { port, bit })
    }

    /// Initial writes in order: everything at rest first, pins last. `outputs` are the inactive states.
    pub(crate) fn set_up(
        &self,
        settings: &BoardSettings,
        outputs: &Outputs,
        session: u16,
    ) -> Result<Vec<Packet>, PacketFull> {
        let mut packets = Vec::new();
        let mut packet = Packet::new();
        let zeros = [0; MAX_PORTS];
        packet.write(self.port.address(1, 0), &zeros[..self.ports])?;
        packet.write(self.port.address(3, 0), &zeros[..self.ports])?;
        packet.write(self.port.address(4, 0), &zeros[..self.ports])?;
        if let Some((step, count)) = self.step {
            packet.write(step.address(0, 0), &[0; MAX_UNITS][..count])?;
            packet.write(step.address(9, 0), &[u32::MAX])?;
        }
        packets.push(packet.clone());
        packet.clear();
        for axis in &settings.axes {
            if let (Actuator::Steps { unit, timing }, Some((step, _))) = (axis.actuator, self.step) {
                let clock_hz = f64::from(step.clock_hz);
                // The generator takes N + 1 clocks for pulse length and space, N for the direction times.
                for (register, value) in [
                    (2, 0),
                    (3, clocks(timing.setup_ns, clock_hz)),
                    (4, clocks(timing.hold_ns, clock_hz)),
                    (5, clocks(timing.length_ns, clock_hz) - 1),
                    (6, clocks(timing.space_ns, clock_hz) - 1),
                ] {
                    packet.write(step.address(register, unit), &[value])?;
                }
            }
            if let (
                Actuator::Servo {
                    encoder,
                    index_rising,
                    ..
                },
                Some((module, _)),
            ) = (axis.actuator, self.encoder)
            {
                let edge = if index_rising { INDEX_RISING } else { 0 };
                packet.write(module.address(1, encoder), &[QUADRATURE | edge])?;
            }
        }
        for input in &settings.inputs {
            if let (&InputSource::Encoder { unit, .. }, Some((module, _))) = (&input.source, self.encoder) {
                packet.write(module.address(1, unit), &[QUADRATURE])?;
            }
        }
        for angle in settings.spindles.iter().filter_map(|spindle| spindle.angle) {
            if let Some((module, _)) = self.encoder {
                let edge = if angle.index_rising { INDEX_RISING } else { 0 };
                packet.write(module.address(1, angle.encoder), &[QUADRATURE | edge])?;
            }
        }
        packets.push(packet.clone());
        packet.clear();
        if let Some((pwm, count)) = self.pwm {
            let clock = settings.pwm_hz * 4096.0;
            let rate = (clock * 65536.0 / f64::from(pwm.clock_hz))
                .round()
                .clamp(1.0, 65535.0);
            packet.write(pwm.address(0, 0), &[0; MAX_UNITS][..count])?;
            packet.write(pwm.address(1, 0), &[PWM_MODE; MAX_UNITS][..count])?;
            packet.write(pwm.address(2, 0), &[rate as u32])?;
            packet.write(pwm.address(4, 0), &[0])?;
        }
        let ticks = settings.watchdog_s * f64::from(self.watchdog.clock_hz) - 1.0;
        packet.write(self.watchdog.address(0, 0), &[ticks as u32])?;
        packet.write(self.watchdog.address(2, 0), &[FEED])?;
        packet.write(self.watchdog.address(1, 0), &[0])?;
        self.field.prepare(
            &mut packet,
            [settings.input_filter_s, settings.slow_filter_s],
            &outputs.field,
        )?;
        packet.write(self.port.address(0, 0), &outputs.ports[..self.ports])?;
        packet.write(self.port.address(2, 0), &self.alternate[..self.ports])?;
        packet.write(self.port.address(1, 0), &self.driven[..self.ports])?;
        self.field.start(&mut packet)?;
        packet.write_word(Space::Timer, SCRATCH, 0)?;
        for slot in 0..self.index_slots {
            packet.write_word(Space::Timer, INDEX_SCRATCH + 2 * slot as u16, 0)?;
        }
        packet.write_word(Space::Timer, SCRATCH + 4, session)?;
        packets.push(packet);
        Ok(packets)
    }

    /// The packet that reads all values, and the control registers of the encoders whose index pulses are
    /// awaited.
    pub(crate) fn read(
        &self,
        packet: &mut Packet,
        number: u16,
        awaited: &[Option<usize>; INDEX_SLOTS],
    ) -> Result<(), PacketFull> {
        packet.clear();
        packet.write_word(Space::Timer, SCRATCH + 2, number)?;
        packet.read(Space::Timer, SCRATCH, 3 + self.index_slots)?;
        packet.read(Space::HostMot2, self.watchdog.address(1, 0), 1)?;
        packet.read(Space::HostMot2, self.port.address(0, 0), self.ports)?;
        if let Some((step, count)) = self.step {
            packet.read(Space::HostMot2, step.address(1, 0), count)?;
        }
        if let Some((encoder, count)) = self.encoder {
            packet.read(Space::HostMot2, encoder.address(0, 0), count)?;
            for unit in awaited.iter().flatten() {
                packet.read(Space::HostMot2, encoder.address(1, *unit), 1)?;
            }
        }
        self.field.read(packet)?;
        self.serial.as_ref().map_or(Ok(()), |serial| serial.read(packet))
    }

    /// Evaluates the reply to [`Plan::read`].
    pub(crate) fn take_reply(
        &self,
        mut reply: crate::packet::Reply<'_>,
        awaited: &[Option<usize>; INDEX_SLOTS],
    ) -> Inputs {
        let mut inputs = Inputs {
            write_number: reply.word(),
            read_number: reply.word(),
            session: reply.word(),
            ..Inputs::default()
        };
        inputs.index_numbers[..self.index_slots].fill_with(|| reply.word());
        inputs.has_bitten = reply.value() & 1 == 1;
        inputs.ports[..self.ports].fill_with(|| reply.value());
        if let Some((_, count)) = self.step {
            inputs.accumulators[..count].fill_with(|| reply.value());
        }
        if let Some((_, count)) = self.encoder {
            inputs.counts[..count].fill_with(|| reply.value());
            for (control, awaited) in inputs.index_controls.iter_mut().zip(awaited) {
                if awaited.is_some() {
                    *control = reply.value();
                }
            }
        }
        inputs.filtered[..self.field.filters()].fill_with(|| reply.value());
        if let Some(serial) = &self.serial {
            serial.take_reply(&mut reply, &mut inputs.serial);
        }
        inputs
    }

    /// The packet that writes all values and resets the watchdog.
    pub(crate) fn write(
        &self,
        packet: &mut Packet,
        outputs: &Outputs,
        number: u16,
    ) -> Result<(), PacketFull> {
        packet.clear();
        if let Some((step, count)) = self.step {
            let scale = 4_294_967_296.0 / f64::from(step.clock_hz);
            let rates = outputs.rates.map(|rate| (rate * scale).round() as i32 as u32);
            packet.write(step.address(0, 0), &rates[..count])?;
        }
        if let Some((pwm, count)) = self.pwm {
            let values = outputs.duties.map(|duty| {
                let magnitude = (duty.abs().min(1.0) * 4095.0).round() as u32;
                magnitude << 16 | u32::from(duty < 0.0) << 31
            });
            packet.write(pwm.address(0, 0), &values[..count])?;
            packet.write(pwm.address(4, 0), &[outputs.pwm_enable])?;
        }
        for (slot, index) in outputs.index.iter().enumerate() {
            if let (Some(index), Some((encoder, _))) = (index, self.encoder) {
                packet.write(encoder.address(1, index.unit), &[index.control])?;
                packet.write_word(Space::Timer, INDEX_SCRATCH + 2 * slot as u16, index.number)?;
            }
        }
        packet.write(self.port.address(0, 0), &outputs.ports[..self.ports])?;
        self.field.write(packet, &outputs.field)?;
        if let Some(serial) = &self.serial {
            serial.write(packet, &outputs.serial)?;
        }
        packet.write(self.watchdog.address(2, 0), &[FEED])?;
        packet.write_word(Space::Timer, SCRATCH, number)
    }

    /// The packet that makes every pin an input.
    pub(crate) fn release(&self, packet: &mut Packet) -> Result<(), PacketFull> {
        packet.clear();
        if let Some((step, count)) = self.step {
            packet.write(step.address(0, 0), &[0; MAX_UNITS][..count])?;
        }
        if let Some((pwm, count)) = self.pwm {
            packet.write(pwm.address(0, 0), &[0; MAX_UNITS][..count])?;
            packet.write(pwm.address(4, 0), &[0])?;
        }
        self.field.release(packet)?;
        if let Some(serial) = &self.serial {
            serial.release(packet)?;
        }
        packet.write(self.port.address(1, 0), &[0; MAX_PORTS][..self.ports])
    }
}

/// Checks that no counter can wrap while readings are missing: for at most `max_lost` periods, and one more
/// until the next reading.
fn check_gap(
    what: &'static str,
    unit: usize,
    longest_s: f64,
    period_s: f64,
    max_lost: u32,
) -> Result<(), PlanError> {
    if f64::from(max_lost + 1) * period_s <= longest_s {
        return Ok(());
    }
    Err(PlanError::TurnsOver {
        what,
        unit,
        longest_ms: longest_s * 1e3,
        max_lost,
        permitted: (longest_s / period_s) as u32,
    })
}

/// Checks that the board is the one of the board file.
fn check_name(board: &Description, settings: &BoardSettings) -> Result<(), PlanError> {
    if let Some(wanted) = settings.name.as_ref()
        && !wanted.eq_ignore_ascii_case(&board.name)
    {
        return Err(PlanError::Name {
            found: board.name.clone(),
            wanted: wanted.clone(),
        });
    }
    Ok(())
}

/// A time in clocks, rounded up, at least 1.
fn clocks(time_ns: f64, clock_hz: f64) -> u32 {
    // Less than a hundredth of a clock is a rounding error.
    (time_ns * 1e-9 * clock_hz - 0.01).ceil().max(1.0) as u32
}

pub(crate) fn grow(module: &mut Option<(Module, usize)>, found: Module, unit: usize) {
    let count = module.map_or(0, |(_, count)| count).max(unit + 1);
    *module = Some((found, count));
}

pub(crate) fn module(
    board: &Description,
    tag: u8,
    what: &'static str,
    unit: usize,
    registers: u8,
) -> Result<Module, PlanError> {
    let found = board.module(tag).copied();
    let instances = found.map_or(0, |module| module.instances.min(MAX_UNITS));
    let Some(module) = found.filter(|_| unit < instances) else {
        return Err(PlanError::Module {
            what,
            unit,
            board: board.name.clone(),
            instances,
        });
    };
    if module.registers < registers || module.instance_stride != 4 || module.register_stride == 0 {
        return Err(PlanError::Kind {
            what,
            version: module.version,
            registers: module.registers,
            stride: module.instance_stride,
        });
    }
    Ok(module)
}
