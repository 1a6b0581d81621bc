//! The commands of a program file, from its beginning or from a given line.

use std::collections::VecDeque;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use evolvent_config::open_regular;
use evolvent_gcode::{
    Action, CanonicalCommand, Diagnostic, Interpreter, Modal, PersistentParameters, Restart,
};
use evolvent_machine::{Machine, MachineKind, SignalKind, ToolChange};
use evolvent_path::{Axes, AxisLetter};

use crate::job::Setup;
use crate::memory::ProgramMemory;
use crate::refusal::{ProgramError, about_line_with};

/// Maximum number of bytes read at once.
const MAX_READ_AHEAD: u64 = 128 * 1024;

/// How a program starts in the middle; shown before anything moves.
#[derive(Clone, Debug, PartialEq)]
pub struct Start {
    /// The state after the preceding lines.
    pub restart: Restart,
    /// Outputs of the machine that are set before the approach, in this order.
    pub outputs: Vec<String>,
    /// The moves to the starting position, one per line.
    pub approach: Vec<String>,
}

/// The output that an action sets, by its name in the machine file; `None` for other actions.
fn output_text(action: &Action, machine: &Machine) -> Option<String> {
    let name = |kind, index: u32| {
        let named = machine.signals.output(kind, index);
        named.map_or_else(|| index.to_string(), |output| output.name.clone())
    };
    match *action {
        Action::Output { index, on, .. } => {
            let setting = if on { "on" } else { "off" };
            Some(format!("{} {setting}", name(SignalKind::Digital, index)))
        }
        Action::AnalogOutput { index, value, .. } => {
            Some(format!("{} {value}", name(SignalKind::Analog, index)))
        }
        _ => None,
    }
}

/// Interprets a program file on demand. All parts that need the commands of a program use this, so that
/// blocks have the same numbers everywhere.
#[derive(Debug)]
pub struct Commands {
    interpreter: Interpreter<BufReader<File>>,
    first: VecDeque<CanonicalCommand>,
    start: Option<Start>,
}

/// Reads a program with a buffer no larger than needed: blocks of MDI are many and short.
pub(crate) fn reader_of(file: File) -> BufReader<File> {
    let bytes = file
        .metadata()
        .map_or(MAX_READ_AHEAD, |metadata| metadata.len() + 1);
    BufReader::with_capacity(bytes.min(MAX_READ_AHEAD) as usize, file)
}

impl Commands {
    /// Opens a program. If the setup names a start line, the preceding lines are interpreted now, and the
    /// commands begin with the approach.
    ///
    /// # Errors
    /// The file cannot be read, or the program cannot begin at that line.
    pub fn open(program: &Path, setup: &Setup) -> Result<Self, ProgramError> {
        Self::opened(program, setup, None)
    }

    /// Like [`Commands::open`], with loops and subroutines of at most `max_body_bytes`. Another thread can
    /// end it by `interrupt`, since the lines before the start line can take minutes.
    ///
    /// # Errors
    /// As [`Commands::open`]; [`evolvent_gcode::Code::Interrupted`] and
    /// [`evolvent_gcode::Code::BodyTooLong`].
    pub fn open_bounded(
        program: &Path,
        setup: &Setup,
        max_body_bytes: usize,
        interrupt: Arc<AtomicBool>,
    ) -> Result<Self, ProgramError> {
        Self::opened(program, setup, Some((max_body_bytes, interrupt)))
    }

