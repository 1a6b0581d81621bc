//! `evolvent bridge ethercat`: EtherCAT drives as the axes of a machine.

use std::io::Write;
use std::path::{Path, PathBuf};

use clap::Args;
use evolvent_bus::BusError;
use evolvent_config::{check_outputs, write_new};
use evolvent_ethercat::{
    BridgeError, BridgeReport, DumpSettings, EsiLibrary, Network, RunError, RunSettings, ScanError,
    check_fit, fit_notes, network_text, run as run_bridge, scan, scan_json, scan_text,
};
use evolvent_machine::Machine;
use evolvent_path::AxisLetter;
use serde_json::{Value, json};

use crate::bridge::{duration_of, ending_of_bridge, stop_on_signals};
use crate::output::written;
use crate::{CommandError, Ending};

/// Options of `evolvent bridge ethercat`.
///
/// The bridge waits for the core and the network in any order and outlives both. It needs CAP_NET_RAW to open
/// the interface, and then drops every capability. Terminals provide the inputs and outputs of the machine
/// file, two drives may move one axis, and drives that home themselves move their axes when power is first
/// requested. It has been tested with simulated devices only: see docs/ethercat.md.
#[derive(Args, Debug)]
pub(crate) struct EthercatArgs {
    /// Machine file: name, axes and limits, as for the core. With --scan, its axes are assigned to the drives
    /// in their order.
    #[arg(long, value_name = "FILE", required_unless_present = "scan")]
    machine: Option<PathBuf>,
    /// Network file: devices, and the axis of each drive.
    #[arg(long, value_name = "FILE", required_unless_present = "scan")]
    network: Option<PathBuf>,
    /// List the devices on the wire, and end. Takes every device to INIT: do not use it while a bridge runs.
    #[arg(long, requires = "interface", conflicts_with_all = ["network", "machine_name", "bus_prefix", "seconds"])]
    scan: bool,
    /// Write a template of a network file, which must not exist; its axes have guessed values, with which no
    /// bridge runs.
    #[arg(long, value_name = "FILE", requires = "scan")]
    write: Option<PathBuf>,
    /// ESI file of a vendor, or a folder of them: names, process data and units that the devices do not
    /// report. May be given several times.
    #[arg(long, value_name = "FILE", requires = "scan")]
    esi: Vec<PathBuf>,
    /// Network interface, instead of the network file's.
    #[arg(long, value_name = "NAME")]
    interface: Option<String>,
    /// Name on the bus, instead of the machine file's.
    #[arg(long, value_name = "NAME")]
    machine_name: Option<String>,
    /// Prefix of the bus's files, as for the core.
    #[arg(long, value_name = "PREFIX")]
    bus_prefix: Option<String>,
    /// End after this many seconds; without it, at Ctrl-C. The exit code is 1 if the network did not come up
    /// in that time.
    #[arg(long, value_name = "N")]
    seconds: Option<f64>,
    /// Record the wire to this file (pcapng, for Wireshark and tshark), which is created or replaced. It
    /// keeps the most recent frames that fit into --dump-mib. Frames for which the disk is too slow are
    /// counted and omitted; the cycle does not wait.
    #[arg(long, value_name = "FILE", conflicts_with = "scan")]
    dump: Option<PathBuf>,
    /// Maximum size of that file in MiB.
    #[arg(long, value_name = "N", requires = "dump", default_value_t = 256, value_parser = clap::value_parser!(u32).range(1..=65536))]
    dump_mib: u32,
    /// Print one JSON object at the end, or as the list.
    #[arg(long)]
    json: bool,
}

fn scan_wire(args: &EthercatArgs, out: &mut dyn Write, err: &mut dyn Write) -> Result<Ending, CommandError> {
    let usage = CommandError::Usage;
    let interface = args.interface.as_deref().unwrap_or_default();
    let letters: Vec<AxisLetter> = match &args.machine {
        Some(path) => {
            let machine = Machine::load(path).map_err(|error| usage(error.to_string()))?;
            machine.axes.iter().map(|axis| axis.letter).collect()
        }
        None => AxisLetter::ALL.to_vec(),
    };
    let mut library = EsiLibrary::default();
    for path in &args.esi {
        library.add(path).map_err(|error| usage(error.to_string()))?;
    }
    let exists = args.write.as_deref().filter(|path| path.exists());
    if let Some(path) = exists {
        return Err(usage(format!(
            "{}: the network file exists, so nothing was scanned; choose a path that does not exist",
            path.display()
        )));
    }
    let mut devices = scan(interface).map_err(|error| match error {
        ScanError::Interface(_) => usage(error.to_string()),
        error => CommandError::Failed(error.to_string()),
    })?;
    library.complete(&mut devices);
    if args.json {
        written(writeln!(out, "{}", scan_json(&devices)))?;
    } else {
        written(write!(out, "{}", scan_text(&devices)))?;
    }
    let Some(path) = &args.write else {
        return Ok(Ending::Clean);
    };
    let text = network_text(&devices, interface, &letters).ok_or_else(|| {
        CommandError::Failed(
            "no device is a CiA 402 drive: a network file needs one, so none was written".to_owned(),
        )
    })?;
    write_new(path, text.as_bytes()).map_err(|error| {
        usage(format!(
            "{}: the network file cannot be written: {error}; choose a path that does not exist",
            path.display()
        ))
    })?;
    written(writeln!(
        err,
        "{}: check each [device.axis], then remove `unchecked`",
        path.display()
    ))?;
    Ok(Ending::Clean)
}

