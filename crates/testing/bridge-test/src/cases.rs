//! The cases themselves. Each starts its bridge and its core, and judges by the feedback.

use core::time::Duration;

use evolvent_bridge_sim::monotonic_ns;
use evolvent_bus::Feedback;
use evolvent_drive::{BridgeState, DriveState, PowerRequest};

use crate::case::{CaseError, Stage};
use crate::core_process::CoreProcess;
use crate::test_core::{Fate, LATEST_S, LEAD, PERIOD_NS, Seen, TestCore, is_following, states};
pub(crate) use crate::timing::due;

pub(crate) type Judged = Result<(), CaseError>;

/// Way of the moves, mm.
const WAY: f64 = 5.0;
/// How far an axis may be off its setpoint at rest, mm.
const CLOSE: f64 = 0.2;
/// How far an axis may go on by itself, mm: the moves are slow.
const ALONE: f64 = 6.0;

pub(crate) fn demand(good: bool, what: impl FnOnce() -> String) -> Judged {
    if good { Ok(()) } else { Err(CaseError::new(what())) }
}

pub(crate) fn up(stage: &mut Stage<'_>) -> Result<TestCore, CaseError> {
    stage.start_bridge()?;
    let mut core = stage.open_core()?;
    core.bring_up()?;
    let _before = core.take_log();
    Ok(core)
}

/// The axes get where they are sent.
pub(crate) fn follows(core: &mut TestCore) -> Judged {
    for by in [WAY, -WAY] {
        core.move_by(by, 0.4, &mut |_| Fate::Sent);
        // What was sent is due a lead later.
        core.rest((LEAD * PERIOD_NS) as f64 * 1e-9 + 0.3);
        let (wanted, found) = (
            core.commanded(),
            core.feedback()
                .map_or([f64::NAN; 9], |feedback| feedback.position),
        );
        for axis in 0..3 {
            let off = (wanted[axis] - found[axis]).abs();
            demand(off <= CLOSE, || {
                format!("axis {axis} is {off:.3} off after a move; {}", core.describe())
            })?;
        }
    }
    Ok(())
}

/// The distance between the ends of the positions of the axis that moved most.
fn extent(log: &[Seen]) -> f64 {
    let of = |axis: usize| {
        let positions = log.iter().map(move |seen| seen.feedback.position[axis]);
        positions.clone().fold(f64::MIN, f64::max) - positions.fold(f64::MAX, f64::min)
    };
    (0..3).map(of).fold(0.0, f64::max)
}

fn stands(feedback: &Feedback) -> bool {
    feedback.velocity[..3].iter().all(|velocity| velocity.abs() < 0.1)
}

/// At rest and not following: what a bridge shows when it has stopped by itself.
fn has_stopped(feedback: &Feedback) -> bool {
    stands(feedback) && BridgeState::from_number(feedback.bridge_state) != Some(BridgeState::Following)
}

pub(crate) fn bridge_first(stage: &mut Stage<'_>) -> Judged {
    stage.start_bridge()?;
    std::thread::sleep(Duration::from_millis(700));
    demand(stage.bridge.is_running(), || {
        "the bridge did not wait for its core".to_owned()
    })?;
    let mut core = stage.open_core()?;
    core.bring_up()?;
    follows(&mut core)
}

pub(crate) fn core_first(stage: &mut Stage<'_>) -> Judged {
    let mut core = stage.open_core()?;
    core.rest(0.5);
    stage.start_bridge()?;
    core.bring_up()?;
    follows(&mut core)
}

pub(crate) fn feedback(stage: &mut Stage<'_>) -> Judged {
    let mut core = up(stage)?;
    let begin_ns = monotonic_ns();
    core.swing(WAY, 1.5, &mut |_| Fate::Sent);
    // One that does not run just now is heard to the end.
    core.rest(0.1);
    let log = core.take_log();
    let expected = (monotonic_ns() - begin_ns) / PERIOD_NS;
    demand(log.len() as u64 >= expected * 8 / 10, || {
        format!("{} answers to {expected} setpoints", log.len())
    })?;
    let mut last: Option<Seen> = None;
    let mut stale = 0;
    for seen in &log {
        let feedback = &seen.feedback;
        demand(feedback.axes_mask & 0b111 == 0b111, || {
            format!("axes mask {:#b}", feedback.axes_mask)
        })?;
        demand(feedback.is_finite(), || "a number that is not finite".to_owned())?;
        stale += u32::from(seen.now_ns.abs_diff(feedback.time_ns) > 100_000_000);
        if let Some(last) = last {
            demand(feedback.sequence >= last.feedback.sequence, || {
                format!("answers {} after {}", feedback.sequence, last.feedback.sequence)
            })?;
            demand(feedback.time_ns > last.feedback.time_ns, || {
                "time_ns does not grow".to_owned()
            })?;
            demand(feedback.instance == last.feedback.instance, || {
                "the instance changes without a restart".to_owned()
            })?;
        }
        last = Some(*seen);
    }
    demand(u64::from(stale) * 20 < log.len() as u64, || {
        format!(
            "{stale} of {} samples are more than 0.1 s off CLOCK_MONOTONIC",
            log.len()
        )
    })
}

