//! `evolvent turn`: self-programmed turning on a simulated workpiece, its report, and the passes as a part program.

mod passes;
mod report;
mod trial;

use std::io::Write;
use std::path::{Path, PathBuf};

use clap::Args;
use evolvent_runtime::Clock;
use evolvent_turning::Figures;
use serde_json::json;

use crate::rate::write_whole;
use crate::{CommandError, Ending};
use trial::{Road, Trial};

/// Options of `evolvent turn`.
///
/// The job is tried on the stock of its file: the passes find themselves from the simulated cutting load, under the
/// machine's limits. docs/theory-turning.md leads through an example and names every assumption.
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
    /// Write the passes that were found as a part program for this stock
    #[arg(long, value_name = "FILE.ngc")]
    pub(crate) program: Option<PathBuf>,
    /// Record every cycle, and every change of state with its reason
    #[arg(long, value_name = "FILE.mcap")]
    pub(crate) trace: Option<PathBuf>,
    /// Publish the setpoints on the bus
    #[arg(long)]
    pub(crate) bus: bool,
    /// Turn in real time, by the load on the bus, instead of trying the job on the stock of its file
    #[arg(long)]
    pub(crate) realtime: bool,
    /// Prefix of the bus's files, as of `evolvent run`
    #[arg(long, value_name = "PREFIX")]
    pub(crate) bus_prefix: Option<String>,
    /// Tell every change of state with its reason
    #[arg(long)]
    pub(crate) log: bool,
    /// Print one JSON object on standard output
    #[arg(long)]
    pub(crate) json: bool,
}

/// Tries the job.
///
/// # Errors
/// `Usage` for a bad job or machine, `Failed` where the machine's guard refuses a setpoint or a file cannot be written.
pub(crate) fn run(args: &TurnArgs, out: &mut dyn Write, err: &mut dyn Write) -> Result<Ending, CommandError> {
    let job = crate::process::read(&args.job)?;
    if let Some(report) = &args.report {
        let good = ["html", "svg"];
        let extension = report.extension().unwrap_or_default().to_string_lossy();
        if !good.iter().any(|name| extension.eq_ignore_ascii_case(name)) {
            return Err(CommandError::Usage(format!(
                "{}: reports are HTML or SVG: let the name end in .html or .svg",
                report.display()
            )));
        }
    }
    let road = Road {
        clock: if args.realtime {
            Clock::Realtime
        } else {
            Clock::Virtual
        },
        trace: args.trace.clone(),
        bus: args.bus || args.realtime,
        bus_prefix: args.bus_prefix.as_deref(),
    };
    let trial = Trial::run(job, &args.machine, &road)?;
    let machine = trial.machine.clone();
    let failed = |file: &Path, error: &std::io::Error| {
        CommandError::Failed(format!("{}: cannot be written: {error}", file.display()))
    };
    if let Some(file) = &args.report {
        let svg = report::svg(&trial, &machine);
        let html = file
            .extension()
            .is_some_and(|extension| extension.eq_ignore_ascii_case("html"));
        let text = if html {
            report::html(&trial, &machine, &svg)
        } else {
            svg
        };
        write_whole(file, text.as_bytes()).map_err(|error| failed(file, &error))?;
    }
    if let Some(file) = &args.program {
        let text = passes::program(&trial);
        write_whole(file, text.as_bytes()).map_err(|error| failed(file, &error))?;
    }
    let written = if args.json {
        writeln!(out, "{}", object(&trial, &machine))
    } else {
        out.write_all(text(&trial, &machine, args.log).as_bytes())
    };
    written.map_err(|error| CommandError::Failed(format!("cannot write: {error}")))?;
    for note in &trial.notes {
        let _told = writeln!(err, "note: {note}");
    }
    Ok(if trial.figures.done {
        Ending::Clean
    } else {
        Ending::Negative
    })
}

/// One line of the comparison: what, figures, time saved by the job in percent.
pub(crate) fn comparison(trial: &Trial) -> Vec<(&'static str, Figures, f64)> {
    let saved = |figures: &Figures| 100.0 * (1.0 - trial.figures.time_s / figures.time_s);
    trial
        .fixed
        .iter()
        .map(|(name, figures)| (*name, *figures, saved(figures)))
        .collect()
}

