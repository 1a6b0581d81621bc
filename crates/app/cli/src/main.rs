//! The `evolvent` command.

mod bore;
mod bridge;
mod bridge_ethercat;
mod bridge_mesa;
mod bridge_test;
mod chatter;
mod check;
mod completions;
mod ctl;
mod ctl_answer;
mod ctl_args;
mod ctl_away;
mod ctl_io;
mod ctl_request;
mod ctl_session;
mod ctl_status;
mod doctor;
mod doctor_network;
mod finding_row;
mod import;
mod man;
mod operator;
mod output;
mod plan;
mod program;
mod rate;
mod run;
mod screen;
mod screen_args;
mod serve;
mod signal_watch;
mod signals;
mod terminal;
mod top;
mod trace;
mod turn;

use std::io::{self, Write};
use std::process::ExitCode;

use clap::{CommandFactory, Parser, Subcommand};
use evolvent_analysis::AnalysisError;
use evolvent_config::OutputConflict;

/// A real-time CNC core: part programs to setpoints in shared memory, with every cycle recorded.
///
/// Exit codes: 0 done; 1 the program or the run failed; 2 wrong usage or configuration; 3 done, but data was
/// lost (trace), setpoints were late, a part of the program was not checked (check), or a case could not be
/// measured (bridge test).
#[derive(Debug, Parser)]
#[command(version, propagate_version = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Run a part program: progress, setpoints on the bus, a trace, a summary at the end.
    #[command(allow_negative_numbers = true)]
    Run(run::RunArgs),
    /// Plan a program without running it: time, limits reached, required control rate.
    #[command(allow_negative_numbers = true)]
    Plan(plan::PlanArgs),
    /// Check a program for errors without moving anything.
    #[command(allow_negative_numbers = true)]
    Check(check::CheckArgs),
    /// Compute the rational control rate of a machine.
    #[command(allow_negative_numbers = true)]
    Rate(rate::RateArgs),
    /// Write a part program that mills a hole along involutes.
    #[command(allow_negative_numbers = true)]
    Bore(bore::BoreArgs),
    /// Predict chatter: whether a cut vibrates, how strongly, and at which speeds it does not
    /// (self-oscillation, stability lobes).
    Chatter(chatter::ChatterArgs),
    /// Serve a machine: accept clients, jog, home, run programs. SIGTERM stops within the limits and ends.
    Serve(serve::ServeArgs),
    /// Operate a served machine.
    #[command(allow_negative_numbers = true)]
    Ctl(ctl_args::CtlArgs),
    /// Measure what this host can do for a real-time loop, and advise what to change.
    Doctor(doctor::DoctorArgs),
    /// Write a machine file from the configuration of another control.
    Import(import::ImportArgs),
    /// Run drive bridges: EtherCAT, Mesa boards, simulated drives; test a bridge.
    Bridge(bridge::BridgeArgs),
    /// Turn a step in load-adaptive passes, on a simulated workpiece.
    Turn(turn::TurnArgs),
    /// Show a running machine on the terminal: positions, feed, override, state, lateness, alarms.
    Top(top::TopArgs),
    /// Examine traces: info, report, export, verify, replay, compare, recover.
    #[command(allow_negative_numbers = true)]
    Trace(trace::TraceArgs),
    /// Write shell completions to standard output.
    Completions(completions::CompletionsArgs),
    /// Write the man pages of all commands into a folder.
    Man(man::ManArgs),
}

/// Why a command failed.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum CommandError {
    /// Wrong usage or configuration: exit code 2.
    Usage(String),
    /// The program or the run failed: exit code 1.
    Failed(String),
}

/// The ending of a command that did not fail.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Ending {
    /// Success: exit code 0.
    Clean,
    /// Done, and the result is negative: exit code 1. It has been reported.
    Negative,
    /// Done, but data was lost or setpoints were late: exit code 3.
    Lossy,
    /// Done without errors, but only for a part of the input: exit code 3. It has been reported.
    Incomplete,
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    let (mut out, mut err) = (output::Output::new(io::stdout()), io::stderr());
    let result = match &cli.command {
        Command::Run(args) => run::run(args, &mut out, &mut err),
        Command::Plan(args) => plan::run(args, &mut out, &mut err),
        Command::Check(args) => check::run(args, &mut out, &mut err),
        Command::Rate(args) => rate::run(args, &mut out, &mut err).map(|()| Ending::Clean),
        Command::Bore(args) => bore::run(args, &mut out).map(|()| Ending::Clean),
        Command::Chatter(args) => chatter::run(args, &mut out, &mut err),
        Command::Serve(args) => serve::run(args, &mut out, &mut err),
        Command::Ctl(args) => ctl::run(args, &mut out, &mut err),
        Command::Doctor(args) => doctor::run(args, &mut out, &mut err).map(|()| Ending::Clean),
        Command::Import(args) => import::run(args, &mut out),
        Command::Bridge(args) => bridge::run(args, &mut out, &mut err),
        Command::Turn(args) => turn::run(args, &mut out, &mut err),
        Command::Top(args) => top::run(args, &mut out),
        Command::Trace(args) => trace::run(args, &mut out, &mut err),
        Command::Completions(args) => completions::run(args, Cli::command(), &mut out),
        Command::Man(args) => man::run(args, Cli::command(), &mut out),
    };
    match result {
        Ok(Ending::Clean) => ExitCode::SUCCESS,
        Ok(Ending::Negative) => ExitCode::from(1),
        Ok(Ending::Lossy | Ending::Incomplete) => ExitCode::from(3),
        Err(CommandError::Usage(text)) => complain(&mut err, &text, 2),
        Err(CommandError::Failed(text)) => complain(&mut err, &text, 1),
    }
}

impl From<AnalysisError> for CommandError {
    fn from(error: AnalysisError) -> Self {
        match error {
            AnalysisError::Input(text) => Self::Usage(text),
            AnalysisError::Failed(text) => Self::Failed(text),
        }
    }
}

impl From<OutputConflict> for CommandError {
    fn from(conflict: OutputConflict) -> Self {
        Self::Usage(conflict.to_string())
    }
}

fn complain(err: &mut dyn Write, text: &str, code: u8) -> ExitCode {
    let text = text.trim_end();
    // Diagnostics of a program have their own heading.
    let result = if text.starts_with("error") {
        writeln!(err, "{text}")
    } else {
        writeln!(err, "error: {text}")
    };
    // If standard error is closed, nobody is left to inform.
    drop(result);
    ExitCode::from(code)
}
