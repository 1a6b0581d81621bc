//! Machine files: shipped files are valid, and invalid files are rejected with the position of the error.

#![expect(
    clippy::unwrap_used,
    clippy::panic,
    reason = "clippy does not recognise the helpers of these tests as test code"
)]

use std::path::Path;

use evolvent_file_tests::{assert_schema, config};
use evolvent_machine::{
    ControlRate, CycleRecording, FeedbackMode, HomingMethod, Lead, Machine, MachineError, MachineKind,
    OnFull, PathMode, RotaryWay, UNLIMITED_DEG, machine_schema,
};
use evolvent_path::AxisLetter;
use proptest::prelude::*;

fn shipped() -> Vec<(String, String)> {
    let mut files: Vec<_> = std::fs::read_dir(config().join("machines"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "toml"))
        .map(|path| {
            (
                path.file_stem().unwrap().to_str().unwrap().to_owned(),
                std::fs::read_to_string(&path).unwrap(),
            )
        })
        .collect();
    files.sort();
    files
}

const GOOD: &str = r#"name = "m"
kind = "mill"
increments_per_mm = 1000
increments_per_degree = 100
rate = 1000.5

[limits]
max_feed_mm_min = 6000

[path]
mode = "exact"
joint_time_ms = 2

[realtime]
priority = 70
core = 1

[trace]
cycles = "columns"
on_full = "stop"
[[axis]]
letter = "x"
travel_min_mm = -1
travel_max_mm = 2
max_velocity_mm_min = 30000
max_acceleration_g = 0.5
max_jerk_m_s3 = 50
home_mm = 1.5

[[axis]]
letter = "A"
kind = "rotary"
travel_min_deg = -90
travel_max_deg = 90
max_velocity_deg_min = 3600
max_acceleration_deg_s2 = 100
max_jerk_deg_s3 = 1000
"#;

#[test]
fn drive_monitoring_is_read_and_has_defaults() {
    let machine = Machine::parse(GOOD, "full.toml").unwrap();
    assert_eq!(machine.drives.feedback, FeedbackMode::IfPresent);
    assert_eq!(
        (machine.drives.feedback_timeout_s, machine.drives.enable_timeout_s),
        (0.02, 2.0)
    );
    assert!(machine.drives.follow_clock);
    assert_eq!(
        (machine.axes[0].following_error, machine.axes[0].following_time_s),
        (0.5, 0.02)
    );
    let text = GOOD.replace(
        "home_mm = 1.5",
        "home_mm = 1.5\nfollowing_error_mm = 0.1\nfollowing_time_ms = 5",
    ) + "following_error_deg = 2\n[drives]\nfeedback = \"required\"\nfeedback_timeout_ms = 8\nfollow_clock = false\n";
    let machine = Machine::parse(&text, "full.toml").unwrap();
    assert_eq!(machine.drives.feedback, FeedbackMode::Required);
    assert_eq!(machine.drives.feedback_timeout_s, 0.008);
    assert!(!machine.drives.follow_clock);
    assert_eq!(
        (machine.axes[0].following_error, machine.axes[0].following_time_s),
        (0.1, 0.005)
    );
    assert_eq!(machine.axes[1].following_error, 2.0);
}

#[test]
fn a_file_is_converted_to_mm_degrees_and_seconds() {
    let machine = Machine::parse(GOOD, "good.toml").unwrap();
    assert_eq!(machine.rate, ControlRate::Hz(1000.5));
    assert_eq!(machine.axis_letters(), "XA");
    assert_eq!(machine.max_feed_mm_s, Some(100.0));
    assert_eq!(machine.path.mode, PathMode::Exact);
    assert_eq!(machine.path.joint_time_s, 0.002);
    assert_eq!(machine.path.involute_end_tolerance_mm, 0.001);
    assert_eq!((machine.realtime.priority, machine.realtime.core), (70, Some(1)));
    assert_eq!(machine.trace.on_full, OnFull::Stop);
    assert_eq!(machine.trace.cycles, CycleRecording::Columns);
    assert_eq!(machine.lead, Lead::ByRate);
    assert_eq!(machine.max_late_cycles(1_000_000), 1000);
    assert_eq!(machine.max_late_cycles(28_571), 35_000);
    let limits = machine.limits();
    let (x, a, y) = (
        AxisLetter::X.index(),
        AxisLetter::A.index(),
        AxisLetter::Y.index(),
    );
    assert_eq!(
        (limits.velocity[x], limits.acceleration[x], limits.jerk[x]),
        (500.0, 4905.0, 50_000.0)
    );
    assert_eq!(
        (limits.travel_min[x], limits.travel_max[x], limits.home[x]),
        (-1.0, 2.0, 1.5)
    );
    assert_eq!(
        (limits.velocity[a], limits.acceleration[a], limits.jerk[a]),
        (60.0, 100.0, 1000.0)
    );
    assert_eq!(
        (limits.present[x], limits.present[a], limits.present[y]),
        (true, true, false)
    );
    assert_eq!(
        (limits.velocity[y], limits.jerk[y], limits.travel_max[y]),
        (0.0, 0.0, 0.0)
    );
    assert_eq!(
        (
            machine.increments()[x],
            machine.increments()[a],
            machine.increments()[y]
        ),
        (1000.0, 100.0, 0.0)
    );
}

