//! Transfers between states, all in one executable.

mod common;

mod allocation;
mod durations;
mod refusals;
mod transfers;

// It counts by thread, so that tests beside each other do not count together.
#[global_allocator]
static ALLOCATOR: evolvent_counting::CountingAllocator = evolvent_counting::CountingAllocator;
