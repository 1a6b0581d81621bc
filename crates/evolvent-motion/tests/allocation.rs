//! The cycle does not allocate: counted, not believed.

mod common;

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicU64, Ordering};

use common::{BLEND, PLANNERS, Pair, Random, scenario};
use evolvent_motion::Inputs;

struct Counting;

static CALLS: AtomicU64 = AtomicU64::new(0);

// SAFETY: every call is passed on to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        CALLS.fetch_add(1, Ordering::Relaxed);
        // SAFETY: the caller keeps the contract of `alloc`.
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        CALLS.fetch_add(1, Ordering::Relaxed);
        // SAFETY: the caller keeps the contract of `dealloc`.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn the_cycle_does_not_allocate() {
    let seed = 0x0a11_0c01;
    println!("seed {seed:#x}");
    let mut random = Random(seed);
    let before = CALLS.load(Ordering::Relaxed);
    drop(std::hint::black_box(vec![1_u8; 100]));
    assert!(
        CALLS.load(Ordering::Relaxed) >= before + 2,
        "the allocator does not count"
    );
    let mut cycles = 0_u64;
    for case in 0..8 {
        let mut scenario = scenario(&mut random, BLEND, true);
        scenario.planner = PLANNERS[case % 2];
        let mut pair = Pair::new(&scenario);
        let (mut producer, mut consumer) = rtrb::RingBuffer::new(16);
        let (mut calls, mut own) = (0, 0_u64);
        while !pair.motion.is_over() {
            pair.plan_ahead(&scenario);
            let inputs = Inputs {
                hold: own % 700 > 600,
                feed_override: if own % 300 < 150 { 1.0 } else { 1.7 },
                ..Inputs::default()
            };
            let before = CALLS.load(Ordering::Relaxed);
            let setpoint = pair.step(&inputs);
            // Hand-over, as the loop does it.
            let _full = producer.push(setpoint);
            let _taken = consumer.pop();
            calls += CALLS.load(Ordering::Relaxed) - before;
            own += 1;
        }
        assert_eq!(
            calls, 0,
            "case {case}: {calls} calls of the allocator in {own} cycles"
        );
        cycles += own;
    }
    assert!(cycles > 5_000, "only {cycles} cycles: proves nothing");
}
