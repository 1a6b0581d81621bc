//! Smart serial: devices connected to a board that describe their own inputs and outputs, such as the field
//! I/O of a 7I76E.
//!
//! The module's processor (SSLBP) executes one command at a time and clears the command register at its end.
//! In setup mode the bridge reads the process data descriptors from a device's memory. In normal mode each
//! DOIT exchanges the process data, up to 96 bits in each direction.

use core::time::Duration;
use std::time::Instant;

use thiserror::Error;

use crate::board_settings::RemoteSettings;
use crate::description::{Description, Module, tag};
use crate::link::{Link, LinkError};
use crate::packet::{Packet, PacketFull, Space};

/// Maximum number of devices of one board file.
pub(crate) const MAX_REMOTES: usize = 4;
/// Maximum number of modules of a board.
pub(crate) const MAX_SERIAL_PORTS: usize = 4;
/// 32-bit words of process data in each direction.
pub(crate) const WORDS: usize = 3;
/// Maximum number of records of a device, and of bytes of a name.
const MAX_RECORDS: u16 = 64;
const MAX_NAME: usize = 32;
/// Time limit for the discovery of all devices.
const PATIENCE: Duration = Duration::from_secs(5);
/// Time limit of one command.
const COMMAND: Duration = Duration::from_millis(500);

/// Registers of a module by number.
const COMMAND_REGISTER: u16 = 0;
const DATA_REGISTER: u16 = 1;
const CS: u16 = 2;
const USER: u16 = 3;
/// Commands.
const STOP: u32 = 0x0800;
const START: u32 = 0x0900;
const SETUP_START: u32 = 0x0F00;
const DO_IT: u32 = 0x1000;
/// Reads of a device's memory, in the top byte of the CS register.
const READ_WORD: u32 = 0x45;
const READ_LONG: u32 = 0x46;
/// Pins of a channel.
const TX: u8 = 0x81;
const TX_ENABLE: u8 = 0x91;

/// Why a smart-serial device cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum RemoteError {
    /// The board has no such module, or one of another kind.
    #[error(
        "the board file requires smart serial port {port}, but the firmware of this board has {ports}: \
         correct `port`"
    )]
    NoPort {
        /// Its number.
        port: usize,
        /// Number of ports of the board.
        ports: usize,
    },
    /// No device at the channel.
    #[error(
        "no device replies at channel {channel} of smart serial port {port}: check its cable and its supply \
         (a 7I76 needs its field supply too)"
    )]
    Absent {
        /// Port.
        port: usize,
        /// Channel.
        channel: usize,
    },
    /// A device with another name.
    #[error(
        "the device at channel {channel} of smart serial port {port} has the name {found}, the board file \
         has {wanted}: correct `name`, or connect the other device"
    )]
    Name {
        /// Port.
        port: usize,
        /// Channel.
        channel: usize,
        /// Its name.
        found: String,
        /// The name in the file.
        wanted: String,
    },
    /// A device with invalid descriptors.
    #[error("the device at channel {channel} of smart serial port {port} cannot be read: {what}")]
    Description {
        /// Port.
        port: usize,
        /// Channel.
        channel: usize,
        /// What is wrong.
        what: &'static str,
    },
    /// Data that the device does not have.
    #[error("{device} has no {what}; it has {there}")]
    Missing {
        /// The device.
        device: String,
        /// The data in the board file.
        what: String,
        /// The data of the device.
        there: String,
    },
    /// The board does not reply.
    #[error(transparent)]
    Link(#[from] LinkError),
}

impl From<PacketFull> for RemoteError {
    fn from(full: PacketFull) -> Self {
        Self::Link(full.into())
    }
}

/// Type of an element of process data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ElementKind {
    /// Packed bits.
    Bits,
    /// An integer.
    Number {
        /// Twos complement.
        signed: bool,
    },
    /// True if not zero.
    Boolean,
    /// Any other type: its bits are not used.
    Other,
}

/// One element of process data.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Element {
    pub(crate) name: String,
    pub(crate) kind: ElementKind,
    /// First bit, and number of bits.
    pub(crate) offset: usize,
    pub(crate) bits: usize,
    min: f64,
    max: f64,
}

