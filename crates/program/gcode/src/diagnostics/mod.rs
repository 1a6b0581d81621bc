//! Errors with their place, and what other dialects mean.

pub(crate) mod diagnostic;
pub(crate) mod foreign;
pub(crate) mod foreign_line;
pub(crate) mod hints;
pub(crate) mod misread;