    fn opened(
        program: &Path,
        setup: &Setup,
        bounds: Option<(usize, Arc<AtomicBool>)>,
    ) -> Result<Self, ProgramError> {
        let file = program.display().to_string();
        let opened = open_regular(program).map_err(|source| ProgramError::Read {
            file: file.clone(),
            source,
        })?;
        let mut settings = setup.interpreter_settings_for(program);
        let interrupt = bounds.map(|(max_body_bytes, interrupt)| {
            settings.limits.max_body_bytes = max_body_bytes;
            interrupt
        });
        let mut interpreter = Interpreter::new(reader_of(opened), settings);
        if let Some(interrupt) = interrupt {
            interpreter.set_interrupt(interrupt);
        }
        let mut first = VecDeque::new();
        let mut start = None;
        if let Some(line) = setup.start_line {
            let wrong = |diagnostic| ProgramError::Text {
                file: file.clone(),
                diagnostic,
            };
            let restart = interpreter.start_at(line).map_err(wrong)?;
            if setup.machine.program.tool_change == ToolChange::Subroutine
                && let Some(Action::ChangeTool(tool)) = restart.actions.first()
            {
                let message = format!(
                    "line {line} is reached with tool {tool}, and tool {} is in the spindle",
                    setup.tool
                );
                let help = format!("change to it first, by MDI: T{tool} M6");
                return Err(wrong(Box::new(about_line_with(
                    message,
                    Some(help),
                    program,
                    line,
                ))));
            }
            let axis = match setup.machine.kind {
                MachineKind::Lathe => AxisLetter::X,
                MachineKind::Mill => AxisLetter::Z,
            };
            let from = setup.start();
            // At the end of its travel the tool is as far from the workpiece as possible.
            let clear = setup
                .machine
                .axis(axis)
                .map_or(from[axis.index()], |axis| axis.travel_max);
            let approach = restart.approach(&from, axis, clear).map_err(wrong)?;
            first.extend(approach.commands);
            // A start at a later piece of a thread is rejected before anything moves.
            if interpreter.starts_after_thread() {
                match interpreter.next() {
                    Some(Ok(command)) => first.push_back(command),
                    Some(Err(diagnostic)) => return Err(wrong(Box::new(diagnostic))),
                    None => {}
                }
            }
            let outputs = (restart.actions.iter())
                .filter_map(|action| output_text(action, &setup.machine))
                .collect();
            start = Some(Start {
                restart,
                outputs,
                approach: approach.descriptions,
            });
        }
        Ok(Self {
            interpreter,
            first,
            start,
        })
    }

    /// The start in the middle of the program, if any.
    #[must_use]
    pub fn start(&self) -> Option<&Start> {
        self.start.as_ref()
    }

    /// Sets whether lines that begin with `/` are skipped, from the next line read on.
    pub(crate) fn set_block_delete(&mut self, on: bool) {
        self.interpreter.set_block_delete(on);
    }

    /// Sets the result of an input (M66) before the next command is read.
    pub(crate) fn set_input_result(&mut self, value: f64) {
        self.interpreter.set_input_result(value);
    }

    /// Sets the result of a probing move before the next command is read.
    pub(crate) fn set_probe_result(&mut self, contact: &Axes, stop_position: &Axes, tripped: bool) {
        let _is_position = self.interpreter.set_probe_result(contact, stop_position, tripped);
    }

    /// The last contact of the probe, in program coordinates and units: #5061 to #5069.
    pub(crate) fn probed(&self) -> [f64; 9] {
        std::array::from_fn(|axis| self.interpreter.parameter(5061 + axis as u32))
    }

    /// Number of lines read that begin with `/`: skipped, executed.
    pub(crate) fn block_delete_lines(&self) -> (u64, u64) {
        self.interpreter.block_delete_lines()
    }

    /// Number of subroutine files read.
    pub(crate) fn file_count(&self) -> usize {
        self.interpreter.subroutine_file_count()
    }

    /// Name and text of each subroutine file.
    pub(crate) fn files(&self) -> impl Iterator<Item = (&str, Vec<u8>)> {
        self.interpreter.subroutine_files()
    }

    /// The modes after the last line read.
    #[must_use]
    pub fn modal(&self) -> Modal {
        self.interpreter.modal()
    }

    /// The F word in force after the last line read, and its value in mm/s.
    pub(crate) fn feed_per_minute(&self) -> Option<(f64, f64)> {
        self.interpreter.feed_per_minute()
    }

    /// Lines that restore, in another program, the machine's answers so far, except parameters kept in a
    /// file.
    fn results(&self, kept: Option<&PersistentParameters>) -> String {
        RESULTS
            .into_iter()
            .filter(|number| kept.is_none_or(|kept| kept.get(*number).is_none()))
            .map(|number| (number, self.interpreter.parameter(number)))
            .filter(|(_, value)| *value != 0.0 && value.is_finite())
            .map(|(number, value)| format!("#{number}={value}\n"))
            .collect()
    }

    /// `memory` with the changes that the program has made up to the last line read.
    #[must_use]
    pub fn left(&self, memory: &ProgramMemory) -> ProgramMemory {
        let mut left = memory.clone();
        if let Some(kept) = &mut left.kept {
            kept.update(&self.interpreter);
        }
        left.volatile = match &left.kept {
            Some(kept) => self.interpreter.volatile_parameters(kept),
            None => self
                .interpreter
                .volatile_parameters(&PersistentParameters::default()),
        };
        left.volatile.push_str(&self.results(left.kept.as_ref()));
        if let Some(tools) = self.interpreter.tools() {
            left.tools = Some(tools.clone());
        }
        left
    }
}

/// Parameters with answers of the machine: last contact of the probe and whether it tripped, and the value of
/// an input when a wait (M66) ended.
const RESULTS: [u32; 11] = [5061, 5062, 5063, 5064, 5065, 5066, 5067, 5068, 5069, 5070, 5399];

