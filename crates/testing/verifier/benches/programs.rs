//! Machining time, limits, tolerance and cost of planning over a folder of programs:
//!
//!     cargo bench -p evolvent-verifier --bench programs -- [FOLDER|FILE ...] [--planner NAME|both]
//!         [--rate HZ] [--machine FILE] [--only TEXT] [--json] [--strict] [--write DIR]
//!
//! `--planner both` compares the planners side by side. Without a folder: the programs of tests/programs and
//! those that this crate generates. `--write DIR` writes the latter and runs nothing. `--strict` ends with
//! exit code 1 if anything was violated or did not run to its end. Every sample is checked by the judge,
//! which shares no code with the planners.

#![expect(clippy::print_stdout, clippy::print_stderr, reason = "a benchmark prints")]

#[path = "support/peers.rs"]
mod peers;
#[path = "support/trial.rs"]
mod trial;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use evolvent_machine::PlannerKind;
use evolvent_runtime::Setup;
use evolvent_verifier::{Allowances, suite};
use peers::{Peer, peers};
use serde_json::json;
use trial::{Trial, planner_of, root, setup, trial};

#[derive(Debug)]
struct Options {
    paths: Vec<PathBuf>,
    planners: Vec<Option<PlannerKind>>,
    rate_hz: Option<f64>,
    machine: PathBuf,
    only: Option<String>,
    json: bool,
    strict: bool,
    write: Option<PathBuf>,
}

impl Options {
    fn read() -> Result<Self, String> {
        let mut options = Self {
            paths: Vec::new(),
            planners: vec![None],
            rate_hz: None,
            machine: root().join("config/machines/bench-3axis.toml"),
            only: None,
            json: false,
            strict: false,
            write: None,
        };
        let mut words = std::env::args().skip(1);
        while let Some(word) = words.next() {
            let mut value = || words.next().ok_or_else(|| format!("{word} needs a value"));
            match word.as_str() {
                // Cargo passes it to every benchmark.
                "--bench" => {}
                "--json" => options.json = true,
                "--strict" => options.strict = true,
                "--planner" => {
                    let name = value()?;
                    options.planners = match name.as_str() {
                        "both" => vec![Some(PlannerKind::Classic), Some(PlannerKind::Optimal)],
                        one => vec![Some(planner_of(one)?)],
                    };
                }
                "--rate" => {
                    let text = value()?;
                    let rate = text.parse().map_err(|_| format!("{text:?} is no rate in Hz"))?;
                    options.rate_hz = Some(rate);
                }
                "--machine" => options.machine = value()?.into(),
                "--only" => options.only = Some(value()?),
                "--write" => options.write = Some(value()?.into()),
                flag if flag.starts_with('-') => return Err(format!("there is no option {flag}")),
                path => options.paths.push(path.into()),
            }
        }
        Ok(options)
    }
}

/// Programs of a folder in the order of their names, or one program.
fn programs(path: &Path) -> Result<Vec<PathBuf>, String> {
    let fail = |error: std::io::Error| format!("{}: {error}", path.display());
    if path.is_file() {
        return Ok(vec![path.to_owned()]);
    }
    let mut files = Vec::new();
    for entry in std::fs::read_dir(path).map_err(fail)? {
        let path = entry.map_err(fail)?.path();
        if path.extension().is_some_and(|ending| ending == "ngc") {
            files.push(path);
        }
    }
    files.sort();
    Ok(files)
}

fn write_suite(folder: &Path) -> Result<Vec<PathBuf>, String> {
    let fail = |error: std::io::Error| format!("{}: {error}", folder.display());
    std::fs::create_dir_all(folder).map_err(fail)?;
    let mut files = Vec::new();
    for program in suite() {
        let path = folder.join(format!("{}.ngc", program.name));
        std::fs::write(&path, program.text).map_err(fail)?;
        files.push(path);
    }
    Ok(files)
}

/// Logarithms of ratios, for a geometric mean.
#[derive(Debug, Default)]
struct Mean(Vec<f64>);

impl Mean {
    fn add(&mut self, ratio: f64) {
        self.0.push(libm::log(ratio));
    }

    fn value(&self) -> Option<f64> {
        (!self.0.is_empty()).then(|| libm::exp(self.0.iter().sum::<f64>() / self.0.len() as f64))
    }
}

#[derive(Debug, Default)]
struct Totals {
    trapezoid: Mean,
    s_curve: Mean,
    programs: usize,
    failed: usize,
    violated: usize,
}

fn name_of(path: &Path) -> String {
    path.file_stem()
        .map_or_else(String::new, |stem| stem.to_string_lossy().into_owned())
}

fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
}

/// One program with one planner.
struct Row {
    name: String,
    result: Result<Trial, String>,
    peer: Option<Peer>,
}

