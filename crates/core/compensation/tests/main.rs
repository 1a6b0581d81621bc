//! Tests of the corrections through the public interface.

#![expect(clippy::unwrap_used, reason = "a test may fail")]

mod allocation;
mod curves;
mod design;
mod motions;
mod plant;
mod profile;
mod smoothing;

#[global_allocator]
static ALLOCATOR: evolvent_counting::CountingAllocator = evolvent_counting::CountingAllocator;
