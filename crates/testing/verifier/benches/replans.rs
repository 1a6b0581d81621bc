//! Cost of single re-plans: windows solved, Newton steps, and processor time of each:
//!
//!     cargo bench -p evolvent-verifier --bench replans -- [FOLDER|FILE ...] [--runs N]
//!
//! The planner runs alone on this thread. The time of a re-plan is the minimum of several runs (3 by
//! default), since the same window is solved in each; steps are the same in all of them.

#![expect(clippy::print_stdout, clippy::print_stderr, reason = "a benchmark prints")]
#![allow(dead_code, reason = "the shared part serves other benchmarks too")]

#[path = "support/trial.rs"]
mod trial;

use std::convert::Infallible;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use evolvent_gcode::{Action, Interpreter};
use evolvent_machine::PlannerKind;
use evolvent_planner::{ExitSpeeds, PlanSink, Planner, Segment, Step};
use evolvent_runtime::Setup;
use rustix::time::{ClockId, clock_gettime};
use trial::{root, setup};

fn cpu() -> f64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// A sink that takes everything and measures.
#[derive(Debug, Default)]
struct Meter {
    begun: f64,
    plans: Vec<(f64, u32)>,
}

impl PlanSink for Meter {
    type Error = Infallible;

    fn segment(&mut self, _: &Segment) -> Result<(), Infallible> {
        Ok(())
    }
    fn step(&mut self, _: &Step) -> Result<(), Infallible> {
        Ok(())
    }
    fn exit(&mut self, _: u64, _: ExitSpeeds) {}
    fn commit(&mut self, _: u64) {}
    fn solving(&mut self) {
        self.begun = cpu();
    }
    fn solved(&mut self, steps: u32) {
        self.plans.push((cpu() - self.begun, steps));
    }
}

/// Plans a program to its end. Returns the windows with their times and steps.
fn plan(program: &Path, setup: &Setup) -> Result<Vec<(f64, u32)>, String> {
    let name = program.display();
    let file = File::open(program).map_err(|error| format!("{name}: {error}"))?;
    let mut planner = Planner::new(setup.path_limits(), setup.path_rules(1.0), Meter::default());
    for (block, command) in Interpreter::new(BufReader::new(file), setup.interpreter_settings()).enumerate() {
        let command = command.map_err(|diagnostic| format!("{name}: {}", diagnostic.message))?;
        match &command.action {
            Action::Move(motion) => planner
                .push(motion, command.line, block as u32)
                .map_err(|error| format!("{name}: {error}"))?,
            Action::ProgramEnd => break,
            Action::Dwell { seconds } => {
                let Ok(()) = planner.rest(&Step::Dwell {
                    seconds: *seconds,
                    line: command.line,
                });
            }
            _ => {}
        }
    }
    let Ok(()) = planner.finish(0);
    Ok(std::mem::take(&mut planner.sink_mut().plans))
}

fn quantile(sorted: &[f64], fraction: f64) -> f64 {
    let last = sorted.len().saturating_sub(1);
    sorted
        .get((fraction * last as f64).round() as usize)
        .copied()
        .unwrap_or(0.0)
}

fn row(name: &str, plans: &[(f64, u32)]) {
    let mut ms: Vec<f64> = plans.iter().map(|plan| 1e3 * plan.0).collect();
    let mut steps: Vec<f64> = plans.iter().map(|plan| f64::from(plan.1)).collect();
    ms.sort_by(f64::total_cmp);
    steps.sort_by(f64::total_cmp);
    let per_step = 1e3 * ms.iter().sum::<f64>() / steps.iter().sum::<f64>().max(1.0);
    println!(
        "| {name} | {} | {:.2} | {:.2} | {:.2} | {:.0} | {:.0} | {:.0} | {per_step:.1} |",
        plans.len(),
        quantile(&ms, 0.5),
        quantile(&ms, 0.99),
        quantile(&ms, 1.0),
        quantile(&steps, 0.5),
        quantile(&steps, 0.99),
        quantile(&steps, 1.0),
    );
}

fn bench() -> Result<(), String> {
    let (mut files, mut runs) = (Vec::new(), 3);
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        match word.as_str() {
            "--bench" => {}
            "--runs" => {
                let value = words.next().and_then(|value| value.parse().ok());
                runs = value.ok_or("--runs needs a number")?;
            }
            path => {
                let path = PathBuf::from(path);
                if path.is_file() {
                    files.push(path);
                    continue;
                }
                let entries =
                    std::fs::read_dir(&path).map_err(|error| format!("{}: {error}", path.display()))?;
                files.extend(
                    (entries.filter_map(Result::ok).map(|entry| entry.path()))
                        .filter(|path| path.extension().is_some_and(|ending| ending == "ngc")),
                );
            }
        }
    }
    files.sort();
    let machine = root().join("config/machines/bench-3axis.toml");
    let setup = setup(&machine, None, Some(PlannerKind::Optimal))?;
    println!("| program | plans | p50 ms | p99 ms | worst ms | p50 steps | p99 | worst | us per step |");
    println!("|---|---|---|---|---|---|---|---|---|");
    let mut all = Vec::new();
    for file in &files {
        let mut plans = plan(file, &setup)?;
        for _ in 1..runs {
            for (best, again) in plans.iter_mut().zip(plan(file, &setup)?) {
                best.0 = best.0.min(again.0);
            }
        }
        row(&file.file_stem().unwrap_or_default().to_string_lossy(), &plans);
        all.extend(plans);
    }
    row("all", &all);
    Ok(())
}

fn main() -> ExitCode {
    match bench() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::from(2)
        }
    }
}
