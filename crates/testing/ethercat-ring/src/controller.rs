//! The EtherCAT SubDevice controller: applies datagrams to registers, FMMUs, SyncManagers, SII and clock.

use crate::clock::Clock;
use crate::datagram::{Command, Datagram};
use crate::fmmu::{FMMU_BYTES, FMMUS, Fmmu, copy_bits};
use crate::registers::{Registers, address};
use crate::sii::{Contents, Sii};
use crate::sync_manager::{Access, Channel, SYNC_MANAGERS, SyncManager};

/// First address after the registers of the distributed clock.
const DC_END: u16 = 0x0A00;
/// Bits of DC activation: the cyclic unit, SYNC0.
const SYNC0_ACTIVE: u8 = 0b11;
/// Divider and time of the watchdog at power-up: 100 us, 100 ms.
const WATCHDOG_DEFAULTS: [(u16, u16); 2] =
    [(address::WATCHDOG_DIVIDER, 2498), (address::WATCHDOG_TIME, 1000)];

/// Times at which a frame passes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Passing {
    /// Time at the processing unit.
    pub(crate) now_ns: u64,
    /// Time of return from the devices after this one; `None` for the last device.
    pub(crate) return_ns: Option<u64>,
}

/// Actions of the MainDevice that the device must handle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Events {
    /// AL control was written.
    pub(crate) al_control: bool,
    /// Outputs have been written completely.
    pub(crate) outputs: bool,
}

/// One controller.
#[derive(Clone, Debug)]
pub(crate) struct Controller {
    pub(crate) registers: Registers,
    managers: [SyncManager; SYNC_MANAGERS as usize],
    sii: Sii,
    pub(crate) clock: Option<Clock>,
    pub(crate) events: Events,
    fed_ns: Option<u64>,
}

impl Controller {
    pub(crate) fn new(contents: &Contents, clock: Option<Clock>) -> Self {
        let mut registers = Registers::new();
        // Type of an ET1100, 8 FMMUs, 8 SyncManagers, 8 KiB, ports 0 and 1 with MII; a clock of 64 bits, or
        // 32.
        let features = clock.map_or(0, |clock| if clock.is_short { 0x04 } else { 0x0C });
        registers.set(
            address::TYPE,
            &[
                0x11,
                0,
                2,
                0,
                FMMUS as u8,
                SYNC_MANAGERS as u8,
                8,
                0x0F,
                features,
                0,
            ],
        );
        for (address, value) in WATCHDOG_DEFAULTS {
            registers.set(address, &value.to_le_bytes());
        }
        registers.set(address::WATCHDOG_STATUS, &[1, 0]);
        let sii = Sii::new(contents);
        sii.load(&mut registers);
        Self {
            registers,
            managers: [SyncManager::default(); SYNC_MANAGERS as usize],
            sii,
            clock,
            events: Events::default(),
            fed_ns: None,
        }
    }

    pub(crate) fn channel(&self, number: u16) -> Option<Channel> {
        Channel::decode(self.registers.slice(address::SYNC_MANAGER + 8 * number, 8))
    }

    pub(crate) const fn manager(&mut self, number: usize) -> &mut SyncManager {
        &mut self.managers[number]
    }

    /// Sets the links of ports 0 and 1; the loops of the other ports are closed.
    pub(crate) fn set_links(&mut self, has_next: bool) {
        // Bits: operational, links, and for each port "loop closed" (even bits) or "communication" (odd
        // bits).
        let mut status: u16 = 0b11 | 1 << 4 | 1 << 9 | 1 << 12 | 1 << 14;
        status |= if has_next { 1 << 5 | 1 << 11 } else { 1 << 10 };
        self.registers.set(address::DL_STATUS, &status.to_le_bytes());
    }

