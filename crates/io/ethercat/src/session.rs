//! One session with the network: from INIT to OP, the cycle, and why it ended.

mod cycle;
mod error;
mod start;

use core::sync::atomic::{AtomicU64, Ordering};
use core::time::Duration;

use ethercrab::error::Error;
use ethercrab::subdevice_group::{HasDc, NoDc, Op};
use ethercrab::{
    AlStatusCode, Command, DefaultLock, MainDevice, MainDeviceConfig, PduStorage, RegisterAddress,
    SubDeviceGroup, SubDeviceState, Timeouts,
};
use evolvent_bridge::{BusEnds, monotonic_ns};
use evolvent_bus::AXES;
use evolvent_machine::Machine;

use self::cycle::{Cycle, Exchanged};
pub(crate) use self::error::Notice;
pub use self::error::SessionError;
use self::start::{Layouts, start};
use crate::al_status_text::what_to_check;
use crate::clock_monitor::ClockMonitor;
use crate::cycle_times::CycleTimes;
use crate::drive_set::{DriveSet, Starts};
use crate::dump::{DumpCounters, DumpSender};
use crate::homing::HomingProgress;
use crate::network::{MAX_DEVICES, Network};
use crate::pump::Pump;
use crate::signal_set::SignalSet;
use crate::socket::PacketSocket;
use crate::spindle_drive::SpindleDrive;

/// Maximum number of frames in flight, and their data size.
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
pub(crate) const FIRST_STATION: u16 = 0x1000;
/// Maximum time for one frame while the network comes up. A mailbox from which an emergency message was read
/// is read again until the device has replied, all within one frame of the MainDevice: drives take up to some
/// 100 ms.
const REPLY: Duration = Duration::from_millis(500);
/// Maximum time for one access to a device's EEPROM. It takes a device some milliseconds; the usual 10 ms end
/// the start where the host is busy for that long.
const EEPROM: Duration = Duration::from_millis(500);

type Group<S> = SubDeviceGroup<MAX_DEVICES, IMAGE, DefaultLock, Op, S>;

/// Counters over all sessions.
#[derive(Debug, Default)]
pub(crate) struct Counters {
    /// Number of times that all devices reached OP.
    pub(crate) ready: AtomicU64,
    pub(crate) cycles: AtomicU64,
    pub(crate) lost: AtomicU64,
    pub(crate) short: AtomicU64,
    /// Start offsets of the drives.
    pub(crate) starts: Starts,
}

/// The queues of a session and its counters.
pub(crate) struct Ends<'a, 'b> {
    pub(crate) bus: &'a mut BusEnds<'b, Notice>,
    pub(crate) counters: &'a Counters,
    pub(crate) clocks: &'a mut ClockMonitor,
    pub(crate) recorded: &'a DumpCounters,
    /// For benchmarks.
    pub(crate) times: Option<&'a CycleTimes>,
}

enum Devices {
    Clocked(Group<HasDc>),
    Free(Group<NoDc>),
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

    /// Whether a device has a distributed clock, of those that have been set up.
    fn has_clock<'m>(&self, main: &'m MainDevice<'m>, device: usize) -> bool {
        match self {
            Self::Clocked(group) => group
                .subdevice(main, device)
                .is_ok_and(|subdevice| subdevice.dc_support().any()),
            Self::Free(_) => false,
        }
    }

    /// Calls a function with the outputs of a device.
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

    /// Calls a function with the inputs of a device.
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

/// Brings the network up and runs the cycle until something ends it; returns `Ok` if a stop was requested.
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
        return Err(failed("reserving the frame buffer", &"it is not available"));
    };
    let mut pump = Pump::new(tx, rx, socket, dump);
    let config = MainDeviceConfig {
        dc_static_sync_iterations: CLOCK_WARM_UP,
        ..MainDeviceConfig::default()
    };
    let main = MainDevice::new(pdus, timeouts(), config);
    let started = pump.complete(
        monotonic_ns() + START_NS,
        start(&main, network, machine, period_ns),
    );
    report_emergencies(&pump, ends);
    let (devices, layouts, reference) = match started {
        Some(Ok(started)) => started,
        Some(Err(error)) => return Err(with_states(error, 0, &mut pump, &main, network)),
        None => return Err(failed("bringing the network up", &"it took more than a minute")),
    };
    let instance = monotonic_ns();
    let drives = DriveSet::new(machine, network, period_ns, instance, &ends.counters.starts)?;
    let mut signals = SignalSet::new(machine, network, instance);
    place_signals(&mut signals, network, &layouts)?;
    let mut cycle = Cycle {
        main: &main,
        network,
        devices,
        layouts,
        drives,
        signals,
        spindles: SpindleDrive::all(machine, network, instance),
        period_ns,
        reference,
        expected: 0,
        lost: 0,
        short: 0,
        operational: false,
        silent: 0,
        homing: [HomingProgress::Needed; MAX_DEVICES],
        reported: [0; MAX_DEVICES],
        was_apart: [false; AXES],
    };
    let ended = cycle.run(&mut pump, ends);
    let silent = cycle.silent;
    ended.map_err(|error| with_states(error, silent, &mut pump, &main, network))
}

