//! Traces replayed, recomputed and damaged, in one executable.

#[path = "../../inspect/tests/common/mod.rs"]
mod common;

mod damaged;
mod replayed;
mod signals;
mod verify;