#[test]
fn every_shipped_machine_is_valid_and_named_as_its_file() {
    let files = shipped();
    assert!(files.len() >= 10, "only {} machines ship", files.len());
    for (stem, text) in files {
        let machine = Machine::parse(&text, &stem).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(machine.name, stem);
        machine.period_ns(machine.rate).unwrap();
        let at_home = machine
            .axes
            .iter()
            .all(|axis| (axis.travel_min..=axis.travel_max).contains(&axis.home));
        assert!(at_home && !machine.description.is_empty(), "{stem}");
    }
}

#[test]
fn shipped_machines_carry_the_papers_limits() {
    let rate = |stem: &str| {
        let machine = Machine::load(&config().join(format!("machines/{stem}.toml"))).unwrap();
        machine.rational_rate().unwrap().rate_hz
    };
    let cases = [
        ("6r13gn1", 110.85),
        ("fp7m", 121.43),
        ("fp7smn", 156.73),
        ("ma655sm30a", 297.31),
        ("16k20f3", 313.21),
    ];
    for (stem, hz) in cases {
        assert!(
            (rate(stem) - hz).abs() < 0.01,
            "{stem}: {} Hz, expected {hz}",
            rate(stem)
        );
    }
    // UCP 710: the maxima over the axes are 2.5 m/s2 (X) and 50 m/s3 (Z), which meet at R = 6.25 mm.
    let expected = 0.5 * (2500.0 * 1000.0 / (2.0 - 1.0 / 6250.0_f64)).sqrt();
    assert!(
        (rate("ucp-710") - expected).abs() < 1e-6,
        "{} {expected}",
        rate("ucp-710")
    );
    let lathe = Machine::load(&config().join("machines/16k20f3.toml")).unwrap();
    assert_eq!(lathe.kind, MachineKind::Lathe);
}

#[test]
fn the_three_axis_mill_is_as_documented() {
    let mill = Machine::load(&config().join("machines/mill-3axis.toml")).unwrap();
    let limits = mill.limits();
    let head = |axes: evolvent_path::Axes| [axes[0], axes[1], axes[2]];
    assert_eq!(head(limits.velocity), [500.0, 500.0, 20_000.0 / 60.0]);
    assert_eq!(head(limits.acceleration), [5000.0, 5000.0, 3000.0]);
    assert_eq!(head(limits.jerk), [200_000.0, 200_000.0, 100_000.0]);
    assert_eq!(head(limits.travel_min), [-400.0, -250.0, -400.0]);
    assert_eq!(head(limits.travel_max), [400.0, 250.0, 100.0]);
    assert_eq!(
        (mill.rate, mill.lead_cycles(1_000_000), mill.increments_per_mm),
        (ControlRate::Rational, 2, 1000.0)
    );
    assert_eq!(
        (mill.path.blend_tolerance_mm, mill.path.joint_time_s),
        (0.01, 0.001)
    );
}

const TABLE: &str = "[[axis]]\nletter = \"C\"\nmax_velocity_deg_s = 360\nmax_acceleration_deg_s2 = 720\nmax_jerk_deg_s3 = 7200\n";

#[test]
fn a_rotary_axis_without_ends_needs_no_travel_and_takes_none() {
    let parse = |keys: &str| Machine::parse(&format!("{GOOD}\n{TABLE}{keys}"), "table.toml");
    for (word, way) in [("shorter", RotaryWay::Shorter), ("sign", RotaryWay::Sign)] {
        let machine = parse(&format!("unlimited = \"{word}\"\nhome_deg = -90")).unwrap();
        let axis = machine.axis(AxisLetter::C).unwrap();
        assert_eq!((axis.unlimited, axis.home), (Some(way), -90.0));
        assert_eq!(
            (axis.travel_min, axis.travel_max),
            (-UNLIMITED_DEG, UNLIMITED_DEG)
        );
        assert!(machine.unlimited().contains(AxisLetter::C.index()));
    }
    let unlimited = "unlimited = \"shorter\"\n";
    for (keys, key) in [
        (format!("{unlimited}travel_min_deg = 0"), "travel_min_deg"),
        (format!("{unlimited}screw_table = \"c.csv\""), "screw_table"),
        (format!("{unlimited}home_deg = 361"), "home_deg"),
        ("unlimited = true".to_owned(), "unlimited"),
        ("unlimited = \"for ever\"".to_owned(), "unlimited"),
        (String::new(), "travel_min_deg"),
    ] {
        let error = parse(&keys).unwrap_err().to_string();
        assert!(
            error.contains(key) && error.contains("table.toml:"),
            "{keys}: {error}"
        );
    }
    let linear = GOOD.replacen(
        "travel_min_mm = -1",
        "unlimited = \"sign\"\ntravel_min_mm = -1",
        1,
    );
    let error = Machine::parse(&linear, "linear.toml").unwrap_err().to_string();
    assert!(error.contains("unlimited") && error.contains("linear"), "{error}");
}

