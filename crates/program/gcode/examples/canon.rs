//! Prints the commands of a program, one per line, for `tools/compare-rs274`: `cargo run --release -p
//! evolvent-gcode --example canon -- PROGRAM [TOOL_TABLE]`.

#[path = "../tests/common/canon.rs"]
mod canon;

use std::io::Write as _;

use evolvent_gcode::{MachineFeatures, SPINDLES, Settings, ToolTable};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args_os().skip(1);
    let program = std::path::PathBuf::from(arguments.next().ok_or("name a part program")?);
    let tools = match arguments.next() {
        Some(file) => Some(ToolTable::parse(&std::fs::read_to_string(file)?)?),
        None => None,
    };
    let folder = program
        .parent()
        .map(std::path::Path::to_path_buf)
        .unwrap_or_default();
    let settings = Settings {
        tools,
        subroutine_folders: vec![folder],
        block_delete: false,
        features: MachineFeatures {
            user_codes: (100..200).collect(),
            spindles: [true; SPINDLES],
            ..MachineFeatures::default()
        },
        ..Settings::default()
    };
    let reader = std::io::BufReader::new(std::fs::File::open(&program)?);
    let mut out = std::io::BufWriter::new(std::io::stdout().lock());
    for line in canon::canon(reader, settings) {
        writeln!(out, "{line}")?;
    }
    Ok(())
}
