//! The status of a run: the positions of the drives, if there are any.
#![expect(clippy::expect_used, reason = "tests fail as tests do")]

use std::time::{Duration, Instant};

use evolvent_bus::Status;
use evolvent_tests::{Domain, Drives, Launch, Workshop, unless_disturbed, wait};

/// Runs a program whose motion begins after 3 s, when drives follow, and returns the statuses in motion.
fn statuses(name: &str, has_drives: bool) -> Vec<Status> {
    let (domain, workshop) = (Domain::new(), Workshop::new());
    let machine = workshop.mill(
        name,
        &[("feedback_timeout_ms = 20 ", "feedback_timeout_ms = 800 ")],
    );
    let _drives = has_drives.then(|| Drives::start(&machine, &domain, &[]));
    let program = workshop.write("part.ngc", "G21 G90 G94\nG4 P3\nG1 X60 Y-20 Z-5 F1800\nM2\n");
    let child = Launch::in_real_time(&program, &machine, &domain)
        .no_trace()
        .start();
    let bus = domain.client(name);
    let mut reader = bus.status().expect("the status");
    let (begin, mut moving) = (Instant::now(), Vec::new());
    while begin.elapsed() < Duration::from_secs(6) {
        let status = reader.latest().expect("the status");
        moving.extend(status.filter(|status| status.velocity != [0.0; 9]));
        std::thread::sleep(Duration::from_millis(5));
    }
    let _finished = wait(child);
    moving
}

#[test]
fn a_run_shows_the_positions_of_its_drives() {
    unless_disturbed(|| {
        let moving = statuses("run-drives", true);
        let with: Vec<&Status> = moving.iter().filter(|status| status.has_feedback()).collect();
        let last = with.last().expect("feedback");
        assert!(last.feedback_age_ns < 800_000_000, "{last:?}");
        assert_eq!(last.enabled_mask, 7, "{last:?}");
        assert!(last.position_actual[0] > 40.0, "{last:?}");
        for status in &with {
            for axis in 0..3 {
                // The drives follow with a delay: at 30 mm/s less than 3 mm in a tenth of a second.
                let off = status.position_actual[axis] - status.position_machine[axis];
                assert!(off.abs() < 3.0, "axis {axis} is off by {off} mm");
            }
        }
    });
}

#[test]
fn a_run_without_drives_shows_no_feedback() {
    let moving = statuses("run-alone", false);
    assert!(!moving.is_empty() && moving.iter().all(|status| !status.has_feedback()));
}
