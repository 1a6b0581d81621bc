//! The controller does not allocate after set-up: allocations are counted.

use evolvent_counting::calls;
use evolvent_turning::{Sensor, TurningController, TurningInputs, TurningState, Workpiece};

use crate::common::{fast, literal, safe, sensor, stocks};

#[test]
fn a_whole_job_allocates_nothing() {
    let start = calls();
    drop(std::hint::black_box(vec![1_u8; 100]));
    assert!(calls() >= start + 2, "the allocator does not count");
    for (settings, (name, blank)) in [safe(), fast(), literal()].into_iter().zip(stocks()) {
        let mut controller = TurningController::new(settings).unwrap();
        let mut piece = Workpiece::new(blank, 200.0, crate::common::law(), settings.tool, 60.0);
        let mut reader = Sensor::new(sensor(1), settings.period_s);
        let (mut load, mut counted, mut cycles) = (0.0, 0, 0_u32);
        while !controller.is_over() {
            let inputs = TurningInputs {
                load: reader.read(load, None),
                hold: cycles % 20_000 > 19_500,
                feed_override: if cycles % 7000 > 5000 { 0.7 } else { 1.0 },
                ..TurningInputs::default()
            };
            let before = calls();
            let output = controller.step(&inputs);
            counted += calls() - before;
            load = piece.step(output.along.position, output.out.position).load;
            cycles += 1;
        }
        assert_eq!(controller.state(), TurningState::Done, "{name}");
        assert_eq!(counted, 0, "{name}");
    }
}
