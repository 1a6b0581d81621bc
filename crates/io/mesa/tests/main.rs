//! The tests of the bridge to Mesa boards, in one executable.

#![expect(clippy::expect_used, clippy::print_stdout, reason = "tests")]

mod common;

mod board_files;
mod bridge;
mod campaign;
mod discovery;
mod faults;
mod field_io;
mod gantry;
mod index;
mod pins;
mod spindle;
