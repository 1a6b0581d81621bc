//! Transfers between states, in one executable.

mod common;

mod allocation;
mod durations;
mod refusals;
mod transfers;

// Counts per thread, so that concurrent tests do not count each other's allocations.
#[global_allocator]
static ALLOCATOR: evolvent_counting::CountingAllocator = evolvent_counting::CountingAllocator;
