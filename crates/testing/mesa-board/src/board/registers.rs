//! The registers of a board, by address in its memory spaces.

use super::{Board, CLOCK_HIGH, CLOCK_LOW, COOKIE};
use crate::encoder::Encoder;
use crate::fault::FaultKind;
use crate::layout::{PORT_WIDTH, tag};
use crate::lbp16::Memory;
use crate::step_generator::StepGenerator;

impl Board {
    fn idrom(&self, address: u16) -> u32 {
        let name = self.model.idrom_name();
        let part = |i: usize| u32::from_le_bytes([name[i], name[i + 1], name[i + 2], name[i + 3]]);
        match address {
            0x400 => 3,
            0x404 => 0x40,
            0x408 => 0x200,
            0x40C => part(0),
            0x410 => part(4),
            0x414 => 9,
            0x418 => 144,
            0x41C => self.model.ports() as u32,
            0x420 => self.model.pins() as u32,
            0x424 => PORT_WIDTH as u32,
            0x428 => CLOCK_LOW,
            0x42C => CLOCK_HIGH,
            0x430 => 4,
            0x434 => 0x40,
            0x438 => 0x100,
            0x43C => 4,
            0x440..0x600 => {
                let modules = self.model.modules();
                let Some(module) = modules.get(usize::from(address - 0x440) / 12) else {
                    return 0;
                };
                match (address - 0x440) % 12 / 4 {
                    0 => u32::from_le_bytes([
                        module.tag,
                        module.version,
                        1 + u8::from(module.is_fast),
                        module.instances,
                    ]),
                    1 => u32::from_le_bytes([
                        module.base as u8,
                        (module.base >> 8) as u8,
                        module.registers,
                        module.strides,
                    ]),
                    _ => module.multiple,
                }
            }
            0x600..0x800 => {
                let function = self.functions.get(usize::from(address - 0x600) / 4);
                function.map_or(0, |&(tag, unit, pin)| {
                    u32::from_le_bytes([pin, tag, unit, tag::IO_PORT])
                })
            }
            _ => 0,
        }
    }

    fn read_register(&mut self, address: u16) -> u32 {
        self.traffic.reads += 1;
        if let Some(log) = &mut self.log {
            log.push((address, false));
        }
        let unit = usize::from(address & 0xFF) / 4;
        let generator = |get: fn(&StepGenerator) -> u32| self.step_generators.get(unit).map_or(0, get);
        match address & 0xFF00 {
            0x0100 => match address {
                0x100 if self.is_active(FaultKind::Cookie) => 0x1234_5678,
                0x100 => COOKIE,
                0x104 => u32::from_le_bytes(*b"HOST"),
                0x108 => u32::from_le_bytes(*b"MOT2"),
                0x10C => 0x400,
                _ => 0,
            },
            0x0200 => self.leds,
            0x0400..=0x0700 => self.idrom(address),
            0x0C00 => self.watchdog_timer,
            0x0D00 => u32::from(self.watchdog_bitten),
            0x1000 if unit < self.ports.len() => {
                let pins = unit * PORT_WIDTH..(unit + 1) * PORT_WIDTH;
                pins.rev()
                    .fold(0, |bits, pin| bits << 1 | u32::from(self.level(pin)))
            }
            0x1100 => self.ports.get(unit).map_or(0, |port| port.direction),
            0x1200 => self.ports.get(unit).map_or(0, |port| port.alternate),
            0x1300 => self.ports.get(unit).map_or(0, |port| port.open_drain),
            0x1400 => self.ports.get(unit).map_or(0, |port| port.invert),
            0x2000 => generator(|generator| generator.rate),
            0x2100 => generator(StepGenerator::accumulator),
            0x3000 => self.encoders.get(unit).map_or(0, Encoder::count),
            0x3100 => self.encoders.get(unit).map_or(0, Encoder::control),
            0x3200 => self.encoder_divider,
            0x3300 => (self.now_ns / 1000) as u32 & 0xFFFF,
            0x3400 => self.encoder_filter,
            0x4000 => self.pwms.get(unit).map_or(0, |pwm| pwm.value),
            0x4100 => self.pwms.get(unit).map_or(0, |pwm| pwm.mode),
            0x5B00..=0x6000 => {
                let (register, channel) = (usize::from(address >> 8) - 0x5B, usize::from(address & 0x3F) / 4);
                self.serial
                    .as_ref()
                    .map_or(0, |serial| serial.read(register, channel))
            }
            0x7D00 => self.field.relays,
            0x7E00 => self.field.relay_rate,
            0x7F00 => self.field.simple,
            0x8500..=0x8900 => {
                let register = usize::from(address >> 8) - 0x85;
                self.filter.as_ref().map_or(0, |filter| filter.read(register))
            }
            _ => 0,
        }
    }