fn homed(keys: &str) -> Result<Machine, MachineError> {
    Machine::parse(
        &format!("{GOOD}\n[[homing]]\naxis = \"X\"\n{keys}"),
        "homing.toml",
    )
}

#[test]
fn every_method_of_homing_is_read_with_the_keys_that_it_needs() {
    let speeds = "towards = \"positive\"\nsearch_mm_s = 20\nlatch_mm_s = 2\n";
    let of = |keys: &str| homed(keys).unwrap().homing[0];
    let switch = of(&format!("{speeds}switch_mm = 1.5"));
    assert_eq!((switch.method, switch.reference), (HomingMethod::Switch, 1.5));
    let index = "index_mm = 0.5\nindex_within_mm = 1.2\n";
    for (edge, when_opening) in [
        ("", false),
        ("index_edge = \"closing\"", false),
        ("index_edge = \"opening\"", true),
    ] {
        let found = of(&format!("method = \"switch-index\"\n{speeds}{index}{edge}"));
        let within = 1.2;
        assert_eq!(
            found.method,
            HomingMethod::SwitchThenIndex { when_opening, within }
        );
        assert_eq!((found.reference, found.negative), (0.5, false));
    }
    let alone = of(&format!(
        "method = \"index\"\ntowards = \"negative\"\nlatch_mm_s = 2\n{index}"
    ));
    assert_eq!(alone.method, HomingMethod::Index { within: 1.2 });
    assert_eq!((alone.negative, alone.search_velocity), (true, 2.0));
    let absolute = of("method = \"absolute\"\norder = 3");
    assert_eq!((absolute.method, absolute.order), (HomingMethod::Absolute, 3));
}

#[test]
fn keys_that_a_method_of_homing_has_no_use_for_and_those_that_it_lacks_are_told() {
    let speeds = "towards = \"positive\"\nsearch_mm_s = 20\nlatch_mm_s = 2\n";
    for (keys, key) in [
        (format!("{speeds}switch_mm = 1\nindex_mm = 0"), "index_mm"),
        (
            format!("{speeds}switch_mm = 1\nindex_edge = \"opening\""),
            "index_edge",
        ),
        (speeds.to_owned(), "switch_mm"),
        (
            "search_mm_s = 20\nlatch_mm_s = 2\nswitch_mm = 1".to_owned(),
            "towards",
        ),
        (
            format!("method = \"switch-index\"\n{speeds}index_mm = 0"),
            "index_within_mm",
        ),
        (
            format!("method = \"switch-index\"\n{speeds}index_within_mm = 1"),
            "index_mm",
        ),
        (
            format!("method = \"switch-index\"\n{speeds}index_mm = 0\nindex_within_mm = 4"),
            "index_within_mm",
        ),
        (
            format!("method = \"switch-index\"\n{speeds}switch_mm = 0\nindex_mm = 0\nindex_within_mm = 1"),
            "switch_mm",
        ),
        (
            "method = \"absolute\"\ntowards = \"positive\"".to_owned(),
            "towards",
        ),
        ("method = \"absolute\"\nlatch_mm_s = 1".to_owned(), "latch_mm_s"),
        (
            format!("method = \"index\"\n{speeds}index_deg = 0\nindex_within_mm = 1"),
            "index_mm",
        ),
        (format!("method = \"echo\"\n{speeds}"), "switch-index"),
    ] {
        let error = homed(&keys).unwrap_err().to_string();
        assert!(
            error.contains(key) && error.contains("homing.toml:"),
            "{keys}: {error}"
        );
    }
}

/// To regenerate the file: `EVOLVENT_WRITE_SCHEMA=1 cargo test -p evolvent-machine schema`.
#[test]
fn the_shipped_schema_is_that_of_the_code() {
    assert_schema("machine.schema.json", &machine_schema(), "evolvent-machine");
}

/// Asserts that an edit of `GOOD` is rejected with these parts of the message.
fn rejected(edits: &[(&str, &str)], parts: &[&str]) {
    let mut text = GOOD.to_owned();
    for (from, to) in edits {
        assert!(text.contains(from), "no {from:?} in the good file");
        text = text.replacen(from, to, 1);
    }
    let message = match Machine::parse(&text, "bad.toml") {
        Ok(_) => panic!("accepted: {edits:?}"),
        Err(error) => error.to_string(),
    };
    for part in parts {
        assert!(
            message.contains(part),
            "{edits:?}\n  gives   {message}\n  without {part}"
        );
    }
}

