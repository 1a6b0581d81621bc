//! `evolvent bridge ethercat`: EtherCAT drives as the axes of a machine.

use std::io::Write;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use clap::Args;
use evolvent_bus::BusError;
use evolvent_ethercat::{Network, RunError, RunSettings, check_fit, run as run_bridge};
use evolvent_machine::Machine;
use serde_json::json;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

use crate::{CommandError, Ending};

/// Options of `evolvent bridge ethercat`.
///
/// Waits for the core and the network, in any order, and outlives both. Needs CAP_NET_RAW to open the interface, and gives up every
/// capability then. So far it was shown with simulated devices only: see docs/ethercat.md.
#[derive(Args, Debug)]
pub(crate) struct EthercatArgs {
    /// Machine file: name, axes and limits, as of the core.
    #[arg(long, value_name = "FILE")]
    machine: PathBuf,
    /// Network file: devices, and which axis each drive turns.
    #[arg(long, value_name = "FILE")]
    network: PathBuf,
    /// Network interface, in place of the network file's.
    #[arg(long, value_name = "NAME")]
    interface: Option<String>,
    /// Name on the bus, in place of the machine file's.
    #[arg(long, value_name = "NAME")]
    machine_name: Option<String>,
    /// Prefix of the bus's files, as of the core.
    #[arg(long, value_name = "PREFIX")]
    bus_prefix: Option<String>,
    /// End after so many seconds; without it, at Ctrl-C.
    #[arg(long, value_name = "N")]
    seconds: Option<f64>,
    /// Print one JSON object at the end.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(
    args: &EthercatArgs,
    out: &mut dyn Write,
    err: &mut dyn Write,
) -> Result<Ending, CommandError> {
    let usage = |text: String| CommandError::Usage(text);
    let failed =
        |error: std::io::Error| CommandError::Failed(format!("the report cannot be written: {error}"));
    let machine = Machine::load(&args.machine).map_err(|error| usage(error.to_string()))?;
    let network = Network::load(&args.network).map_err(|error| usage(error.to_string()))?;
    check_fit(&machine, &network).map_err(|error| usage(format!("{}: {error}", args.network.display())))?;
    let interface = args
        .interface
        .clone()
        .or_else(|| network.interface.clone())
        .ok_or_else(|| {
            usage(format!(
                "{}: no interface is named: give --interface, or `interface` in the file",
                args.network.display()
            ))
        })?;
    let duration = match args.seconds {
        None => None,
        Some(seconds) if (0.0..=1e9).contains(&seconds) => Some(Duration::from_secs_f64(seconds)),
        Some(seconds) => {
            return Err(usage(format!(
                "--seconds {seconds} is out of range: choose 0 to 1000000000"
            )));
        }
    };
    let settings = RunSettings {
        machine,
        machine_name: args.machine_name.clone(),
        network,
        interface,
        prefix: args.bus_prefix.clone(),
        duration,
    };
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM, SIGHUP] {
        signal_hook::flag::register(signal, Arc::clone(&stop))
            .map_err(|error| CommandError::Failed(format!("signals cannot be caught: {error}")))?;
    }
    let name = settings
        .machine_name
        .as_ref()
        .unwrap_or(&settings.machine.name)
        .clone();
    writeln!(
        err,
        "EtherCAT drives of {name} on {}: waiting for its core",
        settings.interface
    )
    .map_err(failed)?;
    let report = run_bridge(&settings, &stop, |text| {
        // With standard error gone there is nobody left to tell.
        let _told = writeln!(err, "{text}");
    });
    let report = report.map_err(|error| match error {
        RunError::Bus(BusError::Name(_) | BusError::Prefix { .. })
        | RunError::Axes { .. }
        | RunError::Interface { .. } => usage(error.to_string()),
        error => CommandError::Failed(error.to_string()),
    })?;
    if args.json {
        let object = json!({
            "machine": name,
            "connections": report.connections,
            "sessions": report.sessions,
            "cycles": report.cycles,
            "lost_frames": report.lost_frames,
            "short_frames": report.short_frames,
        });
        writeln!(out, "{object}").map_err(failed)?;
    } else {
        writeln!(
            err,
            "{} cycles, {} frames lost, {} short",
            report.cycles, report.lost_frames, report.short_frames
        )
        .map_err(failed)?;
    }
    Ok(Ending::Clean)
}