impl Iterator for Commands {
    type Item = Result<CanonicalCommand, Diagnostic>;

    fn next(&mut self) -> Option<Self::Item> {
        match self.first.pop_front() {
            Some(command) => Some(Ok(command)),
            None => self.interpreter.next(),
        }
    }
}

impl Start {
    /// What the operator must know before the machine moves, in several lines.
    #[must_use]
    pub fn description(&self) -> String {
        use std::fmt::Write as _;
        let restart = &self.restart;
        let mut text = format!(
            "starting at line {}, as after: {}",
            restart.line,
            restart.summary()
        );
        let position = AxisLetter::ALL
            .iter()
            .filter(|axis| restart.position[axis.index()] != 0.0)
            .map(|axis| format!("{}{:.4}", axis.letter(), restart.position[axis.index()]))
            .collect::<Vec<_>>();
        // Writing to a string cannot fail.
        let _ = write!(
            text,
            "\n  the tool is assumed at {} (machine coordinates)",
            if position.is_empty() {
                "zero".to_owned()
            } else {
                position.join(" ")
            }
        );
        if !self.outputs.is_empty() {
            let _ = write!(
                text,
                "\n  outputs before the approach: {}",
                self.outputs.join(", ")
            );
        }
        for step in &self.approach {
            let _ = write!(text, "\n  approach (machine coordinates): {step}");
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use evolvent_machine::Machine;

    use super::*;

    #[test]
    fn a_start_at_a_line_names_the_outputs_that_it_sets() {
        let folder = tempfile::tempdir().unwrap();
        let program = folder.path().join("part.ngc");
        std::fs::write(
            &program,
            "M64 P1\nM62 P0\nG0 X1\nM65 P0\nM68 E0 Q2.5\nG0 X2\nG0 X3\nM2\n",
        )
        .unwrap();
        let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/machines/mill-3axis.toml");
        let outputs = "\n[[output]]\nnumber = 1\nname = \"air\"\n[[output]]\nnumber = 0\nname = \"drawbar\"\n\
             [[output]]\nnumber = 0\nname = \"laser\"\nkind = \"analog\"\n";
        let file = folder.path().join("mill.toml");
        let text = std::fs::read_to_string(shipped).unwrap() + outputs;
        std::fs::write(&file, text).unwrap();
        let machine = Machine::load(&file).unwrap();
        let mut setup = Setup::new(machine, file, String::new(), None).unwrap();
        setup.start_line = Some(7);
        let commands = Commands::open(&program, &setup).unwrap();
        let description = commands.start().unwrap().description();
        assert!(
            description.contains("outputs before the approach: drawbar off, air on, laser 2.5\n"),
            "{description}"
        );
    }

    /// Nothing has moved when the program is opened.
    #[test]
    fn a_start_inside_a_thread_is_refused_on_opening() {
        let folder = tempfile::tempdir().unwrap();
        let program = folder.path().join("part.ngc");
        std::fs::write(&program, "S500 M3\nG0 Z10\nG33 Z5 K1\nG33 Z0 K1\nG0 X9\nM2\n").unwrap();
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/machines/mill-3axis.toml");
        let machine = Machine::load(&file).unwrap();
        let mut setup = Setup::new(machine, file, String::new(), None).unwrap();
        setup.start_line = Some(4);
        let error = Commands::open(&program, &setup).err().unwrap().to_string();
        assert!(
            error.contains("line 4 continues the thread that begins in line 3"),
            "{error}"
        );
        for line in [3, 5] {
            setup.start_line = Some(line);
            let commands: Vec<_> = Commands::open(&program, &setup).unwrap().collect();
            assert!(commands.iter().all(Result::is_ok), "{line}: {commands:?}");
        }
    }

    #[test]
    fn block_delete_applies_from_the_next_line_read() {
        let folder = tempfile::tempdir().unwrap();
        let program = folder.path().join("part.ngc");
        std::fs::write(&program, "G0 X1\n/G0 X2\nG0 X3\n/G0 X4\nG0 X5\n/G0 X6\nM2\n").unwrap();
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/machines/mill-3axis.toml");
        let machine = Machine::load(&file).unwrap();
        let mut setup = Setup::new(machine, file, String::new(), None).unwrap();
        setup.block_delete = true;
        let mut commands = Commands::open(&program, &setup).unwrap();
        let mut positions = Vec::new();
        while let Some(command) = commands.next() {
            if let Action::Move(motion) = command.unwrap().action {
                positions.push(motion.curve.end()[0]);
                commands.set_block_delete(positions.len() != 2);
            }
        }
        assert_eq!(positions, [1.0, 3.0, 4.0, 5.0]);
    }
}
