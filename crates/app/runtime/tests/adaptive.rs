//! A run whose feed keeps a cutting load: with the virtual clock, and with a load computed from the
//! setpoints.
#![expect(clippy::unwrap_used, reason = "a test may fail")]

use std::path::Path;
use std::sync::{Arc, Mutex};

use evolvent_machine::{Machine, PlannerKind};
use evolvent_runtime::{Controls, Job, Notice, RunObserver, RunOutcome, Setup, run};
use evolvent_turning::AdaptiveSettings;

const SET: f64 = 1000.0;
const TURN_S: f64 = 0.1;
/// 300 mm/min.
const FEED_MM_S: f64 = 5.0;
const PROGRAM: &str = "G21 G90 G94\nG0 X0 Y0 Z0\nG1 X60 F300\nG1 X120\nG0 X0\nM2\n";

struct Silent;

impl RunObserver for Silent {
    fn progress(&mut self, _: &Controls) {}
    fn notice(&mut self, _: &Notice) {}
    fn note(&mut self, _: &str) {}
}

/// (path, feed, load, override) of each setpoint, and the outcome. The sensor sends up to a position.
fn run_with(sends_to_mm: f64) -> (Vec<[f64; 4]>, RunOutcome, f64) {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/machines/mill-3axis.toml");
    let mut machine = Machine::load(&file).unwrap();
    machine.path.planner = PlannerKind::Classic;
    let setup = Setup::new(machine, file, String::new(), None).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let program = folder.path().join("cut.ngc");
    std::fs::write(&program, PROGRAM).unwrap();
    let period_s = setup.period_ns as f64 * 1e-9;
    let settings = AdaptiveSettings {
        overload: 1.6 * SET,
        lag_s: 0.0,
        ..AdaptiveSettings::usual(SET, TURN_S, period_s)
    };
    let job = Job::new(program, setup);
    let controls = Arc::new(Controls::new(1.0).with_adaptive_feed(settings));
    let sensor = Arc::clone(&controls);
    let samples: Mutex<Vec<[f64; 4]>> = Mutex::new(Vec::new());
    let turn = (TURN_S / period_s).round() as usize;
    let outcome = run(&job, &controls, &mut Silent, |setpoint| {
        let x = setpoint.position[0];
        // From 20 mm on, the load at the programmed feed rises from half to twice the set load.
        let engaged = if x < 20.0 {
            0.0
        } else {
            0.5 + 1.5 * (x - 20.0) / 100.0
        };
        let ripple = 1.0 + 0.01 * (setpoint.sequence as f64).sin();
        let mut samples = samples.lock().unwrap();
        // The chip thickness is the distance in the last revolution.
        let before = samples
            .len()
            .checked_sub(turn)
            .map_or(0.0, |turn_ago| samples[turn_ago][0]);
        let chip = (x - before).max(0.0) / TURN_S / FEED_MM_S;
        let load = SET * engaged * chip.powf(0.75) * ripple;
        if x <= sends_to_mm {
            sensor.set_load(load, 10.0 * SET);
        }
        samples.push([x, setpoint.feed_mm_s, load, setpoint.feed_override]);
    })
    .unwrap();
    (samples.into_inner().unwrap(), outcome, period_s)
}

#[test]
fn load_and_limits_are_kept_and_rapids_not_scaled() {
    let (samples, outcome, _) = run_with(1e9);
    assert_eq!(outcome.fault, None);
    let summary = &outcome.summary;
    assert_eq!(summary.outcome.name(), "done");
    assert!(
        summary.jerk_ratio.iter().all(|ratio| *ratio <= 1.02),
        "{summary:?}"
    );
    let there: Vec<_> = samples.iter().take_while(|s| s[0] < 119.0).collect();
    // In air the idle factor, then the factor for the load: (set / engaged)^(1/0.75).
    assert!(
        there
            .iter()
            .any(|s| s[0] < 19.0 && (s[1] - 1.5 * FEED_MM_S).abs() < 1e-3)
    );
    for s in there.iter().filter(|s| s[0] > 65.0) {
        assert!((s[2] / SET - 1.0).abs() < 0.06, "{s:?}");
    }
    let slowest = there
        .iter()
        .filter(|s| s[0] > 65.0)
        .map(|s| s[1])
        .fold(f64::INFINITY, f64::min);
    let expected = FEED_MM_S * (1.0 / 1.985_f64).powf(1.0 / 0.75);
    assert!(
        (slowest / expected - 1.0).abs() < 0.05,
        "{slowest} for {expected}"
    );
    let rapid = samples.iter().map(|s| s[1]).fold(0.0, f64::max);
    assert!(rapid > 20.0 * FEED_MM_S, "{rapid}");
}

#[test]
fn a_silent_sensor_stops_the_run_within_a_turn() {
    let (samples, outcome, period_s) = run_with(70.0);
    assert_eq!(outcome.summary.alarm, Some(501));
    assert!(outcome.fault.is_some_and(|text| text.contains("load sensor")));
    let silent = samples.iter().position(|s| s[0] > 70.0).unwrap();
    let stopped_at = samples.iter().skip(silent).position(|s| s[1] == 0.0).unwrap();
    assert!(
        stopped_at as f64 * period_s <= 0.1,
        "{} s",
        stopped_at as f64 * period_s
    );
    assert!(
        samples.iter().all(|s| s[0] < 72.0),
        "it stops where the sensor does"
    );
}