impl Row {
    fn run(file: &Path, setup: &Setup, peers: &BTreeMap<String, Peer>) -> Self {
        let name = name_of(file);
        let peer = peers.get(&name).copied();
        let result = trial(file, setup);
        Self { name, result, peer }
    }

    /// The trial, if the program was run to its end.
    fn whole(&self) -> Option<&Trial> {
        let trial = self.result.as_ref().ok()?;
        (trial.error.is_none() && trial.summary.outcome.name() == "done").then_some(trial)
    }

    fn count(&self, totals: &mut Totals) {
        totals.programs += 1;
        let Ok(trial) = &self.result else {
            totals.failed += 1;
            return;
        };
        totals.violated += usize::from(!trial.verdict.violations(&Allowances::default()).is_empty());
        totals.failed += usize::from(self.whole().is_none());
        if let (Some(trial), Some(peer)) = (self.whole(), self.peer) {
            totals.trapezoid.add(trial.verdict.duration_s / peer.trapezoid_s);
            totals.s_curve.add(trial.verdict.duration_s / peer.s_curve_s);
        }
    }

    /// `ok`, or what was wrong.
    fn judged(&self) -> String {
        let trial = match &self.result {
            Ok(trial) => trial,
            Err(error) => return error.lines().next().unwrap_or_default().to_owned(),
        };
        let violations = trial.verdict.violations(&Allowances::default());
        let mut words: Vec<String> = Vec::new();
        if self.whole().is_none() {
            words.push(trial.summary.outcome.name().to_owned());
            words.extend(
                trial
                    .error
                    .iter()
                    .filter_map(|error| error.lines().next())
                    .map(str::to_owned),
            );
        }
        words.extend(violations.iter().map(ToString::to_string));
        if words.is_empty() {
            "ok".to_owned()
        } else {
            words.join("; ")
        }
    }

    fn ratios(&self) -> (Option<f64>, Option<f64>) {
        let time = self.whole().map(|trial| trial.verdict.duration_s);
        let over = |of: fn(&Peer) -> f64| Some(time? / of(self.peer.as_ref()?));
        (over(|peer| peer.trapezoid_s), over(|peer| peer.s_curve_s))
    }

    fn print(&self) {
        let name = &self.name;
        let Ok(trial) = &self.result else {
            println!("| {name} | | | | | | | | | | | | | | | {} |", self.judged());
            return;
        };
        let verdict = &trial.verdict;
        let mut deviation = format!("{:.2}", verdict.deviation_mm.value * 1e3);
        if verdict.deviation_deg.value > 0.0 {
            deviation.push_str(&format!(" + {:.4} deg", verdict.deviation_deg.value));
        }
        let (trapezoid, s_curve) = self.ratios();
        println!(
            "| {name} | {} | {:.1} | {:.3} | {} | {} | {:.4} | {:.4} | {:.4} | {deviation} | {:.3} | {:.4} \
             | {:.3} | {:.2} % | {:.0} | {} |",
            verdict.blocks,
            verdict.path_mm,
            verdict.duration_s,
            number(trapezoid, 3),
            number(s_curve, 3),
            verdict.velocity.value,
            verdict.acceleration.value,
            verdict.jerk.value,
            verdict.chord.value,
            verdict.feed.value,
            trial.planning_s,
            100.0 * load(trial),
            blocks_per_s(trial),
            self.judged()
        );
    }

    fn print_json(&self, planner: PlannerKind) {
        let planner = format!("{planner:?}").to_lowercase();
        let value = match &self.result {
            Err(error) => json!({"name": self.name, "planner": planner, "error": error}),
            Ok(trial) => json!({
                "name": self.name, "planner": planner, "outcome": trial.summary.outcome, "error": trial.error,
                "verdict": trial.verdict, "violations": trial.verdict.violations(&Allowances::default()),
                "planning_s": trial.planning_s, "reading_s": trial.reading_s, "load": load(trial),
                "blocks_per_s": blocks_per_s(trial), "starved_cycles": trial.summary.starved_cycles,
                "trapezoid_s": self.peer.map(|peer| peer.trapezoid_s),
                "s_curve_s": self.peer.map(|peer| peer.s_curve_s),
            }),
        };
        println!("{value}");
    }
}

/// Processor time of planning over the time of the motion.
fn load(trial: &Trial) -> f64 {
    trial.planning_s / trial.verdict.duration_s.max(1e-9)
}

fn blocks_per_s(trial: &Trial) -> f64 {
    trial.verdict.blocks as f64 / trial.planning_s.max(1e-9)
}

