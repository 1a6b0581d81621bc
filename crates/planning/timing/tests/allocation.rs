//! After warming up the planner does not allocate, so its run time does not depend on the allocator.
#![allow(clippy::expect_used, reason = "a test may fail")]

use evolvent_counting::allocations;
use evolvent_timing::{Entry, Exit, Grid, Optimizer, PathPosition, TimeLawPiece};

use crate::common::{axes, relaxation, square};

/// A plan from rest, its continuation at a reduced feed, and a stop.
fn round(grid: &Grid, optimizer: &mut Optimizer, out: &mut Vec<TimeLawPiece>) {
    let start = PathPosition { interval: 0, x: 0.0 };
    optimizer
        .plan(grid, start, Entry::Rest, 40, Exit::Open, 1.0, out)
        .expect("plan");
    for fraction in [2, 3] {
        let piece = out[out.len() / fraction];
        let state = piece.law.at(0.0).0;
        let (_, begin) = grid.segment_of(piece.interval).expect("known");
        let position = PathPosition {
            interval: piece.interval,
            x: piece.from - begin,
        };
        let (v, a) = (state.v, state.a);
        let (entry, factor) = (Entry::Moving { v, a }, if fraction == 2 { 0.7 } else { 1.0 });
        optimizer
            .plan(grid, position, entry, 60, Exit::Open, factor, out)
            .expect("plan");
    }
}

#[test]
fn plans_allocate_nothing_after_the_first() {
    let limits = relaxation(axes(3, 200.0, 2000.0, 5e4));
    let mut grid = Grid::new(&limits);
    square(10.0, 0.02, 30.0).push_to(&mut grid);
    let (mut optimizer, mut out) = (Optimizer::new(&limits), Vec::with_capacity(2000));
    round(&grid, &mut optimizer, &mut out);
    let before = allocations();
    round(&grid, &mut optimizer, &mut out);
    assert!(before > 0, "nothing is counted");
    assert_eq!(allocations() - before, 0);
}
