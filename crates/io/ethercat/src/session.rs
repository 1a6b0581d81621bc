//! One session with the network: from INIT to OP, the cycle, and why it ended.

use core::sync::atomic::{AtomicU64, Ordering};
use core::time::Duration;

use ethercrab::error::{Error, MailboxError};
use ethercrab::subdevice_group::{DcConfiguration, HasDc, NoDc, Op};
use ethercrab::{
    AlStatusCode, Command, DcSync, DefaultLock, MainDevice, MainDeviceConfig, PduStorage, RegisterAddress,
    SubDeviceGroup, SubDeviceRef, SubDeviceState, Timeouts,
};
use evolvent_bridge::{BusEnds, Incoming, monotonic_ns};
use evolvent_drive::{InterpolationError, InterpolationTime, SettingsError};
use evolvent_machine::Machine;
use rustix::thread::clock_nanosleep_absolute;
use rustix::time::{ClockId, Timespec};
use thiserror::Error;

use crate::cycle_times::{CycleTime, CycleTimes};
use crate::drive_set::DriveSet;
use crate::dump::DumpSender;
use crate::homing::HomingProgress;
use crate::network::{MAX_DEVICES, Network, NetworkAxis, NetworkDevice, Startup};
use crate::pdo::{Mapped, PdoError, PdoLayout, wanted_inputs, wanted_outputs};
use crate::pump::Pump;
use crate::signal::NetworkInput;
use crate::signal_set::SignalSet;
use crate::socket::PacketSocket;
use crate::time_driver::thread_ns;

/// Maximum number of frames under way, and the data of each.
const FRAMES: usize = 16;
const FRAME_DATA: usize = PduStorage::element_size(1100);
/// Bytes of process data of all devices.
const IMAGE: usize = 1024;
/// Maximum time for the network to come up, ns.
const START_NS: u64 = 60_000_000_000;
/// Maximum time for devices from SAFE-OP to OP, ns.
const OPERATIONAL_NS: u64 = 10_000_000_000;
/// Maximum time for drives to stop at the end of the session, ns.
const STOP_NS: u64 = 1_500_000_000;
/// Delay of the first SYNC0 after its request.
const SYNC_DELAY: Duration = Duration::from_millis(200);
/// Number of times that the reference time is distributed before clocks are used.
const CLOCK_WARM_UP: u32 = 2_000;
/// The phase error is reduced by one part in this number per cycle.
const PHASE_GAIN: i64 = 16;
/// First station address assigned by the MainDevice.
const FIRST_STATION: u16 = 0x1000;

type Group<S> = SubDeviceGroup<MAX_DEVICES, IMAGE, DefaultLock, Op, S>;

/// Why a session did not start, or why it ended.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum SessionError {
    /// Nobody answers.
    #[error("no device replies: check cable, interface and supply")]
    NoDevices,
    /// The number of devices differs from the file.
    #[error("{found} devices are on the wire, the network file lists {expected}: check cables and the file")]
    Count {
        /// On the wire.
        found: usize,
        /// In the file.
        expected: usize,
    },
    /// A device differs from the file.
    #[error(
        "device {position} (`{name}`): {what} is {found:#x} on the wire and {expected:#x} in the network \
         file: check the order of the devices"
    )]
    Identity {
        /// Position on the wire, from 1.
        position: usize,
        /// Name in the file.
        name: String,
        /// Which number.
        what: &'static str,
        /// On the wire.
        found: u32,
        /// In the file.
        expected: u32,
    },
    /// An object cannot be read or written.
    #[error("`{name}`: object {index:04X}h:{sub_index} cannot be {action}: {why}")]
    Object {
        /// Name in the file.
        name: String,
        /// Index.
        index: u16,
        /// Sub-index.
        sub_index: u8,
        /// "read" or "written".
        action: &'static str,
        /// The message of the device or the MainDevice.
        why: String,
    },
    /// Process data cannot be used.
    #[error("`{name}`: {why}")]
    ProcessData {
        /// Name in the file.
        name: String,
        /// The error.
        why: PdoError,
    },
    /// A signal of the file is beyond the process data.
    #[error(
        "`{name}`: the network file has a signal up to bit {bit} of its {direction}s, of which there are \
         {bits}: `--scan` lists them"
    )]
    SignalPlace {
        /// Name in the file.
        name: String,
        /// `input` or `output`.
        direction: &'static str,
        /// The last bit of the signal.
        bit: u32,
        /// Number of bits available.
        bits: usize,
    },
    /// A drive cannot be given the period.
    #[error(transparent)]
    Period(#[from] InterpolationError),
    /// A limit of the machine is invalid.
    #[error(transparent)]
    Limits(#[from] SettingsError),
    /// A device rejected a state.
    #[error("a device did not come into {wanted}: {states}")]
    State {
        /// The state.
        wanted: &'static str,
        /// The state of each device.
        states: String,
    },
    /// The MainDevice cannot continue.
    #[error("{doing}: {why}")]
    Main {
        /// The failed step.
        doing: &'static str,
        /// Why it failed.
        why: String,
    },
    /// Frames stopped returning.
    #[error("{frames} frames in a row did not return: check the cable")]
    Lost {
        /// How many.
        frames: u32,
    },
    /// The library failed.
    #[error(
        "a device sent data that the EtherCAT library cannot handle (an emergency message, or a broken \
         EEPROM): {what}"
    )]
    Library {
        /// Its message.
        what: String,
    },
    /// A device left OP, or does not reply.
    #[error("the network failed: {states}")]
    Broken {
        /// The state of each device.
        states: String,
    },
}

