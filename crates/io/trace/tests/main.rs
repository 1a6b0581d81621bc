//! Trace files written, torn, read and described, all in one executable.

mod common;

mod foreign;
mod full_disk;
mod memory;
mod old_traces;
mod read_errors;
mod round_trip;
mod schema;
mod torn;

#[global_allocator]
static ALLOCATOR: evolvent_counting::CountingAllocator = evolvent_counting::CountingAllocator;