#[test]
fn invalid_files_are_rejected_with_key_and_advice() {
    rejected(
        &[("name = \"m\"", "name = \"\"")],
        &["bad.toml:1:1: name:", "1 to 64 letters"],
    );
    rejected(
        &[("name = \"m\"", "name = \"a/b\"")],
        &["bad.toml:1:1: name:", "a/b"],
    );
    rejected(
        &[("name = \"m\"", "")],
        &["name", "missing field", "add this key"],
    );
    rejected(
        &[("kind = \"mill\"", "kind = \"milk\"")],
        &["bad.toml:2:", ": kind:", "mill", "lathe"],
    );
    rejected(
        &[("kind = \"mill\"", "kind = \"lathe\"")],
        &[": axis:", "lathe needs", "Z"],
    );
    rejected(
        &[("increments_per_mm = 1000", "increments_per_mm = 0")],
        &["bad.toml:3:1: increments_per_mm: 0"],
    );
    rejected(
        &[("increments_per_mm = 1000", "increments_per_mm = nan")],
        &["3:1: increments_per_mm: NaN"],
    );
    rejected(
        &[("increments_per_degree = 100", "")],
        &["increments_per_degree: missing", "A is rotary"],
    );
    rejected(
        &[("rate = 1000.5", "rate = 100")],
        &["bad.toml:5:1: rate: 100", "250 to 35000"],
    );
    rejected(
        &[("rate = 1000.5", "rate = 35001")],
        &["rate: 35001", "250 to 35000"],
    );
    rejected(
        &[("rate = 1000.5", "rate = \"rationel\"")],
        &["bad.toml:5:1: rate:", "rationel", "\"rational\" or a number"],
    );
    rejected(
        &[("rate = 1000.5", "rate = true")],
        &["rate:", "\"rational\" or a number"],
    );
    rejected(
        &[("max_feed_mm_min = 6000", "max_feed = 6000")],
        &["8:1: limits.max_feed:", "unit is missing"],
    );
    rejected(
        &[(
            "max_feed_mm_min = 6000",
            "max_feed_mm_min = 6000\nmax_feed_mm_s = 100",
        )],
        &["bad.toml:9:1: limits.max_feed_mm_s: given a second time"],
    );
    rejected(
        &[("mode = \"exact\"", "mode = \"exakt\"")],
        &["path.mode", "exact"],
    );
    rejected(
        &[("mode = \"exact\"", "blend_tolerance_mm = 0")],
        &["path.blend_tolerance_mm", "mode = \"exact\""],
    );
    rejected(
        &[("joint_time_ms = 2", "joint_time_ms = 0")],
        &["12:1: path.joint_time_ms: 0"],
    );
    rejected(
        &[("joint_time_ms = 2", "min_radius_mm = 1e-4")],
        &["path.min_radius_mm", "0.0005 mm"],
    );
    rejected(
        &[("priority = 70", "priority = 99")],
        &["15:1: realtime.priority: 99", "2 to 98"],
    );
    rejected(
        &[("priority = 70", "priority = 70.5")],
        &["realtime.priority", "70.5"],
    );
    rejected(&[("core = 1", "core = -1")], &["realtime.core: -1"]);
    rejected(
        &[("cycles = \"columns\"", "cycles = \"rows\"")],
        &["trace.cycles", "messages"],
    );
    rejected(
        &[("on_full = \"stop\"", "on_full = \"wait\"")],
        &["trace.on_full", "continue"],
    );
    let drives = "on_full = \"stop\"\n[drives]\n";
    for (key, words) in [
        ("feedback = \"perhaps\"", ["drives.feedback", "required"]),
        (
            "feedback_timeout_ms = 0",
            ["drives.feedback_timeout_ms: 0 is out of range", "1 to 1000"],
        ),
        (
            "enable_timeout_ms = nan",
            ["drives.enable_timeout_ms: NaN", "10 to"],
        ),
    ] {
        rejected(&[("on_full = \"stop\"", &format!("{drives}{key}"))], &words);
    }
    rejected(
        &[("letter = \"x\"", "letter = \"Q\"")],
        &["22:1: axis[0].letter:", "\"Q\" is no axis"],
    );
    rejected(&[("letter = \"x\"", "letter = \"\"")], &["axis[0].letter"]);
    rejected(
        &[("letter = \"x\"", "letter = \"A\"")],
        &["23:1: axis[0].travel_min_mm:", "A is rotary", "degrees"],
    );
    rejected(
        &[("letter = \"x\"", "letter = \"X\"\nkind = \"rotary\"")],
        &["axis[0].kind: axis X is linear"],
    );
    rejected(
        &[("kind = \"rotary\"", "kind = \"linear\"")],
        &["axis[1].kind: axis A is rotary"],
    );
    rejected(
        &[("letter = \"A\"", "letter = \"X\""), ("kind = \"rotary\"", "")],
        &["axis[1].travel_min_deg"],
    );
    rejected(
        &[("travel_min_mm = -1", "travel_min_mm = 3")],
        &["23:1: axis[0].travel_min_mm", "3 mm", "2 mm"],
    );
    rejected(
        &[("travel_min_mm = -1", "travel_min_mm = 2")],
        &["axis[0].travel_min_mm"],
    );
    rejected(&[("travel_min_mm = -1", "")], &["axis[0].travel_min_mm: missing"]);
    rejected(
        &[("travel_min_mm = -1", "travel_min = -1")],
        &["23:1: axis[0].travel_min", "unit is missing"],
    );
    rejected(
        &[("travel_max_mm = 2", "travel_max_mm = inf")],
        &["24:1: axis[0].travel_max_mm: inf"],
    );
    rejected(
        &[("home_mm = 1.5", "home_mm = 2.5")],
        &["28:1: axis[0].home_mm: home is 2.5 mm"],
    );
    rejected(
        &[("travel_min_mm = -1", "travel_min_mm = 1"), ("home_mm = 1.5", "")],
        &["axis[0].home_mm: home is 0"],
    );
    rejected(
        &[("max_velocity_mm_min", "max_velocity")],
        &["25:1: axis[0].max_velocity:", "max_velocity_mm_min or"],
    );
    rejected(
        &[("max_velocity_mm_min = 30000", "")],
        &["axis[0].max_velocity_mm_min: missing"],
    );
    rejected(
        &[(
            "max_velocity_mm_min = 30000",
            "max_velocity_mm_min = 30000\nmax_velocity_mm_s = 500",
        )],
        &["26:1: axis[0].max_velocity_mm_s: given a second time"],
    );
    rejected(
        &[("max_velocity_mm_min = 30000", "max_velocity_mm_min = \"fast\"")],
        &["25:", "axis[0].max_velocity_mm_min", "fast"],
    );
    rejected(
        &[("max_velocity_mm_min = 30000", "max_velocity_m_h = 1")],
        &["25:1: axis[0].max_velocity_m_h", "spelling"],
    );
    rejected(
        &[("max_velocity_deg_min", "max_velocity_mm_min")],
        &["axis[1].max_velocity_mm_min", "A is rotary"],
    );
    rejected(&[("[trace]", "[tracing]")], &["tracing", "unknown field"]);
    rejected(
        &[("name = \"m\"", "name = \"m\"\nname = \"n\"")],
        &["bad.toml:2:1: not valid TOML"],
    );
    rejected(
        &[("kind = \"mill\"", "kind = mill")],
        &["bad.toml:2:", "not valid TOML"],
    );
}