/// Timeouts while devices are scanned and the network comes up.
pub(crate) fn timeouts() -> Timeouts {
    Timeouts {
        mailbox_response: Duration::from_secs(2),
        pdu: REPLY,
        eeprom: EEPROM,
        ..Timeouts::default()
    }
}

/// Reports the emergency messages that devices sent while the network came up.
fn report_emergencies(pump: &Pump<'_, '_>, ends: &mut Ends<'_, '_>) {
    for emergency in pump.emergencies() {
        let _full = ends.bus.notices.push(Notice::Emergency {
            device: usize::from(emergency.station.wrapping_sub(FIRST_STATION)),
            code: emergency.code,
            register: emergency.register,
        });
    }
}

/// Moves the signals of each drive to the positions of its digital inputs and outputs in the process data.
fn place_signals(signals: &mut SignalSet, network: &Network, layouts: &Layouts) -> Result<(), SessionError> {
    let axes = network.axis_devices().zip(&layouts.axes);
    let spindles = network.spindle_devices().zip(&layouts.spindles);
    let mut in_order: Vec<_> = axes.chain(spindles).collect();
    in_order.sort_by_key(|(device, _)| *device);
    for (device, layout) in in_order {
        let listed = &network.devices[device];
        let place = layout
            .digital_inputs_at(!listed.inputs.is_empty())
            .map_err(|why| SessionError::ProcessData {
                name: listed.name.clone(),
                why,
            })?;
        signals.move_inputs(device, place);
        // Their absence is an error of the start where the network file has outputs.
        signals.move_outputs(device, layout.physical_outputs_at().unwrap_or(0));
    }
    Ok(())
}

/// The error with the devices that caused it: those of `silent`, bit i for device i, otherwise those below
/// the state that was requested, which after the start is OP.
fn with_states<'m>(
    error: SessionError,
    silent: u32,
    pump: &mut Pump<'_, '_>,
    main: &'m MainDevice<'m>,
    network: &Network,
) -> SessionError {
    match error {
        SessionError::Broken { .. } if silent != 0 => {
            let devices = network.devices.iter().enumerate();
            let names: Vec<_> = devices
                .filter(|(device, _)| silent >> device & 1 == 1)
                .map(|(_, listed)| format!("`{}` did not exchange process data", listed.name))
                .collect();
            SessionError::Broken {
                states: names.join(", "),
            }
        }
        SessionError::Broken { .. } => SessionError::Broken {
            states: tell_states(pump, main, network, SubDeviceState::Op),
        },
        SessionError::State { wanted, .. } => SessionError::State {
            wanted,
            states: tell_states(pump, main, network, state_of(wanted)),
        },
        other => other,
    }
}

/// The state with a name.
fn state_of(wanted: &str) -> SubDeviceState {
    match wanted {
        "PRE-OP" => SubDeviceState::PreOp,
        "SAFE-OP" => SubDeviceState::SafeOp,
        _ => SubDeviceState::Op,
    }
}

/// Bit of the AL status: the device has refused a state.
const AL_ERROR: u8 = 0x10;

/// The devices that are below a state or report an error, each with its state, its AL status code by name,
/// and what to check.
fn tell_states<'m>(
    pump: &mut Pump<'_, '_>,
    main: &'m MainDevice<'m>,
    network: &Network,
    wanted: SubDeviceState,
) -> String {
    let mut problems = Vec::new();
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
            // Devices may keep an old code: it is valid only with the error bit.
            Some(Ok((number, code))) if number & 0x0F < u8::from(wanted) || number & AL_ERROR != 0 => {
                let state = SubDeviceState::from(number & 0x0F);
                let remedy = what_to_check(code.into()).map_or_else(String::new, |text| format!(": {text}"));
                problems.push(format!("`{name}` is in {state} ({code}){remedy}"));
            }
            Some(Ok(_)) => {}
            _ => problems.push(format!(
                "`{name}` does not reply: check its supply and the cable before it"
            )),
        }
    }
    if problems.is_empty() {
        return format!("every device is in {wanted} again");
    }
    problems.join("; ")
}
