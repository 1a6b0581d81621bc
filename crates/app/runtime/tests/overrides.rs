//! M48 to M53 in runs with the virtual clock: which override and which hold applies where, and recomputation
//! to the same bits.

#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

use std::path::Path;
use std::sync::{Arc, Mutex};

use evolvent_machine::{Machine, PlannerKind};
use evolvent_motion::{MotionState, Setpoint};
use evolvent_replay::verify;
use evolvent_runtime::{Controls, Job, Notice, Outcome, RunObserver, Setup, run};

struct Silent;

impl RunObserver for Silent {
    fn progress(&mut self, _: &Controls) {}
    fn notice(&mut self, _: &Notice) {}
    fn note(&mut self, _: &str) {}
}

/// Runs a program at 50 % feed, and recomputes the trace.
fn drive(
    program: &str,
    planner: PlannerKind,
    operate: impl Fn(&Controls, &Setpoint) + Send + Sync,
) -> (Vec<Setpoint>, Outcome) {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/machines/mill-3axis.toml");
    let text = std::fs::read_to_string(&file).unwrap();
    let mut machine = Machine::parse(&text, "mill.toml").unwrap();
    machine.path.planner = planner;
    let folder = tempfile::tempdir().unwrap();
    let part = folder.path().join("part.ngc");
    std::fs::write(&part, program).unwrap();
    let trace = folder.path().join("run.mcap");
    let job = Job {
        feed_override: 0.5,
        trace: Some(trace.clone()),
        ..Job::new(part, Setup::new(machine, file, text, None).unwrap())
    };
    let controls = Arc::new(Controls::new(0.5));
    let operated = Arc::clone(&controls);
    let setpoints = Mutex::new(Vec::new());
    let outcome = run(&job, &controls, &mut Silent, |setpoint| {
        operate(&operated, setpoint);
        setpoints.lock().unwrap().push(*setpoint);
    })
    .unwrap();
    let verified = verify(&trace).unwrap();
    assert!(verified.holds() && verified.recomputed, "{verified:?}");
    assert_eq!(verified.compared, verified.cycles);
    (setpoints.into_inner().unwrap(), outcome.summary.outcome)
}

/// The feed in the middle of a move along X, mm/s.
fn feed_at(setpoints: &[Setpoint], x: f64) -> f64 {
    let passes = setpoints.iter().find(|setpoint| setpoint.position[0] >= x);
    passes.unwrap().feed_mm_s
}

const PLANNERS: [PlannerKind; 2] = [PlannerKind::Classic, PlannerKind::Optimal];

#[test]
fn m49_and_m50_ignore_the_override_from_their_blocks() {
    let program = "G21 G90 G94\nG1 X20 F1200\nM49\nX40\nM48\nX60\nM50 P0\nX80\nM51 P0\nX100\nM2\n";
    for planner in PLANNERS {
        let (setpoints, outcome) = drive(program, planner, |_, _| {});
        assert_eq!(outcome, Outcome::Done);
        for (x, feed) in [
            (15.0, 10.0),
            (38.0, 20.0),
            (55.0, 10.0),
            (78.0, 20.0),
            (90.0, 20.0),
        ] {
            let driven = feed_at(&setpoints, x);
            assert!(
                (driven - feed).abs() < 0.02 * feed,
                "{planner:?}: {driven} at {x}"
            );
        }
        // It applies from the second setpoint of the block on, and to none before.
        let begins = setpoints.iter().position(|setpoint| setpoint.block == 1).unwrap();
        assert_eq!(setpoints[begins].feed_override, 0.5, "{planner:?}");
        assert_eq!(setpoints[begins + 1].feed_override, 1.0, "{planner:?}");
    }
}

#[test]
fn a_hold_waits_until_it_counts_and_a_stop_does_not() {
    let program = "G21 G90 G94 F1200\nM53 P0\nG1 X20\nM53 P1\nX40\nM2\n";
    for planner in PLANNERS {
        let (setpoints, outcome) = drive(program, planner, |controls, setpoint| match setpoint.state {
            MotionState::Held => controls.set_hold(false),
            _ if setpoint.position[0] > 5.0 && setpoint.position[0] < 20.0 => controls.set_hold(true),
            _ => {}
        });
        assert_eq!(outcome, Outcome::Done);
        let held = setpoints
            .iter()
            .find(|setpoint| setpoint.state == MotionState::Held)
            .unwrap();
        assert!(held.position[0] > 20.0 && held.position[0] < 30.0, "{held:?}");
        let (setpoints, outcome) = drive(program, planner, |controls, setpoint| {
            if setpoint.position[0] > 5.0 {
                controls.stop();
            }
        });
        assert_eq!(outcome, Outcome::Stopped);
        assert!(setpoints.last().unwrap().position[0] < 15.0);
    }
}

#[test]
fn floating_taps_ignore_holds_and_overrides() {
    let program = "G21 G90 G94 F600 S400 M3\nG0 Z-10\nG84 X0 Z-30 R-12\nG80\nG1 X20\nM2\n";
    for planner in PLANNERS {
        let (setpoints, outcome) = drive(program, planner, |controls, setpoint| match setpoint.state {
            MotionState::Held => controls.set_hold(false),
            _ if setpoint.position[2] < -15.0 => controls.set_hold(true),
            _ => {}
        });
        assert_eq!(outcome, Outcome::Done);
        let deep = setpoints.iter().filter(|setpoint| setpoint.position[2] < -14.0);
        assert!(
            deep.clone()
                .all(|setpoint| setpoint.feed_override == 1.0 && setpoint.state != MotionState::Held)
        );
        let middle = deep.filter(|setpoint| (setpoint.position[2] + 21.0).abs() < 1.0);
        for setpoint in middle {
            assert!(
                (setpoint.feed_mm_s - 10.0).abs() < 0.1,
                "{planner:?}: {setpoint:?}"
            );
        }
        assert!(
            setpoints
                .iter()
                .any(|setpoint| setpoint.state == MotionState::Held)
        );
        assert!((feed_at(&setpoints, 12.0) - 5.0).abs() < 0.1);
    }
}
