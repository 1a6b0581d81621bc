//! Programs on which planners are compared.

/// A part program.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Program {
    /// Name, without ending.
    pub name: String,
    /// RS274/NGC.
    pub text: String,
}

/// The standing bench.
#[must_use]
pub fn suite() -> Vec<Program> {
    Vec::new()
}
