//! Files of a machine: tool table and parameter file.

pub(crate) mod parameter_file;
pub(crate) mod store;
pub(crate) mod tools;