impl Element {
    /// A value in engineering units.
    pub(crate) fn value(&self, words: &[u32; WORDS]) -> f64 {
        if self.bits == 0 {
            return self.min;
        }
        let raw = bits_of(words, self.offset, self.bits);
        let full = (2.0_f64.powi(self.bits as i32) - 1.0).max(1.0);
        match self.kind {
            ElementKind::Number { signed: true } => {
                let shift = 64 - self.bits.min(64);
                let signed = ((raw << shift) as i64 >> shift) as f64;
                signed / ((full - 1.0) / 2.0).max(1.0) * self.max
            }
            _ => raw as f64 * (self.max - self.min) / full + self.min,
        }
    }

    /// Sets a fraction of the range: 0 is the minimum of an unsigned number or the zero of a signed one, 1
    /// the maximum.
    pub(crate) fn put_fraction(&self, words: &mut [u32; WORDS], fraction: f64) {
        let full = 2.0_f64.powi(self.bits as i32) - 1.0;
        let raw = match self.kind {
            ElementKind::Number { signed: true } => {
                let half = (full - 1.0) / 2.0;
                (fraction.clamp(-1.0, 1.0) * half).round() as i64 as u64
            }
            _ => (fraction.clamp(0.0, 1.0) * full).round() as u64,
        };
        put_bits(words, self.offset, self.bits, raw);
    }
}

/// Bits of process data, at most 64.
fn bits_of(words: &[u32; WORDS], offset: usize, bits: usize) -> u64 {
    (0..bits.min(64)).fold(0, |value, i| {
        let at = offset + i;
        let bit = words.get(at / 32).map_or(0, |word| word >> (at % 32) & 1);
        value | u64::from(bit) << i
    })
}

fn put_bits(words: &mut [u32; WORDS], offset: usize, bits: usize, value: u64) {
    for i in 0..bits.min(64) {
        set_bit(words, offset + i, value >> i & 1 == 1);
    }
}

/// Sets one bit.
pub(crate) fn set_bit(words: &mut [u32; WORDS], at: usize, on: bool) {
    if let Some(word) = words.get_mut(at / 32) {
        *word = *word & !(1 << (at % 32)) | u32::from(on) << (at % 32);
    }
}

/// One bit.
pub(crate) fn bit_of(words: &[u32; WORDS], at: usize) -> bool {
    bits_of(words, at, 1) == 1
}

/// A device, according to its own descriptors.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Remote {
    pub(crate) port: usize,
    pub(crate) channel: usize,
    /// Name and serial number, as in `7I76 10004711`.
    pub(crate) name: String,
    pub(crate) inputs: Vec<Element>,
    pub(crate) outputs: Vec<Element>,
}

impl Remote {
    /// The bit of a field input or output by its number; packed bits are counted in order.
    pub(crate) fn field_bit(&self, is_output: bool, number: usize) -> Result<usize, RemoteError> {
        let elements = if is_output { &self.outputs } else { &self.inputs };
        let mut left = number;
        let mut count = 0;
        for element in elements
            .iter()
            .filter(|element| element.kind == ElementKind::Bits)
        {
            if left < element.bits {
                return Ok(element.offset + left);
            }
            left -= element.bits;
            count += element.bits;
        }
        let way = if is_output { "output" } else { "input" };
        Err(RemoteError::Missing {
            device: self.name.clone(),
            what: format!("field {way} {number}"),
            there: format!("{count}, from 0"),
        })
    }

    /// An element by its name, in any case.
    pub(crate) fn element(&self, is_output: bool, name: &str) -> Result<&Element, RemoteError> {
        let elements = if is_output { &self.outputs } else { &self.inputs };
        let found = elements
            .iter()
            .find(|element| element.name.eq_ignore_ascii_case(name));
        found.ok_or_else(|| RemoteError::Missing {
            device: self.name.clone(),
            what: format!("{} `{name}`", if is_output { "output" } else { "input" }),
            there: elements
                .iter()
                .map(|element| element.name.as_str())
                .collect::<Vec<_>>()
                .join(", "),
        })
    }
}

/// Values of the modules that the cycle reads.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SerialInputs {
    /// Pending command, and mask of failed channels.
    pub(crate) ports: [(u32, u32); MAX_SERIAL_PORTS],
    /// CS register of each device.
    pub(crate) status: [u32; MAX_REMOTES],
    pub(crate) words: [[u32; WORDS]; MAX_REMOTES],
}

/// Values that the cycle writes.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SerialOutputs {
    pub(crate) words: [[u32; WORDS]; MAX_REMOTES],
    /// Bit i: port i has completed its last command.
    pub(crate) is_free: u8,
}

/// The devices of one board file, discovered and started.
#[derive(Clone, Debug)]
pub(crate) struct SmartSerial {
    module: Module,
    pub(crate) remotes: Vec<Remote>,
    /// Mask of the channels in use, by port.
    masks: [u32; MAX_SERIAL_PORTS],
}

