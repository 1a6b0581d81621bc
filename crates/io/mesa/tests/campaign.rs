//! Each kind of fault at random moments of a motion, on the simulated board over real sockets. One moment per
//! kind, or `EVOLVENT_CASES` moments.

use std::time::{Duration, Instant};

use evolvent_bridge_trial::{TrialCore, states};
use evolvent_drive::{DriveState, PowerRequest};
use evolvent_mesa_board::{BoardServer, FaultKind};
use evolvent_random::{Random, cases};

use crate::common::core::{STEPS, with_bridge};

/// Maximum distance of X from its start, mm, and its maximum velocity, mm/s.
const REACH: f64 = 40.0;
const FASTEST: f64 = 60.0;
/// Maximum velocity command: 1.2 times the velocity that the machine file permits X, mm/s. An axis whose
/// setpoints or packets were late catches up.
const LIMIT: f64 = 1.2 * 150.0;

/// Steps of the motor of X minus those of its position.
fn ahead(server: &BoardServer, position: f64) -> f64 {
    server.lock().motor_steps(0) - position * STEPS
}

/// One fault while X moves. Either the drives continue with every step, or all stop within 1.5 s; no motor
/// exceeds the highest command; afterwards the axes are enabled again and steps and positions agree. Returns
/// whether the axes were stopped.
fn one_moment(kind: FaultKind, random: &mut Random, core: &mut TrialCore, server: &BoardServer) -> bool {
    let before = core.bring_up();
    let (from, stalls) = (before.position[0], server.lock().motor_stalls(0));
    let ahead_before = ahead(server, from);
    let turn = |core: &mut TrialCore| {
        if (core.position[0] - from) * core.velocity_x > REACH * core.velocity_x.abs() {
            core.velocity_x = -core.velocity_x;
        }
    };
    core.velocity_x = random.between(5.0, FASTEST) * [-1.0, 1.0][random.below(2)];
    for _ in 0..10 + random.below(200) {
        core.cycle();
        turn(core);
    }
    let duration_ns = random.log(1e6, 4e8) as u64;
    server.lock().fault_now(kind, Some(duration_ns));
    let since = Instant::now();
    let mut is_stopped = false;
    while since.elapsed() < Duration::from_nanos(duration_ns) + Duration::from_millis(1500) {
        core.cycle();
        let rates = [0, 1, 2].map(|unit| server.lock().step_rate(unit).abs());
        assert!(
            rates[0] < 1.001 * LIMIT * STEPS && rates[1] < 1.0 && rates[2] < 1.0,
            "{kind:?} for {duration_ns} ns: {rates:?} steps/s"
        );
        let in_operation = core
            .fresh()
            .is_some_and(|feedback| states(&feedback) == [Some(DriveState::OperationEnabled); 3]);
        if !in_operation {
            // As a core does: it stops its axes, and requests power again later.
            (core.velocity_x, core.power) = (0.0, PowerRequest::Off);
            is_stopped = true;
        }
        turn(core);
    }
    if is_stopped {
        let rates = [0, 1, 2].map(|unit| server.lock().step_rate(unit).abs());
        assert!(
            rates.iter().all(|rate| *rate < 1.0),
            "{kind:?} for {duration_ns} ns: {rates:?} steps/s after 1.5 s"
        );
        core.fault_reset += 1;
    } else {
        assert_eq!(
            server.lock().motor_stalls(0),
            stalls,
            "{kind:?} for {duration_ns} ns"
        );
        core.velocity_x = 0.0;
        core.rest(0.3);
    }
    let here = core.bring_up();
    // A new session counts from the present position of the axis.
    if here.instance == before.instance {
        let lost = ahead(server, here.position[0]) - ahead_before;
        assert!(
            lost.abs() <= 2.0,
            "{kind:?} for {duration_ns} ns: {lost} steps lost"
        );
    }
    // The host may keep the core from sending in time, which stops the axes: such a motion is not compared.
    let moved = (0..5).find_map(|_| {
        core.bring_up();
        let (from, motor) = (core.position[0], server.lock().motor_steps(0));
        core.velocity_x = 20.0;
        core.rest(0.3);
        core.velocity_x = 0.0;
        core.rest(0.3);
        let (_, now) = core.newest?;
        let is_following = now.bridge_state == 1 && states(&now) == [Some(DriveState::OperationEnabled); 3];
        let steps = server.lock().motor_steps(0) - motor;
        is_following.then(|| steps - (core.position[0] - from) * STEPS)
    });
    let lost = moved.expect("one of five short moves reaches its end");
    assert!(lost.abs() <= 2.0, "{kind:?}: {lost} steps lost afterwards");
    is_stopped
}

#[test]
fn random_faults_end_in_defined_stop_or_pass() {
    for (kind, name) in FaultKind::ALL {
        with_bridge(
            |_| {},
            |core, server, _| {
                let mut random = Random::seeded(kind as u64);
                let moments = cases(1);
                let stops = (0..moments)
                    .filter(|_| one_moment(kind, &mut random, core, server))
                    .count();
                println!("{name}: {moments} moments, {stops} stops");
            },
        );
    }
}
