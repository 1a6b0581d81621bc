//! Feedback, phase, followers and state machines, all in one executable.

mod allocation;
mod brake;
mod cia402;
mod entry;
mod follower;
mod gantry;
mod input_entry;
mod machines;
mod phase;
mod random_motion;
mod renaming;
mod start;
mod step_check;
mod watch;
mod watch_bench;

// It counts per thread, so that parallel tests do not affect each other.
#[global_allocator]
static ALLOCATOR: evolvent_counting::CountingAllocator = evolvent_counting::CountingAllocator;
