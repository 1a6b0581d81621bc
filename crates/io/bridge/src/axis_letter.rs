//! The letter of an axis in the files of bridges.

use evolvent_config::{ConfigDocument, ConfigError};
use evolvent_path::AxisLetter;

/// Reads the letter of an axis; `key` is its key.
///
/// # Errors
/// The text is not one letter of an axis, with its position in the file.
pub fn axis_letter(sheet: &ConfigDocument<'_>, key: &str, text: &str) -> Result<AxisLetter, ConfigError> {
    let mut letters = text.chars();
    match (letters.next().and_then(AxisLetter::from_letter), letters.next()) {
        (Some(letter), None) => Ok(letter),
        _ => Err(sheet.error(
            key,
            format!("`{text}` is not an axis"),
            "give one of X Y Z A B C U V W",
        )),
    }
}
