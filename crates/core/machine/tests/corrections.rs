//! Backlash, tables, squareness and thermal inputs of machine files: valid and invalid input.

#![expect(
    clippy::unwrap_used,
    reason = "clippy does not recognise the helpers of these tests as test code"
)]

use std::io;
use std::path::Path;

use evolvent_machine::{Machine, MachineError};
use evolvent_path::{Axes, Jet};

const HEAD: &str =
    "name = \"m\"\nkind = \"mill\"\nincrements_per_mm = 1000\nincrements_per_degree = 1000\nrate = 1000.0\n";
const X: &str = "[[axis]]\nletter = \"X\"\ntravel_min_mm = -200\ntravel_max_mm = 200\n\
                 max_velocity_mm_s = 100\nmax_acceleration_m_s2 = 2\nmax_jerk_m_s3 = 100\n";
const A: &str = "[[axis]]\nletter = \"A\"\ntravel_min_deg = -200\ntravel_max_deg = 200\n\
                 max_velocity_deg_s = 100\nmax_acceleration_deg_s2 = 2000\nmax_jerk_deg_s3 = 100000\n";
const Y: &str = "[[axis]]\nletter = \"Y\"\ntravel_min_mm = -200\ntravel_max_mm = 200\n\
                 max_velocity_mm_s = 100\nmax_acceleration_m_s2 = 2\nmax_jerk_m_s3 = 100\n";

/// A machine whose axis has these keys; every file that it names has this content.
fn with_table(axis: &str, keys: &str, content: &str) -> Result<Machine, MachineError> {
    let text = format!(
        "{HEAD}{axis}{keys}\n{}",
        if axis.contains("\"X\"") { Y } else { X }
    );
    Machine::parse_with(&text, "folder/m.toml", |_| Ok(content.as_bytes().to_vec()))
}

/// The correction of axis `axis` at a position reached forwards or backwards.
fn correction(machine: &Machine, axis: usize, position: f64, forwards: bool) -> f64 {
    let mut compensation = machine.corrections.design.compensation(0.001, Axes::zeros());
    let mut ideal = Jet::at_rest(Axes::zeros());
    let mut corrected = ideal;
    for away in [if forwards { -1.0 } else { 1.0 }, 0.0] {
        ideal.position[axis] = position + away;
        for _ in 0..2000 {
            corrected = compensation.step(&ideal);
        }
    }
    corrected.position[axis] - position
}

#[track_caller]
fn assert_corrections(machine: &Machine, axis: usize, expected: &[(f64, f64, f64)]) {
    for (position, forward, reverse) in expected {
        for (is, should) in [
            (correction(machine, axis, *position, true), forward),
            (correction(machine, axis, *position, false), reverse),
        ] {
            assert!((is - should).abs() < 1e-12, "at {position}: {is}, not {should}");
        }
    }
}

#[test]
fn tables_of_all_formats_are_read_into_corrections() {
    let csv = "\u{feff}position_mm,forward_error_um,reverse_error_um\r\n-100, 3, -2.5\r\n\r\n# warm\r\n\
               0,0,-5\r\n100,-4,-9\r\n";
    let machine = with_table(X, "screw_table = \"x.csv\"", csv).unwrap();
    let expected = [
        (-100.0, -0.003, 0.0025),
        (0.0, 0.0, 0.005),
        (100.0, 0.004, 0.009),
        // The slopes at the end are 0.0425 and 0.04375 um/mm; half-way the curve has gained 5/12 of 100 mm
        // times the slope, and 1/2 at the end.
        (
            150.0,
            0.004 + 0.004_25 * 5.0 / 12.0,
            0.009 + 0.004_375 * 5.0 / 12.0,
        ),
        (250.0, 0.006_125, 0.011_187_5),
    ];
    assert_corrections(&machine, 0, &expected);
    assert_eq!(machine.corrections.files.len(), 1);
    let json = r#"{"positions_mm": [-100, 0, 100], "forward_errors_um": [3, 0, -4], "reverse_errors_um": [-2.5, -5, -9]}"#;
    assert_corrections(
        &with_table(X, "screw_table = \"x.json\"", json).unwrap(),
        0,
        &expected,
    );
    let one = r#"{"positions_mm": [-100, 0, 100], "errors_um": [3, 0, -4]}"#;
    let machine = with_table(
        X,
        "screw_table = \"t\"\nscrew_table_format = \"json\"\nbacklash_mm = 0.02",
        one,
    );
    assert_corrections(
        &machine.unwrap(),
        0,
        &[(-100.0, 0.007, -0.013), (100.0, 0.014, -0.006)],
    );
    let rotary = "position_deg,error_mdeg\n0,5\n90,-5\n";
    let machine = with_table(A, "screw_table = \"a.csv\"\nbacklash_deg = 0.01", rotary).unwrap();
    assert_corrections(&machine, 3, &[(0.0, 0.0, -0.01), (90.0, 0.01, 0.0)]);
}

