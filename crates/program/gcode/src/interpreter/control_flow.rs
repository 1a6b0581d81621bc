//! What decides which line is next.

use crate::interpreter::o_words::{Definition, Frame, Skip};
use crate::parameters::names::Names;
use crate::syntax::lines::{Library, Lines};

/// What decides which line is next: subroutines, loops and branches.
pub(crate) struct ControlFlow {
    /// Whether a subroutine has started or ended since [`CurrentLine::place`] was recorded.
    pub(crate) has_moved: bool,
    /// Lines of the program that may be needed again, and whether the present line is among them.
    pub(crate) tape: Lines,
    pub(crate) on_tape: bool,
    /// The program, and on top of it the active subroutines.
    pub(crate) frames: Vec<Frame>,
    pub(crate) skip: Option<Skip>,
    pub(crate) definition: Option<Definition>,
    pub(crate) library: Library,
    pub(crate) labels: Names,
    /// Values after an O-word.
    pub(crate) arguments: Vec<f64>,
}

impl Default for ControlFlow {
    fn default() -> Self {
        Self {
            has_moved: true,
            tape: Lines::default(),
            on_tape: false,
            frames: vec![Frame::default()],
            skip: None,
            definition: None,
            library: Library::default(),
            labels: Names::default(),
            arguments: Vec::new(),
        }
    }
}
