//! Traces left by killed runs.

use std::path::Path;

use evolvent_trace::recover_leftovers;

/// Completes the traces that killed runs have left in the folder of `trace`. Returns a message for each.
pub(crate) fn rescue_leftovers(trace: &Path) -> Vec<String> {
    let folder = trace
        .parent()
        .filter(|folder| !folder.as_os_str().is_empty())
        .unwrap_or(Path::new("."));
    // If the folder cannot be read, the recorder reports it when it matters.
    let leftovers = recover_leftovers(folder).unwrap_or_default();
    leftovers
        .into_iter()
        .map(|(part, result)| match result {
            Ok(recovered) => format!(
                "{}: left by a run that was killed, recovered as {}",
                part.display(),
                recovered.path.display()
            ),
            Err(error) => format!("{}: left by a run that was killed: {error}", part.display()),
        })
        .collect()
}
