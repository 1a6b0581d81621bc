//! The checker of positions, all in one executable.

mod common;

mod feeds;
mod planted;
mod rates;
