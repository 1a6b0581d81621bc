//! A smart-serial module (SSLBP) with the field I/O of a 7I76, by Mesa's manuals of the cards.
//!
//! A command written to the command register is carried out and cleared. In setup mode the CS register of a
//! channel holds a command of the device's own protocol (LBP) above an address; in normal mode each DOIT
//! exchanges the process data that the device describes in its memory.

/// Channels of one module.
pub(crate) const CHANNELS: usize = 8;
/// Duration of one exchange, ns: both directions at 2.5 Mb/s and the device's own time.
const EXCHANGE_NS: u64 = 60_000;
/// Duration of a start, ns.
const START_NS: u64 = 400_000;
/// Time without an exchange after which the device switches its outputs off, ns.
const WATCHDOG_NS: u64 = 50_000_000;

const STOP: u16 = 0x08;
const START: u16 = 0x09;
const SETUP_START: u16 = 0x0F;
const DO_IT: u16 = 0x1000;
const REQUEST: u16 = 0x2000;
const WRITE: u16 = 0x8000;

/// CS register.
const NOT_READY: u32 = 0x8000;
const NO_REMOTE: u32 = 0x4000;
const TOO_MANY_ERRORS: u32 = 0x80;
const TIMEOUT_ERROR: u32 = 0x08;

/// Addresses of the tables in the device's memory.
const PROCESS_TABLE: u16 = 0x0200;
const GLOBAL_TABLE: u16 = 0x0240;
const RECORDS: u16 = 0x0300;

/// Mode of a channel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Mode {
    #[default]
    Stopped,
    Setup,
    Normal,
}

/// Registers of a channel: the host's writes and reads access two separate sets.
#[derive(Clone, Copy, Debug, Default)]
struct Channel {
    mode: Mode,
    written: [u32; 4],
    read: [u32; 4],
}

/// One element of process data.
struct Element {
    bits: u8,
    kind: u8,
    direction: u8,
    min: f32,
    max: f32,
    unit: &'static str,
    name: &'static str,
}

const INPUT: u8 = 0x00;
const OUTPUT: u8 = 0x80;

/// 32 inputs and 16 outputs in the field, and a spindle: its analog output, enable and direction.
const ELEMENTS: [Element; 6] = [
    Element {
        bits: 16,
        kind: 1,
        direction: OUTPUT,
        min: 0.0,
        max: 0.0,
        unit: "None",
        name: "Output",
    },
    Element {
        bits: 32,
        kind: 1,
        direction: INPUT,
        min: 0.0,
        max: 0.0,
        unit: "None",
        name: "Input",
    },
    Element {
        bits: 12,
        kind: 2,
        direction: OUTPUT,
        min: 0.0,
        max: 100.0,
        unit: "Percent",
        name: "SpinOut",
    },
    Element {
        bits: 1,
        kind: 7,
        direction: OUTPUT,
        min: 0.0,
        max: 0.0,
        unit: "None",
        name: "SpinDir",
    },
    Element {
        bits: 1,
        kind: 7,
        direction: OUTPUT,
        min: 0.0,
        max: 0.0,
        unit: "None",
        name: "SpinEna",
    },
    Element {
        bits: 2,
        kind: 0,
        direction: OUTPUT,
        min: 0.0,
        max: 0.0,
        unit: "None",
        name: "Pad",
    },
];

/// The device's memory: tables of pointers, and the records that they point to.
fn memory() -> Vec<u8> {
    let mut memory = vec![0; 0x0800];
    let mut next = RECORDS;
    let mut put = |table: u16, entry: &mut u16, record: &[u8]| {
        let offset = usize::from(table + 2 * *entry);
        memory[offset..offset + 2].copy_from_slice(&next.to_le_bytes());
        let at = usize::from(next);
        memory[at..at + record.len()].copy_from_slice(record);
        *entry += 1;
        next += record.len() as u16;
    };
    let mut entry = 0;
    for element in &ELEMENTS {
        let mut record = vec![0xA0, element.bits, element.kind, element.direction];
        record.extend(element.min.to_le_bytes());
        record.extend(element.max.to_le_bytes());
        record.extend([0, 0]);
        for text in [element.unit, element.name] {
            record.extend(text.bytes().chain([0]));
        }
        put(PROCESS_TABLE, &mut entry, &record);
    }
    for (mode, name) in [(0, "Standard"), (1, "IO_Only")] {
        let mut record = vec![0xB0, 0, mode, 0];
        record.extend(name.bytes().chain([0]));
        put(PROCESS_TABLE, &mut entry, &record);
    }
    let mut record = vec![0xA0, 8, 2, INPUT];
    record.extend([0; 8]);
    record.extend([0x10, 0]);
    record.extend(b"None\0SwRevision\0");
    put(GLOBAL_TABLE, &mut 0, &record);
    memory
}

