//! `evolvent trace replay`.

use std::io::{self, Write};
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::time::Duration;

use clap::Args;
use evolvent_replay::{Pace, Replay, ReplayError, replay};

use super::export::PartArgs;
use super::{inspect_error, write_error};
use crate::{CommandError, Ending};

/// Poll interval of requests to end while no line arrives.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// Options of `evolvent trace replay`.
#[derive(Debug, Args)]
pub(super) struct ReplayArgs {
    /// The trace, NAME.mcap.
    file: PathBuf,
    #[command(flatten)]
    part: PartArgs,
    /// Speed relative to real time, 0.001 to 1000.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, conflicts_with = "step")]
    speed: f64,
    /// Publish one setpoint per line on standard input; a number publishes that many, `q` or Ctrl-C ends.
    #[arg(long)]
    step: bool,
    /// The name on the bus. Default: the recorded machine's.
    #[arg(long = "as", value_name = "NAME")]
    machine_name: Option<String>,
    /// Prefix of the bus's files.
    #[arg(long, value_name = "PREFIX")]
    bus_prefix: Option<String>,
    /// Wait up to 10 s until this many clients subscribe to setpoints.
    #[arg(long, value_name = "N", default_value_t = 0)]
    wait_for_clients: usize,
    /// Publish even to drives that are on; requires --yes-machine-is-on.
    #[arg(long, requires = "yes_machine_is_on")]
    force: bool,
    /// Confirms --force.
    #[arg(long, requires = "force")]
    yes_machine_is_on: bool,
    /// Print one JSON object at the end.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(
    args: &ReplayArgs,
    out: &mut dyn Write,
    err: &mut dyn Write,
) -> Result<Ending, CommandError> {
    let options = Replay {
        selection: args.part.selection()?,
        pace: if args.step {
            Pace::Step
        } else {
            Pace::Factor(args.speed)
        },
        machine_name: args.machine_name.clone(),
        bus_prefix: args.bus_prefix.clone(),
        wait_for_subscribers: args.wait_for_clients,
        force: args.force,
        machine_is_on: args.yes_machine_is_on,
    };
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
        signal_hook::flag::register(signal, Arc::clone(&stop))
            .map_err(|error| CommandError::Failed(format!("signals cannot be watched: {error}")))?;
    }
    let lines = args.step.then(lines_of_input);
    let replayed = replay(
        &args.file,
        &options,
        |record| {
            // Standard error may be closed.
            drop(writeln!(
                err,
                "cycle {}, line {}, feed {:.3} mm/s; Enter for the next cycle, N for the next N cycles, q to \
                 end",
                record.sequence, record.line, record.feed_mm_s
            ));
            match lines.as_ref().and_then(|lines| next_line(lines, &stop)) {
                Some(line) if line.trim() == "q" => ControlFlow::Break(()),
                Some(line) => ControlFlow::Continue(line.trim().parse().unwrap_or(1)),
                None => ControlFlow::Break(()),
            }
        },
        || stop.load(Ordering::Relaxed),
    )
    .map_err(|error| match &error {
        ReplayError::Inspect(error) => inspect_error(error),
        ReplayError::Pace(_) | ReplayError::Nothing => CommandError::Usage(error.to_string()),
        other => CommandError::Failed(other.to_string()),
    })?;
    let written = if args.json {
        serde_json::to_string(&replayed)
            .map_err(io::Error::from)
            .and_then(|text| writeln!(out, "{text}"))
    } else if replayed.setpoints == 0 {
        writeln!(out, "ended before the first setpoint: nothing was published")
    } else {
        let ended = if replayed.stopped { "ended early: " } else { "" };
        writeln!(
            out,
            "{ended}{} setpoints, cycles {} to {}, in {:.3} s; {} clients listened",
            replayed.setpoints,
            replayed.first_sequence,
            replayed.last_sequence,
            replayed.seconds,
            replayed.subscribers
        )
    };
    written.map_err(write_error)?;
    Ok(Ending::Clean)
}

/// The lines of standard input, read by a separate thread, so that a request to end is noticed while no line
/// arrives.
fn lines_of_input() -> Receiver<String> {
    // One line ahead: further input stays in the pipe until its setpoint is due.
    let (sender, lines) = sync_channel(1);
    // The thread ends with the process or the input.
    std::thread::spawn(move || {
        for line in io::stdin().lines().map_while(Result::ok) {
            if sender.send(line).is_err() {
                break;
            }
        }
    });
    lines
}

/// The next line; `None` at the end of the input, or if the replay is to end.
fn next_line(lines: &Receiver<String>, stop: &AtomicBool) -> Option<String> {
    while !stop.load(Ordering::Relaxed) {
        match lines.recv_timeout(POLL_INTERVAL) {
            Ok(line) => return Some(line),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return None,
        }
    }
    None
}
