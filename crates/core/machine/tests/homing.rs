//! Homing in machine files.

use evolvent_machine::{HomingMethod, Machine, MachineError};

use crate::common::GOOD;

fn homed(keys: &str) -> Result<Machine, MachineError> {
    Machine::parse(
        &format!("{GOOD}\n[[homing]]\naxis = \"X\"\n{keys}"),
        "homing.toml",
    )
}

#[test]
fn every_homing_method_reads_its_keys() {
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
fn missing_and_unused_homing_keys_are_rejected() {
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
