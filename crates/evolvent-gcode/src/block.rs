//! What stands on one line.

use crate::diagnostic::Span;
use crate::expression::Target;
use crate::names::Normal;

/// A letter and its value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Word {
    /// Upper-case ASCII letter, or `@`, `^`, `$`.
    pub(crate) letter: u8,
    pub(crate) value: f64,
    /// From the letter to the end of the value.
    pub(crate) span: Span,
}

/// One line. Kept and filled again, so that a line costs no allocation.
#[derive(Debug, Default)]
pub(crate) struct Block {
    /// Words in the order written, without N.
    pub(crate) words: Vec<Word>,
    /// Parameters to be written once the whole line has been read.
    pub(crate) assignments: Vec<(Target, f64)>,
    /// What stands between the parentheses of each comment.
    pub(crate) comments: Vec<Span>,
}

impl Block {
    pub(crate) fn clear(&mut self) {
        self.words.clear();
        self.assignments.clear();
        self.comments.clear();
    }
}

/// The name and the keyword of a line that begins with O.
pub(crate) struct OWord {
    /// The place of the name, from O.
    pub(crate) span: Span,
    pub(crate) name: Normal,
    pub(crate) keyword: Keyword,
    /// Where on the line the rest begins.
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
    /// None: the number of a program, as in `O1234`.
    Program,
}

impl Keyword {
    /// Every keyword; where one begins with another, the longer comes first.
    pub(crate) const ALL: [(&'static str, Self); 15] = [
        ("sub", Self::Sub),
        ("endsub", Self::EndSub),
        ("return", Self::Return),
        ("call", Self::Call),
        ("if", Self::If),
        ("elseif", Self::ElseIf),
        ("else", Self::Else),
        ("endif", Self::EndIf),
        ("while", Self::While),
        ("endwhile", Self::EndWhile),
        ("do", Self::Do),
        ("repeat", Self::Repeat),
        ("endrepeat", Self::EndRepeat),
        ("break", Self::Break),
        ("continue", Self::Continue),
    ];

    /// As written.
    pub(crate) fn name(self) -> &'static str {
        Self::ALL
            .iter()
            .find(|(_, keyword)| *keyword == self)
            .map_or("a program number", |(name, _)| name)
    }
}