    /// Processes one datagram.
    pub(crate) fn process(&mut self, datagram: &mut Datagram<'_>, passing: Passing) {
        match datagram.command {
            Command::Nothing => {}
            Command::LogicalRead | Command::LogicalWrite | Command::LogicalReadWrite => {
                self.process_logical(datagram);
            }
            command => {
                let (addressed, reads, writes) = self.addressing(command, datagram);
                if addressed {
                    self.process_physical(datagram, reads, writes, passing);
                }
            }
        }
    }

    /// Decides whether the datagram is for this device, and which operations it needs. Increments positions.
    fn addressing(&self, command: Command, datagram: &mut Datagram<'_>) -> (bool, bool, bool) {
        let position = datagram.position();
        let (is_first, is_station) = (position == 0, self.is_station(position));
        if command.counts_position() {
            datagram.set_position(position.wrapping_add(1));
        }
        match command {
            Command::PositionRead => (is_first, true, false),
            Command::PositionWrite => (is_first, false, true),
            Command::PositionReadWrite => (is_first, true, true),
            Command::StationRead => (is_station, true, false),
            Command::StationWrite => (is_station, false, true),
            Command::StationReadWrite => (is_station, true, true),
            Command::BroadcastRead => (true, true, false),
            Command::BroadcastWrite => (true, false, true),
            Command::BroadcastReadWrite => (true, true, true),
            Command::PositionReadMultipleWrite => (true, is_first, !is_first),
            Command::StationReadMultipleWrite => (true, is_station, !is_station),
            Command::Nothing | Command::LogicalRead | Command::LogicalWrite | Command::LogicalReadWrite => {
                (false, false, false)
            }
        }
    }

    fn is_station(&self, station: u16) -> bool {
        let alias_counts = self.registers.u32(address::DL_CONTROL) >> 24 & 1 == 1;
        station == self.registers.u16(address::STATION_ADDRESS)
            || alias_counts && station == self.registers.u16(address::STATION_ALIAS)
    }

    fn process_physical(&mut self, datagram: &mut Datagram<'_>, reads: bool, writes: bool, passing: Passing) {
        let offset = datagram.offset();
        let written = datagram.data.to_vec();
        let mut value = vec![0; written.len()];
        if reads && self.read(offset, &mut value, passing.now_ns) {
            let ors = matches!(
                datagram.command,
                Command::BroadcastRead | Command::BroadcastReadWrite
            );
            for (target, byte) in datagram.data.iter_mut().zip(value) {
                *target = if ors { *target | byte } else { byte };
            }
            datagram.count(1);
        }
        if writes && self.write(offset, &written, passing) {
            datagram.count(if reads { 2 } else { 1 });
        }
    }

    fn process_logical(&mut self, datagram: &mut Datagram<'_>) {
        let (mut has_read, mut has_written) = (false, false);
        let written = datagram.data.to_vec();
        for number in 0..FMMUS {
            let registers = self
                .registers
                .slice(address::FMMU + number * FMMU_BYTES as u16, FMMU_BYTES);
            let Some(fmmu) = Fmmu::decode(registers) else {
                continue;
            };
            let Some(mapped) = fmmu.map(datagram.logical(), written.len()) else {
                continue;
            };
            let (first, count) = mapped.physical_bytes();
            let (Ok(first), count) = (u16::try_from(first), count as usize) else {
                continue;
            };
            let physical_bit = mapped.physical_bit - u64::from(first) * 8;
            if fmmu.writes && datagram.command != Command::LogicalRead && self.registers.holds(first, count) {
                let mut memory = self.registers.slice(first, count).to_vec();
                copy_bits(
                    &written,
                    mapped.datagram_bit,
                    &mut memory,
                    physical_bit,
                    mapped.bits,
                );
                has_written |= self.write_memory(first, &memory);
            }
            if fmmu.reads && datagram.command != Command::LogicalWrite {
                let mut memory = vec![0; count];
                if self.read(first, &mut memory, 0) {
                    copy_bits(
                        &memory,
                        physical_bit,
                        datagram.data,
                        mapped.datagram_bit,
                        mapped.bits,
                    );
                    has_read = true;
                }
            }
        }
        match datagram.command {
            Command::LogicalReadWrite => datagram.count(u16::from(has_read) + 2 * u16::from(has_written)),
            _ => datagram.count(u16::from(has_read || has_written)),
        }
    }

