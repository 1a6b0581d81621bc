//! Characters: case and blanks have no effect, and every error has a position in the line.
#![no_main]

use evolvent_gcode::{Action, Code, Interpreter, Settings};
use libfuzzer_sys::fuzz_target;

/// Result of a line: the end of its move, or its error.
fn run(line: &[u8]) -> Result<Vec<u64>, Code> {
    let mut program = b"G21 F1\n".to_vec();
    program.extend_from_slice(line);
    let mut found = Vec::new();
    for item in Interpreter::new(&program[..], Settings::default()) {
        match item {
            Ok(command) => {
                if let Action::Move(step) = command.action {
                    found.extend(step.curve.end().iter().map(|value| value.to_bits()));
                }
            }
            Err(error) => {
                assert!(error.line == 2 && error.column >= 1);
                assert!(error.source.get(error.span.clone()).is_some());
                assert!(error.help.is_some() && !error.render("a").is_empty());
                return Err(error.code);
            }
        }
    }
    Ok(found)
}

fuzz_target!(|data: &[u8]| {
    // One line; comments and names keep their blanks.
    if data.len() > 200 || data.iter().any(|byte| matches!(byte, b'\n' | b'\r')) {
        return;
    }
    let plain = run(data);
    if data.iter().any(|byte| matches!(byte, b'(' | b';' | b'%' | b'/' | b'<' | b'o' | b'O')) {
        return;
    }
    let mut spread = vec![b' '];
    for byte in data.iter().filter(|byte| !matches!(byte, b' ' | b'\t')) {
        let byte = if byte.is_ascii_lowercase() {
            byte.to_ascii_uppercase()
        } else {
            byte.to_ascii_lowercase()
        };
        spread.extend([byte, b' ', b'\t']);
    }
    assert_eq!(plain, run(&spread), "{:?}", String::from_utf8_lossy(data));
});
