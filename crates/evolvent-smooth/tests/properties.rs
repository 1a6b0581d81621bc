//! What every smoothed path keeps, over random programs and machines.

mod common;

use common::{Kind, campaign, check, equal_limits, limits, program, settings, smooth, within};

const ANY: Kind = Kind {
    smallest: 1e-3,
    largest: 20.0,
    curves: true,
    other_axes: false,
    mixed: false,
    flat: false,
};

#[test]
fn random_programs_stay_within_the_tolerance_and_are_smooth() {
    let (mut random, cases) = campaign(0x5300_0001, 60);
    for case in 0..cases {
        let seed = random.0;
        let tolerance = random.log(1e-3, 1.0);
        let smallest = random.log(1e-3, 1.0);
        let kind = Kind {
            smallest,
            largest: smallest * random.log(1.0, 1e3),
            curves: case % 2 == 0,
            flat: case % 4 == 1,
            ..ANY
        };
        let count = 2 + random.pick(60);
        let blocks = program(&mut random, kind, count, within(tolerance));
        let limits = if case % 3 == 0 {
            limits(&mut random)
        } else {
            equal_limits(200.0, 2000.0, 50_000.0)
        };
        let what = format!("case {case} seed {seed} P {tolerance}");
        let (out, smoother) = smooth(settings(limits), &blocks);
        check(&blocks, &out, 5, &what);
        assert_eq!(smoother.failures(), 0, "{what}");
        let deviation = smoother.deviation_mm();
        assert!(deviation <= tolerance, "{what}: {deviation}");
    }
}

#[test]
fn programs_of_mixed_modes_and_axes_stay_within_the_tolerance() {
    let (mut random, cases) = campaign(0x5300_0002, 60);
    for case in 0..cases {
        let seed = random.0;
        let smallest = random.log(1e-3, 0.3);
        let kind = Kind {
            smallest,
            largest: smallest * random.log(1.0, 300.0),
            curves: case % 3 == 0,
            other_axes: case % 2 == 0,
            mixed: true,
            flat: false,
        };
        let count = 2 + random.pick(60);
        let first = within(random.log(1e-3, 1.0));
        let blocks = program(&mut random, kind, count, first);
        let limits = limits(&mut random);
        let what = format!("case {case} seed {seed}");
        let (out, smoother) = smooth(settings(limits), &blocks);
        check(&blocks, &out, 5, &what);
        assert_eq!(smoother.failures(), 0, "{what}");
    }
}