/// Events of a session, for the log.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Notice {
    /// All devices are in OP.
    Operational { clocks: bool },
    /// A drive is in fault.
    DriveFault { axis: usize, code: u16 },
    /// The drives of a gantry differ too much.
    Apart { axis: usize, by: f64 },
    /// A drive has found its machine zero, or has not.
    Homed { axis: usize, found: bool },
    /// A device does not reply, or has left OP.
    DeviceLost { device: usize },
    /// Process data returned with a working counter that is too small.
    Short { found: u16, expected: u16 },
}

/// Counters over all sessions.
#[derive(Debug, Default)]
pub(crate) struct Counters {
    pub(crate) cycles: AtomicU64,
    pub(crate) lost: AtomicU64,
    pub(crate) short: AtomicU64,
}

/// The queues of a session and its counters.
pub(crate) struct Ends<'a, 'b> {
    pub(crate) bus: &'a mut BusEnds<'b, Notice>,
    pub(crate) counters: &'a Counters,
    /// For benchmarks.
    pub(crate) times: Option<&'a CycleTimes>,
}

enum Devices {
    Clocked(Group<HasDc>),
    Free(Group<NoDc>),
}

struct Exchanged {
    working_counter: u16,
    /// Bit i set: device i is in OP.
    operational: u32,
    /// The reference's time.
    time_ns: Option<u64>,
}

impl Devices {
    async fn exchange<'m>(&self, main: &'m MainDevice<'m>) -> Result<Exchanged, Error> {
        let mask = |states: &[SubDeviceState]| {
            states.iter().enumerate().fold(0, |mask, (i, state)| {
                mask | u32::from(*state == SubDeviceState::Op) << i
            })
        };
        match self {
            Self::Clocked(group) => group.tx_rx_dc(main).await.map(|response| Exchanged {
                working_counter: response.working_counter,
                operational: mask(&response.subdevice_states),
                time_ns: Some(response.extra.dc_system_time),
            }),
            Self::Free(group) => group.tx_rx(main).await.map(|response| Exchanged {
                working_counter: response.working_counter,
                operational: mask(&response.subdevice_states),
                time_ns: None,
            }),
        }
    }

    /// Calls with the outputs of a device.
    fn with_outputs<'m, R>(
        &self,
        main: &'m MainDevice<'m>,
        device: usize,
        call: impl FnOnce(&mut [u8]) -> R,
    ) -> Result<R, Error> {
        match self {
            Self::Clocked(group) => Ok(call(&mut group.subdevice(main, device)?.outputs_raw_mut())),
            Self::Free(group) => Ok(call(&mut group.subdevice(main, device)?.outputs_raw_mut())),
        }
    }

    /// Calls with the inputs of a device.
    fn with_inputs<'m, R>(
        &self,
        main: &'m MainDevice<'m>,
        device: usize,
        call: impl FnOnce(&[u8]) -> R,
    ) -> Result<R, Error> {
        match self {
            Self::Clocked(group) => Ok(call(&group.subdevice(main, device)?.inputs_raw())),
            Self::Free(group) => Ok(call(&group.subdevice(main, device)?.inputs_raw())),
        }
    }
}

