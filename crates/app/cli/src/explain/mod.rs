//! `evolvent plan --explain LINE`: why the machine is as slow there as it is, and what would help.
//!
//! Three sources: the setpoints of the line ([`Watch`]), the program around it ([`Surroundings`]), and plans made once
//! more with one thing changed ([`Remedy`]): what helps is measured, not guessed.

mod remedy;
mod surroundings;
mod watch;
mod words;

pub(crate) use remedy::{Remedy, remedies};
pub(crate) use surroundings::Surroundings;
pub(crate) use watch::{Seen, Watch};

use serde::Serialize;

/// All that is said of a line.
#[derive(Debug, Serialize)]
pub(crate) struct Explanation {
    pub(crate) line: u32,
    #[serde(flatten)]
    pub(crate) program: Surroundings,
    #[serde(flatten)]
    pub(crate) seen: Seen,
    /// Why it is slow, in sentences.
    pub(crate) reasons: Vec<String>,
    /// What would help, measured.
    pub(crate) remedies: Vec<Remedy>,
    /// What would help, not measured.
    pub(crate) advice: Vec<String>,
}

impl Explanation {
    pub(crate) fn new(line: u32, program: Surroundings, seen: Seen, remedies: Vec<Remedy>) -> Self {
        let (reasons, advice) = words::reasons(&program, &seen);
        Self {
            line,
            program,
            seen,
            reasons,
            remedies,
            advice,
        }
    }
}
