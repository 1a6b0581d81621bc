//! `evolvent trace`: what a trace holds, and the rescue of torn ones.

use std::io::{self, Write};
use std::path::PathBuf;

use clap::{Args, Subcommand};
use evolvent_trace::{ReadError, RecoverError, Recovered, RunInfo, TraceFile, TraceInfo};
use serde_json::{Map, Value, json};

use crate::{CommandError, Ending};

/// Options of `evolvent trace`.
#[derive(Debug, Args)]
pub(crate) struct TraceArgs {
    #[command(subcommand)]
    command: TraceCommand,
}

#[derive(Debug, Subcommand)]
enum TraceCommand {
    /// What a trace holds: the run, the machine, channels, gaps, alarms, lateness. At once, whatever its size.
    Info {
        /// The trace, NAME.mcap.
        file: PathBuf,
        /// Print one JSON object.
        #[arg(long)]
        json: bool,
    },
    /// Make a complete trace of a torn or damaged one. Exit code 3 if something of it was lost.
    Recover {
        /// The torn trace, NAME.mcap or NAME.mcap.part. It is left as it is.
        file: PathBuf,
        /// Where the complete trace goes; else NAME.mcap for NAME.mcap.part, or NAME.recovered.mcap.
        #[arg(short, long, value_name = "FILE")]
        output: Option<PathBuf>,
        /// Print one JSON object.
        #[arg(long)]
        json: bool,
    },
}

pub(crate) fn run(
    args: &TraceArgs,
    out: &mut dyn Write,
    err: &mut dyn Write,
) -> Result<Ending, CommandError> {
    match &args.command {
        TraceCommand::Info { file, json } => {
            let trace = TraceFile::open(file).map_err(|error| read_error(&error))?;
            let info = trace.info();
            let written = if *json {
                writeln!(out, "{}", info_to_json(info))
            } else {
                write_info(out, info)
            };
            written.map_err(write_error)?;
            Ok(Ending::Clean)
        }
        TraceCommand::Recover { file, output, json } => {
            let recovered =
                evolvent_trace::recover(file, output.as_deref()).map_err(|error| recover_error(&error))?;
            let written = if *json {
                writeln!(out, "{}", recovered_to_json(&recovered))
            } else {
                write_recovered(err, &recovered)
            };
            written.map_err(write_error)?;
            Ok(if recovered.lost_data() {
                Ending::Lossy
            } else {
                Ending::Clean
            })
        }
    }
}

/// A name that was mistyped is wrong usage; a file that is broken is a failure.
fn read_error(error: &ReadError) -> CommandError {
    match error {
        ReadError::NotATrace { .. } => CommandError::Usage(error.to_string()),
        ReadError::Io { source, .. } if source.kind() == io::ErrorKind::NotFound => {
            CommandError::Usage(error.to_string())
        }
        _ => CommandError::Failed(error.to_string()),
    }
}

fn recover_error(error: &RecoverError) -> CommandError {
    match error {
        RecoverError::Read { source, .. } if source.kind() == io::ErrorKind::NotFound => {
            CommandError::Usage(error.to_string())
        }
        _ => CommandError::Failed(error.to_string()),
    }
}

#[expect(clippy::needless_pass_by_value, reason = "given to map_err by name")]
fn write_error(error: io::Error) -> CommandError {
    CommandError::Failed(format!("the result cannot be written: {error}"))
}

/// Lines of name and value, the values one below another.
fn write_table(out: &mut dyn Write, rows: &[(&str, String)]) -> io::Result<()> {
    let width = rows.iter().map(|(name, _)| name.len()).max().unwrap_or(0);
    rows.iter()
        .try_for_each(|(name, value)| writeln!(out, "{name:width$}  {value}"))
}