/// Brings the network up and runs the cycle until something ends it; returns `Ok` if it was asked to stop.
pub(crate) fn run_session(
    socket: &PacketSocket,
    network: &Network,
    machine: &Machine,
    dump: Option<&mut DumpSender<'_>>,
    ends: &mut Ends<'_, '_>,
) -> Result<(), SessionError> {
    let period_ns = ends.bus.period_ns.load(Ordering::Relaxed);
    let storage = PduStorage::<FRAMES, FRAME_DATA>::new();
    let failed = |doing, why: &dyn core::fmt::Display| SessionError::Main {
        doing,
        why: why.to_string(),
    };
    let Ok((tx, rx, pdus)) = storage.try_split() else {
        return Err(failed("making room for frames", &"there is none"));
    };
    let mut pump = Pump::new(tx, rx, socket, dump);
    let timeouts = Timeouts {
        mailbox_response: Duration::from_secs(2),
        ..Timeouts::default()
    };
    let config = MainDeviceConfig {
        dc_static_sync_iterations: CLOCK_WARM_UP,
        ..MainDeviceConfig::default()
    };
    let main = MainDevice::new(pdus, timeouts, config);
    let started = pump.complete(monotonic_ns() + START_NS, start(&main, network, period_ns));
    let (devices, layouts) = match started {
        Some(Ok(started)) => started,
        Some(Err(SessionError::State { wanted, .. })) => {
            let states = tell_states(&mut pump, &main, network);
            return Err(SessionError::State { wanted, states });
        }
        Some(Err(error)) => return Err(error),
        None => return Err(failed("bringing the network up", &"it took more than a minute")),
    };
    let instance = monotonic_ns();
    let drives = DriveSet::new(machine, network, period_ns, instance)?;
    let mut signals = SignalSet::new(machine, network, instance);
    let driving = (network.devices.iter().enumerate()).filter(|(_, device)| device.axis.is_some());
    for ((device, listed), layout) in driving.zip(&layouts) {
        let place = layout
            .digital_inputs_at(!listed.inputs.is_empty())
            .map_err(|why| SessionError::ProcessData {
                name: listed.name.clone(),
                why,
            })?;
        signals.move_inputs(device, place);
    }
    let mut cycle = Cycle {
        main: &main,
        network,
        devices,
        layouts,
        drives,
        signals,
        period_ns,
        expected: 0,
        lost: 0,
        short: 0,
        operational: false,
        homing: [HomingProgress::Needed; MAX_DEVICES],
        reported: [0; MAX_DEVICES],
        was_apart: false,
    };
    match cycle.run(&mut pump, ends) {
        Err(SessionError::Broken { .. }) => Err(SessionError::Broken {
            states: tell_states(&mut pump, &main, network),
        }),
        Err(SessionError::State { wanted, .. }) => Err(SessionError::State {
            wanted,
            states: tell_states(&mut pump, &main, network),
        }),
        other => other,
    }
}

/// State and AL status code of every device, as text.
fn tell_states<'m>(pump: &mut Pump<'_, '_>, main: &'m MainDevice<'m>, network: &Network) -> String {
    let mut told = Vec::new();
    for (i, device) in network.devices.iter().enumerate() {
        let station = FIRST_STATION + i as u16;
        let read = pump.complete(monotonic_ns() + 100_000_000, async {
            let state = Command::fprd(station, RegisterAddress::AlStatus.into())
                .receive::<u8>(main)
                .await?;
            let code = Command::fprd(station, RegisterAddress::AlStatusCode.into())
                .receive::<AlStatusCode>(main)
                .await?;
            Ok::<_, Error>((state, code))
        });
        let name = &device.name;
        match read {
            Some(Ok((state, code))) => {
                let state = SubDeviceState::from(state & 0x0F);
                if state != SubDeviceState::Op {
                    told.push(format!("`{name}` is in {state} ({code})"));
                }
            }
            _ => told.push(format!(
                "`{name}` does not reply: check its supply and the cable before it"
            )),
        }
    }
    if told.is_empty() {
        return "every device is in Operational again".to_owned();
    }
    told.join(", ")
}

