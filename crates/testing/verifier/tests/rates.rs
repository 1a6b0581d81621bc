//! Judges the motion of the daemon at every control rate.

#[expect(dead_code, reason = "shared with the benchmarks")]
#[path = "../benches/support/trial.rs"]
pub(crate) mod trial;

use evolvent_verifier::{Allowances, Program, suite};
use trial::{root, setup, trial};

fn programs(names: &[&str]) -> Vec<Program> {
    let all = suite();
    let chosen: Vec<Program> = all
        .into_iter()
        .filter(|program| names.contains(&program.name.as_str()))
        .collect();
    assert_eq!(chosen.len(), names.len());
    chosen
}

#[test]
fn programs_of_every_class_pass_at_every_rate() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let machine = root().join("config/machines/bench-3axis.toml");
    for rate_hz in [250.0, 1000.0, 10_000.0, 35_000.0] {
        let setup = setup(&machine, Some(rate_hz), None).expect("machine");
        for program in programs(&[
            "butterfly-200-r30",
            "slots-r0",
            "squares-r45",
            "helices",
            "bore-involutes",
        ]) {
            let path = folder.path().join(&program.name);
            std::fs::write(&path, &program.text).expect("a file in the temporary folder");
            let trial = trial(&path, &setup).expect("a run");
            let name = format!("{} at {rate_hz} Hz", program.name);
            assert_eq!(trial.error, None, "{name}");
            assert_eq!(trial.summary.outcome.name(), "done", "{name}");
            let violations = trial.verdict.violations(&Allowances::default());
            assert!(violations.is_empty(), "{name}: {violations:?}");
            assert_eq!(trial.verdict.setpoints, trial.summary.cycles, "{name}");
            // The cycle's own gauges agree.
            let gauge = |list: &[f64]| list.iter().copied().fold(0.0, f64::max);
            for (judged, gauge) in [
                (trial.verdict.velocity.value, gauge(&trial.summary.velocity_ratio)),
                (
                    trial.verdict.acceleration.value,
                    gauge(&trial.summary.acceleration_ratio),
                ),
                (trial.verdict.jerk.value, gauge(&trial.summary.jerk_ratio)),
            ] {
                assert!((judged - gauge).abs() < 1e-4, "{name}: {judged} {gauge}");
            }
        }
    }
}