pub(crate) fn run(
    args: &EthercatArgs,
    out: &mut dyn Write,
    err: &mut dyn Write,
) -> Result<Ending, CommandError> {
    let usage = CommandError::Usage;
    let (false, Some(machine_path), Some(network_path)) = (args.scan, &args.machine, &args.network) else {
        return scan_wire(args, out, err);
    };
    check_outputs(
        args.dump.as_deref(),
        [
            (machine_path.as_path(), "the machine file"),
            (network_path.as_path(), "the network file"),
        ],
    )?;
    let settings = settings_of(args, machine_path, network_path, err)?;
    let stop = stop_on_signals()?;
    let report = run_bridge(&settings, &stop, |text| {
        // If standard error is closed, nobody is left to inform.
        let _told = writeln!(err, "{text}");
    });
    let report = report.map_err(|error| match error {
        RunError::Bridge(BridgeError::Bus(BusError::Name(_) | BusError::Prefix { .. }))
        | RunError::Dump { .. } => usage(error.to_string()),
        // The interface may come up after the bridge was started at boot, and a core with other axes may be
        // replaced with the right one: systemd units start the bridge again.
        error => CommandError::Failed(error.to_string()),
    })?;
    if args.json {
        written(writeln!(out, "{}", report_json(&settings, &report)))?;
    } else {
        written(write!(err, "{}", report_text(&settings, &report)))?;
    }
    let reached = (report.connections, report.ready);
    ending_of_bridge(args.seconds, &stop, reached, "the network", err)
}

/// Reads the machine and network file, which must fit each other, and writes notes on how they do.
fn settings_of(
    args: &EthercatArgs,
    machine_path: &Path,
    network_path: &Path,
    err: &mut dyn Write,
) -> Result<RunSettings, CommandError> {
    let usage = CommandError::Usage;
    let machine = Machine::load(machine_path).map_err(|error| usage(error.to_string()))?;
    let network = Network::load(network_path).map_err(|error| usage(error.to_string()))?;
    check_fit(&machine, &network).map_err(|error| usage(format!("{}: {error}", network_path.display())))?;
    for note in fit_notes(&machine, &network) {
        written(writeln!(err, "note: {note}"))?;
    }
    let interface = args.interface.clone().or_else(|| network.interface.clone());
    let interface = interface.ok_or_else(|| {
        usage(format!(
            "{}: no interface is named: give --interface, or `interface` in the file",
            network_path.display()
        ))
    })?;
    Ok(RunSettings {
        machine,
        machine_name: args.machine_name.clone(),
        network,
        interface,
        prefix: args.bus_prefix.clone(),
        duration: duration_of(args.seconds)?,
        dump: args.dump.as_ref().map(|path| DumpSettings {
            path: path.clone(),
            max_bytes: u64::from(args.dump_mib) << 20,
        }),
    })
}

fn report_json(settings: &RunSettings, report: &BridgeReport) -> Value {
    json!({
        "machine": settings.machine_name.as_ref().unwrap_or(&settings.machine.name),
        "connections": report.connections,
        "sessions": report.sessions,
        "ready": report.ready,
        "cycles": report.cycles,
        "lost_frames": report.lost_frames,
        "short_frames": report.short_frames,
        "recorded_frames": report.recorded_frames,
        "unrecorded_frames": report.unrecorded_frames,
        "clocks": report.clocks.map(|clocks| json!({
            "readings": clocks.readings,
            "max_difference_ns": clocks.max_difference_ns,
            "max_difference_device": clocks.max_difference_device.map(|device| settings.name_of(device)),
            "last_difference_ns": clocks.last_difference_ns,
            "shift_ns": clocks.shift_ns,
            "jitter_p50_ns": clocks.jitter_p50_ns,
            "jitter_p999_ns": clocks.jitter_p999_ns,
            "jitter_max_ns": clocks.jitter_max_ns,
            "drift_ppm": clocks.drift_ppm,
        })),
    })
}

fn report_text(settings: &RunSettings, report: &BridgeReport) -> String {
    let mut text = format!(
        "{} cycles, {} frames lost, {} short\n",
        report.cycles, report.lost_frames, report.short_frames
    );
    if let Some(clocks) = &report.clocks {
        text += &format!("{}\n", settings.clock_text(clocks));
    }
    if let Some(dump) = &settings.dump {
        text += &format!(
            "{}: {} frames recorded, {} omitted\n",
            dump.path.display(),
            report.recorded_frames,
            report.unrecorded_frames
        );
    }
    text
}
