//! Why there is no answer.

use std::fmt::Display;

/// Why there is no answer, in words for the user.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum AnalysisError {
    /// A file or a number is wrong; the text says which and what to do.
    #[error("{0}")]
    Input(String),
    /// The input makes sense, but there is no result: a program fails, a folder cannot be written, nothing converges.
    #[error("{0}")]
    Failed(String),
}

impl AnalysisError {
    /// [`Self::Input`] with the text of another error.
    pub(crate) fn input(error: impl Display) -> Self {
        Self::Input(error.to_string())
    }

    /// [`Self::Failed`] with the text of another error.
    pub(crate) fn failed(error: impl Display) -> Self {
        Self::Failed(error.to_string())
    }
}
