//! The file of `evolvent run --adaptive`.

use std::path::Path;

use evolvent_turning::AdaptiveSettings;

use crate::CommandError;
use crate::user_file::read_text;

/// Reads and checks the file.
///
/// # Errors
/// A file that cannot be read, keys that are unknown, missing or make no sense.
pub(crate) fn read(file: &Path, period_ns: u64) -> Result<AdaptiveSettings, CommandError> {
    let name = file.display().to_string();
    let text = read_text(file, "adaptive file")?;
    AdaptiveSettings::parse(&text, &name, 1e-9 * period_ns as f64)
        .map_err(|error| CommandError::Usage(error.to_string()))
}
