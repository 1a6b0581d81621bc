//! Tests of the time laws, in one executable.

mod common;

mod allocation;
mod invariants;
mod repeatable;

// It counts per thread, so that concurrent tests do not interfere.
#[global_allocator]
static ALLOCATOR: evolvent_counting::CountingAllocator = evolvent_counting::CountingAllocator;
