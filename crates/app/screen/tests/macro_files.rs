//! Files of macros: shipped ones are valid, errors name their position, and the schema matches the code.

use evolvent_file_tests::{assert_refused, assert_schema, edit, shipped};
use evolvent_screen::{macros_schema, parse_macros};

const FILE: &str = "macros/mill.toml";

/// To regenerate the file: `EVOLVENT_WRITE_SCHEMA=1 cargo test -p evolvent-screen schema`.
#[test]
fn the_shipped_schema_is_that_of_the_code() {
    assert_schema("macros.schema.json", &macros_schema(), "evolvent-screen");
}

#[test]
fn the_shipped_file_says_what_its_keys_say() {
    let macros = parse_macros(&shipped(FILE), FILE).unwrap();
    let names: Vec<_> = macros
        .iter()
        .map(|entry| (entry.name.as_str(), entry.confirm))
        .collect();
    assert_eq!(
        names,
        [("Park", false), ("To work zero", true), ("Warm up", true)]
    );
    assert_eq!(macros[2].blocks, ["M3 S3000", "G4 P10", "M5"]);
    assert!(parse_macros("", "empty.toml").unwrap().is_empty());
}

#[test]
fn what_is_wrong_is_told_with_its_place() {
    let good = "[[macro]]\nname = \"Park\"\nblocks = [\"G53 G0 Z0\"]\nconfirm = true\n\n[[macro]]\n\
                name = \"Home\"\nblocks = [\"G28\"]\n";
    let edits = [
        edit("name = \"Park\"", "name = \"\"", "name"),
        edit("name = \"Park\"", "name = \"  \"", "name"),
        edit("name = \"Park\"", "name = \"a\\nb\"", "name"),
        edit("name = \"Park\"", "nam = \"Park\"", "nam"),
        edit("name = \"Home\"", "name = \"Park\"", "name"),
        edit("blocks = [\"G28\"]", "blocks = []", "blocks"),
        edit("blocks = [\"G28\"]", "blocks = [\"G28\", \" \"]", "blocks"),
        edit("blocks = [\"G28\"]", "blocks = [\"G28\\nM30\"]", "blocks"),
    ];
    assert_refused(good, &edits, parse_macros);
    let long = good.replace("G28", &"G1".repeat(600));
    assert!(parse_macros(&long, "long.toml").is_err());
    let many = "[[macro]]\nname = \"N\"\nblocks = [\"M5\"]\n";
    let many: String = (0..61).map(|i| many.replace('N', &format!("N{i}"))).collect();
    assert!(
        parse_macros(&many, "many.toml")
            .unwrap_err()
            .to_string()
            .contains("at most 60")
    );
}
