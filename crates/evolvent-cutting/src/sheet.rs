//! A TOML or JSON text that knows the place of every key, so that every error can name it.

use std::ops::Range;

use serde::de::DeserializeOwned;
use toml::de::{DeTable, DeValue};

use crate::error::SheetError;

/// The text of a case file, parsed once. TOML, or JSON where the file's name ends in `.json`.
///
/// [`Sheet::read`] makes a type of it (unknown keys, missing keys and wrong kinds are errors where the type says so);
/// [`Sheet::number`] and [`Sheet::error`] are for the checks that follow, with the dotted key of what is wrong.
#[derive(Debug)]
pub struct Sheet<'a> {
    file: &'a str,
    text: &'a str,
    content: Content<'a>,
}

#[derive(Debug)]
enum Content<'a> {
    Toml(DeTable<'a>, Range<usize>),
    Json,
}

impl<'a> Sheet<'a> {
    /// Parses `text`; `file` names it in errors.
    ///
    /// # Errors
    /// Text that is neither.
    pub fn parse(text: &'a str, file: &'a str) -> Result<Self, SheetError> {
        let json = std::path::Path::new(file)
            .extension()
            .is_some_and(|extension| extension.eq_ignore_ascii_case("json"));
        let content = if json {
            serde_json::from_str::<serde::de::IgnoredAny>(text).map_err(|error| SheetError::Syntax {
                file: file.to_owned(),
                format: "JSON",
                line: error.line(),
                column: error.column(),
                what: one_line(&json_message(&error)),
            })?;
            Content::Json
        } else {
            let table = DeTable::parse(text).map_err(|error| {
                let (line, column) = line_and_column(text, error.span().map_or(0, |span| span.start));
                SheetError::Syntax {
                    file: file.to_owned(),
                    format: "TOML",
                    line,
                    column,
                    what: one_line(error.message()),
                }
            })?;
            let whole = table.span();
            Content::Toml(table.into_inner(), whole)
        };
        Ok(Self { file, text, content })
    }

    /// The file's name, as errors give it.
    #[must_use]
    pub fn file(&self) -> &'a str {
        self.file
    }

    /// The text.
    #[must_use]
    pub fn text(&self) -> &'a str {
        self.text
    }

    /// The text as a `T`.
    ///
    /// # Errors
    /// What serde refuses, with place and key.
    pub fn read<T: DeserializeOwned>(&self) -> Result<T, SheetError> {
        match &self.content {
            Content::Toml(table, whole) => {
                let spanned = toml::Spanned::new(whole.clone(), table.clone());
                serde_path_to_error::deserialize(toml::Deserializer::from(spanned)).map_err(|error| {
                    let path = error.path().to_string();
                    let inner = error.into_inner();
                    self.refused(path, inner.span().map(|span| span.start), inner.message())
                })
            }
            Content::Json => {
                let mut deserializer = serde_json::Deserializer::from_str(self.text);
                serde_path_to_error::deserialize(&mut deserializer).map_err(|error| {
                    let path = error.path().to_string();
                    let inner = error.into_inner();
                    let at = byte_of(self.text, inner.line(), inner.column());
                    self.refused(path, Some(at), &json_message(&inner))
                })
            }
        }
    }

    fn refused(&self, mut key: String, at: Option<usize>, message: &str) -> SheetError {
        let what = in_plain_words(message);
        let advice = if what.starts_with("unknown field") {
            "correct the spelling (the unit belongs to the key), or remove the key"
        } else if what.starts_with("missing field") {
            "add this key"
        } else {
            "correct the value"
        };
        // Serde names the table that lacks a key; people look for the key.
        let missing = what
            .strip_prefix("missing field `")
            .and_then(|rest| rest.strip_suffix('`'));
        if let Some(missing) = missing {
            key = if key == "." {
                missing.to_owned()
            } else {
                format!("{key}.{missing}")
            };
        }
        self.error_at(&key, at, what, advice.to_owned())
    }

    /// Refuses a number that is outside `least..=most`, or no number.
    ///
    /// # Errors
    /// With the place of `key` (dotted, `mode[1].frequency_hz`).
    pub fn number(&self, key: &str, value: f64, least: f64, most: f64) -> Result<(), SheetError> {
        // A NaN is in no range.
        if (least..=most).contains(&value) {
            return Ok(());
        }
        let advice = format!("give a number from {} to {}", plain(least), plain(most));
        Err(self.error(key, format!("{} is out of range", plain(value)), advice))
    }

    /// An error at a dotted key, or at the innermost table of it that is there.
    #[must_use]
    pub fn error(&self, key: &str, what: String, advice: impl Into<String>) -> SheetError {
        self.error_at(key, None, what, advice.into())
    }

    fn error_at(&self, key: &str, at: Option<usize>, what: String, advice: String) -> SheetError {
        let (found, whole) = match &self.content {
            Content::Toml(table, whole) => (find_toml(table, whole.start, key), key),
            Content::Json => (find_json(self.text, key), key),
        };
        let place = match (found, at) {
            (Found::Key(place), _) | (_, Some(place)) | (Found::Parent(place), None) => place,
        };
        let (line, column) = line_and_column(self.text, place);
        let key = if whole.is_empty() || whole == "." {
            "the file".to_owned()
        } else {
            shortened(whole, 80)
        };
        SheetError::Key {
            file: self.file.to_owned(),
            line,
            column,
            key,
            what,
            advice,
        }
    }
}

enum Found {
    Key(usize),
    Parent(usize),
}

