//! Plans that are executed, held, changed and guarded, in one executable.

mod common;

mod allocation;
mod classic_holds;
mod determinism;
mod excursions;
mod faults;
mod full_queue;
mod guard;
mod holds;
mod interleaved;
mod invariants;
mod late_answers;
mod low_overrides;
mod planner_allocation;
mod probing;
mod regressions;
mod requests;
mod rests;
mod served_machine;
mod slow_planner;
mod synchronised;

// Counts per thread, so that concurrent tests do not count each other's allocations.
#[global_allocator]
static ALLOCATOR: evolvent_counting::CountingAllocator = evolvent_counting::CountingAllocator;
