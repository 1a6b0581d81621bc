//! One SubDevice: controller, AL state machine, mailbox, process data, and drive or terminal.

use std::collections::VecDeque;

use crate::application_layer::{AlState, ApplicationLayer, Check, status_code};
use crate::clock::Clock;
use crate::coe::{Reply, Server, abort, abort_message};
use crate::controller::{Controller, Passing};
use crate::datagram::Datagram;
use crate::device_objects::device_objects;
use crate::drive::{Drive, STEP_NS};
use crate::drive_settings::DriveSettings;
use crate::mailbox::{COE, MailboxError, Message, encode, encode_error};
use crate::object::Dictionary;
use crate::process_data::{INPUTS, OUTPUTS, ProcessMap};
use crate::registers::address;
use crate::sii::{Contents, Identity, SiiPdo, SiiSyncManager};
use crate::terminal::{Terminal, TerminalKind};

/// Vendor ID of all simulated devices; no real vendor has it.
pub const SIMULATED_VENDOR: u32 = 0x4556_534D;
/// Product code of the drive.
pub const DRIVE_PRODUCT: u32 = 0x0000_0402;
/// Delay up to which a late wake-up catches up, ns.
const CATCH_UP_NS: u64 = 200_000_000;
/// Bytes of each mailbox.
const MAILBOX: u16 = 128;
/// Reply time of a slow mailbox, ns.
const SLOW_NS: u64 = 300_000_000;
/// Supported periods of SYNC0, ns.
const SYNC_CYCLES: core::ops::RangeInclusive<u64> = 125_000..=100_000_000;
/// Function of a device.
#[derive(Clone, Debug)]
pub enum Device {
    /// A drive with its motor.
    Drive(Box<Drive>),
    /// A terminal.
    Terminal(Terminal),
}

/// SyncManagers of the process data, and their addresses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Layout {
    has_mailbox: bool,
    /// SyncManager and first address.
    outputs: Option<(u16, u16)>,
    inputs: Option<(u16, u16)>,
}

/// Simulated faults of a device, except those of its drive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Trouble {
    pub(crate) ignores_logical: bool,
    pub(crate) ignores_reference: bool,
    pub(crate) aborts_sdo: bool,
    pub(crate) answers_wrong: bool,
    pub(crate) slow_mailbox: bool,
    pub(crate) sends_emergencies: bool,
    pub(crate) refuses_safe_op: bool,
    pub(crate) refuses_op: bool,
}

/// Service 1 of CoE (ETG.1000.6, 5.6.4): error code 7121h, motor blocked; the error register's general bit,
/// no data.
const EMERGENCY: [u8; 10] = [0x00, 0x10, 0x21, 0x71, 0x01, 0, 0, 0, 0, 0];

/// One device of the ring.
#[derive(Clone, Debug)]
pub struct SubDevice {
    contents: Contents,
    layout: Layout,
    drift_ppm: Option<f64>,
    has_short_clock: bool,
    controller: Controller,
    layer: ApplicationLayer,
    objects: Dictionary,
    server: Server,
    replies: VecDeque<(u64, Vec<u8>)>,
    last_reply: Vec<u8>,
    last_counter: u8,
    reply_counter: u8,
    outputs: ProcessMap,
    inputs: ProcessMap,
    next_step_ns: u64,
    device: Device,
    pub(crate) trouble: Trouble,
}

impl SubDevice {
    /// Creates a drive. Its clock drifts by `drift_ppm`.
    #[must_use]
    pub fn drive(settings: DriveSettings, serial: u32, drift_ppm: f64) -> Self {
        let device = Device::Drive(Box::new(Drive::new(settings)));
        Self::new(
            device,
            (DRIVE_PRODUCT, "SIM-DRIVE", "CiA 402 servo drive (test simulator)"),
            serial,
            Some(drift_ppm),
        )
    }

    /// A terminal.
    #[must_use]
    pub fn terminal(kind: TerminalKind, serial: u32) -> Self {
        let drift_ppm = matches!(kind, TerminalKind::Coupler).then_some(0.0);
        Self::new(
            Device::Terminal(Terminal::new(kind)),
            Terminal::product(kind),
            serial,
            drift_ppm,
        )
    }

    /// Sets the drift of the distributed clock, ppm; no effect on a device without a clock. The first clock
    /// of a ring is the reference.
    #[must_use]
    pub fn with_drift_ppm(mut self, drift_ppm: f64) -> Self {
        self.drift_ppm = self.drift_ppm.map(|_| drift_ppm);
        self
    }