pub(crate) fn power(stage: &mut Stage<'_>) -> Judged {
    let mut core = up(stage)?;
    core.rest(0.3);
    let moved = extent(&core.take_log());
    demand(moved <= CLOSE, || {
        format!("switching on moved the axis by {moved:.3}")
    })?;
    core.request(PowerRequest::QuickStop);
    core.until("out of operation after a quick stop", LATEST_S, |feedback| {
        stands(feedback) && states(feedback).all(|state| state != Some(DriveState::OperationEnabled))
    })?;
    core.request(PowerRequest::On);
    core.rest(0.5);
    let still_off = core
        .feedback()
        .is_some_and(|feedback| states(feedback).all(|state| state != Some(DriveState::OperationEnabled)));
    demand(still_off, || {
        "power came back after a quick stop without having been requested off".to_owned()
    })?;
    core.bring_up()?;
    follows(&mut core)
}

/// How long a quick stop may take to show, ns: much less than the lead, after which it is due.
const AT_ONCE_NS: u64 = 120_000_000;
const _: () = assert!(AT_ONCE_NS < LEAD * PERIOD_NS * 3 / 4);
/// A jump that persists, mm.
const JUMP: f64 = 2.0;
/// Way in which an axis stops from the middle of a move of 0.6 s, with ten periods for which it goes on, mm.
const ROLLING: f64 = 1.2;
/// From where on a setpoint is elsewhere, mm: a bridge may begin within 1 mm, and a drive may hold that little besides its position.
const ELSEWHERE: f64 = 1.0 + CLOSE;
/// Speed of setpoints that pass by, mm/s.
const PASSING: f64 = 20.0;
/// How much later than due setpoints come that are too late, ns: a bridge may wait for them for some periods, with a busy host in mind,
/// and no longer.
const TOO_LATE_NS: [u64; 2] = [30 * PERIOD_NS, 500_000_000];

pub(crate) fn begin(stage: &mut Stage<'_>) -> Judged {
    let mut core = up(stage)?;
    let silence = |core: &mut TestCore| {
        core.rest_with(1.0, &mut |_| Fate::Lost);
        let seen = core.feedback().copied();
        let _before = core.take_log();
        seen.ok_or_else(|| CaseError::new("no feedback any more without setpoints"))
    };
    for (axis, off) in [(0, ELSEWHERE), (1, -ELSEWHERE), (2, ELSEWHERE)] {
        let here = silence(&mut core)?.position[axis];
        begins_elsewhere(&mut core, 0.6, axis, here + off)?;
    }
    // The drives are off, and on again: by the position that the bridge reports while they are off.
    core.request(PowerRequest::Off);
    let here = core.until("drives out of operation", LATEST_S, |feedback| {
        stands(feedback) && states(feedback).all(|state| state != Some(DriveState::OperationEnabled))
    })?;
    core.request(PowerRequest::On);
    let _before = core.take_log();
    begins_elsewhere(&mut core, 1.5, 0, here.position[0] + ELSEWHERE)?;
    let here = silence(&mut core)?.position[0];
    let mut count = 0;
    core.rest_with(0.6, &mut |setpoint| {
        setpoint.position[0] = here + PASSING * f64::from(count) * PERIOD_NS as f64 * 1e-9;
        setpoint.velocity[0] = PASSING;
        count += 1;
        Fate::Sent
    });
    let moved = extent(&core.take_log());
    demand(moved <= CLOSE, || {
        format!("moved by {moved:.3} with setpoints that begin at {PASSING} mm/s")
    })?;
    core.bring_up()?;
    follows(&mut core)
}

/// Setpoints at rest that begin elsewhere for an axis: the bridge neither moves nor says that it follows them.
fn begins_elsewhere(core: &mut TestCore, seconds: f64, axis: usize, position: f64) -> Judged {
    core.rest_with(seconds, &mut |setpoint| {
        setpoint.position[axis] = position;
        Fate::Sent
    });
    let log = core.take_log();
    let moved = extent(&log);
    demand(moved <= CLOSE, || {
        format!("moved by {moved:.3} towards setpoints that begin {ELSEWHERE} mm from axis {axis}")
    })?;
    let says = log.last().is_some_and(|seen| is_following(&seen.feedback));
    demand(!says, || {
        format!("says that it follows setpoints that begin {ELSEWHERE} mm from axis {axis}")
    })
}