    fn write_register(&mut self, address: u16, value: u32) {
        self.traffic.writes += 1;
        if let Some(log) = &mut self.log {
            log.push((address, true));
        }
        let unit = usize::from(address & 0xFF) / 4;
        let area = address & 0xFF00;
        match area {
            0x0200 => self.leds = value,
            0x0C00 => self.watchdog_timer = value,
            0x0D00 => self.watchdog_bitten = value & 1 == 1,
            0x0E00 if value >> 24 == 0x5A => {
                self.traffic.feeds += 1;
                self.watchdog_left = u64::from(self.watchdog_timer) + 1;
                self.armed_ns.get_or_insert(self.now_ns);
            }
            0x1000..=0x1400 => {
                let is_bitten = self.watchdog_bitten;
                let Some(port) = self.ports.get_mut(unit) else {
                    return;
                };
                match area {
                    0x1000 => port.output = value,
                    0x1100 if !is_bitten => port.direction = value,
                    0x1200 => port.alternate = value,
                    0x1300 if !is_bitten => port.open_drain = value,
                    0x1400 => port.invert = value,
                    _ => {}
                }
            }
            0x2900 => self.dds = value,
            0x2000..=0x2600 => {
                let Some(generator) = self.step_generators.get_mut(unit) else {
                    return;
                };
                let time = value & 0x3FFF;
                match area {
                    0x2000 => generator.set_rate(value),
                    0x2100 => generator.set_accumulator(value),
                    0x2200 => generator.mode = value & 3,
                    0x2300 => generator.dir_setup = time,
                    0x2400 => generator.dir_hold = time,
                    0x2500 => generator.step_length = time,
                    _ => generator.step_space = time,
                }
            }
            0x3000 => {
                if let Some(encoder) = self.encoders.get_mut(unit) {
                    encoder.clear();
                }
            }
            0x3100 => {
                if let Some(encoder) = self.encoders.get_mut(unit) {
                    encoder.set_control(value);
                }
            }
            0x3200 => self.encoder_divider = value,
            0x3400 => self.encoder_filter = value,
            0x4000 | 0x4100 => {
                let Some(pwm) = self.pwms.get_mut(unit) else {
                    return;
                };
                if area == 0x4000 {
                    pwm.value = value;
                } else {
                    pwm.mode = value;
                }
            }
            0x4200 => self.pwm_rate = value,
            0x4300 => self.pdm_rate = value,
            0x4400 => self.pwm_enable = value,
            _ => self.write_field(address, value),
        }
    }

    fn write_field(&mut self, address: u16, value: u32) {
        let area = address & 0xFF00;
        match area {
            0x5B00..=0x6000 => {
                let (register, channel) = (usize::from(area >> 8) - 0x5B, usize::from(address & 0x3F) / 4);
                if let Some(serial) = &mut self.serial {
                    serial.write(register, channel, value, self.now_ns);
                }
            }
            0x7D00 => self.field.relays = value,
            0x7E00 => self.field.relay_rate = value,
            0x7F00 => self.field.simple = value,
            0x8500..=0x8900 => {
                if let Some(filter) = &mut self.filter {
                    filter.write(usize::from(area >> 8) - 0x85, value);
                }
            }
            _ => {}
        }
    }

    /// Reads a word of the spaces that are 16 bits wide.
    fn read_word(&self, space: u8, address: u16) -> u16 {
        let index = usize::from(address) / 2;
        match space {
            // The EEPROM: MAC address, name, address of the board.
            2 => match address {
                0x02 => 0x0001,
                0x04 => 0x1B20,
                0x06 => 0x0060,
                0x10..0x20 => name_word(self.model.card_name(), index - 8),
                0x20 => 0x0179,
                0x22 => 0xC0A8,
                _ => 0xFFFF,
            },
            4 => match address {
                0x00 => (self.now_ns / 1000) as u16,
                0x10..0x20 => self.scratch[index - 8],
                _ => 0,
            },
            6 => self.counters.get(index).copied().unwrap_or(0),
            7 => match address {
                0x00..0x10 => name_word(self.model.card_name(), index),
                0x10 => 3,
                0x12 => 18,
                _ => 0,
            },
            _ => 0,
        }
    }
}

/// Two characters of a name, low byte first.
fn name_word(name: &str, index: usize) -> u16 {
    let byte = |i: usize| name.as_bytes().get(i).copied().unwrap_or(0);
    u16::from_le_bytes([byte(2 * index), byte(2 * index + 1)])
}

impl Memory for Board {
    fn read(&mut self, space: u8, address: u16, bytes: usize) -> u64 {
        match (space, bytes) {
            (0, 4) => u64::from(self.read_register(address & !3)),
            (0, _) => {
                let register = self.read_register(address & !3);
                u64::from(register) >> (8 * (address & 3))
            }
            (_, 1) => u64::from(self.read_word(space, address & !1)) >> (8 * (address & 1)),
            (_, 2) => u64::from(self.read_word(space, address)),
            _ => {
                self.refused();
                0
            }
        }
    }

    fn write(&mut self, space: u8, address: u16, bytes: usize, value: u64) {
        match (space, bytes) {
            (0, 4) => self.write_register(address & !3, value as u32),
            (4, 2) if (0x10..0x20).contains(&address) => {
                self.scratch[usize::from(address - 0x10) / 2] = value as u16;
            }
            (6, 2) if address < 0x20 => self.counters[usize::from(address) / 2] = value as u16,
            // Waiting times and the LEDs of the protocol.
            (4 | 6 | 7, 2) => {}
            _ => self.refused(),
        }
    }

    fn information(&mut self, space: u8, address: u16) -> u16 {
        const NAMES: [&str; 8] = [
            "HostMot2", "KSZ8851", "EtherEEP", "FPGAFlsh", "Timers", "", "LBP16RW", "LBP16RO",
        ];
        match address {
            0 => 0x5A00 | u16::from(space),
            2 => {
                if space == 0 {
                    4
                } else {
                    2
                }
            }
            4 => 16,
            6 => self.pointers[usize::from(space)],
            8..16 => name_word(NAMES[usize::from(space)], usize::from(address - 8) / 2),
            _ => 0,
        }
    }

    fn refused(&mut self) {
        self.traffic.refused += 1;
        self.counters[1] = self.counters[1].wrapping_add(1);
    }
}
