//! Programs interpreted to their end.

use evolvent_gcode::{CanonicalCommand, Diagnostic, Interpreter, Settings};

/// Commands and errors of a program.
pub(crate) fn interpret(program: &str, settings: Settings) -> (Vec<CanonicalCommand>, Vec<Diagnostic>) {
    let (mut commands, mut errors) = (Vec::new(), Vec::new());
    for command in Interpreter::new(program.as_bytes(), settings) {
        match command {
            Ok(command) => commands.push(command),
            Err(error) => errors.push(error),
        }
    }
    (commands, errors)
}

/// The errors of a program.
pub(crate) fn errors(program: &str) -> Vec<Diagnostic> {
    interpret(program, Settings::default()).1
}
