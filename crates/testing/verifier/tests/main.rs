//! Tests of the judge of positions, in one executable.

mod common;

mod feeds;
mod planted;
mod rates;
