//! `evolvent serve`.

use std::io::{IsTerminal, Write};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use clap::Args;
use evolvent_daemon::{
    Clock, ProgramMemory, ServeConfig, ServeSummary, Setup, StartError, serve, state_folder,
};
use evolvent_machine::ControlRate;

use crate::program::{load_setup, parse_rate};
use crate::{CommandError, Ending};

/// Options of `evolvent serve`.
#[derive(Debug, Args)]
pub(crate) struct ServeArgs {
    /// Machine file.
    #[arg(long, value_name = "FILE")]
    machine: PathBuf,
    /// Control rate: Hz, or `rational`. Default: the machine file's.
    #[arg(long, value_name = "HZ|rational", value_parser = parse_rate)]
    rate: Option<ControlRate>,
    /// Trace of the whole session. Default: none.
    #[arg(long, value_name = "FILE.mcap")]
    trace: Option<PathBuf>,
    /// Prefix of the bus's files: cores and clients of different prefixes do not see each other.
    #[arg(long, value_name = "PREFIX")]
    bus_prefix: Option<String>,
    /// Folder for offsets, tools and parameters. Default: $XDG_STATE_HOME/evolvent/NAME.
    #[arg(long, value_name = "FOLDER")]
    state: Option<PathBuf>,
    /// What the cut is like, for turning cycles with Q1, which find their passes from the cutting load on the bus: a file
    /// as of `evolvent turn`.
    #[arg(long, value_name = "FILE.toml")]
    process: Option<PathBuf>,
    /// Print the summary as one JSON object.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(
    args: &ServeArgs,
    out: &mut dyn Write,
    err: &mut dyn Write,
) -> Result<Ending, CommandError> {
    let mut setup: Setup = load_setup(&args.machine, args.rate)?;
    setup.memory = ProgramMemory::of_machine(&setup.machine, &args.machine)
        .map_err(|error| CommandError::Usage(error.to_string()))?;
    if let Some(file) = &args.process {
        crate::process::install_file(&mut setup, file, Clock::Realtime)?;
    }
    let config = ServeConfig {
        bus_prefix: args.bus_prefix.clone(),
        trace: args.trace.clone(),
        state_folder: args
            .state
            .clone()
            .unwrap_or_else(|| state_folder(&setup.machine.name)),
        setup,
    };
    let stop = Arc::new(AtomicBool::new(false));
    watch_signals(&stop)?;
    let name = config.setup.machine.name.clone();
    if std::io::stderr().is_terminal() {
        drop(writeln!(
            err,
            "serving {name}; Ctrl-C stops within the limits and ends"
        ));
    }
    let summary = serve(&config, &stop, |text| {
        drop(writeln!(err, "note: {text}"));
    })
    .map_err(|error| match error {
        StartError::Bus(_)
        | StartError::BusTimeout
        | StartError::DrivesRequired
        | StartError::Trace(_)
        | StartError::Thread(_) => CommandError::Failed(error.to_string()),
    })?;
    report(args.json, &summary, out)
}

fn report(json: bool, summary: &ServeSummary, out: &mut dyn Write) -> Result<Ending, CommandError> {
    let written = if json {
        serde_json::to_string(summary)
            .map_err(std::io::Error::from)
            .and_then(|text| writeln!(out, "{text}"))
    } else {
        write_summary(summary, out)
    };
    written.map_err(|error| CommandError::Failed(format!("the summary cannot be written: {error}")))?;
    let missed = summary.late_cycles > 0 && summary.listeners > 0;
    let lossy = missed || summary.dropped_records > 0 || summary.dropped_setpoints > 0;
    Ok(if lossy { Ending::Lossy } else { Ending::Clean })
}

fn write_summary(summary: &ServeSummary, out: &mut dyn Write) -> std::io::Result<()> {
    writeln!(
        out,
        "{}: {} setpoints at {:.2} Hz, {} jobs, {} commands accepted, {} rejected",
        summary.machine,
        summary.cycles,
        summary.rate_hz,
        summary.jobs,
        summary.commands_accepted,
        summary.commands_rejected
    )?;
    writeln!(
        out,
        "  late setpoints {}, lost records {}, lost setpoints {}",
        summary.late_cycles, summary.dropped_records, summary.dropped_setpoints
    )?;
    if let Some(trace) = &summary.trace {
        writeln!(out, "  trace {trace}")?;
    }
    Ok(())
}

/// The first signal stops within the limits and ends; the second ends at once.
fn watch_signals(stop: &Arc<AtomicBool>) -> Result<(), CommandError> {
    use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM, SIGTSTP};
    let failed = |error: std::io::Error| CommandError::Failed(format!("signals cannot be caught: {error}"));
    for signal in [SIGINT, SIGTERM] {
        // In this order: the first signal finds the flag unset.
        signal_hook::flag::register_conditional_shutdown(signal, 1, Arc::clone(stop)).map_err(failed)?;
        signal_hook::flag::register(signal, Arc::clone(stop)).map_err(failed)?;
    }
    // A terminal that goes away ends it too; Ctrl-Z does nothing, because it would freeze the axes wherever they are.
    signal_hook::flag::register(SIGHUP, Arc::clone(stop)).map_err(failed)?;
    signal_hook::flag::register(SIGTSTP, Arc::new(AtomicBool::new(false))).map_err(failed)?;
    Ok(())
}
