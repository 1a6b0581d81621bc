//! A counting allocator for tests, which shows that code does not allocate.
//!
//! A test makes it the global allocator and compares [`calls`] or [`allocations`] before and after:
//!
//! ```
//! use evolvent_counting::{CountingAllocator, calls};
//! #[global_allocator]
//! static ALLOCATOR: CountingAllocator = CountingAllocator;
//!
//! let before = calls();
//! drop(std::hint::black_box(vec![1_u8; 100]));
//! assert_eq!(calls(), before + 2);
//! ```
//!
//! Each thread has its own counts, because the test harness allocates on other threads.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

/// The system's allocator with counters.
#[derive(Debug)]
pub struct CountingAllocator;

thread_local! {
    static TAKEN: Cell<u64> = const { Cell::new(0) };
    static GIVEN_BACK: Cell<u64> = const { Cell::new(0) };
    static LIVE: Cell<i64> = const { Cell::new(0) };
}

/// Bytes that this thread has allocated minus those that it has freed. Memory freed by another thread is not
/// subtracted.
#[must_use]
pub fn live_bytes() -> i64 {
    LIVE.with(Cell::get)
}

fn add_live(bytes: i64) {
    LIVE.with(|live| live.set(live.get() + bytes));
}

/// Number of allocations of this thread so far, reallocations included.
#[must_use]
pub fn allocations() -> u64 {
    TAKEN.with(Cell::get)
}

/// Number of allocations and deallocations of this thread so far. The real-time cycle does neither.
#[must_use]
pub fn calls() -> u64 {
    allocations() + GIVEN_BACK.with(Cell::get)
}

fn count(calls: &'static std::thread::LocalKey<Cell<u64>>) {
    calls.with(|calls| calls.set(calls.get() + 1));
}

// SAFETY: every call is passed on to the system's allocator unchanged.
unsafe impl GlobalAlloc for CountingAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count(&TAKEN);
        add_live(layout.size() as i64);
        // SAFETY: the caller keeps the contract of `alloc`.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        count(&GIVEN_BACK);
        add_live(-(layout.size() as i64));
        // SAFETY: the caller keeps the contract of `dealloc`.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count(&TAKEN);
        add_live(size as i64 - layout.size() as i64);
        // SAFETY: the caller keeps the contract of `realloc`.
        unsafe { System.realloc(pointer, layout, size) }
    }
}
