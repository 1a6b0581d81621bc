//! `evolvent bridge test`: the cases that every drive bridge must pass.

use std::io::Write;
use std::path::Path;
use std::time::{Instant, SystemTime, UNIX_EPOCH};

use clap::Args;
use evolvent_bridge_test::{
    BridgeUnderTest, CASES, Case, CaseError, Outcome, Part, ProcessBridge, SIMULATED_PROBE, Stage,
    ThreadBridge, run_case,
};
use serde_json::{Value, json};

use crate::bridge::stop_on_signals;
use crate::output::written;
use crate::{CommandError, Ending};

#[derive(Args, Debug)]
pub(crate) struct TestArgs {
    /// Run only the case of this name, or the cases whose name contains it.
    #[arg(long, value_name = "WORD")]
    only: Option<String>,
    /// Number of random moments for each case that uses them.
    #[arg(long, value_name = "N", default_value_t = 3)]
    moments: u32,
    /// Seed of the random moments.
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Test the simulated bridge in this process instead of a command.
    #[arg(long, conflicts_with = "command")]
    in_process: bool,
    /// Run the cases of signals too: the bridge reads inputs and sets outputs, and its digital output 0 is
    /// wired to its digital input 0.
    #[arg(long)]
    signals: bool,
    /// Run the cases of a spindle too: the bridge sends the angle of spindle 0, which TURNS AT 300 RPM in
    /// both directions.
    #[arg(long)]
    spindle: bool,
    /// Run the case of a touch probe too: the FIRST AXIS MOVES in its positive direction, at 0.5 and at 3
    /// mm/s, until the probe touches a surface 1 to 4 mm away, and about 1 mm beyond.
    #[arg(long)]
    probe: bool,
    /// List the cases and their requirements.
    #[arg(long)]
    list: bool,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
    /// The command of the bridge.
    #[arg(last = true, value_name = "COMMAND")]
    command: Vec<String>,
}

pub(crate) fn run(args: &TestArgs, out: &mut dyn Write, err: &mut dyn Write) -> Result<Ending, CommandError> {
    let cases = selected_cases(args.only.as_deref())?;
    if args.list {
        for case in cases {
            written(writeln!(out, "{:<16} {}", case.name, case.demand))?;
        }
        return Ok(Ending::Clean);
    }
    let program = std::env::current_exe().ok();
    let mut process;
    let mut thread;
    let bridge: &mut dyn BridgeUnderTest = if args.in_process {
        thread = ThreadBridge::simulated();
        &mut thread
    } else {
        process = ProcessBridge::new(command_under_test(args, program.as_deref()));
        &mut process
    };
    let now = SystemTime::now().duration_since(UNIX_EPOCH);
    let seed = args
        .seed
        .unwrap_or_else(|| now.map_or(1, |since| since.as_nanos() as u64));
    let parts = tested_parts(args);
    let mut stage = Stage {
        bridge,
        machine_name: "bridge-test".to_owned(),
        prefix: format!("bt{}_", std::process::id()),
        core_program: program,
        seed: seed | 1,
        moments: args.moments,
        parts: &parts,
        stop: stop_on_signals()?,
    };
    let mut tally = SuiteTally::default();
    for case in cases {
        let begin = Instant::now();
        let (verdict, why) = tally.count(run_case(case, &mut stage));
        let seconds = begin.elapsed().as_secs_f64();
        if args.json {
            tally.results.push(json!({
                "case": case.name,
                "demand": case.demand,
                "verdict": verdict.to_lowercase(),
                "why": why,
                "seconds": seconds,
            }));
        } else {
            written(writeln!(
                out,
                "{verdict:<12}  {:<16} {} ({seconds:.1} s)",
                case.name, case.demand
            ))?;
            if let Some(why) = why {
                written(writeln!(out, "              {why}"))?;
            }
        }
        if tally.stopped {
            break;
        }
    }
    tally.report(args.json, seed, out, err)
}

/// The command under test; the simulated bridge if none is given.
fn command_under_test(args: &TestArgs, program: Option<&Path>) -> Vec<String> {
    let mut command = args.command.clone();
    if command.is_empty()
        && let Some(program) = program
    {
        command = [
            "bridge",
            "sim",
            "--machine-name",
            "{name}",
            "--bus-prefix",
            "{prefix}",
            "--loopback",
            "--probe",
            SIMULATED_PROBE,
        ]
        .map(str::to_owned)
        .to_vec();
        command.insert(0, program.display().to_string());
    }
    command
}

/// The case of this name, or the cases whose name contains the word.
fn selected_cases(only: Option<&str>) -> Result<Vec<&'static Case>, CommandError> {
    let exact = CASES.iter().any(|case| only == Some(case.name));
    let is_wanted = |name: &str| match only {
        None => true,
        Some(word) if exact => name == word,
        Some(word) => name.contains(word),
    };
    let cases: Vec<_> = CASES.iter().filter(|case| is_wanted(case.name)).collect();
    if cases.is_empty() {
        return Err(CommandError::Usage(
            "no case has this name: see --list".to_owned(),
        ));
    }
    Ok(cases)
}

/// The parts of a bridge that are tested; the simulated bridge supports all of them.
fn tested_parts(args: &TestArgs) -> Vec<Part> {
    let is_simulated = args.command.is_empty();
    [
        (Part::Signals, args.signals),
        (Part::Spindle, args.spindle),
        (Part::Probe, args.probe),
    ]
    .into_iter()
    .filter_map(|(part, is_asked)| (is_asked || is_simulated).then_some(part))
    .collect()
}

/// The outcomes of the cases so far.
#[derive(Default)]
struct SuiteTally {
    failed: u32,
    unmeasured: u32,
    stopped: bool,
    /// One object for each case, for `--json`.
    results: Vec<Value>,
}

impl SuiteTally {
    /// Counts a case. Returns its verdict and the reason for it.
    fn count(&mut self, outcome: Result<Outcome, CaseError>) -> (&'static str, Option<String>) {
        match outcome {
            Ok(Outcome::Passed) => ("passed", None),
            Ok(Outcome::LeftOut(why)) => ("left out", Some(why)),
            Ok(Outcome::NotMeasured(why)) => {
                self.unmeasured += 1;
                ("not measured", Some(why))
            }
            Ok(Outcome::Stopped) => {
                self.stopped = true;
                ("stopped", None)
            }
            Err(error) => {
                self.failed += 1;
                ("FAILED", Some(error.to_string()))
            }
        }
    }

    fn report(
        &self,
        as_json: bool,
        seed: u64,
        out: &mut dyn Write,
        err: &mut dyn Write,
    ) -> Result<Ending, CommandError> {
        let Self {
            failed,
            unmeasured,
            stopped,
            results,
        } = self;
        if as_json {
            let object =
                json!({ "seed": seed, "failed": failed, "not_measured": unmeasured, "cases": results });
            written(writeln!(out, "{object}"))?;
        }
        if *stopped {
            written(writeln!(err, "stopped by a signal; the bridge has ended"))?;
        }
        if *failed > 0 && !as_json {
            written(writeln!(
                err,
                "{failed} failed; --seed {seed} repeats the random moments"
            ))?;
        }
        if *unmeasured > 0 {
            written(writeln!(
                err,
                "{unmeasured} not measured: this host kept the bridge from running; test again while it is \
                 less busy"
            ))?;
        }
        Ok(if *failed > 0 || *stopped {
            Ending::Negative
        } else if *unmeasured > 0 {
            Ending::Incomplete
        } else {
            Ending::Clean
        })
    }
}
