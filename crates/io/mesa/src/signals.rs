//! Inputs and outputs of the machine at pins and PWM generators.

use evolvent_bus::{MachineInputs, MachineOutputs};
use evolvent_drive::OutputFollower;
use evolvent_machine::{Machine, SignalKind};

use crate::axis_set::{level, set};
use crate::board_settings::{BoardSettings, InputSource, OutputTarget, Pin};
use crate::plan::{Inputs, Outputs, Plan};
use crate::spindle::put_duty;

/// Interval between messages of unchanged inputs, ns.
const INPUTS_EVERY_NS: u64 = 5_000_000;

/// The counts of an encoder, extended beyond the range of its register.
#[derive(Debug)]
struct Counter {
    /// Number of the analog input on the bus.
    number: u32,
    unit: usize,
    inverted: bool,
    last: Option<u16>,
    total: i64,
}

impl Counter {
    /// Counts since the first reading.
    fn read(&mut self, inputs: &Inputs) -> f64 {
        // The register has the count in its lower 16 bits, and the time of the last count above.
        let now = inputs.counts[self.unit] as u16;
        let step = now.wrapping_sub(self.last.unwrap_or(now)) as i16;
        self.last = Some(now);
        self.total += i64::from(step);
        (if self.inverted { -self.total } else { self.total }) as f64
    }
}

#[derive(Clone, Copy, Debug)]
struct Output {
    /// Number on the bus.
    number: u32,
    target: OutputTarget,
    /// Its value while no core sends one.
    safe: f64,
}

impl Output {
    fn value(&self, wanted: &MachineOutputs) -> f64 {
        let is_known = |mask: u64| mask >> self.number & 1 == 1;
        match self.target {
            OutputTarget::Pin(_) if is_known(wanted.digital_mask) => {
                f64::from(u8::from(wanted.digital >> self.number & 1 == 1))
            }
            OutputTarget::Pwm { .. } if is_known(u64::from(wanted.analog_mask)) => {
                (wanted.analog.get(self.number as usize)).map_or(self.safe, |value| *value)
            }
            _ => self.safe,
        }
    }
}

/// Signals of one session. Only the constructor allocates.
#[derive(Debug)]
pub(crate) struct Signals {
    follower: OutputFollower,
    /// Number on the bus and pin.
    inputs: Vec<(u32, Pin)>,
    counters: Vec<Counter>,
    /// Number on the bus, and index in the board file's list: numbers of smart-serial devices.
    numbers: Vec<(u32, usize)>,
    outputs: Vec<Output>,
    coolant: [Option<Pin>; 2],
    sent: MachineInputs,
    outputs_sequence: u64,
    /// The session ends: all outputs are safe.
    ending: bool,
}

impl Signals {
    /// Names that the machine does not have are skipped; [`crate::check_fit`] reports them.
    pub(crate) fn new(machine: &Machine, board: &BoardSettings, instance: u64) -> Self {
        let signals = &machine.signals;
        let (mut inputs, mut counters, mut numbers) = (Vec::new(), Vec::new(), Vec::new());
        for (index, input) in board.inputs.iter().enumerate() {
            let Some(listed) = signals.inputs.iter().find(|listed| listed.name == input.name) else {
                continue;
            };
            match (listed.kind, &input.source) {
                (SignalKind::Digital, InputSource::Pin(pin)) => inputs.push((listed.number, *pin)),
                (SignalKind::Analog, InputSource::Remote { .. }) => numbers.push((listed.number, index)),
                (SignalKind::Analog, &InputSource::Encoder { unit, inverted }) => counters.push(Counter {
                    number: listed.number,
                    unit,
                    inverted,
                    last: None,
                    total: 0,
                }),
                _ => {}
            }
        }
        let outputs = board.outputs.iter().filter_map(|output| {
            let listed = signals.outputs.iter().find(|listed| listed.name == output.name)?;
            Some(Output {
                number: listed.number,
                target: output.target,
                safe: listed.safe,
            })
        });
        Self {
            follower: OutputFollower::default(),
            inputs,
            counters,
            numbers,
            outputs: outputs.collect(),
            coolant: board.coolant,
            sent: MachineInputs {
                instance,
                ..MachineInputs::default()
            },
            outputs_sequence: 0,
            ending: false,
        }
    }

    /// Makes outputs safe and stops spindles from now on, whatever the core sends.
    pub(crate) const fn end(&mut self) {
        self.ending = true;
    }

    pub(crate) fn offer(&mut self, now_ns: u64, message: &MachineOutputs) {
        // A damaged message is followed by a complete one.
        let _damaged = self.follower.offer(now_ns, message);
    }

    /// Sets the outputs at `now_ns`; a time far in the future makes them safe. Returns the outputs commanded
    /// by the core.
    pub(crate) fn step(&mut self, now_ns: u64, plan: &Plan, outputs: &mut Outputs) -> MachineOutputs {
        let wanted = self.follower.step(if self.ending { u64::MAX } else { now_ns });
        self.outputs_sequence = wanted.sequence;
        for output in &self.outputs {
            let value = output.value(&wanted);
            match output.target {
                OutputTarget::Pin(pin) => set(plan, outputs, pin, value != 0.0),
                OutputTarget::Pwm { unit, full } => put_duty(outputs, unit, value / full, value != 0.0),
            }
        }
        for (bit, pin) in [1, 0].into_iter().zip(self.coolant) {
            if let Some(pin) = pin {
                set(plan, outputs, pin, wanted.coolant >> bit & 1 == 1);
            }
        }
        wanted
    }

    /// Evaluates a reading. Returns the message, if one has to be sent.
    pub(crate) fn read(&mut self, measured_ns: u64, plan: &Plan, inputs: &Inputs) -> Option<MachineInputs> {
        let mut message = self.sent;
        (message.digital_mask, message.digital) = (0, 0);
        for (number, pin) in &self.inputs {
            message.digital_mask |= 1 << number;
            message.digital |= u64::from(level(plan, inputs, *pin)) << number;
        }
        for (number, index) in &self.numbers {
            message.analog_mask |= 1 << number;
            message.analog[*number as usize] = plan.number(*index, inputs);
        }
        for counter in &mut self.counters {
            message.analog_mask |= 1 << counter.number;
            message.analog[counter.number as usize] = counter.read(inputs);
        }
        message.outputs_sequence = self.outputs_sequence;
        let is_old = measured_ns.saturating_sub(self.sent.time_ns) >= INPUTS_EVERY_NS;
        if message == self.sent && !is_old {
            return None;
        }
        (message.sequence, message.time_ns) = (self.sent.sequence + 1, measured_ns);
        self.sent = message;
        Some(message)
    }
}