fn write_info(out: &mut dyn Write, info: &TraceInfo) -> io::Result<()> {
    let mut rows = vec![("trace", info.path.display().to_string())];
    match &info.run {
        Some(run) => add_run(&mut rows, run),
        None => rows.push(("run", "unknown: the file does not say what was run".to_owned())),
    }
    rows.push(("duration", format!("{:.3} s", info.duration_s())));
    rows.push((
        "size",
        format!(
            "{} in {} chunks, {} unpacked",
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
            format!("{}, {} left late", text("cycles"), text("late_cycles")),
        ));
        rows.push((
            "gaps",
            format!("{}, {} cycles missing", text("gaps"), text("missing_cycles")),
        ));
        rows.push(("alarms", text("alarms")));
        rows.push(("woke up late by", percentiles(info, "wake_lateness")));
        rows.push(("own work", percentiles(info, "work")));
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

fn write_channels(out: &mut dyn Write, channels: &[evolvent_trace::ChannelInfo]) -> io::Result<()> {
    let width = channels
        .iter()
        .map(|channel| channel.topic.len())
        .max()
        .unwrap_or(0);
    channels.iter().try_for_each(|channel| {
        writeln!(
            out,
            "{:width$}  {:>12} messages  {}",
            channel.topic, channel.messages, channel.message
        )
    })
}

fn write_recovered(out: &mut dyn Write, recovered: &Recovered) -> io::Result<()> {
    let saved = &recovered.statistics;
    let mut rows = vec![
        ("recovered", recovered.source.display().to_string()),
        ("as", recovered.path.display().to_string()),
        (
            "cycles",
            match (saved.first_sequence, saved.last_sequence) {
                (Some(first), Some(last)) => format!("{}, from {first} to {last}", saved.cycles),
                _ => "none".to_owned(),
            },
        ),
        (
            "gaps",
            format!("{}, {} cycles missing", saved.gaps, saved.missing_cycles),
        ),
    ];
    let lost = match (recovered.damaged_places, recovered.bytes_dropped) {
        (0, 0) if recovered.was_complete => "nothing, the file was complete".to_owned(),
        (0, 0) => "nothing, only the index was missing".to_owned(),
        (0, dropped) => format!("{dropped} bytes at the torn end"),
        (places, dropped) => format!("{dropped} bytes; {places} damaged places before the end"),
    };
    rows.push(("lost", lost));
    if !recovered.has_run {
        rows.push(("run", "unknown: the description of the run was lost".to_owned()));
    }
    write_table(out, &rows)?;
    writeln!(out)?;
    write_channels(out, &recovered.channels)
}

fn bytes(count: u64) -> String {
    let value = count as f64;
    match count {
        0..10_000 => format!("{count} bytes"),
        10_000..10_000_000 => format!("{:.1} kB", value / 1e3),
        10_000_000..10_000_000_000 => format!("{:.1} MB", value / 1e6),
        _ => format!("{:.2} GB", value / 1e9),
    }
}

fn channels_to_json(channels: &[evolvent_trace::ChannelInfo]) -> Value {
    channels
        .iter()
        .map(|channel| {
            (
                channel.topic.clone(),
                json!({ "message": channel.message, "messages": channel.messages }),
            )
        })
        .collect::<Map<_, _>>()
        .into()
}

/// Texts that are numbers become numbers.
fn map_to_json(map: &std::collections::BTreeMap<String, String>) -> Value {
    map.iter()
        .map(|(key, text)| {
            let number = text
                .parse::<i64>()
                .map(Value::from)
                .or_else(|_| text.parse::<u64>().map(Value::from))
                .or_else(|_| text.parse::<f64>().map(Value::from));
            // JSON has no infinity: it stays a text.
            let value = number.ok().filter(|value| !value.is_null());
            (key.clone(), value.unwrap_or_else(|| Value::from(text.clone())))
        })
        .collect::<Map<_, _>>()
        .into()
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

fn recovered_to_json(recovered: &Recovered) -> Value {
    json!({
        "source": recovered.source.display().to_string(),
        "file": recovered.path.display().to_string(),
        "was_complete": recovered.was_complete,
        "lost_data": recovered.lost_data(),
        "channels": channels_to_json(&recovered.channels),
        "cycles": recovered.statistics.cycles,
        "first_sequence": recovered.statistics.first_sequence,
        "last_sequence": recovered.statistics.last_sequence,
        "gaps": recovered.statistics.gaps,
        "missing_cycles": recovered.statistics.missing_cycles,
        "chunks": recovered.chunks,
        "attachments": recovered.attachments,
        "damaged_places": recovered.damaged_places,
        "bytes_dropped": recovered.bytes_dropped,
        "has_run": recovered.has_run,
    })
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use clap::Parser;
    use evolvent_path::AxisLetter;
    use evolvent_trace::{CycleRecord, Recorder};

    use super::*;

    #[derive(Debug, Parser)]
    struct Cli {
        #[command(flatten)]
        args: TraceArgs,
    }

    /// Runs the command; gives its ending and both outputs.
    fn trace(arguments: &[&str]) -> (Result<Ending, CommandError>, String, String) {
        let cli = Cli::try_parse_from([&["trace"], arguments].concat()).expect("arguments");
        let (mut out, mut err) = (Vec::new(), Vec::new());
        let ending = run(&cli.args, &mut out, &mut err);
        (
            ending,
            String::from_utf8_lossy(&out).into_owned(),
            String::from_utf8_lossy(&err).into_owned(),
        )
    }

    /// A folder of its own, gone at the end.
    struct Folder(PathBuf);

    impl Folder {
        fn new(name: &str) -> Self {
            let path = std::env::temp_dir().join(format!("evolvent-trace-{name}-{}", std::process::id()));
            std::fs::create_dir_all(&path).expect("folder");
            Self(path)
        }
    }

    impl Drop for Folder {
        fn drop(&mut self) {
            let _ = std::fs::remove_dir_all(&self.0);
        }
    }

    fn record(path: &std::path::Path, cycles: u64) {
        let info = RunInfo {
            program_name: "part.ngc".into(),
            machine_name: "mill".into(),
            axes: vec![AxisLetter::X, AxisLetter::Z],
            period_ns: 1_000_000,
            ..RunInfo::default()
        };
        let mut recorder = Recorder::create(path, &info).expect("recorder");
        for sequence in 0..cycles {
            let due_time_ns = sequence * 1_000_000;
            let cycle = CycleRecord {
                sequence,
                due_time_ns,
                wake_lateness_ns: 20_000,
                ..CycleRecord::default()
            };
            recorder.cycle(&cycle).expect("cycle");
            if sequence % 100 == 99 {
                recorder.flush().expect("flush");
            }
        }
        recorder.finish(&BTreeMap::new()).expect("finish");
    }

    #[test]
    fn info_tells_the_same_to_people_and_to_programs() {
        let folder = Folder::new("info");
        let path = folder.0.join("run.mcap");
        record(&path, 1001);
        let file = path.display().to_string();
        let (ending, text, _) = trace(&["info", &file]);
        assert_eq!(ending, Ok(Ending::Clean));
        for part in [
            "mill, axes XZ",
            "1000000 ns, 1000.00 Hz",
            "1.000 s",
            "1001, 0 left late",
            "worst 20.0 us",
        ] {
            assert!(text.contains(part), "{part} is not in\n{text}");
        }
        let (ending, text, _) = trace(&["info", "--json", &file]);
        assert_eq!(ending, Ok(Ending::Clean));
        let object: Value = serde_json::from_str(&text).expect("one JSON object");
        assert_eq!(object["run"]["axes"], "XZ");
        assert_eq!(object["summary"]["cycles"], 1001);
        assert_eq!(object["channels"]["/cycle"]["messages"], 1001);
        assert_eq!(object["duration_s"], 1.0);
    }

    #[test]
    fn recovery_of_a_torn_trace_ends_with_data_lost() {
        let folder = Folder::new("recover");
        let path = folder.0.join("run.mcap");
        record(&path, 1000);
        let file = path.display().to_string();
        let (ending, text, _) = trace(&["recover", "--json", &file]);
        let object: Value = serde_json::from_str(&text).expect("one JSON object");
        assert_eq!(
            (ending, &object["lost_data"], &object["cycles"]),
            (Ok(Ending::Clean), &json!(false), &json!(1000))
        );
        let bytes = std::fs::read(&path).expect("reading");
        std::fs::write(&path, &bytes[..bytes.len() / 2]).expect("writing");
        assert!(
            matches!(trace(&["info", &file]).0, Err(CommandError::Failed(text)) if text.contains("recover"))
        );
        let output = folder.0.join("whole.mcap").display().to_string();
        let (ending, _, text) = trace(&["recover", &file, "-o", &output]);
        assert_eq!(ending, Ok(Ending::Lossy), "{text}");
        assert!(text.contains("bytes at the torn end"), "{text}");
        assert_eq!(trace(&["info", &output]).0, Ok(Ending::Clean));
    }

    #[test]
    fn a_wrong_name_is_wrong_usage() {
        assert!(matches!(
            trace(&["info", "/none/run.mcap"]).0,
            Err(CommandError::Usage(_))
        ));
        assert!(matches!(
            trace(&["recover", "/none/run.mcap"]).0,
            Err(CommandError::Usage(_))
        ));
        let this = concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml");
        assert!(matches!(trace(&["info", this]).0, Err(CommandError::Usage(_))));
    }
}
