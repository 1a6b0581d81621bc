//! Sensors of torque, power and current: the result equals that of a force sensor, and a dead sensor is
//! distinguished from air.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use evolvent_turning::{
    Blank, LoadScale, Reason, SensorFault, SensorModel, SensorTrouble, Simulation, TurningInputs, TurningJob,
    TurningSettings,
};

use crate::common::{SET, TURN_S, law, safe, sensor};

fn shaft(sensor: &str) -> Result<TurningJob, String> {
    let file = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../../config/processes/turn-shaft.toml"
    );
    let text = std::fs::read_to_string(file).unwrap();
    assert!(text.contains("[sensor]\n"));
    let text = text.replace("[sensor]\n", &format!("[sensor]\n{sensor}\n"));
    TurningJob::parse(&text, "shaft.toml").map_err(|error| error.to_string())
}

/// Reading of each kind for 2200 N at 60 mm and 500 rev/min, computed by hand.
fn kinds() -> [(&'static str, f64); 4] {
    let torque = 2200.0 * 0.030;
    let power = 2200.0 * std::f64::consts::PI * 0.060 * 500.0 / 60.0;
    [
        ("kind = \"force\"", 2200.0),
        ("kind = \"torque\"\nidle = 5.0", torque + 5.0),
        (
            "kind = \"power\"\nidle = 400.0\nidle_per_rpm = 0.8\nefficiency = 0.85",
            power / 0.85 + 800.0,
        ),
        (
            "kind = \"current\"\nidle = 3.0\namps_per_nm = 0.25",
            0.25 * torque + 3.0,
        ),
    ]
}

#[test]
fn each_kind_shows_what_the_laws_of_mechanics_say() {
    for (text, expected) in kinds() {
        let scale = shaft(text).unwrap().settings.scale;
        let reading = scale.reading(2200.0, [0.0; 2], 0.0);
        assert!(
            (reading / expected - 1.0).abs() < 1e-9,
            "{text}: {reading} for {expected}"
        );
    }
    for (text, expected) in [
        ("kind = \"current\"", "amps_per_nm"),
        ("kind = \"power\"\nefficiency = 0.0", "efficiency"),
        ("kind = \"torque\"\nidle = -1.0", "idle"),
        ("kind = \"sound\"", "kind"),
    ] {
        let error = shaft(text).unwrap_err();
        assert!(error.contains(expected), "{text}: {error}");
    }
}

fn with(scale: LoadScale) -> (TurningSettings, SensorModel) {
    let settings = TurningSettings { scale, ..safe() };
    let model = SensorModel {
        range_max: scale.reading(8000.0, [0.0; 2], 0.0),
        noise: 0.01,
        ..sensor(4)
    };
    (settings, model)
}

#[test]
fn torque_power_and_current_keep_the_set_load() {
    for (text, _) in kinds() {
        let (settings, model) = with(shaft(text).unwrap().settings.scale);
        for blank in [Blank::uniform(8.0), Blank::outline(&[(0.0, 10.0), (200.0, 5.0)])] {
            let mut sim = Simulation::new(settings, blank, law(), model).unwrap();
            let (figures, reason) = sim.run(3000.0, |_, _| {});
            let what = format!("{text}: {reason:?}, {figures:?}");
            assert!(figures.done && figures.residual_mm <= 0.1, "{what}");
            assert!(figures.over_130_s <= TURN_S && figures.peak < 1.3 * SET, "{what}");
            // The force acts above the tip by up to half the depth, so it is overestimated by a twelfth at
            // most.
            assert!(figures.time_s < 1.2 * 207.0, "{what}");
        }
    }
}

/// Facing from 160 mm: the torque of a constant force falls with the diameter.
#[test]
fn facing_by_torque_power_current_keeps_the_load() {
    let facing = |sensor: &str, length: f64| {
        let file = concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/../../../config/processes/turn-shaft.toml"
        );
        let text = std::fs::read_to_string(file).unwrap();
        let text = text
            .replace("[sensor]\n", &format!("[sensor]\n{sensor}\n"))
            .replace("kind = \"longitudinal\"", "kind = \"facing\"")
            .replace("diameter_mm = 60.0", "diameter_mm = 160.0")
            .replace("length_mm = 200.0", &format!("length_mm = {length:.1}"));
        TurningJob::parse(&text, "face.toml").map_err(|error| error.to_string())
    };
    for (text, _) in kinds() {
        let job = facing(text, 55.0).unwrap();
        let settings = TurningSettings {
            period_s: crate::common::PERIOD_S,
            ..job.settings
        };
        let law = settings.regime.law;
        for blank in [Blank::uniform(7.0), Blank::outline(&[(0.0, 8.0), (55.0, 4.0)])] {
            let mut sim = Simulation::new(settings, blank, law, job.sensor).unwrap();
            let (figures, reason) = sim.run(3000.0, |_, _| {});
            let what = format!("{text}: {reason:?}, {figures:?}");
            assert!(figures.done && figures.residual_mm <= 0.1, "{what}");
            assert!(figures.over_130_s <= TURN_S && figures.peak < 1.3 * SET, "{what}");
        }
    }
    // 2200 N at 160 mm are 176 N m; 50 mm nearer to the axis 66 N m. The edge leads by 1 mm / tan(60) per mm
    // of depth.
    let scale = facing(kinds()[1].0, 55.0).unwrap().settings.scale;
    for (position, depth, expected) in [
        (0.0, 0.0, 176.0),
        (50.0, 0.0, 66.0),
        (50.0, 3.0, 66.0 - 1.1 * 3.0 / 3.0_f64.sqrt()),
    ] {
        let reading = scale.reading(2200.0, [position, 2.0], depth);
        assert!(
            (reading - 5.0 - expected).abs() < 1e-9,
            "{position} {depth}: {reading}"
        );
    }
    // At the axis the torque of any force is zero.
    let error = facing(kinds()[1].0, 79.0).unwrap_err();
    assert!(
        error.contains("sensor.kind") && error.contains("nearer"),
        "{error}"
    );
    assert!(facing(kinds()[0].0, 79.0).is_ok());
}

#[test]
fn a_dead_sensor_is_told_from_air_by_the_idle_reading() {
    // Idle power is half of that at the set load: without supply the reading is far below that in air.
    let mut scale = shaft(kinds()[2].0).unwrap().settings.scale;
    scale.idle = 0.5 * (scale.reading(SET, [0.0; 2], 0.0) - scale.idle);
    let (settings, model) = with(scale);
    let mut sim = Simulation::new(settings, Blank::uniform(8.0), law(), model).unwrap();
    // Still in air.
    while sim.figures.time_s < 1.6 {
        sim.step(TurningInputs::default(), None);
    }
    let (mut reason, mut time_s) = (None, 0.0);
    while reason.is_none() && time_s < 1.0 {
        let (output, _) = sim.step(TurningInputs::default(), Some(SensorFault::Zero));
        reason = output.transition.map(|transition| transition.reason);
        time_s += settings.period_s;
    }
    assert_eq!(reason, Some(Reason::Sensor(SensorTrouble::Negative)));
    assert!(time_s <= TURN_S, "{time_s}");
}
