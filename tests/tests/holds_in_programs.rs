//! Holds at random moments of whole programs: their stops, and the setpoints published meanwhile.
//!
//! `EVOLVENT_PROGRAMS=FOLDER` takes the programs of another folder, `EVOLVENT_CASES` sets the number of holds
//! in each at each rate.

#![expect(clippy::unwrap_used, reason = "a test may fail")]

use std::path::{Path, PathBuf};
use std::sync::Arc;

use evolvent_machine::{ControlRate, Machine};
use evolvent_motion::{MotionState, Setpoint};
use evolvent_runtime::{Controls, Job, Notice, RunObserver, RunOutcome, Setup, run};
use evolvent_tests::{Random, Workshop, repository};

struct Silent;

impl RunObserver for Silent {
    fn progress(&mut self, _: &Controls) {}
    fn notice(&mut self, _: &Notice) {}
    fn note(&mut self, _: &str) {}
}

fn job(workshop: &Workshop, program: &Path, machine: &str, rate_hz: f64) -> Job {
    let file = repository().join("config/machines").join(machine);
    let loaded = Machine::load(&file).unwrap();
    let mut setup = Setup::new(loaded, file, String::new(), Some(ControlRate::Hz(rate_hz))).unwrap();
    let tools = workshop.path("tools.tbl");
    let table: String = (1..100).map(|tool| format!("T{tool} P{tool} D3 Z0\n")).collect();
    std::fs::write(&tools, table).unwrap();
    setup.memory.load_tools(tools).unwrap();
    Job::new(program.to_owned(), setup)
}

fn drive(job: &Job, controls: &Arc<Controls>, observe: impl FnMut(&Setpoint) + Send) -> RunOutcome {
    run(job, controls, &mut Silent, observe).unwrap()
}

/// The result of one hold.
struct Hold {
    line: u32,
    /// Path speed at the hold, mm/s, and the time to rest, s.
    feed_mm_s: f64,
    seconds: f64,
    /// Lower bound of the time to rest of any axis, s.
    min_s: f64,
}

/// The minimum time in which an axis stops from velocity `v` and acceleration `a`, at any position.
fn axis_to_rest(v: f64, a: f64, max_a: f64, jerk: f64) -> f64 {
    let falls = v + a * a.abs() / (2.0 * jerk) >= 0.0;
    let (v, a) = if falls { (v, a) } else { (-v, -a) };
    let peak = (jerk * v + 0.5 * a * a).max(0.0).sqrt();
    if peak <= max_a {
        (a + 2.0 * peak) / jerk
    } else {
        (a + 2.0 * max_a) / jerk + (v + 0.5 * a * a / jerk - max_a * max_a / jerk) / max_a
    }
}

/// Drives the program with `count` holds, each at a random moment after the previous one.
fn holds(job: &Job, count: usize, random: &mut Random) -> (Vec<Hold>, RunOutcome) {
    let setpoints = drive(job, &Arc::new(Controls::new(1.0)), |_| {}).summary.cycles as usize;
    let period = job.setup.period_ns as f64 * 1e-9;
    // Enough time to reach full speed again.
    let apart = (2 * setpoints / count).max((0.2 / period) as usize);
    let limits = job.setup.machine.limits();
    let controls = Arc::new(Controls::new(1.0));
    let orders = Arc::clone(&controls);
    let mut found: Vec<Hold> = Vec::new();
    let mut next = 1 + random.below(apart);
    let mut held: Option<(usize, Setpoint)> = None;
    let outcome = drive(job, &controls, |setpoint| match &mut held {
        None if next > 0 => next -= 1,
        None => {
            if setpoint.state == MotionState::Running && setpoint.feed_mm_s > 0.0 {
                orders.set_hold(true);
                held = Some((0, *setpoint));
            }
        }
        Some((cycles, from)) => {
            *cycles += 1;
            assert!(*cycles < 100_000, "a hold at line {} does not end", from.line);
            let rests = !matches!(setpoint.state, MotionState::Running | MotionState::Holding);
            if rests {
                found.push(Hold {
                    line: from.line,
                    feed_mm_s: from.feed_mm_s,
                    seconds: *cycles as f64 * period,
                    min_s: (0..9)
                        .filter(|&i| limits.present[i])
                        .map(|i| {
                            let (v, a) = (from.velocity[i], from.acceleration[i]);
                            axis_to_rest(v, a, limits.acceleration[i], limits.jerk[i])
                        })
                        .fold(0.0, f64::max),
                });
                orders.set_hold(false);
                held = None;
                next = random.below(apart);
            }
        }
    });
    (found, outcome)
}

#[test]
fn holds_in_whole_programs_stop_soon_within_limits() {
    let folder = std::env::var_os("EVOLVENT_PROGRAMS").map(PathBuf::from);
    let count = std::env::var("EVOLVENT_CASES")
        .ok()
        .and_then(|n| n.parse().ok())
        .unwrap_or(25);
    let mut programs: Vec<PathBuf> = match &folder {
        Some(folder) => std::fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .filter(|path| path.extension().is_some_and(|end| end == "ngc"))
            .collect(),
        None => ["letters", "relief"]
            .iter()
            .map(|name| repository().join(format!("tests/programs/{name}.ngc")))
            .collect(),
    };
    programs.sort();
    let (mut random, workshop) = (Random::seeded(0x1401), Workshop::new());
    for program in &programs {
        for rate_hz in [1000.0, 4000.0] {
            let name = program.file_stem().unwrap().to_string_lossy().into_owned();
            let job = job(&workshop, program, "bench-3axis.toml", rate_hz);
            let (mut found, mut outcome) = holds(&job, count, &mut random);
            while found.len() < count {
                let before = found.len();
                let (more, next) = holds(&job, count, &mut random);
                found.extend(more);
                outcome = next;
                assert!(found.len() > before, "{name}: nothing moves");
            }
            let what = format!("{name} at {rate_hz} Hz");
            assert!(outcome.fault.is_none(), "{what}: {:?}", outcome.fault);
            assert!(outcome.program.is_ok(), "{what}: {:?}", outcome.program.err());
            let summary = &outcome.summary;
            for (ratios, max) in [
                (&summary.velocity_ratio, 1.001),
                (&summary.acceleration_ratio, 1.001),
                (&summary.jerk_ratio, 1.02),
            ] {
                assert!(ratios.iter().all(|ratio| *ratio <= max), "{what}: {ratios:?}");
            }
            let mut over: Vec<f64> = found
                .iter()
                .map(|hold| (hold.seconds - 0.015) / hold.min_s)
                .collect();
            over.sort_by(f64::total_cmp);
            let worst = found
                .iter()
                .max_by(|a, b| a.seconds.total_cmp(&b.seconds))
                .unwrap();
            // From the highest speed on a straight line 140 ms; 40 ms more if the axis still accelerates, and
            // again if an axis that the curve turns uses its whole jerk and delays braking.
            assert!(
                worst.seconds <= 0.25,
                "{what}: line {} takes {} s",
                worst.line,
                worst.seconds
            );
            println!(
                "{what}: {} holds, longest {:.0} ms from {:.1} mm/s (line {}); but for 15 ms {:.2} \
                 (median), {:.2} (99 %), {:.2} (most) times the least of any path",
                found.len(),
                1e3 * worst.seconds,
                worst.feed_mm_s,
                worst.line,
                over[over.len() / 2],
                over[over.len() * 99 / 100],
                over[over.len() - 1],
            );
        }
    }
}
