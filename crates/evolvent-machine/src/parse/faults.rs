//! Where something wrong stands in a file, and how it is told.

use std::ops::Range;

use toml::de::DeValue;

use super::Check;
use crate::error::MachineError;

impl Check<'_> {
    pub(super) fn error(&self, key: &str, what: String, advice: impl Into<String>) -> MachineError {
        self.error_at(key, None, what, advice.into())
    }

    /// `span` is used where the key itself is not in the file.
    pub(super) fn error_at(
        &self,
        key: &str,
        span: Option<Range<usize>>,
        what: String,
        advice: String,
    ) -> MachineError {
        let found = self.find(key);
        let span = match (found, span) {
            (Found::Key(span), _) => span,
            (_, Some(span)) => span,
            (Found::Parent(span), None) => span,
        };
        let (line, column) = line_and_column(self.text, span.start);
        let key = if key.is_empty() || key == "." {
            "the file".to_owned()
        } else {
            shortened(key)
        };
        MachineError::Key {
            file: self.file.to_owned(),
            line,
            column,
            key,
            what,
            advice,
        }
    }

    /// The place of a dotted key, or of the innermost table that is there.
    fn find(&self, key: &str) -> Found {
        let mut parent = self.whole.clone();
        let mut table = Some(self.table);
        let mut last = None;
        for part in key.split('.') {
            let (word, index) = match part.split_once('[') {
                Some((word, rest)) => (word, rest.trim_end_matches(']').parse::<usize>().ok()),
                None => (part, None),
            };
            let Some((name, value)) = table.and_then(|table| table.get_key_value(word)) else {
                return Found::Parent(parent);
            };
            let mut value = value;
            let mut place = name.span();
            if let (Some(index), DeValue::Array(array)) = (index, value.get_ref()) {
                let Some(element) = array.get(index) else {
                    return Found::Parent(place);
                };
                value = element;
                place = element.span();
            }
            table = value.get_ref().as_table();
            parent = place.clone();
            last = Some(place);
        }
        last.map_or(Found::Parent(parent), Found::Key)
    }
}

enum Found {
    Key(Range<usize>),
    Parent(Range<usize>),
}

/// What to do about something that serde refused.
pub(super) fn advice_for(key: &str, what: &str) -> String {
    let last = key.rsplit('.').next().unwrap_or(key);
    if what.starts_with("unknown field") {
        let unit = match last {
            "max_velocity" => "max_velocity_mm_min or max_velocity_mm_s (rotary: _deg_min or _deg_s)",
            "max_acceleration" => {
                "max_acceleration_mm_s2, max_acceleration_m_s2 or max_acceleration_g (rotary: _deg_s2)"
            }
            "max_jerk" => "max_jerk_mm_s3 or max_jerk_m_s3 (rotary: _deg_s3)",
            "travel_min" => "travel_min_mm (rotary: travel_min_deg)",
            "travel_max" => "travel_max_mm (rotary: travel_max_deg)",
            "home" => "home_mm (rotary: home_deg)",
            "following_error" => "following_error_mm (rotary: following_error_deg)",
            "following_time" => "following_time_ms",
            "feedback_timeout" => "feedback_timeout_ms",
            "enable_timeout" => "enable_timeout_ms",
            "blend_tolerance" => "blend_tolerance_mm",
            "joint_time" => "joint_time_ms",
            "max_feed" => "max_feed_mm_min or max_feed_mm_s",
            _ => return "correct the spelling, or remove the key".to_owned(),
        };
        return format!("the unit is missing: write {unit}");
    }
    if what.starts_with("missing field") {
        return "add this key".to_owned();
    }
    "correct the value".to_owned()
}

pub(super) fn line_and_column(text: &str, byte: usize) -> (usize, usize) {
    let before: String = text
        .char_indices()
        .take_while(|(at, _)| *at < byte)
        .map(|(_, c)| c)
        .collect();
    let line = before.matches('\n').count() + 1;
    let column = before.rsplit('\n').next().unwrap_or("").chars().count() + 1;
    (line, column)
}

/// Serde speaks of Rust's types.
pub(super) fn in_plain_words(message: &str) -> String {
    let plain = message
        .replace("expected f64", "expected a number")
        .replace("expected i64", "expected a whole number")
        .replace(" as i128", "")
        .replace(" as u128", "");
    one_line(&plain)
}

pub(super) fn one_line(message: &str) -> String {
    let words: Vec<_> = message.split_whitespace().collect();
    shortened_to(&words.join(" "), 600)
}

/// Long text from the file does not belong into a message.
pub(super) fn shortened(text: &str) -> String {
    shortened_to(text, 80)
}

fn shortened_to(text: &str, most_chars: usize) -> String {
    match text.char_indices().nth(most_chars) {
        None => text.to_owned(),
        Some((end, _)) => format!("{}...", &text[..end]),
    }
}

/// A number as people write it: 1e308 stays short.
pub(super) fn plain(value: f64) -> String {
    let size = value.abs();
    if size != 0.0 && !(1e-4..1e7).contains(&size) && value.is_finite() {
        format!("{value:e}")
    } else {
        format!("{value}")
    }
}