#[test]
fn every_limit_rejects_numbers_out_of_range() {
    let keys = [
        ("max_velocity_mm_min = 30000", "max_velocity_mm_min", "axis[0]"),
        ("max_velocity_mm_min = 30000", "max_velocity_mm_s", "axis[0]"),
        ("max_acceleration_g = 0.5", "max_acceleration_g", "axis[0]"),
        ("max_acceleration_g = 0.5", "max_acceleration_mm_s2", "axis[0]"),
        ("max_acceleration_g = 0.5", "max_acceleration_m_s2", "axis[0]"),
        ("max_jerk_m_s3 = 50", "max_jerk_m_s3", "axis[0]"),
        ("max_jerk_m_s3 = 50", "max_jerk_mm_s3", "axis[0]"),
        ("max_velocity_deg_min = 3600", "max_velocity_deg_min", "axis[1]"),
        ("max_velocity_deg_min = 3600", "max_velocity_deg_s", "axis[1]"),
        (
            "max_acceleration_deg_s2 = 100",
            "max_acceleration_deg_s2",
            "axis[1]",
        ),
        ("max_jerk_deg_s3 = 1000", "max_jerk_deg_s3", "axis[1]"),
        ("max_feed_mm_min = 6000", "max_feed_mm_min", "limits"),
        ("max_feed_mm_min = 6000", "max_feed_mm_s", "limits"),
        ("travel_min_mm = -1", "travel_min_mm", "axis[0]"),
        ("home_mm = 1.5", "home_mm", "axis[0]"),
        ("home_mm = 1.5", "following_error_mm", "axis[0]"),
        ("home_mm = 1.5", "following_time_ms", "axis[0]"),
        ("joint_time_ms = 2", "joint_time_ms", "path"),
        ("joint_time_ms = 2", "chord_error_increments", "path"),
        ("joint_time_ms = 2", "min_radius_mm", "path"),
        ("joint_time_ms = 2", "arc_radius_tolerance_mm", "path"),
        ("joint_time_ms = 2", "arc_radius_tolerance_ratio", "path"),
        ("joint_time_ms = 2", "involute_end_tolerance_mm", "path"),
        ("joint_time_ms = 2", "blend_tolerance_mm", "path"),
    ];
    for (line, key, at) in keys {
        for bad in ["nan", "-nan", "inf", "-inf", "1e308", "-1e308", "1e12", "-5"] {
            // A valid start of the travel.
            if (key, bad) == ("travel_min_mm", "-5") {
                continue;
            }
            rejected(
                &[(line, &format!("{key} = {bad}"))],
                &["bad.toml:", &format!("{at}.{key}")],
            );
        }
        // Zero is a valid position and tolerance, but not a valid limit.
        if key.starts_with("max_") {
            rejected(
                &[(line, &format!("{key} = 0"))],
                &["bad.toml:", &format!("{at}.{key}: 0")],
            );
            rejected(
                &[(line, &format!("{key} = 1e-300"))],
                &["bad.toml:", &format!("{at}.{key}: 1e-300")],
            );
        }
    }
}

