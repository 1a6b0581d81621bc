//! A planner that has warmed up does not allocate, so that its speed does not depend on the allocator.

#![allow(clippy::expect_used, reason = "a test may fail")]

use evolvent_counting::allocations;
use evolvent_machine::PlannerKind;
use evolvent_motion::Inputs;
use evolvent_path::{Axes, Curve, Line, Move, MoveKind};

use crate::common::{BLEND, Pair, Scenario, equal_axes};

/// A wavy contour in 20 um chords with occasional corners.
fn contour(blocks: usize) -> Vec<Move> {
    let at = |k: usize| {
        let s = 0.02 * k as f64;
        let mut point = Axes::zeros();
        let tooth = (s % 12.0 - 6.0).abs();
        (point[0], point[1]) = (s, tooth + 3.0 * (0.3 * s).sin());
        point
    };
    (0..blocks)
        .map(|k| Move {
            curve: Curve::Line(Line::new(at(k), at(k + 1)).expect("line")),
            kind: MoveKind::Feed,
            feed_mm_s: 150.0,
            path_mode: BLEND,
        })
        .collect()
}

#[test]
fn a_warm_planner_does_not_allocate() {
    let scenario = Scenario {
        limits: equal_axes(200.0, 2000.0, 50_000.0),
        period_ns: 1_000_000,
        moves: contour(30_000),
        chord_error_mm: 1e-3,
        planner: PlannerKind::Optimal,
    };
    let mut pair = Pair::new(&scenario);
    let mut counts = Vec::new();
    while !pair.motion.is_over() {
        while !pair.motion.is_ready(&mut pair.queue) {
            let before = allocations();
            pair.feed(&scenario);
            pair.planner.poll().expect("plan");
            let now = allocations();
            if now > before {
                counts.push((pair.fed, now - before));
            }
        }
        pair.step(&Inputs::default());
    }
    // The end of the path is excluded: it is planned in larger pieces.
    let warm = 15_000..=30_000;
    let late: Vec<_> = counts.iter().filter(|(fed, _)| warm.contains(fed)).collect();
    assert!(late.is_empty(), "counts (move, count): {late:?}");
    assert!(!counts.is_empty(), "nothing was counted");
}
