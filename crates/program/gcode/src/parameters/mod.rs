//! Numbered and named parameters, and the values of the system.

pub(crate) mod assumption;
pub(crate) mod foreign_reads;
pub(crate) mod names;
pub(crate) mod system;
pub(crate) mod values;