impl SmartSerial {
    /// Reads the descriptors of each device of a board file, and starts the devices. `None` if the file has
    /// no devices. Blocks for up to 5 s; not for use in the cycle.
    ///
    /// # Errors
    /// A device is missing, has another name, or has invalid descriptors.
    pub(crate) fn discover(
        link: &Link,
        board: &Description,
        settings: &[RemoteSettings],
    ) -> Result<Option<Self>, RemoteError> {
        let Some(first) = settings.first() else {
            return Ok(None);
        };
        let found = board.module(tag::SMART_SERIAL).copied();
        let ports = found.map_or(0, |module| module.instances.min(MAX_SERIAL_PORTS));
        let bad = settings.iter().find(|remote| remote.port >= ports);
        let usable = found.filter(|module| module.registers >= 6 && module.register_stride > 0);
        let (Some(module), None) = (usable, bad) else {
            let port = bad.unwrap_or(first).port;
            return Err(RemoteError::NoPort { port, ports });
        };
        let mut serial = Self {
            module,
            remotes: Vec::new(),
            masks: [0; MAX_SERIAL_PORTS],
        };
        for remote in settings {
            serial.masks[remote.port] |= 1 << remote.channel;
        }
        let deadline = Instant::now() + PATIENCE;
        for port in (0..ports).filter(|port| serial.masks[*port] != 0) {
            let setup = RemoteSetup {
                link,
                module,
                port,
                deadline,
            };
            setup.start(SETUP_START, settings)?;
            for remote in settings.iter().filter(|remote| remote.port == port) {
                serial.remotes.push(setup.describe(remote)?);
            }
            setup.start(START, settings)?;
        }
        // In the order of the file, because pins refer to this order.
        let place = |remote: &Remote| {
            settings
                .iter()
                .position(|listed| (listed.port, listed.channel) == (remote.port, remote.channel))
        };
        serial.remotes.sort_by_key(place);
        Ok(Some(serial))
    }

    /// Pins of the board for the channels in use.
    pub(crate) fn pins(&self, board: &Description) -> Vec<usize> {
        let codes = self
            .remotes
            .iter()
            .flat_map(|remote| [TX, TX_ENABLE].map(|code| (remote.port, code + remote.channel as u8)));
        codes
            .filter_map(|(port, code)| board.pin_of(tag::SMART_SERIAL, port, code))
            .collect()
    }

    fn used(&self) -> impl Iterator<Item = usize> + '_ {
        (0..MAX_SERIAL_PORTS).filter(|port| self.masks[*port] != 0)
    }

    pub(crate) fn read(&self, packet: &mut Packet) -> Result<(), PacketFull> {
        for port in self.used() {
            packet.read(Space::HostMot2, self.module.address(COMMAND_REGISTER, port), 1)?;
            packet.read(Space::HostMot2, self.module.address(DATA_REGISTER, port), 1)?;
        }
        for remote in &self.remotes {
            for register in CS..=CS + WORDS as u16 {
                let address = channel_address(&self.module, register, remote.port, remote.channel);
                packet.read(Space::HostMot2, address, 1)?;
            }
        }
        Ok(())
    }

    pub(crate) fn take_reply(&self, reply: &mut crate::packet::Reply<'_>, inputs: &mut SerialInputs) {
        for port in self.used() {
            inputs.ports[port] = (reply.value(), reply.value());
        }
        for i in 0..self.remotes.len() {
            inputs.status[i] = reply.value();
            inputs.words[i].fill_with(|| reply.value());
        }
    }

    pub(crate) fn write(&self, packet: &mut Packet, outputs: &SerialOutputs) -> Result<(), PacketFull> {
        for (remote, words) in self.remotes.iter().zip(&outputs.words) {
            for (register, word) in (USER..).zip(words) {
                let address = channel_address(&self.module, register, remote.port, remote.channel);
                packet.write(address, &[*word])?;
            }
        }
        for port in self.used().filter(|port| outputs.is_free >> port & 1 == 1) {
            let command = DO_IT | self.masks[port];
            packet.write(self.module.address(COMMAND_REGISTER, port), &[command])?;
        }
        Ok(())
    }

    /// Stops every device, which turns its outputs off.
    pub(crate) fn release(&self, packet: &mut Packet) -> Result<(), PacketFull> {
        for port in self.used() {
            packet.write(self.module.address(COMMAND_REGISTER, port), &[STOP | 0xFF])?;
        }
        Ok(())
    }

    /// Mask of the ports that have completed their command.
    pub(crate) fn free_ports(&self, inputs: &SerialInputs) -> u8 {
        self.used()
            .filter(|port| inputs.ports[*port].0 as u16 == 0)
            .fold(0, |mask, port| mask | 1 << port)
    }

    /// The failure of a device in its last exchange.
    pub(crate) fn failure(&self, remote: usize, inputs: &SerialInputs) -> Option<&'static str> {
        let device = self.remotes.get(remote)?;
        let (command, failed) = inputs.ports[device.port];
        let status = inputs.status[remote];
        // Byte 1: not ready, no device, communication error, remote fault; byte 0: sticky errors since the
        // start.
        if command as u16 != 0 {
            Some("the last exchange is not complete")
        } else if status & 0xE000 != 0 || failed >> device.channel & 1 == 1 {
            Some("no reply")
        } else if status & 0x0100 != 0 {
            Some("it reports a fault")
        } else {
            None
        }
    }
}

