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

fn shortened_to(text: &str, max_chars: usize) -> String {
    match text.char_indices().nth(max_chars) {
        None => text.to_owned(),
        Some((end, _)) => format!("{}...", &text[..end]),
    }
}

/// Numbers with more digits are formatted by [`plain`]. A double has up to 17 digits, and a file may contain
/// a few more.
const MAX_DIGITS: usize = 24;

/// Shortens long numbers in a message: other crates format the user's numbers with all digits.
pub(crate) fn with_plain_numbers(message: String) -> String {
    if message.len() <= MAX_DIGITS {
        return message;
    }
    let is_digit = |letter: char| letter.is_ascii_digit() || letter == '.';
    let mut text = String::with_capacity(message.len().min(4096));
    let mut rest = message.as_str();
    while let Some(start) = rest.find(is_digit) {
        let (before, from) = rest.split_at(start);
        let (number, after) = from.split_at(from.find(|letter| !is_digit(letter)).unwrap_or(from.len()));
        text.push_str(before);
        // A trailing dot may be the full stop of a sentence.
        let digits = number.trim_end_matches('.');
        match digits.parse() {
            Ok(value) if digits.len() > MAX_DIGITS => {
                text.push_str(&plain(value));
                text.push_str(&number[digits.len()..]);
            }
            _ => text.push_str(number),
        }
        rest = after;
    }
    text.push_str(rest);
    text
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_number_of_a_message_fills_lines() {
        let huge = format!("home is {} and below {}.", 1e300, -2.5e-200);
        assert!(huge.len() > 500, "{huge}");
        assert_eq!(with_plain_numbers(huge), "home is 1e300 and below -2.5e-200.");
        for same in [
            "",
            "...",
            "from 0.1 to 10000.",
            "line 12: 0.30000000000000004",
            "1.2.3",
        ] {
            assert_eq!(with_plain_numbers(same.to_owned()), same);
        }
    }
}
