//! G and M codes and their modal groups.

pub(crate) mod code;
pub(crate) mod modal_groups;
