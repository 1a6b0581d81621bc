//! The chosen values and omitted lines of an import.

use serde::Serialize;

/// The chosen values and omitted lines of an import.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Report {
    /// Values of the machine file that the configuration does not contain.
    pub chosen: Vec<Chosen>,
    /// Lines of the configuration without effect on the machine file, in their order.
    pub dropped: Vec<Dropped>,
}

/// A value that the configuration does not contain.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Chosen {
    /// Key of the machine file, and its axis.
    pub key: String,
    /// The value with its reason.
    pub value: String,
}

/// A line that was not carried over.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Dropped {
    /// File of the line.
    pub file: String,
    /// From 1.
    pub line: u32,
    /// Section, without brackets.
    pub section: String,
    /// Key.
    pub key: String,
    /// Value.
    pub value: String,
    /// Why.
    pub reason: String,
}

impl Report {
    pub(crate) fn choose(&mut self, key: impl Into<String>, value: impl Into<String>) {
        self.chosen.push(Chosen {
            key: key.into(),
            value: value.into(),
        });
    }
}
