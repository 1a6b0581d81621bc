//! The checker of positions, all in one executable.

mod common;

mod planted;
mod rates;