/// The example of LinuxCNC's manual, type 0; LinuxCNC adds nominal minus given. In inches it is 25.4 times as
/// much.
#[test]
fn comp_files_have_the_meaning_of_linuxcnc() {
    let absolute = "-1.000 -1.005 -0.995\n0.000 0.002 -0.003\n1.000 1.003 0.998\n";
    let keys = "screw_table = \"x.comp\"\nscrew_table_format = \"linuxcnc-0\"\nscrew_table_unit = \"inch\"";
    let slow = X.replace("max_velocity_mm_s = 100", "max_velocity_mm_s = 10");
    let expected = [
        (-25.4, 0.127, -0.127),
        (0.0, -0.0508, 0.0762),
        (25.4, -0.0762, 0.0508),
    ];
    assert_corrections(&with_table(&slow, keys, absolute).unwrap(), 0, &expected);
    let trims = "-1.000 0.005 -0.005\n0.000 -0.002 0.003\n\n1.000\t-0.003  0.002 and trailing text\n";
    let keys = keys.replace("linuxcnc-0", "linuxcnc-1");
    assert_corrections(&with_table(&slow, &keys, trims).unwrap(), 0, &expected);
    let metric = "-25.4 0.127 -0.127\n0 -0.0508 0.0762\n25.4 -0.0762 0.0508\n";
    let keys = "screw_table = \"x.comp\"\nscrew_table_format = \"linuxcnc-1\"";
    assert_corrections(&with_table(&slow, keys, metric).unwrap(), 0, &expected);
}

#[test]
fn the_planner_gets_reduced_limits() {
    let machine = with_table(X, "backlash_mm = 0.02", "").unwrap();
    let (planned, drives) = (machine.limits(), machine.drive_limits());
    // 8 (B/2)/T^3 is a tenth of the jerk.
    assert!((planned.jerk[0] - 90_000.0).abs() < 1e-6, "{}", planned.jerk[0]);
    assert_eq!(drives.jerk[0], 100_000.0);
    assert_eq!((planned.jerk[1], planned.velocity[1]), (100_000.0, 100.0));
    let plain = with_table(X, "", "").unwrap();
    assert!(plain.corrections.is_none());
    assert_eq!(plain.limits(), plain.drive_limits());
}

#[test]
fn squareness_and_thermal_inputs_are_read() {
    let text = format!(
        "{HEAD}{X}thermal_input = \"growth\"\n{Y}[squareness]\nxy_um_m = -200\n\
         [[input]]\nname = \"growth\"\nnumber = 3\nkind = \"analog\"\n"
    );
    let machine = Machine::parse(&text, "m.toml").unwrap();
    assert_eq!(machine.corrections.thermal_inputs[0], Some(3));
    let mut compensation = machine.corrections.design.compensation(0.001, Axes::zeros());
    let mut ideal = Jet::at_rest(Axes::zeros());
    (ideal.position[0], ideal.position[1]) = (5.0, 100.0);
    assert_eq!(compensation.step(&ideal).position[0], 5.02);
    compensation.set_thermal_offset(0, 0.01);
    let after: Vec<f64> = (0..12_000)
        .map(|_| compensation.step(&ideal).position[0])
        .collect();
    // The default rate is 1 um/s.
    assert!((after[5000] - 5.025).abs() < 1e-4 && (after[11_999] - 5.03).abs() < 1e-9);
}

