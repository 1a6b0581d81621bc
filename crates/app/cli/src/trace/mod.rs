//! `evolvent trace`: examining traces.

mod compare;
mod export;
mod info;
mod recover;
mod replay;
mod report;
mod text;
mod verify;

use std::io::{self, Write};
use std::path::PathBuf;

use clap::{Args, Subcommand};
use evolvent_inspect::InspectError;
use evolvent_trace::ReadError;

use crate::{CommandError, Ending};

/// Options of `evolvent trace`.
#[derive(Debug, Args)]
pub(crate) struct TraceArgs {
    #[command(subcommand)]
    command: TraceCommand,
}

#[derive(Debug, Subcommand)]
enum TraceCommand {
    /// Show what a trace contains: the run, the machine, channels, gaps, alarms, lateness. Immediate for any
    /// size.
    Info {
        /// The trace, NAME.mcap.
        file: PathBuf,
        /// Print one JSON object.
        #[arg(long)]
        json: bool,
    },
    /// Write one page for a browser: the verdict in words, the path, feed and every axis over time, where the
    /// time went.
    Report {
        /// The trace, NAME.mcap.
        file: PathBuf,
        /// Output file; default: NAME.html.
        #[arg(short, long, value_name = "FILE.html")]
        output: Option<PathBuf>,
    },
    /// Write a table of cycles, events or blocks: CSV or Parquet, by the extension of the output.
    Export(export::ExportArgs),
    /// Recompute the run, or every job of a served machine, and compare every setpoint bit for bit; check
    /// every sample against limits and path.
    ///
    /// Exit code 0: the run is reproduced; 1: it is not, or a limit is exceeded; 3: no error was found, but
    /// cycles are missing, or what moved the axes is unknown.
    Verify {
        /// The trace, NAME.mcap.
        file: PathBuf,
        /// Print one JSON object.
        #[arg(long)]
        json: bool,
    },
    /// Publish the recorded setpoints on the bus again.
    Replay(replay::ReplayArgs),
    /// Compare two runs, aligned by position on the path: where and why one was slower, and where they
    /// differ.
    Compare {
        /// The first trace.
        a: PathBuf,
        /// The second trace.
        b: PathBuf,
        /// Job of the first trace, for the trace of a served machine: its number in the report. Default: the
        /// whole trace.
        #[arg(long, value_name = "N")]
        job_a: Option<u32>,
        /// Job of the second trace, likewise.
        #[arg(long, value_name = "N")]
        job_b: Option<u32>,
        /// Print one JSON object.
        #[arg(long)]
        json: bool,
    },
    /// Make a complete trace of a truncated or damaged one. Exit code 3 if a part of it was lost.
    Recover {
        /// The truncated trace, NAME.mcap or NAME.mcap.part. It is not changed.
        file: PathBuf,
        /// Output file; default: NAME.mcap for NAME.mcap.part, or NAME.recovered.mcap.
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
        TraceCommand::Info { file, json } => info::run(file, *json, out),
        TraceCommand::Report { file, output } => report::run(file, output.as_deref(), err),
        TraceCommand::Export(args) => export::run(args, err),
        TraceCommand::Verify { file, json } => verify::run(file, *json, out),
        TraceCommand::Replay(args) => replay::run(args, out, err),
        TraceCommand::Compare {
            a,
            b,
            job_a,
            job_b,
            json,
        } => compare::run((a, *job_a), (b, *job_b), *json, out),
        TraceCommand::Recover { file, output, json } => {
            recover::run(file, output.as_deref(), *json, out, err)
        }
    }
}

/// A mistyped name is wrong usage; a broken file is a failure.
fn read_error(error: &ReadError) -> CommandError {
    if error.is_wrong_name() {
        CommandError::Usage(error.to_string())
    } else {
        CommandError::Failed(error.to_string())
    }
}

fn inspect_error(error: &InspectError) -> CommandError {
    match error {
        InspectError::Read(error) => read_error(error),
        other => CommandError::Failed(other.to_string()),
    }
}

#[expect(clippy::needless_pass_by_value, reason = "given to map_err by name")]
fn write_error(error: io::Error) -> CommandError {
    CommandError::Failed(format!("the result cannot be written: {error}"))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use clap::Parser;
    use evolvent_path::AxisLetter;
    use evolvent_trace::{CycleRecord, Recorder, RunInfo};

    use super::*;
    use serde_json::{Value, json};

    #[derive(Debug, Parser)]
    struct Cli {
        #[command(flatten)]
        args: TraceArgs,
    }

    /// Runs the command; returns its ending and both outputs.
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

    /// A separate folder, removed at the end.
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
            "1001, 0 late",
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
        assert!(text.contains("bytes at the truncated end"), "{text}");
        assert_eq!(trace(&["info", &output]).0, Ok(Ending::Clean));
    }

    #[test]
    fn no_output_replaces_the_trace() {
        let folder = Folder::new("over");
        std::fs::create_dir_all(folder.0.join("inner")).expect("folder");
        let path = folder.0.join("run.csv");
        record(&path, 200);
        let bytes = std::fs::read(&path).expect("reading");
        let file = path.display().to_string();
        let same = folder.0.join("inner/../run.csv").display().to_string();
        for words in [
            ["report", &file, "-o", &same],
            ["export", &file, "-o", &same],
            ["recover", &file, "-o", &same],
        ] {
            let refused = trace(&words).0;
            assert!(
                matches!(&refused, Err(CommandError::Usage(text)) if text.contains("is the trace itself; name another")),
                "{words:?}: {refused:?}"
            );
            assert_eq!(std::fs::read(&path).expect("reading"), bytes, "{words:?}");
        }
    }

    #[test]
    fn a_wrong_name_is_wrong_usage() {
        let folder = Folder::new("names");
        let there = |name: &str| folder.0.join(name).display().to_string();
        std::fs::write(there("empty.mcap"), b"").expect("writing");
        std::fs::write(there("text.mcap"), b"G0 X1").expect("writing");
        let table = there("table.csv");
        let commands = |file: &str| {
            let strings = |words: &[&str]| words.iter().map(|word| (*word).to_owned()).collect::<Vec<_>>();
            [
                strings(&["info", file]),
                strings(&["report", file]),
                strings(&["export", file, "-o", &table]),
                strings(&["verify", file]),
                strings(&["replay", file]),
                strings(&["compare", file, file]),
                strings(&["recover", file]),
            ]
        };
        for (name, wanted) in [
            ("none.mcap", "does not exist; check the name"),
            ("none/run.mcap", "does not exist; check the name"),
            ("", "is a folder; name one of the traces in it"),
            ("empty.mcap", "is not a trace: it"),
            ("text.mcap", "is not a trace: it"),
        ] {
            for command in commands(&there(name)) {
                let words: Vec<&str> = command.iter().map(String::as_str).collect();
                let Err(CommandError::Usage(text)) = trace(&words).0 else {
                    panic!("{command:?} is no wrong usage");
                };
                assert!(text.contains(wanted), "{command:?}: {text}");
            }
        }
    }
}