async fn start<'m>(
    main: &'m MainDevice<'m>,
    network: &Network,
    period_ns: u64,
) -> Result<(Devices, Vec<PdoLayout>), SessionError> {
    let told = InterpolationTime::from_period_ns(period_ns)?;
    let failed = |doing: &'static str| {
        move |error: Error| SessionError::Main {
            doing,
            why: error.to_string(),
        }
    };
    let refused = |wanted: &'static str| {
        move |error: Error| match error {
            Error::StateTransition | Error::Timeout(_) | Error::SubDevice(_) => SessionError::State {
                wanted,
                states: String::new(),
            },
            error => SessionError::Main {
                doing: wanted,
                why: error.to_string(),
            },
        }
    };
    let answer = Command::brd(RegisterAddress::Type.into())
        .ignore_wkc()
        .receive::<u8>(main)
        .await;
    if answer.is_err() {
        return Err(SessionError::NoDevices);
    }
    let mut group = main
        .init_single_group::<MAX_DEVICES, IMAGE>(monotonic_ns)
        .await
        .map_err(refused("PRE-OP"))?;
    let (found, expected) = (main.num_subdevices(), network.devices.len());
    if found == 0 {
        return Err(SessionError::NoDevices);
    }
    if found != expected {
        return Err(SessionError::Count { found, expected });
    }
    let mut layouts = Vec::new();
    for (i, (subdevice, device)) in group.iter(main).zip(&network.devices).enumerate() {
        let identity = subdevice.identity();
        let revision = device.revision.unwrap_or(identity.revision);
        for (what, found, expected) in [
            ("vendor", identity.vendor_id, device.vendor),
            ("product", identity.product_id, device.product),
            ("revision", identity.revision, revision),
        ] {
            if found != expected {
                return Err(SessionError::Identity {
                    position: i + 1,
                    name: device.name.clone(),
                    what,
                    found,
                    expected,
                });
            }
        }
        let objects = Objects {
            subdevice: &subdevice,
            device,
        };
        for entry in &device.startup {
            objects.write(*entry).await?;
        }
        if let Some(axis) = &device.axis {
            layouts.push(objects.set_up(axis, told).await?);
        }
    }
    let mut has_clock = false;
    for (mut subdevice, device) in group.iter_mut(main).zip(&network.devices) {
        if network.distributed_clocks && device.axis.is_some() && subdevice.dc_support().any() {
            subdevice.set_dc_sync(DcSync::Sync0);
            has_clock = true;
        }
    }
    let group = group
        .into_pre_op_pdi(main)
        .await
        .map_err(failed("mapping process data"))?;
    let devices = if has_clock {
        let clocks = DcConfiguration {
            start_delay: SYNC_DELAY,
            sync0_period: Duration::from_nanos(period_ns),
            sync0_shift: Duration::from_nanos(period_ns / 2),
        };
        let group = group
            .configure_dc_sync(main, clocks)
            .await
            .map_err(failed("setting SYNC0 up"))?;
        let group = group.into_safe_op(main).await.map_err(refused("SAFE-OP"))?;
        Devices::Clocked(group.request_into_op(main).await.map_err(refused("OP"))?)
    } else {
        let group = group.into_safe_op(main).await.map_err(refused("SAFE-OP"))?;
        Devices::Free(group.request_into_op(main).await.map_err(refused("OP"))?)
    };
    Ok((devices, layouts))
}

/// Objects of one device.
struct Objects<'a, 'm, S> {
    subdevice: &'a SubDeviceRef<'m, S>,
    device: &'a NetworkDevice,
}