/// The device of the first channel.
#[derive(Clone, Debug)]
struct Device {
    memory: Vec<u8>,
    inputs: u32,
    outputs: u16,
    spindle: u16,
    fed_ns: u64,
    /// Pairs of a wired output and input.
    wires: Vec<(u32, u32)>,
}

impl Device {
    /// Packs the process data of the field inputs.
    fn answer(&self) -> [u32; 3] {
        let inputs = self.wires.iter().fold(self.inputs, |inputs, (from, to)| {
            let on = u32::from(self.outputs >> from & 1);
            inputs & !(1 << to) | on << to
        });
        [inputs, 0, 0]
    }

    const fn take(&mut self, registers: [u32; 3], now_ns: u64) {
        (self.outputs, self.spindle) = (registers[0] as u16, (registers[0] >> 16) as u16);
        self.fed_ns = now_ns;
    }
}

/// A module of up to eight channels, with a device at the first.
#[derive(Clone, Debug)]
pub(crate) struct SmartSerial {
    command: u16,
    /// Time at which the present command is done.
    done_ns: u64,
    data: u8,
    channels: [Channel; CHANNELS],
    device: Device,
    /// The cable or the field supply is off.
    is_off: bool,
    exchanges: u64,
}

impl SmartSerial {
    pub(crate) fn new() -> Self {
        Self {
            command: 0,
            done_ns: 0,
            data: 0,
            channels: [Channel::default(); CHANNELS],
            device: Device {
                memory: memory(),
                inputs: 0,
                outputs: 0,
                spindle: 0,
                fed_ns: 0,
                wires: Vec::new(),
            },
            is_off: false,
            exchanges: 0,
        }
    }

    pub(crate) fn reset(&mut self) {
        let (device, is_off) = (self.device.clone(), self.is_off);
        *self = Self {
            device,
            is_off,
            ..Self::new()
        };
    }

    pub(crate) const fn set_off(&mut self, is_off: bool) {
        self.is_off = is_off;
    }

    pub(crate) const fn set_input(&mut self, bit: u32, on: bool) {
        self.device.inputs = self.device.inputs & !(1 << bit) | (on as u32) << bit;
    }

    pub(crate) fn wire(&mut self, from: u32, to: u32) {
        self.device.wires.push((from & 15, to & 31));
    }

    pub(crate) const fn output(&self, bit: u32) -> bool {
        self.device.outputs >> bit & 1 == 1
    }

    /// Fraction of the spindle's analog output, direction, enable.
    pub(crate) fn spindle(&self) -> (f64, bool, bool) {
        let raw = self.device.spindle;
        (
            f64::from(raw & 0xFFF) / 4095.0,
            raw >> 12 & 1 == 1,
            raw >> 13 & 1 == 1,
        )
    }

    pub(crate) const fn exchanges(&self) -> u64 {
        self.exchanges
    }

    /// Advances to `now_ns`.
    pub(crate) fn advance(&mut self, now_ns: u64) {
        if self.command != 0 && now_ns >= self.done_ns {
            self.finish(now_ns);
        }
        if now_ns.saturating_sub(self.device.fed_ns) > WATCHDOG_NS {
            (self.device.outputs, self.device.spindle) = (0, 0);
        }
    }

    /// Register 0 command, 1 data, 2 CS, 3 to 5 user registers; `index`: the channel.
    pub(crate) fn read(&self, register: usize, index: usize) -> u32 {
        match register {
            0 => u32::from(self.command),
            1 => u32::from(self.data),
            2..=5 => self
                .channels
                .get(index)
                .map_or(0, |channel| channel.read[register - 2]),
            _ => 0,
        }
    }

