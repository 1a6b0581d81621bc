//! Options shared by every command with a program.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use clap::Args;
use evolvent_analysis::read_text;
use evolvent_config::{FILE_TIMEOUT, open_regular, within};
use evolvent_gcode::StoreError;
use evolvent_machine::{ControlRate, Machine, PlannerKind};
use evolvent_runtime::{Commands, InputScript, ProgramMemory, Setup, file_stamp};

use crate::CommandError;

/// A program on a machine.
#[derive(Clone, Debug, Args)]
pub(crate) struct ProgramArgs {
    /// The part program (RS274/NGC).
    pub(crate) program: PathBuf,
    /// The machine file (TOML).
    #[arg(long, value_name = "FILE")]
    pub(crate) machine: PathBuf,
    /// Control rate in Hz, or `rational`: as the machine's limits require. Default: the machine file's.
    #[arg(long, value_name = "HZ", value_parser = parse_rate)]
    pub(crate) rate: Option<ControlRate>,
    /// Planner: `optimal` or `classic`. Default: the machine file's.
    #[arg(long, value_name = "NAME", value_parser = parse_planner)]
    pub(crate) planner: Option<PlannerKind>,
    /// Start at this line: shows the modes that the previous lines set, and the approach.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) start_line: Option<u32>,
    /// Tool table in LinuxCNC's format, lengths in mm. Default: the machine file's.
    #[arg(long, value_name = "FILE.tbl")]
    pub(crate) tools: Option<PathBuf>,
    /// Persistent parameters and offsets, in LinuxCNC's format. Default: the machine file's.
    #[arg(long, value_name = "FILE.var")]
    pub(crate) parameters: Option<PathBuf>,
    /// Number of the tool in the spindle at the start: M6 with another one waits for a tool change.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=99_999))]
    pub(crate) tool: u32,
    /// Skip lines that start with `/` (block delete); without this they are executed.
    #[arg(long)]
    pub(crate) block_delete: bool,
    /// Search for subroutines NAME.ngc in this folder too, after the program's own and before the machine
    /// file's.
    #[arg(long, value_name = "FOLDER")]
    pub(crate) subroutines: Vec<PathBuf>,
}

impl ProgramArgs {
    /// Reads and checks the machine file; makes sure that the program exists.
    pub(crate) fn setup(&self) -> Result<Setup, CommandError> {
        let usage = |text: String| CommandError::Usage(text);
        let mut machine = Machine::load(&self.machine).map_err(|error| usage(error.to_string()))?;
        if let Some(planner) = self.planner {
            machine.path.planner = planner;
        }
        let text = read_text(&self.machine, "machine file")?;
        try_program(&self.program)?;
        let mut setup = Setup::new(machine, self.machine.clone(), text, self.rate)
            .map_err(|error| usage(error.to_string()))?;
        setup.memory = self.memory(&setup.machine)?;
        setup.start_line = self.start_line;
        setup.tool = self.tool;
        setup.block_delete = self.block_delete;
        Ok(setup)
    }

    /// The input files and their descriptions; no output may replace one of them. `setup` names those of the
    /// machine file.
    pub(crate) fn inputs<'a>(&'a self, setup: &'a Setup) -> Vec<(&'a Path, &'static str)> {
        let mut inputs = vec![
            (self.program.as_path(), "the program"),
            (self.machine.as_path(), "the machine file"),
        ];
        let tools = setup.memory.tools_file.as_deref();
        inputs.extend(tools.map(|file| (file, "the tool table")));
        let parameters = setup.memory.kept_file.as_deref();
        inputs.extend(parameters.map(|file| (file, "the parameter file")));
        inputs
    }

    /// Settings of programs: those of the machine file, unless the command line overrides them.
    fn memory(&self, machine: &Machine) -> Result<ProgramMemory, CommandError> {
        let usage = |error: StoreError| CommandError::Usage(error.to_string());
        let mut machine = machine.clone();
        if self.tools.is_some() {
            machine.program.tool_table = None;
        }
        if self.parameters.is_some() {
            machine.program.parameters = None;
        }
        let mut memory = ProgramMemory::of_machine(&machine, &self.machine).map_err(usage)?;
        if let Some(file) = &self.tools {
            memory.load_tools(file.clone()).map_err(usage)?;
        }
        if let Some(file) = &self.parameters {
            memory.load_parameters(file.clone()).map_err(usage)?;
        }
        for folder in &self.subroutines {
            if !folder.is_dir() {
                return Err(CommandError::Usage(format!(
                    "{} is not a folder; give a folder of subroutines NAME.ngc",
                    folder.display()
                )));
            }
        }
        memory.folders.splice(0..0, self.subroutines.iter().cloned());
        Ok(memory)
    }

    /// Shows how a program starts in the middle, before anything moves.
    pub(crate) fn tell_start(&self, setup: &Setup, err: &mut dyn Write) -> Result<(), CommandError> {
        if self.start_line.is_none() {
            return Ok(());
        }
        let commands =
            Commands::open(&self.program, setup).map_err(|error| CommandError::Failed(error.to_string()))?;
        if let Some(start) = commands.start() {
            // If standard error is closed, nobody is left to inform.
            drop(writeln!(err, "{}", start.description()));
        }
        Ok(())
    }
}

