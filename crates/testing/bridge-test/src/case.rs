//! Definition and execution of a case.

use evolvent_random::Random;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use evolvent_bus::remove_private_domain;
use thiserror::Error;

use crate::bridge::BridgeUnderTest;
use crate::test_core::{DISTURBED, TestCore};
use crate::{begin_cases, cases, probe_case, setpoint_cases, signal_cases, spindle_cases};

/// Why a bridge failed a case, or why the case could not be run.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{what}")]
pub struct CaseError {
    what: String,
    kind: ErrorKind,
}

/// Cause of a failed case.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ErrorKind {
    /// The bridge is wrong.
    Wrong,
    /// A pause of the host explains it.
    Unmeasured,
    /// The situation of the case did not occur.
    LeftOut,
}

impl CaseError {
    pub(crate) fn new(what: impl Into<String>) -> Self {
        Self {
            what: what.into(),
            kind: ErrorKind::Wrong,
        }
    }

    /// An error that the host may have caused by keeping the bridge from running for as long.
    pub(crate) fn unmeasured(what: impl Into<String>) -> Self {
        Self {
            what: what.into(),
            kind: ErrorKind::Unmeasured,
        }
    }

    /// This bridge does not get into the situation of the case.
    pub(crate) fn left_out(what: impl Into<String>) -> Self {
        Self {
            what: what.into(),
            kind: ErrorKind::LeftOut,
        }
    }

    /// Whether the host explains it.
    pub(crate) fn is_unmeasured(&self) -> bool {
        self.kind == ErrorKind::Unmeasured
    }
}

/// Result of a case in which the bridge did nothing wrong.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// The bridge meets the demand.
    Passed,
    /// The case cannot be run with this bridge or this suite, for this reason.
    LeftOut(String),
    /// The host kept the bridge from running at each attempt, for long enough to explain the failure.
    NotMeasured(String),
    /// [`Stage::stop`] was set before the end of the case.
    Stopped,
}

/// Environment of a case: one bridge, one bus.
pub struct Stage<'a> {
    /// The bridge under test.
    pub bridge: &'a mut dyn BridgeUnderTest,
    /// The machine's name.
    pub machine_name: String,
    /// iceoryx2's prefix.
    pub prefix: String,
    /// The `evolvent` program, which runs the core that is killed; without it such cases are left out.
    pub core_program: Option<PathBuf>,
    /// Seed of the random moments.
    pub seed: u64,
    /// Number of random moments for each case that has some.
    pub moments: u32,
    /// Parts that the bridge has besides axes.
    pub parts: &'a [Part],
    /// Ends the running case and its bridge.
    pub stop: Arc<AtomicBool>,
}

impl Stage<'_> {
    pub(crate) fn start_bridge(&mut self) -> Result<(), CaseError> {
        let (name, prefix) = (self.machine_name.clone(), self.prefix.clone());
        self.bridge
            .start(&name, &prefix)
            .map_err(|error| CaseError::new(error.to_string()))
    }

    pub(crate) fn open_core(&self) -> Result<TestCore, CaseError> {
        TestCore::open(&self.machine_name, &self.prefix)
            .map(|core| core.with_stop(&self.stop))
            .map_err(|error| CaseError::new(error.to_string()))
    }

    /// A random number from `low` to `high`.
    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        let mut random = Random::from_state(self.seed);
        let number = random.between(low, high);
        self.seed = random.state();
        number
    }
}

/// Part of a bridge that a case tests. Every bridge has axes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// Drives that follow setpoints.
    Axes,
    /// The bridge reads inputs and sets outputs, and its digital output 0 is wired to its digital input 0.
    Signals,
    /// The bridge turns spindle 0 and sends its angle, and the spindle may turn at 300 rpm in either
    /// direction.
    Spindle,
    /// The bridge reports a touch probe, and the first axis may drive it against something 1 to 4 mm away in
    /// its positive direction.
    Probe,
}

