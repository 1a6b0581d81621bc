//! What programs find and leave: tools, kept parameters, subroutines.

use std::path::{Path, PathBuf};

use evolvent_gcode::{KeptParameters, StoreError, ToolTable};
use evolvent_machine::Machine;

/// What a program finds on the machine, and what it leaves there, with the files behind it.
///
/// Nothing is written by itself: whoever runs programs calls [`ProgramMemory::save`] when they have ended.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ProgramMemory {
    /// The tools; `None` where there is no table.
    pub tools: Option<ToolTable>,
    /// Where the tool table is kept.
    pub tools_file: Option<PathBuf>,
    /// Offsets and other parameters; `None` where nothing is kept.
    pub kept: Option<KeptParameters>,
    /// Where they are kept.
    pub kept_file: Option<PathBuf>,
    /// Lines that set the parameters of the last program again that are not kept; nothing before it.
    pub volatile: String,
    /// Folders of subroutines, after the program's own.
    pub folders: Vec<PathBuf>,
}

impl ProgramMemory {
    /// What the machine file names; its paths are relative to its own folder.
    ///
    /// # Errors
    /// A file that cannot be read or is none.
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

    /// Takes the tools of a file.
    ///
    /// # Errors
    /// The file cannot be read or is none.
    pub fn load_tools(&mut self, file: PathBuf) -> Result<(), StoreError> {
        self.tools = Some(ToolTable::load(&file)?);
        self.tools_file = Some(file);
        Ok(())
    }

    /// Takes the parameters of a file; it need not exist yet.
    ///
    /// # Errors
    /// The file cannot be read or is none.
    pub fn load_parameters(&mut self, file: PathBuf) -> Result<(), StoreError> {
        self.kept = Some(KeptParameters::load(&file)?);
        self.kept_file = Some(file);
        Ok(())
    }

    /// Writes what differs from `before`, each file whole or not at all; says which.
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
