//! `evolvent plan`: the same code as a run, with the virtual clock and without clients.

use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::Args;
use evolvent_analysis::{
    ChatterWarnings, Explanation, FeedWords, LimitClassifier, LineExplainer, LongestStopReport, NeededRate,
    PlanFigure, chatter_warnings, sort_process_files,
};
use evolvent_config::{OutputFile, check_outputs, write_whole};
use evolvent_machine::{Machine, PlannerKind};
use evolvent_motion::{Setpoint, StoppingDistance};
use evolvent_runtime::{CheckBounds, Clock, Controls, Job, RunOutcome};

use crate::program::{ProgramArgs, parse_override};
use crate::run::report;
use crate::screen::Screen;
use crate::{CommandError, Ending};

/// Options of `evolvent plan`.
#[derive(Debug, Args)]
pub(crate) struct PlanArgs {
    #[command(flatten)]
    program: ProgramArgs,
    /// Write every setpoint as CSV: time, position, velocity, acceleration and jerk of every axis.
    #[arg(long, value_name = "FILE.csv")]
    setpoints: Option<PathBuf>,
    /// Draw the path coloured by feed and by what limits it, and feed, velocity, acceleration and jerk over
    /// time.
    #[arg(long, value_name = "FILE.svg")]
    plot: Option<PathBuf>,
    /// Explain why the machine is slow on this line of the program, and what would help (by planning again).
    #[arg(long, value_name = "LINE", value_parser = clap::value_parser!(u32).range(1..))]
    explain: Option<u32>,
    /// File of changes of the machine's inputs, for the virtual clock. Without it no input is known, so M66
    /// ends by its timeout, and an emergency-stop chain is closed.
    #[arg(long, value_name = "FILE.toml")]
    inputs: Option<PathBuf>,
    /// Feed override in percent, 1 to 200.
    #[arg(long = "override", value_name = "PCT", value_parser = parse_override, default_value = "100")]
    feed_override: f64,
    /// The cutting process: a case file of `evolvent chatter` warns of turning cuts that are predicted to
    /// vibrate; a process file of `evolvent turn` lets cycles with Q1 compute their passes, on its stock. At
    /// most one of each.
    #[arg(long, value_name = "FILE.toml")]
    process: Vec<PathBuf>,
    /// Print the plan as one JSON object.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &PlanArgs, out: &mut dyn Write, err: &mut dyn Write) -> Result<Ending, CommandError> {
    let mut setup = args.program.setup()?;
    crate::program::warn_of_machine(&setup, err);
    let case = sort_process_files(&mut setup, &args.process, Clock::Virtual)?;
    let mut inputs = args.program.inputs(&setup);
    inputs.extend(args.inputs.as_deref().map(|file| (file, "the file of inputs")));
    inputs.extend(
        args.process
            .iter()
            .map(|file| (file.as_path(), "the process file")),
    );
    let outputs = args.setpoints.iter().chain(&args.plot);
    check_outputs(outputs.map(PathBuf::as_path), inputs)?;
    args.program.tell_start(&setup, err)?;
    let machine = setup.machine.clone();
    let period_s = setup.period_ns as f64 * 1e-9;
    let chatter = match case {
        Some(case) => Some(chatter_warnings(
            &args.program.program,
            &setup,
            case,
            CheckBounds::whole(1),
        )?),
        None => None,
    };
    if let Some(chatter) = chatter.as_ref().filter(|_| !args.json) {
        crate::chatter::write_warnings(chatter, err, &args.program.program.display().to_string());
    }
    let job = Job {
        feed_override: args.feed_override,
        inputs: crate::program::inputs(args.inputs.as_deref(), &machine)?,
        ..Job::new(args.program.program.clone(), setup)
    };
    let mut table = match &args.setpoints {
        Some(path) => Some(Table::create(path, &machine)?),
        None => None,
    };
    let mut figure = args.plot.as_ref().map(|_| PlanFigure::new(&machine, period_s));
    let mut explainer = match args.explain {
        Some(line) => Some(LineExplainer::new(line, &job, &machine, period_s)?),
        None => None,
    };
    let mut feeds = match (&args.plot, args.explain) {
        (None, None) => None,
        _ => Some(
            FeedWords::open(&job.program, &job.setup)
                .map_err(|error| CommandError::Failed(error.to_string()))?,
        ),
    };
    let classifier = LimitClassifier::new(&machine, period_s);
    let mut needed = NeededRate::default();
    let mut stops = match machine.path.planner {
        PlannerKind::Optimal => Some(StoppingDistance::new(machine.limits(), period_s)),
        PlannerKind::Classic => None,
    };
    let mut failure: Option<io::Error> = None;
    let controls = Arc::new(Controls::new(args.feed_override));
    let mut screen = Screen::new(&job.program, args.json, false);
    let result = evolvent_runtime::run(&job, &controls, &mut screen, |setpoint| {
        needed.see(setpoint, &machine);
        if let Some(stops) = &mut stops {
            stops.push(setpoint);
        }
        let word = feeds
            .as_mut()
            .and_then(|feeds| feeds.at(setpoint.block, setpoint.path_mm));
        if let Some(figure) = &mut figure {
            figure.see(setpoint, word, classifier.classify(setpoint, word));
        }
        if let Some(explainer) = &mut explainer {
            explainer.see(setpoint, word);
        }
        if let Some(table) = &mut table
            && failure.is_none()
        {
            failure = table.write(setpoint, period_s).err();
        }
    });
    screen.finish();
    let outcome = result.map_err(|error| CommandError::Failed(error.to_string()))?;
    if let Some(table) = table {
        table.finish(failure)?;
    }
    if let (Some(figure), Some(path)) = (&figure, &args.plot) {
        let summary = &outcome.summary;
        let svg = figure.svg(&format!("{} on {}", summary.program, summary.machine));
        write_whole(path, svg.as_bytes())
            .map_err(|error| CommandError::Failed(format!("{}: {error}", path.display())))?;
    }
    let is_whole = outcome.program.is_ok() && outcome.fault.is_none();
    let explanation = explainer.map(|explainer| explainer.finish(&job, is_whole));
    let stop = LongestStopReport::new(stops.as_ref(), period_s);
    let findings = Findings {
        needed,
        stop,
        explanation,
        chatter,
    };
    findings.write(args.json, &outcome, out, err)
}

