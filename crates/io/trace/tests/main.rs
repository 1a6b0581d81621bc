//! Trace files written, torn, read and described, all in one executable.

mod common;

mod foreign;
mod full_disk;
mod read_errors;
mod round_trip;
mod schema;
mod torn;