pub(crate) fn quick_stop(stage: &mut Stage<'_>) -> Judged {
    let mut core = up(stage)?;
    core.rest(0.3);
    let _before = core.take_log();
    let asked_ns = monotonic_ns();
    core.request(PowerRequest::QuickStop);
    let stopped =
        |feedback: &Feedback| states(feedback).all(|state| state != Some(DriveState::OperationEnabled));
    core.until("out of operation after a quick stop", LATEST_S, stopped)?;
    let first = core.take_log().into_iter().find(|seen| stopped(&seen.feedback));
    let took_ns = first.map_or(u64::MAX, |seen| seen.feedback.time_ns.saturating_sub(asked_ns));
    demand(took_ns <= AT_ONCE_NS, || {
        format!(
            "a quick stop showed after {} ms, when it was due, and not at once",
            took_ns / 1_000_000
        )
    })?;
    core.bring_up()?;
    follows(&mut core)
}

pub(crate) fn fault_reset(stage: &mut Stage<'_>) -> Judged {
    let mut core = up(stage)?;
    core.request(PowerRequest::Off);
    for _ in 0..2 {
        let number = core.reset_faults();
        core.until(
            "the number of the reset in fault_reset_done",
            LATEST_S,
            |feedback| feedback.fault_reset_done == number,
        )?;
    }
    core.bring_up()?;
    follows(&mut core)
}

pub(crate) fn gaps(stage: &mut Stage<'_>) -> Judged {
    let mut core = up(stage)?;
    let before = core.feedback().map_or(0, |feedback| feedback.missed_setpoints);
    let mut lost = 0;
    core.swing(WAY, 1.0, &mut |setpoint| {
        if setpoint.sequence % 40 == 7 {
            lost += 1;
            return Fate::Lost;
        }
        Fate::Sent
    });
    core.rest(0.3);
    let log = core.take_log();
    let stopped = log.iter().find(|seen| {
        !matches!(
            BridgeState::from_number(seen.feedback.bridge_state),
            Some(BridgeState::Following | BridgeState::Bridging)
        )
    });
    demand(stopped.is_none(), || {
        format!("single missing setpoints stopped the bridge; {}", core.describe())
    })?;
    let counted = core.feedback().map_or(0, |feedback| feedback.missed_setpoints) - before;
    demand(counted >= lost, || {
        format!("{lost} setpoints were missing, {counted} were counted")
    })?;
    follows(&mut core)
}

pub(crate) fn silence(stage: &mut Stage<'_>) -> Judged {
    let mut core = up(stage)?;
    // In the middle of a move, at its highest speed.
    let (from, mut sent, half) = (core.commanded()[0], 0, 0.5e9 as u64 / PERIOD_NS / 2);
    core.move_by(WAY, 0.5, &mut |_| {
        sent += 1;
        if sent < half { Fate::Sent } else { Fate::Lost }
    });
    core.rest_with(1.0, &mut |_| Fate::Lost);
    let seen = core
        .feedback()
        .copied()
        .ok_or_else(|| CaseError::new("no feedback any more without setpoints"))?;
    demand(has_stopped(&seen), || {
        format!("does not stand 1 s after the last setpoint; {}", core.describe())
    })?;
    let way = (seen.position[0] - from).abs();
    demand(way <= WAY / 2.0 + ALONE, || format!("went {way:.3} by itself"))?;
    // The core goes on as if nothing had been, elsewhere.
    let _before = core.take_log();
    core.rest_with(0.5, &mut |setpoint| {
        setpoint.position[0] += 4.0 * ALONE;
        Fate::Sent
    });
    let moved = extent(&core.take_log());
    demand(moved <= CLOSE, || {
        format!("moved by {moved:.3} towards setpoints that begin elsewhere")
    })?;
    core.bring_up()?;
    follows(&mut core)
}

