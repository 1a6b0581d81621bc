//! first smoke
use evolvent_machine::Limits;
use evolvent_path::{AXES, Axes};
use evolvent_transfer::*;
#[test]
fn smoke() {
    let mut limits = Limits {
        present: [false; AXES],
        velocity: Axes::repeat(500.0),
        acceleration: Axes::repeat(5000.0),
        jerk: Axes::repeat(200_000.0),
        travel_min: Axes::repeat(-400.0),
        travel_max: Axes::repeat(400.0),
        home: Axes::zeros(),
    };
    for i in 0..3 {
        limits.present[i] = true;
    }
    let mut to = Axes::zeros();
    to[0] = 100.0;
    to[1] = 33.0;
    to[2] = 1e-3;
    for sync in [Sync::Time, Sync::Phase, Sync::None] {
        let t = Transfer::solve(
            &limits,
            &AxesState::at_rest(Axes::zeros()),
            &AxesState::at_rest(to),
            sync,
        )
        .unwrap();
        println!(
            "{sync:?} {:?} {} {}",
            t.method(),
            t.duration_s(),
            std::mem::size_of::<Transfer>()
        );
        for l in [
            evolvent_path::AxisLetter::X,
            evolvent_path::AxisLetter::Y,
            evolvent_path::AxisLetter::Z,
        ] {
            for p in t.track(l).pieces() {
                println!(
                    "   {l:?} {:.9} {:.9} j {:.3} v {:.3}",
                    p.start_s, p.duration_s, p.jerk, p.velocity
                );
            }
        }
    }
}