    /// Limits the registers of the clock to 32 bits, as in many controllers.
    #[must_use]
    pub const fn with_clock_of_32_bits(mut self) -> Self {
        self.has_short_clock = true;
        self
    }

    fn new(
        device: Device,
        (product, order, name): (u32, &'static str, &'static str),
        serial: u32,
        drift_ppm: Option<f64>,
    ) -> Self {
        let identity = Identity {
            vendor: SIMULATED_VENDOR,
            product,
            revision: 0x0001_0000,
            serial,
        };
        let (objects, pdos, has_mailbox) = device_objects(&device, identity, name);
        let has = |inputs: bool| pdos.iter().any(|pdo| pdo.is_input == inputs);
        let layout = match (has_mailbox, has(false), has(true)) {
            (true, ..) => Layout {
                has_mailbox,
                outputs: Some((2, 0x1200)),
                inputs: Some((3, 0x1400)),
            },
            (false, outputs, inputs) => Layout {
                has_mailbox,
                outputs: outputs.then_some((0, 0x0F00)),
                inputs: inputs.then_some((0, 0x1000)),
            },
        };
        let pdos = pdos
            .into_iter()
            .map(|mut pdo| {
                let area = if pdo.is_input {
                    layout.inputs
                } else {
                    layout.outputs
                };
                pdo.sync_manager = area.map_or(0xFF, |(manager, _)| manager as u8);
                pdo
            })
            .collect();
        let contents = contents(
            &layout,
            &objects,
            identity,
            (order, name),
            pdos,
            drift_ppm.is_some(),
        );
        let controller = Controller::new(&contents, drift_ppm.map(|drift_ppm| Clock::new(0, drift_ppm)));
        Self {
            contents,
            layout,
            drift_ppm,
            has_short_clock: false,
            controller,
            layer: ApplicationLayer::new(),
            objects,
            server: Server::new(usize::from(MAILBOX)),
            replies: VecDeque::new(),
            last_reply: Vec::new(),
            last_counter: 0,
            reply_counter: 0,
            outputs: ProcessMap::default(),
            inputs: ProcessMap::default(),
            next_step_ns: 0,
            device,
            trouble: Trouble::default(),
        }
    }

    /// Switches the supply on, at a time of the simulator.
    pub(crate) fn power_up(&mut self, now_ns: u64) {
        if let Device::Drive(drive) = &mut self.device {
            drive.restart();
        }
        let identity = self.contents.identity;
        (self.objects, _, _) = device_objects(&self.device, identity, self.contents.name);
        self.controller = Controller::new(
            &self.contents,
            self.drift_ppm.map(|drift_ppm| {
                let mut clock = Clock::new(now_ns, drift_ppm);
                clock.is_short = self.has_short_clock;
                clock
            }),
        );
        self.layer = ApplicationLayer::new();
        self.server = Server::new(usize::from(MAILBOX));
        self.replies.clear();
        self.last_counter = 0;
        (self.outputs, self.inputs) = (ProcessMap::default(), ProcessMap::default());
        self.next_step_ns = now_ns;
    }

    /// Identity, as in the SII and object 1018h.
    #[must_use]
    pub const fn identity(&self) -> Identity {
        self.contents.identity
    }

    /// The AL state.
    #[must_use]
    pub const fn state(&self) -> AlState {
        self.layer.state()
    }

    /// AL status code of the last refusal; 0 for none.
    #[must_use]
    pub const fn status_code(&self) -> u16 {
        self.layer.code()
    }

    /// The drive, if the device is one.
    #[must_use]
    pub fn as_drive(&self) -> Option<&Drive> {
        match &self.device {
            Device::Drive(drive) => Some(drive),
            Device::Terminal(_) => None,
        }
    }

    /// The drive, mutable, if the device is one.
    pub fn as_drive_mut(&mut self) -> Option<&mut Drive> {
        match &mut self.device {
            Device::Drive(drive) => Some(drive),
            Device::Terminal(_) => None,
        }
    }

    /// The terminal, where it is one.
    #[must_use]
    pub const fn as_terminal(&self) -> Option<&Terminal> {
        match &self.device {
            Device::Terminal(terminal) => Some(terminal),
            Device::Drive(_) => None,
        }
    }

