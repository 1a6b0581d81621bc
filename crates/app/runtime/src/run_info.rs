//! Information in a trace about the run that it records.

use std::collections::BTreeMap;
use std::path::Path;

use evolvent_machine::CycleRecording;
use evolvent_trace::{ProgramSource, RunInfo, configuration_hash};

use crate::job::{Clock, Job, Setup};

/// Names of the attachments with the program's tools and parameters.
const TOOLS: &str = "tools.tbl";
const PARAMETERS: &str = "parameters.var";
/// Prefix of the names of attached tables of screw errors.
pub const TABLES: &str = "tables/";

/// The source of a recording: one program, or a served machine.
pub(crate) enum RunSource<'a> {
    Job(&'a Job),
    Served,
}

pub(crate) fn run_info(setup: &Setup, source: &RunSource<'_>, start_time_ns: u64) -> RunInfo {
    let settings = &setup.machine.realtime;
    let name = |path: &Path| {
        path.file_name()
            .map_or_else(String::new, |name| name.to_string_lossy().into_owned())
    };
    let (program_name, program, clock, mut extra) = match source {
        RunSource::Job(job) => (
            name(&job.program),
            ProgramSource::File(job.program.clone()),
            job.clock,
            // Inputs of the run besides program and machine file, for recomputation.
            BTreeMap::from([
                ("feed_override".to_owned(), job.feed_override.to_string()),
                ("optional_stop".to_owned(), job.optional_stop.to_string()),
                ("planner".to_owned(), setup.machine.path.planner.name().to_owned()),
                ("platform".to_owned(), crate::platform()),
                ("block_delete".to_owned(), setup.block_delete.to_string()),
                ("tool".to_owned(), setup.tool.to_string()),
                ("start_line".to_owned(), setup.start_line.unwrap_or(0).to_string()),
            ]),
        ),
        RunSource::Served => (
            "serve".to_owned(),
            ProgramSource::None,
            Clock::Realtime,
            BTreeMap::from([
                ("served".to_owned(), true.to_string()),
                ("planner".to_owned(), setup.machine.path.planner.name().to_owned()),
                ("platform".to_owned(), crate::platform()),
            ]),
        ),
    };
    if let Some(process) = &setup.process {
        extra.insert("process".to_owned(), process.text().to_owned());
    }
    RunInfo {
        program_name,
        program,
        machine_name: setup.machine.name.clone(),
        machine_file_name: name(&setup.machine_file),
        machine_file: setup.machine_text.clone(),
        tool_table: setup
            .memory
            .tools
            .as_ref()
            .map(|tools| (TOOLS.to_owned(), tools.to_text().into_bytes())),
        parameters: setup
            .memory
            .kept
            .as_ref()
            .map(|kept| (PARAMETERS.to_owned(), kept.to_text().into_bytes())),
        tables: setup
            .machine
            .corrections
            .files
            .iter()
            .map(|file| (format!("{TABLES}{}", file.name.display()), file.bytes.clone()))
            .collect(),
        axes: setup.machine.axes.iter().map(|axis| axis.letter).collect(),
        period_ns: setup.period_ns,
        start_time_ns,
        versions: BTreeMap::from([("evolvent".to_owned(), env!("CARGO_PKG_VERSION").to_owned())]),
        configuration_hash: configuration_hash(&[setup.machine_text.as_bytes()]),
        clock: clock.name().to_owned(),
        real_time: format!(
            "SCHED_FIFO {} asked for, core {:?}, lock memory {}",
            settings.priority, settings.core, settings.lock_memory
        ),
        columns: setup.machine.trace.cycles == CycleRecording::Columns,
        extra,
    }
}
