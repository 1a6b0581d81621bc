//! The modal state between blocks, and the settings of the interpreter.

pub(crate) mod machine_state;
pub(crate) mod outputs;
pub(crate) mod rotation;
pub(crate) mod scope;
pub(crate) mod settings;
pub(crate) mod tool_pockets;
