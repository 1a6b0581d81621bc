//! `evolvent doctor`: what this host can do, and what to change.

use std::io::{self, Write};
use std::net::IpAddr;
use std::time::Duration;

use clap::Args;
use evolvent_runtime::{BareLoopError, DoctorReport, examine};
use serde_json::{Value, json};

use crate::finding_row::{FindingRow, write_advice, write_findings};
use crate::output::written;
use crate::{CommandError, doctor_network};

/// Measure what this host can do for a real-time loop: scheduler, locked memory, timers, isolated cores, the
/// bus, lateness of wake-ups; with advice.
///
/// Run it as the user who runs the machine, on an otherwise idle host and again under the load that it will
/// have.
#[derive(Args, Debug)]
pub(crate) struct DoctorArgs {
    /// Rate of the measured loop, in Hz
    #[arg(long, value_name = "HZ", default_value_t = 1000.0)]
    pub(crate) rate: f64,
    /// Duration of the measurement, in seconds
    #[arg(long, value_name = "N", default_value_t = 5.0)]
    pub(crate) seconds: f64,
    /// Measure round trips on this network interface instead, of EtherCAT frames or packets to --board, and
    /// examine its card and driver. Not for use while a bridge runs on it
    #[arg(long, value_name = "IFACE")]
    pub(crate) network: Option<String>,
    /// Address of a Mesa board on that interface
    #[arg(long, value_name = "ADDRESS", requires = "network")]
    pub(crate) board: Option<IpAddr>,
    /// Print one JSON object on standard output
    #[arg(long)]
    pub(crate) json: bool,
}

/// Examines the host and writes the report to `out`, as a table or as one JSON object; notes go to `err`.
/// Takes as long as it measures.
///
/// # Errors
/// `Usage` for a bad rate or duration, `Failed` if no thread can measure or the output cannot be written.
pub(crate) fn run(args: &DoctorArgs, out: &mut dyn Write, err: &mut dyn Write) -> Result<(), CommandError> {
    let duration = Duration::try_from_secs_f64(args.seconds).map_err(|_| {
        CommandError::Usage(
            BareLoopError::Duration {
                seconds: args.seconds,
            }
            .to_string(),
        )
    })?;
    if let Some(interface) = &args.network {
        let measure = (args.rate, duration);
        return doctor_network::run(interface, args.board, measure, args.json, out, err);
    }
    written(writeln!(
        err,
        "measuring for {} s at {} Hz ...",
        args.seconds, args.rate
    ))?;
    let report = examine(args.rate, duration).map_err(|error| match error {
        BareLoopError::Rate { .. } | BareLoopError::Duration { .. } => CommandError::Usage(error.to_string()),
        BareLoopError::Thread { .. } => CommandError::Failed(error.to_string()),
    })?;
    written(if args.json {
        writeln!(out, "{}", to_json(&report))
    } else {
        write_table(&report, out)
    })
}

fn to_json(report: &DoctorReport) -> Value {
    let findings: Vec<Value> = rows(report).iter().map(FindingRow::to_json).collect();
    let lateness = &report.lateness;
    json!({
        "findings": findings,
        "lateness": {
            "rate_hz": lateness.rate_hz,
            "period_ns": lateness.period_ns,
            "cycles": lateness.cycles,
            "p50_ns": lateness.p50_ns,
            "p99_ns": lateness.p99_ns,
            "p999_ns": lateness.p999_ns,
            "max_ns": lateness.max_ns,
            "over_period": lateness.over_period,
            "fifo_priority": lateness.granted.priority,
            "core": lateness.granted.core,
            "memory_locked": lateness.granted.memory_locked,
            "notes": lateness.granted.notes,
        },
    })
}

fn write_table(report: &DoctorReport, out: &mut dyn Write) -> io::Result<()> {
    let rows = rows(report);
    write_findings(&rows, out)?;
    let lateness = &report.lateness;
    let us = |ns: u64| ns as f64 / 1e3;
    writeln!(
        out,
        "\nwake-up lateness (us): p50 {:.1}, p99 {:.1}, p99.9 {:.1}, max {:.1}",
        us(lateness.p50_ns),
        us(lateness.p99_ns),
        us(lateness.p999_ns),
        us(lateness.max_ns)
    )?;
    for note in &lateness.granted.notes {
        writeln!(out, "note: {note}")?;
    }
    write_advice(&rows, out)
}

fn rows(report: &DoctorReport) -> Vec<FindingRow<'_>> {
    report.findings.iter().map(FindingRow::from).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ran(args: &DoctorArgs) -> (Result<(), CommandError>, String) {
        let mut out = Vec::new();
        let result = run(args, &mut out, &mut io::sink());
        (result, String::from_utf8(out).expect("UTF-8"))
    }

    #[test]
    fn the_json_holds_every_finding_and_ordered_quantiles() {
        let (result, text) = ran(&DoctorArgs {
            rate: 1000.0,
            seconds: 0.05,
            network: None,
            board: None,
            json: true,
        });
        assert!(result.is_ok());
        let report: Value = serde_json::from_str(&text).expect("one JSON object");
        let names: Vec<&str> = report["findings"]
            .as_array()
            .expect("a list")
            .iter()
            .filter_map(|f| f["name"].as_str())
            .collect();
        for name in [
            "kernel",
            "preemption",
            "isolated_cores",
            "scheduler",
            "locked_memory",
            "bus",
            "lateness",
        ] {
            assert!(names.contains(&name), "{name} is not among {names:?}");
        }
        let lateness = &report["lateness"];
        assert_eq!(lateness["cycles"], 50);
        let quantiles: Vec<u64> = ["p50_ns", "p99_ns", "p999_ns", "max_ns"]
            .iter()
            .filter_map(|key| lateness[key].as_u64())
            .collect();
        assert!(quantiles.len() == 4 && quantiles.is_sorted(), "{quantiles:?}");
    }

    #[test]
    fn the_table_advises_on_all_that_is_not_good() {
        let (result, text) = ran(&DoctorArgs {
            rate: 500.0,
            seconds: 0.05,
            network: None,
            board: None,
            json: false,
        });
        assert!(result.is_ok());
        let bad = text
            .lines()
            .filter(|line| line.starts_with("bad ") || line.starts_with("fair "))
            .count();
        let advised = text.lines().filter(|line| line.starts_with("  ")).count();
        assert_eq!(advised, bad, "{text}");
    }

    #[test]
    fn absurd_rates_and_durations_are_wrong_usage() {
        for (rate, seconds) in [
            (0.0, 1.0),
            (f64::NAN, 1.0),
            (1e9, 1.0),
            (1e3, 0.0),
            (1e3, -1.0),
            (1e3, f64::NAN),
            (1e3, 1e300),
        ] {
            let (result, _) = ran(&DoctorArgs {
                rate,
                seconds,
                network: None,
                board: None,
                json: true,
            });
            assert!(
                matches!(result, Err(CommandError::Usage(_))),
                "{rate} Hz, {seconds} s"
            );
        }
    }
}
