//! State that programs use and leave: tools, kept parameters, subroutines.

use std::path::{Path, PathBuf};

use evolvent_gcode::{PersistentParameters, StoreError, ToolTable};
use evolvent_machine::Machine;

/// The state that a program uses and leaves on a machine, with its files.
///
/// Nothing is written automatically: call [`ProgramMemory::save`] when a program has ended.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ProgramMemory {
    /// The tools; `None` without a table.
    pub tools: Option<ToolTable>,
    /// The file of the tool table.
    pub tools_file: Option<PathBuf>,
    /// Offsets and other parameters; `None` if none are kept.
    pub kept: Option<PersistentParameters>,
    /// The file of the parameters.
    pub kept_file: Option<PathBuf>,
    /// Lines that restore the parameters of the last program that are not kept; empty before the first.
    pub volatile: String,
    /// Folders that are searched for subroutines after the program's own.
    pub folders: Vec<PathBuf>,
}

impl ProgramMemory {
    /// Reads the files that the machine file names; relative paths start at its folder.
    ///
    /// # Errors
    /// A file cannot be read or is invalid.
    pub fn of_machine(machine: &Machine, machine_file: &Path) -> Result<Self, StoreError> {
        let folder = machine_file.parent().unwrap_or(Path::new(""));
        let program = &machine.program;
        let mut memory = Self {
            folders: program.subroutines.iter().map(|path| folder.join(path)).collect(),
            ..Self::default()
        };
        if let Some(file) = &program.tool_table {
            memory.load_tools(folder.join(file))?;
        }
        if let Some(file) = &program.parameters {
            memory.load_parameters(folder.join(file))?;
        }
        Ok(memory)
    }

    /// Reads the tools from a file.
    ///
    /// # Errors
    /// The file cannot be read or is invalid.
    pub fn load_tools(&mut self, file: PathBuf) -> Result<(), StoreError> {
        self.tools = Some(ToolTable::load(&file)?);
        self.tools_file = Some(file);
        Ok(())
    }

    /// Reads the parameters from a file, which need not exist yet.
    ///
    /// # Errors
    /// The file cannot be read or is invalid.
    pub fn load_parameters(&mut self, file: PathBuf) -> Result<(), StoreError> {
        self.kept = Some(PersistentParameters::load(&file)?);
        self.kept_file = Some(file);
        Ok(())
    }

    /// Writes what differs from `before`; each file is replaced as a whole. Returns the files written.
    ///
    /// # Errors
    /// The first file that cannot be written.
    pub fn save(&self, before: &Self) -> Result<Vec<PathBuf>, StoreError> {
        let mut written = Vec::new();
        if let (Some(file), Some(tools)) = (&self.tools_file, &self.tools)
            && before.tools.as_ref() != Some(tools)
        {
            tools.save(file)?;
            written.push(file.clone());
        }
        if let (Some(file), Some(kept)) = (&self.kept_file, &self.kept)
            && before.kept.as_ref() != Some(kept)
        {
            kept.save(file)?;
            written.push(file.clone());
        }
        Ok(written)
    }
}