    /// Whether the SyncManagers permit the MainDevice to access these bytes.
    fn access(&mut self, begin: u16, length: usize, writes: bool) -> bool {
        for number in 0..SYNC_MANAGERS {
            let Some(channel) = self
                .channel(number)
                .filter(|channel| channel.overlaps(begin, length))
            else {
                continue;
            };
            match self.managers[usize::from(number)].access(&channel, begin, length, writes) {
                Access::Refused => return false,
                Access::Granted => {}
                Access::Completed => {
                    if writes && !channel.is_mailbox {
                        self.events.outputs = true;
                    }
                }
            }
        }
        true
    }

    fn has_registers(&self, begin: u16, length: usize) -> bool {
        let is_clock = (address::DC_RECEIVE_TIMES..DC_END).contains(&begin);
        self.registers.holds(begin, length) && (self.clock.is_some() || !is_clock)
    }

    fn read(&mut self, begin: u16, into: &mut [u8], now_ns: u64) -> bool {
        if !self.has_registers(begin, into.len()) || !self.access(begin, into.len(), false) {
            return false;
        }
        self.refresh(begin, into.len(), now_ns);
        self.registers.copy_to(begin, into);
        true
    }

    /// Updates registers that are computed when they are read.
    fn refresh(&mut self, begin: u16, length: usize, now_ns: u64) {
        let touches =
            |first: u16, last: u16| begin < last && usize::from(begin) + length > usize::from(first);
        if touches(address::SYNC_MANAGER, address::SYNC_MANAGER + 8 * SYNC_MANAGERS) {
            for (number, manager) in (0_u16..).zip(self.managers) {
                let registers = address::SYNC_MANAGER + 8 * number;
                let own = self.registers.u8(registers + 7) & 1 | u8::from(manager.repeat_acknowledged) << 1;
                self.registers.set(registers + 5, &[manager.status()]);
                self.registers.set(registers + 7, &[own]);
            }
        }
        if let (true, Some(clock)) = (
            touches(address::DC_SYSTEM_TIME, address::DC_SPEED_START),
            &self.clock,
        ) {
            self.registers.set(
                address::DC_SYSTEM_TIME,
                &clock.shown(clock.system(now_ns)).to_le_bytes(),
            );
            self.registers
                .set(address::DC_DIFFERENCE, &clock.difference().to_le_bytes());
        }
    }

    /// Writes process memory through an FMMU.
    fn write_memory(&mut self, begin: u16, data: &[u8]) -> bool {
        if !self.access(begin, data.len(), true) {
            return false;
        }
        self.registers.write(begin, data);
        true
    }

    fn write(&mut self, begin: u16, data: &[u8], passing: Passing) -> bool {
        if !self.has_registers(begin, data.len()) || !self.access(begin, data.len(), true) {
            return false;
        }
        let enabled = self.enabled_channels();
        self.registers.write(begin, data);
        let end = usize::from(begin) + data.len();
        let touches = |address: u16| begin <= address && usize::from(address) < end;
        self.events.al_control |= touches(address::AL_CONTROL);
        if begin < address::SII_DATA && end > usize::from(address::SII_CONTROL) {
            self.sii.after_write(&mut self.registers, begin, data.len());
        }
        for (number, (was, is)) in enabled.into_iter().zip(self.enabled_channels()).enumerate() {
            if was != is {
                self.managers[number] = SyncManager::default();
            }
        }
        self.after_clock_write(touches, passing);
        true
    }

