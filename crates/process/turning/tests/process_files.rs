//! Process files: what ships is read, what is wrong is refused with its place, and the schema is that of the code.

use evolvent_file_tests::{Edit, assert_refused, assert_schema, edit, shipped};
use evolvent_turning::{Job, process_schema};

/// To write the file anew: `EVOLVENT_WRITE_SCHEMA=1 cargo test -p evolvent-turning schema`.
#[test]
fn the_shipped_schema_is_that_of_the_code() {
    assert_schema("process.schema.json", &process_schema(), "evolvent-turning");
}

#[test]
fn bad_files_are_refused_with_line_column_and_key() {
    let rpm = "spindle_rpm = 500.0";
    assert_refused(
        &shipped("processes/turn-shaft.toml"),
        &[
            edit(rpm, "spindle_rpm = \"fast\"", "cut.spindle_rpm"),
            edit(rpm, "spindle_rpm = 0", "cut.spindle_rpm"),
            edit("length_mm = 200.0", "lenght_mm = 200.0", "lenght_mm"),
            edit("kind = \"longitudinal\"", "kind = \"across\"", "cut.kind"),
            edit("noise = 0.02", "noise = 3", "sensor.noise"),
            // What is no TOML is told where it ends to be so, ...
            Edit {
                column: 15,
                ..edit("set_n = 2200.0", "set_n = 2200.0.0", "")
            },
            // ... and what is missing where its table begins.
            Edit {
                line: "[feed]",
                ..edit("min_mm_rev = 0.2 ", "# ", "min_mm_rev")
            },
        ],
        Job::parse,
    );
}