const fn channel_address(module: &Module, register: u16, port: usize, channel: usize) -> u16 {
    module.address(register, port).wrapping_add(4 * channel as u16)
}

/// A port during discovery.
struct RemoteSetup<'a> {
    link: &'a Link,
    module: Module,
    port: usize,
    deadline: Instant,
}

impl RemoteSetup<'_> {
    fn bad(&self, channel: usize, what: &'static str) -> RemoteError {
        RemoteError::Description {
            port: self.port,
            channel,
            what,
        }
    }

    /// Stops the port and starts its channels in use.
    fn start(&self, command: u32, settings: &[RemoteSettings]) -> Result<(), RemoteError> {
        let mut packet = Packet::new();
        packet.write(self.module.address(COMMAND_REGISTER, self.port), &[STOP | 0xFF])?;
        self.finish(&mut packet, 0)?;
        let mut mask = 0;
        packet.clear();
        for remote in settings.iter().filter(|remote| remote.port == self.port) {
            mask |= 1 << remote.channel;
            let address = channel_address(&self.module, CS, self.port, remote.channel);
            packet.write(address, &[u32::from(remote.mode) << 24])?;
        }
        packet.write(
            self.module.address(COMMAND_REGISTER, self.port),
            &[command | mask],
        )?;
        let failed = self.finish(&mut packet, 0)?;
        let absent = settings
            .iter()
            .find(|remote| remote.port == self.port && failed >> remote.channel & 1 == 1);
        absent.map_or(Ok(()), |remote| {
            Err(RemoteError::Absent {
                port: self.port,
                channel: remote.channel,
            })
        })
    }

    /// Sends a packet that ends with a command, and waits for its completion. Returns the mask of failed
    /// channels.
    fn finish(&self, packet: &mut Packet, channel: usize) -> Result<u32, RemoteError> {
        let until = Instant::now() + COMMAND;
        let command = self.module.address(COMMAND_REGISTER, self.port);
        // Read in the same packet, so a reply shows that the command was received.
        packet.read(Space::HostMot2, command, 1)?;
        packet.read(Space::HostMot2, self.module.address(DATA_REGISTER, self.port), 1)?;
        let mut poll = Packet::new();
        poll.read(Space::HostMot2, command, 1)?;
        poll.read(Space::HostMot2, self.module.address(DATA_REGISTER, self.port), 1)?;
        let (mut busy, mut failed) = (0, 0);
        self.link.request(packet, |mut reply| {
            (busy, failed) = (reply.value(), reply.value());
        })?;
        while busy as u16 != 0 {
            if Instant::now() > until.min(self.deadline) {
                return Err(self.bad(channel, "a command is not completed"));
            }
            std::thread::sleep(Duration::from_micros(100));
            self.link
                .request(&poll, |mut reply| (busy, failed) = (reply.value(), reply.value()))?;
        }
        Ok(failed)
    }

    /// Reads a value from the device's memory.
    fn memory(&self, channel: usize, order: u32, address: u16) -> Result<u32, RemoteError> {
        if Instant::now() > self.deadline {
            return Err(self.bad(channel, "discovery takes longer than 5 s"));
        }
        let mut packet = Packet::new();
        let cs = channel_address(&self.module, CS, self.port, channel);
        packet.write(cs, &[order << 24 | u32::from(address)])?;
        packet.write(
            self.module.address(COMMAND_REGISTER, self.port),
            &[DO_IT | 1 << channel],
        )?;
        let failed = self.finish(&mut packet, channel)?;
        if failed >> channel & 1 == 1 {
            return Err(self.bad(channel, "its memory cannot be read"));
        }
        self.user(channel, 0)
    }

    fn user(&self, channel: usize, number: u16) -> Result<u32, RemoteError> {
        let mut packet = Packet::new();
        let address = channel_address(&self.module, USER + number, self.port, channel);
        packet.read(Space::HostMot2, address, 1)?;
        let mut value = 0;
        self.link.request(&packet, |mut reply| value = reply.value())?;
        Ok(value)
    }

    fn describe(&self, settings: &RemoteSettings) -> Result<Remote, RemoteError> {
        let channel = settings.channel;
        let unit = self.user(channel, 0)?;
        let name = self.user(channel, 1)?.to_le_bytes();
        let found = String::from_utf8_lossy(&name)
            .trim_end_matches('\0')
            .escape_default()
            .to_string();
        if let Some(wanted) = settings.name.as_ref()
            && !wanted.eq_ignore_ascii_case(&found)
        {
            return Err(RemoteError::Name {
                port: self.port,
                channel,
                found,
                wanted: wanted.clone(),
            });
        }
        let mut remote = Remote {
            port: self.port,
            channel,
            name: format!("{found} {unit:08X}"),
            inputs: Vec::new(),
            outputs: Vec::new(),
        };
        let table = self.user(channel, 2)? as u16;
        if table == 0 {
            return Err(self.bad(channel, "it has no process data descriptors"));
        }
        let mut addresses = Vec::new();
        for entry in 0..=MAX_RECORDS {
            match self.memory(channel, READ_WORD, table.wrapping_add(2 * entry))? as u16 {
                0 => break,
                _ if entry == MAX_RECORDS => return Err(self.bad(channel, "it has more than 64 records")),
                address => addresses.push(address),
            }
        }
        for address in addresses {
            self.record(channel, address, &mut remote)?;
        }
        Ok(remote)
    }

    /// One record: type and range, then unit and name.
    fn record(&self, channel: usize, address: u16, remote: &mut Remote) -> Result<(), RemoteError> {
        let [record, bits, kind, direction] = self.memory(channel, READ_LONG, address)?.to_le_bytes();
        match record {
            0xA0 => {}
            // Modes.
            0xB0 => return Ok(()),
            _ => return Err(self.bad(channel, "a record has an unknown type")),
        }
        let number = |offset| {
            let raw = self.memory(channel, READ_LONG, address.wrapping_add(offset))?;
            let value = f64::from(f32::from_bits(raw));
            Ok::<_, RemoteError>(if value.is_finite() { value } else { 0.0 })
        };
        let (min, max) = (number(4)?, number(8)?);
        let mut at = address.wrapping_add(14);
        let _unit = self.text(channel, &mut at)?;
        let name = self.text(channel, &mut at)?;
        let kind = match kind {
            1 => ElementKind::Bits,
            2 | 4 => ElementKind::Number { signed: false },
            3 | 5 => ElementKind::Number { signed: true },
            7 => ElementKind::Boolean,
            _ => ElementKind::Other,
        };
        let lists: &mut [&mut Vec<Element>] = match direction {
            0x00 => &mut [&mut remote.inputs],
            0x40 => &mut [&mut remote.inputs, &mut remote.outputs],
            0x80 => &mut [&mut remote.outputs],
            _ => return Err(self.bad(channel, "a record has an unknown direction")),
        };
        for list in lists {
            let offset = list.last().map_or(0, |last: &Element| last.offset + last.bits);
            if offset + usize::from(bits) > 32 * WORDS {
                return Err(self.bad(channel, "its process data are more than 96 bits"));
            }
            list.push(Element {
                name: name.clone(),
                kind,
                offset,
                bits: usize::from(bits),
                min,
                max,
            });
        }
        Ok(())
    }

    /// A string that ends with zero; moves `at` after its end.
    fn text(&self, channel: usize, at: &mut u16) -> Result<String, RemoteError> {
        let mut bytes = Vec::new();
        while bytes.len() <= MAX_NAME {
            let four = self.memory(channel, READ_LONG, *at)?.to_le_bytes();
            for byte in four {
                *at = at.wrapping_add(1);
                if byte == 0 {
                    return Ok(String::from_utf8_lossy(&bytes).escape_default().to_string());
                }
                bytes.push(byte);
            }
        }
        Err(self.bad(channel, "a name is longer than 32 bytes"))
    }
}
