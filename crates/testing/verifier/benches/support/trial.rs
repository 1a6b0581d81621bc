//! Runs one program through the code of `evolvent plan` and judges it.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use evolvent_machine::{ControlRate, Machine, PlannerKind};
use evolvent_runtime::{Controls, Job, Notice, RunObserver, Setup, Summary, run};
use evolvent_verifier::{Judge, Route, Verdict};
use rustix::time::{ClockId, Timespec, clock_gettime};

/// A planner by its name.
pub(crate) fn planner_of(name: &str) -> Result<PlannerKind, String> {
    match name {
        "optimal" => Ok(PlannerKind::Optimal),
        "classic" => Ok(PlannerKind::Classic),
        other => Err(format!("there is no planner {other:?}: name optimal or classic")),
    }
}

/// Result of a run.
pub(crate) struct Trial {
    pub(crate) verdict: Verdict,
    pub(crate) summary: Summary,
    /// Processor time of interpreting and planning.
    pub(crate) planning_s: f64,
    /// Processor time of interpreting alone (reading the route).
    pub(crate) reading_s: f64,
    pub(crate) error: Option<String>,
}

pub(crate) fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..")
}

/// A machine file at a rate, with a planner; both the file's own if none is named.
pub(crate) fn setup(
    machine: &Path,
    rate_hz: Option<f64>,
    planner: Option<PlannerKind>,
) -> Result<Setup, String> {
    let text = std::fs::read_to_string(machine).map_err(|error| format!("{}: {error}", machine.display()))?;
    let loaded = Machine::parse(&text, &machine.display().to_string()).map_err(|error| error.to_string())?;
    let rate = rate_hz.map(ControlRate::Hz);
    let mut setup = Setup::new(loaded, machine.to_owned(), text, rate).map_err(|error| error.to_string())?;
    if let Some(planner) = planner {
        setup.machine.path.planner = planner;
    }
    Ok(setup)
}

/// Ends a run that takes too long.
struct Patience {
    start: Instant,
    program: String,
}

#[expect(clippy::print_stderr, reason = "says why the process ends")]
impl RunObserver for Patience {
    fn progress(&mut self, controls: &Controls) {
        let waited = self.start.elapsed();
        if waited > PATIENCE {
            controls.stop();
        }
        if waited > 2 * PATIENCE {
            // A thread that does not come back cannot be ended otherwise.
            eprintln!(
                "{}: the planner has not come back for {:.0} s",
                self.program,
                waited.as_secs_f64()
            );
            std::process::exit(3);
        }
    }
    fn notice(&mut self, _: &Notice) {}
    fn note(&mut self, _: &str) {}
}

/// Time limit of one program; it is then stopped, and its outcome says so.
const PATIENCE: Duration = Duration::from_secs(60);

fn cpu(clock: ClockId) -> f64 {
    let Timespec { tv_sec, tv_nsec } = clock_gettime(clock);
    tv_sec as f64 + tv_nsec as f64 * 1e-9
}

/// Runs and judges a program.
pub(crate) fn trial(program: &Path, setup: &Setup) -> Result<Trial, String> {
    let name = program.display();
    let start = cpu(ClockId::ThreadCPUTime);
    let file = File::open(program).map_err(|error| format!("{name}: {error}"))?;
    let route = Route::read(BufReader::new(file), setup.interpreter_settings(), &setup.machine)
        .map_err(|error| format!("{name}: {error}"))?;
    let reading_s = cpu(ClockId::ThreadCPUTime) - start;

    let job = Job::new(program.to_owned(), setup.clone());
    let controls = Arc::new(Controls::new(1.0));
    let mut judge = Judge::new(&setup.machine, setup.period_ns, &route);
    // The cycle's thread also runs the judge; its total processor time is known at the last setpoint.
    let mut cycle_s = 0.0;
    let before = (cpu(ClockId::ProcessCPUTime), cpu(ClockId::ThreadCPUTime));
    let mut patience = Patience {
        start: Instant::now(),
        program: name.to_string(),
    };
    let outcome = run(&job, &controls, &mut patience, |setpoint| {
        judge.sample(&setpoint.position);
        cycle_s = cpu(ClockId::ThreadCPUTime);
    })
    .map_err(|error| format!("{name}: {error}"))?;
    let whole_s = cpu(ClockId::ProcessCPUTime) - before.0;
    let own_s = cpu(ClockId::ThreadCPUTime) - before.1;
    let error = match (&outcome.fault, &outcome.program) {
        (Some(fault), _) => Some(fault.clone()),
        (None, Err(error)) => Some(error.to_string()),
        _ => None,
    };
    Ok(Trial {
        verdict: judge.finish(),
        summary: outcome.summary,
        planning_s: (whole_s - own_s - cycle_s).max(0.0),
        reading_s,
        error,
    })
}
