//! A trace with its attachments.

use std::io;
use std::path::Path;
use std::sync::Arc;

use evolvent_gcode::{Outputs, PersistentParameters, ToolTable};
use evolvent_machine::{Machine, PlannerKind, ToolChange, WithoutToolTable};
use evolvent_path::AxisMask;
use evolvent_runtime::{ProgramMemory, Setup, TABLES};
use evolvent_trace::{ReadError, RunInfo, TraceFile};
use evolvent_turning::TurningJob;

/// Why a trace cannot be examined.
#[derive(Debug, thiserror::Error)]
pub enum InspectError {
    /// The trace cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The description of the run is missing.
    #[error(
        "{file} has no description of the run; without machine and period its cycles cannot be interpreted"
    )]
    NoRun {
        /// The trace.
        file: String,
    },
    /// An attachment is missing or invalid for this version.
    #[error("{file}: {what}; record with this version, or use the version that recorded it ({version})")]
    Attachment {
        /// The trace.
        file: String,
        /// The error.
        what: String,
        /// The version that recorded it.
        version: String,
    },
    /// The trace has no such job.
    #[error(
        "{file} has no job {job}; its jobs end with number {jobs}, and `evolvent trace report` lists them"
    )]
    NoJob {
        /// The trace.
        file: String,
        /// The number.
        job: u32,
        /// Number of its last job; 0 where it is a run of one program.
        jobs: u32,
    },
    /// Writing or the system failed.
    #[error("{what}: {source}")]
    Io {
        /// The failed step.
        what: String,
        /// Why it failed.
        source: io::Error,
    },
}

/// A complete trace, its run, and its machine.
#[derive(Debug)]
pub struct Opened {
    /// The trace.
    pub trace: TraceFile,
    /// The description of the run.
    pub run: RunInfo,
    /// The machine from the attached machine file, with the planner that was used.
    pub machine: Machine,
    /// The attached program; `None` if there is none.
    pub program: Option<Vec<u8>>,
    /// The machine file's text.
    pub machine_text: String,
}

impl Opened {
    /// Opens a trace and its attachments.
    ///
    /// # Errors
    /// [`InspectError`].
    pub fn open(path: &Path) -> Result<Self, InspectError> {
        let mut trace = TraceFile::open(path)?;
        let file = path.display().to_string();
        let run = trace
            .info()
            .run
            .clone()
            .ok_or_else(|| InspectError::NoRun { file: file.clone() })?;
        let wrong = |what: String| InspectError::Attachment {
            file: file.clone(),
            what,
            version: run.versions.get("evolvent").cloned().unwrap_or_default(),
        };
        let text = trace
            .attachment(&run.machine_file_name)?
            .ok_or_else(|| wrong("its machine file is missing".to_owned()))?;
        let machine_text =
            String::from_utf8(text).map_err(|_| wrong("its machine file is not UTF-8".to_owned()))?;
        let mut machine = Machine::parse_with(&machine_text, &run.machine_file_name, |name| {
            let attached = trace.attachment(&format!("{TABLES}{}", name.display()));
            match attached.map_err(io::Error::other)? {
                Some(bytes) => Ok(bytes),
                None => Err(io::Error::other("it is not attached")),
            }
        })
        .map_err(|error| wrong(error.to_string()))?;
        if let Some(kind) = run
            .extra
            .get("planner")
            .and_then(|name| PlannerKind::from_name(name))
        {
            machine.path.planner = kind;
        }
        let program = if run.program_name.is_empty() {
            None
        } else {
            trace.attachment(&run.program_name)?
        };
        Ok(Self {
            trace,
            run,
            machine,
            program,
            machine_text,
        })
    }

    /// The control period, s.
    #[must_use]
    pub fn period_s(&self) -> f64 {
        self.run.period_ns as f64 * 1e-9
    }

    /// Lines of the program; empty without one.
    #[must_use]
    pub fn program_lines(&self) -> Vec<String> {
        let Some(program) = &self.program else {
            return Vec::new();
        };
        program
            .split(|&byte| byte == b'\n')
            .map(|line| String::from_utf8_lossy(line).trim_end().to_owned())
            .collect()
    }

    /// The machine in its state at the start of the run, with the tools and parameters of the program.
    ///
    /// # Errors
    /// An attachment that this version cannot read.
    pub fn setup(&mut self) -> Result<Setup, InspectError> {
        let file = self.trace.info().path.display().to_string();
        let version = self.run.versions.get("evolvent").cloned().unwrap_or_default();
        let wrong = |what: String| InspectError::Attachment {
            file: file.clone(),
            what,
            version: version.clone(),
        };
        let mut memory = ProgramMemory::default();
        if let Some(bytes) = self.trace.attachment("tools.tbl")? {
            let text = String::from_utf8_lossy(&bytes);
            memory.tools = Some(ToolTable::parse(&text).map_err(|error| wrong(error.to_string()))?);
        }
        if let Some(bytes) = self.trace.attachment("parameters.var")? {
            let text = String::from_utf8_lossy(&bytes);
            memory.kept = Some(PersistentParameters::parse(&text).map_err(|error| wrong(error.to_string()))?);
        }
        let process = match self.run.extra.get("process") {
            Some(text) => {
                let job = TurningJob::parse(text, "the attached process file");
                Some(Arc::new(job.map_err(|error| wrong(error.to_string()))?))
            }
            None => None,
        };
        let mut machine = self.machine.clone();
        let tool = self.run.extra.get("tool").and_then(|tool| tool.parse().ok());
        // Jobs of a served machine have their own initial state.
        if tool.is_none() && !self.run.extra.contains_key("served") {
            before_tool_changes(&mut machine);
        }
        let start_line = self
            .run
            .extra
            .get("start_line")
            .and_then(|line| line.parse().ok());
        Ok(Setup {
            machine,
            machine_file: self.run.machine_file_name.clone().into(),
            machine_text: self.machine_text.clone(),
            period_ns: self.run.period_ns,
            memory,
            start_line: start_line.filter(|&line| line > 0),
            // A program run by `run` starts at home, with spindle and coolant off.
            position: None,
            unhomed: AxisMask::NONE,
            tool: tool.unwrap_or(0),
            selected_tool: None,
            tool_unknown: None,
            log_folder: None,
            outputs: Outputs::default(),
            is_mdi: false,
            restored: evolvent_gcode::MdiPreamble::default(),
            block_delete: self
                .run
                .extra
                .get("block_delete")
                .is_none_or(|text| text == "true"),
            rapid_override: 1.0,
            process,
        })
    }
}

/// Settings of the machine as interpreted by versions that neither waited for tool changes nor required a
/// tool table.
pub fn before_tool_changes(machine: &mut Machine) {
    machine.program.tool_change = ToolChange::None;
    machine.program.without_tool_table = WithoutToolTable::Zero;
}
