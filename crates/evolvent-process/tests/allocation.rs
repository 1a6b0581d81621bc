//! The controller allocates nothing once it is set up: counted, not believed.

mod common;

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicU64, Ordering};

use common::{fast, literal, safe, sensor, stocks};
use evolvent_process::{Sensor, TurningController, TurningInputs, TurningState, Workpiece};

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
fn a_whole_job_allocates_nothing() {
    let start = CALLS.load(Ordering::Relaxed);
    drop(std::hint::black_box(vec![1_u8; 100]));
    assert!(
        CALLS.load(Ordering::Relaxed) >= start + 2,
        "the allocator does not count"
    );
    for (settings, (name, blank)) in [safe(), fast(), literal()].into_iter().zip(stocks()) {
        let mut controller = TurningController::new(settings).unwrap();
        let mut piece = Workpiece::new(blank, 200.0, common::law(), settings.tool, 60.0);
        let mut reader = Sensor::new(sensor(1), settings.period_s);
        let (mut load, mut calls, mut cycles) = (0.0, 0, 0_u32);
        while !controller.is_over() {
            let inputs = TurningInputs {
                load: reader.read(load, None),
                hold: cycles % 20_000 > 19_500,
                feed_override: if cycles % 7000 > 5000 { 0.7 } else { 1.0 },
                ..TurningInputs::default()
            };
            let before = CALLS.load(Ordering::Relaxed);
            let output = controller.step(&inputs);
            calls += CALLS.load(Ordering::Relaxed) - before;
            load = piece.step(output.along.position, output.out.position).load;
            cycles += 1;
        }
        assert_eq!(controller.state(), TurningState::Done, "{name}");
        assert_eq!(calls, 0, "{name}");
    }
}
