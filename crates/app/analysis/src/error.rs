//! The error of an analysis.

use std::fmt::Display;

/// The error of an analysis, as text for the user.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum AnalysisError {
    /// A file or a number is invalid; the text says which, and how to correct it.
    #[error("{0}")]
    Input(String),
    /// The input is valid, but there is no result: a program fails, a directory is not writable, an iteration
    /// does not converge.
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