#[test]
fn letters_are_unique_and_one_axis_is_linear() {
    let axis = &GOOD[GOOD.find("[[axis]]").unwrap()..GOOD.rfind("[[axis]]").unwrap()];
    let twice = format!("{GOOD}\n{axis}");
    let message = Machine::parse(&twice, "m").unwrap_err().to_string();
    assert!(
        message.contains("axis[2].letter: axis X is defined twice"),
        "{message}"
    );
    let rotary = GOOD.replacen(axis, "", 1);
    let message = Machine::parse(&rotary, "m").unwrap_err().to_string();
    assert!(message.contains("none of them linear"), "{message}");
    let none = format!("{}\naxis = []", &GOOD[..GOOD.find("[limits]").unwrap()]);
    assert!(
        Machine::parse(&none, "m")
            .unwrap_err()
            .to_string()
            .contains("axis: 0 axes")
    );
}

#[test]
fn columns_count_characters_and_crlf_is_accepted() {
    let text = "name = \"m\"\r\nkind = \"mill\"\r\n\"größe\" = 1\r\n";
    let message = Machine::parse(text, "m").unwrap_err().to_string();
    assert!(message.contains("m:3:1: größe: unknown field"), "{message}");
    let inline = "axis = [{ letter = \"X\", größe = 1 }]";
    let message = Machine::parse(inline, "m").unwrap_err().to_string();
    assert!(message.starts_with("m:1:"), "{message}");
}

#[test]
fn unreadable_files_are_named() {
    let missing = Machine::load(Path::new("no/such/machine.toml")).unwrap_err();
    assert!(matches!(missing, MachineError::Read { .. }));
    assert!(missing.to_string().contains("no/such/machine.toml"));
    let folder = Machine::load(&config()).unwrap_err();
    assert!(matches!(folder, MachineError::Read { .. }));
    assert!(folder.to_string().contains("it is a folder"), "{folder}");
    let long = "#".repeat((1 << 20) + 1);
    assert!(matches!(
        Machine::parse(&long, "m").unwrap_err(),
        MachineError::TooLong { .. }
    ));
    let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join("long-machine.toml");
    std::fs::write(&file, &long).unwrap();
    assert!(matches!(
        Machine::load(&file).unwrap_err(),
        MachineError::TooLong { .. }
    ));
    // Rejected before it is read: its length is meaningless.
    let zero = Path::new("/dev/zero");
    if zero.exists() {
        let device = Machine::load(zero).unwrap_err();
        assert!(matches!(device, MachineError::Read { .. }));
        let message = device.to_string();
        assert!(
            message.contains("/dev/zero") && message.contains("it is a pipe or a device"),
            "{message}"
        );
    }
}

#[test]
fn deep_nesting_and_long_text_give_an_error() {
    for text in [
        "[".repeat(100_000),
        format!("a = {}", "[".repeat(100_000)),
        "a.".repeat(100_000),
        "{".repeat(1000),
    ] {
        let message = Machine::parse(&text, "m").unwrap_err().to_string();
        assert!(message.len() < 1000, "{} characters", message.len());
    }
    let long = "x".repeat(100_000);
    let texts = [
        format!("name = \"{long}\""),
        format!("{long} = 1"),
        GOOD.replacen("\"m\"", &format!("\"{long}\""), 1),
    ];
    for text in texts {
        let message = Machine::parse(&text, "m").unwrap_err().to_string();
        assert!(message.len() < 1000, "{} characters", message.len());
    }
}

/// Either rejected with a message of one line, or a machine whose numbers are all valid.
fn valid_or_rejected(text: &str) -> Result<(), TestCaseError> {
    match Machine::parse(text, "m") {
        Err(error) => {
            let message = error.to_string();
            prop_assert!(message.starts_with("m:") && !message.contains('\n'), "{message}");
        }
        Ok(machine) => {
            for axis in &machine.axes {
                prop_assert!(axis.travel_min < axis.travel_max && axis.travel_max - axis.travel_min < 1e10);
                for limit in [axis.max_velocity, axis.max_acceleration, axis.max_jerk] {
                    prop_assert!(limit > 0.0 && limit <= 1.001e9);
                }
            }
            prop_assert!(machine.period_ns(machine.rate).is_ok());
        }
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1500, ..ProptestConfig::default() })]

    #[test]
    fn damaged_files_never_panic(
        cut in any::<prop::sample::Index>(),
        at in any::<prop::sample::Index>(),
        put in prop_oneof![
            "[ -~\\n\"=\\[\\]{}.#é\u{0}]{0,6}",
            prop::sample::select(vec!["nan", "inf", "1e308", "-0", "1e-308", "0x", "9223372036854775807", "\"", "'''", "]", "[[axis]]\n", "=", "null", "1979-05-27"])
                .prop_map(str::to_owned),
        ],
        drop in 0_usize..12,
        truncate in any::<bool>(),
    ) {
        let bytes: Vec<char> = GOOD.chars().collect();
        let at = at.index(bytes.len());
        let mut text: String = bytes[..at].iter().collect();
        text.push_str(&put);
        text.extend(&bytes[(at + drop).min(bytes.len())..]);
        if truncate {
            let keep = cut.index(text.chars().count().max(1));
            text = text.chars().take(keep).collect();
        }
        valid_or_rejected(&text)?;
    }

    #[test]
    fn any_value_of_any_key_is_rejected_or_valid(
        line in 0_usize..40,
        value in prop_oneof![
            any::<f64>().prop_map(|x| format!("{x:e}")),
            any::<i64>().prop_map(|x| x.to_string()),
            prop::sample::select(vec!["true", "[]", "{}", "\"\"", "[1]", "\"X\"", "nan", "+inf", "1e400", "00:00:00"]).prop_map(str::to_owned),
        ],
    ) {
        let lines: Vec<_> = GOOD.lines().enumerate().map(|(i, old)| match old.split_once(" = ") {
            Some((key, _)) if i == line % GOOD.lines().count() => format!("{key} = {value}"),
            _ => old.to_owned(),
        }).collect();
        valid_or_rejected(&lines.join("\n"))?;
    }
}

