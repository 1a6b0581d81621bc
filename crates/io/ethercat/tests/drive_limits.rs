//! Limits that simulated drives report (6080h, 607Fh, 60C5h, 6085h), compared with the machine file when the
//! network comes up.
//!
//! Needs the right to create a network namespace.

use std::time::{Duration, Instant};

use evolvent_bridge_trial::{Messages, TrialCore};
use evolvent_disturbance::unless_disturbed;
use evolvent_ethercat_ring::{DriveSettings, SubDevice, on_bench};

use crate::support::{devices, with_bridge};

/// Runs a test with a bridge to the mill whose drive of X has these settings; its network comes up `ready`
/// times.
fn with_x(settings: DriveSettings, ready: u64, test: fn(&mut TrialCore, &Messages)) {
    unless_disturbed(|| {
        let mut devices = devices();
        devices[1] = SubDevice::drive(settings, 2, 0.0);
        on_bench(devices, move |ring| {
            let report = with_bridge(|_| {}, ring, |core, _, messages| test(core, messages));
            assert_eq!(report.ready, ready, "{report:?}");
        });
    });
}

/// 500 mm/s on a screw of 5 mm are 6000 rpm.
#[test]
fn motor_that_is_too_slow_for_its_axis_is_refused() {
    let settings = DriveSettings {
        max_motor_rpm: Some(4800),
        ..DriveSettings::default()
    };
    with_x(settings, 0, |core, messages| {
        let expected = "`x-drive`: the machine file permits X 500 mm/s, the maximum motor speed of the drive \
                        (6080h), 4800 rpm, is 400 mm/s";
        let begin = Instant::now();
        while !messages.contain(expected) {
            core.cycle();
            assert!(begin.elapsed() < Duration::from_secs(20), "{messages:#?}");
        }
    });
}

/// Profile limits and the quick stop are noted, once, for X only; the network comes up. A motor that is just
/// fast enough is no fault.
#[test]
fn limits_of_profiles_are_noted() {
    let settings = DriveSettings {
        max_motor_rpm: Some(6000),
        max_profile_turns_s: Some(90),
        max_turns_s2: Some(900),
        quick_stop_turns_s2: 200,
        ..DriveSettings::default()
    };
    with_x(settings, 1, |core, messages| {
        core.bring_up();
        for expected in [
            "drive of X: its maximum profile velocity (607Fh) is 450 mm/s, the machine file permits 500",
            "drive of X: its maximum acceleration (60C5h) is 4500 mm/s2, the machine file permits 5000",
            "drive of X: its quick stop (6085h) brakes with 1000 mm/s2, less than the 5000 of the machine \
             file: from 500 mm/s it takes 0.50 s",
        ] {
            assert!(messages.contain(expected), "{expected}: {messages:#?}");
        }
        for other in ["drive of Y", "drive of Z"] {
            assert!(!messages.contain(other), "{messages:#?}");
        }
    });
}
