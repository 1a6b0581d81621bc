//! Each kind of fault at random moments of a motion, on the simulated ring over real sockets. One moment per
//! kind, or `EVOLVENT_CASES` moments.
//!
//! Needs the right to create a network namespace.

#![expect(clippy::expect_used, reason = "a test")]

use std::time::{Duration, Instant};

use evolvent_bridge_trial::{TrialCore, states};
use evolvent_disturbance::unless_disturbed;
use evolvent_drive::{DriveState, PowerRequest};
use evolvent_ethercat_ring::{DriveSettings, FaultKind, SharedRing, on_bench};
use evolvent_random::{Random, cases};

use crate::support::*;

/// Travel in use and maximum velocity of X, mm and mm/s.
const REACH: f64 = 100.0;
const FASTEST: f64 = 60.0;
/// Gain of the drives' position loop, 1/s, and the longest time without a target that does not end the
/// session: 20 cycles, s.
const POSITION_GAIN: f64 = 80.0;
const LONGEST_LOSS_S: f64 = 20.0 * 2e-3;
/// Lead of X, mm per turn; the drives' window of following errors (6065h) is one turn too.
const LEAD_MM: f64 = 5.0;
/// Time for which the following error may exceed that window (6066h), s.
const FOLLOWING_TIMEOUT_S: f64 = 0.02;

fn turns(ring: &SharedRing) -> f64 {
    let ring = ring.lock().expect("no panic");
    ring.devices()[1]
        .as_drive()
        .map_or(0.0, |drive| drive.motor_turns())
}

/// One fault while X moves. Either the drives continue, or all stop within 2.5 s; no motor exceeds the
/// commanded velocity, except to catch up; afterwards the axes are enabled again at the positions of their
/// motors. Returns whether the axes were stopped.
fn one_moment(kind: FaultKind, random: &mut Random, core: &mut TrialCore, ring: &SharedRing) -> bool {
    core.bring_up();
    // Away from the nearer end.
    let speed = random.between(5.0, FASTEST);
    core.velocity_x = if core.position[0] > 0.0 { -speed } else { speed };
    for _ in 0..10 + random.below(200) {
        core.cycle();
        if core.position[0].abs() > REACH {
            core.velocity_x = -core.velocity_x.abs() * core.position[0].signum();
        }
    }
    let device = match kind {
        FaultKind::Loss | FaultKind::Delay | FaultKind::Reorder => 0,
        _ => 1 + random.below(3),
    };
    let duration_ns = random.log(1e6, 4e8) as u64;
    // Drives whose targets were lost for some cycles, but for fewer than end the session, catch up the
    // distance that their position loop sees.
    let highest = match kind {
        FaultKind::Loss
        | FaultKind::Delay
        | FaultKind::Reorder
        | FaultKind::WorkingCounter
        | FaultKind::Break
        | FaultKind::Gone => FASTEST * (1.0 + POSITION_GAIN * LONGEST_LOSS_S),
        // A released load follows its target again, from the lag that the drive's window of following errors
        // allows.
        FaultKind::Blocked => FASTEST + POSITION_GAIN * (LEAD_MM + FASTEST * FOLLOWING_TIMEOUT_S),
        _ => 1.3 * FASTEST,
    };
    begin(ring, kind, device, Some(duration_ns));
    let since = Instant::now();
    let mut is_stopped = false;
    while since.elapsed() < Duration::from_nanos(duration_ns) + Duration::from_millis(2500) {
        core.cycle();
        let speeds = speeds(ring);
        let fastest = speeds.iter().fold(0.0_f64, |max, speed| max.max(*speed));
        assert!(
            fastest * LEAD_MM < highest,
            "{kind:?} for {duration_ns} ns: {fastest} turns/s"
        );
        let in_operation = core
            .fresh()
            .is_some_and(|feedback| states(&feedback) == [Some(DriveState::OperationEnabled); 3]);
        if !in_operation {
            // As a core does: it stops its axes, and requests power again later.
            (core.velocity_x, core.power) = (0.0, PowerRequest::Off);
            is_stopped = true;
        }
        if core.position[0].abs() > REACH {
            core.velocity_x = -core.velocity_x.abs() * core.position[0].signum();
        }
    }
    if is_stopped {
        let speeds = speeds(ring);
        assert!(
            speeds.iter().all(|speed| *speed < 0.02),
            "{kind:?} at device {device} for {duration_ns} ns: {speeds:?} turns/s after 2.5 s"
        );
        core.fault_reset += 1;
    } else {
        core.velocity_x = 0.0;
    }
    let here = core.bring_up();
    let off = here.position[0] - turns(ring) * LEAD_MM;
    assert!(
        off.abs() < 5e-3,
        "{kind:?}: X is said to be {off} mm from where its motor is"
    );
    is_stopped
}

#[test]
fn random_faults_end_in_defined_stop_or_pass() {
    const KINDS: [FaultKind; 10] = [
        FaultKind::Loss,
        FaultKind::Delay,
        FaultKind::Reorder,
        FaultKind::WorkingCounter,
        FaultKind::Break,
        FaultKind::Gone,
        FaultKind::Drive,
        FaultKind::Temperature,
        FaultKind::TorqueOff,
        FaultKind::Blocked,
    ];
    // Drives that lose their position with their supply are covered by another test: their axes must be homed
    // again.
    let absolute = DriveSettings {
        absolute: true,
        ..DriveSettings::default()
    };
    for kind in KINDS {
        unless_disturbed(move || {
            on_bench(devices_of(absolute), move |ring| {
                with_bridge(
                    |_| {},
                    ring,
                    |core, ring, _| {
                        let mut random = Random::seeded(kind as u64);
                        let moments = cases(1);
                        let stops = (0..moments)
                            .filter(|_| one_moment(kind, &mut random, core, ring))
                            .count();
                        println!("{kind:?}: {moments} moments, {stops} stops");
                    },
                );
            });
        });
    }
}
