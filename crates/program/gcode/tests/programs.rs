//! The shipped programs are valid and stay within the travel of their mill.

use std::path::Path;

use evolvent_gcode::{Action, Interpreter, Settings};

#[test]
fn shipped_programs_have_no_errors() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../tests/programs");
    let mut count = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|extension| extension != "ngc") {
            continue;
        }
        count += 1;
        let name = path.display().to_string();
        let reader = std::io::BufReader::new(std::fs::File::open(&path).unwrap());
        let mut moves = 0;
        let mut last = None;
        for item in Interpreter::new(reader, Settings::default()) {
            let command = item.unwrap_or_else(|error| panic!("{}", error.render(&name)));
            if let Action::Move(step) = &command.action {
                moves += 1;
                let (low, high) = step.curve.bounds(0.0, step.curve.domain());
                let inside = |axis: usize, min: f64, max: f64| low[axis] >= min && high[axis] <= max;
                assert!(
                    inside(0, -400.0, 400.0) && inside(1, -250.0, 250.0) && inside(2, -400.0, 100.0),
                    "{name}:{} leaves the travel",
                    command.line
                );
            }
            last = Some(command.action);
        }
        assert!(moves > 5, "{name}");
        assert_eq!(last, Some(Action::ProgramEnd), "{name}");
    }
    assert!(count >= 6, "{count} programs");
}
