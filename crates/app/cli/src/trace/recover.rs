//! `evolvent trace recover`.

use std::io::{self, Write};
use std::path::Path;

use evolvent_config::check_outputs;
use evolvent_trace::{RecoverError, Recovered};
use serde_json::{Value, json};

use super::text::{channels_to_json, write_channels, write_table};
use super::write_error;
use crate::{CommandError, Ending};

pub(super) fn run(
    file: &Path,
    output: Option<&Path>,
    json: bool,
    out: &mut dyn Write,
    err: &mut dyn Write,
) -> Result<Ending, CommandError> {
    if let Some(output) = output {
        check_outputs([output], [(file, "the trace")])?;
    }
    let recovered = evolvent_trace::recover(file, output).map_err(|error| recover_error(&error))?;
    let written = if json {
        writeln!(out, "{}", recovered_to_json(&recovered))
    } else {
        write_recovered(err, &recovered)
    };
    written.map_err(write_error)?;
    Ok(if recovered.lost_data() {
        Ending::Lossy
    } else {
        Ending::Clean
    })
}

fn recover_error(error: &RecoverError) -> CommandError {
    if error.is_wrong_name() {
        CommandError::Usage(error.to_string())
    } else {
        CommandError::Failed(error.to_string())
    }
}

fn write_recovered(out: &mut dyn Write, recovered: &Recovered) -> io::Result<()> {
    let saved = &recovered.statistics;
    let mut rows = vec![
        ("recovered", recovered.source.display().to_string()),
        ("as", recovered.path.display().to_string()),
        (
            "cycles",
            match (saved.first_sequence, saved.last_sequence) {
                (Some(first), Some(last)) => format!("{}, from {first} to {last}", saved.cycles),
                _ => "none".to_owned(),
            },
        ),
        (
            "gaps",
            format!("{}, {} cycles missing", saved.gaps, saved.missing_cycles),
        ),
    ];
    let lost = match (recovered.damaged_places, recovered.bytes_dropped) {
        (0, 0) if recovered.was_complete => "nothing, the file was complete".to_owned(),
        (0, 0) => "nothing, only the index was missing".to_owned(),
        (0, dropped) => format!("{dropped} bytes at the truncated end"),
        (places, dropped) => format!("{dropped} bytes; {places} damaged places before the end"),
    };
    rows.push(("lost", lost));
    if !recovered.has_run {
        rows.push(("run", "unknown: the description of the run was lost".to_owned()));
    }
    write_table(out, &rows)?;
    writeln!(out)?;
    write_channels(out, &recovered.channels)
}

fn recovered_to_json(recovered: &Recovered) -> Value {
    json!({
        "source": recovered.source.display().to_string(),
        "file": recovered.path.display().to_string(),
        "was_complete": recovered.was_complete,
        "lost_data": recovered.lost_data(),
        "channels": channels_to_json(&recovered.channels),
        "cycles": recovered.statistics.cycles,
        "first_sequence": recovered.statistics.first_sequence,
        "last_sequence": recovered.statistics.last_sequence,
        "gaps": recovered.statistics.gaps,
        "missing_cycles": recovered.statistics.missing_cycles,
        "chunks": recovered.chunks,
        "attachments": recovered.attachments,
        "damaged_places": recovered.damaged_places,
        "bytes_dropped": recovered.bytes_dropped,
        "has_run": recovered.has_run,
    })
}
