//! Devices that refuse while the network comes up: the bridge reports what was refused, by which device and
//! why, and comes up once they no longer refuse.
//!
//! Needs the right to create a network namespace.
#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use std::time::{Duration, Instant};

use evolvent_bridge_trial::{Messages, TrialCore};
use evolvent_disturbance::unless_disturbed;
use evolvent_ethercat_ring::{FaultKind, SharedRing, on_bench};

use crate::support::*;

/// Runs cycles until the bridge reports all texts; the core receives nothing meanwhile.
fn until_reported(core: &mut TrialCore, messages: &Messages, texts: &[&str], within: Duration) {
    let begin = Instant::now();
    while !texts.iter().all(|text| messages.contain(text)) {
        core.cycle();
        assert!(begin.elapsed() < within, "{texts:#?}: {messages:#?}");
    }
    assert!(core.newest.is_none(), "no feedback of a network that is not up");
}

/// A fault of a device before the start: the bridge reports these texts, and the network comes up once the
/// fault is over.
fn is_reported_and_ends(kind: FaultKind, device: usize, texts: &'static [&'static str]) {
    unless_disturbed(move || {
        on_bench(devices(), move |ring: &SharedRing| {
            begin(ring, kind, device, None);
            let report = with_bridge(
                |_| {},
                ring,
                |core, ring, messages| {
                    until_reported(core, messages, texts, Duration::from_secs(30));
                    ring.lock().expect("no panic").clear_faults();
                    core.bring_up();
                    assert!(messages.contain("all devices are in OP"), "{messages:?}");
                },
            );
            assert!(report.sessions >= 2 && report.ready == 1, "{report:?}");
        });
    });
}

/// The object and the abort code by its name. The period of a drive may be aborted (60C2h): some take it from
/// SYNC0 alone.
#[test]
fn object_aborted_by_drive_is_named_with_reason() {
    is_reported_and_ends(
        FaultKind::SdoAbort,
        2,
        &["`y-drive`: object 1C12h:0 cannot be written: the device rejects it: 0x08000000: General"],
    );
}

#[test]
fn aborted_object_of_network_file_is_named_too() {
    is_reported_and_ends(
        FaultKind::SdoAbort,
        1,
        &["`x-drive`: object 6065h:0 cannot be written: the device rejects it: 0x08000000: General"],
    );
}

#[test]
fn a_reply_for_another_object_is_named() {
    is_reported_and_ends(
        FaultKind::SdoWrong,
        1,
        &["`x-drive`: object 6065h:0 cannot be written: the device replies for another object"],
    );
}

/// 300 ms for each of some thirty objects: the network comes up slowly, at the first attempt.
#[test]
fn a_slow_mailbox_is_waited_for() {
    unless_disturbed(|| {
        on_bench(devices(), |ring| {
            begin(ring, FaultKind::SlowMailbox, 2, None);
            let report = with_bridge(
                |_| {},
                ring,
                |core, _, messages| {
                    let begin = Instant::now();
                    core.bring_up();
                    assert!(begin.elapsed() > Duration::from_secs(3), "{:?}", begin.elapsed());
                    assert!(messages.contain("all devices are in OP"), "{messages:?}");
                },
            );
            assert_eq!((report.sessions, report.ready), (1, 1), "{report:?}");
        });
    });
}

#[test]
fn device_refusing_safe_op_is_named_with_remedy() {
    is_reported_and_ends(
        FaultKind::RefuseSafeOp,
        2,
        &[
            "a device did not reach SAFE-OP: `y-drive` is in Pre-Operational (0x0024: Invalid Input \
             Mapping): compare its process data",
            "which `--scan` lists",
        ],
    );
}

#[test]
fn device_refusing_op_is_named_with_remedy() {
    is_reported_and_ends(
        FaultKind::RefuseOp,
        3,
        &[
            "a device did not reach OP: `z-drive` is in Safe-Operational (0x0035: DC Invalid Sync Cycle \
             Time): it does not support this period",
            "set `rate` in the machine file",
        ],
    );
}