pub(crate) fn late(stage: &mut Stage<'_>) -> Judged {
    let mut core = up(stage)?;
    let before = core.feedback().map_or(0, |feedback| feedback.missed_setpoints);
    // A smooth way, as any other, but each setpoint some time after it was due.
    core.rest(0.2);
    for late_ns in TOO_LATE_NS {
        // What was sent before is due, and the axes stand.
        core.rest((LEAD * PERIOD_NS) as f64 * 1e-9);
        let _before = core.take_log();
        for by in [WAY, -WAY] {
            core.move_by(by, 0.4, &mut |setpoint| {
                setpoint.due_time_ns -= LEAD * PERIOD_NS + late_ns;
                Fate::Sent
            });
        }
        let moved = extent(&core.take_log());
        demand(moved <= CLOSE, || {
            format!(
                "followed setpoints that came {} ms late for {moved:.3}",
                late_ns / 1_000_000
            )
        })?;
        core.bring_up()?;
    }
    // Due two seconds ago, and somewhere else.
    core.rest_with(0.6, &mut |setpoint| {
        setpoint.due_time_ns -= 2_000_000_000;
        setpoint.position[0] += WAY;
        Fate::Sent
    });
    let moved = extent(&core.take_log());
    demand(moved <= CLOSE, || {
        format!("setpoints of the past moved the axis by {moved:.3}")
    })?;
    let counted = core.feedback().map_or(0, |feedback| feedback.missed_setpoints);
    demand(counted > before, || "late setpoints are not counted".to_owned())?;
    core.bring_up()?;
    follows(&mut core)
}

pub(crate) fn jump(stage: &mut Stage<'_>) -> Judged {
    let mut core = up(stage)?;
    // One wild setpoint among good ones.
    core.rest(0.1);
    let mut count = 0;
    core.rest_with(0.4, &mut |setpoint| {
        count += 1;
        if count == 20 {
            setpoint.position[0] += 400.0;
        }
        Fate::Sent
    });
    let moved = extent(&core.take_log());
    demand(moved <= CLOSE, || {
        format!("one wild setpoint moved the axis by {moved:.3}")
    })?;
    // From here on all of them.
    core.rest_with(0.6, &mut |setpoint| {
        setpoint.position[0] += 400.0;
        Fate::Sent
    });
    let moved = extent(&core.take_log());
    demand(moved <= CLOSE, || {
        format!("a jump by 400 mm was followed for {moved:.3}")
    })?;
    core.bring_up()?;
    // Jumps that an axis could go in the time for which a bridge waits for setpoints.
    for by in [ELSEWHERE, -JUMP] {
        let _before = core.take_log();
        core.rest_with(0.6, &mut |setpoint| {
            setpoint.position[0] += by;
            Fate::Sent
        });
        let moved = extent(&core.take_log());
        demand(moved <= CLOSE, || {
            format!("a jump by {by} mm that persists was followed for {moved:.3}")
        })?;
        core.bring_up()?;
    }
    // The same in motion, from the middle of a move on.
    let _before = core.take_log();
    let (mut sent, half) = (0, 0.6e9 as u64 / PERIOD_NS / 2);
    core.move_by(WAY, 0.6, &mut |setpoint| {
        sent += 1;
        setpoint.position[0] += if sent > half { JUMP } else { 0.0 };
        Fate::Sent
    });
    let end = core.commanded()[0];
    core.rest_with(0.6, &mut |setpoint| {
        setpoint.position[0] = end + JUMP;
        Fate::Sent
    });
    let moved = extent(&core.take_log());
    demand(moved <= WAY / 2.0 + ROLLING, || {
        format!(
            "went {moved:.3} in a move with a jump by {JUMP} mm after {} mm",
            WAY / 2.0
        )
    })?;
    core.bring_up()?;
    follows(&mut core)
}

pub(crate) fn not_finite(stage: &mut Stage<'_>) -> Judged {
    let mut core = up(stage)?;
    let mut count = 0_usize;
    core.rest_with(0.5, &mut |setpoint| {
        let wrong = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY][count % 3];
        match count / 3 % 3 {
            0 => setpoint.position[count % 2] = wrong,
            1 => setpoint.velocity[count % 3] = wrong,
            _ => setpoint.acceleration[0] = wrong,
        }
        count += 1;
        Fate::Sent
    });
    let log = core.take_log();
    demand(log.iter().all(|seen| seen.feedback.is_finite()), || {
        "answers with a number that is not finite".to_owned()
    })?;
    let moved = extent(&log);
    demand(moved <= CLOSE, || {
        format!("moved by {moved:.3} at numbers that are none")
    })?;
    core.bring_up()?;
    follows(&mut core)
}

