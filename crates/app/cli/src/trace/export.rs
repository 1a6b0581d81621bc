//! `evolvent trace export`.

use std::io::Write;
use std::ops::RangeInclusive;
use std::path::PathBuf;

use clap::{Args, ValueEnum};
use evolvent_config::check_outputs;
use evolvent_inspect::{ExportChannel, ExportError, ExportFormat, Selection, export};
use evolvent_trace::TraceFile;

use super::{read_error, write_error};
use crate::{CommandError, Ending};

/// A part of a trace.
#[derive(Debug, Args)]
pub(super) struct PartArgs {
    /// Start time, s since the start of the run.
    #[arg(long, value_name = "S", allow_negative_numbers = true)]
    from: Option<f64>,
    /// End time, s since the start of the run.
    #[arg(long, value_name = "S", allow_negative_numbers = true)]
    to: Option<f64>,
    /// Only these lines of the program: N, N-M, N- or -M.
    #[arg(long, value_name = "N-M", value_parser = parse_lines, allow_hyphen_values = true)]
    lines: Option<RangeInclusive<u32>>,
}

impl PartArgs {
    pub(super) fn selection(&self) -> Result<Selection, CommandError> {
        let all = Selection::default();
        let (from, to) = (
            self.from.unwrap_or(*all.time_s.start()),
            self.to.unwrap_or(*all.time_s.end()),
        );
        if from.is_nan() || to.is_nan() || from > to {
            return Err(CommandError::Usage(format!(
                "--from {from} to --to {to} is not a time span"
            )));
        }
        Ok(Selection {
            time_s: from..=to,
            lines: self.lines.clone().unwrap_or(all.lines),
        })
    }
}

/// Options of `evolvent trace export`.
#[derive(Debug, Args)]
pub(super) struct ExportArgs {
    /// The trace, NAME.mcap.
    file: PathBuf,
    /// Output file: NAME.csv or NAME.parquet; its extension selects the format.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Contents of the table.
    #[arg(long, value_enum, default_value_t = ChannelArg::Cycles)]
    channel: ChannelArg,
    #[command(flatten)]
    part: PartArgs,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum ChannelArg {
    /// Every cycle: position, velocity, acceleration, jerk, times.
    Cycles,
    /// Inputs and faults.
    Events,
    /// Executed blocks.
    Blocks,
}

fn parse_lines(text: &str) -> Result<RangeInclusive<u32>, String> {
    let number = |text: &str, other: u32| {
        if text.is_empty() {
            Ok(other)
        } else {
            text.parse().map_err(|_| format!("{text:?} is not a line number"))
        }
    };
    let (first, last) = match text.split_once('-') {
        None => (number(text, 0)?, number(text, 0)?),
        Some((first, last)) => (number(first, 0)?, number(last, u32::MAX)?),
    };
    if text.is_empty() || first > last {
        return Err(format!(
            "{text:?} is not a range of lines; write N, N-M, N- or -M"
        ));
    }
    Ok(first..=last)
}

pub(super) fn run(args: &ExportArgs, err: &mut dyn Write) -> Result<Ending, CommandError> {
    let extension = args
        .output
        .extension()
        .and_then(|text| text.to_str())
        .unwrap_or("");
    let format = match extension.to_ascii_lowercase().as_str() {
        "csv" => ExportFormat::Csv,
        "parquet" => ExportFormat::Parquet,
        _ => {
            return Err(CommandError::Usage(format!(
                "{} does not have the extension of a table: use .csv or .parquet",
                args.output.display()
            )));
        }
    };
    let channel = match args.channel {
        ChannelArg::Cycles => ExportChannel::Cycles,
        ChannelArg::Events => ExportChannel::Events,
        ChannelArg::Blocks => ExportChannel::Blocks,
    };
    check_outputs([args.output.as_path()], [(args.file.as_path(), "the trace")])?;
    if channel == ExportChannel::Events && args.part.lines.is_some() {
        return Err(CommandError::Usage(
            "events belong to no line of the program: select them by --from and --to, or export cycles or \
             blocks"
                .to_owned(),
        ));
    }
    let selection = args.part.selection()?;
    let mut trace = TraceFile::open(&args.file).map_err(|error| read_error(&error))?;
    let done =
        export(&mut trace, channel, &selection, format, &args.output).map_err(|error| match &error {
            ExportError::Read(error) => read_error(error),
            other => CommandError::Failed(other.to_string()),
        })?;
    writeln!(
        err,
        "{}: {} rows, {:.1} MB",
        args.output.display(),
        done.rows,
        done.bytes as f64 * 1e-6
    )
    .map_err(write_error)?;
    if done.rows == 0 {
        writeln!(
            err,
            "note: the trace has no data in this selection; `evolvent trace info` shows its contents"
        )
        .map_err(write_error)?;
    }
    Ok(Ending::Clean)
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Debug, Parser)]
    struct Cli {
        #[command(flatten)]
        args: ExportArgs,
    }

    #[test]
    fn values_may_begin_with_a_minus() {
        let parse = |words: &[&str]| {
            Cli::try_parse_from([&["export", "a.mcap", "-o", "a.csv"], words].concat())
                .map(|cli| cli.args.part)
        };
        assert_eq!(parse(&["--lines", "-4"]).unwrap().lines, Some(0..=4));
        let part = parse(&["--from", "-5", "--to", "-1.5"]).unwrap();
        assert_eq!((part.from, part.to), (Some(-5.0), Some(-1.5)));
        assert!(parse(&["--lines", "--from"]).is_err());
    }

    #[test]
    fn events_are_not_selected_by_lines() {
        let words = [
            "export",
            "a.mcap",
            "-o",
            "a.csv",
            "--channel",
            "events",
            "--lines",
            "4-4",
        ];
        let args = Cli::try_parse_from(words).unwrap().args;
        let refused = run(&args, &mut Vec::new());
        assert!(
            matches!(&refused, Err(CommandError::Usage(text)) if text.starts_with("events belong to no line")),
            "{refused:?}"
        );
    }

    #[test]
    fn lines_are_given_as_one_or_from_to_or_open() {
        assert_eq!(parse_lines("7"), Ok(7..=7));
        assert_eq!(parse_lines("7-9"), Ok(7..=9));
        assert_eq!(parse_lines("7-"), Ok(7..=u32::MAX));
        assert_eq!(parse_lines("-9"), Ok(0..=9));
        for wrong in ["", "x", "9-7", "1-2-3", "-x"] {
            assert!(parse_lines(wrong).is_err(), "{wrong}");
        }
    }
}
