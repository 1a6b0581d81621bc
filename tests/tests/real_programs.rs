//! The shipped programs on the shipped mill: golden summaries, and properties that hold whatever the summary
//! says.
//!
//! After a change of the planner: `EVOLVENT_REGENERATE=1 cargo test -p evolvent-tests real_programs::`, and
//! review the difference before committing it.
#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use std::fs;

use evolvent_tests::{Cycle, Hole, Launch, Workshop, cycles, repository, run};
use serde_json::{Map, Value, json};

/// Program, its end in machine coordinates as read from its last lines, and the tolerance of its G64 in mm.
const PROGRAMS: [(&str, [f64; 3], f64); 6] = [
    // After the departure from the wall, at the safe height; G61. X and Y are in `the_end_of_the_hole` below.
    (
        "bore-200",
        [-50.611_303_158_466_98, 25.268_478_240_720_214, 5.0],
        0.0,
    ),
    // G53 G0 X0 Y0 Z0; G61.
    ("bracket-g61", [0.0; 3], 0.0),
    // G53 G0 X0 Y0 Z0; G64 P0.002 in inches.
    ("facing-inch", [0.0; 3], 0.0508),
    // G0 X0 Y0 Z0; G64 P0.02.
    ("letters", [0.0; 3], 0.02),
    // G0 Z5, G0 X0 Y0; G64 P0.02.
    ("pocket-helix", [0.0, 0.0, 5.0], 0.02),
    // G0 X0 Y0 Z0; G64 P0.01.
    ("relief", [0.0; 3], 0.01),
];

/// Velocity, acceleration and jerk of the shipped mill in mm and s: 30 and 20 m/min, 5 and 3 m/s2, 200 and
/// 100 m/s3.
const LIMITS: [[f64; 3]; 3] = [
    [500.0, 5000.0, 200_000.0],
    [500.0, 5000.0, 200_000.0],
    [20_000.0 / 60.0, 3000.0, 100_000.0],
];
/// Travel of its axes, mm.
const TRAVEL: [[f64; 2]; 3] = [[-400.0, 400.0], [-250.0, 250.0], [-400.0, 100.0]];
/// Bit of the flags of a setpoint: at a step of curvature in exact-path mode, where the joint time bounds the
/// step of acceleration and so the jerk.
const JOINT: u32 = 1 << 4;

fn round(value: &Value, digits: i32) -> Value {
    let scale = 10_f64.powi(digits);
    match value {
        Value::Number(number) if number.is_u64() => value.clone(),
        // Zero has no sign here.
        Value::Number(number) => json!((number.as_f64().unwrap_or(f64::NAN) * scale).round() / scale + 0.0),
        Value::Array(list) => list.iter().map(|value| round(value, digits)).collect(),
        other => other.clone(),
    }
}

/// The part of a summary that does not depend on the host, rounded.
fn golden(summary: &Value) -> Value {
    let fields = [
        ("outcome", 0),
        ("axes", 0),
        ("cycles", 0),
        ("moves", 0),
        ("period_ns", 0),
        ("starved_cycles", 0),
        ("duration_s", 6),
        ("planned_duration_s", 6),
        ("path_length_mm", 6),
        ("end_position", 6),
        ("max_chord_error_mm", 7),
        ("max_path_error_mm", 7),
        ("velocity_ratio", 3),
        ("acceleration_ratio", 3),
        ("jerk_ratio", 3),
        ("needed_rate_hz", 2),
        ("needed_at_line", 0),
    ];
    fields
        .iter()
        .map(|&(name, digits)| (name.to_owned(), round(&summary[name], digits)))
        .collect::<Map<_, _>>()
        .into()
}

#[test]
fn plans_of_the_shipped_programs_are_those_on_file() {
    for (program, ..) in PROGRAMS {
        let file = repository().join(format!("tests/golden/{program}.json"));
        let source = format!("tests/programs/{program}.ngc");
        let plan = run([
            "plan",
            &source,
            "--machine",
            "config/machines/mill-3axis.toml",
            "--json",
        ])
        .expect_code(&[0]);
        let found = serde_json::to_string_pretty(&golden(&plan.json())).expect("JSON") + "\n";
        if std::env::var_os("EVOLVENT_REGENERATE").is_some() {
            fs::write(&file, &found).expect("to write the file");
        }
        let on_file = fs::read_to_string(&file).unwrap_or_default();
        assert_eq!(
            found, on_file,
            "{program}: if that is meant, see the head of this test"
        );
    }
}

