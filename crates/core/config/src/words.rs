//! Wording of error messages.

/// A message of serde on one line, without names of Rust types.
pub(crate) fn in_plain_words(message: &str) -> String {
    let plain = message
        .replace("expected f64", "expected a number")
        .replace("expected i64", "expected a whole number")
        .replace("expected u32", "expected a whole number")
        .replace("expected usize", "expected a whole number")
        .replace(" as i128", "")
        .replace(" as u128", "");
    one_line(&plain)
}

/// Shortens a message to one line of at most 600 characters.
pub(crate) fn one_line(message: &str) -> String {
    let words: Vec<_> = message.split_whitespace().collect();
    shortened_to(&words.join(" "), 600)
}

/// Shortens user text to at most 80 characters for messages.
#[must_use]
pub fn shortened(text: &str) -> String {
    shortened_to(text, 80)
}

fn shortened_to(text: &str, most_chars: usize) -> String {
    match text.char_indices().nth(most_chars) {
        None => text.to_owned(),
        Some((end, _)) => format!("{}...", &text[..end]),
    }
}

/// Formats a number for messages; very large ones stay short (1e308).
#[must_use]
pub fn plain(value: f64) -> String {
    let size = value.abs();
    if size != 0.0 && !(1e-4..1e7).contains(&size) && value.is_finite() {
        format!("{value:e}")
    } else {
        format!("{value}")
    }
}
