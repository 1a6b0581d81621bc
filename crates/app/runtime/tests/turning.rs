//! Load-adaptive turning cycles of a program: with the virtual clock, on a simulated stock.
#![expect(clippy::unwrap_used, reason = "a test may fail")]

use std::path::Path;
use std::sync::{Arc, Mutex};

use evolvent_machine::{Machine, PlannerKind};
use evolvent_motion::MotionState;
use evolvent_runtime::{
    CheckBounds, Controls, Job, Notice, ObservedCycle, ProgramError, RunObserver, RunOutcome, Setup, check,
    run_observed,
};
use evolvent_turning::{SimulatedProcess, TurningJob, TurningState};

/// Turns 40 mm to a radius of 30 mm, then continues with an ordinary move.
const PROGRAM: &str =
    "G21 G18 G90 G94 G8\nS500 M3\nG0 Z308\nG0 X35\nG0 Z300\nF200\nG82 X60 Z260 H0.3 Q1\nG0 X60\nM2\n";
const FINAL_X: f64 = 30.0;

struct Silent;

impl RunObserver for Silent {
    fn progress(&mut self, _: &Controls) {}
    fn notice(&mut self, _: &Notice) {}
    fn note(&mut self, _: &str) {}
}

fn process_text() -> String {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/processes/turn-shaft.toml");
    std::fs::read_to_string(file).unwrap()
}

fn process() -> TurningJob {
    let shorter = process_text()
        .replace("length_mm = 200.0", "length_mm = 40.0")
        .replace("[[0.0, 10.0], [200.0, 5.0]]", "[[0.0, 4.8], [40.0, 3.0]]");
    TurningJob::parse(&shorter, "process").unwrap()
}

fn setup(process: Option<TurningJob>) -> Setup {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/machines/lathe-2axis.toml");
    let machine = Machine::load(&file).unwrap();
    let mut setup = Setup::new(machine, file, String::new(), None).unwrap();
    setup.process = process.map(Arc::new);
    setup
}

/// The observed values of each cycle.
struct Sample {
    position: [f64; 2],
    state: MotionState,
    turning: Option<TurningState>,
    line: u32,
}

