//! Signals of a session: outputs of the core to process data, inputs from them.

use evolvent_bus::{AXES, MachineInputs, MachineOutputs};
use evolvent_drive::OutputFollower;
use evolvent_machine::{Machine, SignalKind};
use evolvent_path::AxisMask;

use crate::drive_set::ProbeReading;
use crate::network::Network;
use crate::signal::{Channel, ChannelForm, OutputFunction, OutputSource};

/// Interval between two messages of unchanged inputs, ns.
const INPUTS_EVERY_NS: u64 = 5_000_000;
/// The core is silent after this time, as for outputs, ns.
const SILENCE_NS: u64 = 200_000_000;
/// Bits of `coolant` in the messages.
const MIST: u32 = 0b01;
const FLOOD: u32 = 0b10;

#[derive(Clone, Copy, Debug)]
struct Input {
    device: usize,
    number: u32,
    channel: Channel,
    error_bit: Option<u32>,
    /// Range outside of which the core rejects a message.
    range: [f64; 2],
}

#[derive(Clone, Copy, Debug)]
enum Source {
    /// An output of the machine file: number, and the safe value until the core sends one.
    Digital {
        number: u32,
        safe: f64,
    },
    Analog {
        number: u32,
        safe: f64,
    },
    /// Coolant or spindle.
    Function(OutputFunction, u32),
}

#[derive(Clone, Copy, Debug)]
struct Output {
    device: usize,
    source: Source,
    channel: Channel,
}

/// All signals of a session, with one follower. Only the constructor allocates.
#[derive(Debug)]
pub(crate) struct SignalSet {
    inputs: Vec<Input>,
    outputs: Vec<Output>,
    follower: OutputFollower,
    in_force: MachineOutputs,
    read: MachineInputs,
    sent: MachineInputs,
    ending: bool,
    heard_ns: Option<u64>,
    speaks: bool,
}

impl SignalSet {
    /// Signals unknown to the machine are skipped; `check_fit` has rejected them.
    pub(crate) fn new(machine: &Machine, network: &Network, instance: u64) -> Self {
        let kind = |channel: &Channel| {
            if channel.is_analog() {
                SignalKind::Analog
            } else {
                SignalKind::Digital
            }
        };
        let (mut inputs, mut outputs) = (Vec::new(), Vec::new());
        for (device, listed) in network.devices.iter().enumerate() {
            for input in &listed.inputs {
                let found = (machine.signals.inputs.iter())
                    .find(|known| known.name == input.name && known.kind == kind(&input.channel));
                inputs.extend(found.map(|known| Input {
                    device,
                    number: known.number,
                    channel: input.channel,
                    error_bit: input.error_bit,
                    range: known.range,
                }));
            }
            for output in &listed.outputs {
                let source = match &output.source {
                    OutputSource::Named(name) => (machine.signals.outputs.iter())
                        .find(|known| known.name == *name && known.kind == kind(&output.channel))
                        .map(|known| {
                            let (number, safe) = (known.number, known.safe);
                            match known.kind {
                                SignalKind::Digital => Source::Digital { number, safe },
                                SignalKind::Analog => Source::Analog { number, safe },
                            }
                        }),
                    OutputSource::Function(function, spindle) => Some(Source::Function(*function, *spindle)),
                };
                outputs.extend(source.map(|source| Output {
                    device,
                    source,
                    channel: output.channel,
                }));
            }
        }
        let message = MachineInputs {
            instance,
            ..MachineInputs::default()
        };
        Self {
            inputs,
            outputs,
            follower: OutputFollower::default(),
            in_force: MachineOutputs::default(),
            read: message,
            sent: message,
            ending: false,
            heard_ns: None,
            speaks: network.has_signals(),
        }
    }

    /// The drives' digital inputs follow other objects: their bits are offset by the position of 60FDh.
    pub(crate) fn move_inputs(&mut self, device: usize, by_bits: u32) {
        for input in self.inputs.iter_mut().filter(|input| input.device == device) {
            input.channel.bit += by_bits;
        }
    }

    /// The same for their digital outputs (60FEh).
    pub(crate) fn move_outputs(&mut self, device: usize, by_bits: u32) {
        for output in self.outputs.iter_mut().filter(|output| output.device == device) {
            output.channel.bit += by_bits;
        }
    }

