//! Replies that arrive too late: the cycle has withdrawn their requests, and the planner has to notice.

#![allow(clippy::expect_used, reason = "a test may fail")]

use std::cell::Cell;
use std::rc::Rc;

use evolvent_machine::PlannerKind;
use evolvent_motion::{Inputs, MotionState, PlanConsumer, PlanProducer, QueueClosed, Setpoint, plan_queue};
use evolvent_path::{Axes, Curve, Line, Move};
use evolvent_planner::{PlanSink, Planner, ReplanReply, Step};

use crate::common::{BLEND, Scenario, campaign, check, forward_to_sink, scenario, wave};

/// Loses this many replies, which has the same effect on the cycle as late replies.
struct Losing<S> {
    sink: S,
    left: Rc<Cell<u32>>,
}

impl<S: PlanSink<Error = QueueClosed>> PlanSink for Losing<S> {
    type Error = QueueClosed;

    forward_to_sink!(segment step exit commit mark leave_open reserve_link link has_capacity wait request acknowledged withdrawn reached reached_step);

    fn reply(&mut self, reply: ReplanReply) {
        match self.left.get().checked_sub(1) {
            Some(left) => self.left.set(left),
            None => self.sink.reply(reply),
        }
    }
}

/// Drives the wave while the first `lost` replies get lost.
fn drive(lost: u32, inputs: impl Fn(u64) -> Inputs) -> Vec<Setpoint> {
    drive_along(&wave(700), lost, 0.02, "wave", inputs)
}

type LosingPlanner = Planner<Losing<PlanProducer<fn() -> bool>>>;

/// A planner whose first `lost` replies get lost, its queue, and the number of replies that will still be
/// lost.
fn planner_and_queue(scenario: &Scenario, lost: u32) -> (LosingPlanner, PlanConsumer, Rc<Cell<u32>>) {
    let (producer, queue): (PlanProducer<fn() -> bool>, _) = plan_queue(|| false);
    let left = Rc::new(Cell::new(lost));
    let sink = Losing {
        sink: producer,
        left: Rc::clone(&left),
    };
    (scenario.planner(1.0, sink), queue, left)
}

fn drive_along(
    scenario: &Scenario,
    lost: u32,
    tolerance: f64,
    what: &str,
    inputs: impl Fn(u64) -> Inputs,
) -> Vec<Setpoint> {
    let (mut planner, mut queue, left) = planner_and_queue(scenario, lost);
    for (i, one) in scenario.moves.iter().enumerate() {
        planner.push(one, i as u32 + 1, i as u32).expect("plan");
    }
    planner.finish(9999).expect("plan");
    let mut motion = scenario.motion();
    let mut setpoints: Vec<Setpoint> = Vec::new();
    let mut was_held = false;
    while !motion.is_over() {
        planner.poll().expect("plan");
        let now = inputs(setpoints.len() as u64);
        // At rest no reply is too late.
        if was_held && !now.hold {
            left.set(0);
        }
        was_held = now.hold;
        setpoints.push(motion.step(&now, &mut queue));
        assert!(setpoints.len() < 1_000_000, "{what}: does not end");
    }
    check(scenario, &setpoints, &motion, tolerance, what);
    assert_eq!(motion.state(), MotionState::Done);
    setpoints
}

#[test]
fn a_request_answered_late_is_met_by_a_later_reply() {
    for lost in [1, 2] {
        for factor in [0.5, 1.5] {
            let setpoints = drive(lost, |cycle| Inputs {
                feed_override: if cycle >= 700 { factor } else { 1.0 },
                ..Inputs::default()
            });
            let feed = setpoints[1000].feed_mm_s;
            let wanted = 20.0 * factor;
            assert!(
                (feed - wanted).abs() < 0.05 * wanted,
                "{lost} lost, {factor}: {feed} mm/s"
            );
        }
        let setpoints = drive(lost, |cycle| Inputs {
            hold: (700..1000).contains(&cycle),
            ..Inputs::default()
        });
        assert_eq!(setpoints[900].state, MotionState::Held);
    }
}

#[test]
fn a_withdrawn_request_does_not_block_the_next() {
    let setpoints = drive(1, |cycle| Inputs {
        feed_override: if (700..705).contains(&cycle) || cycle >= 1500 {
            0.5
        } else {
            1.0
        },
        ..Inputs::default()
    });
    for (cycle, wanted) in [(1400, 20.0), (1800, 10.0)] {
        let feed = setpoints[cycle].feed_mm_s;
        assert!((feed - wanted).abs() < 0.05 * wanted, "{feed} mm/s at {cycle}");
    }
}

#[test]
fn overrides_that_were_not_met_make_no_hold_slower() {
    let hold = 745;
    let cycles_to_rest = |lost: u32| {
        let setpoints = drive(lost, |cycle| Inputs {
            feed_override: if cycle >= 700 { 0.9 } else { 1.0 },
            hold: (hold..2500).contains(&cycle),
            ..Inputs::default()
        });
        let rest = (hold as usize..setpoints.len()).find(|&k| setpoints[k].state == MotionState::Held);
        rest.expect("comes to rest") - hold as usize
    };
    // Two leads at most: the request for the override is still open when the hold arrives.
    let (met, lost) = (cycles_to_rest(0), cycles_to_rest(4));
    assert!(lost <= met + 20, "{lost} cycles, {met} where overrides were met");
}