/// Warns about a machine file: implausible values, and folders that do not exist.
pub(crate) fn warn_of_machine(setup: &Setup, err: &mut dyn Write) {
    warn_of_values(&setup.machine, err);
    for warning in setup.missing_folders() {
        drop(writeln!(err, "warning: {warning}"));
    }
}

/// Warns about implausible values in a machine file. If standard error is closed, nobody is left to inform.
pub(crate) fn warn_of_values(machine: &Machine, err: &mut dyn Write) {
    for warning in &machine.warnings {
        drop(writeln!(err, "warning: {warning}"));
    }
}

/// Makes sure that a program can be opened in time.
///
/// # Errors
/// If it cannot.
fn try_program(file: &Path) -> Result<(), CommandError> {
    let path = file.to_path_buf();
    within(FILE_TIMEOUT, move || open_regular(&path).map(drop)).map_err(|error| {
        CommandError::Usage(format!(
            "{}: {error}; give a readable part program",
            file.display()
        ))
    })
}

pub(crate) fn parse_rate(text: &str) -> Result<ControlRate, String> {
    if text.eq_ignore_ascii_case("rational") {
        return Ok(ControlRate::Rational);
    }
    match text.parse::<f64>() {
        Ok(hz) if hz.is_finite() && hz > 0.0 => Ok(ControlRate::Hz(hz)),
        _ => Err("give a rate in Hz above 0, or `rational`".to_owned()),
    }
}

fn parse_planner(text: &str) -> Result<PlannerKind, String> {
    match text {
        "optimal" => Ok(PlannerKind::Optimal),
        "classic" => Ok(PlannerKind::Classic),
        _ => Err("give `optimal` or `classic`".to_owned()),
    }
}

/// Checks an override in percent and returns the factor.
pub(crate) fn parse_override(text: &str) -> Result<f64, String> {
    match text.trim_end_matches('%').parse::<f64>() {
        // A run that starts at 0 would never move, since nobody could raise the override.
        Ok(percent) if (1.0..=200.0).contains(&percent) => Ok(percent / 100.0),
        _ => Err("give a percentage from 1 to 200".to_owned()),
    }
}

/// Default file of a trace: `traces/NAME-TIME.mcap`, time in UTC.
pub(crate) fn default_trace(program: &Path) -> PathBuf {
    let name = program
        .file_stem()
        .map_or_else(|| "run".into(), |stem| stem.to_string_lossy());
    let stamp = file_stamp(SystemTime::now());
    PathBuf::from("traces").join(format!("{name}-{stamp}.mcap"))
}

/// The inputs of a file for a run with the virtual clock.
pub(crate) fn inputs(file: Option<&Path>, machine: &Machine) -> Result<Option<InputScript>, CommandError> {
    file.map(|file| InputScript::load(file, &machine.signals))
        .transpose()
        .map_err(|error| CommandError::Usage(error.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn overrides_outside_1_to_200_percent_are_refused() {
        assert_eq!(parse_override("150"), Ok(1.5));
        assert_eq!(parse_override("1%"), Ok(0.01));
        for bad in ["-1", "0", "0.9", "200.1", "nan", "inf", "fast", ""] {
            assert!(parse_override(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn rates_are_positive_numbers_or_rational() {
        assert_eq!(parse_rate("Rational"), Ok(ControlRate::Rational));
        assert_eq!(parse_rate("1000"), Ok(ControlRate::Hz(1000.0)));
        for bad in ["0", "-5", "nan", "inf", "quick"] {
            assert!(parse_rate(bad).is_err(), "{bad}");
        }
    }
}