impl<S: core::ops::Deref<Target = ethercrab::SubDevice>> Objects<'_, '_, S> {
    fn refused(&self, index: u16, sub_index: u8, action: &'static str, error: Error) -> SessionError {
        let why = match error {
            Error::Mailbox(MailboxError::Aborted { code, .. }) => format!("the device rejects it: {code}"),
            Error::Timeout(_) => "the device does not reply".to_owned(),
            // ethercrab's result for an emergency message, where it does not assert that there is none.
            Error::Wire(_) => "the reply does not belong to it; possibly an emergency message".to_owned(),
            error => error.to_string(),
        };
        SessionError::Object {
            name: self.device.name.clone(),
            index,
            sub_index,
            action,
            why,
        }
    }

    async fn write(&self, entry: Startup) -> Result<(), SessionError> {
        let Startup {
            index,
            sub_index,
            bytes,
            value,
        } = entry;
        let written = match bytes {
            1 => self.subdevice.sdo_write(index, sub_index, value as u8).await,
            2 => self.subdevice.sdo_write(index, sub_index, value as u16).await,
            _ => self.subdevice.sdo_write(index, sub_index, value).await,
        };
        written.map_err(|error| self.refused(index, sub_index, "written", error))
    }

    async fn set_up(&self, axis: &NetworkAxis, told: InterpolationTime) -> Result<PdoLayout, SessionError> {
        for (sub_index, value) in [(1, told.value), (2, told.index as u8)] {
            let written = self.subdevice.sdo_write(0x60C2, sub_index, value).await;
            match written {
                // Drives that take the period from SYNC0 may not have it.
                Ok(()) | Err(Error::Mailbox(MailboxError::Aborted { .. })) => {}
                Err(error) => return Err(self.refused(0x60C2, sub_index, "written", error)),
            }
        }
        if let Some(homing) = axis.homing {
            let write = |index, sub_index, bytes, value| {
                self.write(Startup {
                    index,
                    sub_index,
                    bytes,
                    value,
                })
            };
            write(0x6098, 0, 1, i32::from(homing.method) as u32).await?;
            write(0x6099, 1, 4, homing.search).await?;
            write(0x6099, 2, 4, homing.latch).await?;
            if let Some(acceleration) = homing.acceleration {
                write(0x609A, 0, 4, acceleration).await?;
            }
            // The network file gives the machine coordinate of the zero that the drive finds.
            write(0x607C, 0, 4, 0).await?;
        }
        let extras = axis.extras();
        if axis.map {
            self.map(0x1C12, 0x1600, &wanted_outputs(extras)).await?;
            self.map(0x1C13, 0x1A00, &wanted_inputs(extras)).await?;
        }
        let (outputs, inputs) = (self.mapped(0x1C12).await?, self.mapped(0x1C13).await?);
        PdoLayout::new(&outputs, &inputs, extras).map_err(|why| SessionError::ProcessData {
            name: self.device.name.clone(),
            why,
        })
    }

    async fn map(&self, assignment: u16, pdo: u16, wanted: &[Mapped]) -> Result<(), SessionError> {
        let entry = |index, sub_index, bytes, value| Startup {
            index,
            sub_index,
            bytes,
            value,
        };
        self.write(entry(assignment, 0, 1, 0)).await?;
        self.write(entry(pdo, 0, 1, 0)).await?;
        for (sub_index, mapped) in (1_u8..).zip(wanted) {
            self.write(entry(pdo, sub_index, 4, mapped.number())).await?;
        }
        self.write(entry(pdo, 0, 1, wanted.len() as u32)).await?;
        self.write(entry(assignment, 1, 2, u32::from(pdo))).await?;
        self.write(entry(assignment, 0, 1, 1)).await
    }

    async fn mapped(&self, assignment: u16) -> Result<Vec<Mapped>, SessionError> {
        let mut mapped = Vec::new();
        let count: u8 = self.read(assignment, 0).await?;
        for sub_index in 1..=count {
            let pdo: u16 = self.read(assignment, sub_index).await?;
            let entries: u8 = self.read(pdo, 0).await?;
            for sub_index in 1..=entries {
                mapped.push(Mapped::from_number(self.read(pdo, sub_index).await?));
            }
        }
        Ok(mapped)
    }

    async fn read<T: ethercrab::EtherCrabWireReadSized>(
        &self,
        index: u16,
        sub_index: u8,
    ) -> Result<T, SessionError> {
        self.subdevice
            .sdo_read(index, sub_index)
            .await
            .map_err(|error| self.refused(index, sub_index, "read", error))
    }
}

