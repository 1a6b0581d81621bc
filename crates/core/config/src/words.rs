//! How what is wrong is told.

/// A message of serde without the names of Rust's types, on one line.
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

/// A message on one line, of at most 600 characters.
pub(crate) fn one_line(message: &str) -> String {
    let words: Vec<_> = message.split_whitespace().collect();
    shortened_to(&words.join(" "), 600)
}

/// At most 80 characters: long text from the file does not belong into a message.
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

/// A number as people write it: 1e308 stays short.
#[must_use]
pub fn plain(value: f64) -> String {
    let size = value.abs();
    if size != 0.0 && !(1e-4..1e7).contains(&size) && value.is_finite() {
        format!("{value:e}")
    } else {
        format!("{value}")
    }
}
