//! Shared code of the tests of holds.

#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

#[expect(dead_code, reason = "the example `holds` uses the rest")]
pub(crate) mod driven;
