//! Case files: shipped files are read, errors are reported with their position, and the shipped schema
//! matches the code.

use evolvent_chatter::{Case, case_schema};
use evolvent_file_tests::{Edit, assert_refused, assert_schema, edit, shipped};

/// To regenerate the file: `EVOLVENT_WRITE_SCHEMA=1 cargo test -p evolvent-chatter schema`.
#[test]
fn the_shipped_schema_is_that_of_the_code() {
    assert_schema("chatter-case.schema.json", &case_schema(), "evolvent-chatter");
}

#[test]
fn bad_files_are_refused_with_line_column_and_key() {
    let speed = "speed_m_min = 60.0";
    assert_refused(
        &shipped("processes/chatter-40x.toml"),
        &[
            edit(speed, "speed_m_min = \"fast\"", "cut.speed_m_min"),
            edit(speed, "speed_m_min = 0", "cut.speed_m_min"),
            edit("beta_deg = 35.0", "beta = 35.0", "beta"),
            edit("law = \"40X-R1\"", "law = \"41X\"", "force.law"),
            edit("mass_kg = 6.0", "mass_kg = -6.0", "mass_kg"),
            // Invalid TOML is reported where the parser fails.
            Edit {
                column: 16,
                ..edit("lead_deg = 60.0", "lead_deg = 60.0.0", "")
            },
        ],
        Case::parse,
    );
}

/// A disturbance followed for a thousand periods of 252 Hz in steps of 132 kHz would take too long.
#[test]
fn axes_with_frequencies_far_apart_are_refused() {
    let text = shipped("processes/chatter-40x.toml");
    let apart = |stiffness: &str| {
        let text = text.replace("30020020.401035063", stiffness);
        Case::parse(&text, "case.toml")
            .map(|_| ())
            .map_err(|error| error.to_string())
    };
    // 99 and 101 times the frequency of the other axis.
    assert_eq!(apart("1.4696e11"), Ok(()));
    let refused = apart("1.5296e11").unwrap_err();
    assert!(
        refused.contains("tool.axis") && refused.contains("a factor of 100"),
        "{refused}"
    );
}
