//! The contents of one line.

use crate::diagnostics::diagnostic::Span;
use crate::parameters::names::NormalizedName;
use crate::syntax::expression::Target;

/// A letter and its value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Word {
    /// Upper-case ASCII letter, or `@`, `^`, `$`.
    pub(crate) letter: u8,
    pub(crate) value: f64,
    /// From the letter to the end of the value.
    pub(crate) span: Span,
}

/// One line. Reused, so that a line needs no allocation.
#[derive(Debug, Default)]
pub(crate) struct Block {
    /// Words in the order written, without N.
    pub(crate) words: Vec<Word>,
    /// Parameters to be written after the whole line has been read.
    pub(crate) assignments: Vec<(Target, f64)>,
    /// The text between the parentheses of each comment.
    pub(crate) comments: Vec<Span>,
}

impl Block {
    pub(crate) fn clear(&mut self) {
        self.words.clear();
        self.assignments.clear();
        self.comments.clear();
    }
}

/// The name and keyword of a line that starts with O.
pub(crate) struct OWord {
    /// The span of the name, including O.
    pub(crate) span: Span,
    pub(crate) name: NormalizedName,
    pub(crate) keyword: Keyword,
    /// Byte offset of the rest of the line.
    pub(crate) rest: usize,
}

/// Keywords of O-words.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Keyword {
    Sub,
    EndSub,
    Return,
    Call,
    If,
    ElseIf,
    Else,
    EndIf,
    While,
    EndWhile,
    Do,
    Repeat,
    EndRepeat,
    Break,
    Continue,
    /// None: a program number, as in `O1234`.
    Program,
}

impl Keyword {
    /// The keyword with these lower-case letters.
    #[inline]
    pub(crate) fn of(letters: &[u8]) -> Option<Self> {
        Some(match letters {
            b"" => Self::Program,
            b"sub" => Self::Sub,
            b"endsub" => Self::EndSub,
            b"return" => Self::Return,
            b"call" => Self::Call,
            b"if" => Self::If,
            b"elseif" => Self::ElseIf,
            b"else" => Self::Else,
            b"endif" => Self::EndIf,
            b"while" => Self::While,
            b"endwhile" => Self::EndWhile,
            b"do" => Self::Do,
            b"repeat" => Self::Repeat,
            b"endrepeat" => Self::EndRepeat,
            b"break" => Self::Break,
            b"continue" => Self::Continue,
            _ => return None,
        })
    }

    /// As written.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Program => "a program number",
            Self::Sub => "sub",
            Self::EndSub => "endsub",
            Self::Return => "return",
            Self::Call => "call",
            Self::If => "if",
            Self::ElseIf => "elseif",
            Self::Else => "else",
            Self::EndIf => "endif",
            Self::While => "while",
            Self::EndWhile => "endwhile",
            Self::Do => "do",
            Self::Repeat => "repeat",
            Self::EndRepeat => "endrepeat",
            Self::Break => "break",
            Self::Continue => "continue",
        }
    }
}