    pub(crate) fn offer(&mut self, now_ns: u64, message: &MachineOutputs) {
        // A damaged message is followed by a complete one.
        if self.follower.offer(now_ns, message).is_ok() {
            self.heard_ns = Some(now_ns);
        }
    }

    /// Makes all outputs safe from now on, whatever the core sends.
    pub(crate) const fn end(&mut self) {
        self.ending = true;
    }

    /// The outputs in force.
    pub(crate) const fn in_force(&self) -> &MachineOutputs {
        &self.in_force
    }

    /// Whether the core is silent, or the session ends.
    pub(crate) fn is_silent(&self, now_ns: u64) -> bool {
        self.ending
            || self
                .heard_ns
                .is_none_or(|heard_ns| now_ns.saturating_sub(heard_ns) > SILENCE_NS)
    }

    /// Updates the outputs for this period.
    pub(crate) fn step(&mut self, now_ns: u64) {
        self.in_force = self.follower.step(now_ns);
    }

    /// Writes outputs of a device to its process data.
    pub(crate) fn write(&self, device: usize, image: &mut [u8]) {
        for output in self.outputs.iter().filter(|output| output.device == device) {
            let value = self.value(output.source);
            let (number, bits) = match output.channel.form {
                ChannelForm::Digital { inverted } => (i64::from((value != 0.0) != inverted), 1),
                ChannelForm::Analog(analog) => (analog.number(value), analog.bits),
            };
            put_bits(image, output.channel.bit, bits, number);
        }
    }

    fn value(&self, source: Source) -> f64 {
        let now = &self.in_force;
        match source {
            Source::Digital { safe, .. } | Source::Analog { safe, .. } if self.ending => safe,
            Source::Digital { number, safe } => {
                if now.digital_mask >> number & 1 == 1 {
                    f64::from(u8::from(now.digital >> number & 1 == 1))
                } else {
                    safe
                }
            }
            Source::Analog { number, safe } => match now.analog.get(number as usize) {
                Some(value) if now.analog_mask >> number & 1 == 1 => *value,
                _ => safe,
            },
            Source::Function(..) if self.ending => 0.0,
            Source::Function(function, spindle) => {
                let direction = now.spindle_direction.get(spindle as usize).copied().unwrap_or(0);
                // Stopped, or turned to an angle, which an on/off contact and a speed cannot do.
                let turns = matches!(direction, 1 | 2);
                match function {
                    OutputFunction::Flood => f64::from(u8::from(now.coolant & FLOOD != 0)),
                    OutputFunction::Mist => f64::from(u8::from(now.coolant & MIST != 0)),
                    OutputFunction::SpindleOn => f64::from(u8::from(turns)),
                    OutputFunction::SpindleClockwise => f64::from(u8::from(direction == 1)),
                    OutputFunction::SpindleCounterclockwise => f64::from(u8::from(direction == 2)),
                    OutputFunction::SpindleSpeed if !turns => 0.0,
                    OutputFunction::SpindleSpeed => {
                        now.spindle_rpm.get(spindle as usize).copied().unwrap_or(0.0)
                    }
                }
            }
        }
    }

    /// Reads inputs of a device from its process data; they are unknown if `image` is `None`.
    pub(crate) fn read(&mut self, device: usize, image: Option<&[u8]>) {
        for input in self.inputs.iter().filter(|input| input.device == device) {
            let bit = |at: u32| image.and_then(|image| get_bits(image, at, 1));
            let is_good = input.error_bit.is_none_or(|at| bit(at) == Some(0));
            let message = &mut self.read;
            match input.channel.form {
                ChannelForm::Digital { inverted } => {
                    let mask = 1_u64 << input.number;
                    let found = bit(input.channel.bit).filter(|_| is_good);
                    let is_on = found.is_some_and(|found| (found != 0) != inverted);
                    set(&mut message.digital_mask, mask, found.is_some());
                    set(&mut message.digital, mask, is_on);
                }
                ChannelForm::Analog(analog) => {
                    let number = image
                        .and_then(|image| get_bits(image, input.channel.bit, analog.bits))
                        .map(|bits| extend(bits, analog.bits, analog.signed));
                    // One value outside the machine file's range would invalidate the whole message.
                    let value = number
                        .filter(|_| is_good)
                        .map(|number| analog.value(number))
                        .filter(|value| (input.range[0]..=input.range[1]).contains(value));
                    let mut mask = u64::from(message.analog_mask);
                    set(&mut mask, 1 << input.number, value.is_some());
                    message.analog_mask = mask as u32;
                    if let Some(slot) = message.analog.get_mut(input.number as usize) {
                        *slot = value.unwrap_or(0.0);
                    }
                }
            }
        }
    }

