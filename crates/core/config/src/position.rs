//! Positions of keys in a text.

use toml::de::{DeTable, DeValue};

/// Position of a dotted key, as a byte offset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Found {
    /// The key exists.
    Key(usize),
    /// The innermost table or key of it that exists.
    Parent(usize),
}

/// Splits a part of a dotted key into the word and its index, if it has one.
fn part_of(part: &str) -> (&str, Option<usize>) {
    match part.split_once('[') {
        Some((word, rest)) => (word, rest.trim_end_matches(']').parse().ok()),
        None => (part, None),
    }
}

/// Finds a dotted key (`mode[1].frequency_hz`) in a table that begins at byte `whole`.
pub(crate) fn find_toml(table: &DeTable<'_>, whole: usize, key: &str) -> Found {
    let mut parent = whole;
    let mut table = Some(table);
    let mut last = None;
    for part in key.split('.') {
        let (word, index) = part_of(part);
        let Some((name, value)) = table.and_then(|table| table.get_key_value(word)) else {
            return Found::Parent(parent);
        };
        let mut value = value;
        let mut position = name.span().start;
        if let (Some(index), DeValue::Array(array)) = (index, value.get_ref()) {
            let Some(element) = array.get(index) else {
                return Found::Parent(position);
            };
            value = element;
            position = element.span().start;
        }
        table = value.get_ref().as_table();
        parent = position;
        last = Some(position);
    }
    last.map_or(Found::Parent(parent), Found::Key)
}

/// Finds a dotted key in valid JSON.
pub(crate) fn find_json(text: &str, key: &str) -> Found {
    let bytes = text.as_bytes();
    let mut at = skip_space(bytes, 0);
    let mut position = at;
    for part in key.split('.') {
        let (word, index) = part_of(part);
        let Some((name, value)) = member(text, at, word) else {
            return Found::Parent(position);
        };
        (position, at) = (name, value);
        if let Some(index) = index {
            let Some(element) = element(bytes, at, index) else {
                return Found::Parent(position);
            };
            (position, at) = (element, element);
        }
    }
    Found::Key(position)
}

fn skip_space(bytes: &[u8], mut at: usize) -> usize {
    while bytes.get(at).is_some_and(u8::is_ascii_whitespace) {
        at += 1;
    }
    at
}

/// The first byte after the value that begins at `at`.
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

pub(crate) fn byte_of(text: &str, line: usize, column: usize) -> usize {
    let start: usize = text
        .split_inclusive('\n')
        .take(line.saturating_sub(1))
        .map(str::len)
        .sum();
    (start + column.saturating_sub(1)).min(text.len())
}

/// Line and column of a byte offset, from 1, the column in characters.
pub(crate) fn line_and_column(text: &str, byte: usize) -> (usize, usize) {
    let before: String = text
        .char_indices()
        .take_while(|(at, _)| *at < byte)
        .map(|(_, c)| c)
        .collect();
    let line = before.matches('\n').count() + 1;
    let column = before.rsplit('\n').next().unwrap_or("").chars().count() + 1;
    (line, column)
}