/// Periods from the last setpoint before a hold at this cycle to rest.
fn cycles_to_rest(setpoints: &[Setpoint], hold: usize) -> usize {
    let rest = (hold..setpoints.len()).find(|&k| setpoints[k].state == MotionState::Held);
    rest.expect("comes to rest") - (hold - 1)
}

/// A hold needs no reply: the cycle slows the plan down at once. The bounds leave 24 ms and 1.8 (wave) or 1.2
/// times (line) the minimum time.
#[test]
fn a_hold_without_replies_is_short_and_is_resumed() {
    let holds = |cycle: u64| Inputs {
        hold: (745..2500).contains(&cycle),
        ..Inputs::default()
    };
    let setpoints = drive(9, holds);
    let min_ms = 2e3 * (20.0_f64 / 50_000.0).sqrt();
    let took = cycles_to_rest(&setpoints, 745);
    assert!(took as f64 <= 24.0 + 1.8 * min_ms, "{took} ms on the wave");

    let mut line = wave(1);
    line.moves[0].curve = Curve::Line(
        Line::new(
            Axes::zeros(),
            Axes::from_fn(|i, _| if i == 0 { 400.0 } else { 0.0 }),
        )
        .expect("line"),
    );
    line.moves[0].feed_mm_s = 80.0;
    let setpoints = drive_along(&line, 9, 1e-6, "line", holds);
    let took = cycles_to_rest(&setpoints, 745);
    // 2 sqrt(v/J), if that keeps the acceleration.
    let min_ms = 2e3 * (80.0_f64 / 50_000.0).sqrt();
    assert!(
        took as f64 <= 24.0 + 1.2 * min_ms,
        "{took} ms on a line, {min_ms} at the least"
    );
    assert!(took as f64 >= min_ms, "{took} ms is less than the limits allow");
}

#[test]
fn holds_without_replies_keep_limits_and_path() {
    let (mut random, cases) = campaign(0x9E37_79B9_7F4A_7C15, 40);
    let (mut tried, mut held) = (0, 0);
    while tried < cases {
        let mut one = scenario(&mut random, BLEND, true);
        one.planner = PlannerKind::Optimal;
        one.period_ns = one.period_ns.max(250_000);
        let what = format!("case {tried}");
        // Without holds, to know when it moves.
        let plain = drive_along(&one, 0, 0.02, &what, |_| Inputs::default());
        if plain.len() > 60_000 {
            continue;
        }
        tried += 1;
        let moment = random.pick(plain.len()) as u64;
        let length = 2 + random.pick(1500) as u64;
        let setpoints = drive_along(&one, 1_000, 0.02, &what, |cycle| Inputs {
            hold: (moment..moment + length).contains(&cycle),
            ..Inputs::default()
        });
        held += u32::from(
            setpoints
                .iter()
                .any(|setpoint| setpoint.state == MotionState::Held),
        );
    }
    assert!(held > cases as u32 / 4, "only {held} of {cases} came to rest");
}

/// Motion that is planned after a stop, where the stop was reached before a reply got lost, follows the stop
/// and not the lost plan.
#[test]
fn a_program_ends_after_a_lost_reply_at_any_stop() {
    let line = |from: f64, to: f64| Move {
        curve: Curve::Line(
            Line::new(
                Axes::from_fn(|i, _| if i == 0 { from } else { 0.0 }),
                Axes::from_fn(|i, _| if i == 0 { to } else { 0.0 }),
            )
            .expect("line"),
        ),
        feed_mm_s: 80.0,
        ..wave(1).moves[0]
    };
    let mut scenario = wave(0);
    scenario.moves = vec![line(0.0, 50.0)];
    for (lost, hold, factor) in [(1, true, 1.0), (2, true, 1.0), (1, false, 0.5), (2, false, 0.5)] {
        for (dwell, until) in [None, Some(0.0), Some(0.05)]
            .into_iter()
            .flat_map(|dwell| [(dwell, 303), (dwell, 500)])
        {
            let what = format!("{lost} lost, hold {hold}, dwell {dwell:?}, withdrawn at {until}");
            let (mut planner, mut queue, left) = planner_and_queue(&scenario, lost);
            let step = |seconds: f64| Step::Dwell { seconds, line: 2 };
            planner.push(&scenario.moves[0], 1, 0).expect("plan");
            planner.rest(&step(dwell.unwrap_or_default())).expect("plan");
            let mut motion = scenario.motion();
            let mut setpoints: Vec<Setpoint> = Vec::new();
            while !motion.is_over() {
                let cycle = setpoints.len();
                planner.poll().expect("plan");
                if cycle == 330 {
                    left.set(0);
                    if dwell.is_some() {
                        planner.rest(&step(0.1)).expect("plan");
                    }
                    let back = Move {
                        curve: Curve::Line(
                            Line::new(scenario.moves[0].curve.end(), Axes::zeros()).expect("line"),
                        ),
                        ..scenario.moves[0]
                    };
                    planner.push(&back, 3, 1).expect("plan");
                    planner.finish(9999).expect("plan");
                }
                let inputs = Inputs {
                    hold: hold && (300..until).contains(&cycle),
                    feed_override: if (300..until).contains(&cycle) {
                        factor
                    } else {
                        1.0
                    },
                    ..Inputs::default()
                };
                setpoints.push(motion.step(&inputs, &mut queue));
                assert!(cycle < 10_000, "{what}: does not end");
            }
            assert_eq!(motion.state(), MotionState::Done, "{what}");
            let last = setpoints.last().expect("setpoints");
            assert_eq!(last.position, Axes::zeros(), "{what}");
        }
    }
}
