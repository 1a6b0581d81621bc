//! From bytes to blocks: lines, tokens, words, expressions, and which word belongs to which code.

pub(crate) mod block;
pub(crate) mod comment;
pub(crate) mod expression;
pub(crate) mod lexer;
pub(crate) mod lines;
pub(crate) mod parser;
pub(crate) mod reader;
pub(crate) mod statement;
pub(crate) mod word_faults;