/// Results besides the summary.
struct Findings {
    needed: NeededRate,
    stop: LongestStopReport,
    explanation: Option<Explanation>,
    chatter: Option<ChatterWarnings>,
}

impl Findings {
    fn write(
        &self,
        json: bool,
        outcome: &RunOutcome,
        out: &mut dyn Write,
        err: &mut dyn Write,
    ) -> Result<Ending, CommandError> {
        let lost = |error: io::Error| CommandError::Failed(format!("the plan cannot be written: {error}"));
        if json {
            let text = merge(
                &outcome.summary,
                &self.needed,
                &self.stop,
                self.explanation.as_ref(),
                self.chatter.as_ref(),
            )
            .map_err(io::Error::from);
            text.and_then(|text| writeln!(out, "{text}")).map_err(lost)?;
            return report(true, outcome, &mut io::sink(), err);
        }
        if let Some(explanation) = &self.explanation {
            write!(out, "{explanation}").map_err(lost)?;
            return report(true, outcome, &mut io::sink(), err);
        }
        let ending = report(false, outcome, out, err)?;
        writeln!(out, "  {}", self.needed).map_err(lost)?;
        if let Some(stop) = self.stop.text() {
            writeln!(out, "  {stop}").map_err(lost)?;
        }
        Ok(ending)
    }
}

/// The summary's JSON with the rate's fields, the warnings and the explanation.
fn merge(
    summary: &evolvent_runtime::Summary,
    needed: &NeededRate,
    stop: &LongestStopReport,
    explanation: Option<&Explanation>,
    chatter: Option<&ChatterWarnings>,
) -> serde_json::Result<String> {
    let mut object = serde_json::to_value(summary)?;
    if let (Some(object), serde_json::Value::Object(more)) =
        (object.as_object_mut(), serde_json::to_value(needed)?)
    {
        object.extend(more);
        if let serde_json::Value::Object(stop) = serde_json::to_value(stop)? {
            object.extend(stop);
        }
        object.insert("warnings".to_owned(), serde_json::to_value(&summary.notes)?);
        let found = chatter.map_or(&[][..], ChatterWarnings::found);
        object.insert("chatter".to_owned(), serde_json::to_value(found)?);
        let omissions = chatter.map_or(&[][..], ChatterWarnings::omissions);
        object.insert("chatter_omissions".to_owned(), serde_json::to_value(omissions)?);
        if let Some(explanation) = explanation {
            object.insert("explanation".to_owned(), serde_json::to_value(explanation)?);
        }
    }
    serde_json::to_string(&object)
}

/// Setpoints as CSV. An incomplete table is an error, since a reader could not recognize it.
struct Table {
    out: BufWriter<OutputFile>,
    path: PathBuf,
    axes: Vec<usize>,
}

impl Table {
    fn create(path: &Path, machine: &Machine) -> Result<Self, CommandError> {
        let fail = |error: io::Error| CommandError::Failed(format!("{}: {error}", path.display()));
        let mut out = BufWriter::with_capacity(1 << 20, OutputFile::create(path).map_err(fail)?);
        let mut head = "sequence,time_s,line,path_mm,feed_mm_s".to_owned();
        for order in ["", "'", "''", "'''"] {
            for axis in &machine.axes {
                let unit = if axis.letter.is_rotary() { "deg" } else { "mm" };
                let per = ["", "_s", "_s2", "_s3"][order.len()];
                head.push_str(&format!(",{}{order}_{unit}{per}", axis.letter.letter()));
            }
        }
        writeln!(out, "{head}").map_err(fail)?;
        let axes = machine.axes.iter().map(|axis| axis.letter.index()).collect();
        Ok(Self {
            out,
            path: path.to_owned(),
            axes,
        })
    }

    fn write(&mut self, setpoint: &Setpoint, period_s: f64) -> io::Result<()> {
        let time = (setpoint.sequence + 1) as f64 * period_s;
        write!(
            self.out,
            "{},{time},{},{},{}",
            setpoint.sequence, setpoint.line, setpoint.path_mm, setpoint.feed_mm_s
        )?;
        for values in [
            &setpoint.position,
            &setpoint.velocity,
            &setpoint.acceleration,
            &setpoint.jerk,
        ] {
            for &axis in &self.axes {
                write!(self.out, ",{}", values[axis])?;
            }
        }
        writeln!(self.out)
    }

    fn finish(self, failure: Option<io::Error>) -> Result<(), CommandError> {
        let done = match failure {
            Some(error) => Err(error),
            None => self
                .out
                .into_inner()
                .map_err(io::IntoInnerError::into_error)
                .and_then(OutputFile::finish),
        };
        done.map(drop)
            .map_err(|error| CommandError::Failed(format!("{}: {error}", self.path.display())))
    }
}
