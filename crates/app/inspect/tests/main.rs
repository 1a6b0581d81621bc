//! Traces read, exported, shown and compared, in one executable.

mod common;

mod compared;
mod page;
mod tables;
mod viewers;
