//! A TOML or JSON document with the position of every key, so that every error names it.

use std::ops::Range;

use serde::de::DeserializeOwned;
use toml::de::DeTable;

use crate::error::ConfigError;
use crate::position::{Found, byte_of, find_json, find_toml, line_and_column};
use crate::words::{in_plain_words, one_line, plain, shortened, with_plain_numbers};

/// A user-written configuration file, parsed once: TOML, or JSON if the file name ends in `.json`.
///
/// [`ConfigDocument::read`] deserializes it (unknown keys, missing keys and wrong types are errors as far as
/// the type requires). [`ConfigDocument::number`] and [`ConfigDocument::error`] serve the checks that follow;
/// both take a dotted key.
#[derive(Debug)]
pub struct ConfigDocument<'a> {
    file: &'a str,
    text: &'a str,
    content: Content<'a>,
}

#[derive(Debug)]
enum Content<'a> {
    Toml(DeTable<'a>, Range<usize>),
    Json,
}

impl<'a> ConfigDocument<'a> {
    /// Parses `text`. `file` is the name in error messages; the ending `.json` selects JSON, anything else
    /// TOML.
    ///
    /// # Errors
    /// [`ConfigError`] with line and column if the text is not valid.
    pub fn parse(text: &'a str, file: &'a str) -> Result<Self, ConfigError> {
        let is_json = std::path::Path::new(file)
            .extension()
            .is_some_and(|extension| extension.eq_ignore_ascii_case("json"));
        if !is_json {
            return Self::toml(text, file);
        }
        serde_json::from_str::<serde::de::IgnoredAny>(text).map_err(|error| ConfigError::Syntax {
            file: file.to_owned(),
            format: "JSON",
            line: error.line(),
            column: error.column(),
            what: one_line(&json_message(&error)),
        })?;
        let content = Content::Json;
        Ok(Self { file, text, content })
    }

    /// Parses TOML, independent of the file name.
    ///
    /// # Errors
    /// [`ConfigError`] with line and column if the text is not valid TOML.
    pub fn toml(text: &'a str, file: &'a str) -> Result<Self, ConfigError> {
        let table = DeTable::parse(text).map_err(|error| {
            let (line, column) = line_and_column(text, error.span().map_or(0, |span| span.start));
            ConfigError::Syntax {
                file: file.to_owned(),
                format: "TOML",
                line,
                column,
                what: one_line(error.message()),
            }
        })?;
        let whole = table.span();
        let content = Content::Toml(table.into_inner(), whole);
        Ok(Self { file, text, content })
    }

    /// The file name for error messages.
    #[must_use]
    pub fn file(&self) -> &'a str {
        self.file
    }

    /// The complete text.
    #[must_use]
    pub fn text(&self) -> &'a str {
        self.text
    }

    /// Deserializes the document.
    ///
    /// # Errors
    /// Errors of serde, with line, column and key.
    pub fn read<T: DeserializeOwned>(&self) -> Result<T, ConfigError> {
        self.read_advised(|_| None)
    }

    /// As [`read`](Self::read), with additional advice on unknown keys. `advice` receives the last part of
    /// the key.
    ///
    /// # Errors
    /// Errors of serde, with line, column and key.
    pub fn read_advised<T: DeserializeOwned>(
        &self,
        on_unknown: impl Fn(&str) -> Option<String>,
    ) -> Result<T, ConfigError> {
        match &self.content {
            Content::Toml(table, whole) => {
                let spanned = toml::Spanned::new(whole.clone(), table.clone());
                serde_path_to_error::deserialize(toml::Deserializer::from(spanned)).map_err(|error| {
                    let path = error.path().to_string();
                    let inner = error.into_inner();
                    self.serde_error(
                        path,
                        inner.span().map(|span| span.start),
                        inner.message(),
                        &on_unknown,
                    )
                })
            }
            Content::Json => {
                let mut deserializer = serde_json::Deserializer::from_str(self.text);
                serde_path_to_error::deserialize(&mut deserializer).map_err(|error| {
                    let path = error.path().to_string();
                    let inner = error.into_inner();
                    let at = byte_of(self.text, inner.line(), inner.column());
                    self.serde_error(path, Some(at), &json_message(&inner), &on_unknown)
                })
            }
        }
    }

    fn serde_error(
        &self,
        mut key: String,
        at: Option<usize>,
        message: &str,
        on_unknown: impl Fn(&str) -> Option<String>,
    ) -> ConfigError {
        let what = in_plain_words(message);
        let advice = if what.starts_with("unknown field") {
            let last = key.rsplit('.').next().unwrap_or(&key);
            on_unknown(last).unwrap_or_else(|| {
                "correct the spelling (the unit belongs to the key), or remove the key".to_owned()
            })
        } else if what.starts_with("missing field") {
            "add this key".to_owned()
        } else {
            "correct the value".to_owned()
        };
        // Serde names the table that lacks a key; users search for the key.
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
        self.error_at(&key, at, what, advice)
    }

    /// Checks that a number is within `min..=max`.
    ///
    /// # Errors
    /// [`ConfigError`] at the position of `key` (dotted, `mode[1].frequency_hz`) if it is not, or is NaN.
    pub fn number(&self, key: &str, value: f64, min: f64, max: f64) -> Result<(), ConfigError> {
        // No range contains NaN.
        if (min..=max).contains(&value) {
            return Ok(());
        }
        let advice = format!("give a number from {} to {}", plain(min), plain(max));
        Err(self.error(key, format!("{} is out of range", plain(value)), advice))
    }

    /// The line of a dotted key, or of the innermost table of it that exists, from 1.
    #[must_use]
    pub fn line(&self, key: &str) -> u32 {
        let (Found::Key(position) | Found::Parent(position)) = self.find(key);
        line_and_column(self.text, position).0 as u32
    }

    fn find(&self, key: &str) -> Found {
        match &self.content {
            Content::Toml(table, whole) => find_toml(table, whole.start, key),
            Content::Json => find_json(self.text, key),
        }
    }

    /// An error at a dotted key, or at the innermost table of it that exists.
    #[must_use]
    pub fn error(&self, key: &str, what: String, advice: impl Into<String>) -> ConfigError {
        self.error_at(key, None, what, advice.into())
    }

    fn error_at(&self, key: &str, at: Option<usize>, what: String, advice: String) -> ConfigError {
        let (what, advice) = (with_plain_numbers(what), with_plain_numbers(advice));
        let position = match (self.find(key), at) {
            (Found::Key(position), _) | (_, Some(position)) | (Found::Parent(position), None) => position,
        };
        let (line, column) = line_and_column(self.text, position);
        let key = if key.is_empty() || key == "." {
            "the file".to_owned()
        } else {
            shortened(key)
        };
        ConfigError::Key {
            file: self.file.to_owned(),
            line,
            column,
            key,
            what,
            advice,
        }
    }
}

/// Splits a message of `serde_json` into text and position, which it appends.
fn json_message(error: &serde_json::Error) -> String {
    let text = error.to_string();
    text.rsplit_once(" at line ")
        .map_or(text.clone(), |(message, _)| message.to_owned())
}
