//! `evolvent run`.

use std::io::{self, IsTerminal, Write};
use std::path::PathBuf;
use std::sync::Arc;

use clap::{Args, ValueEnum};
use evolvent_config::check_outputs;
use evolvent_machine::PlannerKind;
use evolvent_runtime::{
    Alarm, CheckBounds, Clock, Controls, Job, Outcome, RunOutcome, Setup, StartError, state_folder,
};
use evolvent_screen::ScreenScope;
use evolvent_turning::AdaptiveSettings;

use crate::check::write_text;
use crate::operator::{resume_on_enter, watch_signals};
use crate::program::{ProgramArgs, default_trace, parse_override};
use crate::screen::{Screen, write_summary};
use crate::screen_args::{ScreenArgs, write_screen};
use crate::{CommandError, Ending};

/// Options of `evolvent run`.
#[derive(Debug, Args)]
pub(crate) struct RunArgs {
    #[command(flatten)]
    program: ProgramArgs,
    /// Clock: real time, or virtual, as fast as the host computes, with bit-identical positions and without
    /// saving tools and parameters.
    #[arg(long, value_enum, default_value_t = ClockArg::Realtime)]
    clock: ClockArg,
    /// Trace file. Default: traces/NAME-TIME.mcap.
    #[arg(long, value_name = "FILE.mcap", conflicts_with = "no_trace")]
    trace: Option<PathBuf>,
    /// Do not write a trace.
    #[arg(long)]
    no_trace: bool,
    /// Do not open the bus (iceoryx2).
    #[arg(long)]
    no_bus: bool,
    /// Prefix of the bus's files: cores and clients with different prefixes do not see each other.
    #[arg(long, value_name = "PREFIX")]
    bus_prefix: Option<String>,
    /// Wait up to 10 s until this many clients subscribe to setpoints.
    #[arg(long, value_name = "N", default_value_t = 0)]
    wait_for_clients: usize,
    /// Feed override in percent, 1 to 200.
    #[arg(long = "override", value_name = "PCT", value_parser = parse_override, default_value = "100")]
    feed_override: f64,
    /// File of changes of the machine's inputs, for the virtual clock. Without it no input is known, so M66
    /// ends by its timeout, and an emergency-stop chain is closed.
    #[arg(long, value_name = "FILE.toml")]
    inputs: Option<PathBuf>,
    /// Stop at M1.
    #[arg(long)]
    optional_stop: bool,
    /// Control the feed for a constant cutting load, with the tool settings of this file. In real time the
    /// load comes from the bus; with the virtual clock the stock of --process is cut. Uses the classic
    /// planner, with which the feed reacts in the same cycle.
    #[arg(long, value_name = "FILE.toml", conflicts_with_all = ["no_bus", "planner"])]
    adaptive: Option<PathBuf>,
    /// The cutting process, for turning cycles with Q1, which compute their passes from the cutting load: a
    /// process file of `evolvent turn`. In real time the load comes from the bus; with the virtual clock the
    /// file's stock is cut.
    #[arg(long, value_name = "FILE.toml")]
    process: Option<PathBuf>,
    /// Do not check the program first; a program with an error then runs up to the line before it.
    #[arg(long)]
    unchecked: bool,
    #[command(flatten)]
    browser: ScreenArgs,
    /// Print the summary as one JSON object.
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum ClockArg {
    Realtime,
    Virtual,
}

pub(crate) fn run(args: &RunArgs, out: &mut dyn Write, err: &mut dyn Write) -> Result<Ending, CommandError> {
    if args.browser.is_wanted() && (args.no_bus || args.clock == ClockArg::Virtual) {
        return Err(CommandError::Usage(
            "--screen needs the bus and real time: omit --no-bus and --clock virtual".to_owned(),
        ));
    }
    let mut setup = args.program.setup()?;
    crate::program::warn_of_machine(&setup, err);
    let adaptive = adaptive_settings(args, &mut setup)?;
    let clock = match args.clock {
        ClockArg::Realtime => Clock::Realtime,
        ClockArg::Virtual => Clock::Virtual,
    };
    if let Some(file) = &args.process {
        evolvent_analysis::install_process_file(&mut setup, file, clock)?;
    }
    let stop_at_program_stops = clock == Clock::Realtime && io::stdin().is_terminal();
    if !args.unchecked {
        refuse_wrong_program(args, &setup, clock, out, err)?;
    }
    let inputs = match (&args.inputs, clock) {
        (Some(file), Clock::Realtime) => {
            return Err(CommandError::Usage(format!(
                "{}: in real time inputs come from a bridge: omit --inputs, or use --clock virtual",
                file.display()
            )));
        }
        (file, _) => crate::program::inputs(file.as_deref(), &setup.machine)?,
    };
    let trace = trace_file(args, &setup)?;
    if clock == Clock::Realtime {
        let state = state_folder(&setup.machine.name);
        setup = setup.logging(&state);
    }
    args.program.tell_start(&setup, err)?;
    let job = Job {
        program: args.program.program.clone(),
        setup,
        clock,
        feed_override: args.feed_override,
        trace,
        bus: !args.no_bus,
        bus_prefix: args.bus_prefix.clone(),
        wait_for_subscribers: args.wait_for_clients,
        own_subscribers: usize::from(args.browser.is_wanted()),
        inputs,
        optional_stop: args.optional_stop,
        stop_at_program_stops,
    };
    let controls = Controls::new(args.feed_override);
    let controls = Arc::new(match adaptive {
        Some(settings) => controls.with_adaptive_feed(settings),
        None => controls,
    });
    watch_signals(&controls)?;
    let scope = ScreenScope::Watch {
        program: job.program.clone(),
    };
    let browser = args.browser.start(&job.setup, job.bus_prefix.as_ref(), scope)?;
    if let Some(browser) = &browser {
        // If standard error is closed, nobody is left to inform.
        drop(write_screen(err, browser));
    }
    if stop_at_program_stops {
        resume_on_enter(&controls);
    }
    let mut screen = Screen::new(&job.program, args.json, stop_at_program_stops);
    let result = evolvent_runtime::run(&job, &controls, &mut screen, |_| {});
    screen.finish();
    let kept = result.as_ref().map_or(Ok(()), |outcome| keep(&job, outcome));
    let outcome = result.map_err(|error| match error {
        StartError::Bus(_) | StartError::BusTimeout => {
            CommandError::Failed(format!("{error} (or run without a bus: --no-bus)"))
        }
        other => CommandError::Failed(other.to_string()),
    })?;
    let ending = report(args.json, &outcome, out, err)?;
    kept.map(|()| ending)
}

/// Adaptive feed, if it is requested and compatible with the other options.
fn adaptive_settings(args: &RunArgs, setup: &mut Setup) -> Result<Option<AdaptiveSettings>, CommandError> {
    Ok(match &args.adaptive {
        None => None,
        Some(file) if args.clock == ClockArg::Virtual && args.process.is_none() => {
            return Err(CommandError::Usage(format!(
                "{}: with the virtual clock no sensor measures a load: give a process file with a [stock] \
                 to cut (--process), or omit --clock virtual",
                file.display()
            )));
        }
        Some(file) if args.clock == ClockArg::Realtime && args.process.is_some() => {
            return Err(CommandError::Usage(format!(
                "{}: in real time adaptive feed and load-adaptive passes cannot be combined: omit --process \
                 or --adaptive",
                file.display()
            )));
        }
        Some(file) => {
            setup.machine.path.planner = PlannerKind::Classic;
            Some(evolvent_analysis::read_adaptive(file, setup.period_ns)?)
        }
    })
}

/// The trace file, in a folder that exists; `None` without a trace.
fn trace_file(args: &RunArgs, setup: &Setup) -> Result<Option<PathBuf>, CommandError> {
    let trace = if args.no_trace {
        None
    } else {
        Some(
            args.trace
                .clone()
                .unwrap_or_else(|| default_trace(&args.program.program)),
        )
    };
    let mut inputs = args.program.inputs(setup);
    for (file, what) in [
        (&args.inputs, "the file of inputs"),
        (&args.adaptive, "the adaptive file"),
        (&args.process, "the process file"),
    ] {
        inputs.extend(file.as_deref().map(|file| (file, what)));
    }
    check_outputs(trace.as_deref(), inputs)?;
    if let Some(folder) = trace.as_ref().and_then(|path| path.parent())
        && !folder.as_os_str().is_empty()
    {
        std::fs::create_dir_all(folder).map_err(|error| {
            CommandError::Failed(format!(
                "{}: {error}; choose another file with --trace",
                folder.display()
            ))
        })?;
    }
    Ok(trace)
}

/// Maximum number of errors shown when a program should run.
const ERRORS_SHOWN: usize = 10;

/// Rejects a program with a known error before anything moves.
fn refuse_wrong_program(
    args: &RunArgs,
    setup: &Setup,
    clock: Clock,
    out: &mut dyn Write,
    err: &mut dyn Write,
) -> Result<(), CommandError> {
    let file = &args.program.program;
    let name = file.display().to_string();
    let mut bounds = CheckBounds::while_one_waits(ERRORS_SHOWN);
    // With the virtual clock, user-defined M codes are not carried out.
    bounds.user_codes = clock == Clock::Realtime;
    bounds.confirms_tools = clock == Clock::Virtual || io::stdin().is_terminal();
    let found = evolvent_runtime::check(file, setup, bounds)
        .map_err(|error| CommandError::Usage(format!("{name}: {error}; give a readable part program")))?;
    let Some(first) = found.errors.first() else {
        if let Some(unchecked) = &found.unchecked {
            // If standard error is closed, nobody is left to inform.
            drop(writeln!(
                err,
                "warning: {name} was {unchecked}; an error after that stops the run there, so check it with \
                 `evolvent check` first"
            ));
        }
        return Ok(());
    };
    let written = if args.json {
        let refused = serde_json::json!({
            "program": name,
            "outcome": "failed",
            "alarm": Alarm::Program.number(),
            "error": first.render(&name),
            "errors": found.errors,
            "cycles": 0,
        });
        writeln!(out, "{refused}")
    } else {
        write_text(err, &name, &found, io::stderr().is_terminal())
    };
    written.map_err(|error| CommandError::Failed(format!("the errors cannot be written: {error}")))?;
    Err(CommandError::Failed(format!(
        "{name} has errors, so nothing was moved; --unchecked runs it up to line {}",
        first.line
    )))
}

/// Writes the program's changes to tools and parameters. A program that did not reach its end writes none,
/// because it was interpreted ahead of the machine. Neither does a run with the virtual clock, because no
/// machine has measured its contacts and lengths.
fn keep(job: &Job, outcome: &RunOutcome) -> Result<(), CommandError> {
    let Some(left) = outcome
        .left
        .as_ref()
        .filter(|_| job.clock == Clock::Realtime && outcome.summary.outcome == Outcome::Done)
    else {
        return Ok(());
    };
    let saved = left.save(&job.setup.memory);
    saved
        .map(drop)
        .map_err(|error| CommandError::Failed(error.to_string()))
}

/// Writes summary and errors, and returns the resulting exit code.
pub(crate) fn report(
    json: bool,
    outcome: &RunOutcome,
    out: &mut dyn Write,
    err: &mut dyn Write,
) -> Result<Ending, CommandError> {
    let summary = &outcome.summary;
    let written = if json {
        serde_json::to_string(summary)
            .map_err(io::Error::from)
            .and_then(|text| writeln!(out, "{text}"))
    } else {
        write_summary(out, summary)
    };
    written.map_err(|error| CommandError::Failed(format!("the summary cannot be written: {error}")))?;
    if let Some(error) = &outcome.trace_error {
        // The run itself continued; the exit code shows that data was lost.
        drop(writeln!(err, "warning: {error}"));
    }
    if let Some(fault) = &outcome.fault {
        return Err(CommandError::Failed(fault.clone()));
    }
    if let Err(error) = &outcome.program {
        if summary.outcome == Outcome::Stopped {
            drop(writeln!(
                err,
                "the run was stopped; a later line of the program has an error"
            ));
        }
        return Err(CommandError::Failed(error.to_string()));
    }
    if summary.outcome != Outcome::Done {
        return Err(CommandError::Failed(
            "the run was stopped before the program's end".to_owned(),
        ));
    }
    let lossy = outcome.trace_error.is_some() || summary.is_lossy();
    Ok(if lossy { Ending::Lossy } else { Ending::Clean })
}
