//! `evolvent turn`: load-adaptive turning on a simulated workpiece, its report, and the passes as a part
//! program.

use std::io::Write;
use std::path::{Path, PathBuf};

use clap::Args;
use evolvent_analysis::{AnalysisError, TurningRoute, TurningTrial, read_process};
use evolvent_config::{check_outputs, write_whole};
use evolvent_runtime::Clock;

use crate::operator::watch_signals;
use crate::{CommandError, Ending};

/// Options of `evolvent turn`.
///
/// The job is tried on the stock of its file: the passes follow from the simulated cutting load, under the
/// machine's limits. docs/theory-turning.md explains an example and lists every assumption.
#[derive(Debug, Args, Default)]
pub(crate) struct TurnArgs {
    /// The job file (TOML)
    pub(crate) job: PathBuf,
    /// Machine file of a lathe
    #[arg(long, value_name = "FILE")]
    pub(crate) machine: PathBuf,
    /// Draw passes, feed and load, and the comparison with fixed passes (HTML or SVG)
    #[arg(long, value_name = "FILE")]
    pub(crate) report: Option<PathBuf>,
    /// Write the resulting passes as a part program for this stock; none is written if the job is stopped
    #[arg(long, value_name = "FILE.ngc")]
    pub(crate) program: Option<PathBuf>,
    /// Record every cycle, and every change of state with its reason
    #[arg(long, value_name = "FILE.mcap")]
    pub(crate) trace: Option<PathBuf>,
    /// Publish the setpoints on the bus
    #[arg(long)]
    pub(crate) bus: bool,
    /// Turn in real time, with the load on the bus, instead of trying the job on the stock of its file
    #[arg(long)]
    pub(crate) realtime: bool,
    /// Prefix of the bus's files, as of `evolvent run`
    #[arg(long, value_name = "PREFIX")]
    pub(crate) bus_prefix: Option<String>,
    /// Print every change of state with its reason
    #[arg(long)]
    pub(crate) log: bool,
    /// Print one JSON object on standard output
    #[arg(long)]
    pub(crate) json: bool,
}

/// Runs the job.
///
/// # Errors
/// `Usage` for a bad job or machine, `Failed` if the machine's guard rejects a setpoint or a file cannot be
/// written.
pub(crate) fn run(args: &TurnArgs, out: &mut dyn Write, err: &mut dyn Write) -> Result<Ending, CommandError> {
    let job = read_process(&args.job)?;
    if let Some(report) = &args.report {
        let good = ["html", "svg"];
        let extension = report.extension().unwrap_or_default().to_string_lossy();
        if !good.iter().any(|name| extension.eq_ignore_ascii_case(name)) {
            return Err(CommandError::Usage(format!(
                "{}: reports are HTML or SVG: use the extension .html or .svg",
                report.display()
            )));
        }
    }
    check_outputs(
        [&args.report, &args.program, &args.trace]
            .into_iter()
            .flatten()
            .map(PathBuf::as_path),
        [
            (args.job.as_path(), "the job file"),
            (args.machine.as_path(), "the machine file"),
        ],
    )?;
    let route = TurningRoute {
        clock: if args.realtime {
            Clock::Realtime
        } else {
            Clock::Virtual
        },
        trace: args.trace.clone(),
        bus: args.bus || args.realtime,
        bus_prefix: args.bus_prefix.as_deref(),
        on_start: &|controls| {
            watch_signals(controls).map_err(|error| match error {
                CommandError::Usage(text) => AnalysisError::Input(text),
                CommandError::Failed(text) => AnalysisError::Failed(text),
            })
        },
    };
    let trial = TurningTrial::run(job, &args.machine, &route)?;
    let failed = |file: &Path, error: &std::io::Error| {
        CommandError::Failed(format!("{}: cannot be written: {error}", file.display()))
    };
    if let Some(file) = &args.report {
        let is_page = file
            .extension()
            .is_some_and(|extension| extension.eq_ignore_ascii_case("html"));
        let text = if is_page { trial.html() } else { trial.svg() };
        write_whole(file, text.as_bytes()).map_err(|error| failed(file, &error))?;
    }
    if let Some(file) = &args.program {
        if let Some(program) = trial.program() {
            write_whole(file, program.as_bytes()).map_err(|error| failed(file, &error))?;
        } else {
            let _told = writeln!(
                err,
                "note: {} was not written: the passes are incomplete, because the job was {}",
                file.display(),
                trial.outcome()
            );
        }
    }
    let written = if args.json {
        writeln!(out, "{}", trial.json())
    } else {
        out.write_all(trial.text(args.log).as_bytes())
    };
    written.map_err(|error| CommandError::Failed(format!("cannot write: {error}")))?;
    for note in trial.notes() {
        let _told = writeln!(err, "note: {note}");
    }
    if let Some(error) = trial.trace_error() {
        let _told = writeln!(err, "warning: {error}");
    }
    Ok(match (trial.is_done(), trial.is_lossy()) {
        (false, _) => Ending::Negative,
        (true, true) => Ending::Lossy,
        (true, false) => Ending::Clean,
    })
}

