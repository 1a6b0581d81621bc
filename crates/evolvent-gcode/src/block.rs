//! The syntax tree of one line.

use crate::diagnostic::Span;

/// What a word's value is worked out from. Only literals now; parameters and formulas come in here.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Value {
    /// A number as written.
    Literal(f64),
}

impl Value {
    /// The number. Always finite.
    pub(crate) fn evaluate(self) -> f64 {
        match self {
            Self::Literal(number) => number,
        }
    }
}

/// A letter and its value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Word {
    /// Upper-case ASCII letter.
    pub(crate) letter: u8,
    pub(crate) value: Value,
    /// From the letter to the end of the value.
    pub(crate) span: Span,
}

/// One line. Kept and filled again, so that a line costs no allocation.
#[derive(Debug, Default)]
pub(crate) struct Block {
    /// Words in the order written, without N.
    pub(crate) words: Vec<Word>,
    /// What stands between the parentheses of each comment.
    pub(crate) comments: Vec<Span>,
}

impl Block {
    pub(crate) fn clear(&mut self) {
        self.words.clear();
        self.comments.clear();
    }
}
