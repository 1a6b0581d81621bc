//! Files of adaptive feed: shipped files are read, errors are reported with their position, and the shipped
//! schema matches the code.
#![allow(clippy::unwrap_used, reason = "a test may fail")]

use evolvent_file_tests::{Edit, assert_refused, assert_schema, edit, shipped};
use evolvent_turning::{AdaptiveSettings, adaptive_schema};

const FILE: &str = "processes/adaptive-steel.toml";

/// To regenerate the file: `EVOLVENT_WRITE_SCHEMA=1 cargo test -p evolvent-turning schema`.
#[test]
fn the_shipped_schema_is_that_of_the_code() {
    assert_schema("adaptive.schema.json", &adaptive_schema(), "evolvent-turning");
}

#[test]
fn the_shipped_file_says_what_its_keys_say() {
    let read = AdaptiveSettings::parse(&shipped(FILE), FILE, 0.001).unwrap();
    assert_eq!(
        (read.set_load, read.overload, read.contact_load),
        (2200.0, 3300.0, 110.0)
    );
    assert_eq!(
        (
            read.factor_min,
            read.factor_max,
            read.factor_entry,
            read.factor_idle
        ),
        (0.3, 1.5, 0.8, 1.5)
    );
    assert_eq!(
        (read.turn_s, read.lag_s, read.stale_s, read.overload_s),
        (0.12, 0.01, 0.01, 0.02)
    );
    assert_eq!(
        (
            read.slew_up_per_s,
            read.slew_down_per_s,
            read.edges,
            read.period_s
        ),
        (2.0, 100.0, 1, 0.001)
    );
    assert_eq!(read.feed_exponent, 0.75);
}

#[test]
fn bad_files_are_refused_with_line_column_and_key() {
    let missing = "bad.toml:1:1:";
    assert_refused(
        &shipped(FILE),
        &[
            edit("set_load = 2200.0", "set_load = 0", "set_load: 0 is out of range"),
            edit("feed_exponent = 0.75", "feed_exponent = 4", "feed_exponent"),
            edit("factor_min = 0.3", "factor_min = 0.0", "factor_min"),
            edit("factor_max = 1.5", "factor_max = nan", "factor_max"),
            // Its minimum is given by another key.
            edit(
                "factor_entry = 0.8",
                "factor_entry = 0.2",
                "give a number from 0.3 to 1.5",
            ),
            edit("factor_idle = 1.5", "factor_idle = 2.5", "factor_idle"),
            edit(
                "contact_load = 110.0",
                "contact_load = 1200",
                "give a number from 1e-9 to 1100",
            ),
            edit(
                "overload = 3300.0",
                "overload = 2200.0",
                "give a number from 2222 to",
            ),
            // In the unit of the key.
            edit(
                "overload_ms = 20.0",
                "overload_ms = -1",
                "give a number from 0 to 10000",
            ),
            edit("slew_up_per_s = 2.0", "slew_up_per_s = 0", "slew_up_per_s"),
            edit(
                "slew_down_per_s = 100.0",
                "slew_down_per_s = inf",
                "slew_down_per_s",
            ),
            edit(
                "stale_ms = 10.0",
                "stale_ms = 1001",
                "give a number from 0 to 1000",
            ),
            edit(
                "turn_ms = 120.0",
                "turn_ms = 0.5",
                "give a number from 1 to 60000",
            ),
            edit("lag_ms = 10.0", "lag_ms = 2000.0", "lag_ms: 2000 is out of range"),
            edit("lag_ms = 10.0", "lag = 10.0", "lag"),
            edit("lag_ms = 10.0", "lag_ms = \"long\"", "lag_ms"),
            Edit {
                line: "# edges",
                ..edit("# edges = 1 ", "edges = 0\n#", "edges")
            },
            Edit {
                column: 16,
                ..edit("turn_ms = 120.0", "turn_ms = 120.0.0", "")
            },
        ],
        |text, file| AdaptiveSettings::parse(text, file, 0.001),
    );
    let text = shipped(FILE).replacen("stale_ms = 10.0", "", 1);
    let error = AdaptiveSettings::parse(&text, "bad.toml", 0.001)
        .unwrap_err()
        .to_string();
    assert!(
        error.starts_with(missing) && error.contains("stale_ms"),
        "{error}"
    );
    // The control period comes from the machine.
    let error = AdaptiveSettings::parse(&shipped(FILE), "bad.toml", 0.1)
        .unwrap_err()
        .to_string();
    assert!(
        error.starts_with("bad.toml:") && error.contains("control rate"),
        "{error}"
    );
}
