//! The description of a board as read from it: name, clocks, modules, pins.

use core::fmt;

use thiserror::Error;

/// The cookie of a HostMot2 configuration.
const COOKIE: u32 = 0x55AA_CAFE;
/// Maximum number of modules and pins of a board.
const MAX_MODULES: usize = 32;
const MAX_PINS: u32 = 144;

/// The pin of an SSR that is the common reference of its outputs.
pub(crate) const RELAY_REFERENCE: u8 = 0xA0;

/// Function tags of modules, from Mesa's register map.
pub mod tag {
    /// Watchdog.
    pub const WATCHDOG: u8 = 0x02;
    /// Digital inputs and outputs.
    pub const IO_PORT: u8 = 0x03;
    /// Quadrature counters.
    pub const ENCODER: u8 = 0x04;
    /// Step generators.
    pub const STEP_GENERATOR: u8 = 0x05;
    /// PWM generators.
    pub const PWM: u8 = 0x06;
    /// Multiplexed quadrature counters.
    pub const MUXED_ENCODER: u8 = 0x0C;
    /// Inputs with a filter (InM).
    pub const INPUT_FILTER: u8 = 0x23;
    /// Outputs (OutM).
    pub const SIMPLE_OUTPUT: u8 = 0x2D;
    /// Smart serial.
    pub const SMART_SERIAL: u8 = 0xC1;
    /// Isolated outputs (SSR).
    pub const RELAY: u8 = 0xC3;

    /// A name for messages.
    #[must_use]
    pub const fn name(tag: u8) -> &'static str {
        match tag {
            0x01 => "interrupt",
            WATCHDOG => "watchdog",
            IO_PORT => "I/O port",
            ENCODER => "encoder",
            STEP_GENERATOR => "step generator",
            PWM => "PWM generator",
            0x07 | 0x0E | 0x0F => "SPI",
            0x08 => "SSI encoder",
            0x09 | 0x0A | 0x1B | 0x1C => "UART",
            MUXED_ENCODER => "multiplexed encoder",
            0x0D => "encoder multiplexer",
            0x13 => "three-phase PWM",
            0x18 => "BiSS encoder",
            0x1A => "DPLL",
            INPUT_FILTER => "input filter (InM)",
            SIMPLE_OUTPUT => "output (OutM)",
            RELAY => "isolated output (SSR)",
            0x80 => "LED",
            0xC0 => "resolver",
            SMART_SERIAL => "smart serial",
            _ => "other",
        }
    }
}

/// One kind of module on a board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Module {
    /// Its function; see [`tag`].
    pub tag: u8,
    /// Version.
    pub version: u8,
    /// Clock frequency, Hz.
    pub clock_hz: u32,
    /// Number of instances.
    pub instances: usize,
    /// Address of its first register.
    pub base: u16,
    /// Registers.
    pub registers: u8,
    /// Address distance of two instances, bytes.
    pub instance_stride: u16,
    /// Address distance of two registers, bytes.
    pub register_stride: u16,
}

impl Module {
    /// Address of a register of an instance.
    #[must_use]
    pub const fn address(&self, register: u16, instance: usize) -> u16 {
        self.base
            .wrapping_add(register.wrapping_mul(self.register_stride))
            .wrapping_add((instance as u16).wrapping_mul(self.instance_stride))
    }
}

/// The secondary function of a pin, besides plain input and output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PinFunction {
    /// Function tag of the module; 0 for none.
    pub tag: u8,
    /// Number of the instance.
    pub unit: u8,
    /// Pin number within the instance; bit 7 marks an output.
    pub pin: u8,
}

impl PinFunction {
    /// Whether a module reads the pin, so that something outside of the board drives it.
    #[must_use]
    pub const fn is_input(self) -> bool {
        self.tag != 0 && self.pin & 0x80 == 0
    }
}

impl fmt::Display for PinFunction {
    /// As in `encoder 0 A`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {} ", tag::name(self.tag), self.unit)?;
        match (self.tag, self.pin) {
            (tag::RELAY, RELAY_REFERENCE) => f.write_str("reference"),
            (tag::INPUT_FILTER | tag::RELAY | tag::SIMPLE_OUTPUT, pin) if pin & 0x7F != 0 => {
                write!(f, "bit {}", (pin & 0x7F) - 1)
            }
            (tag::STEP_GENERATOR, 0x81) => f.write_str("step"),
            (tag::STEP_GENERATOR, 0x82) | (tag::PWM, 0x82) => f.write_str("direction"),
            (tag::ENCODER, 1) => f.write_str("A"),
            (tag::ENCODER, 2) => f.write_str("B"),
            (tag::ENCODER, 3) => f.write_str("index"),
            (tag::PWM, 0x81) => f.write_str("out"),
            (tag::PWM, 0x83) => f.write_str("enable"),
            _ => f.write_str("pin"),
        }
    }
}