/// Prints the planners' times side by side.
fn print_beside(rows: &[Row], times: &mut Mean) {
    let time = |row: &Row| row.whole().map(|trial| trial.verdict.duration_s);
    let [one, other] = rows else { return };
    let gain = time(one).zip(time(other)).map(|(one, other)| other / one);
    if let Some(gain) = gain {
        times.add(gain);
    }
    let cost = |row: &Row| row.result.as_ref().ok().map(load).map(|load| 100.0 * load);
    let blocks = one.result.as_ref().map_or(0, |trial| trial.verdict.blocks);
    println!(
        "| {} | {blocks} | {} | {} | {} | {} | {} | {} % | {} % | {} | {} |",
        one.name,
        number(time(one), 3),
        number(time(other), 3),
        number(gain, 3),
        number(one.ratios().0, 3),
        number(other.ratios().0, 3),
        number(cost(one), 2),
        number(cost(other), 2),
        one.judged(),
        other.judged()
    );
}

fn print_head(setups: &[Setup]) {
    let names: Vec<String> = setups
        .iter()
        .map(|setup| format!("{:?}", setup.machine.path.planner).to_lowercase())
        .collect();
    let machine = &setups[0].machine.name;
    println!(
        "{machine}, {:.0} Hz, planner {}\n",
        setups[0].rate_hz(),
        names.join(" and ")
    );
    if let [one, other] = names.as_slice() {
        println!(
            "| program | blocks | {one} s | {other} s | {other} / {one} | {one} / 2.9 | {other} / 2.9 | \
             load {one} | load {other} | judged {one} | judged {other} |"
        );
        println!("|---|---|---|---|---|---|---|---|---|---|---|");
    } else {
        println!(
            "| program | blocks | path mm | time s | / 2.9 | / 2.10 S | v | a | j | deviation um | chord | \
             feed | planning s | load | blocks/s | judged |"
        );
        println!("|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|");
    }
}

fn print_totals(setups: &[Setup], totals: &[Totals], times: &Mean, json: bool) {
    if let (Some(gain), false) = (times.value(), json) {
        println!("\nGeometric mean of {} quotients: {gain:.3}.", times.0.len());
    }
    for (setup, totals) in setups.iter().zip(totals) {
        let planner = format!("{:?}", setup.machine.path.planner).to_lowercase();
        if json {
            let value = json!({
                "planner": planner, "programs": totals.programs, "failed": totals.failed,
                "violated": totals.violated, "compared": totals.trapezoid.0.len(),
                "trapezoid_ratio": totals.trapezoid.value(), "s_curve_ratio": totals.s_curve.value(),
            });
            println!("{value}");
            continue;
        }
        println!(
            "\n{planner}: {} programs, {} not run to their end, {} with violations. Geometric mean of {} \
             times: {} of LinuxCNC 2.9, {} of 2.10's S-curve.",
            totals.programs,
            totals.failed,
            totals.violated,
            totals.trapezoid.0.len(),
            number(totals.trapezoid.value(), 3),
            number(totals.s_curve.value(), 3)
        );
    }
}

/// Returns whether there was no violation.
fn bench(options: &Options) -> Result<bool, String> {
    if let Some(folder) = &options.write {
        let files = write_suite(folder)?;
        println!("{} programs in {}", files.len(), folder.display());
        return Ok(true);
    }
    let setups: Vec<Setup> = options
        .planners
        .iter()
        .map(|planner| setup(&options.machine, options.rate_hz, *planner))
        .collect::<Result<_, _>>()?;
    let peers: BTreeMap<String, Peer> = peers()?;
    let own;
    let mut files = Vec::new();
    if options.paths.is_empty() {
        files.extend(programs(&root().join("tests/programs"))?);
        own = tempfile::tempdir().map_err(|error| error.to_string())?;
        files.extend(write_suite(own.path())?);
    }
    for path in &options.paths {
        files.extend(programs(path)?);
    }
    if let Some(only) = &options.only {
        files.retain(|file| name_of(file).contains(only));
    }
    if !options.json {
        print_head(&setups);
    }
    let mut totals: Vec<Totals> = setups.iter().map(|_| Totals::default()).collect();
    let mut times = Mean::default();
    for file in &files {
        let mut rows = Vec::new();
        for (setup, totals) in setups.iter().zip(&mut totals) {
            let row = Row::run(file, setup, &peers);
            row.count(totals);
            if options.json {
                row.print_json(setup.machine.path.planner);
            } else if setups.len() == 1 {
                row.print();
            }
            rows.push(row);
        }
        if !options.json {
            print_beside(&rows, &mut times);
        }
    }
    print_totals(&setups, &totals, &times, options.json);
    Ok(totals.iter().all(|totals| totals.failed + totals.violated == 0))
}

fn main() -> ExitCode {
    let ended = Options::read().and_then(|options| Ok((bench(&options)?, options.strict)));
    match ended {
        Ok((false, true)) => ExitCode::FAILURE,
        Ok(_) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::from(2)
        }
    }
}
