//! The cycle does not allocate: counted, not believed.

mod common;

use common::{BLEND, PLANNERS, Pair, Random, scenario};
use evolvent_counting::{Counting, calls};
use evolvent_motion::Inputs;

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn the_cycle_does_not_allocate() {
    let seed = 0x0a11_0c01;
    println!("seed {seed:#x}");
    let mut random = Random(seed);
    let before = calls();
    drop(std::hint::black_box(vec![1_u8; 100]));
    assert!(calls() >= before + 2, "the allocator does not count");
    let mut cycles = 0_u64;
    for case in 0..8 {
        let mut scenario = scenario(&mut random, BLEND, true);
        scenario.planner = PLANNERS[case % 2];
        let mut pair = Pair::new(&scenario);
        let (mut producer, mut consumer) = rtrb::RingBuffer::new(16);
        let (mut counted, mut own) = (0, 0_u64);
        while !pair.motion.is_over() {
            pair.plan_ahead(&scenario);
            let inputs = Inputs {
                hold: own % 700 > 600,
                feed_override: if own % 300 < 150 { 1.0 } else { 1.7 },
                ..Inputs::default()
            };
            let before = calls();
            let setpoint = pair.step(&inputs);
            // Hand-over, as the loop does it.
            let _full = producer.push(setpoint);
            let _taken = consumer.pop();
            counted += calls() - before;
            own += 1;
        }
        assert_eq!(
            counted, 0,
            "case {case}: {counted} calls of the allocator in {own} cycles"
        );
        cycles += own;
    }
    assert!(cycles > 5_000, "only {cycles} cycles: proves nothing");
}
