//! The queue alone, without planner and cycle.

#![allow(clippy::expect_used, reason = "a test may fail")]

use std::cell::Cell;
use std::rc::Rc;

use super::*;
use crate::replan::EMPTY;

fn dwell(line: u32) -> Step {
    Step::Dwell { seconds: 0.1, line }
}

fn request(id: u64) -> ReplanRequest {
    ReplanRequest { id, ..EMPTY }
}

/// Four steps: the first two are final, the others are a tail.
fn four() -> (PlanProducer<fn() -> bool>, PlanConsumer) {
    let (mut producer, consumer) = plan_queue((|| false) as fn() -> bool);
    for line in 0..4 {
        producer.step(&dwell(line)).expect("room");
    }
    producer.leave_open(1);
    producer.commit(2);
    (producer, consumer)
}

#[test]
fn the_successor_of_a_linked_step_is_final() {
    let (mut producer, mut consumer) = four();
    assert_eq!(consumer.successor(0), (1, true));
    assert_eq!(consumer.successor(1), (2, false), "the tail may yet be replaced");
    assert!(producer.link(1, 3));
    assert_eq!(consumer.successor(1), (3, true));
    assert_eq!(consumer.claim_successor(1), (3, true));
    assert!(!consumer.is_claimed(1), "there was nothing to settle");
}

#[test]
fn a_tail_that_was_claimed_cannot_be_skipped_any_more() {
    let (mut producer, mut consumer) = four();
    assert!(!consumer.is_claimed(1));
    assert_eq!(consumer.claim_successor(1), (2, false));
    assert!(consumer.is_claimed(1));
    assert!(!producer.link(1, 3), "the link comes too late");
    assert_eq!(consumer.successor(1), (2, false));
    assert_eq!(consumer.claim_successor(1), (2, false), "a second time");
}

#[test]
fn a_commit_after_a_tail_does_not_commit_the_tail() {
    let (mut producer, consumer) = four();
    producer.step(&dwell(4)).expect("room");
    producer.commit(5);
    assert_eq!(consumer.successor(1), (2, false));
    assert_eq!(consumer.successor(2), (3, true), "within the tail");
    assert!(producer.link(1, 4), "taken up again");
    assert_eq!(consumer.successor(1), (4, true));
    let (mut producer, mut consumer) = four();
    producer.commit(4);
    assert_eq!(consumer.settle_successor(1, false), (2, true), "a tail");
    assert!(!producer.link(1, 3));
    assert_eq!(consumer.settle_successor(0, false), (1, false), "final");
}

#[test]
fn a_step_that_was_not_left_open_is_not_linked() {
    let (mut producer, consumer) = four();
    assert!(!producer.link(0, 2));
    assert_eq!(consumer.successor(0), (1, true));
}

#[test]
fn a_reserved_place_is_occupied_by_its_linked_step() {
    let (mut producer, mut consumer) = plan_queue(|| false);
    producer.step(&dwell(0)).expect("room");
    producer.reserve_link().expect("room");
    producer.commit(2);
    assert_eq!((consumer.occupant(0), consumer.occupant(1)), (Some(0), None));
    // The plan of a reply that is not taken over, and the step after the stop.
    for line in 2..4 {
        producer.step(&dwell(line)).expect("room");
    }
    producer.commit(4);
    assert_eq!((consumer.successor(0), consumer.occupant(1)), ((1, true), None));
    assert!(producer.link(1, 3));
    assert!(!producer.link(1, 2), "there is one");
    assert_eq!(consumer.occupant(1), Some(3));
    assert_eq!(consumer.occupant(3), Some(3), "any other step stands for itself");
    assert_eq!(consumer.occupant(4), Some(4), "also one that has not come");
    producer.step(&Step::Wait).expect("room");
    assert_eq!(consumer.occupant(4), Some(4), "an ordinary wait");
}

#[test]
fn a_step_that_has_not_come_has_no_link_of_an_old_one() {
    let (mut producer, mut consumer) = plan_queue(|| false);
    let size = (PENDING_STEPS + READY_STEPS) as u64;
    producer.reserve_link().expect("room");
    for k in 1..size {
        producer.step(&dwell(k as u32)).expect("room");
    }
    consumer.take(1, 0, 0, 0);
    assert_eq!(consumer.occupant(size), Some(size));
    producer.step(&Step::Wait).expect("room");
    assert_eq!(consumer.occupant(size), Some(size));
}

#[test]
fn the_planner_hears_which_request_was_withdrawn() {
    let (producer, consumer) = four();
    assert_eq!(producer.withdrawn(), 0);
    consumer.withdraw_request(3);
    assert_eq!(producer.withdrawn(), 3);
}

#[test]
fn a_failed_look_makes_later_looks_fail() {
    let (mut producer, mut consumer) = four();
    assert!(producer.link(1, 3));
    consumer.begin_cycle(Some(1));
    assert!(consumer.record_lookup(true));
    assert_eq!(
        consumer.settle_successor(1, false),
        (2, true),
        "the tail that was driven"
    );
    assert_eq!(consumer.claim_successor(1), (2, false));
    assert!(!consumer.record_lookup(true));
    assert_eq!(consumer.failed_lookup(), Some(1));
}

#[test]
fn the_end_of_a_window_is_looked_at_once() {
    let (mut producer, mut consumer) = four();
    producer.step(&dwell(4)).expect("room");
    producer.leave_open(3);
    producer.commit(4);
    assert!(producer.link(1, 3));
    assert_eq!(consumer.settle_successor(1, false), (3, false));
    // In a later cycle, after a look farther ahead has failed.
    consumer.begin_cycle(Some(0));
    assert_eq!(consumer.settle_successor(3, false), (4, true), "a tail");
    assert_eq!(consumer.settle_successor(1, false), (3, false), "known already");
    assert_eq!(consumer.failed_lookup(), Some(0));
}

