//! What tests of holds share.

#[expect(dead_code, reason = "the example `holds` uses the rest")]
pub(crate) mod driven;
