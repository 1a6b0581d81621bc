//! Terminals with inputs and outputs, and their coupler.

use crate::object::{Dictionary, Entry, ObjectCode, data_type as t};

/// Kinds of terminals, with the similar types by Beckhoff.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TerminalKind {
    /// No process data, like EK1100.
    Coupler,
    /// 8 digital inputs, like EL1008.
    DigitalInput,
    /// 8 digital outputs, like EL2008.
    DigitalOutput,
    /// 2 analog inputs of 16 bits with a status word, like EL3102. It has a mailbox.
    AnalogInput,
    /// 2 analog outputs of 16 bits, like EL4102. It has a mailbox.
    AnalogOutput,
}

/// One terminal.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Terminal {
    kind: TerminalKind,
    /// Digital inputs, or outputs as they are driven.
    bits: u8,
    /// Analog inputs, or outputs as they are driven.
    analog: [i16; 2],
    /// An analog input that is broken: bit 6 of its status.
    broken: bool,
}

impl Terminal {
    pub(crate) const fn new(kind: TerminalKind) -> Self {
        Self {
            kind,
            bits: 0,
            analog: [0; 2],
            broken: false,
        }
    }

    /// The kind of the terminal.
    #[must_use]
    pub const fn kind(&self) -> TerminalKind {
        self.kind
    }

    /// Its digital inputs, or its outputs as they are driven; bit 0 is the first.
    #[must_use]
    pub const fn bits(&self) -> u8 {
        self.bits
    }

    /// Its analog inputs, or its outputs as they are driven.
    #[must_use]
    pub const fn analog(&self) -> [i16; 2] {
        self.analog
    }

    /// Breaks the wires of the analog inputs, which sets bit 6 of their status.
    pub const fn set_broken(&mut self, broken: bool) {
        self.broken = broken;
    }

    /// Receives the outputs of another terminal as inputs.
    pub(crate) const fn receive(&mut self, other: &Self) {
        match (other.kind, self.kind) {
            (TerminalKind::DigitalOutput, TerminalKind::DigitalInput) => self.bits = other.bits,
            (TerminalKind::AnalogOutput, TerminalKind::AnalogInput) => self.analog = other.analog,
            _ => {}
        }
    }

    /// Sets digital inputs.
    pub const fn set_inputs(&mut self, bits: u8) {
        if matches!(self.kind, TerminalKind::DigitalInput) {
            self.bits = bits;
        }
    }

    /// Sets an analog input.
    pub const fn set_analog(&mut self, channel: usize, value: i16) {
        if channel < self.analog.len() && matches!(self.kind, TerminalKind::AnalogInput) {
            self.analog[channel] = value;
        }
    }

    pub(crate) const fn product(kind: TerminalKind) -> (u32, &'static str, &'static str) {
        match kind {
            TerminalKind::Coupler => (0x1100, "SIM-EK1100", "Coupler (test simulator)"),
            TerminalKind::DigitalInput => (0x1008, "SIM-EL1008", "8 digital inputs (test simulator)"),
            TerminalKind::DigitalOutput => (0x2008, "SIM-EL2008", "8 digital outputs (test simulator)"),
            TerminalKind::AnalogInput => (0x3102, "SIM-EL3102", "2 analog inputs (test simulator)"),
            TerminalKind::AnalogOutput => (0x4102, "SIM-EL4102", "2 analog outputs (test simulator)"),
        }
    }

    pub(crate) const fn has_mailbox(&self) -> bool {
        matches!(self.kind, TerminalKind::AnalogInput | TerminalKind::AnalogOutput)
    }

    /// Adds the objects, and returns the PDOs with the entries that they map.
    pub(crate) fn objects(&self, objects: &mut Dictionary) -> Vec<(u16, Vec<(u16, u8)>)> {
        match self.kind {
            TerminalKind::Coupler => Vec::new(),
            TerminalKind::DigitalInput => (0..8)
                .map(|channel| {
                    let bit = Entry::integer("Input", t::BOOLEAN, 0).input();
                    objects.compound(
                        0x6000 + 0x10 * channel,
                        "Digital input",
                        ObjectCode::Record,
                        vec![bit],
                    );
                    (0x1A00 + channel, vec![(0x6000 + 0x10 * channel, 1)])
                })
                .collect(),
            TerminalKind::DigitalOutput => (0..8)
                .map(|channel| {
                    let bit = Entry::integer("Output", t::BOOLEAN, 0).output();
                    objects.compound(
                        0x7000 + 0x10 * channel,
                        "Digital output",
                        ObjectCode::Record,
                        vec![bit],
                    );
                    (0x1600 + channel, vec![(0x7000 + 0x10 * channel, 1)])
                })
                .collect(),
            TerminalKind::AnalogOutput => (0..2)
                .map(|channel| {
                    let value = Entry::integer("Value", t::INTEGER16, 0).output();
                    objects.compound(
                        0x7000 + 0x10 * channel,
                        "Analog output",
                        ObjectCode::Record,
                        vec![value],
                    );
                    (0x1600 + channel, vec![(0x7000 + 0x10 * channel, 1)])
                })
                .collect(),
            TerminalKind::AnalogInput => (0..2)
                .map(|channel| {
                    let entries = vec![
                        Entry::integer("Status", t::UNSIGNED16, 0).input(),
                        Entry::integer("Value", t::INTEGER16, 0).input(),
                    ];
                    objects.compound(
                        0x6000 + 0x10 * channel,
                        "Analog input",
                        ObjectCode::Record,
                        entries,
                    );
                    (
                        0x1A00 + channel,
                        vec![(0x6000 + 0x10 * channel, 1), (0x6000 + 0x10 * channel, 2)],
                    )
                })
                .collect(),
        }
    }

    /// Accepts outputs; they are off unless the fieldbus is in OP.
    pub(crate) fn take_outputs(&mut self, objects: &Dictionary, operational: bool) {
        if self.kind == TerminalKind::DigitalOutput {
            let driven = (0..8_u16).fold(0, |bits, channel| {
                bits | (objects.integer(0x7000 + 0x10 * channel, 1) as u8 & 1) << channel
            });
            self.bits = if operational { driven } else { 0 };
        }
        if self.kind == TerminalKind::AnalogOutput {
            for (channel, value) in (0_u16..).zip(&mut self.analog) {
                let driven = objects.integer(0x7000 + 0x10 * channel, 1) as i16;
                *value = if operational { driven } else { 0 };
            }
        }
    }

    pub(crate) fn give_inputs(&self, objects: &mut Dictionary) {
        match self.kind {
            TerminalKind::DigitalInput => {
                for channel in 0..8_u16 {
                    objects.set_integer(0x6000 + 0x10 * channel, 1, i64::from(self.bits >> channel & 1));
                }
            }
            TerminalKind::AnalogInput => {
                let status = i64::from(self.broken) << 6;
                for (channel, &value) in (0_u16..).zip(&self.analog) {
                    objects.set_integer(0x6000 + 0x10 * channel, 1, status);
                    objects.set_integer(0x6000 + 0x10 * channel, 2, i64::from(value));
                }
            }
            TerminalKind::Coupler | TerminalKind::DigitalOutput | TerminalKind::AnalogOutput => {}
        }
    }
}