pub(crate) fn version(stage: &mut Stage<'_>) -> Judged {
    let mut core = up(stage)?;
    for (interface_version, struct_size) in [(2, 400), (1, 392), (0, 0)] {
        core.move_by(WAY, 0.3, &mut |setpoint| {
            (setpoint.interface_version, setpoint.struct_size) = (interface_version, struct_size);
            Fate::Sent
        });
        core.move_by(-WAY, 0.3, &mut |setpoint| {
            (setpoint.interface_version, setpoint.struct_size) = (interface_version, struct_size);
            Fate::Sent
        });
    }
    let moved = extent(&core.take_log());
    demand(moved <= CLOSE, || {
        format!("another version's setpoints moved the axis by {moved:.3}")
    })?;
    demand(stage.bridge.is_running(), || "the bridge has ended".to_owned())?;
    core.bring_up()?;
    follows(&mut core)
}

pub(crate) fn datum(stage: &mut Stage<'_>) -> Judged {
    let mut core = up(stage)?;
    core.rest(0.2);
    let before = core
        .feedback()
        .copied()
        .ok_or_else(|| CaseError::new("no feedback"))?;
    core.rename(100.0);
    let after = core.until("the new datum in the feedback", LATEST_S, |feedback| {
        feedback.datum == before.datum + 1
    })?;
    let shift = after.position[0] - before.position[0];
    demand((shift - 100.0).abs() <= CLOSE, || {
        format!("a shift of 100 shows as {shift:.3} in the positions")
    })?;
    demand(is_following(&after), || core.describe())?;
    let log = core.take_log();
    let fastest = log
        .iter()
        .map(|seen| seen.feedback.velocity[0].abs())
        .fold(0.0, f64::max);
    demand(fastest < 1.0, || {
        format!("the axis moved at {fastest:.3} mm/s for a new name")
    })?;
    follows(&mut core)
}

pub(crate) fn core_restart(stage: &mut Stage<'_>) -> Judged {
    stage.start_bridge()?;
    for _ in 0..stage.moments {
        let mut core = stage.open_core()?;
        core.bring_up()?;
        let seconds = stage.between(0.05, 0.5);
        core.move_by(WAY * seconds, seconds, &mut |_| Fate::Sent);
        drop(core);
        let pause = stage.between(0.0, 0.3);
        std::thread::sleep(Duration::from_secs_f64(pause));
    }
    let mut core = stage.open_core()?;
    core.bring_up()?;
    follows(&mut core)
}

pub(crate) fn bridge_restart(stage: &mut Stage<'_>) -> Judged {
    restart(stage, false)
}

pub(crate) fn bridge_kill(stage: &mut Stage<'_>) -> Judged {
    restart(stage, true)
}

fn restart(stage: &mut Stage<'_>, by_kill: bool) -> Judged {
    let mut core = stage.open_core()?;
    let mut instances = Vec::new();
    for _ in 0..stage.moments {
        stage.start_bridge()?;
        core.bring_up()?;
        instances.extend(core.feedback().map(|feedback| feedback.instance));
        let seconds = stage.between(0.05, 0.5);
        core.move_by(WAY * seconds, seconds, &mut |_| Fate::Sent);
        if by_kill {
            stage.bridge.kill();
        } else {
            stage.bridge.end();
        }
    }
    stage.start_bridge()?;
    core.bring_up()?;
    instances.extend(core.feedback().map(|feedback| feedback.instance));
    let repeated = instances.windows(2).any(|pair| pair[0] == pair[1]);
    demand(!repeated, || {
        "the instance is the same after a restart".to_owned()
    })?;
    follows(&mut core)
}

pub(crate) fn core_kill(stage: &mut Stage<'_>) -> Judged {
    let program = stage
        .core_program
        .clone()
        .ok_or_else(|| CaseError::new("no program to play the core"))?;
    stage.start_bridge()?;
    let mut before = 0.0;
    for _ in 0..stage.moments {
        let mut process = CoreProcess::start(&program, &stage.machine_name, &stage.prefix)?;
        let seconds = stage.between(0.3, 1.8);
        std::thread::sleep(Duration::from_secs_f64(seconds));
        process.kill();
        let pause = stage.between(0.0, 0.3);
        std::thread::sleep(Duration::from_secs_f64(pause));
        // The next core finds the axes stopped, or stopping, where the last one had sent them.
        let mut core = stage.open_core()?;
        core.until("feedback after the core was killed", LATEST_S, |_| true)?;
        core.rest(0.6);
        let here = core
            .feedback()
            .copied()
            .ok_or_else(|| CaseError::new("no feedback"))?;
        demand(stands(&here), || {
            format!("still moves after its core was killed; {}", core.describe())
        })?;
        // A core process starts where the axes are and moves by 8 mm at the most.
        let way = (here.position[0] - before).abs();
        demand(way <= 8.0 + ALONE, || {
            format!("is {way:.3} from where its core began")
        })?;
        before = here.position[0];
    }
    let mut core = stage.open_core()?;
    core.bring_up()?;
    follows(&mut core)
}