struct Cycle<'a, 'm> {
    main: &'m MainDevice<'m>,
    network: &'a Network,
    devices: Devices,
    layouts: Vec<PdoLayout>,
    drives: DriveSet,
    signals: SignalSet,
    period_ns: u64,
    /// Working counter of all devices.
    expected: u16,
    lost: u32,
    short: u32,
    /// All devices have been in OP.
    operational: bool,
    /// Progress of homing at the last check.
    homing: [HomingProgress; MAX_DEVICES],
    /// Fault codes that were reported.
    reported: [u16; MAX_DEVICES],
    was_apart: bool,
}

impl<'m> Cycle<'_, 'm> {
    fn run(&mut self, pump: &mut Pump<'_, '_>, ends: &mut Ends<'_, '_>) -> Result<(), SessionError> {
        self.expected = self.count()?;
        // Setpoints sent while the network came up are void.
        while ends.bus.incoming.pop().is_ok() {}
        let begin_ns = monotonic_ns();
        let mut next_ns = begin_ns + self.period_ns;
        let mut ending: Option<(u64, Result<(), SessionError>)> = None;
        loop {
            sleep_until(next_ns);
            let (woken_ns, waited_ns) = (monotonic_ns(), pump.waited_ns());
            let processor_ns = ends.times.map_or(0, |_| thread_ns());
            let now_ns = next_ns;
            while let Ok(incoming) = ends.bus.incoming.pop() {
                match incoming {
                    Incoming::Setpoint(setpoint) => self.drives.offer(now_ns, &setpoint),
                    Incoming::Outputs(outputs) => self.signals.offer(now_ns, &outputs),
                    Incoming::OtherVersion => self.drives.refuse_version(),
                }
            }
            let outcome = self.cycle(pump, now_ns, ends);
            ends.counters.cycles.fetch_add(1, Ordering::Relaxed);
            let correction_ns = match outcome {
                Ok(correction_ns) => correction_ns,
                Err(error @ SessionError::Broken { .. }) => {
                    // Devices that still reply stop first.
                    self.drives.end();
                    self.signals.end();
                    ending.get_or_insert((now_ns, Err(error)));
                    0
                }
                Err(error) => return Err(error),
            };
            if !self.operational && now_ns.saturating_sub(begin_ns) > OPERATIONAL_NS {
                return Err(SessionError::State {
                    wanted: "OP",
                    states: String::new(),
                });
            }
            let asked = ends.bus.stop.load(Ordering::Relaxed)
                || ends.bus.period_ns.load(Ordering::Relaxed) != self.period_ns;
            if asked && ending.is_none() {
                self.drives.end();
                self.signals.end();
                ending = Some((now_ns, Ok(())));
            }
            if let Some((since_ns, _)) = &ending
                && (now_ns.saturating_sub(*since_ns) > STOP_NS
                    || !self.drives.has_torque() && now_ns.saturating_sub(*since_ns) > 20 * self.period_ns)
                && let Some((_, result)) = ending.take()
            {
                return result;
            }
            if let Some(times) = ends.times.filter(|_| self.operational) {
                let whole_ns = monotonic_ns() - woken_ns;
                let capped = |ns: u64| u32::try_from(ns).unwrap_or(u32::MAX);
                times.take(CycleTime {
                    late_ns: capped(woken_ns.saturating_sub(next_ns)),
                    work_ns: capped(whole_ns.saturating_sub(pump.waited_ns() - waited_ns)),
                    whole_ns: capped(whole_ns),
                    processor_ns: capped(thread_ns() - processor_ns),
                });
            }
            next_ns = next_ns
                .wrapping_add(self.period_ns)
                .wrapping_add_signed(-correction_ns);
            let late_ns = monotonic_ns().saturating_sub(next_ns);
            if late_ns > self.period_ns {
                // Missed cycles are skipped.
                next_ns += late_ns / self.period_ns * self.period_ns;
            }
        }
    }

    /// Bit i set: there is a device i.
    fn all(&self) -> u32 {
        u32::MAX >> (32 - self.network.devices.len() as u32)
    }

    /// The working counter of a frame that reaches every device: 2 for outputs, 1 for inputs.
    fn count(&self) -> Result<u16, SessionError> {
        let mut expected = 0;
        let failed = |error: Error| SessionError::Main {
            doing: "reading process data",
            why: error.to_string(),
        };
        for (device, listed) in self.network.devices.iter().enumerate() {
            let outputs = (self.devices)
                .with_outputs(self.main, device, |image| image.len())
                .map_err(failed)?;
            let inputs = (self.devices)
                .with_inputs(self.main, device, |image| image.len())
                .map_err(failed)?;
            expected += 2 * u16::from(outputs > 0) + u16::from(inputs > 0);
            let read =
                |input: &NetworkInput| input.error_bit.map_or(0, |bit| bit + 1).max(input.channel.end());
            let last = [
                (
                    "output",
                    listed.outputs.iter().map(|output| output.channel.end()).max(),
                    outputs,
                ),
                (
                    "input",
                    listed
                        .inputs
                        .iter()
                        .filter(|_| listed.axis.is_none())
                        .map(read)
                        .max(),
                    inputs,
                ),
            ];
            for (direction, end, bytes) in last {
                let bits = 8 * bytes;
                if let Some(end) = end.filter(|end| *end as usize > bits) {
                    return Err(SessionError::SignalPlace {
                        name: listed.name.clone(),
                        direction,
                        bit: end - 1,
                        bits,
                    });
                }
            }
        }
        Ok(expected)
    }

    /// One period; returns by how many ns the next one is shorter, to follow the reference clock.
    fn cycle(
        &mut self,
        pump: &mut Pump<'_, '_>,
        now_ns: u64,
        ends: &mut Ends<'_, '_>,
    ) -> Result<i64, SessionError> {
        let internal = |error: Error| SessionError::Main {
            doing: "exchanging process data",
            why: error.to_string(),
        };
        if self.operational {
            self.drives.step(now_ns);
            self.signals.step(now_ns);
        }
        let axes = self
            .network
            .devices
            .iter()
            .enumerate()
            .filter(|(_, device)| device.axis.is_some());
        for (axis, (device, _)) in axes.clone().enumerate() {
            let (outputs, layout) = (self.drives.outputs(axis), self.layouts[axis]);
            self.devices
                .with_outputs(self.main, device, |image| layout.write(&outputs, image))
                .map_err(internal)?;
        }
        for (device, listed) in self.network.devices.iter().enumerate() {
            if !listed.outputs.is_empty() {
                self.devices
                    .with_outputs(self.main, device, |image| self.signals.write(device, image))
                    .map_err(internal)?;
            }
        }
        let answer = pump.complete(now_ns + self.period_ns * 9 / 10, self.devices.exchange(self.main));
        let exchanged = match answer {
            Some(Ok(exchanged)) => exchanged,
            Some(Err(_)) | None => {
                ends.counters
                    .lost
                    .fetch_add(u64::from(self.operational), Ordering::Relaxed);
                self.lost += 1;
                // While the network comes up, a busy host may be late.
                let patience = if self.operational {
                    self.network.max_lost_cycles
                } else {
                    1000
                };
                return if self.lost > patience {
                    Err(SessionError::Lost { frames: self.lost })
                } else {
                    Ok(0)
                };
            }
        };
        self.lost = 0;
        let all = self.all();
        let is_whole = exchanged.working_counter == self.expected;
        // If a device is missing, the inputs of the others are valid; if none is, it is unknown whose are
        // not.
        let is_known = |device: usize| {
            is_whole || exchanged.operational & all != all && exchanged.operational >> device & 1 == 1
        };
        for (axis, (device, _)) in axes.enumerate() {
            let layout = self.layouts[axis];
            let inputs = self
                .devices
                .with_inputs(self.main, device, |image| layout.read(image))
                .map_err(internal)?;
            if is_known(device) {
                self.drives.take(axis, inputs);
            }
        }
        for (device, listed) in self.network.devices.iter().enumerate() {
            if !listed.inputs.is_empty() {
                let signals = &mut self.signals;
                self.devices
                    .with_inputs(self.main, device, |image| {
                        signals.read(device, is_known(device).then_some(image));
                    })
                    .map_err(internal)?;
            }
        }
        let judged = self.judge(&exchanged, ends);
        if self.operational {
            // A message that does not fit is replaced by the next.
            if let Some(feedback) = self.drives.feedback(monotonic_ns()) {
                let _full = ends.bus.feedback.push(feedback);
            }
            let read_ns = monotonic_ns();
            self.signals.read_probe(&self.drives.probe(), read_ns);
            if let Some(message) = self.signals.message(read_ns) {
                let _full = ends.bus.inputs.push(message);
            }
        }
        judged?;
        Ok(exchanged.time_ns.map_or(0, |time_ns| self.correction_ns(time_ns)))
    }

    fn judge(&mut self, exchanged: &Exchanged, ends: &mut Ends<'_, '_>) -> Result<(), SessionError> {
        let all = self.all();
        let is_whole = exchanged.operational & all == all && exchanged.working_counter == self.expected;
        if is_whole {
            self.short = 0;
            if !self.operational {
                self.operational = true;
                let clocks = matches!(self.devices, Devices::Clocked(_));
                let _full = ends.bus.notices.push(Notice::Operational { clocks });
            }
            self.tell_faults(ends);
            return Ok(());
        }
        if !self.operational {
            return Ok(());
        }
        ends.counters.short.fetch_add(1, Ordering::Relaxed);
        self.short += 1;
        if self.short <= self.network.max_lost_cycles {
            return Ok(());
        }
        if self.short == self.network.max_lost_cycles + 1 {
            let (found, expected) = (exchanged.working_counter, self.expected);
            let _full = ends.bus.notices.push(Notice::Short { found, expected });
        }
        let mut axis = 0;
        for (device, listed) in self.network.devices.iter().enumerate() {
            let is_lost = exchanged.operational >> device & 1 == 0;
            if is_lost && self.short == self.network.max_lost_cycles + 1 {
                let _full = ends.bus.notices.push(Notice::DeviceLost { device });
            }
            if listed.axis.is_some() {
                // If all report OP, it is unknown whose data are missing.
                if is_lost || exchanged.operational & all == all {
                    self.drives.set_lost(axis);
                }
                axis += 1;
            }
        }
        Err(SessionError::Broken {
            states: String::new(),
        })
    }

    fn tell_faults(&mut self, ends: &mut Ends<'_, '_>) {
        let apart = self.drives.apart();
        if let (Some((axis, by)), false) = (apart, self.was_apart) {
            let _full = ends.bus.notices.push(Notice::Apart { axis, by });
        }
        self.was_apart = apart.is_some();
        for (place, axis) in self.drives.axes().iter().enumerate() {
            let (index, code) = (axis.index(), axis.error_code());
            if code != 0 && self.reported[place] != code {
                let _full = ends.bus.notices.push(Notice::DriveFault { axis: index, code });
            }
            self.reported[place] = code;
            let homing = axis.homing();
            if homing != self.homing[place] {
                let ended = matches!(homing, HomingProgress::Done | HomingProgress::Failed);
                let runs = matches!(self.homing[place], HomingProgress::Running(_));
                if ended && runs {
                    let found = homing == HomingProgress::Done;
                    let _full = ends.bus.notices.push(Notice::Homed { axis: index, found });
                }
                self.homing[place] = homing;
            }
        }
    }

    /// Frames pass the reference half a period after SYNC0. The difference is reduced gradually.
    fn correction_ns(&self, time_ns: u64) -> i64 {
        let half = self.period_ns / 2;
        let phase = (time_ns.wrapping_sub(half)) % self.period_ns;
        let error = if phase > half {
            phase as i64 - self.period_ns as i64
        } else {
            phase as i64
        };
        error / PHASE_GAIN
    }
}

fn sleep_until(at_ns: u64) {
    let at = Timespec {
        tv_sec: (at_ns / 1_000_000_000) as i64,
        tv_nsec: (at_ns % 1_000_000_000) as i64,
    };
    // A signal ends the sleep early: the cycle is early once.
    let _interrupted = clock_nanosleep_absolute(ClockId::Monotonic, &at);
}
