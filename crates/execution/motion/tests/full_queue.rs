//! A planner that is so far ahead that the queue is full still replies.

#![allow(clippy::expect_used, reason = "a test may fail")]

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use evolvent_machine::PlannerKind;
use evolvent_motion::{Inputs, MotionState, PathExecutor, PlanConsumer, PlannerLag, Setpoint, plan_queue};
use evolvent_path::{Axes, Curve, Line, Move, MoveKind};
use evolvent_planner::Step;

use crate::common::{BLEND, Scenario, check, equal_axes};

/// Time for which the planner may keep the cycle waiting before the test fails.
const PATIENCE: Duration = Duration::from_secs(60);

fn scenario(moves: Vec<Move>, planner: PlannerKind) -> Scenario {
    Scenario {
        limits: equal_axes(200.0, 2000.0, 50_000.0),
        period_ns: 1_000_000,
        moves,
        chord_error_mm: 1e-3,
        planner,
    }
}

/// Drives `moves` by `step`, which receives the number of the cycle, in `rounds` that each begin when the
/// queue is full.
fn drive(
    moves: Vec<Move>,
    (rounds, cycles): (usize, usize),
    mut step: impl FnMut(usize, &mut PathExecutor, &mut PlanConsumer) -> Setpoint,
) {
    let scenario = scenario(moves, PlannerKind::Optimal);
    let (waits, over) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicBool::new(false)));
    let (counted, ended) = (Arc::clone(&waits), Arc::clone(&over));
    let (producer, mut queue) = plan_queue(move || {
        counted.fetch_add(1, Ordering::Relaxed);
        std::thread::sleep(Duration::from_micros(200));
        !ended.load(Ordering::Relaxed)
    });
    let mut motion = scenario.motion();
    std::thread::scope(|scope| {
        let planner = scope.spawn(|| {
            let mut planner = scenario.planner(1.0, producer);
            for (i, one) in scenario.moves.iter().enumerate() {
                if planner.push(one, i as u32 + 1, i as u32).is_err() {
                    return;
                }
            }
        });
        let mut setpoints: Vec<Setpoint> = Vec::new();
        let mut is_stuck = false;
        for _ in 0..rounds {
            // The planner has used up the capacity, after any number of waits.
            let (start, before) = (Instant::now(), waits.load(Ordering::Relaxed));
            while waits.load(Ordering::Relaxed) < before + 50 && start.elapsed() < PATIENCE {
                std::thread::sleep(Duration::from_millis(1));
            }
            assert!(start.elapsed() < PATIENCE, "the queue was never full");
            for _ in 0..cycles {
                let since = Instant::now();
                while !motion.is_ready(&mut queue) && !is_stuck {
                    std::thread::yield_now();
                    is_stuck = since.elapsed() > PATIENCE;
                }
                if !is_stuck {
                    setpoints.push(step(setpoints.len(), &mut motion, &mut queue));
                }
            }
        }
        over.store(true, Ordering::Relaxed);
        planner.join().expect("planner");
        assert!(
            !is_stuck,
            "cycle and planner wait for each other at cycle {}",
            setpoints.len()
        );
        check(&scenario, &setpoints, &motion, 0.02, "full queue");
    });
}

fn line(from: Axes, to: Axes, feed: f64) -> Move {
    Move {
        curve: Curve::Line(Line::new(from, to).expect("line")),
        kind: MoveKind::Feed,
        feed_mm_s: feed,
        path_mode: BLEND,
    }
}

fn zigzag(count: usize) -> Vec<Move> {
    let at = |k: usize| {
        let mut point = Axes::zeros();
        (point[0], point[1]) = (k as f64, f64::from(u8::from(k % 2 == 1)));
        point
    };
    (0..count).map(|k| line(at(k), at(k + 1), 50.0)).collect()
}

#[test]
fn overrides_get_replies_when_the_queue_is_full() {
    let cycles = 200;
    drive(zigzag(6000), (5, cycles), |cycle, motion, queue| {
        let inputs = Inputs {
            feed_override: [1.0, 0.5][cycle / cycles % 2],
            ..Inputs::default()
        };
        motion.step(&inputs, queue)
    });
}

/// Each reply that is not taken over stays in the queue until the cycle has passed it. When no more fit, the
/// cycle must not wait for the planner, which waits for the cycle.
#[test]
fn answers_that_came_to_nothing_do_not_stop_the_next() {
    let mut refusals = 0;
    drive(zigzag(6000), (1, 60_000), |cycle, motion, queue| {
        let inputs = Inputs {
            feed_override: 0.998_f64.powi(cycle as i32 / 40).max(0.3),
            ..Inputs::default()
        };
        // As in a recorded run whose planner was always late.
        let lag = PlannerLag {
            refused: true,
            ..PlannerLag::default()
        };
        let setpoint = motion.replay_step(&inputs, queue, lag);
        refusals += u32::from(motion.planner_lag().refused);
        setpoint
    });
    assert!(refusals > 8, "{refusals} answers came to nothing");
}