#[test]
fn a_stop_of_the_path_is_looked_at() {
    let (mut producer, mut consumer) = four();
    producer.commit(4);
    consumer.begin_cycle(Some(1));
    assert_eq!(consumer.settle_successor(2, true), (3, false));
    assert_eq!(consumer.settle_successor(3, true), (4, true));
    assert_eq!(consumer.failed_lookup(), Some(1));
}

#[test]
fn answers_that_nobody_read_leave_room_for_the_next() {
    let (mut producer, mut consumer) = four();
    for id in 1..=2 * REQUESTS as u64 {
        assert!(consumer.send_request(request(id)));
        assert!(producer.request().is_some());
        producer.reply(ReplanReply { id, step: Some(3) });
    }
    let last = 2 * REQUESTS as u64;
    assert!(consumer.reply(last).is_some());
}

#[test]
fn a_claim_with_a_final_successor_settles_nothing() {
    let (_producer, mut consumer) = four();
    assert_eq!(consumer.claim_successor(0), (1, true));
    assert!(!consumer.is_claimed(0));
}

#[test]
fn a_reused_slot_keeps_neither_link_nor_exit() {
    let (mut producer, mut consumer) = plan_queue(|| false);
    let size = (PENDING_STEPS + READY_STEPS) as u64;
    producer.step(&dwell(0)).expect("room");
    producer.exit(
        0,
        ExitSpeeds {
            nominal: 1.0,
            doubled: 2.0,
        },
    );
    assert_eq!((consumer.exit(0).nominal, consumer.exit(0).doubled), (1.0, 2.0));
    producer.leave_open(0);
    assert!(producer.link(0, 5));
    for k in 1..size {
        producer.step(&dwell(k as u32)).expect("room");
    }
    consumer.take(1, 0, 0, 0);
    producer.step(&dwell(7)).expect("room");
    assert_eq!(consumer.successor(size), (size + 1, false));
    assert_eq!(consumer.exit(size), ExitSpeeds::REST);
}

#[test]
fn a_full_queue_waits_and_reports_a_stuck_consumer() {
    let waits = Rc::new(Cell::new(0));
    let counted = Rc::clone(&waits);
    let (mut producer, consumer) = plan_queue(move || {
        counted.set(counted.get() + 1);
        counted.get() < 3
    });
    let size = PENDING_STEPS + READY_STEPS;
    for k in 0..size {
        assert!(producer.has_capacity(1, 0, 0));
        producer.step(&dwell(k as u32)).expect("room");
    }
    assert!(!producer.has_capacity(1, 0, 0) && producer.has_capacity(0, 1, 1));
    assert_eq!(waits.get(), 0);
    assert_eq!(producer.step(&dwell(0)), Err(QueueClosed));
    assert_eq!(waits.get(), 3);
    drop(consumer);
    assert_eq!(producer.wait(), Err(QueueClosed));
    assert_eq!(waits.get(), 3, "a consumer that has gone is not waited for");
}

#[test]
fn taken_steps_are_gone_and_others_keep_their_numbers() {
    let (_producer, mut consumer) = four();
    assert_eq!(consumer.step(2), Some(dwell(2)));
    consumer.take(2, 0, 0, 17);
    assert_eq!(consumer.step(1), None);
    assert_eq!(
        (consumer.step(2), consumer.step(3)),
        (Some(dwell(2)), Some(dwell(3)))
    );
    assert_eq!(consumer.step(4), None);
    assert_eq!(_producer.reached(), 17);
}

#[test]
fn an_ended_planner_is_noticed_and_its_steps_remain() {
    let (mut producer, mut consumer) = four();
    assert!(!consumer.has_no_planner() && !consumer.is_abandoned());
    producer.step(&Step::End { line: 9 }).expect("room");
    assert!(!consumer.is_complete());
    producer.commit(5);
    assert!(consumer.is_complete() && consumer.has_final_ahead(4));
    drop(producer);
    assert!(consumer.has_no_planner());
    assert!(!consumer.is_abandoned(), "the plan is complete");
    assert_eq!(consumer.step(4), Some(Step::End { line: 9 }));
    let (producer, consumer) = four();
    drop(producer);
    assert!(consumer.is_abandoned() && !consumer.is_complete());
}

#[test]
fn only_the_last_request_is_open_and_answered() {
    let (mut producer, mut consumer) = four();
    assert_eq!(producer.request(), None);
    assert!(consumer.send_request(request(1)) && consumer.send_request(request(2)));
    assert_eq!(producer.request(), Some(request(2)));
    assert_eq!(producer.request(), None, "asked once");
    for id in [1, 2] {
        producer.reply(ReplanReply {
            id,
            step: Some(10 + id),
        });
    }
    let reply = consumer.reply(2).expect("a reply");
    assert_eq!((reply.id, reply.step), (2, Some(12)));
    assert_eq!(consumer.reply(2).map(|reply| reply.id), Some(2), "it stays");
    assert_eq!(consumer.reply(3), None);
    assert_eq!(producer.acknowledged(), 0);
    consumer.acknowledge_replan(2);
    assert_eq!(producer.acknowledged(), 2);
}

#[test]
fn requests_are_rejected_when_their_queue_is_full() {
    let (_producer, mut consumer) = four();
    let sent = (1..=20)
        .take_while(|&id| consumer.send_request(request(id)))
        .count();
    assert_eq!(sent, REQUESTS);
}