    /// Reads the drives' reports of the probe.
    pub(crate) fn read_probe(&mut self, reading: &ProbeReading, now_ns: u64) {
        let message = &mut self.read;
        message.probe = match reading.input {
            None => 0,
            Some(false) => 1,
            Some(true) => 2,
        };
        if reading.trips != message.probe_trips {
            message.probe_trips = reading.trips;
            message.probe_time_ns = now_ns;
            message.probe_position = [0.0; AXES];
            message.probe_latched_mask = 0;
        }
        for (axis, slot) in message.probe_position.iter_mut().enumerate() {
            // Latched once: the datum may change afterwards.
            let is_new = AxisMask::from_bits(reading.latched_mask).contains(axis)
                && !AxisMask::from_bits(message.probe_latched_mask).contains(axis);
            if is_new {
                *slot = reading.position[axis];
                message.probe_latched_mask |= AxisMask::one(axis).bits();
            }
        }
    }

    /// Returns the message of this period, if one is due: after a change, or if the last one is old.
    pub(crate) fn message(&mut self, now_ns: u64) -> Option<MachineInputs> {
        if !self.speaks {
            return None;
        }
        self.read.outputs_sequence = if self.ending { 0 } else { self.in_force.sequence };
        (self.read.sequence, self.read.time_ns) = (self.sent.sequence, self.sent.time_ns);
        let is_old = now_ns.saturating_sub(self.sent.time_ns) >= INPUTS_EVERY_NS;
        if self.read == self.sent && !is_old || now_ns <= self.sent.time_ns {
            return None;
        }
        (self.read.sequence, self.read.time_ns) = (self.sent.sequence + 1, now_ns);
        self.sent = self.read;
        Some(self.sent)
    }
}

fn set(bits: &mut u64, mask: u64, is_on: bool) {
    *bits = if is_on { *bits | mask } else { *bits & !mask };
}

/// Bits of process data, the lowest first; `None` if there are not enough.
fn get_bits(image: &[u8], at: u32, bits: u32) -> Option<u64> {
    (0..bits).try_fold(0, |number, i| {
        let byte = image.get((at + i) as usize / 8)?;
        Some(number | u64::from(byte >> ((at + i) % 8) & 1) << i)
    })
}

fn put_bits(image: &mut [u8], at: u32, bits: u32, number: i64) {
    for i in 0..bits {
        if let Some(byte) = image.get_mut((at + i) as usize / 8) {
            let mask = 1 << ((at + i) % 8);
            *byte = if number >> i & 1 == 1 {
                *byte | mask
            } else {
                *byte & !mask
            };
        }
    }
}

