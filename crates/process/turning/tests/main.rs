//! Turning passes, protection and adaptive feed, all in one executable.

mod common;
mod cone;

mod adaptive;
mod adaptive_files;
mod adaptive_losses;
mod allocation;
mod bound;
mod campaign;
mod lost_loads;
mod process_files;
mod protection;
mod sensors;
mod shoulder;
mod watch;

// It counts per thread, so that parallel tests do not affect each other.
#[global_allocator]
static ALLOCATOR: evolvent_counting::CountingAllocator = evolvent_counting::CountingAllocator;