    /// The terminal, mutable, if the device is one.
    pub const fn as_terminal_mut(&mut self) -> Option<&mut Terminal> {
        match &mut self.device {
            Device::Terminal(terminal) => Some(terminal),
            Device::Drive(_) => None,
        }
    }

    /// Its object dictionary.
    #[must_use]
    pub const fn objects(&self) -> &Dictionary {
        &self.objects
    }

    /// The device's copy of the system time, if it has a clock.
    #[must_use]
    pub fn system_time_ns(&self, now_ns: u64) -> Option<u64> {
        Some(self.controller.clock.as_ref()?.system(now_ns))
    }

    /// Time from SYNC0 to the last outputs, ns by the device's clock; `None` without SYNC0 or outputs.
    #[must_use]
    pub fn outputs_after_sync0_ns(&self) -> Option<u64> {
        self.controller.outputs_after_sync0_ns()
    }

    pub(crate) fn set_links(&mut self, has_next: bool) {
        self.controller.set_links(has_next);
    }

    pub(crate) fn process(&mut self, datagram: &mut Datagram<'_>, passing: Passing) {
        if self.trouble.ignores_logical && datagram.is_logical() {
            return;
        }
        if let Some(clock) = &mut self.controller.clock {
            clock.ignores_reference = self.trouble.ignores_reference;
        }
        self.controller.process(datagram, passing);
    }

    /// Advances the time, up to the arrival of a frame or without one.
    pub(crate) fn advance(&mut self, now_ns: u64) {
        if self.next_step_ns.saturating_add(CATCH_UP_NS) < now_ns {
            self.next_step_ns = now_ns;
        }
        while let Some(at_ns) = self
            .controller
            .clock
            .as_mut()
            .and_then(|clock| clock.take_sync(now_ns))
        {
            self.step_until(at_ns);
            self.take_outputs();
            self.give_inputs();
        }
        self.step_until(now_ns);
        if !self.controller.wants_sync() {
            self.give_inputs();
        }
        self.handle_mailbox(now_ns);
    }

    fn step_until(&mut self, until_ns: u64) {
        let operational = self.layer.state() == AlState::Op;
        while self.next_step_ns <= until_ns {
            self.next_step_ns += STEP_NS;
            if let Device::Drive(drive) = &mut self.device {
                drive.step(&self.objects, operational);
            }
        }
    }

    fn take_outputs(&mut self) {
        let operational = self.layer.state() == AlState::Op;
        if let (true, Some((_, start))) = (operational, self.layout.outputs) {
            self.outputs.take(
                self.controller.registers.slice(start, self.outputs.bytes()),
                &mut self.objects,
            );
        }
        match &mut self.device {
            Device::Drive(drive) if operational => {
                let cycle_ns = self
                    .controller
                    .clock
                    .as_ref()
                    .filter(|clock| clock.has_sync())
                    .map(Clock::sync_cycle_ns);
                drive.take_outputs(&self.objects, cycle_ns);
            }
            Device::Drive(drive) => drive.forget_orders(),
            Device::Terminal(terminal) => terminal.take_outputs(&self.objects, operational),
        }
    }

    fn give_inputs(&mut self) {
        match &self.device {
            Device::Drive(drive) => drive.give_inputs(&mut self.objects),
            Device::Terminal(terminal) => terminal.give_inputs(&mut self.objects),
        }
        if let (true, Some((_, start))) = (self.layer.state() >= AlState::SafeOp, self.layout.inputs) {
            let mut memory = vec![0; self.inputs.bytes()];
            self.inputs.put(&self.objects, &mut memory);
            self.controller.registers.set(start, &memory);
        }
    }

    /// Handles the changes that a frame has made.
    pub(crate) fn settle(&mut self, now_ns: u64) {
        let events = core::mem::take(&mut self.controller.events);
        if events.outputs {
            self.controller.feed_watchdog(now_ns);
        }
        if events.al_control || self.layer.is_waiting() {
            self.change_state(now_ns);
        }
        if events.outputs && !self.controller.wants_sync() {
            self.take_outputs();
        }
        if self.controller.watchdog_expires(now_ns) && self.layer.state() == AlState::Op {
            self.layer.fall_to(AlState::SafeOp, status_code::WATCHDOG);
            self.take_outputs();
        }
        self.handle_mailbox(now_ns);
        let status = self.layer.status().to_le_bytes();
        self.controller.registers.set(address::AL_STATUS, &status);
        self.controller
            .registers
            .set(address::AL_STATUS_CODE, &self.layer.code().to_le_bytes());
    }

