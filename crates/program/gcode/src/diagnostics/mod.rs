//! Errors with their position, and the meaning of lines in other dialects.

pub(crate) mod diagnostic;
pub(crate) mod dialect_conflicts;
pub(crate) mod foreign;
pub(crate) mod foreign_codes;
pub(crate) mod foreign_line;
mod foreign_text;
pub(crate) mod hints;
