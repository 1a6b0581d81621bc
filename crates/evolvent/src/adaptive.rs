//! The file of `evolvent run --adaptive`.

use std::path::Path;

use evolvent_cutting::Sheet;
use evolvent_process::{AdaptiveFeed, AdaptiveSettings};
use serde::Deserialize;

use crate::CommandError;

/// Settings as a file gives them, for one tool. Loads are in the unit of the sensor.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct AdaptiveFile {
    set_load: f64,
    overload: f64,
    contact_load: f64,
    feed_exponent: f64,
    factor_min: f64,
    factor_max: f64,
    factor_entry: f64,
    factor_idle: f64,
    turn_ms: f64,
    overload_ms: f64,
    stale_ms: f64,
    slew_up_per_s: f64,
    slew_down_per_s: f64,
}

/// Reads and checks the file.
///
/// # Errors
/// A file that cannot be read, keys that are unknown, missing or make no sense.
pub(crate) fn read(file: &Path, period_ns: u64) -> Result<AdaptiveSettings, CommandError> {
    let usage = |text: String| CommandError::Usage(format!("{}: {text}", file.display()));
    let text = std::fs::read_to_string(file).map_err(|error| usage(error.to_string()))?;
    let name = file.display().to_string();
    let read: AdaptiveFile = Sheet::parse(&text, &name)
        .and_then(|sheet| sheet.read())
        .map_err(|error| CommandError::Usage(error.to_string()))?;
    let settings = AdaptiveSettings {
        set_load: read.set_load,
        feed_exponent: read.feed_exponent,
        factor_min: read.factor_min,
        factor_max: read.factor_max,
        factor_entry: read.factor_entry,
        factor_idle: read.factor_idle,
        contact_load: read.contact_load,
        overload: read.overload,
        overload_s: 1e-3 * read.overload_ms,
        slew_up: read.slew_up_per_s,
        slew_down: read.slew_down_per_s,
        stale_s: 1e-3 * read.stale_ms,
        turn_s: 1e-3 * read.turn_ms,
        period_s: 1e-9 * period_ns as f64,
    };
    AdaptiveFeed::new(settings).map_err(|error| usage(error.to_string()))?;
    Ok(settings)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shipped_file_is_read_and_a_senseless_one_refused() {
        let shipped =
            Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/processes/adaptive-steel.toml");
        let settings = read(&shipped, 1_000_000).unwrap();
        assert_eq!(settings.set_load, 2200.0);
        let text = std::fs::read_to_string(&shipped).unwrap();
        let folder = tempfile::tempdir().unwrap();
        for (from, to, expected) in [
            ("factor_min = 0.3", "factor_min = 0.0", "smallest factor"),
            ("overload = 3300.0", "overload = 2200.0", "overload limit"),
            ("set_load", "load", "load"),
        ] {
            let file = folder.path().join("adaptive.toml");
            std::fs::write(&file, text.replacen(from, to, 1)).unwrap();
            let Err(CommandError::Usage(what)) = read(&file, 1_000_000) else {
                panic!("{to} was taken");
            };
            assert!(what.contains(expected), "{what}");
        }
    }
}
