//! `ethercat-ring`: the simulated ring on a network interface, started by hand.

use std::io::Write;
use std::process::ExitCode;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex};

use clap::{Parser, ValueEnum};
use evolvent_ethercat_ring::{
    DriveSettings, Fault, PacketSocket, Ring, SubDevice, TerminalKind, monotonic_ns, run,
};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

/// A TEST SIMULATOR: a ring of EtherCAT SubDevices on a network interface, for MainDevices under test.
///
/// Never on an interface with real devices. A pair of virtual ones is made by
/// `ip link add name ec0 type veth peer name ec1`, `ip link set ec0 up` and `ip link set ec1 up`; the ring
/// goes on ec1, the MainDevice on ec0. Needs CAP_NET_RAW.
#[derive(Debug, Parser)]
#[command(version)]
struct Arguments {
    /// The network interface.
    #[arg(long, value_name = "NAME")]
    interface: String,
    /// A device; may be given several times, in the order of the ring. Default: coupler and one drive.
    #[arg(long = "device", value_enum, value_name = "KIND")]
    devices: Vec<Kind>,
    /// Wires the outputs of a device to the inputs of another; may be given several times, devices count from
    /// 0.
    #[arg(long = "wire", value_name = "FROM:TO", value_parser = parse_wire)]
    wires: Vec<(usize, usize)>,
    /// A fault N seconds after all devices were in OP: loss, delay, reorder, wkc, break, gone, drive,
    /// temperature, sto, blocked, limit, index-missing, clock-free, sdo-abort, sdo-wrong, slow-mailbox,
    /// emergency, refuse-safe-op or refuse-op. May be given several times; devices count from 0.
    #[arg(long = "fault", value_name = "KIND@SECONDS[+DURATION][:DEVICE]")]
    faults: Vec<Fault>,
    /// By how much the clock of each drive is faster than the one before it, in millionths.
    #[arg(
        long,
        value_name = "PPM",
        default_value_t = 10.0,
        allow_negative_numbers = true
    )]
    drift_ppm: f64,
    /// By how much the clock of the first device, which is the reference, is faster than this computer's, in
    /// millionths. The others count from it.
    #[arg(
        long,
        value_name = "PPM",
        default_value_t = 0.0,
        allow_negative_numbers = true
    )]
    reference_ppm: f64,
    /// Turns of the motor from the start of each drive to its limit switches, negative and positive end.
    #[arg(
        long,
        value_name = "LOW:HIGH",
        default_value = "-200:200",
        allow_hyphen_values = true,
        value_parser = parse_limits
    )]
    limit_turns: [f64; 2],
    /// The drives have absolute encoders, which keep their position while a device is `gone`; others count
    /// from 0 again.
    #[arg(long)]
    absolute: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Kind {
    /// CiA 402 drive, 2^20 increments a turn.
    Drive,
    /// The same without limit switches, to turn a spindle.
    Spindle,
    /// Coupler without process data.
    Coupler,
    /// 8 digital inputs.
    DigitalIn,
    /// 8 digital outputs.
    DigitalOut,
    /// 2 analog inputs.
    AnalogIn,
    /// 2 analog outputs.
    AnalogOut,
}

impl Kind {
    fn device(self, position: usize, arguments: &Arguments) -> SubDevice {
        let serial = position as u32 + 1;
        let terminal = |kind| SubDevice::terminal(kind, serial);
        match self {
            Self::Drive | Self::Spindle => {
                let mut settings = DriveSettings {
                    absolute: arguments.absolute,
                    limits_turns: arguments.limit_turns,
                    ..DriveSettings::default()
                };
                if matches!(self, Self::Spindle) {
                    settings.limits_turns = [f64::NEG_INFINITY, f64::INFINITY];
                    settings.probe_turns = f64::INFINITY;
                }
                let drift_ppm = arguments.reference_ppm + arguments.drift_ppm * position as f64;
                SubDevice::drive(settings, serial, drift_ppm)
            }
            Self::Coupler => terminal(TerminalKind::Coupler).with_drift_ppm(arguments.reference_ppm),
            Self::DigitalIn => terminal(TerminalKind::DigitalInput),
            Self::DigitalOut => terminal(TerminalKind::DigitalOutput),
            Self::AnalogIn => terminal(TerminalKind::AnalogInput),
            Self::AnalogOut => terminal(TerminalKind::AnalogOutput),
        }
    }
}

fn parse_wire(text: &str) -> Result<(usize, usize), String> {
    text.split_once(':')
        .and_then(|(from, to)| Some((from.parse().ok()?, to.parse().ok()?)))
        .ok_or_else(|| format!("`{text}` is no wire: expected FROM:TO, for example 5:4"))
}

fn parse_limits(text: &str) -> Result<[f64; 2], String> {
    text.split_once(':')
        .and_then(|(low, high)| Some([low.parse().ok()?, high.parse().ok()?]))
        .filter(|[low, high]: &[f64; 2]| low < high)
        .ok_or_else(|| format!("`{text}` are no limits: expected LOW:HIGH, for example -90:10"))
}

/// Wires and faults of devices that do not exist, or cannot have them, would do nothing.
fn check_positions(kinds: &[Kind], arguments: &Arguments) -> Result<(), String> {
    for &(from, to) in &arguments.wires {
        let pair = (kinds.get(from), kinds.get(to));
        let is_possible = matches!(
            pair,
            (Some(Kind::DigitalOut), Some(Kind::DigitalIn)) | (Some(Kind::AnalogOut), Some(Kind::AnalogIn))
        );
        if !is_possible {
            return Err(format!(
                "--wire {from}:{to} does not lead from outputs to inputs of the same kind: the {} devices are \
                 numbered from 0 in the order of --device",
                kinds.len()
            ));
        }
    }
    match arguments.faults.iter().find(|fault| fault.device >= kinds.len()) {
        Some(fault) => Err(format!(
            "--fault has device {}, but there are {} devices, numbered from 0 in the order of --device",
            fault.device,
            kinds.len()
        )),
        None => Ok(()),
    }
}

fn main() -> ExitCode {
    match serve(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // If standard error is closed, the message cannot be shown.
            let _written = writeln!(std::io::stderr(), "error: {error}");
            ExitCode::from(2)
        }
    }
}

fn serve(arguments: &Arguments) -> std::io::Result<()> {
    let kinds = if arguments.devices.is_empty() {
        &[Kind::Coupler, Kind::Drive]
    } else {
        arguments.devices.as_slice()
    };
    check_positions(kinds, arguments).map_err(std::io::Error::other)?;
    let devices: Vec<SubDevice> = kinds
        .iter()
        .enumerate()
        .map(|(i, kind)| kind.device(i, arguments))
        .collect();
    let count = devices.len();
    let mut ring = Ring::new(devices, monotonic_ns());
    for fault in &arguments.faults {
        ring.add_fault(*fault);
    }
    for &(from, to) in &arguments.wires {
        ring.wire(from, to);
    }
    let socket = PacketSocket::open(&arguments.interface).map_err(|error| {
        std::io::Error::new(
            error.kind(),
            format!("the interface {} cannot be opened: {error}", arguments.interface),
        )
    })?;
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM, SIGHUP] {
        signal_hook::flag::register(signal, Arc::clone(&stop))?;
    }
    writeln!(
        std::io::stderr(),
        "test simulator: {count} devices on {}",
        arguments.interface
    )?;
    run(&Mutex::new(ring), &socket, &stop)
}
