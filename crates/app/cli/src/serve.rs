//! `evolvent serve`.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use clap::Args;
use evolvent_analysis::{load_setup, sort_process_files};
use evolvent_config::check_outputs;
use evolvent_machine::ControlRate;
use evolvent_runtime::{
    Clock, ProgramMemory, ServeConfig, ServeNews, ServeSummary, Setup, StartError, TraceTo, serve,
    state_folder,
};
use evolvent_screen::ScreenScope;

use crate::program::parse_rate;
use crate::screen_args::{OperateArgs, ScreenArgs, write_screen};
use crate::signals::{ignore_suspension, stop_at_first};
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
    /// Trace the whole session to one file of any size. Default: a file every hour in --trace-folder.
    #[arg(long, value_name = "FILE.mcap", conflicts_with_all = ["no_trace", "trace_folder", "trace_limit"])]
    trace: Option<PathBuf>,
    /// Do not write a trace.
    #[arg(long, conflicts_with_all = ["trace_folder", "trace_limit"])]
    no_trace: bool,
    /// Folder for traces: a new file every hour while nothing moves. Default: traces in the state folder.
    #[arg(long, value_name = "FOLDER")]
    trace_folder: Option<PathBuf>,
    /// Maximum total size of this machine's traces in that folder: the oldest are removed.
    #[arg(long, value_name = "GIB", value_parser = parse_gib, default_value = "10")]
    trace_limit: u64,
    /// Prefix of the bus's files: cores and clients with different prefixes do not see each other.
    #[arg(long, value_name = "PREFIX")]
    bus_prefix: Option<String>,
    /// Folder for offsets, tools and parameters. Default: $XDG_STATE_HOME/evolvent/NAME.
    #[arg(long, value_name = "FOLDER")]
    state: Option<PathBuf>,
    /// The cutting process. A process file of `evolvent turn`: for turning cycles with Q1, which compute
    /// their passes from the cutting load on the bus. A case file of `evolvent chatter`: its limits are shown
    /// on the screen. May be given once for each.
    #[arg(long, value_name = "FILE.toml")]
    process: Vec<PathBuf>,
    #[command(flatten)]
    screen: ScreenArgs,
    #[command(flatten)]
    operate: OperateArgs,
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
    crate::program::warn_of_machine(&setup, err);
    check_trace(args, &setup.memory)?;
    let chatter = sort_process_files(&mut setup, &args.process, Clock::Realtime)?.map(Path::to_path_buf);
    if chatter.is_some() && !args.screen.is_wanted() {
        return Err(CommandError::Usage(
            "a case file of chatter is for the screen: add --screen, or omit it".to_owned(),
        ));
    }
    let state = args
        .state
        .clone()
        .unwrap_or_else(|| state_folder(&setup.machine.name));
    let setup = setup.logging(&state);
    let config = ServeConfig {
        bus_prefix: args.bus_prefix.clone(),
        trace: match &args.trace {
            Some(file) => TraceTo::File(file.clone()),
            None if args.no_trace => TraceTo::Nowhere,
            None => TraceTo::Folder {
                folder: args.trace_folder.clone().unwrap_or_else(|| state.join("traces")),
                limit_bytes: args.trace_limit,
            },
        },
        state_folder: state,
        setup,
    };
    let stop = Arc::new(AtomicBool::new(false));
    ignore_suspension()?;
    let stopped = Arc::clone(&stop);
    stop_at_first(move || stopped.store(true, Ordering::Relaxed))?;
    let scope = ScreenScope::Operate {
        state_folder: config.state_folder.clone(),
        traces: config.trace.clone(),
        macros: args.operate.macros.clone(),
        chatter,
    };
    let screen = args
        .screen
        .start(&config.setup, config.bus_prefix.as_ref(), scope)?;
    let summary = serve(&config, &stop, |news| {
        // If standard error is closed, nobody is left to inform.
        drop(match news {
            ServeNews::Note(text) => writeln!(err, "note: {text}"),
            ServeNews::Ready(trace) => write_ready(err, &config, trace).and_then(|()| match &screen {
                Some(screen) => write_screen(err, screen),
                None => Ok(()),
            }),
        });
    })
    .map_err(|error| match (&error, &config.trace) {
        (StartError::Trace(_), TraceTo::Folder { .. }) => CommandError::Failed(format!(
            "{error}; choose another folder with --trace-folder, or use --no-trace"
        )),
        _ => CommandError::Failed(error.to_string()),
    })?;
    report(args.json, &summary, out)
}