#[cfg(test)]
mod tests {
    use evolvent_turning::TurningJob;

    use super::*;

    fn shipped(path: &str) -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../../../config")
            .join(path)
    }

    fn arguments(job: PathBuf) -> TurnArgs {
        TurnArgs {
            job,
            machine: shipped("machines/lathe-2axis.toml"),
            ..TurnArgs::default()
        }
    }

    #[test]
    fn worked_example_reaches_size_within_load_and_faster() {
        let folder = tempfile::tempdir().unwrap();
        let (report, program) = (folder.path().join("turn.html"), folder.path().join("turn.ngc"));
        let args = TurnArgs {
            report: Some(report.clone()),
            program: Some(program.clone()),
            json: true,
            ..arguments(shipped("processes/turn-shaft.toml"))
        };
        let (mut out, mut err) = (Vec::new(), Vec::new());
        assert_eq!(run(&args, &mut out, &mut err), Ok(Ending::Clean));
        let answer: serde_json::Value = serde_json::from_slice(&out).unwrap();
        let number = |pointer: &str| answer.pointer(pointer).unwrap().as_f64().unwrap();
        assert_eq!(answer["outcome"], "done");
        assert!(number("/figures/peak_over_set") < 1.3 && number("/figures/residual_mm") <= 0.1);
        assert!(number("/figures/time_s") < 0.79 * number("/fixed/stock not known, same load/time_s"));
        assert!((number("/regime/depth_back_off_mm") - 3.0547).abs() < 1e-4);

        let page = std::fs::read_to_string(report).unwrap();
        assert!(page.contains("<svg") && page.contains("at size") && !page.contains("NaN"));

        // The program follows the same path: equal length within a few percent, and down to the final radius.
        let text = std::fs::read_to_string(program).unwrap();
        let (mut at, mut minutes, mut lowest) = ((0.0, 0.0), 0.0, f64::INFINITY);
        for line in text
            .lines()
            .filter(|line| line.starts_with("G0") || line.starts_with("G1"))
        {
            let word = |letter: char| {
                line.split_whitespace()
                    .find_map(|word| word.strip_prefix(letter))
                    .map(|number| number.parse::<f64>().unwrap())
            };
            let to = (word('X').unwrap_or(at.0), word('Z').unwrap_or(at.1));
            if let Some(feed) = word('F') {
                minutes += f64::hypot(to.0 - at.0, to.1 - at.1) / feed;
            }
            at = to;
            lowest = lowest.min(at.0);
        }
        assert_eq!(lowest, 30.0);
        let feeding_s = number("/figures/time_s") - number("/figures/return_s");
        assert!(
            (60.0 * minutes / feeding_s - 1.0).abs() < 0.03,
            "{} s of {feeding_s} s",
            60.0 * minutes
        );
    }

    #[test]
    fn an_output_over_the_job_file_is_refused_first() {
        let folder = tempfile::tempdir().unwrap();
        let job = folder.path().join("job.toml");
        let text = std::fs::read(shipped("processes/turn-shaft.toml")).unwrap();
        std::fs::write(&job, &text).unwrap();
        let there = Some(folder.path().join("./job.toml"));
        let page = Some(folder.path().join("a.svg"));
        for (args, expected) in [
            (
                TurnArgs {
                    program: there.clone(),
                    ..arguments(job.clone())
                },
                "is the job file itself; name another file to write to",
            ),
            (
                TurnArgs {
                    trace: there,
                    ..arguments(job.clone())
                },
                "is the job file itself",
            ),
            (
                TurnArgs {
                    report: page.clone(),
                    program: page,
                    ..arguments(job.clone())
                },
                "named for two outputs; name two files",
            ),
        ] {
            let refused = run(&args, &mut Vec::new(), &mut Vec::new());
            assert!(
                matches!(&refused, Err(CommandError::Usage(text)) if text.contains(expected)),
                "{refused:?}"
            );
            assert_eq!(std::fs::read(&job).unwrap(), text);
        }
    }

    #[test]
    fn no_program_is_made_of_passes_that_end_in_a_fault() {
        let folder = tempfile::tempdir().unwrap();
        let (job, program) = (folder.path().join("job.toml"), folder.path().join("turn.ngc"));
        let good = std::fs::read_to_string(shipped("processes/turn-shaft.toml")).unwrap();
        std::fs::write(&job, good.replace("overload_n = 3300.0", "overload_n = 2210.0")).unwrap();
        let args = TurnArgs {
            program: Some(program.clone()),
            ..arguments(job)
        };
        let mut err = Vec::new();
        assert_eq!(run(&args, &mut Vec::new(), &mut err), Ok(Ending::Negative));
        let err = String::from_utf8(err).unwrap();
        assert!(
            err.contains("turn.ngc was not written: the passes are incomplete"),
            "{err}"
        );
        assert!(!program.exists());
    }

    #[test]
    fn errors_in_a_job_name_file_line_and_key() {
        let good = std::fs::read_to_string(shipped("processes/turn-shaft.toml")).unwrap();
        let folder = tempfile::tempdir().unwrap();
        for (from, to, expected) in [
            ("lead_deg = 60.0", "lead_deg = 95.0", "95 degrees"),
            (
                "min_mm_rev = 0.2",
                "min_mm_rev = 0.35",
                "2.520 times the smallest",
            ),
            ("edge_mm = 12.0", "edge_mm = 5.0", "longer than the edge"),
            (
                "permitted_n = 3500.0",
                "permitted_n = 2000.0",
                "above the permitted load",
            ),
            ("spindle_rpm = 500.0", "spindle_rpm = nan", "spindle_rpm"),
            ("spindle_rpm = 500.0", "speed_rpm = 500.0", "speed_rpm"),
            (
                "allowance_max_mm = 10.2",
                "allowance_max_mm = 12.0",
                "reaches 10.39 mm",
            ),
            ("coefficient_n = 2943.0", "name = \"42Z\"", "either a name"),
            (
                "outline_mm = [[0.0, 10.0], [200.0, 5.0]]",
                "outline_mm = []",
                "one point",
            ),
            ("[stock]", "[stok]", "stok"),
        ] {
            assert!(good.contains(from), "{from}");
            let file = folder.path().join("job.toml");
            std::fs::write(&file, good.replace(from, to)).unwrap();
            let Err(CommandError::Usage(text)) = run(&arguments(file), &mut Vec::new(), &mut Vec::new())
            else {
                panic!("{to} was taken");
            };
            assert!(text.contains(expected), "{to}: {text}");
        }
    }

    #[test]
    fn a_falling_force_law_is_fitted_by_a_power_law() {
        let good = std::fs::read_to_string(shipped("processes/turn-shaft.toml")).unwrap();
        let from = good.find("\ncoefficient_n").unwrap();
        let to = good.find("[load]").unwrap();
        let text =
            format!("{}\nname = \"40X-R1\"\n\n{}", &good[..from], &good[to..]).replace("500.0", "300.0");
        let job = TurningJob::parse(&text, "job.toml").unwrap();
        assert!(job.law_misfit > 0.0 && job.law_misfit < 0.1, "{}", job.law_misfit);
        assert!(job.settings.regime.law.depth_exponent > 0.8 && job.settings.regime.law.depth_exponent < 0.9);
    }
}
