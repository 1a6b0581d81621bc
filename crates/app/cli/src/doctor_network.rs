//! `evolvent doctor --network`: round-trip times to drives or a board, and what to change.

use std::io::{self, Write};
use std::net::IpAddr;
use std::time::Duration;

use evolvent_ethercat::{CardFinding, CardVerdict, InterfaceError, RoundTrips, examine_card};
use serde_json::{Value, json};

use crate::CommandError;
use crate::finding_row::{FindingRow, write_advice, write_findings};
use crate::output::written;

/// Maximum round trip as a fraction of the period. A bridge waits for 60 % of a period (Mesa boards) or 90 %
/// (EtherCAT).
const MAX_FRACTION: f64 = 0.6;

/// Measures an interface and writes the report.
///
/// # Errors
/// `Usage` if the interface does not exist or cannot be opened, `Failed` if the output cannot be written.
pub(crate) fn run(
    interface: &str,
    board: Option<IpAddr>,
    (rate_hz, duration): (f64, Duration),
    is_json: bool,
    out: &mut dyn Write,
    err: &mut dyn Write,
) -> Result<(), CommandError> {
    if !(10.0..=10_000.0).contains(&rate_hz) || !(0.1..=3600.0).contains(&duration.as_secs_f64()) {
        return Err(CommandError::Usage(format!(
            "--rate {rate_hz} Hz and --seconds {}: with --network, a rate of 10 to 10000 Hz and a duration \
             of 0.1 to 3600 s are needed",
            duration.as_secs_f64()
        )));
    }
    let findings = examine_card(interface).map_err(|error| {
        CommandError::Usage(format!(
            "the network interface `{interface}` cannot be examined: {error}; `ip link` lists the interfaces"
        ))
    })?;
    let period = Duration::from_secs_f64(1.0 / rate_hz);
    written(writeln!(
        err,
        "measuring round trips for {} s at {rate_hz} Hz ...",
        duration.as_secs_f64()
    ))?;
    let (trips, devices) = match board {
        Some(address) => {
            let trips = evolvent_mesa::round_trips(address, period, duration);
            (
                trips.map_err(|error| CommandError::Usage(error.to_string()))?,
                None,
            )
        }
        None => {
            let (trips, devices) =
                evolvent_ethercat::round_trips(interface, period, duration).map_err(|error| {
                    CommandError::Usage(match error {
                        InterfaceError::Closed { .. } => {
                            format!("{error}. for a Mesa board, give its address with --board")
                        }
                        InterfaceError::InUse { .. } => error.to_string(),
                    })
                })?;
            (trips, Some(devices))
        }
    };
    let mut findings = findings;
    findings.insert(0, judged(&trips, devices, period));
    written(if is_json {
        writeln!(out, "{}", to_json(interface, &findings, &trips, devices))
    } else {
        write_table(&findings, &trips, out)
    })
}

/// The finding of the round trips.
fn judged(trips: &RoundTrips, devices: Option<u16>, period: Duration) -> CardFinding {
    let period_ns = period.as_nanos() as f64;
    let advice = if trips.lost == trips.sent {
        let what = match devices {
            Some(_) => "no frame returns: check cable and supply, and that the devices are on this interface",
            None => {
                "no reply: check cable, supply and address, and that this computer has an address of the \
                 same network"
            }
        };
        Some((CardVerdict::Bad, what.to_owned()))
    } else if devices == Some(0) {
        let what = "frames return, but no device has processed them: something else returns them; connect \
                    the devices without a switch";
        Some((CardVerdict::Bad, what.to_owned()))
    } else if trips.lost > 0 {
        let what =
            "packets are lost, or return after their period: see below, and `evolvent doctor` for the host";
        Some((CardVerdict::Bad, what.to_owned()))
    } else if trips.p999_ns as f64 > MAX_FRACTION * period_ns {
        let what = "replies take more than 60 % of the period, for which a bridge waits: see below, or \
                    lower the rate";
        Some((CardVerdict::Bad, what.to_owned()))
    } else if trips.max_ns as f64 > MAX_FRACTION * period_ns {
        let what = "single replies are late: see below, and `evolvent doctor` for the host";
        Some((CardVerdict::Fair, what.to_owned()))
    } else {
        None
    };
    let (verdict, advice) = advice.map_or((CardVerdict::Good, None), |(verdict, advice)| {
        (verdict, Some(advice))
    });
    let us = |ns: u64| ns as f64 / 1e3;
    let devices = devices.map_or(String::new(), |devices| format!(", {devices} devices"));
    CardFinding {
        name: "round trips",
        value: format!(
            "median {:.1} us, 99.9 % within {:.1} us, maximum {:.1} us; {} of {} lost{devices}",
            us(trips.p50_ns),
            us(trips.p999_ns),
            us(trips.max_ns),
            trips.lost,
            trips.sent
        ),
        verdict,
        advice,
    }
}

fn to_json(interface: &str, findings: &[CardFinding], trips: &RoundTrips, devices: Option<u16>) -> Value {
    let findings: Vec<Value> = findings
        .iter()
        .map(|finding| FindingRow::from(finding).to_json())
        .collect();
    json!({
        "interface": interface,
        "findings": findings,
        "round_trips": {
            "sent": trips.sent,
            "lost": trips.lost,
            "p50_ns": trips.p50_ns,
            "p999_ns": trips.p999_ns,
            "max_ns": trips.max_ns,
            "real_time": trips.is_real_time,
            "devices": devices,
        },
    })
}

fn write_table(findings: &[CardFinding], trips: &RoundTrips, out: &mut dyn Write) -> io::Result<()> {
    let rows: Vec<FindingRow<'_>> = findings.iter().map(FindingRow::from).collect();
    write_findings(&rows, out)?;
    if !trips.is_real_time {
        writeln!(
            out,
            "note: measured without real-time priority; `evolvent doctor` reports what it requires"
        )?;
    }
    write_advice(&rows, out)
}
