//! Turning passes, protection and adaptive feed, all in one executable.

mod common;
mod cone;

mod adaptive;
mod adaptive_files;
mod allocation;
mod bound;
mod campaign;
mod lost_loads;
mod process_files;
mod protection;
mod sensors;
mod shoulder;
mod watch;

// It counts by thread, so that tests beside each other do not count together.
#[global_allocator]
static ALLOCATOR: evolvent_counting::CountingAllocator = evolvent_counting::CountingAllocator;