/// `word` and the index behind it, if there is one.
fn part_of(part: &str) -> (&str, Option<usize>) {
    match part.split_once('[') {
        Some((word, rest)) => (word, rest.trim_end_matches(']').parse().ok()),
        None => (part, None),
    }
}

fn find_toml(table: &DeTable<'_>, whole: usize, key: &str) -> Found {
    let mut parent = whole;
    let mut table = Some(table);
    let mut last = None;
    for part in key.split('.') {
        let (word, index) = part_of(part);
        let Some((name, value)) = table.and_then(|table| table.get_key_value(word)) else {
            return Found::Parent(parent);
        };
        let mut value = value;
        let mut place = name.span().start;
        if let (Some(index), DeValue::Array(array)) = (index, value.get_ref()) {
            let Some(element) = array.get(index) else {
                return Found::Parent(place);
            };
            value = element;
            place = element.span().start;
        }
        table = value.get_ref().as_table();
        parent = place;
        last = Some(place);
    }
    last.map_or(Found::Parent(parent), Found::Key)
}

/// Walks through JSON that is known to be valid.
fn find_json(text: &str, key: &str) -> Found {
    let bytes = text.as_bytes();
    let mut at = skip_space(bytes, 0);
    let mut place = at;
    for part in key.split('.') {
        let (word, index) = part_of(part);
        let Some((name, value)) = member(text, at, word) else {
            return Found::Parent(place);
        };
        (place, at) = (name, value);
        if let Some(index) = index {
            let Some(element) = element(bytes, at, index) else {
                return Found::Parent(place);
            };
            (place, at) = (element, element);
        }
    }
    Found::Key(place)
}

fn skip_space(bytes: &[u8], mut at: usize) -> usize {
    while bytes.get(at).is_some_and(u8::is_ascii_whitespace) {
        at += 1;
    }
    at
}

/// The first byte behind the value that begins at `at`.
fn skip_value(bytes: &[u8], mut at: usize) -> usize {
    let mut depth = 0_usize;
    while let Some(byte) = bytes.get(at) {
        match byte {
            b'"' => {
                at += 1;
                while bytes.get(at).is_some_and(|byte| *byte != b'"') {
                    at += if bytes.get(at) == Some(&b'\\') { 2 } else { 1 };
                }
            }
            b'{' | b'[' => depth += 1,
            b'}' | b']' if depth > 0 => depth -= 1,
            b'}' | b']' | b',' | b':' if depth == 0 => return at,
            _ => {}
        }
        at += 1;
    }
    at
}

fn member(text: &str, at: usize, word: &str) -> Option<(usize, usize)> {
    let bytes = text.as_bytes();
    if bytes.get(at) != Some(&b'{') {
        return None;
    }
    let mut at = skip_space(bytes, at + 1);
    while bytes.get(at) == Some(&b'"') {
        let name = at;
        let end = skip_value(bytes, at);
        let value = skip_space(bytes, end + 1);
        if text
            .get(name..end)
            .is_some_and(|name| name.trim_end().trim_matches('"') == word)
        {
            return Some((name, value));
        }
        at = skip_space(bytes, skip_value(bytes, value) + 1);
    }
    None
}

fn element(bytes: &[u8], at: usize, index: usize) -> Option<usize> {
    if bytes.get(at) != Some(&b'[') {
        return None;
    }
    let mut at = skip_space(bytes, at + 1);
    for _ in 0..index {
        let end = skip_value(bytes, at);
        if bytes.get(end) != Some(&b',') {
            return None;
        }
        at = skip_space(bytes, end + 1);
    }
    (bytes.get(at) != Some(&b']')).then_some(at)
}

fn byte_of(text: &str, line: usize, column: usize) -> usize {
    let start: usize = text
        .split_inclusive('\n')
        .take(line.saturating_sub(1))
        .map(str::len)
        .sum();
    (start + column.saturating_sub(1)).min(text.len())
}

fn line_and_column(text: &str, byte: usize) -> (usize, usize) {
    let before: String = text
        .char_indices()
        .take_while(|(at, _)| *at < byte)
        .map(|(_, c)| c)
        .collect();
    let line = before.matches('\n').count() + 1;
    let column = before.rsplit('\n').next().unwrap_or("").chars().count() + 1;
    (line, column)
}

/// `serde_json` puts the place behind its message; it is told apart here.
fn json_message(error: &serde_json::Error) -> String {
    let text = error.to_string();
    text.rsplit_once(" at line ")
        .map_or(text.clone(), |(message, _)| message.to_owned())
}

/// Serde speaks of Rust's types.
fn in_plain_words(message: &str) -> String {
    let plain = message
        .replace("expected f64", "expected a number")
        .replace("expected i64", "expected a whole number")
        .replace("expected u32", "expected a whole number")
        .replace("expected usize", "expected a whole number")
        .replace(" as i128", "")
        .replace(" as u128", "");
    one_line(&plain)
}

fn one_line(message: &str) -> String {
    let words: Vec<_> = message.split_whitespace().collect();
    shortened(&words.join(" "), 600)
}

fn shortened(text: &str, most_chars: usize) -> String {
    match text.char_indices().nth(most_chars) {
        None => text.to_owned(),
        Some((end, _)) => format!("{}...", &text[..end]),
    }
}

/// A number as people write it: 1e308 stays short.
fn plain(value: f64) -> String {
    let size = value.abs();
    if size != 0.0 && !(1e-4..1e7).contains(&size) && value.is_finite() {
        format!("{value:e}")
    } else {
        format!("{value}")
    }
}