/// While an axis moves by 100 mm, the tool drifts by the value of the pair's key and by nothing else: the
/// slides compensate it.
#[test]
fn each_pair_of_axes_has_its_own_squareness() {
    let z = Y.replace("\"Y\"", "\"Z\"");
    for (key, moving, drifting) in [("xy_um_m", 1, 0), ("xz_um_m", 2, 0), ("yz_um_m", 2, 1)] {
        let text = format!("{HEAD}{X}{Y}{z}[squareness]\n{key} = 150\n");
        let machine = Machine::parse(&text, "m.toml").unwrap();
        let mut compensation = machine.corrections.design.compensation(0.001, Axes::zeros());
        let mut ideal = Jet::at_rest(Axes::zeros());
        ideal.position[moving] = 100.0;
        let slides = compensation.step(&ideal).position;
        let mut expected = ideal.position;
        expected[drifting] = -0.015;
        assert!((slides - expected).norm() < 1e-12, "{key}: {slides:?}");
    }
}

#[track_caller]
fn rejected(axis: &str, keys: &str, content: &str, parts: &[&str]) {
    let error = with_table(axis, keys, content).unwrap_err().to_string();
    for part in parts {
        assert!(error.contains(part), "{error:?} does not contain {part:?}");
    }
}

#[test]
fn invalid_tables_report_position_and_advice() {
    let csv = "screw_table = \"x.csv\"";
    let head = "position_mm,error_um\n";
    let at = "folder/x.csv:";
    rejected(X, csv, "", &[at, ":1:1:", "empty", "position_mm,error_um"]);
    rejected(
        X,
        csv,
        "x,y\n1,2\n",
        &[
            "folder/x.csv:1:1",
            "not a header",
            "position_mm,forward_error_um,reverse_error_um",
        ],
    );
    rejected(
        X,
        csv,
        "position_deg,error_mdeg\n0,1\n",
        &["folder/x.csv:1:1", "position_mm"],
    );
    rejected(
        X,
        csv,
        &format!("{head}0,1\n10,a\n"),
        &["folder/x.csv:3:4", "error_um", "\"a\" is not a number", "write"],
    );
    rejected(
        X,
        csv,
        &format!("{head}0,1\n10,inf\n"),
        &["folder/x.csv:3:4", "is not a number"],
    );
    rejected(
        X,
        csv,
        &format!("{head}0,1\n10\n"),
        &["folder/x.csv:3:3", "1 numbers instead of 2"],
    );
    rejected(
        X,
        csv,
        &format!("{head}0,1\n10,2,3\n"),
        &["folder/x.csv:3:6", "3 numbers instead of 2"],
    );
    rejected(
        X,
        csv,
        &format!("{head}0,1\n\n0,2\n"),
        &["folder/x.csv:4:1", "not at least", "sort"],
    );
    rejected(
        X,
        csv,
        &format!("{head}0,1\n"),
        &["folder/x.csv:3:1", "2 to 10000 points", "this one has 1"],
    );
    rejected(
        X,
        csv,
        &format!("{head}0,1\n10,20000\n"),
        &["folder/x.csv:3:1", "out of range", "unit"],
    );
    let comp = "screw_table = \"x.comp\"\nscrew_table_format = \"linuxcnc-1\"";
    rejected(
        X,
        comp,
        "0 0 0\n10 0\n",
        &[
            "folder/x.comp:2:5",
            "2 numbers instead of 3",
            "LinuxCNC silently ends",
        ],
    );
    rejected(
        X,
        comp,
        "0 0 0\n  10 0 x\n",
        &["folder/x.comp:2:8", "\"x\" is not a number"],
    );
    rejected(X, comp, "10 0 0\n0 0 0\n", &["folder/x.comp:2:1", "sort"]);
    let json = "screw_table = \"x.json\"";
    rejected(X, json, "{\"positions_mm\": [0, 1", &["folder/x.json:1:", "JSON"]);
    rejected(
        X,
        json,
        "{\"positions_mm\": [0, 10]}",
        &["folder/x.json:1:1", "missing", "errors_um"],
    );
    rejected(
        X,
        json,
        "{\"positions_mm\": [0, 10], \"position\": 1}",
        &["folder/x.json:1:", "unknown field"],
    );
    rejected(
        X,
        json,
        "{\"positions_deg\": [0], \"errors_mdeg\": [0]}",
        &["another kind of axis", "positions_mm"],
    );
    rejected(
        X,
        json,
        "{\"positions_mm\": [0, 10, 5],\n \"errors_um\": [0, 1, 2]}",
        &["folder/x.json:1:26", "positions_mm[2]", "sort"],
    );
    rejected(
        X,
        json,
        "{\"positions_mm\": [0, 10],\n \"errors_um\": [0]}",
        &["folder/x.json:2:", "1 corrections", "as many"],
    );
    rejected(
        X,
        json,
        "{\"positions_mm\": [0, 10],\n \"errors_um\": [0, 1e9]}",
        &["folder/x.json:2:", "errors_um[1]", "unit"],
    );
}

