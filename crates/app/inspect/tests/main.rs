//! Traces read, exported, shown, compared, replayed and computed again, all in one executable.

mod common;

mod compared;
mod damaged;
mod page;
mod replayed;
mod tables;
mod verify;
mod viewers;
