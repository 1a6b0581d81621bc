//! The cycle does not allocate: counted, not believed.

mod common;

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicU64, Ordering};

use common::{BLEND, Random, plan, scenario};
use evolvent_motion::{Inputs, Motion};

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
    for case in 0..20 {
        let scenario = scenario(&mut random, BLEND, true);
        let mut queue = plan(&scenario);
        let mut motion = Motion::new(
            scenario.limits,
            scenario.period_ns,
            scenario.moves[0].curve.start(),
        );
        let (mut producer, mut consumer) = rtrb::RingBuffer::new(16);
        let before = CALLS.load(Ordering::Relaxed);
        let mut own = 0_u64;
        while !motion.is_over() {
            let inputs = Inputs {
                hold: own % 700 > 600,
                feed_override: if own % 300 < 150 { 1.0 } else { 1.7 },
                ..Inputs::default()
            };
            let setpoint = motion.step(&inputs, &mut queue);
            // Hand-over, as the loop does it.
            let _full = producer.push(setpoint);
            let _taken = consumer.pop();
            own += 1;
        }
        let calls = CALLS.load(Ordering::Relaxed) - before;
        assert_eq!(
            calls, 0,
            "case {case}: {calls} calls of the allocator in {own} cycles"
        );
        cycles += own;
    }
    assert!(cycles > 10_000, "only {cycles} cycles: proves nothing");
}
