//! The cycle's end neither allocates nor frees, whatever is scheduled.

use evolvent_counting::{CountingAllocator, calls};
use evolvent_machine::{SignalKind, SignalSettings};
use evolvent_signals::{
    Awaited, InputImage, InputWait, OutputChange, Phase, Progress, SignalMoment, Signals, WaitMode, schedule,
};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

#[test]
fn a_full_queue_runs_in_order_without_allocation() {
    let mut signals = Signals::new(&SignalSettings::default(), 2, 1_000_000);
    let (mut scheduler, consumer) = schedule();
    assert!(signals.begin_program(consumer).is_none());
    let blocks = 100_000;
    for block in 0..blocks {
        let mut change = OutputChange::at(SignalMoment::Block(block));
        change.set_digital(block % 64, block / 64 % 2 == 0);
        change.set_analog(block % 16, f64::from(block));
        assert!(scheduler.change(change), "no room at {block}");
    }
    let wait = InputWait {
        action: 0,
        awaited: Awaited::Input {
            kind: SignalKind::Digital,
            number: 3,
            mode: WaitMode::High,
        },
        timeout_cycles: 1000,
    };
    assert!(scheduler.wait(wait));
    let mut last = OutputChange::at(SignalMoment::Rest(1));
    last.set_digital(0, true);
    assert!(scheduler.change(last));
    let mut inputs = InputImage::default();
    let before = calls();
    let at = |blocks, actions| Progress {
        actions,
        blocks,
        phase: Phase::Runs,
        x_mm: 0.0,
    };
    for block in 0..blocks {
        let outputs = signals.step(&at(block + 1, 0));
        assert_eq!(outputs.analog[block as usize % 16], f64::from(block));
    }
    for _ in 0..10 {
        signals.step(&at(blocks, 1));
    }
    assert!(signals.is_waiting() && !signals.is_over());
    inputs.set(SignalKind::Digital, 3, Some(1.0));
    signals.observe(&inputs);
    signals.step(&at(blocks, 1));
    assert!(signals.take_resume());
    let outputs = signals.step(&at(blocks, 2));
    assert_eq!(calls() - before, 0, "calls of the allocator");
    assert_eq!(outputs.digital & 1, 1);
    let result = scheduler.result().unwrap();
    assert_eq!((result.action, result.value), (0, Some(1.0)));
}

#[test]
fn a_wait_begins_a_lead_later_and_ends_by_its_timeout() {
    for lead in [0, 1, 70] {
        let mut signals = Signals::new(&SignalSettings::default(), lead, 1_000_000);
        let (mut scheduler, consumer) = schedule();
        assert!(signals.begin_program(consumer).is_none());
        let wait = InputWait {
            action: 4,
            awaited: Awaited::Input {
                kind: SignalKind::Digital,
                number: 0,
                mode: WaitMode::Low,
            },
            timeout_cycles: 25,
        };
        assert!(scheduler.wait(wait));
        let progress = |actions| Progress {
            actions,
            blocks: 0,
            phase: Phase::Runs,
            x_mm: 0.0,
        };
        signals.step(&progress(4));
        assert!(!signals.is_waiting());
        let mut cycles = 0;
        while !signals.is_over() {
            signals.step(&progress(5));
            cycles += 1;
        }
        // One setpoint at which the wait begins, the lead, and its time.
        assert_eq!(cycles, 1 + u64::from(lead) + 25, "lead {lead}");
        assert_eq!(scheduler.result().unwrap().value, None);
    }
}
