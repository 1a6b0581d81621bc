//! `evolvent trace report`.

use std::io::Write;
use std::path::Path;

use evolvent_config::check_outputs;
use evolvent_inspect::{ReportError, write_report};

use super::{inspect_error, write_error};
use crate::{CommandError, Ending};

pub(super) fn run(file: &Path, output: Option<&Path>, err: &mut dyn Write) -> Result<Ending, CommandError> {
    let output = output.map_or_else(|| file.with_extension("html"), Path::to_path_buf);
    check_outputs([output.as_path()], [(file, "the trace")])?;
    let bytes = write_report(file, &output).map_err(|error| match &error {
        ReportError::Inspect(error) => inspect_error(error),
        ReportError::Write { .. } => CommandError::Failed(error.to_string()),
    })?;
    writeln!(
        err,
        "{}: {:.1} MB, open it in a browser",
        output.display(),
        bytes as f64 * 1e-6
    )
    .map_err(write_error)?;
    Ok(Ending::Clean)
}
