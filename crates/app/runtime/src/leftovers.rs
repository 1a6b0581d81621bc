//! Traces that killed runs have left.

use std::path::Path;

use evolvent_trace::recover_leftovers;

/// Makes complete traces of what killed runs have left in the folder of `trace`; says what became of each.
pub(crate) fn rescue_leftovers(trace: &Path) -> Vec<String> {
    let folder = trace
        .parent()
        .filter(|folder| !folder.as_os_str().is_empty())
        .unwrap_or(Path::new("."));
    // A folder that cannot be read is told by the recorder, if it matters.
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
