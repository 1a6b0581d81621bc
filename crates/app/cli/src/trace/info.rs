//! `evolvent trace info`.

use std::io::{self, Write};
use std::path::Path;

use evolvent_trace::{RunInfo, TraceFile, TraceInfo};
use serde_json::{Value, json};

use super::text::{bytes, channels_to_json, map_to_json, write_channels, write_table};
use super::{read_error, write_error};
use crate::{CommandError, Ending};

pub(super) fn run(file: &Path, json: bool, out: &mut dyn Write) -> Result<Ending, CommandError> {
    let trace = TraceFile::open(file).map_err(|error| read_error(&error))?;
    let info = trace.info();
    let written = if json {
        writeln!(out, "{}", info_to_json(info))
    } else {
        write_info(out, info)
    };
    written.map_err(write_error)?;
    Ok(Ending::Clean)
}

fn write_info(out: &mut dyn Write, info: &TraceInfo) -> io::Result<()> {
    let mut rows = vec![("trace", info.path.display().to_string())];
    match &info.run {
        Some(run) => add_run(&mut rows, run),
        None => rows.push((
            "run",
            "unknown: the file has no description of the run".to_owned(),
        )),
    }
    rows.push(("duration", format!("{:.3} s", info.duration_s())));
    rows.push((
        "size",
        format!(
            "{} in {} chunks, {} uncompressed",
            bytes(info.bytes),
            info.chunks,
            bytes(info.uncompressed_bytes)
        ),
    ));
    if info.summary.is_empty() {
        rows.push(("ended", "early: the run's summary was never written".to_owned()));
    } else {
        let text = |key: &str| info.summary.get(key).cloned().unwrap_or_else(|| "?".to_owned());
        rows.push((
            "cycles",
            format!("{}, {} late", text("cycles"), text("late_cycles")),
        ));
        rows.push((
            "gaps",
            format!("{}, {} cycles missing", text("gaps"), text("missing_cycles")),
        ));
        rows.push(("alarms", text("alarms")));
        rows.push(("wake-up lateness", percentiles(info, "wake_lateness")));
        rows.push(("own work", percentiles(info, "work")));
        if let Some(drift_ppm) = info.summary_number("clock_drift_ppm") {
            let us = |key: &str| info.summary_number(key).unwrap_or(f64::NAN) * 1e-3;
            let text = format!(
                "drift {drift_ppm:.2} ppm; phase error mean {:.2}, scatter {:.2}, p99.9 {:.2}, max {:.2} us",
                us("phase_mean_ns"),
                us("phase_scatter_ns"),
                us("phase_p999_ns"),
                us("phase_max_ns")
            );
            rows.push(("drives' clock", text));
        }
    }
    if let Some(failure) = info.recovery.get("failure") {
        rows.push(("recording failed", failure.clone()));
    } else if let Some(dropped) = info.recovery.get("bytes_dropped") {
        let places = info.recovery.get("damaged_places").map_or("?", String::as_str);
        rows.push((
            "recovered",
            format!("{dropped} bytes dropped, {places} damaged places"),
        ));
    }
    write_table(out, &rows)?;
    writeln!(out)?;
    write_channels(out, &info.channels)?;
    if !info.attachments.is_empty() {
        writeln!(out)?;
        for (name, size) in &info.attachments {
            writeln!(out, "attached  {name}  {}", bytes(*size))?;
        }
    }
    Ok(())
}

fn add_run(rows: &mut Vec<(&str, String)>, run: &RunInfo) {
    let axes: String = run.axes.iter().map(|axis| axis.letter()).collect();
    rows.push(("program", run.program_name.clone()));
    rows.push(("machine", format!("{}, axes {axes}", run.machine_name)));
    let rate_hz = if run.period_ns == 0 {
        0.0
    } else {
        1e9 / run.period_ns as f64
    };
    rows.push(("period", format!("{} ns, {rate_hz:.2} Hz", run.period_ns)));
    rows.push(("clock", run.clock.clone()));
    rows.push(("real time", run.real_time.clone()));
    rows.push(("configuration", run.configuration_hash.clone()));
    for (name, version) in &run.versions {
        rows.push(("version", format!("{name} {version}")));
    }
}

fn percentiles(info: &TraceInfo, name: &str) -> String {
    let microseconds = |key: &str| match info.summary_number(&format!("{name}_{key}_ns")) {
        Some(ns) => format!("{:.1} us", ns / 1000.0),
        None => "?".to_owned(),
    };
    format!(
        "p50 {}, p99 {}, p99.9 {}, worst {}",
        microseconds("p50"),
        microseconds("p99"),
        microseconds("p999"),
        microseconds("max")
    )
}

fn info_to_json(info: &TraceInfo) -> Value {
    let run = info.run.as_ref().map(|run| {
        json!({
            "program": run.program_name,
            "machine": run.machine_name,
            "machine_file": run.machine_file_name,
            "axes": run.axes.iter().map(|axis| axis.letter()).collect::<String>(),
            "period_ns": run.period_ns,
            "start_time_ns": run.start_time_ns,
            "clock": run.clock,
            "real_time": run.real_time,
            "configuration_hash": run.configuration_hash,
            "versions": run.versions,
            "extra": run.extra,
        })
    });
    json!({
        "file": info.path.display().to_string(),
        "bytes": info.bytes,
        "run": run,
        "start_time_ns": info.start_time_ns,
        "end_time_ns": info.end_time_ns,
        "duration_s": info.duration_s(),
        "channels": channels_to_json(&info.channels),
        "chunks": info.chunks,
        "uncompressed_bytes": info.uncompressed_bytes,
        "attachments": info.attachments.iter().cloned().collect::<std::collections::BTreeMap<_, _>>(),
        "summary": map_to_json(&info.summary),
        "recovery": map_to_json(&info.recovery),
    })
}
