//! G95 with G97 and G96 in runs with the virtual clock: the feed in the middle of cuts, and recomputation to
//! the same bits.

#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

use std::f64::consts::TAU;
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

/// Runs a turning program, and recomputes the trace.
fn turn(program: &str, planner: PlannerKind) -> Vec<Setpoint> {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/machines/lathe-2axis.toml");
    let text = std::fs::read_to_string(&file).unwrap();
    let mut machine = Machine::parse(&text, "lathe.toml").unwrap();
    machine.path.planner = planner;
    let folder = tempfile::tempdir().unwrap();
    let part = folder.path().join("part.ngc");
    std::fs::write(&part, program).unwrap();
    let trace = folder.path().join("run.mcap");
    let job = Job {
        trace: Some(trace.clone()),
        ..Job::new(part, Setup::new(machine, file, text, None).unwrap())
    };
    let controls = Arc::new(Controls::new(1.0));
    let setpoints = Mutex::new(Vec::new());
    let outcome = run(&job, &controls, &mut Silent, |setpoint| {
        setpoints.lock().unwrap().push(*setpoint);
    })
    .unwrap();
    assert_eq!(outcome.summary.outcome, Outcome::Done);
    let verified = verify(&trace).unwrap();
    assert!(verified.holds() && verified.recomputed, "{verified:?}");
    assert_eq!(verified.compared, verified.cycles);
    setpoints.into_inner().unwrap()
}

const PLANNERS: [PlannerKind; 2] = [PlannerKind::Classic, PlannerKind::Optimal];

#[test]
fn facing_keeps_feed_per_revolution_as_speed_rises() {
    let program = "G21 G18 G8 G90 G95\nG0 X60 Z5\nG96 S100 D1200 M3\nG1 Z0 F0.25\nX8\nG0 Z5\nM5\nM2\n";
    for planner in PLANNERS {
        let setpoints = turn(program, planner);
        let mut count = 0;
        for setpoint in &setpoints {
            let x = setpoint.position[0];
            // While X moves, away from its acceleration at both ends.
            if setpoint.state != MotionState::Running
                || !(10.0..58.0).contains(&x)
                || setpoint.velocity[0] > -1e-6
            {
                continue;
            }
            let rpm = (100_000.0 / (TAU * x)).min(1200.0);
            let per_turn = setpoint.velocity[0].abs() / (rpm / 60.0);
            // Half of the change of speed along a piece, and the lag of the feed.
            assert!(
                (per_turn / 0.25 - 1.0).abs() < 0.02,
                "{planner:?}: {per_turn} mm at {x}"
            );
            count += 1;
        }
        assert!(count > 1000, "{planner:?}: {count}");
    }
}

#[test]
fn a_ball_keeps_its_shape_and_its_feed_per_revolution() {
    let program = "G21 G18 G8 G90 G95 G61\nG0 X2 Z60\nG96 S60 D2000 M3\nG1 Z50 F0.2\nG3 X40 Z12 I0 K-38\n\
                   G1 Z5\nM5\nM2\n";
    for planner in PLANNERS {
        let mut count = 0;
        for setpoint in turn(program, planner) {
            let (x, z) = (setpoint.position[0], setpoint.position[2]);
            if !(12.5..=49.0).contains(&z) {
                continue;
            }
            let radius = (x - 2.0).hypot(z - 12.0);
            assert!((radius - 38.0).abs() < 1e-3, "{radius} at {x}, {z}");
            let rpm = (60_000.0 / (TAU * x)).min(2000.0);
            let per_turn = setpoint.velocity.norm() / (rpm / 60.0);
            if x > 8.0 && x < 39.0 {
                assert!(
                    (per_turn / 0.2 - 1.0).abs() < 0.02,
                    "{planner:?}: {per_turn} at {x}"
                );
                count += 1;
            }
        }
        assert!(count > 500, "{planner:?}: {count}");
    }
}