/// Properties of the positions in the trace, and that the summary reports the same values.
#[test]
fn shipped_programs_keep_limits_travel_and_tolerance() {
    let machine = repository().join("config/machines/mill-3axis.toml");
    let workshop = Workshop::new();
    for (program, end, tolerance_mm) in PROGRAMS {
        let source = repository().join(format!("tests/programs/{program}.ngc"));
        let trace = workshop.path(&format!("{program}.mcap"));
        let summary = Launch::in_virtual_time(&source, &machine)
            .trace(&trace)
            .finish()
            .expect_code(&[0])
            .json();
        let number = |name: &str| summary[name].as_f64().expect("a number");
        let found = cycles(&trace);

        assert_eq!(summary["outcome"], "done", "{program}");
        assert_eq!(summary["cycles"], found.len(), "{program}");
        let last = found.last().expect("cycles");
        for axis in 0..3 {
            let miss = (last.position[axis] - end[axis]).abs();
            assert!(miss <= 1e-9, "{program}: axis {axis} ends {miss:e} mm off");
            let reported = summary["end_position"][axis].as_f64().expect("a number");
            assert!(
                (reported - last.position[axis]).abs() <= 1e-12,
                "{program}: axis {axis} reported to end at {reported}"
            );
        }
        let chord = number("max_chord_error_mm");
        assert!(
            chord <= number("permitted_chord_error_mm") * (1.0 + 1e-9),
            "{program}: chord error {chord}"
        );
        assert_eq!(
            number("permitted_chord_error_mm"),
            0.001,
            "{program}: one increment of 1 um"
        );
        let path_error = number("max_path_error_mm");
        assert!(
            path_error <= tolerance_mm,
            "{program}: {path_error} mm off the path, {tolerance_mm} permitted"
        );
        for (axis, limits) in LIMITS.iter().enumerate() {
            let names = ["max_velocity_mm_s", "max_acceleration_mm_s2", "max_jerk_mm_s3"];
            let permitted = [1.001, 1.001, 1.02];
            for (order, measured) in extremes(&found, axis, number("period_ns") * 1e-9)
                .into_iter()
                .enumerate()
            {
                let ratio = measured / limits[order];
                assert!(
                    ratio <= permitted[order],
                    "{program}: axis {axis}, {}: {ratio} of the limit",
                    names[order]
                );
                let reported = summary[names[order]][axis].as_f64().expect("a number");
                let alike = (reported - measured).abs() <= 1e-6 * limits[order];
                assert!(
                    alike,
                    "{program}: axis {axis}, {}: {reported} reported, {measured} measured",
                    names[order]
                );
            }
            for cycle in &found {
                let [low, high] = TRAVEL[axis];
                assert!(
                    (low..=high).contains(&cycle.position[axis]),
                    "{program}: axis {axis} leaves its travel"
                );
            }
        }
    }
}

/// Maximum magnitudes of the first three differences of positions, from rest before the first to rest after
/// the last, without third differences that include a step of curvature in exact-path mode.
fn extremes(cycles: &[Cycle], axis: usize, period_s: f64) -> [f64; 3] {
    let first = cycles.first().expect("cycles");
    let last = cycles.last().expect("cycles");
    // The machine starts from home, which is zero.
    let start = Cycle {
        position: [0.0; 9],
        ..*first
    };
    let padded: Vec<&Cycle> = [&start; 3].into_iter().chain(cycles).chain([last; 3]).collect();
    let mut max = [0.0_f64; 3];
    for four in padded.windows(4) {
        let p: Vec<f64> = four.iter().map(|cycle| cycle.position[axis]).collect();
        let velocity = (p[3] - p[2]) / period_s;
        let acceleration = (p[3] - 2.0 * p[2] + p[1]) / (period_s * period_s);
        let jerk = (p[3] - 3.0 * p[2] + 3.0 * p[1] - p[0]) / (period_s * period_s * period_s);
        max[0] = max[0].max(velocity.abs());
        max[1] = max[1].max(acceleration.abs());
        if four.iter().all(|cycle| cycle.flags & JOINT == 0) {
            max[2] = max[2].max(jerk.abs());
        }
    }
    max
}

#[test]
fn the_end_of_the_hole_lies_on_its_last_involute() {
    let program = fs::read_to_string(repository().join("tests/programs/bore-200.ngc")).expect("the program");
    let hole = Hole::read(&program);
    let involute = hole
        .pieces
        .values()
        .rfind(|piece| piece.is_curved())
        .expect("curves");
    let [x, y, z] = PROGRAMS[0].1;
    assert_eq!(hole.end, [x, y, z]);
    assert!(involute.distance([x, y]) < 1e-12);
}
