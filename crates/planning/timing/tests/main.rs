//! Time laws of known paths, all in one executable.

mod common;

mod allocation;
mod invariants;
mod repeatable;

// It counts by thread, so that tests beside each other do not count together.
#[global_allocator]
static ALLOCATOR: evolvent_counting::CountingAllocator = evolvent_counting::CountingAllocator;
