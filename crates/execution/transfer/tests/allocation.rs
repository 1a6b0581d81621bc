//! Evaluating a transfer does not allocate, measured by a counting allocator.

use std::hint::black_box;

use evolvent_counting::calls;
use evolvent_machine::Limits;
use evolvent_path::{AXES, Axes};
use evolvent_transfer::{AxesState, Sync, Transfer};

#[test]
fn a_transfer_is_copied_and_evaluated_without_heap() {
    let limits = Limits {
        present: [true; AXES],
        velocity: Axes::repeat(100.0),
        acceleration: Axes::repeat(1000.0),
        jerk: Axes::repeat(20_000.0),
        travel_min: Axes::repeat(-200.0),
        travel_max: Axes::repeat(200.0),
        home: Axes::zeros(),
    };
    let (from, mut to) = (
        AxesState::at_rest(Axes::zeros()),
        AxesState::at_rest(Axes::repeat(50.0)),
    );
    to.velocity[3] = 20.0;
    let before = calls();
    let solved = Transfer::solve(&limits, &from, &to, Sync::Time);
    assert!(calls() > before, "the allocator does not count");
    let before = calls();
    let mut sum = 0.0;
    if let Ok(transfer) = &solved {
        let copy = *black_box(transfer);
        for k in 0..10_000 {
            sum += black_box(copy.at(copy.duration_s() * f64::from(k) * 1e-4)).position[3];
        }
    }
    assert_eq!(calls(), before);
    assert!(sum > 0.0);
}
