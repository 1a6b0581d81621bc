//! Machining time, limits, tolerance and cost of planning over a folder of programs:
//!
//!     cargo bench -p evolvent-judge --bench programs -- [FOLDER|FILE ...] [--planner NAME] [--rate HZ]
//!         [--machine FILE] [--only TEXT] [--json] [--write DIR]
//!
//! Without a folder: the programs of tests/programs and those that this crate writes itself. `--write DIR` writes the
//! latter and runs nothing. Every sample is checked by the judge, which shares no code with planners.

#![allow(clippy::print_stdout, clippy::print_stderr, reason = "a benchmark prints")]

#[path = "support/peers.rs"]
mod peers;
#[path = "support/trial.rs"]
mod trial;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use evolvent_judge::{Allowances, suite};
use peers::{Peer, peers};
use serde_json::json;
use trial::{Planner, Trial, root, setup, trial};

#[derive(Debug)]
struct Options {
    places: Vec<PathBuf>,
    planner: Planner,
    rate_hz: Option<f64>,
    machine: PathBuf,
    only: Option<String>,
    json: bool,
    write: Option<PathBuf>,
}

impl Options {
    fn read() -> Result<Self, String> {
        let mut options = Self {
            places: Vec::new(),
            planner: Planner::Default,
            rate_hz: None,
            machine: root().join("config/machines/bench-3axis.toml"),
            only: None,
            json: false,
            write: None,
        };
        let mut words = std::env::args().skip(1);
        while let Some(word) = words.next() {
            let mut value = || words.next().ok_or_else(|| format!("{word} needs a value"));
            match word.as_str() {
                // Cargo says it to every benchmark.
                "--bench" => {}
                "--json" => options.json = true,
                "--planner" => options.planner = Planner::of(&value()?)?,
                "--rate" => {
                    let text = value()?;
                    let rate = text.parse().map_err(|_| format!("{text:?} is no rate in Hz"))?;
                    options.rate_hz = Some(rate);
                }
                "--machine" => options.machine = value()?.into(),
                "--only" => options.only = Some(value()?),
                "--write" => options.write = Some(value()?.into()),
                flag if flag.starts_with('-') => return Err(format!("there is no option {flag}")),
                place => options.places.push(place.into()),
            }
        }
        Ok(options)
    }
}