const fn extend(number: u64, bits: u32, signed: bool) -> i64 {
    let unused = 64 - bits;
    if signed {
        (number << unused) as i64 >> unused
    } else {
        number as i64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MACHINE: &str = r#"
        input = [{ name = "door", number = 3 }, { name = "level", number = 0, kind = "analog", min = 0, max = 10 }]
        output = [
            { name = "clamp", number = 5, safe_on = true },
            { name = "valve", number = 1, kind = "analog", safe_value = 2.5 },
        ]
        spindle = [{ max_rpm = 6000 }]
    "#;
    const NETWORK: &str = r#"
        [[device]]
        name = "io"
        vendor = 1
        product = 1
        input = [
            { name = "door", bit = 9, inverted = true },
            { name = "level", bit = 16, values = [0, 10], error_bit = 6 },
        ]
        output = [
            { name = "clamp", bit = 0 },
            { name = "valve", bit = 4, bits = 12, signed = false, raw = [0, 4095], values = [0, 4.095] },
            { function = "flood", bit = 1, inverted = true },
            { function = "spindle-counterclockwise", bit = 2 },
            { function = "spindle-speed", bit = 16, values = [0, 6000] },
        ]
        [[device]]
        name = "x"
        vendor = 1
        product = 2
        axis = { letter = "X", increments_per_turn = 1000000, turn_mm = 5 }
    "#;

    fn signal_set() -> SignalSet {
        let text = evolvent_file_tests::shipped("machines/mill-ethercat.toml");
        let machine = Machine::parse(
            &format!(
                "{MACHINE}
{text}"
            ),
            "machine.toml",
        )
        .expect("a machine");
        let network = Network::parse(NETWORK, "network.toml").expect("a network");
        SignalSet::new(&machine, &network, 7)
    }

    fn image(signals: &SignalSet) -> [u8; 4] {
        let mut image = [0; 4];
        signals.write(0, &mut image);
        image
    }

    #[test]
    fn outputs_follow_core_when_due_and_are_safe_else() {
        let mut signals = signal_set();
        signals.step(1_000);
        // Clamp on, 2.5 of the valve: 2500 = 9C4h, flood off (1), no spindle.
        let safe = [0x43, 0x9C, 0, 0];
        assert_eq!(image(&signals), safe);
        let mut message = MachineOutputs {
            sequence: 4,
            due_time_ns: 5_000,
            digital_mask: 1 << 5,
            safe_digital: 1 << 5,
            analog_mask: 1 << 1,
            coolant: FLOOD,
            spindle_mask: 1,
            ..MachineOutputs::default()
        };
        (message.analog[1], message.safe_analog[1]) = (0.016, 2.5);
        (message.spindle_direction[0], message.spindle_rpm[0]) = (2, 3000.0);
        signals.offer(2_000, &message);
        signals.step(4_999);
        assert_eq!(image(&signals), safe, "not due");
        signals.step(5_000);
        // 0.016 is 16 = 010h; 3000 of 6000 rpm is 16384 of 32767.
        assert_eq!(image(&signals), [0x04, 0x01, 0x00, 0x40]);
        signals.step(300_000_000);
        assert_eq!(image(&signals), safe, "the core is silent");
        let mut ended = signal_set();
        ended.offer(2_000, &message);
        ended.step(5_000);
        ended.end();
        assert_eq!(image(&ended), safe, "the session ends");
    }

    #[test]
    fn inputs_are_sent_at_changes_and_5_ms_with_validity() {
        let mut signals = signal_set();
        // Door: bit 9 is 0, so it is on; level 16384 of 32767.
        signals.read(0, Some(&[0, 0b1101, 0x00, 0x40]));
        let first = signals.message(1_000).expect("a change");
        assert_eq!((first.sequence, first.time_ns, first.instance), (1, 1_000, 7));
        assert_eq!((first.digital_mask, first.digital), (1 << 3, 1 << 3));
        assert_eq!(first.analog_mask, 1);
        assert!((first.analog[0] - 163_840.0 / 32_767.0).abs() < 1e-12);
        assert_eq!(signals.message(2_000), None, "nothing new");
        assert_eq!(
            signals.message(5_001_000).map(|message| message.sequence),
            Some(2)
        );
        // The terminal's error bit; then a value below the machine file's range; then the device is lost.
        for (image, expected) in [
            (Some(&[0x40, 0b10, 0x00, 0x40]), (1 << 3, 0, 0)),
            (Some(&[0, 0, 0xFF, 0xFF]), (1 << 3, 1 << 3, 0)),
            (None, (0, 0, 0)),
        ] {
            signals.read(0, image.map(|image| image.as_slice()));
            let message = signals.message(signals.sent.time_ns + 1).expect("a change");
            assert_eq!(
                (message.digital_mask, message.digital, message.analog_mask),
                expected
            );
            assert_eq!(message.analog[0], 0.0);
        }
    }

    #[test]
    fn numbers_of_any_size_come_back_from_any_bit() {
        let mut random = evolvent_random::Random::new();
        for _ in 0..20_000 {
            let bits = random.between(1.0, 32.999) as u32;
            let at = random.between(0.0, 31.999) as u32;
            let signed = bits > 1 && random.between(0.0, 1.0) < 0.5;
            let bound = 2_f64.powi(bits as i32);
            let low = if signed { -bound / 2.0 } else { 0.0 };
            let number = random.between(low, low + bound - 1.0).floor() as i64;
            let before = [random.between(0.0, 256.0) as u8; 10];
            let mut image = before;
            put_bits(&mut image, at, bits, number);
            let read = get_bits(&image, at, bits).map(|found| extend(found, bits, signed));
            assert_eq!(read, Some(number), "{bits} bits at {at}, signed {signed}");
            for bit in (0..80).filter(|bit| !(at..at + bits).contains(bit)) {
                assert_eq!(get_bits(&image, bit, 1), get_bits(&before, bit, 1), "bit {bit}");
            }
        }
        assert_eq!(get_bits(&[0xFF], 7, 2), None);
    }
}