    fn change_state(&mut self, now_ns: u64) {
        let before = self.layer.state();
        let control = self.controller.registers.u16(address::AL_CONTROL);
        let mut layer = self.layer;
        layer.request(control, now_ns, |state| self.check(state));
        self.layer = layer;
        let after = self.layer.state();
        if after == AlState::SafeOp && before < after {
            self.controller.rest_watchdog();
        }
        if after < AlState::PreOp {
            self.replies.clear();
            self.last_counter = 0;
        }
        if before < AlState::PreOp && after == AlState::PreOp && self.trouble.sends_emergencies {
            self.send_emergency(now_ns);
        }
        if before == AlState::Op && after != before {
            self.take_outputs();
        }
    }

    fn check(&mut self, state: AlState) -> Check {
        match state {
            AlState::SafeOp if self.trouble.refuses_safe_op => Check::Wrong(status_code::INPUT_MAPPING),
            AlState::Op if self.trouble.refuses_op => Check::Wrong(status_code::SYNC_CYCLE_TIME),
            AlState::Init => Check::Fine,
            AlState::PreOp => {
                let fits = |number: u16, start: u16, written: bool| {
                    self.controller.channel(number).is_some_and(|channel| {
                        channel.is_enabled
                            && channel.is_mailbox
                            && (channel.start, channel.length) == (start, MAILBOX)
                            && channel.is_written_by_main == written
                    })
                };
                if self.layout.has_mailbox && !(fits(0, 0x1000, true) && fits(1, 0x1080, false)) {
                    return Check::Wrong(status_code::MAILBOX_CONFIGURATION);
                }
                Check::Fine
            }
            AlState::SafeOp => {
                self.outputs = ProcessMap::of(&self.objects, OUTPUTS);
                self.inputs = ProcessMap::of(&self.objects, INPUTS);
                if !self.fits(self.layout.outputs, self.outputs.bytes(), true) {
                    return Check::Wrong(status_code::OUTPUT_CONFIGURATION);
                }
                if !self.fits(self.layout.inputs, self.inputs.bytes(), false) {
                    return Check::Wrong(status_code::INPUT_CONFIGURATION);
                }
                let cycle_ns = u64::from(self.controller.registers.u32(address::DC_SYNC0_CYCLE));
                if self.controller.wants_sync() && !SYNC_CYCLES.contains(&cycle_ns) {
                    return Check::Wrong(status_code::SYNC_CYCLE);
                }
                Check::Fine
            }
            AlState::Op => {
                let has_sync = self.controller.clock.as_ref().is_some_and(Clock::has_sync);
                if self.controller.wants_sync() && !has_sync {
                    return Check::Wrong(status_code::NO_SYNC);
                }
                let awaits_sync = self.controller.wants_sync()
                    && !self.controller.clock.as_ref().is_some_and(Clock::has_pulsed);
                if awaits_sync || self.outputs.bytes() > 0 && !self.controller.was_fed() {
                    return Check::Wait;
                }
                Check::Fine
            }
        }
    }

    /// Whether the SyncManager of process data is configured for `bytes` bytes.
    fn fits(&self, area: Option<(u16, u16)>, bytes: usize, written: bool) -> bool {
        let Some((number, start)) = area else {
            return bytes == 0;
        };
        let Some(channel) = self.controller.channel(number) else {
            return false;
        };
        if bytes == 0 {
            return !channel.is_enabled || channel.length == 0;
        }
        channel.is_enabled
            && !channel.is_mailbox
            && channel.start == start
            && usize::from(channel.length) == bytes
            && channel.is_written_by_main == written
    }

    fn handle_mailbox(&mut self, now_ns: u64) {
        if !self.layout.has_mailbox || self.layer.state() < AlState::PreOp {
            return;
        }
        if let (true, Some(channel)) = (self.controller.manager(0).is_full, self.controller.channel(0)) {
            let mailbox = self
                .controller
                .registers
                .slice(channel.start, usize::from(channel.length))
                .to_vec();
            self.controller.manager(0).is_full = false;
            self.take_message(&mailbox, now_ns);
        }
        let Some(channel) = self.controller.channel(1).filter(|channel| channel.is_enabled) else {
            return;
        };
        let manager = self.controller.manager(1);
        let mut sent = None;
        if channel.repeat_request != manager.repeat_acknowledged {
            // The last reply was lost: it is sent again.
            manager.repeat_acknowledged = channel.repeat_request;
            sent = Some(self.last_reply.clone()).filter(|reply| !reply.is_empty());
        } else if !manager.is_full && self.replies.front().is_some_and(|(due_ns, _)| *due_ns <= now_ns) {
            sent = self.replies.pop_front().map(|(_, reply)| reply);
        }
        if let Some(reply) = sent {
            self.controller.manager(1).is_full = true;
            self.controller.registers.set(channel.start, &reply);
            self.last_reply = reply;
        }
    }

