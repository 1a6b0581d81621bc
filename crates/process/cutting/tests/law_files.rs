//! Law files: errors name file, line and key.

#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

use evolvent_cutting::{LawDefinition, ToolAngles, law_schema};
use evolvent_file_tests::{Edit, assert_refused, assert_schema, edit};
use evolvent_random::Random;

const GOOD: &str = include_str!("../../../../config/laws/40x-r1.toml");

fn refusal(text: &str) -> String {
    LawDefinition::parse(text, "law.toml").unwrap_err().to_string()
}

#[test]
fn every_key_of_a_law_is_required_or_known_optional() {
    assert_eq!(LawDefinition::built_in_names(), ["40X-R1"]);
    assert!(LawDefinition::built_in("50X").is_none());
    for line in GOOD
        .lines()
        .filter(|line| line.contains(" = ") && !line.starts_with('#'))
    {
        let key = line.split(" = ").next().unwrap();
        let without = GOOD.replacen(line, "", 1);
        let optional = ["description", "radial_ratio", "speed_m_min"].contains(&key);
        match LawDefinition::parse(&without, "law.toml") {
            Ok(_) => assert!(optional, "{key}"),
            Err(error) => assert!(!optional && error.to_string().contains(key), "{key}: {error}"),
        }
    }
}

/// To regenerate the file: `EVOLVENT_WRITE_SCHEMA=1 cargo test -p evolvent-cutting schema`.
#[test]
fn the_shipped_schema_is_that_of_the_code() {
    assert_schema("law.schema.json", &law_schema(), "evolvent-cutting");
}

#[test]
fn bad_files_are_refused_with_line_column_and_key() {
    let c = "c = [260.13, 0.8343]";
    let at_table = |edit| Edit {
        line: "[rational]",
        ..edit
    };
    assert_refused(
        GOOD,
        &[
            Edit {
                column: 2,
                ..at_table(edit(c, "c = [260.13, nan]", " rational: "))
            },
            Edit {
                column: 14,
                ..edit(c, "c = [260.13, \"x\"]", " rational.c[1]: ")
            },
            edit(c, "cc = [260.13, 0.8343]", " rational.cc: "),
            at_table(edit("unit_n = 9.80665 ", "#", " rational.unit_n: ")),
            edit("radial_ratio = 0.4", "radial_ratio = -1", " radial_ratio: "),
            Edit {
                line: "speed_m_min",
                ..edit("[10.0, 70.0]", "[70.0, 10.0]", " covered.speed_m_min: ")
            },
            edit("kind = \"rational\"", "kind = \"power\"", " kind: "),
            edit("kind = \"rational\"", "kind = \"cubic\"", " kind: "),
        ],
        LawDefinition::parse,
    );
    let error = refusal("name = = 1\n");
    assert!(
        error.starts_with("law.toml:1:") && error.contains("not valid TOML"),
        "{error}"
    );
}

#[test]
fn power_laws_and_tables_are_read() {
    let tool = ToolAngles {
        rake_deg: 0.0,
        lead_deg: 60.0,
    };
    let power = "name = \"p\"\nkind = \"power\"\n[power]\ncoefficient_n = 2943\nspeed_exponent = -0.15\n\
                 depth_exponent = 1\nfeed_exponent = 0.75\n";
    let law = LawDefinition::parse(power, "p.toml").unwrap().law(tool).unwrap();
    assert_eq!(law.power().unwrap().coefficient_n, 2943.0);
    let table = "name = \"t\"\nkind = \"table\"\n[table]\nspeed_m_min = [10, 50]\ndepth_mm = [1]\n\
                 feed_mm_rev = [0.3]\nforce_n = [[[700, 650]]]\ndepth_exponent = 1\nfeed_exponent = 0.8\n";
    assert!(LawDefinition::parse(table, "t.toml").unwrap().law(tool).is_ok());
    let error = refusal(&table.replace("depth_exponent = 1\n", ""));
    assert!(error.contains("depth_exponent"), "{error}");
    let error = refusal(&table.replace("[10, 50]", "[50, 10]"));
    assert!(error.contains("entry 1 is 10"), "{error}");
}

/// Random damage never panics.
#[test]
fn damaged_files_are_refused_or_read() {
    let mut random = Random::from_state(0x9e37_79b9);
    for _ in 0..2000 {
        let mut bytes = GOOD.as_bytes().to_vec();
        for _ in 0..3 {
            let at = random.below(bytes.len());
            bytes[at] = *random.one_of(b"0.e-]=[\"\n9");
        }
        let text = String::from_utf8_lossy(&bytes);
        let tool = ToolAngles {
            rake_deg: 10.0,
            lead_deg: 60.0,
        };
        for name in ["law.toml", "law.json"] {
            if let Ok(law) = LawDefinition::parse(&text, name) {
                let _ = law.law(tool);
            }
        }
    }
}