fn drive(
    program: &str,
    setup: Setup,
    act: impl Fn(u64, &ObservedCycle<'_>, &Controls) + Sync,
) -> (Vec<Sample>, RunOutcome) {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("turn.ngc");
    std::fs::write(&file, program).unwrap();
    let job = Job::new(file, setup);
    let controls = Arc::new(Controls::new(1.0));
    let samples = Mutex::new(Vec::new());
    let outcome = run_observed(&job, &controls, &mut Silent, |cycle| {
        let setpoint = cycle.setpoint;
        act(setpoint.sequence, cycle, &controls);
        samples.lock().unwrap().push(Sample {
            position: [setpoint.position[0], setpoint.position[2]],
            state: setpoint.state,
            turning: cycle.turning.map(|output| output.state),
            line: setpoint.line,
        });
    })
    .unwrap();
    (samples.into_inner().unwrap(), outcome)
}

/// Checks differences of positions against the machine's limits, without the guard.
fn keeps_limits(samples: &[Sample], setup: &Setup) {
    let (limits, rate) = (setup.machine.limits(), setup.rate_hz());
    for (k, axis) in [(0, 0), (1, 2)] {
        for four in samples.windows(4) {
            let p: Vec<f64> = four.iter().map(|sample| sample.position[k]).collect();
            let first = (p[3] - p[2]) * rate;
            let second = (p[3] - 2.0 * p[2] + p[1]) * rate * rate;
            let third = (p[3] - 3.0 * p[2] + 3.0 * p[1] - p[0]) * rate.powi(3);
            assert!(first.abs() <= 1.001 * limits.velocity[axis], "{first}");
            assert!(
                second.abs() <= 1.001 * limits.acceleration[axis] + 1.0,
                "{second}"
            );
            assert!(third.abs() <= 1.02 * limits.jerk[axis] + 20.0, "{third}");
        }
    }
}

/// The largest true load of a whole program, and the height of the stock left above the final size 10 mm
/// from the face. The setpoints' positions cut the stock.
fn largest_load(program: &str, process: &TurningJob) -> (f64, f64) {
    let here = setup(Some(process.clone()));
    let mut stock = SimulatedProcess::new(process, 1.0 / here.rate_hz()).unwrap();
    let (samples, outcome) = drive(program, here.clone(), |_, _, _| {});
    assert!(outcome.program.is_ok(), "{program}: {:?}", outcome.program);
    assert_eq!(
        (outcome.summary.outcome.name(), outcome.fault),
        ("done", None),
        "{program}"
    );
    keeps_limits(&samples, &here);
    let max = samples.iter().fold(0.0_f64, |max, sample| {
        max.max(stock.step(sample.position[0], sample.position[1]).0.load)
    });
    (max, stock.workpiece().height_mm(10.0))
}

#[test]
fn a_shoulder_within_the_stock_overloads_no_pass() {
    for (words, heights) in [
        ("X60 Z280", [3.0, 5.0, 7.0, 9.0]),
        ("X60 Z280 H0.3", [3.0, 5.0, 7.0, 9.0]),
        ("X60 Z280 H0.8", [3.0, 5.0, 7.0, 9.0]),
        ("X60 Z280 R64 L275 H0.3", [4.0, 6.0, 8.0, 9.0]),
    ] {
        for height in heights {
            let file = process_text().replace(
                "[[0.0, 10.0], [200.0, 5.0]]",
                &format!("[[0.0, {height}], [200.0, {height}]]"),
            );
            let process = TurningJob::parse(&file, "process").unwrap();
            let corner = 30.0 + height + 0.2;
            let program = format!(
                "G21 G18 G90 G94 G8\nS500 M3\nG0 Z308\nG0 X{corner}\nG0 Z300\nF200\nG82 {words} Q1\nM2\n"
            );
            let (max, left) = largest_load(&program, &process);
            let set = process.settings.regime.set_load;
            println!("{words}, {height} mm: {:.2} of the set load", max / set);
            assert!(max < 1.3 * set, "{words}, {height} mm: {}", max / set);
            assert!(left.abs() < 0.02, "{words}, {height} mm: {left} mm left");
        }
    }
}

#[test]
fn facing_to_a_shoulder_or_the_axis_never_overloads() {
    // End diameters. At 0 there is nothing beyond the end; at 4 the axis comes before the end of the wall.
    for (end, allowance) in [
        (20.0, 0.0),
        (20.0, 0.3),
        (4.0, 0.1),
        (4.0, 0.7),
        (0.0, 0.0),
        (0.0, 0.1),
        (0.0, 0.3),
        (0.0, 0.7),
    ] {
        for height in [3.0, 7.0] {
            let file = process_text()
                .replace("kind = \"longitudinal\"", "kind = \"facing\"")
                .replace("z_mm = 300.0", "z_mm = 296.0")
                .replace("length_mm = 200.0", "length_mm = 30.0")
                .replace(
                    "[[0.0, 10.0], [200.0, 5.0]]",
                    &format!("[[0.0, {height}], [30.0, {height}]]"),
                );
            let process = TurningJob::parse(&file, "process").unwrap();
            let corner = 296.0 + height + 0.2;
            let words = format!("X{end} Z296 H{allowance}");
            let program = format!(
                "G21 G18 G90 G94 G8\nS500 M3\nG0 X38\nG0 Z{corner}\nG0 X30\nF200\nG75 {words} Q1\nM2\n"
            );
            let (max, left) = largest_load(&program, &process);
            let set = process.settings.regime.set_load;
            println!("{words}, {height} mm: {:.2} of the set load", max / set);
            assert!(max < 1.3 * set, "{words}, {height} mm: {}", max / set);
            assert!(left.abs() < 0.02, "{words}, {height} mm: {left} mm left");
        }
    }
}

#[test]
fn a_program_continues_after_a_cycle_reproducibly() {
    for planner in [PlannerKind::Optimal, PlannerKind::Classic] {
        let mut here = setup(Some(process()));
        here.machine.path.planner = planner;
        let (samples, outcome) = drive(PROGRAM, here.clone(), |_, _, _| {});
        assert!(outcome.program.is_ok(), "{:?}", outcome.program);
        assert_eq!((outcome.summary.outcome.name(), outcome.fault), ("done", None));
        keeps_limits(&samples, &here);
        // The cycle leaves the allowance, and the pass after it removes it.
        let lowest = |of: &dyn Fn(&&Sample) -> bool| {
            samples
                .iter()
                .filter(of)
                .map(|sample| sample.position[0])
                .fold(f64::INFINITY, f64::min)
        };
        assert!((lowest(&|sample| sample.turning.is_some()) - (FINAL_X + 0.3)).abs() < 1e-9);
        assert!((lowest(&|sample| sample.turning.is_none()) - FINAL_X).abs() < 1e-9);
        let cut = outcome.process.unwrap();
        assert!(
            cut.workpiece().height_mm(20.0).abs() < 0.02,
            "{}",
            cut.workpiece().height_mm(20.0)
        );
        // It begins and ends at the position of its line, exact to the last bit.
        let first = samples
            .iter()
            .position(|sample| sample.turning.is_some())
            .unwrap();
        let last = samples
            .iter()
            .rposition(|sample| sample.turning.is_some())
            .unwrap();
        assert_eq!(samples[first - 1].position, [35.0, 300.0]);
        assert_eq!(samples[last].position, [35.0, 300.0]);
        assert_eq!(samples[last].turning, Some(TurningState::Done));
        assert!(samples[first..=last].iter().all(|sample| sample.line == 7));
        let again = drive(PROGRAM, here, |_, _, _| {}).0;
        assert_eq!(samples.len(), again.len());
        let same = |(a, b): (&Sample, &Sample)| a.position.map(f64::to_bits) == b.position.map(f64::to_bits);
        assert!(samples.iter().zip(&again).all(same));
    }
}

#[test]
fn a_cone_after_the_cylinder_is_finished_to_size() {
    // 30 degrees from a radius of 30 mm at Z268 outwards, to beyond the stock.
    let (end_z, end_x) = (250.0, 30.0 + 18.0 * 30.0_f64.to_radians().tan());
    let program = PROGRAM.replace("Z260 H0.3", &format!("Z268 R{:.6} L{end_z} H0.3", 2.0 * end_x));
    for planner in [PlannerKind::Optimal, PlannerKind::Classic] {
        let mut here = setup(Some(process()));
        here.machine.path.planner = planner;
        let (samples, outcome) = drive(&program, here.clone(), |_, _, _| {});
        assert!(outcome.program.is_ok(), "{:?}", outcome.program);
        assert_eq!(outcome.summary.outcome.name(), "done");
        keeps_limits(&samples, &here);
        // The tip relative to the contour; the cycle leaves 0.3 mm along X and Z.
        let above = |sample: &Sample, left: f64| {
            let [x, z] = sample.position;
            let contour = 30.0 + (268.0 + left - z).max(0.0) * 30.0_f64.to_radians().tan();
            x - (contour + left)
        };
        let min_above = |turns: bool, left: f64| {
            samples
                .iter()
                .filter(|sample| sample.turning.is_some() == turns)
                .map(|sample| above(sample, left))
                .fold(f64::INFINITY, f64::min)
        };
        assert!(min_above(true, 0.3).abs() < 1e-6, "{}", min_above(true, 0.3));
        assert!(min_above(false, 0.0).abs() < 1e-3, "{}", min_above(false, 0.0));
        assert!(
            samples
                .iter()
                .any(|sample| sample.turning == Some(TurningState::Climb))
        );
        // The remaining stock, as heights above the final cylinder along the cut from Z300.
        let cut = outcome.process.unwrap();
        for along in [5.0, 20.0, 30.0, 33.0, 35.0, 37.0] {
            let contour = (along - 32.0_f64).max(0.0) * 30.0_f64.to_radians().tan();
            let left = cut.workpiece().height_mm(along) - contour;
            assert!(left.abs() < 0.05, "{left} at {along}");
        }
    }
}

#[test]
fn hold_override_and_stop_reach_the_turning_cycle() {
    let (whole, _) = drive(PROGRAM, setup(Some(process())), |_, _, _| {});
    let first = whole.iter().position(|sample| sample.turning.is_some()).unwrap() as u64;
    let last = whole.iter().rposition(|sample| sample.turning.is_some()).unwrap() as u64;
    for fraction in [0.02, 0.31, 0.77, 0.98] {
        let at = first + (fraction * (last - first) as f64) as u64;
        let here = setup(Some(process()));
        let (samples, outcome) = drive(PROGRAM, here.clone(), |k, _, controls| {
            if k == at {
                controls.set_hold(true);
            } else if k == at + 2000 {
                controls.set_hold(false);
                controls.set_override(0.5);
            }
        });
        assert_eq!(outcome.summary.outcome.name(), "done", "held at {at}");
        assert!(
            samples
                .iter()
                .any(|sample| sample.state == MotionState::Held && sample.turning == Some(TurningState::Held))
        );
        assert!(samples.len() > whole.len() + 2000);
        assert!(outcome.process.unwrap().workpiece().height_mm(20.0).abs() < 0.02);
        keeps_limits(&samples, &here);
        let (samples, outcome) = drive(PROGRAM, here.clone(), |k, _, controls| {
            if k == at {
                controls.stop();
            }
        });
        assert_eq!(outcome.summary.outcome.name(), "stopped", "stopped at {at}");
        assert!((samples.len() as u64) < at + 2000);
        assert_eq!(
            samples.last().map(|sample| sample.state),
            Some(MotionState::Stopped)
        );
        keeps_limits(&samples, &here);
    }
}

#[test]
fn bad_cycles_are_refused_at_their_line_before_motion() {
    let refused = |program: &str, process: Option<TurningJob>| {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("turn.ngc");
        std::fs::write(&file, program).unwrap();
        let setup = setup(process);
        let found = check(&file, &setup, CheckBounds::whole(5)).unwrap().errors;
        let (samples, outcome) = drive(program, setup, |_, _, _| {});
        assert!(samples.iter().all(|sample| sample.turning.is_none()));
        let Err(ProgramError::Text { diagnostic, .. }) = outcome.program else {
            panic!("it was run");
        };
        assert_eq!(found.first(), Some(&*diagnostic));
        (diagnostic.line, diagnostic.message.clone())
    };
    for (from, to, expected) in [
        ("S500 M3", "M3", "speed"),
        ("S500 M3", "G96 S80 M3", "G96"),
        ("S500 M3", "S20000 M3", "revolution"),
        ("G0 X35", "G0 X60", "edge reaches"),
        ("H0.3", "R66 L259", "lead angle"),
        ("G0 Z300\n", "G0 Z598\n", "needs space"),
    ] {
        assert!(PROGRAM.contains(from), "{from}");
        let (line, text) = refused(&PROGRAM.replace(from, to), Some(process()));
        assert_eq!(line, 7, "{to}: {text}");
        assert!(text.contains(expected), "{to}: {text}");
    }
    let (line, text) = refused(PROGRAM, None);
    assert!(line == 7 && text.contains("--process"), "{text}");
}

#[test]
fn facing_to_the_axis_is_accepted_with_any_offset() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("face.ngc");
    let setup = setup(Some(process()));
    for step in 0..200 {
        let (offset, allowance) = (0.237 * f64::from(step), 0.05 + 0.01 * f64::from(step % 90));
        let program = format!(
            "G21 G18 G90 G94 G8\nG10 L2 P1 X{offset:.3} Z0\nG54 S500 M3\nG0 X38\nG0 Z300\nG0 X30\nF200\n\
             G75 X0 Z296 H{allowance:.2} Q1\nM2\n"
        );
        std::fs::write(&file, &program).unwrap();
        let errors = check(&file, &setup, CheckBounds::whole(5)).unwrap().errors;
        assert!(errors.is_empty(), "{program}: {errors:?}");
    }
}

#[test]
fn a_missing_load_stops_the_run_with_the_sensor_alarm() {
    let mut silent = process();
    silent.blank = None;
    let (samples, outcome) = drive(PROGRAM, setup(Some(silent)), |_, _, _| {});
    assert_eq!(outcome.summary.alarm, Some(501));
    assert!(outcome.fault.is_some_and(|text| text.contains("load sensor")));
    assert_eq!(
        samples.last().map(|sample| sample.state),
        Some(MotionState::Fault)
    );
}
