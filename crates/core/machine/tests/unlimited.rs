//! Unlimited rotary axes.

use evolvent_machine::{Machine, RotaryDirection, UNLIMITED_DEG};
use evolvent_path::AxisLetter;

use crate::common::GOOD;

/// A rotary axis without its travel.
const TABLE: &str = "[[axis]]\nletter = \"C\"\nmax_velocity_deg_s = 360\nmax_acceleration_deg_s2 = 720\n\
                     max_jerk_deg_s3 = 7200\n";

#[test]
fn an_unlimited_axis_needs_no_travel_and_takes_none() {
    let parse = |keys: &str| Machine::parse(&format!("{GOOD}\n{TABLE}{keys}"), "table.toml");
    for (word, way) in [
        ("shorter", RotaryDirection::Shorter),
        ("sign", RotaryDirection::Sign),
    ] {
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
        ("unlimited = \"without end\"".to_owned(), "unlimited"),
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