#[test]
fn invalid_keys_are_rejected_with_position_and_advice() {
    let table = "position_mm,error_um\n0,1\n100,2\n";
    let both = "position_mm,forward_error_um,reverse_error_um\n0,1,2\n100,2,3\n";
    rejected(
        X,
        "backlash_mm = -1",
        table,
        &["m.toml:13:1", "axis[0].backlash_mm", "out of range"],
    );
    rejected(
        X,
        "backlash_deg = 1",
        table,
        &["axis[0].backlash_deg", "no such key"],
    );
    rejected(
        A,
        "backlash_mm = 1",
        table,
        &["axis[0].backlash_mm", "no such key"],
    );
    rejected(
        X,
        "backlash = 1",
        table,
        &["m.toml:13:", "unit is missing", "backlash_mm"],
    );
    rejected(
        X,
        "screw_table = \"\"",
        table,
        &["axis[0].screw_table", "not a valid path"],
    );
    rejected(
        X,
        "screw_table = \"x.txt\"",
        table,
        &["axis[0].screw_table", "screw_table_format"],
    );
    rejected(
        X,
        "screw_table_format = \"csv\"",
        table,
        &["screw_table_format", "there is no screw_table"],
    );
    rejected(
        X,
        "screw_table = \"x.csv\"\nscrew_table_unit = \"mm\"",
        table,
        &["screw_table_unit", "name their units"],
    );
    rejected(
        X,
        "screw_table = \"x.csv\"\nbacklash_mm = 0.1",
        both,
        &["backlash_mm", "both directions"],
    );
    rejected(
        X,
        "thermal_max_mm = 1",
        table,
        &["thermal_max_mm", "there is no thermal_input"],
    );
    rejected(
        X,
        "thermal_input = \"t\"",
        table,
        &["thermal_input", "no analog input", "[[input]]"],
    );
    rejected(
        A,
        "thermal_input = \"t\"",
        table,
        &["thermal_input", "only linear"],
    );
    rejected(
        X,
        "[squareness]\nxy_um_m = 20000",
        table,
        &["squareness.xy_um_m", "out of range"],
    );
    rejected(
        X,
        "[squareness]\nyz_um_m = 1",
        table,
        &["squareness.yz_um_m", "both axes"],
    );
    let rough = "position_mm,error_um\n0,0\n1,15\n2,0\n";
    rejected(
        X,
        "screw_table = \"x.csv\"",
        rough,
        &[
            "axis[0].screw_table",
            "axis X",
            "leave",
            "near",
            "smooth the table",
        ],
    );
    let missing = format!("{HEAD}{X}screw_table = \"x.csv\"\n{Y}");
    let error = Machine::parse_with(&missing, "m.toml", |_: &Path| Err(io::ErrorKind::NotFound.into()));
    let error = error.unwrap_err().to_string();
    assert!(
        error.contains("m.toml:13:1") && error.contains("cannot read \"x.csv\""),
        "{error}"
    );
}

#[test]
fn a_table_is_found_beside_the_machine_file() {
    let folder = std::env::temp_dir().join(format!("evolvent-tables-{}", std::process::id()));
    std::fs::create_dir_all(folder.join("tables")).unwrap();
    let file = folder.join("m.toml");
    std::fs::write(&file, format!("{HEAD}{X}screw_table = \"tables/x.csv\"\n{Y}")).unwrap();
    std::fs::write(folder.join("tables/x.csv"), "position_mm,error_um\n0,1\n100,2\n").unwrap();
    let machine = Machine::load(&file);
    std::fs::remove_dir_all(&folder).unwrap();
    assert_corrections(
        &machine.unwrap(),
        0,
        &[(0.0, -0.001, -0.001), (100.0, -0.002, -0.002)],
    );
}
