//! The line that is being executed, and its position.

use std::sync::Arc as Shared;

use crate::CallChain;
use crate::syntax::block::Block;
use crate::syntax::statement::Statement;

/// The position of the present line. Recorded when the line is read, because the line itself may leave the
/// subroutine.
#[derive(Clone, Debug, Default)]
pub(crate) struct SourceLocation {
    /// The file, if it is not the program itself.
    pub(crate) file: Option<Shared<str>>,
    pub(crate) calls: CallChain,
    /// Whether no subroutine file is among the calls.
    pub(super) is_of_program: bool,
}

/// The line that is being executed.
#[derive(Default)]
pub(crate) struct CurrentLine {
    pub(crate) block: Block,
    pub(crate) statement: Statement,
    /// Its text, and its number in its file.
    pub(crate) text: Vec<u8>,
    pub(crate) number: u32,
    pub(crate) location: SourceLocation,
    /// Line of the program from which the present subroutine files were called.
    pub(super) calling_line: u32,
}
