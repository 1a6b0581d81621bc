//! The planner hands over nothing without capacity: if it waited for capacity in the middle of a window, it
//! could not reply to requests.

#![allow(clippy::expect_used, reason = "a test may fail")]

use std::cell::Cell;
use std::convert::Infallible;

use evolvent_machine::{Limits, PlannerKind};
use evolvent_path::{AXES, Axes, Curve, Line, Move, MoveKind, PathMode};
use evolvent_planner::{BlockMark, ExitSpeeds, PathLimits, PathRules, PlanSink, Planner, Segment, Step};

/// Maximum number of marks of a window: the capacity of the queue to the cycle.
const MARKS: usize = 1 << 17;

/// A sink that provides exactly the requested capacity.
#[derive(Default)]
struct Granting {
    capacity: Cell<(usize, usize, usize)>,
    blocks: Vec<u32>,
}

impl Granting {
    fn use_up(&self, steps: usize, segments: usize, marks: usize, what: &str) {
        let capacity = self.capacity.get();
        let left =
            |capacity: usize, used: usize| capacity.checked_sub(used).ok_or(what).expect("room for this");
        self.capacity.set((
            left(capacity.0, steps),
            left(capacity.1, segments),
            left(capacity.2, marks),
        ));
    }
}

impl PlanSink for Granting {
    type Error = Infallible;

    fn segment(&mut self, _: &Segment) -> Result<(), Infallible> {
        self.use_up(0, 1, 0, "segment");
        Ok(())
    }

    fn step(&mut self, _: &Step) -> Result<(), Infallible> {
        self.use_up(1, 0, 0, "step");
        Ok(())
    }

    fn exit(&mut self, _: u64, _: ExitSpeeds) {}

    fn commit(&mut self, _: u64) {}

    fn mark(&mut self, mark: &BlockMark) -> Result<(), Infallible> {
        self.use_up(0, 0, 1, "mark");
        self.blocks.push(mark.block);
        Ok(())
    }

    fn has_capacity(&self, steps: usize, segments: usize, marks: usize) -> bool {
        assert!(marks < MARKS, "{marks} marks in one window");
        self.capacity.set((steps, segments, marks));
        true
    }
}

/// Plans lines from point to point; returns the marked blocks.
fn plan(count: usize, at: impl Fn(usize) -> (f64, f64)) -> Vec<u32> {
    let limits = Limits {
        present: [true; AXES],
        velocity: Axes::repeat(200.0),
        acceleration: Axes::repeat(2000.0),
        jerk: Axes::repeat(50_000.0),
        travel_min: Axes::repeat(-1e5),
        travel_max: Axes::repeat(1e5),
        home: Axes::zeros(),
    };
    let rules = PathRules {
        blend_tolerance_mm: 0.01,
        joint_time_s: 0.001,
        planner: PlannerKind::Optimal,
        feed_override: 1.0,
    };
    let point = |k: usize| {
        let mut point = Axes::zeros();
        (point[0], point[1]) = at(k);
        point
    };
    let mut planner = Planner::new(PathLimits::new(limits, 1000.0, 1e-3), rules, Granting::default());
    for k in 0..count {
        let motion = Move {
            curve: Curve::Line(Line::new(point(k), point(k + 1)).expect("line")),
            kind: MoveKind::Feed,
            feed_mm_s: 50.0,
            path_mode: PathMode::Blend {
                tolerance_mm: Some(0.02),
                merge_mm: None,
            },
        };
        planner.push(&motion, k as u32, k as u32).expect("plan");
    }
    planner.finish(9999).expect("plan");
    std::mem::take(&mut planner.sink_mut().blocks)
}

#[test]
fn a_window_asks_for_room_for_all_its_marks() {
    // A wave in chords of 0.1 mm.
    let blocks = plan(2000, |k| {
        let s = 0.1 * k as f64;
        (s, 4.0 * (0.2 * s).sin())
    });
    assert!(blocks.iter().copied().eq(0..2000), "{} marks", blocks.len());
}

#[test]
fn marks_of_many_blocks_fit_into_the_queue() {
    let blocks = plan(5000, |k| {
        if k < 5000 {
            (0.01 * k as f64, 0.0)
        } else {
            (49.99, 20.0)
        }
    });
    assert!((500..=1500).contains(&blocks.len()), "{} marks", blocks.len());
    assert!(blocks.is_sorted() && blocks[0] == 0, "{blocks:?}");
    assert_eq!(blocks.last(), Some(&4999));
    let gap = blocks.windows(2).map(|two| two[1] - two[0]).max();
    assert!(gap <= Some(20), "{gap:?}");
}
