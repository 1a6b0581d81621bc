//! The modules of a simulated board, and the functions of its pins.

/// Function tags of modules and pins.
pub(crate) mod tag {
    pub(crate) const WATCHDOG: u8 = 0x02;
    pub(crate) const IO_PORT: u8 = 0x03;
    pub(crate) const ENCODER: u8 = 0x04;
    pub(crate) const STEP_GENERATOR: u8 = 0x05;
    pub(crate) const PWM: u8 = 0x06;
    pub(crate) const INPUT_FILTER: u8 = 0x23;
    pub(crate) const SIMPLE_OUTPUT: u8 = 0x2D;
    pub(crate) const LED: u8 = 0x80;
    pub(crate) const SMART_SERIAL: u8 = 0xC1;
    pub(crate) const RELAY: u8 = 0xC3;
}

/// Pins of one connector of these boards.
pub(crate) const PORT_WIDTH: usize = 17;

/// A simulated board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BoardModel {
    /// Two connectors of 17 pins: 5 step generators and an encoder on the first.
    B7i92,
    /// 11 inputs with filters, 4 isolated outputs and 2 others, 5 step generators, an encoder, a PWM
    /// generator.
    B7i96s,
    /// 5 step generators, an encoder, and the field I/O of a 7I76 on smart serial.
    B7i76e,
    /// 6 encoders, 6 PWM generators for analog outputs.
    B7i97,
}

/// Fields of a module descriptor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Module {
    pub(crate) tag: u8,
    pub(crate) version: u8,
    pub(crate) is_fast: bool,
    pub(crate) instances: u8,
    pub(crate) base: u16,
    pub(crate) registers: u8,
    /// Stride selection: of instances in the upper bits, of registers in the lower.
    pub(crate) strides: u8,
    pub(crate) multiple: u32,
}

impl BoardModel {
    /// All models with their names on the command line.
    pub const ALL: [(Self, &'static str); 4] = [
        (Self::B7i92, "7i92"),
        (Self::B7i96s, "7i96s"),
        (Self::B7i76e, "7i76e"),
        (Self::B7i97, "7i97"),
    ];

    /// Name of the board.
    #[must_use]
    pub const fn card_name(self) -> &'static str {
        match self {
            Self::B7i92 => "7I92",
            Self::B7i96s => "7I96S",
            Self::B7i76e => "7I76E-16",
            Self::B7i97 => "7I97",
        }
    }

    /// The name in the IDROM.
    pub(crate) const fn idrom_name(self) -> &'static [u8; 8] {
        match self {
            Self::B7i92 => b"MESA7I92",
            Self::B7i96s => b"MESA7I96",
            Self::B7i76e => b"MESA7I76",
            Self::B7i97 => b"MESA7I97",
        }
    }

    pub(crate) const fn ports(self) -> usize {
        match self {
            Self::B7i92 => 2,
            _ => 3,
        }
    }

    pub(crate) const fn pins(self) -> usize {
        self.ports() * PORT_WIDTH
    }

    pub(crate) const fn step_generators(self) -> usize {
        match self {
            Self::B7i97 => 0,
            _ => 5,
        }
    }

    pub(crate) const fn encoders(self) -> usize {
        match self {
            Self::B7i97 => 6,
            _ => 1,
        }
    }

    pub(crate) const fn pwms(self) -> usize {
        match self {
            Self::B7i97 => 6,
            Self::B7i96s => 1,
            _ => 0,
        }
    }

    /// Number of filtered inputs; a board with any also has outputs of modules.
    pub(crate) const fn filtered_inputs(self) -> u32 {
        match self {
            Self::B7i96s => 11,
            _ => 0,
        }
    }

    /// Whether it has smart serial, with a 7I76 at its first channel.
    pub(crate) const fn has_smart_serial(self) -> bool {
        matches!(self, Self::B7i76e)
    }

    pub(crate) fn modules(self) -> Vec<Module> {
        let module = |tag, version, is_fast, instances: usize, base, registers, multiple| Module {
            tag,
            version,
            is_fast,
            instances: instances as u8,
            base,
            registers,
            strides: if tag == tag::SMART_SERIAL { 0x10 } else { 0 },
            multiple,
        };
        let mut modules = vec![
            module(tag::WATCHDOG, 0, false, 1, 0x0C00, 3, 0),
            module(tag::IO_PORT, 0, false, self.ports(), 0x1000, 5, 0x1F),
        ];
        if self.step_generators() > 0 {
            let count = self.step_generators();
            modules.push(module(tag::STEP_GENERATOR, 2, false, count, 0x2000, 10, 0x1FF));
        }
        modules.push(module(tag::ENCODER, 2, false, self.encoders(), 0x3000, 5, 3));
        if self.pwms() > 0 {
            modules.push(module(tag::PWM, 0, true, self.pwms(), 0x4000, 5, 3));
        }
        if self.filtered_inputs() > 0 {
            modules.push(module(tag::INPUT_FILTER, 0, false, 1, 0x8500, 5, 0x1F));
            modules.push(module(tag::RELAY, 0, false, 1, 0x7D00, 2, 3));
            modules.push(module(tag::SIMPLE_OUTPUT, 0, false, 1, 0x7F00, 1, 1));
        }
        if self.has_smart_serial() {
            modules.push(module(tag::SMART_SERIAL, 0, false, 1, 0x5B00, 6, 0x3C));
        }
        modules.push(module(tag::LED, 0, false, 1, 0x0200, 1, 0));
        modules
    }

    /// Secondary function of each pin: tag, unit, pin of the unit (bit 7: an output).
    pub(crate) fn pin_functions(self) -> Vec<(u8, u8, u8)> {
        let mut pins = vec![(0, 0, 0); self.pins()];
        let mut next = match self {
            // Inputs and outputs come first.
            Self::B7i96s => PORT_WIDTH,
            _ => 0,
        };
        let mut put = |function| {
            pins[next] = function;
            next += 1;
        };
        for unit in 0..self.step_generators() as u8 {
            put((tag::STEP_GENERATOR, unit, 0x82));
            put((tag::STEP_GENERATOR, unit, 0x81));
        }
        for unit in 0..self.encoders() as u8 {
            for pin in 1..=3 {
                put((tag::ENCODER, unit, pin));
            }
        }
        for unit in 0..self.pwms() as u8 {
            for pin in 0x81..=0x83 {
                put((tag::PWM, unit, pin));
            }
        }
        if self.has_smart_serial() {
            // Two channels, as the real one.
            for (pin, function) in [(13, 0x81), (14, 0x01), (15, 0x82), (16, 0x02)] {
                pins[pin] = (tag::SMART_SERIAL, 0, function);
            }
        }
        if self.filtered_inputs() > 0 {
            for bit in 0..11 {
                pins[usize::from(bit)] = (tag::INPUT_FILTER, 0, bit + 1);
            }
            for bit in 0..4 {
                pins[11 + usize::from(bit)] = (tag::RELAY, 0, 0x81 + bit);
            }
            for bit in 4..6 {
                pins[11 + usize::from(bit)] = (tag::SIMPLE_OUTPUT, 0, 0x81 + bit);
            }
            // The reference of all isolated outputs, after the PWM generator's pins.
            pins[33] = (tag::RELAY, 0, 0xA0);
        }
        pins
    }
}
