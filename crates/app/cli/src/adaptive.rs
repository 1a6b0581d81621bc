//! The file of `evolvent run --adaptive`.

use std::path::Path;

use evolvent_turning::AdaptiveSettings;

use crate::CommandError;

/// Reads and checks the file.
///
/// # Errors
/// A file that cannot be read, keys that are unknown, missing or make no sense.
pub(crate) fn read(file: &Path, period_ns: u64) -> Result<AdaptiveSettings, CommandError> {
    let name = file.display().to_string();
    let text =
        std::fs::read_to_string(file).map_err(|error| CommandError::Usage(format!("{name}: {error}")))?;
    AdaptiveSettings::parse(&text, &name, 1e-9 * period_ns as f64)
        .map_err(|error| CommandError::Usage(error.to_string()))
}
