//! `plan --explain` and `plan --plot` on small programs with known results.

#![expect(clippy::unwrap_used, reason = "a test may fail")]

use std::path::Path;
use std::process::{Command, Output};

const MACHINE: &str = concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/../../../config/machines/bench-3axis.toml"
);

fn plan(folder: &Path, text: &str, more: &[&str]) -> Output {
    std::fs::write(folder.join("part.ngc"), text).unwrap();
    Command::new(env!("CARGO_BIN_EXE_evolvent"))
        .args(["plan", "part.ngc", "--machine", MACHINE])
        .args(more)
        .current_dir(folder)
        .output()
        .unwrap()
}

fn explained(text: &str, line: u32) -> serde_json::Value {
    let folder = tempfile::tempdir().unwrap();
    let output = plan(folder.path(), text, &["--json", "--explain", &line.to_string()]);
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    json["explanation"].clone()
}

fn joined(value: &serde_json::Value) -> String {
    let sentences = value.as_array().unwrap().iter();
    sentences
        .map(|one| one.as_str().unwrap())
        .collect::<Vec<_>>()
        .join("\n")
}

#[test]
fn a_line_without_motion_names_the_nearest_ones() {
    let json = explained("G21\nG1 X1 F600\nM8\n(idle)\nG1 X2\nM2\n", 4);
    assert_eq!(json["text"], "(idle)");
    assert_eq!(json["nearest"], serde_json::json!([2, 5]));
    assert!(json["moves"].as_array().unwrap().is_empty() && json["time_s"] == 0.0);
    let folder = tempfile::tempdir().unwrap();
    let output = plan(folder.path(), "G1 X1 F600\nM2\n", &["--explain", "2"]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(
        text.contains("has no motion; the nearest line with motion is 1"),
        "{text}"
    );
    let output = plan(folder.path(), "G1 X1 F600\nM2\n", &["--explain", "3"]);
    assert_eq!(output.status.code(), Some(2));
}

#[test]
fn a_long_line_is_limited_by_its_feed_word() {
    // 100 mm at 600 mm/min take 10 s; acceleration and deceleration take some hundredths.
    let json = explained("G1 X100 F600\nM2\n", 1);
    assert!((json["time_s"].as_f64().unwrap() - 10.0).abs() < 0.2);
    assert_eq!(json["limited_by"][0][0], "feed word");
    assert!(json["limited_by"][0][1].as_f64().unwrap() > 0.98);
    // A time-optimal plan stays slightly below the feed word.
    assert!((json["most_feed_mm_min"].as_f64().unwrap() - 600.0).abs() < 2.0);
    assert!(joined(&json["advice"]).contains("higher feed word"));
}

/// A threading pass, which the cycle drives synchronously with the spindle, has no block. The lines after it
/// have their own feed words.
#[test]
fn lines_after_threads_use_their_own_feed_words() {
    let folder = tempfile::tempdir().unwrap();
    let lathe = std::fs::read_to_string(Path::new(MACHINE).with_file_name("lathe-2axis.toml")).unwrap();
    let spindle = "\n[[spindle]]\nmax_rpm = 4000\nfeedback = true\nacceleration_rpm_s = 2000\n";
    std::fs::write(folder.path().join("lathe.toml"), lathe + spindle).unwrap();
    let text = "G21 G18 G90 G8 G61\nG0 X50 Z100\nS300 M3\nG33 Z95 K1\nG33 Z90 K1\nG33 Z85 K1\n\
                G1 Z75 F600\nG1 Z65 F60\nG1 Z55 F6000\nG1 Z45 F1200\nM2\n";
    std::fs::write(folder.path().join("thread.ngc"), text).unwrap();
    for line in [7, 8, 10] {
        let output = Command::new(env!("CARGO_BIN_EXE_evolvent"))
            .args([
                "plan",
                "thread.ngc",
                "--machine",
                "lathe.toml",
                "--json",
                "--explain",
            ])
            .arg(line.to_string())
            .current_dir(folder.path())
            .output()
            .unwrap();
        let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        let limited_by = &json["explanation"]["limited_by"][0];
        assert_eq!(limited_by[0], "feed word", "line {line}: {json}");
        assert!(limited_by[1].as_f64().unwrap() > 0.7, "line {line}: {limited_by}");
    }
}

#[test]
fn a_short_rapid_gains_the_cube_root_of_more_jerk() {
    // 1 mm from rest to rest with J alone takes (32 d / J)^(1/3): 86.2 ms, and 68.4 ms with 2 J.
    let json = explained("G0 X1\nM2\n", 1);
    let time = |d: f64, j: f64| (32.0 * d / j).cbrt();
    assert!((json["time_s"].as_f64().unwrap() - time(1.0, 50_000.0)).abs() < 0.003);
    assert_eq!(json["limited_by"][0][0], "X jerk");
    let remedy = &json["remedies"][0];
    assert_eq!(remedy["change"], "twice the jerk of X");
    assert!((remedy["time_s"].as_f64().unwrap() - time(1.0, 100_000.0)).abs() < 0.003);
}

#[test]
fn an_exact_corner_is_named_with_angle_and_next_line() {
    let json = explained("G61 G1 X50 F6000\nG1 X50 Y50\nM2\n", 1);
    let reasons = joined(&json["reasons"]);
    assert!(
        reasons.contains("a corner of 90.0 degrees to line 2, kept exactly (G61)"),
        "{reasons}"
    );
    assert!((json["after"]["corner_degrees"].as_f64().unwrap() - 90.0).abs() < 1e-9);
    assert!(joined(&json["advice"]).contains("G64 P instead of G61"));
    let slow_points = json["places"].as_array().unwrap();
    assert_eq!(slow_points.len(), 2, "rest at both ends");
    assert!((slow_points[1]["position"][0].as_f64().unwrap() - 50.0).abs() < 0.01);
}

#[test]
fn what_the_axes_stand_still_for_is_named() {
    let json = explained("G1 X50 F6000\nG4 P0.5\nG1 X100\nM2\n", 1);
    let reasons = joined(&json["reasons"]);
    assert!(reasons.contains("line 2 is a dwell of 0.5 s"), "{reasons}");
}

#[test]
fn a_tight_arc_is_limited_by_what_its_curvature_costs() {
    // R 1 mm: the jerk v^3/R^2 reaches 50 000 mm/s3 at 36.8 mm/s, the acceleration 2000 mm/s2 at 44.7 mm/s.
    let json = explained("G1 X10 F12000\nG3 X10 Y2 J1\nG1 X0\nM2\n", 2);
    let max_feed_mm_s = json["most_feed_mm_min"].as_f64().unwrap() / 60.0;
    assert!(max_feed_mm_s < 60.0, "{max_feed_mm_s}");
    let slow_points = json["places"].as_array().unwrap();
    let slowest = slow_points
        .iter()
        .min_by(|a, b| {
            a["feed_mm_min"]
                .as_f64()
                .unwrap()
                .total_cmp(&b["feed_mm_min"].as_f64().unwrap())
        })
        .unwrap();
    let radius = slowest["radius_mm"].as_f64().unwrap();
    assert!((0.2..2.0).contains(&radius), "{radius}");
    assert!(!slowest["used"].as_array().unwrap().is_empty());
}

#[test]
fn outputs_never_overwrite_inputs_even_through_links() {
    let folder = tempfile::tempdir().unwrap();
    let text = "G1 X1 F600\nM2\n";
    std::fs::write(folder.path().join("part.ngc"), text).unwrap();
    std::os::unix::fs::symlink("part.ngc", folder.path().join("soft")).unwrap();
    std::fs::hard_link(folder.path().join("part.ngc"), folder.path().join("hard")).unwrap();
    std::os::unix::fs::symlink(MACHINE, folder.path().join("machine")).unwrap();
    for option in ["--plot", "--setpoints"] {
        for name in ["part.ngc", "./part.ngc", "soft", "hard", "machine", MACHINE] {
            let output = Command::new(env!("CARGO_BIN_EXE_evolvent"))
                .args(["plan", "part.ngc", "--machine", MACHINE, option, name])
                .current_dir(folder.path())
                .output()
                .unwrap();
            assert_eq!(output.status.code(), Some(2), "{option} {name}");
        }
    }
    let both = plan(folder.path(), text, &["--plot", "one", "--setpoints", "one"]);
    assert_eq!(both.status.code(), Some(2));
    assert_eq!(std::fs::read_to_string(folder.path().join("hard")).unwrap(), text);
}

#[test]
fn the_picture_names_what_limits_and_shares_add_up() {
    let folder = tempfile::tempdir().unwrap();
    let text = "G1 X100 F600\nG0 X0\nG1 Y20 F6000\nM2\n";
    let output = plan(folder.path(), text, &["--plot", "plan.svg"]);
    assert!(output.status.success());
    let svg = std::fs::read_to_string(folder.path().join("plan.svg")).unwrap();
    let percentages: Vec<f64> = svg
        .lines()
        .filter_map(|line| line.split_once(" % of the time").map(|parts| parts.0))
        .filter_map(|head| head.rsplit_once(": ").and_then(|parts| parts.1.parse().ok()))
        .collect();
    assert!(svg.contains("feed word: ") && svg.contains("X jerk: "));
    assert!(
        (percentages.iter().sum::<f64>() - 100.0).abs() < 1.0,
        "{percentages:?}"
    );
    assert!(!svg.contains("NaN") && !svg.contains("class=\"bad\""));
}