/// The description of a board.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Description {
    /// Its name, such as "7I96S".
    pub name: String,
    /// Pins per port.
    pub port_width: u32,
    /// Ports.
    pub ports: usize,
    /// Modules in register order.
    pub modules: Vec<Module>,
    /// Pins in order.
    pub pins: Vec<PinFunction>,
}

/// Why the data read from a board are not a valid description.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum DescriptionError {
    /// No HostMot2.
    #[error(
        "the cookie at 0100h is {found:08X}h instead of 55AACAFEh: the board has no HostMot2 configuration, \
         or has started with none; write its bit file with `mesaflash`"
    )]
    Cookie {
        /// The value found.
        found: u32,
    },
    /// Another configuration.
    #[error(
        "the configuration has the name `{found}` instead of HOSTMOT2: write a HostMot2 bit file with \
         `mesaflash`"
    )]
    Configuration {
        /// Its name.
        found: String,
    },
    /// An unknown IDROM type.
    #[error(
        "the IDROM is of type {found}, but only 2 and 3 are supported: the firmware is newer than this \
         software, or damaged"
    )]
    Idrom {
        /// Its type.
        found: u32,
    },
    /// An invalid value.
    #[error(
        "the IDROM has an invalid value, {what} {value}: the configuration is damaged; write its bit file \
         again with `mesaflash`"
    )]
    Figure {
        /// Which.
        what: &'static str,
        /// Its value.
        value: u32,
    },
}

/// Register access during discovery.
pub(crate) trait Registers {
    type Error: From<DescriptionError>;

    fn read(&mut self, address: u16, values: &mut [u32]) -> Result<(), Self::Error>;
}

impl Description {
    /// Reads the description of a board with the name `name`.
    pub(crate) fn explore<R: Registers>(name: String, registers: &mut R) -> Result<Self, R::Error> {
        let mut head = [0; 4];
        registers.read(0x0100, &mut head)?;
        if head[0] != COOKIE {
            return Err(DescriptionError::Cookie { found: head[0] }.into());
        }
        let characters: Vec<u8> = head[1..3].iter().flat_map(|part| part.to_le_bytes()).collect();
        if characters != b"HOSTMOT2" {
            let found = String::from_utf8_lossy(&characters).escape_default().to_string();
            return Err(DescriptionError::Configuration { found }.into());
        }
        let at = figure("own address", head[3], 0x0100, 0xFF00)? as u16;
        let mut idrom = [0; 16];
        registers.read(at, &mut idrom)?;
        if !matches!(idrom[0], 2 | 3) {
            return Err(DescriptionError::Idrom { found: idrom[0] }.into());
        }
        let modules_at = address(at, "address of the modules", idrom[1], 12 * MAX_MODULES)?;
        let ports = figure("ports", idrom[7], 1, 8)? as usize;
        let pins = figure("pins", idrom[8], 1, MAX_PINS)?;
        let port_width = figure("pins per port", idrom[9], 1, 32)?;
        let pins_at = address(at, "address of the pins", idrom[2], 4 * pins as usize)?;
        let clocks = [
            figure("low clock in Hz", idrom[10], 1_000_000, 1_000_000_000)?,
            figure("high clock in Hz", idrom[11], 1_000_000, 1_000_000_000)?,
        ];
        let stride = |option: u32, first: usize| idrom[first + (option & 1) as usize] as u16;
        let mut modules = Vec::new();
        for i in 0..MAX_MODULES {
            let mut words = [0; 3];
            registers.read(modules_at + 12 * i as u16, &mut words)?;
            let [tag, version, clock, instances] = words[0].to_le_bytes();
            if tag == 0 {
                break;
            }
            let [low, high, registers, strides] = words[1].to_le_bytes();
            modules.push(Module {
                tag,
                version,
                clock_hz: clocks[usize::from(clock == 2)],
                instances: usize::from(instances),
                base: u16::from_le_bytes([low, high]),
                registers,
                instance_stride: stride(u32::from(strides >> 4), 12),
                register_stride: stride(u32::from(strides), 14),
            });
        }
        // Pins beyond the bits of the ports have no register.
        let mut words = vec![0; (pins as usize).min(ports * port_width as usize)];
        for (i, some) in words.chunks_mut(64).enumerate() {
            registers.read(pins_at + 256 * i as u16, some)?;
        }
        let pins = words.iter().map(|word| {
            let [pin, tag, unit, _] = word.to_le_bytes();
            PinFunction { tag, unit, pin }
        });
        Ok(Self {
            name,
            port_width,
            ports,
            modules,
            pins: pins.collect(),
        })
    }

