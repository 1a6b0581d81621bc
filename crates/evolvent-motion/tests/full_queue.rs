//! A planner so far ahead that the queue is full still answers.

#![allow(clippy::expect_used, reason = "a test may fail")]

mod common;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use common::{BLEND, Scenario, check};
use evolvent_gcode::{Move, MoveKind};
use evolvent_machine::{Limits, PlannerKind};
use evolvent_motion::{Inputs, Setpoint, plan_queue};
use evolvent_path::{AXES, Axes, Curve, Line};

/// How long the planner may keep the cycle waiting before the test gives up.
const PATIENCE: Duration = Duration::from_secs(60);

fn drive(moves: Vec<Move>, wishes: &[Inputs]) {
    let scenario = Scenario {
        limits: Limits {
            present: [true; AXES],
            velocity: Axes::repeat(200.0),
            acceleration: Axes::repeat(2000.0),
            jerk: Axes::repeat(50_000.0),
            travel_min: Axes::repeat(-1e5),
            travel_max: Axes::repeat(1e5),
            home: Axes::zeros(),
        },
        period_ns: 1_000_000,
        moves,
        chord_error_mm: 1e-3,
        planner: PlannerKind::Optimal,
    };
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
        let mut stuck = false;
        for wish in wishes {
            // However many waits it takes: the planner has come to the end of the room.
            let (start, before) = (Instant::now(), waits.load(Ordering::Relaxed));
            while waits.load(Ordering::Relaxed) < before + 50 && start.elapsed() < PATIENCE {
                std::thread::sleep(Duration::from_millis(1));
            }
            assert!(start.elapsed() < PATIENCE, "the queue was never full");
            for _ in 0..200 {
                let since = Instant::now();
                while !motion.is_ready(&mut queue) && !stuck {
                    std::thread::yield_now();
                    stuck = since.elapsed() > PATIENCE;
                }
                if !stuck {
                    setpoints.push(motion.step(wish, &mut queue));
                }
            }
        }
        over.store(true, Ordering::Relaxed);
        planner.join().expect("planner");
        assert!(
            !stuck,
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
        feed,
        path_mode: BLEND,
    }
}

#[test]
fn overrides_are_answered_when_the_queue_is_full_of_steps() {
    let at = |k: usize| {
        let mut point = Axes::zeros();
        (point[0], point[1]) = (k as f64, f64::from(u8::from(k % 2 == 1)));
        point
    };
    let moves = (0..6000).map(|k| line(at(k), at(k + 1), 50.0)).collect();
    let wishes: Vec<_> = (0..5)
        .map(|k| Inputs {
            feed_override: [1.0, 0.5][k % 2],
            ..Inputs::default()
        })
        .collect();
    drive(moves, &wishes);
}
