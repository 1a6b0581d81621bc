//! `evolvent bridge mesa`: a Mesa Ethernet board as the axes of a machine.

use std::io::Write;
use std::net::IpAddr;
use std::path::PathBuf;

use clap::Args;
use evolvent_bus::BusError;
use evolvent_machine::Machine;
use evolvent_mesa::{BoardSettings, BridgeError, Link, RunSettings, check_fit, fit_notes, run as run_bridge};
use serde_json::json;

use crate::bridge::{duration_of, ending_of_bridge, stop_on_signals};
use crate::output::written;
use crate::{CommandError, Ending};

/// Options of `evolvent bridge mesa`.
///
/// The bridge waits for the core and the board in any order and outlives both. It drops every capability once
/// its threads have their priority. It has been tested with a simulated board only: see docs/mesa.md.
#[derive(Args, Debug)]
pub(crate) struct MesaArgs {
    /// Machine file: name, axes and limits, as for the core.
    #[arg(long, value_name = "FILE", required_unless_present = "describe")]
    machine: Option<PathBuf>,
    /// Board file: the generators and encoders of each axis, and the pins.
    #[arg(long, value_name = "FILE", required_unless_present = "describe")]
    board: Option<PathBuf>,
    /// Print modules and pins of the board at an address, and end; nothing is written to it.
    #[arg(long, value_name = "ADDRESS", conflicts_with_all = ["machine", "board", "machine_name", "bus_prefix", "seconds", "json"])]
    describe: Option<IpAddr>,
    /// Address of the board, instead of the board file's.
    #[arg(long, value_name = "ADDRESS")]
    address: Option<IpAddr>,
    /// Name on the bus, instead of the machine file's.
    #[arg(long, value_name = "NAME")]
    machine_name: Option<String>,
    /// Prefix of the bus's files, as for the core.
    #[arg(long, value_name = "PREFIX")]
    bus_prefix: Option<String>,
    /// End after this many seconds; without it, at Ctrl-C. The exit code is 1 if the board did not come up in
    /// that time.
    #[arg(long, value_name = "N")]
    seconds: Option<f64>,
    /// Print one JSON object at the end.
    #[arg(long)]
    json: bool,
}

fn describe(address: IpAddr, out: &mut dyn Write) -> Result<Ending, CommandError> {
    let board = Link::open(address)
        .and_then(|link| link.explore())
        .map_err(|error| CommandError::Failed(error.to_string()))?;
    written(write!(out, "{}", board.text()))?;
    Ok(Ending::Clean)
}

pub(crate) fn run(args: &MesaArgs, out: &mut dyn Write, err: &mut dyn Write) -> Result<Ending, CommandError> {
    let usage = |text: String| CommandError::Usage(text);
    if let Some(address) = args.describe {
        return describe(address, out);
    }
    let (Some(machine_path), Some(board_path)) = (&args.machine, &args.board) else {
        return Err(usage(
            "--machine and --board are required: give both, or use --describe".to_owned(),
        ));
    };
    let machine = Machine::load(machine_path).map_err(|error| usage(error.to_string()))?;
    let mut board = BoardSettings::load(board_path).map_err(|error| usage(error.to_string()))?;
    check_fit(&machine, &board).map_err(|error| usage(format!("{}: {error}", board_path.display())))?;
    for note in fit_notes(&machine, &board) {
        written(writeln!(err, "note: {note}"))?;
    }
    board.address = args.address.unwrap_or(board.address);
    let settings = RunSettings {
        machine,
        machine_name: args.machine_name.clone(),
        board,
        prefix: args.bus_prefix.clone(),
        duration: duration_of(args.seconds)?,
    };
    let stop = stop_on_signals()?;
    let name = settings
        .machine_name
        .as_ref()
        .unwrap_or(&settings.machine.name)
        .clone();
    let report = run_bridge(&settings, &stop, |text| {
        // If standard error is closed, nobody is left to inform.
        let _told = writeln!(err, "{text}");
    });
    let report = report.map_err(|error| match error {
        BridgeError::Bus(BusError::Name(_) | BusError::Prefix { .. }) => usage(error.to_string()),
        // A core with other axes may be replaced with the right one: systemd units start the bridge again.
        error => CommandError::Failed(error.to_string()),
    })?;
    if args.json {
        let object = json!({
            "machine": name,
            "connections": report.connections,
            "sessions": report.sessions,
            "ready": report.ready,
            "cycles": report.cycles,
            "lost_replies": report.lost_replies,
            "lost_writes": report.lost_writes,
            "stale_replies": report.stale_replies,
        });
        written(writeln!(out, "{object}"))?;
    } else {
        written(writeln!(
            err,
            "{} cycles, {} replies lost, {} writes lost, {} replies too late",
            report.cycles, report.lost_replies, report.lost_writes, report.stale_replies
        ))?;
    }
    let reached = (report.connections, report.ready);
    ending_of_bridge(args.seconds, &stop, reached, "the board", err)
}