const SIGNALS: &str = r#"
[[input]]
name = "estop-chain"
number = 0

[[input]]
name = "pressure"
kind = "analog"
number = 0
min = 0
max = 10

[[output]]
name = "clamp"
number = 3
safe_on = true
on_end = "safe"

[[output]]
name = "laser"
kind = "analog"
number = 0
min = 0
max = 100
safe_value = 5
on_hold = "safe"

[[spindle]]
max_rpm = 8000

[[spindle]]
number = 1
max_rpm = 60000
reverse = false

[estop]
input = "estop-chain"

[signals]
input_timeout_ms = 50
"#;

#[test]
fn inputs_outputs_spindles_and_estop_are_read() {
    use evolvent_machine::{EstopSettings, OutputRule, SignalKind};
    let machine = Machine::parse(&format!("{GOOD}{SIGNALS}"), "signals.toml").unwrap();
    let signals = &machine.signals;
    assert_eq!((signals.inputs.len(), signals.outputs.len()), (2, 2));
    assert_eq!(signals.input(SignalKind::Digital, 0).unwrap().name, "estop-chain");
    assert_eq!(signals.input(SignalKind::Analog, 0).unwrap().range, [0.0, 10.0]);
    let clamp = signals.output(SignalKind::Digital, 3).unwrap();
    let rules = (clamp.on_hold, clamp.on_stop, clamp.on_end);
    assert_eq!(rules, (OutputRule::Keep, OutputRule::Keep, OutputRule::Safe));
    let laser = signals.output(SignalKind::Analog, 0).unwrap();
    assert_eq!(
        (clamp.safe, laser.safe, laser.on_hold),
        (1.0, 5.0, OutputRule::Safe)
    );
    assert!(signals.output(SignalKind::Digital, 0).is_none());
    assert_eq!(
        signals
            .spindle(1)
            .map(|spindle| (spindle.max_rpm, spindle.reverse)),
        Some((60_000.0, false))
    );
    let chain = EstopSettings {
        input: 0,
        closed: true,
    };
    assert_eq!((signals.estop, signals.input_timeout_s), (Some(chain), 0.05));
    let without = Machine::parse(GOOD, "without.toml").unwrap();
    assert!(without.signals.is_empty() && without.signals.estop.is_none());
}

#[test]
fn invalid_signals_are_rejected_with_advice() {
    let rejected = |from: &str, to: &str, parts: &[&str]| {
        let text = format!("{GOOD}{SIGNALS}");
        assert!(text.contains(from), "no {from:?}");
        let message = Machine::parse(&text.replacen(from, to, 1), "bad.toml")
            .unwrap_err()
            .to_string();
        for part in parts {
            assert!(message.contains(part), "{to:?} gives {message}, without {part}");
        }
    };
    rejected(
        "name = \"clamp\"",
        "name = \"pressure\"",
        &["output[0].name", "input[1] already", "its own name"],
    );
    rejected(
        "name = \"clamp\"",
        "name = \"a b\"",
        &["output[0].name", "1 to 32 letters"],
    );
    rejected("number = 3", "number = 64", &["output[0].number", "0 to 63"]);
    rejected("number = 3", "number = -1", &["output[0].number", "out of range"]);
    rejected(
        "kind = \"analog\"\nnumber = 0\nmin = 0\nmax = 10\n",
        "kind = \"analog\"\nnumber = 16\n",
        &["input[1].number", "0 to 15"],
    );
    rejected(
        "name = \"pressure\"\nkind = \"analog\"",
        "name = \"pressure\"",
        &["input[1]", "digital number 0 is used by input[0]"],
    );
    rejected(
        "safe_on = true",
        "safe_value = 1",
        &["output[0].safe_value", "safe_on"],
    );
    rejected("safe_on = true", "max = 1", &["output[0].max", "no range"]);
    rejected(
        "safe_value = 5",
        "safe_value = 101",
        &["output[1].safe_value", "between min and max"],
    );
    rejected("safe_value = 5", "safe_value = nan", &["output[1].safe_value"]);
    rejected(
        "safe_value = 5",
        "safe_on = true",
        &["output[1].safe_on", "safe_value"],
    );
    rejected("max = 100", "max = 0", &["output[1].max", "above min"]);
    rejected("on_end = \"safe\"", "on_end = \"off\"", &["on_end"]);
    rejected(
        "number = 1\nmax_rpm",
        "number = 0\nmax_rpm",
        &["spindle[1].number", "spindle 0 exists already"],
    );
    rejected(
        "number = 1\nmax_rpm",
        "number = 4\nmax_rpm",
        &["spindle[1].number", "0 to 3"],
    );
    rejected("max_rpm = 8000", "max_rpm = -1", &["spindle[0].max_rpm"]);
    rejected(
        "input = \"estop-chain\"",
        "input = \"chain\"",
        &["estop.input", "no input called \"chain\"", "[[input]]"],
    );
    rejected(
        "input = \"estop-chain\"",
        "input = \"pressure\"",
        &["estop.input", "analog", "digital"],
    );
    rejected(
        "input_timeout_ms = 50",
        "input_timeout_ms = 0",
        &["signals.input_timeout_ms"],
    );
    rejected(
        "input_timeout_ms = 50",
        "input_timeout = 50",
        &["the unit is missing", "input_timeout_ms"],
    );
}