/// One demand on a bridge.
#[derive(Clone, Copy)]
pub struct Case {
    /// Name of the case.
    pub name: &'static str,
    /// What a bridge must do.
    pub demand: &'static str,
    /// Whether the case kills the bridge.
    pub kills_bridge: bool,
    /// Whether the case kills a core process.
    pub kills_core: bool,
    /// Part that the case tests: a bridge without it is not judged.
    pub part: Part,
    pub(crate) play: fn(&mut Stage<'_>) -> Result<(), CaseError>,
}

macro_rules! case {
    (@ $module:ident::$name:ident, $demand:literal, $part:ident, $kills_bridge:literal, $kills_core:literal) => {
        Case {
            name: stringify!($name),
            demand: $demand,
            kills_bridge: $kills_bridge,
            kills_core: $kills_core,
            part: Part::$part,
            play: $module::$name,
        }
    };
    ($name:ident, $demand:literal, signals) => {
        case!(@ signal_cases::$name, $demand, Signals, false, false)
    };
    ($name:ident, $demand:literal, spindle) => {
        case!(@ spindle_cases::$name, $demand, Spindle, false, false)
    };
    ($name:ident, $demand:literal, setpoints) => {
        case!(@ setpoint_cases::$name, $demand, Axes, false, false)
    };
    ($name:ident, $demand:literal, begin) => {
        case!(@ begin_cases::$name, $demand, Axes, false, false)
    };
    ($name:ident, $demand:literal, probe) => {
        case!(@ probe_case::$name, $demand, Probe, false, false)
    };
    ($name:ident, $demand:literal, $kills_bridge:literal, $kills_core:literal) => {
        case!(@ cases::$name, $demand, Axes, $kills_bridge, $kills_core)
    };
}

/// Every case.
pub const CASES: [Case; 29] = [
    case!(
        bridge_first,
        "waits for a core that starts later, then follows",
        false,
        false
    ),
    case!(core_first, "follows a core that started earlier", false, false),
    case!(
        feedback,
        "replies to every setpoint, in order, with current and finite values of every axis",
        false,
        false
    ),
    case!(
        due,
        "moves when setpoints are due, not when they arrive and not later, and replies to none before",
        false,
        false
    ),
    case!(
        begin,
        "begins to follow only at rest and within 1 mm of the positions that it reports",
        begin
    ),
    case!(
        begin_beside,
        "begins at an offset from the axes without a step of the axes or of their targets",
        begin
    ),
    case!(
        quick_stop,
        "executes a quick stop at once, before it is due",
        false,
        false
    ),
    case!(
        fault_reset,
        "reports in fault_reset_done the last reset that it has executed",
        false,
        false
    ),
    case!(
        new_core_reset,
        "does not reset the fault of a drive by the counter of a core that has just started",
        false,
        false
    ),
    case!(
        silent_start,
        "does not power drives that are not in operation after the core has fallen silent",
        false,
        false
    ),
    case!(
        power,
        "switches on without motion, stops quickly, switches off, and on again",
        false,
        false
    ),
    case!(
        gaps,
        "bridges single missing setpoints and counts them",
        setpoints
    ),
    case!(
        silence,
        "brakes and holds when setpoints stop in motion, and stays when they continue elsewhere",
        setpoints
    ),
    case!(
        late,
        "does not follow setpoints that arrive too late, and continues after them",
        setpoints
    ),
    case!(
        due_times,
        "rejects due times that are long past, far ahead or go backwards, and follows those after them",
        setpoints
    ),
    case!(
        jump,
        "rejects a setpoint that no axis can reach, and those that continue it",
        setpoints
    ),
    case!(not_finite, "rejects numbers that are not finite", setpoints),
    case!(
        version,
        "does not follow a core with another interface version",
        false,
        false
    ),
    case!(
        datum,
        "reports positions in a changed datum without motion",
        false,
        false
    ),
    case!(
        core_restart,
        "finds a core that was restarted at any moment",
        false,
        false
    ),
    case!(
        bridge_restart,
        "restarts at any moment, as another instance, and resumes operation",
        false,
        false
    ),
    case!(
        core_kill,
        "stops when its core is killed at any moment, and finds the next one",
        false,
        true
    ),
    case!(
        bridge_kill,
        "leaves nothing that prevents the next one from starting when it is killed at any moment",
        true,
        false
    ),
    case!(
        inputs,
        "sends its inputs in order, with current times and finite values, at least ten times a second",
        signals
    ),
    case!(
        output_due,
        "sets outputs when they are due, not when they arrive, and reports which it has set last",
        signals
    ),
    case!(
        output_safe,
        "sets the safe values within 200 ms after its core falls silent, and follows the next core",
        signals
    ),
    case!(
        spindle_angle,
        "sends the angle of its spindle with the time, with the sign of the speed, and reports at speed \
         only when it is",
        spindle
    ),
    case!(
        spindle_safe,
        "stops its spindle when the core falls silent, and turns it for the next core",
        spindle
    ),
    case!(
        probe,
        "reports when its probe has tripped, how often, the positions that the drives have latched, and \
         when it opens",
        probe
    ),
];

/// Maximum number of runs of a case that fails while the host kept the suite's core or the bridge from
/// running: such a failure proves nothing.
const ATTEMPTS: usize = 3;

/// Runs one case on its bus, and removes the bus afterwards.
///
/// # Errors
/// What the bridge did wrong.
pub fn run_case(case: &Case, stage: &mut Stage<'_>) -> Result<Outcome, CaseError> {
    if let Some(why) = why_left_out(case, stage) {
        return Ok(Outcome::LeftOut(why.to_owned()));
    }
    let mut result = Ok(());
    for _ in 0..ATTEMPTS {
        let before = DISTURBED.load(Ordering::Relaxed);
        result = (case.play)(stage);
        stage.bridge.end();
        let is_explained = result.as_ref().is_err_and(CaseError::is_unmeasured)
            || DISTURBED.load(Ordering::Relaxed) != before;
        if result.is_ok() || !is_explained || stage.stop.load(Ordering::Relaxed) {
            break;
        }
    }
    let outcome = match result {
        _ if stage.stop.load(Ordering::Relaxed) => Ok(Outcome::Stopped),
        Ok(()) => Ok(Outcome::Passed),
        Err(error) => match error.kind {
            ErrorKind::Wrong => Err(error),
            ErrorKind::Unmeasured => Ok(Outcome::NotMeasured(error.what)),
            ErrorKind::LeftOut => Ok(Outcome::LeftOut(error.what)),
        },
    };
    let cleared = remove_private_domain(&stage.prefix).map_err(|error| CaseError::new(error.to_string()));
    let outcome = outcome?;
    cleared?;
    match remains(&stage.prefix) {
        left if left.is_empty() => Ok(outcome),
        left => Err(CaseError::new(format!(
            "left in shared memory: {}",
            left.join(", ")
        ))),
    }
}

/// Returns why a case cannot be run on this stage, if it cannot.
fn why_left_out(case: &Case, stage: &Stage<'_>) -> Option<&'static str> {
    if case.kills_bridge && !stage.bridge.can_be_killed() {
        return Some("the bridge is not a separate process, so it cannot be killed");
    }
    if case.kills_core && stage.core_program.is_none() {
        return Some("no program is given whose core could be killed");
    }
    let option = match case.part {
        part if stage.parts.contains(&part) => return None,
        Part::Axes => return None,
        Part::Signals => "needs --signals, and output 0 wired to input 0",
        Part::Spindle => "needs --spindle, and a spindle 0 that may turn",
        Part::Probe => "needs --probe, and a touch probe that the first axis may move into a surface",
    };
    Some(option)
}

/// Files of a prefix that were not removed.
fn remains(prefix: &str) -> Vec<String> {
    let mut found = Vec::new();
    let mut folders = vec![PathBuf::from("/dev/shm")];
    for (folder, _) in evolvent_bus::bus_folders(Some(prefix)).unwrap_or_default() {
        // A file may be in shared memory itself.
        if !folder.starts_with(&folders[0]) {
            folders.push(folder);
        }
    }
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
            if entry.file_name().to_string_lossy().starts_with(prefix) {
                found.push(entry.path().display().to_string());
            } else if entry.path().is_dir() {
                folders.push(entry.path());
            }
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::AtomicUsize;

    use crate::bridge::ThreadBridge;

    static PLAYED: AtomicUsize = AtomicUsize::new(0);

    fn outcome(play: fn(&mut Stage<'_>) -> Result<(), CaseError>) -> (Result<Outcome, CaseError>, usize) {
        PLAYED.store(0, Ordering::Relaxed);
        let mut bridge = ThreadBridge::new(|_, _, _| {});
        let mut stage = Stage {
            bridge: &mut bridge,
            machine_name: "outcome".to_owned(),
            prefix: format!("evo{}-", std::process::id()),
            core_program: None,
            seed: 1,
            moments: 1,
            parts: &[],
            stop: Arc::default(),
        };
        let case = Case { play, ..CASES[0] };
        let outcome = run_case(&case, &mut stage);
        (outcome, PLAYED.load(Ordering::Relaxed))
    }

    #[test]
    fn host_disturbance_is_retried_twice_then_unmeasured() {
        let paused = |_: &mut Stage<'_>| {
            PLAYED.fetch_add(1, Ordering::Relaxed);
            Err(CaseError::unmeasured("late"))
        };
        assert_eq!(outcome(paused), (Ok(Outcome::NotMeasured("late".to_owned())), 3));
        let wrong = |_: &mut Stage<'_>| {
            PLAYED.fetch_add(1, Ordering::Relaxed);
            Err(CaseError::new("late"))
        };
        assert_eq!(outcome(wrong), (Err(CaseError::new("late")), 1));
        let absent = |_: &mut Stage<'_>| {
            PLAYED.fetch_add(1, Ordering::Relaxed);
            Err(CaseError::left_out("no fault"))
        };
        assert_eq!(outcome(absent), (Ok(Outcome::LeftOut("no fault".to_owned())), 1));
        let stopped = |stage: &mut Stage<'_>| {
            PLAYED.fetch_add(1, Ordering::Relaxed);
            stage.stop.store(true, Ordering::Relaxed);
            Err(CaseError::unmeasured("late"))
        };
        assert_eq!(outcome(stopped), (Ok(Outcome::Stopped), 1));
    }
}
