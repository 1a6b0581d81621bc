//! Properties of every smoothed path, over random programs and machines.

mod common;

use common::{
    Kind, campaign, chain, check, distance, equal_limits, limits, point, program, settings, smooth,
    stretches, within,
};
use evolvent_path::Axes;
use evolvent_smooth::PathSegment;

const ANY: Kind = Kind {
    smallest: 1e-3,
    largest: 20.0,
    curves: true,
    other_axes: false,
    mixed: false,
    flat: false,
};

#[test]
fn random_programs_are_smooth_within_the_tolerance() {
    let (mut random, cases) = campaign(0x5300_0001, 24);
    for case in 0..cases {
        let seed = random.state();
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
fn mixed_modes_and_axes_stay_within_the_tolerance() {
    let (mut random, cases) = campaign(0x5300_0002, 24);
    for case in 0..cases {
        let seed = random.state();
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

#[test]
fn programmed_points_are_within_two_tolerances() {
    let (mut random, cases) = campaign(0x5300_0004, 24);
    for case in 0..cases {
        let tolerance = random.log(1e-3, 0.1);
        // From many lines within the tolerance to lines much longer than it, corners and reversals among
        // them.
        let step = tolerance * random.log(0.03, 30.0);
        let (mut at, mut heading) = (point(&[0.0]), 0.0);
        let mut points = vec![at];
        for _ in 0..200 {
            heading += if random.unit() < 0.1 {
                random.between(-3.2, 3.2)
            } else {
                random.between(-0.3, 0.3)
            };
            let length = step * random.log(0.3, 3.0);
            at += point(&[length * heading.cos(), length * heading.sin()]);
            points.push(at);
        }
        let blocks = chain(&points, 100.0, within(tolerance));
        let (out, smoother) = smooth(settings(equal_limits(200.0, 2000.0, 50_000.0)), &blocks);
        let what = format!("case {case} P {tolerance} step {step}");
        check(&blocks, &out, 5, &what);
        assert_eq!(smoother.failures(), 0, "{what}");
        let driven = polygon(&stretches(&out), 0.02 * tolerance);
        let mut u = 0.0;
        for (k, block) in blocks.iter().enumerate() {
            u += block.curve.domain();
            let near = driven.partition_point(|&(at, _)| at < u - 12.0 * tolerance)
                ..driven.partition_point(|&(at, _)| at <= u + 12.0 * tolerance);
            let missed = driven[near]
                .iter()
                .map(|(_, position)| distance(&(position - block.curve.end())))
                .fold(f64::INFINITY, f64::min);
            assert!(
                missed <= 2.01 * tolerance,
                "{what}: the end of block {k} is missed by {} P",
                missed / tolerance
            );
        }
    }
}

/// Sections of short chords next to chords several times as long, as CAM systems write them: at the
/// transition, samples that follow the spline across joints are next to samples that slide along a straight
/// segment.
#[test]
fn chords_of_varying_length_stay_within_the_tolerance() {
    let (mut random, cases) = campaign(0x5300_0005, 24);
    for case in 0..cases {
        let tolerance = random.log(5e-3, 0.05);
        let (mut at, mut heading, mut turn, mut rise) = (point(&[0.0]), 0.0_f64, 0.0, 0.0);
        let (mut left, mut chord) = (0, 0.0);
        let mut points = vec![at];
        for _ in 0..700 {
            if left == 0 {
                left = 3 + random.pick(40);
                chord = tolerance * random.log(0.3, 12.0);
                turn = random.between(-0.024, 0.024) * chord / tolerance;
                rise = if random.unit() < 0.2 {
                    random.between(-1.5, 1.5)
                } else {
                    random.between(-0.1, 0.1)
                };
            }
            left -= 1;
            heading += turn;
            at += point(&[chord * heading.cos(), chord * heading.sin(), chord * rise]);
            points.push(at);
        }
        let blocks = chain(&points, 100.0, within(tolerance));
        let (out, smoother) = smooth(settings(equal_limits(300.0, 4000.0, 100_000.0)), &blocks);
        let what = format!("case {case} P {tolerance}");
        check(&blocks, &out, 33, &what);
        assert_eq!(smoother.failures(), 0, "{what}");
    }
}

/// Points of the path, closer than `gap`, by its parameter.
fn polygon(stretches: &[PathSegment], gap: f64) -> Vec<(f64, Axes)> {
    let (mut u, mut out) = (0.0, Vec::new());
    for stretch in stretches {
        let parts = (stretch.length / gap).ceil().clamp(1.0, 1e4) as usize;
        for k in 0..=parts {
            let x = stretch.length * k as f64 / parts as f64;
            out.push((u + x, stretch.curve.position(stretch.from + x)));
        }
        u += stretch.length;
    }
    out
}

#[test]
fn a_path_along_the_edge_of_the_travel_stays_inside() {
    let (mut random, cases) = campaign(0x5300_0003, 20);
    for case in 0..cases {
        let mut limits = equal_limits(200.0, 2000.0, 50_000.0);
        for i in 0..3 {
            (limits.travel_min[i], limits.travel_max[i]) = (-1.0, 1.0);
        }
        let mut at = || random.between(-2.0, 2.0).clamp(-1.0, 1.0);
        let points: Vec<_> = (0..30).map(|_| point(&[at(), at(), at()])).collect();
        let blocks = chain(&points, 100.0, within(random.log(1e-3, 1.0)));
        let what = format!("case {case}");
        let (out, _) = smooth(settings(limits), &blocks);
        check(&blocks, &out, 5, &what);
        for stretch in stretches(&out) {
            let (low, high) = stretch.curve.bounds(stretch.from, stretch.from + stretch.length);
            assert!(low.amax().max(high.amax()) <= 1.0 + 5e-7, "{what}: {low} {high}");
        }
    }
}

#[test]
fn extreme_tolerances_and_feeds_output_the_whole_path() {
    let points = [[0.0, 0.0], [5.0, 0.0], [5.0, 3.0], [5.0, 2.99], [-4.0, 0.0]].map(|p| point(&p));
    for mm in [f64::NAN, f64::INFINITY, -1.0, 1e-300, 1e-12, 1e9, f64::MAX] {
        for feed in [100.0, 1e-300, f64::INFINITY, f64::NAN, 0.0] {
            let blocks = chain(&points, feed, within(mm));
            let (out, _) = smooth(settings(equal_limits(200.0, 2000.0, 50_000.0)), &blocks);
            let length: f64 = stretches(&out).iter().map(|stretch| stretch.length).sum();
            let programmed: f64 = blocks.iter().map(|block| block.curve.domain()).sum();
            assert!(
                (length - programmed).abs() < 1e-9,
                "P {mm} F {feed}: {length} of {programmed}"
            );
            for stretch in stretches(&out) {
                assert!(
                    stretch.curve.position(stretch.from).iter().all(|x| x.is_finite()),
                    "P {mm} F {feed}"
                );
            }
        }
    }
}
