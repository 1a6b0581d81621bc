//! Numbered and named parameters, and what the system provides.

pub(crate) mod names;
pub(crate) mod system;
pub(crate) mod values;