    fn take_message(&mut self, mailbox: &[u8], now_ns: u64) {
        let due_ns = now_ns + if self.trouble.slow_mailbox { SLOW_NS } else { 0 };
        let message = match Message::decode(mailbox) {
            Ok(message) => message,
            Err(error) => return self.reply_error(error, due_ns),
        };
        if message.counter != 0 && message.counter == self.last_counter {
            // A repetition, because the acknowledgement of the first was lost.
            return;
        }
        self.last_counter = message.counter;
        if message.kind != COE {
            return self.reply_error(MailboxError::Protocol, due_ns);
        }
        let configurable = self.layer.state() == AlState::PreOp;
        let index = message
            .data
            .get(3..5)
            .map_or(0, |bytes| u16::from_le_bytes([bytes[0], bytes[1]]));
        let reply = if self.trouble.aborts_sdo {
            Reply::Messages(vec![abort_message(index, 0, abort::GENERAL)])
        } else {
            self.server.handle(message.data, &mut self.objects, configurable)
        };
        let Reply::Messages(messages) = reply else { return };
        if self.trouble.sends_emergencies {
            self.send_emergency(due_ns);
        }
        for mut data in messages {
            if let (true, Some(low)) = (self.trouble.answers_wrong, data.get_mut(3)) {
                *low ^= 0x55;
            }
            let counter = self.next_counter();
            self.replies
                .push_back((due_ns, encode(COE, counter, &data, usize::from(MAILBOX))));
        }
    }

    fn send_emergency(&mut self, due_ns: u64) {
        let counter = self.next_counter();
        self.replies
            .push_back((due_ns, encode(COE, counter, &EMERGENCY, usize::from(MAILBOX))));
    }

    fn reply_error(&mut self, error: MailboxError, due_ns: u64) {
        let counter = self.next_counter();
        self.replies
            .push_back((due_ns, encode_error(error, counter, usize::from(MAILBOX))));
    }

    const fn next_counter(&mut self) -> u8 {
        self.reply_counter = self.reply_counter % 7 + 1;
        self.reply_counter
    }
}

fn contents(
    layout: &Layout,
    objects: &Dictionary,
    identity: Identity,
    (order, name): (&'static str, &'static str),
    pdos: Vec<SiiPdo>,
    has_clock: bool,
) -> Contents {
    let manager = |area: Option<(u16, u16)>, assignment: u16, control: u8, usage: u8| {
        let length = ProcessMap::of(objects, assignment).bytes() as u16;
        area.map(|(_, start)| SiiSyncManager {
            start,
            length,
            control,
            enable: u8::from(length > 0),
            usage,
        })
    };
    let mut sync_managers = Vec::new();
    if layout.has_mailbox {
        sync_managers.push(SiiSyncManager {
            start: 0x1000,
            length: MAILBOX,
            control: 0x26,
            enable: 1,
            usage: 1,
        });
        sync_managers.push(SiiSyncManager {
            start: 0x1080,
            length: MAILBOX,
            control: 0x22,
            enable: 1,
            usage: 2,
        });
    }
    // Outputs feed the watchdog.
    sync_managers.extend(manager(layout.outputs, OUTPUTS, 0x64, 3));
    sync_managers.extend(manager(layout.inputs, INPUTS, 0x20, 4));
    let fmmus = match (layout.outputs, layout.inputs) {
        (None, None) => Vec::new(),
        (None, Some(_)) => vec![2],
        (Some(_), None) => vec![1],
        (Some(_), Some(_)) => vec![1, 2],
    };
    Contents {
        identity,
        alias: 0,
        order,
        name,
        mailbox: layout.has_mailbox.then_some([0x1000, MAILBOX, 0x1080, MAILBOX]),
        fmmus,
        sync_managers,
        pdos,
        has_clock,
    }
}
