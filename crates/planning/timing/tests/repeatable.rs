//! The same calls give the same results, bit for bit.
#![allow(clippy::expect_used, reason = "a test may fail")]

use evolvent_timing::{Entry, Exit, FeedError, Grid, Optimizer, PathPosition, TimeLawPiece};

use crate::common::{Path, axes, relaxation, square};

const START: PathPosition = PathPosition { interval: 0, x: 0.0 };

fn grid(path: &Path) -> (Grid, Optimizer) {
    let limits = relaxation(axes(3, 200.0, 2000.0, 5e4));
    let mut grid = Grid::new(&limits);
    path.push_to(&mut grid);
    (grid, Optimizer::new(&limits))
}

/// A plan from rest over 40 intervals, and its continuation from the middle over 30 more.
fn two(grid: &Grid, optimizer: &mut Optimizer) -> (Vec<TimeLawPiece>, Vec<TimeLawPiece>) {
    let (mut first, mut second) = (Vec::new(), Vec::new());
    optimizer
        .plan(grid, START, Entry::Rest, 40, Exit::Open, 1.0, &mut first)
        .expect("plan");
    let (position, entry) = middle(grid, &first);
    optimizer
        .plan(grid, position, entry, 60, Exit::Open, 0.8, &mut second)
        .expect("plan");
    (first, second)
}

fn middle(grid: &Grid, plan: &[TimeLawPiece]) -> (PathPosition, Entry) {
    let piece = plan[plan.len() / 2];
    let state = piece.law.at(0.0).0;
    let (_, begin) = grid.segment_of(piece.interval).expect("known");
    let position = PathPosition {
        interval: piece.interval,
        x: piece.from - begin,
    };
    (
        position,
        Entry::Moving {
            v: state.v,
            a: state.a,
        },
    )
}

#[test]
fn a_plan_does_not_depend_on_what_was_planned_before() {
    let (grid, mut fresh) = grid(&square(10.0, 0.02, 30.0));
    let expected = two(&grid, &mut fresh);
    let mut used = fresh.clone();
    assert!(two(&grid, &mut used) == expected, "after other plans");
    used.forget();
    assert!(two(&grid, &mut used) == expected, "after forgetting");
}

#[test]
fn what_is_forgotten_serves_no_plan() {
    let (grid, mut optimizer) = grid(&square(10.0, 0.02, 30.0));
    let (first, _) = two(&grid, &mut optimizer);
    let (position, entry) = middle(&grid, &first);
    optimizer.forget();
    let mut out = Vec::new();
    let plan = optimizer.plan(&grid, position, entry, 60, Exit::Open, 1.0, &mut out);
    assert!(matches!(plan, Err(FeedError::NoMotion { .. })) && out.is_empty());
}