/// Ensures that the trace does not replace an input file.
fn check_trace(args: &ServeArgs, memory: &ProgramMemory) -> Result<(), CommandError> {
    let inputs = [
        (Some(args.machine.as_path()), "the machine file"),
        (memory.tools_file.as_deref(), "the tool table"),
        (memory.kept_file.as_deref(), "the parameter file"),
        (args.operate.macros.as_deref(), "the file of macros"),
    ];
    let inputs = inputs.into_iter().filter_map(|(file, what)| Some((file?, what)));
    let processes = args.process.iter().map(|file| (file.as_path(), "a process file"));
    Ok(check_outputs(args.trace.as_deref(), inputs.chain(processes))?)
}

/// A limit of the traces in GiB, as bytes.
fn parse_gib(text: &str) -> Result<u64, String> {
    match text.parse::<f64>() {
        // One file takes at most a quarter of the limit.
        Ok(gib) if (0.01..=1e6).contains(&gib) => Ok((gib * f64::from(1 << 30)) as u64),
        _ => Err("give a size in GiB from 0.01 to 1000000".to_owned()),
    }
}

/// Prints what is served, and the next steps.
fn write_ready(err: &mut dyn Write, config: &ServeConfig, trace: Option<&Path>) -> std::io::Result<()> {
    let machine = &config.setup.machine;
    let axes: String = machine.axes.iter().map(|axis| axis.letter.letter()).collect();
    writeln!(
        err,
        "serving {}: axes {axes}, {:.2} Hz, state in {}",
        machine.name,
        config.setup.rate_hz(),
        config.state_folder.display()
    )?;
    match (&config.trace, trace) {
        (TraceTo::Folder { limit_bytes, .. }, Some(file)) => writeln!(
            err,
            "recording to {}; a new file every hour, at most {:.2} GiB",
            file.display(),
            *limit_bytes as f64 / f64::from(1 << 30)
        )?,
        (_, Some(file)) => writeln!(err, "recording to {}", file.display())?,
        (_, None) => writeln!(err, "not recording")?,
    }
    let mut bus = String::new();
    if let Some(prefix) = &config.bus_prefix {
        bus = format!(" --bus-prefix {prefix}");
    }
    let name = &machine.name;
    writeln!(
        err,
        "next: `evolvent ctl --machine-name {name}{bus} up` leaves the emergency stop and switches on; \
         `evolvent top {name}{bus}` shows the machine;"
    )?;
    writeln!(
        err,
        "      `evolvent bridge sim --machine-name {name}{bus}` simulates drives; Ctrl-C stops within the \
         limits and ends"
    )
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
    if let Some(clock) = &summary.clock {
        writeln!(
            out,
            "  drives' clock: drift {:.2} ppm ({:.2} to {:.2}); phase error mean {:.2}, scatter {:.2}, p50 \
             {:.2}, p99.9 {:.2}, max {:.2} us",
            clock.drift_ppm,
            clock.drift_min_ppm,
            clock.drift_max_ppm,
            clock.phase_mean_ns * 1e-3,
            clock.phase_scatter_ns * 1e-3,
            clock.phase_p50_ns as f64 * 1e-3,
            clock.phase_p999_ns as f64 * 1e-3,
            clock.phase_max_ns as f64 * 1e-3
        )?;
    }
    if let Some(trace) = &summary.trace {
        writeln!(out, "  trace {trace}")?;
    }
    Ok(())
}
