//! How the cost of planning grows with blocks, axes and the density of the path:
//!
//!     cargo bench -p evolvent-verifier --bench scaling [-- --planner NAME] [--quick]
//!
//! Each line is one program through the code of `evolvent plan`; the time is processor time of interpreting
//! and planning, the minimum of three runs; `reading` is the interpreter's part of it, measured alone. The
//! exponent is that of the cost as a function of the number of blocks, between a line and the previous one: 1
//! is linear.

#![expect(clippy::print_stdout, clippy::print_stderr, reason = "a benchmark prints")]

#[path = "support/machines.rs"]
mod machines;
#[path = "support/trial.rs"]
mod trial;

use std::fmt::Write as _;
use std::path::Path;
use std::process::ExitCode;

use evolvent_machine::PlannerKind;
use evolvent_runtime::Setup;
use evolvent_verifier::{Allowances, butterfly_program};
use machines::equal_axes;
use trial::{planner_of, root, setup, trial};

/// A chain of chords about a sphere, all the axes of `letters` moving.
fn chain(letters: &str, chords: usize, chord_mm: f64) -> String {
    let mut text = "G17 G21 G90 G94 G64 P0.02 Q0\nF12000\n".to_owned();
    for i in 0..=chords {
        let s = i as f64 * chord_mm;
        text.push_str("G1");
        for (k, letter) in letters.chars().enumerate() {
            // Circles of 8 to 20 mm, each axis with a period of its own.
            let radius = 20.0 - 1.5 * k as f64;
            let value = radius * libm::sin(s / 25.0 * (1.0 + 0.11 * k as f64) + 1.3 * k as f64);
            // Writing to a string cannot fail.
            let _infallible = write!(text, " {letter}{value:.6}");
        }
        text.push('\n');
    }
    text.push_str("M2\n");
    text
}

struct Bench {
    folder: tempfile::TempDir,
    last_run: Option<(f64, f64)>,
    runs: usize,
}

impl Bench {
    fn line(&mut self, name: &str, text: &str, setup: &Setup) -> Result<(), String> {
        let path = self.folder.path().join("program.ngc");
        std::fs::write(&path, text).map_err(|error| error.to_string())?;
        let mut min_s = f64::INFINITY;
        let mut last = None;
        for _ in 0..self.runs {
            let trial = trial(&path, setup)?;
            min_s = min_s.min(trial.planning_s);
            last = Some(trial);
        }
        let Some(trial) = last else { return Ok(()) };
        let verdict = &trial.verdict;
        let blocks = verdict.blocks as f64;
        let growth = self
            .last_run
            .map(|(before, cost)| libm::log(min_s / cost) / libm::log(blocks / before));
        self.last_run = Some((blocks, min_s));
        println!(
            "| {name} | {} | {:.3} | {:.1} | {:.4} | {:.4} | {:.2} | {:.0} | {:.2} % | {} | {} |",
            verdict.blocks,
            verdict.duration_s,
            1e3 * blocks / verdict.path_mm.max(1e-9),
            trial.reading_s,
            min_s,
            1e6 * min_s / blocks,
            blocks / min_s,
            100.0 * min_s / verdict.duration_s,
            growth
                .filter(|growth| growth.is_finite())
                .map_or("-".to_owned(), |growth| format!("{growth:.2}")),
            trial.error.clone().unwrap_or_else(|| {
                let violations = verdict.violations(&Allowances::default());
                let whole = trial.summary.outcome.name() == "done";
                let first = violations.first().map(ToString::to_string);
                first.unwrap_or_else(|| if whole { "ok" } else { trial.summary.outcome.name() }.to_owned())
            })
        );
        Ok(())
    }

    fn head(&mut self, what: &str) {
        self.last_run = None;
        println!("\n{what}\n");
        println!(
            "| program | blocks | time s | blocks per m | reading s | planning s | us per block | blocks/s \
             | load | exponent | judged |"
        );
        println!("|---|---|---|---|---|---|---|---|---|---|---|");
    }
}

fn bench() -> Result<(), String> {
    let mut planner: Option<PlannerKind> = None;
    let mut quick = false;
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        match word.as_str() {
            "--bench" => {}
            "--quick" => quick = true,
            "--planner" => {
                let name = words.next().ok_or("--planner needs a name")?;
                planner = Some(planner_of(&name)?);
            }
            other => return Err(format!("there is no option {other}")),
        }
    }
    let folder = tempfile::tempdir().map_err(|error| error.to_string())?;
    let mut bench = Bench {
        folder,
        last_run: None,
        runs: if quick { 1 } else { 3 },
    };
    let machine: &Path = &root().join("config/machines/bench-3axis.toml");
    let three = setup(machine, None, planner)?;
    println!("planner {:?}", three.machine.path.planner);

    bench.head("Blocks of one length: chains of 0.1 mm chords, three axes.");
    let max_count = if quick { 10_000 } else { 100_000 };
    for blocks in [100, 1000, 10_000, 100_000]
        .into_iter()
        .filter(|blocks| *blocks <= max_count)
    {
        let text = chain("XYZ", blocks, 0.1);
        bench.line(&format!("{blocks} chords of 0.1 mm"), &text, &three)?;
    }

    bench.head("One path in ever shorter blocks: the butterfly.");
    for chords in [200, 2000, 20_000, 100_000]
        .into_iter()
        .filter(|chords| *chords <= max_count)
    {
        bench.line(
            &format!("butterfly in {chords}"),
            &butterfly_program(chords).text,
            &three,
        )?;
    }

    bench.head("Axes: 5000 chords of 0.1 mm on machines of equal axes.");
    for letters in ["X", "XY", "XYZ", "XYZAB", "XYZABC", "XYZABCUVW"] {
        let setup = equal_axes(letters, 1000.0, planner)?;
        bench.line(letters, &chain(letters, 5000, 0.1), &setup)?;
        bench.last_run = None;
    }

    bench.head("Length of the chords: 200 mm in three axes.");
    for chord_mm in [2.0, 0.5, 0.1, 0.02, 0.005] {
        let blocks = (200.0 / chord_mm) as usize;
        if blocks > max_count {
            continue;
        }
        bench.line(&format!("{chord_mm} mm"), &chain("XYZ", blocks, chord_mm), &three)?;
    }
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