fn text(trial: &Trial, machine: &str, log: bool) -> String {
    use std::fmt::Write as _;
    let (figures, settings) = (&trial.figures, &trial.job.settings);
    let regime = &settings.regime;
    let mut text = String::new();
    // Writing to a string cannot fail.
    let _ = writeln!(
        text,
        "{} on {machine}: {} (simulated stock and sensor)\n  \
         set load {:.0} N; feed {:.3} to {:.3} mm/rev; backs off from {:.3} mm to {:.3} mm at {:.4} mm/rev; full feed \
         below {:.3} mm",
        trial.job.name,
        trial.outcome(),
        regime.set_load,
        regime.feed_min_mm_rev,
        regime.feed_max_mm_rev,
        regime.depth_max_mm,
        regime.depth_back_off_mm,
        regime.feed_back_off_mm_rev,
        regime.depth_full_feed_mm,
    );
    let _ = writeln!(
        text,
        "  {} passes (equation 5: {}), {} times backed off, {:.1} s, of that {:.1} s in air and {:.1} s moving back",
        figures.passes,
        regime.passes(trial.highest_mm),
        figures.back_offs,
        figures.time_s,
        figures.air_s,
        figures.return_s
    );
    let _ = writeln!(
        text,
        "  load at most {:.3} of the set one, above 1.2 for {:.3} s, above 1.3 for {:.3} s at a stretch (a revolution \
         takes {:.3} s)\n  left standing at most {:.4} mm",
        figures.peak / regime.set_load,
        figures.over_120_s,
        figures.over_130_s,
        settings.turn_s(),
        figures.residual_mm
    );
    let _ = writeln!(
        text,
        "\n  against fixed passes (G82)            passes   time s   peak   time saved"
    );
    for (name, fixed, saved) in comparison(trial) {
        let _ = writeln!(
            text,
            "    {name:<34}{:>7}{:>9.1}{:>7.3}{saved:>11.1} %",
            fixed.passes,
            fixed.time_s,
            fixed.peak / regime.set_load
        );
    }
    if log {
        let _ = writeln!(text);
        for change in &trial.changes {
            let _ = writeln!(
                text,
                "  {:9.3} s  pass {:<3} {:>8.2} mm along, {:>6.3} mm out, {:>6.0} N, {:.3} mm/rev: {:?}, because {}",
                change.cycle as f64 * settings.period_s,
                change.pass,
                change.along_mm,
                change.out_mm,
                change.load,
                change.feed_mm_rev,
                change.to,
                change.reason.text()
            );
        }
    }
    text
}

fn figures_object(figures: &Figures, set_load: f64) -> serde_json::Value {
    json!({
        "passes": figures.passes,
        "time_s": figures.time_s,
        "air_s": figures.air_s,
        "return_s": figures.return_s,
        "back_offs": figures.back_offs,
        "peak_n": figures.peak,
        "peak_over_set": figures.peak / set_load,
        "over_120_s": figures.over_120_s,
        "longest_over_130_s": figures.over_130_s,
        "residual_mm": figures.residual_mm,
    })
}

fn object(trial: &Trial, machine: &str) -> serde_json::Value {
    let regime = &trial.job.settings.regime;
    let fixed: serde_json::Map<_, _> = trial
        .fixed
        .iter()
        .map(|(name, figures)| ((*name).to_owned(), figures_object(figures, regime.set_load)))
        .collect();
    json!({
        "job": trial.job.name,
        "machine": machine,
        "outcome": trial.outcome(),
        "simulated": true,
        "regime": {
            "set_n": regime.set_load,
            "feed_back_off_mm_rev": regime.feed_back_off_mm_rev,
            "depth_max_mm": regime.depth_max_mm,
            "depth_back_off_mm": regime.depth_back_off_mm,
            "depth_full_feed_mm": regime.depth_full_feed_mm,
            "passes": regime.passes(trial.highest_mm),
            "law_misfit": trial.job.law_misfit,
        },
        "figures": figures_object(&trial.figures, regime.set_load),
        "fixed": fixed,
        "transitions": trial.changes.iter().map(|change| json!({
            "time_s": change.cycle as f64 * trial.job.settings.period_s,
            "pass": change.pass,
            "from": format!("{:?}", change.from),
            "to": format!("{:?}", change.to),
            "reason": change.reason.text(),
            "along_mm": change.along_mm,
            "out_mm": change.out_mm,
            "load_n": change.load,
            "feed_mm_rev": change.feed_mm_rev,
            "depth_mm": change.depth_mm,
        })).collect::<Vec<_>>(),
    })
}

#[cfg(test)]
mod tests {
    use evolvent_turning::Job;

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
    fn the_worked_example_comes_to_size_within_its_load_and_saves_time() {
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

        // The program goes the same way: as long, within a few percent, and down to the final radius.
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
    fn what_is_wrong_with_a_job_is_told_with_file_line_and_key() {
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
    fn a_law_with_a_falling_section_is_taken_as_its_power_law_and_the_difference_is_told() {
        let good = std::fs::read_to_string(shipped("processes/turn-shaft.toml")).unwrap();
        let from = good.find("\ncoefficient_n").unwrap();
        let to = good.find("[load]").unwrap();
        let text =
            format!("{}\nname = \"40X-R1\"\n\n{}", &good[..from], &good[to..]).replace("500.0", "300.0");
        let job = Job::parse(&text, "job.toml").unwrap();
        assert!(job.law_misfit > 0.0 && job.law_misfit < 0.1, "{}", job.law_misfit);
        assert!(job.settings.regime.law.depth_exponent > 0.8 && job.settings.regime.law.depth_exponent < 0.9);
    }
}