    fn enabled_channels(&self) -> [bool; SYNC_MANAGERS as usize] {
        core::array::from_fn(|number| {
            self.registers.u8(address::SYNC_MANAGER + 8 * number as u16 + 6) & 1 == 1
        })
    }

    fn after_clock_write(&mut self, touches: impl Fn(u16) -> bool, passing: Passing) {
        let Some(clock) = &mut self.clock else { return };
        let (registers, now_ns) = (&mut self.registers, passing.now_ns);
        if touches(address::DC_RECEIVE_TIMES) {
            let received = clock.local(now_ns);
            let returned = passing.return_ns.map_or(0, |return_ns| clock.local(return_ns));
            registers.set(address::DC_RECEIVE_TIMES, &(received as u32).to_le_bytes());
            registers.set(address::DC_RECEIVE_TIMES + 4, &(returned as u32).to_le_bytes());
            registers.set(address::DC_RECEIVE_TIMES + 8, &[0; 8]);
            registers.set(address::DC_RECEIVE_TIME, &clock.shown(received).to_le_bytes());
        }
        if touches(address::DC_OFFSET) {
            clock.offset_ns = registers.u64(address::DC_OFFSET);
        }
        if touches(address::DC_DELAY) {
            clock.delay_ns = registers.u32(address::DC_DELAY);
        }
        if touches(address::DC_SYSTEM_TIME) {
            clock.compare(now_ns, registers.u32(address::DC_SYSTEM_TIME));
        }
        if touches(address::DC_SPEED_START) {
            clock.reset_loop(now_ns);
        }
        if touches(address::DC_ACTIVATION) {
            if registers.u8(address::DC_ACTIVATION) & SYNC0_ACTIVE == SYNC0_ACTIVE {
                let (start_ns, cycle_ns) = (
                    registers.u64(address::DC_START_TIME),
                    registers.u32(address::DC_SYNC0_CYCLE),
                );
                clock.start_sync(now_ns, start_ns, cycle_ns);
            } else {
                clock.stop_sync();
            }
        }
    }

    /// Whether SYNC0 is requested.
    pub(crate) fn wants_sync(&self) -> bool {
        self.clock.is_some() && self.registers.u8(address::DC_ACTIVATION) & SYNC0_ACTIVE == SYNC0_ACTIVE
    }

    /// Feeds the watchdog after outputs were received.
    pub(crate) fn feed_watchdog(&mut self, now_ns: u64) {
        self.fed_ns = Some(now_ns);
        self.registers.set(address::WATCHDOG_STATUS, &[1]);
    }

    /// Time from SYNC0 to the last outputs, ns by the device's clock; `None` without SYNC0.
    pub(crate) fn outputs_after_sync0_ns(&self) -> Option<u64> {
        self.clock.as_ref()?.after_sync_ns(self.fed_ns?)
    }

    /// Whether outputs were received since [`Controller::rest_watchdog`].
    pub(crate) const fn was_fed(&self) -> bool {
        self.fed_ns.is_some()
    }

    /// Forgets the outputs received.
    pub(crate) const fn rest_watchdog(&mut self) {
        self.fed_ns = None;
    }

    /// Whether the watchdog has just expired.
    pub(crate) fn watchdog_expires(&mut self, now_ns: u64) -> bool {
        let unit_ns = (u64::from(self.registers.u16(address::WATCHDOG_DIVIDER)) + 2) * 40;
        let time_ns = unit_ns * u64::from(self.registers.u16(address::WATCHDOG_TIME));
        let Some(fed_ns) = self.fed_ns else { return false };
        if time_ns == 0 || now_ns.saturating_sub(fed_ns) <= time_ns {
            return false;
        }
        self.fed_ns = None;
        let count = self.registers.u8(address::WATCHDOG_COUNTER).saturating_add(1);
        self.registers.set(address::WATCHDOG_STATUS, &[0]);
        self.registers.set(address::WATCHDOG_COUNTER, &[count]);
        true
    }
}