/// A dropped plan fills the queue after the slot that is reserved for the step after a stop, and failed
/// replies take the rest: the step after the stop must still fit.
#[test]
fn the_step_after_a_stop_fits_beside_a_dropped_plan() {
    let mut moves = vec![line(
        Axes::from_fn(|i, _| if i == 0 { -40.0 } else { 0.0 }),
        Axes::zeros(),
        20.0,
    )];
    moves.extend(zigzag(6000));
    let scenario = scenario(moves, PlannerKind::Optimal);
    for every in [14, 18, 22] {
        let [waits, polls] = [(); 2].map(|()| AtomicU64::new(0));
        let [more, over] = [(); 2].map(|()| AtomicBool::new(false));
        let counts_beyond = |counter: &AtomicU64, by: u64| {
            let (start, from) = (Instant::now(), counter.load(Ordering::Relaxed));
            while counter.load(Ordering::Relaxed) < from + by {
                assert!(start.elapsed() < PATIENCE, "the planner stands");
                std::thread::sleep(Duration::from_millis(1));
            }
        };
        let (producer, mut queue) = plan_queue(|| {
            waits.fetch_add(1, Ordering::Relaxed);
            std::thread::sleep(Duration::from_micros(200));
            !over.load(Ordering::Relaxed)
        });
        let mut motion = scenario.motion();
        std::thread::scope(|scope| {
            scope.spawn(|| {
                let mut planner = scenario.planner(1.0, producer);
                planner.push(&scenario.moves[0], 1, 0).ok()?;
                let (seconds, line) = (0.005, 1);
                planner.rest(&Step::Dwell { seconds, line }).ok()?;
                while !more.load(Ordering::Relaxed) {
                    planner.poll().ok()?;
                    polls.fetch_add(1, Ordering::Relaxed);
                    std::thread::sleep(Duration::from_micros(200));
                }
                for (i, one) in scenario.moves.iter().enumerate().skip(1) {
                    planner.push(one, i as u32 + 1, i as u32).ok()?;
                }
                planner.finish(9999).ok()
            });
            let mut feed_override = 1.0;
            let mut requested_at = None;
            let mut last = scenario.moves[0].curve.start()[0];
            let mut is_stuck = false;
            for cycle in 0..6000 {
                let since = Instant::now();
                while !motion.is_ready(&mut queue) && !is_stuck {
                    std::thread::yield_now();
                    is_stuck = since.elapsed() > PATIENCE;
                }
                if is_stuck {
                    break;
                }
                // The request for it gets a reply and is then withdrawn for a lower override.
                if requested_at.is_none() && last > -4.0 {
                    (feed_override, requested_at) = (1.3, Some(cycle));
                }
                let since_request = requested_at.map_or(0, |at| cycle - at);
                if since_request == 2 {
                    counts_beyond(&polls, 20);
                    more.store(true, Ordering::Relaxed);
                    counts_beyond(&waits, 50);
                    feed_override = 0.9;
                } else if since_request > 2 && (since_request - 2) % every == 0 {
                    feed_override *= 0.96;
                }
                let inputs = Inputs {
                    feed_override,
                    ..Inputs::default()
                };
                last = motion.step(&inputs, &mut queue).position[0];
            }
            // Ends any wait of the planner.
            more.store(true, Ordering::Relaxed);
            over.store(true, Ordering::Relaxed);
            assert!(!is_stuck, "cycle and planner wait for each other at X {last}");
            assert!(last > 0.0, "the stop has been passed, at X {last}");
        });
    }
}

#[test]
fn more_consecutive_stops_than_queue_slots_are_passed() {
    const STOPS: usize = 40_000;
    let there = Axes::from_fn(|i, _| if i == 0 { 1.0 } else { 0.0 });
    for kind in [PlannerKind::Optimal, PlannerKind::Classic] {
        let moves = vec![line(Axes::zeros(), there, 50.0), line(there, Axes::zeros(), 50.0)];
        let scenario = scenario(moves, kind);
        let over = Arc::new(AtomicBool::new(false));
        let ended = Arc::clone(&over);
        let (producer, mut queue) = plan_queue(move || {
            std::thread::sleep(Duration::from_micros(200));
            !ended.load(Ordering::Relaxed)
        });
        let mut motion = scenario.motion();
        std::thread::scope(|scope| {
            let planner = scope.spawn(|| {
                let mut planner = scenario.planner(1.0, producer);
                planner.push(&scenario.moves[0], 1, 0).ok()?;
                for _ in 0..STOPS {
                    let (seconds, line) = (0.0, 2);
                    planner.rest(&Step::Dwell { seconds, line }).ok()?;
                }
                planner.push(&scenario.moves[1], 3, 1).ok()?;
                planner.finish(4).ok()
            });
            let (mut setpoints, start) = (Vec::new(), Instant::now());
            while !motion.is_over() && start.elapsed() < PATIENCE {
                if motion.is_ready(&mut queue) {
                    setpoints.push(motion.step(&Inputs::default(), &mut queue));
                } else {
                    std::thread::yield_now();
                }
            }
            over.store(true, Ordering::Relaxed);
            planner.join().expect("planner");
            assert_eq!(
                motion.state(),
                MotionState::Done,
                "{kind:?}: {} cycles",
                setpoints.len()
            );
            check(&scenario, &setpoints, &motion, 1e-6, "stops");
        });
    }
}
