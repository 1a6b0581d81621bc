//! Writes `tools/include/evolvent_bus.h` and `tools/python/evolvent_bus.py` from the Rust structs.

use std::path::Path;

fn main() -> std::io::Result<()> {
    let tools = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../tools");
    for (folder, name, text) in [
        ("include", "evolvent_bus.h", evolvent_bus::c_header()),
        ("python", "evolvent_bus.py", evolvent_bus::python_module()),
    ] {
        std::fs::create_dir_all(tools.join(folder))?;
        std::fs::write(tools.join(folder).join(name), text)?;
    }
    Ok(())
}