    pub(crate) fn write(&mut self, register: usize, index: usize, value: u32, now_ns: u64) {
        match register {
            0 if value >> 31 == 1 => {}
            0 => {
                let command = value as u16;
                let is_stop = command >> 8 == STOP;
                // Only a stop interrupts a command in progress.
                if self.command == 0 || is_stop {
                    self.command = command;
                    let time_ns = match command {
                        _ if is_stop => 0,
                        _ if command & DO_IT != 0 => EXCHANGE_NS,
                        _ if command & REQUEST != 0 => 0,
                        _ => START_NS,
                    };
                    self.done_ns = now_ns + time_ns;
                    if time_ns == 0 {
                        self.finish(now_ns);
                    }
                }
            }
            1 => self.data = value as u8,
            2..=5 => {
                if let Some(channel) = self.channels.get_mut(index) {
                    channel.written[register - 2] = value;
                }
            }
            _ => {}
        }
    }

    fn finish(&mut self, now_ns: u64) {
        let command = std::mem::take(&mut self.command);
        let mask = command as u8;
        if command & REQUEST != 0 {
            if command & WRITE == 0 {
                self.data = local(command & 0x7FF);
            }
        } else if command & DO_IT != 0 {
            self.exchange(mask, now_ns);
        } else {
            match command >> 8 {
                STOP => {
                    for (i, channel) in self.channels.iter_mut().enumerate() {
                        if mask >> i & 1 == 1 || mask == 0 {
                            (channel.mode, channel.read) = (Mode::Stopped, [0; 4]);
                        }
                    }
                    self.data = 0;
                }
                START => self.start(mask, Mode::Normal),
                SETUP_START => self.start(mask, Mode::Setup),
                _ => {}
            }
        }
    }

    fn start(&mut self, mask: u8, mode: Mode) {
        self.data = 0;
        for (i, channel) in self.channels.iter_mut().enumerate() {
            if mask >> i & 1 == 0 {
                continue;
            }
            if i != 0 || self.is_off {
                channel.read = [NOT_READY | NO_REMOTE, 0, 0, 0];
                self.data |= 1 << i;
                continue;
            }
            channel.mode = mode;
            let name = u32::from_le_bytes(*b"7I76");
            let tables = u32::from(GLOBAL_TABLE) << 16 | u32::from(PROCESS_TABLE);
            channel.read = [0, 0x1000_4711, name, tables];
        }
    }

    fn exchange(&mut self, mask: u8, now_ns: u64) {
        self.data = 0;
        for (i, channel) in self.channels.iter_mut().enumerate() {
            if mask >> i & 1 == 0 {
                continue;
            }
            if channel.mode == Mode::Stopped || self.is_off {
                if self.is_off {
                    channel.read[0] |= NOT_READY | TIMEOUT_ERROR | TOO_MANY_ERRORS;
                }
                self.data |= 1 << i;
                continue;
            }
            if channel.mode == Mode::Setup {
                let (order, address) = ((channel.written[0] >> 24) as u8, channel.written[0] as u16);
                match self.device.access(order, address, channel.written[1]) {
                    Some(value) => channel.read[1] = value,
                    None => self.data |= 1 << i,
                }
                continue;
            }
            self.exchanges += 1;
            let [_, out @ ..] = channel.written;
            self.device.take(out, now_ns);
            channel.read[0] &= 0xFFFF;
            channel.read[1..].copy_from_slice(&self.device.answer());
        }
    }
}

impl Device {
    /// LBP: 01, write, RPC, increment, address of two bytes, size.
    fn access(&mut self, order: u8, address: u16, value: u32) -> Option<u32> {
        let (is_command, has_address) = (order >> 6 == 1, order & 4 != 0);
        let size = 1_usize << (order & 3);
        let at = usize::from(address);
        if !is_command || !has_address || size > 4 || at + size > self.memory.len() {
            return None;
        }
        let bytes = &mut self.memory[at..at + size];
        if order & 0x20 != 0 {
            bytes.copy_from_slice(&value.to_le_bytes()[..size]);
            return Some(0);
        }
        let mut word = [0; 4];
        word[..size].copy_from_slice(bytes);
        Some(u32::from_le_bytes(word))
    }
}

/// Parameters of the module's own processor.
const fn local(address: u16) -> u8 {
    match address {
        // SSLBP, 8 bits wide, version 43.
        0 => 0x12,
        1 => 8,
        2 => 43,
        3 => 0,
        // Channels.
        9 => CHANNELS as u8,
        _ => 0,
    }
}