    /// The module with a function.
    #[must_use]
    pub fn module(&self, tag: u8) -> Option<&Module> {
        self.modules.iter().find(|module| module.tag == tag)
    }

    /// The board pin of a module pin.
    #[must_use]
    pub fn pin_of(&self, tag: u8, unit: usize, pin: u8) -> Option<usize> {
        let wanted = PinFunction {
            tag,
            unit: unit as u8,
            pin,
        };
        self.pins.iter().position(|function| *function == wanted)
    }

    /// A listing as text.
    #[must_use]
    pub fn text(&self) -> String {
        let mut text = format!(
            "{}: {} pins in {} ports\n",
            self.name,
            self.pins.len(),
            self.ports
        );
        for module in &self.modules {
            text += &format!(
                "  {:2} x {} (tag {:02X}h, version {}, at {:04X}h, {} MHz)\n",
                module.instances,
                tag::name(module.tag),
                module.tag,
                module.version,
                module.base,
                f64::from(module.clock_hz) / 1e6
            );
        }
        for (i, function) in self.pins.iter().enumerate() {
            if function.tag != 0 {
                text += &format!("  pin {i}: {function}\n");
            }
        }
        text
    }
}

fn figure(what: &'static str, value: u32, least: u32, most: u32) -> Result<u32, DescriptionError> {
    if (least..=most).contains(&value) {
        Ok(value)
    } else {
        Err(DescriptionError::Figure { what, value })
    }
}

/// The address of a table after the IDROM, with this number of bytes, all of which are within the address
/// space.
fn address(idrom: u16, what: &'static str, value: u32, bytes: usize) -> Result<u16, DescriptionError> {
    let offset = figure(what, value, 0x10, 0x1000)?;
    let begin = u32::from(idrom) + offset;
    if begin as usize + bytes > 1 << 16 {
        return Err(DescriptionError::Figure { what, value });
    }
    Ok(begin as u16)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A board that claims `pins` pins in `ports` ports of `width` bits.
    struct Claim {
        pins: u32,
        ports: u32,
        width: u32,
        /// Address of its IDROM.
        idrom: u32,
    }

    impl Registers for Claim {
        type Error = DescriptionError;

        fn read(&mut self, address: u16, values: &mut [u32]) -> Result<(), DescriptionError> {
            values.fill(0);
            let text = |part: &[u8; 4]| u32::from_le_bytes(*part);
            let idrom = [
                3,
                0x40,
                0x200,
                0,
                0,
                0,
                0,
                self.ports,
                self.pins,
                self.width,
                100_000_000,
                200_000_000,
            ];
            match address {
                0x0100 => values.copy_from_slice(&[COOKIE, text(b"HOST"), text(b"MOT2"), self.idrom]),
                _ if u32::from(address) == self.idrom => values[..idrom.len()].copy_from_slice(&idrom),
                _ => {}
            }
            Ok(())
        }
    }

    #[test]
    fn pins_beyond_the_bits_of_the_ports_are_left_out() {
        for (pins, ports, width, kept) in [(144, 2, 4, 8), (51, 3, 17, 51), (34, 2, 17, 34)] {
            let mut board = Claim {
                pins,
                ports,
                width,
                idrom: 0x0400,
            };
            let description = Description::explore("board".to_owned(), &mut board).unwrap();
            assert_eq!(description.pins.len(), kept);
        }
    }

    /// A damaged configuration, whose tables would be beyond the last address.
    #[test]
    fn tables_beyond_the_last_address_are_an_error() {
        for (idrom, pins, what) in [
            (0xFF00, 144, Some("address of the modules")),
            (0xFDF0, 144, Some("address of the pins")),
            (0xFD00, 64, None),
            (0xFD00, 65, Some("address of the pins")),
        ] {
            let (ports, width) = (8, 32);
            let mut board = Claim {
                pins,
                ports,
                width,
                idrom,
            };
            let result = Description::explore("board".to_owned(), &mut board);
            match (what, result) {
                (None, Ok(_)) => {}
                (Some(what), Err(DescriptionError::Figure { what: found, .. })) => assert_eq!(found, what),
                other => panic!("{idrom:04X}h: {other:?}"),
            }
        }
    }
}