const WHEEL: &str = r#"
[[input]]
name = "counts"
kind = "analog"
number = 5
[[input]]
name = "axis-x"
number = 40
[[input]]
name = "fine"
number = 41
[[input]]
name = "coarse"
number = 42
[handwheel]
counts = "counts"
steps_mm = [0.01, 0.1]
axis_inputs = { x = "axis-x" }
step_inputs = ["fine", "coarse"]
enable_input = "fine"
"#;

#[test]
fn an_invalid_handwheel_is_rejected_with_advice() {
    let text = format!("{GOOD}{WHEEL}");
    let wheel = Machine::parse(&text, "good.toml").unwrap().handwheel.unwrap();
    assert_eq!(
        (wheel.counts, wheel.counts_per_detent, wheel.enable_input),
        (5, 4.0, Some(41))
    );
    assert_eq!(wheel.axis_inputs, [(AxisLetter::X, 40)]);
    assert_eq!(wheel.step_inputs, [41, 42]);
    assert_eq!(wheel.step(AxisLetter::X, 1), Some(0.1));
    // The values in degrees default to those in mm.
    assert_eq!(wheel.step(AxisLetter::A, 0), Some(0.01));
    assert_eq!(wheel.step(AxisLetter::X, 2), None);
    let usual = Machine::parse(
        &text
            .replace("steps_mm = [0.01, 0.1]\n", "")
            .replace("step_inputs", "#"),
        "usual.toml",
    )
    .unwrap()
    .handwheel
    .unwrap();
    assert_eq!(usual.steps_mm, [0.001, 0.01, 0.1]);
    assert!(Machine::parse(GOOD, "without.toml").unwrap().handwheel.is_none());

    let rejected = |from: &str, to: &str, parts: &[&str]| {
        assert!(text.contains(from), "no {from:?}");
        let message = Machine::parse(&text.replacen(from, to, 1), "bad.toml")
            .unwrap_err()
            .to_string();
        for part in parts {
            assert!(message.contains(part), "{to:?} gives {message}, without {part}");
        }
    };
    let counts = "counts = \"counts\"";
    rejected(
        counts,
        "counts = \"fine\"",
        &["handwheel.counts", "digital", "name an analog input"],
    );
    rejected(
        counts,
        "counts = \"wheel\"",
        &["handwheel.counts", "no input called \"wheel\"", "[[input]]"],
    );
    rejected(
        counts,
        "counts = \"counts\"\ncounts_per_detent = 0",
        &["handwheel.counts_per_detent"],
    );
    let steps = "[0.01, 0.1]";
    rejected(steps, "[]", &["handwheel.steps_mm", "0 steps", "1 to 8"]);
    rejected(steps, "[0.01, 11]", &["handwheel.steps_mm[1]"]);
    rejected(steps, "[0.01, nan]", &["handwheel.steps_mm[1]"]);
    rejected(
        steps,
        "[0.01, 0.1, 1]",
        &["handwheel.step_inputs", "2 inputs", "3 steps"],
    );
    rejected(
        steps,
        "[0.01, 0.1]\nsteps_deg = [1]",
        &["handwheel.steps_deg", "1 steps", "as many"],
    );
    rejected(
        "x = \"axis-x\"",
        "q = \"axis-x\"",
        &["handwheel.axis_inputs.q", "no axis \"q\"", "X"],
    );
    rejected(
        "x = \"axis-x\"",
        "x = \"counts\"",
        &["handwheel.axis_inputs.x", "analog", "digital"],
    );
    rejected(
        "[\"fine\", \"coarse\"]",
        "[\"fine\", \"none\"]",
        &["handwheel.step_inputs[1]", "\"none\""],
    );
    rejected(
        "enable_input = \"fine\"",
        "enable_input = \"?\"",
        &["handwheel.enable_input"],
    );
    rejected("enable_input", "button", &["button", "handwheel"]);
}
