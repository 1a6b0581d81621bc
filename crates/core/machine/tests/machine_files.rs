//! Machine files: shipped files are valid, and invalid files are rejected with the position of the error.

#![expect(
    clippy::unwrap_used,
    reason = "clippy does not recognise the helpers of these tests as test code"
)]

use std::path::Path;

use evolvent_file_tests::{assert_schema, config};
use evolvent_machine::{
    ControlRate, CycleRecording, Lead, Machine, MachineError, MachineKind, OnFull, PathMode, machine_schema,
};
use evolvent_path::AxisLetter;

use crate::common::{GOOD, rejected};

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
fn shipped_machines_are_valid_and_match_file_names() {
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

/// To regenerate the file: `EVOLVENT_WRITE_SCHEMA=1 cargo test -p evolvent-machine schema`.
#[test]
fn the_shipped_schema_is_that_of_the_code() {
    assert_schema("machine.schema.json", &machine_schema(), "evolvent-machine");
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
        &["bad.toml:9:1: limits.max_feed_mm_s: given twice: max_feed_mm_min"],
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
        &["22:1: axis[0].letter:", "\"Q\" is not an axis"],
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
        &["26:1: axis[0].max_velocity_mm_s: given twice"],
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
        &[("[trace]", "[program]\nstart_unit = \"in\"\n[trace]")],
        &["start_unit", "`mm` or `inch`"],
    );
    rejected(
        &[("[trace]", "[program]\nstart_plane = \"G18\"\n[trace]")],
        &["start_plane", "`xy`, `zx`, `yz`"],
    );
    rejected(
        &[("[trace]", "[program]\nstart_x = \"G7\"\n[trace]")],
        &["start_x", "`radius` or `diameter`"],
    );
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
