//! Process files: shipped files are read, errors are reported with their position, and the shipped schema
//! matches the code.

use evolvent_file_tests::{Edit, assert_refused, assert_schema, edit, shipped};
use evolvent_turning::{TurningJob, process_schema};

/// To regenerate the file: `EVOLVENT_WRITE_SCHEMA=1 cargo test -p evolvent-turning schema`.
#[test]
fn the_shipped_schema_is_that_of_the_code() {
    assert_schema("process.schema.json", &process_schema(), "evolvent-turning");
}

#[test]
fn bad_files_are_refused_with_line_column_and_key() {
    let rpm = "spindle_rpm = 500.0";
    let stock = "outline_mm = [[0.0, 10.0], [200.0, 5.0]]";
    assert_refused(
        &shipped("processes/turn-shaft.toml"),
        &[
            edit(rpm, "spindle_rpm = \"fast\"", "cut.spindle_rpm"),
            edit(rpm, "spindle_rpm = 0", "cut.spindle_rpm"),
            edit("length_mm = 200.0", "lenght_mm = 200.0", "lenght_mm"),
            edit("kind = \"longitudinal\"", "kind = \"across\"", "cut.kind"),
            edit("noise = 0.02", "noise = 3", "sensor.noise"),
            // Values that contradict each other: the error names the key to change.
            edit("set_n = 2200.0", "set_n = 3600.0", "load.set_n"),
            edit("permitted_n = 3500.0", "permitted_n = -1.0", "load.permitted_n"),
            edit("min_mm_rev = 0.2 ", "min_mm_rev = 0.8 ", "feed.min_mm_rev"),
            edit("max_mm_rev = 0.7 ", "max_mm_rev = 12.0 ", "feed.max_mm_rev"),
            Edit {
                line: "min_mm_rev",
                ..edit("edge_mm = 12.0", "edge_mm = 3.0", "feed.min_mm_rev")
            },
            edit(
                stock,
                "outline_mm = [[0.0, 10.3], [200.0, 5.0]]",
                "stock.outline_mm",
            ),
            edit(
                stock,
                "outline_mm = [[0.0, 10.0], [200.0, 5.0]]\nrunout_mm = 0.3",
                "with its runout",
            ),
            // Invalid TOML is reported where the parser fails, ...
            Edit {
                column: 15,
                ..edit("set_n = 2200.0", "set_n = 2200.0.0", "")
            },
            // ... and a missing key where its table begins.
            Edit {
                line: "[feed]",
                ..edit("min_mm_rev = 0.2 ", "# ", "min_mm_rev")
            },
        ],
        TurningJob::parse,
    );
}