/// Programs of a folder in the order of their names, or one program.
fn programs(place: &Path) -> Result<Vec<PathBuf>, String> {
    let fail = |error: std::io::Error| format!("{}: {error}", place.display());
    if place.is_file() {
        return Ok(vec![place.to_owned()]);
    }
    let mut files = Vec::new();
    for entry in std::fs::read_dir(place).map_err(fail)? {
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

fn report(name: &str, trial: &Trial, peer: Option<&Peer>, json: bool, totals: &mut Totals) {
    let verdict = &trial.verdict;
    let time = verdict.duration_s;
    let violations = verdict.violations(&Allowances::default());
    let blocks_per_s = verdict.blocks as f64 / trial.planning_s.max(1e-9);
    let load = trial.planning_s / time.max(1e-9);
    let whole = trial.error.is_none() && trial.summary.outcome == "done";
    if !violations.is_empty() {
        totals.violated += 1;
    }
    if !whole {
        totals.failed += 1;
    }
    let ratio = peer.filter(|_| whole).map(|peer| {
        totals.trapezoid.add(time / peer.trapezoid_s);
        totals.s_curve.add(time / peer.s_curve_s);
        (time / peer.trapezoid_s, time / peer.s_curve_s)
    });
    if json {
        let value = json!({
            "name": name, "outcome": trial.summary.outcome, "error": trial.error, "verdict": verdict,
            "violations": violations, "planning_s": trial.planning_s, "reading_s": trial.reading_s, "load": load,
            "blocks_per_s": blocks_per_s, "starved_cycles": trial.summary.starved_cycles,
            "trapezoid_s": peer.map(|peer| peer.trapezoid_s), "s_curve_s": peer.map(|peer| peer.s_curve_s),
        });
        println!("{value}");
        return;
    }
    let mut deviation = format!("{:.2}", verdict.deviation_mm.value * 1e3);
    if verdict.deviation_deg.value > 0.0 {
        deviation.push_str(&format!(" + {:.4} deg", verdict.deviation_deg.value));
    }
    println!(
        "| {name} | {} | {:.1} | {time:.3} | {} | {} | {:.4} | {:.4} | {:.4} | {deviation} | {:.3} | {:.4} | {:.3} | {:.2} % | {:.0} | {} |",
        verdict.blocks,
        verdict.path_mm,
        number(ratio.map(|ratio| ratio.0), 3),
        number(ratio.map(|ratio| ratio.1), 3),
        verdict.velocity.value,
        verdict.acceleration.value,
        verdict.jerk.value,
        verdict.chord.value,
        verdict.feed.value,
        trial.planning_s,
        load * 100.0,
        blocks_per_s,
        if violations.is_empty() && whole {
            "ok".to_owned()
        } else {
            let mut words: Vec<String> = violations.iter().map(ToString::to_string).collect();
            if !whole {
                words.insert(0, trial.summary.outcome.to_owned());
                words.extend(trial.error.iter().map(|error| error.lines().take(1).collect()));
            }
            words.join("; ")
        }
    );
}

fn bench(options: &Options) -> Result<(), String> {
    if let Some(folder) = &options.write {
        let files = write_suite(folder)?;
        println!("{} programs in {}", files.len(), folder.display());
        return Ok(());
    }
    let setup = setup(&options.machine, options.rate_hz, options.planner)?;
    let peers: BTreeMap<String, Peer> = peers()?;
    let own;
    let mut files = Vec::new();
    if options.places.is_empty() {
        files.extend(programs(&root().join("tests/programs"))?);
        own = tempfile::tempdir().map_err(|error| error.to_string())?;
        files.extend(write_suite(own.path())?);
    }
    for place in &options.places {
        files.extend(programs(place)?);
    }
    if let Some(only) = &options.only {
        files.retain(|file| name_of(file).contains(only));
    }
    if !options.json {
        println!(
            "{}, {:.0} Hz, planner {:?}\n",
            setup.machine.name,
            setup.rate_hz(),
            options.planner
        );
        println!(
            "| program | blocks | path mm | time s | / 2.9 | / 2.10 S | v | a | j | deviation um | chord | feed | planning s | load | blocks/s | judged |"
        );
        println!("|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|");
    }
    let mut totals = Totals::default();
    for file in &files {
        let name = name_of(file);
        totals.programs += 1;
        match trial(file, &setup) {
            Ok(trial) => report(&name, &trial, peers.get(&name), options.json, &mut totals),
            Err(error) => {
                totals.failed += 1;
                let first = error.lines().next().unwrap_or_default();
                if options.json {
                    println!("{}", json!({"name": name, "error": error}));
                } else {
                    println!("| {name} | | | | | | | | | | | | | | | {first} |");
                }
            }
        }
    }
    if options.json {
        let value = json!({
            "programs": totals.programs, "failed": totals.failed, "violated": totals.violated,
            "compared": totals.trapezoid.0.len(),
            "trapezoid_ratio": totals.trapezoid.value(), "s_curve_ratio": totals.s_curve.value(),
        });
        println!("{value}");
    } else {
        println!(
            "\n{} programs, {} not run to their end, {} with violations. Geometric mean of {} times: {} of LinuxCNC 2.9, {} of 2.10's S-curve.",
            totals.programs,
            totals.failed,
            totals.violated,
            totals.trapezoid.0.len(),
            number(totals.trapezoid.value(), 3),
            number(totals.s_curve.value(), 3)
        );
    }
    Ok(())
}

fn main() -> ExitCode {
    match Options::read().and_then(|options| bench(&options)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::from(2)
        }
    }
}
