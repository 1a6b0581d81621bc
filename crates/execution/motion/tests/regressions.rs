//! Cases that once failed, each named for its cause.

use evolvent_motion::Inputs;
use evolvent_path::PathMode;

use crate::common::{BLEND, Random, check, run, scenario};

/// The speed at which an override changes is known to its last digit; the time of the pending change is the
/// square root of the remainder. Without a correction the run ended nanometres too far, and where the path
/// came to rest that was a step of acceleration, which the guard rejected.
#[test]
fn rounding_does_not_carry_a_stop_past_its_position() {
    let mut random = Random::from_state(1000);
    let mut case = 0;
    let scenario = loop {
        let mode = if case % 2 == 0 { BLEND } else { PathMode::ExactPath };
        let scenario = scenario(&mut random, mode, false);
        if case == 113 {
            break scenario;
        }
        case += 1;
    };
    let mut inputs = Inputs::default();
    let mut next = 0;
    let mut history = Random::from_state(random.state() ^ 0xabcd);
    let (setpoints, motion) = run(&scenario, |cycle| {
        if cycle >= next {
            next = cycle + history.log(1.0, 400.0) as u64;
            inputs.hold = history.unit() < 0.3;
            if history.unit() < 0.6 {
                inputs.feed_override = history.between(0.0, 2.2);
            }
            if cycle > 20_000 {
                inputs = Inputs::default();
            }
        }
        inputs
    });
    check(&scenario, &setpoints, &motion, 1e-6, "case 113");
}
