//! Canned cycles: drilling, threading and turning.

pub(crate) mod drilling;
pub(crate) mod fanuc_threads;
pub(crate) mod profile;
pub(crate) mod roughing;
pub(crate) mod threading;
pub(crate) mod turning;
