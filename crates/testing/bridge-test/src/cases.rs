//! The cases. Each starts its bridge and its core, and judges by the feedback.

use core::time::Duration;

use evolvent_bridge_sim::monotonic_ns;
use evolvent_bus::Feedback;
use evolvent_drive::{DriveState, PowerRequest};

use crate::case::{CaseError, Stage};
use crate::core_process::CoreProcess;
use crate::test_core::{Fate, FeedbackSample, LATEST_S, LEAD, PERIOD_NS, TestCore, is_following, states};
pub(crate) use crate::timing::due;

pub(crate) type Judged = Result<(), CaseError>;

/// Distance of the moves, mm.
pub(crate) const DISTANCE_MM: f64 = 5.0;
/// Maximum distance between an axis and its setpoint at rest, mm.
pub(crate) const CLOSE: f64 = 0.2;
/// Maximum distance that an axis may move without setpoints, mm: the moves are slow.
pub(crate) const ALONE: f64 = 6.0;

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

/// The axes reach their setpoints.
pub(crate) fn follows(core: &mut TestCore) -> Judged {
    for by in [DISTANCE_MM, -DISTANCE_MM] {
        core.move_by(by, 0.4, &mut |_| Fate::Sent);
        // Sent setpoints are due a lead later.
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

/// Range of positions of the axis that moved farthest.
pub(crate) fn extent(log: &[FeedbackSample]) -> f64 {
    let of = |axis: usize| {
        let positions = log.iter().map(move |sample| sample.feedback.position[axis]);
        positions.clone().fold(f64::MIN, f64::max) - positions.fold(f64::MAX, f64::min)
    };
    (0..3).map(of).fold(0.0, f64::max)
}

pub(crate) fn is_at_rest(feedback: &Feedback) -> bool {
    feedback.velocity[..3].iter().all(|velocity| velocity.abs() < 0.1)
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
    core.swing(DISTANCE_MM, 1.5, &mut |_| Fate::Sent);
    // Waits for the messages of a bridge that is not running at the moment.
    core.rest(0.1);
    let log = core.take_log();
    let expected = (monotonic_ns() - begin_ns) / PERIOD_NS;
    demand(log.len() as u64 >= expected * 8 / 10, || {
        format!("{} replies to {expected} setpoints", log.len())
    })?;
    let mut last: Option<FeedbackSample> = None;
    let mut stale = 0;
    for sample in &log {
        let feedback = &sample.feedback;
        demand(feedback.axes_mask & 0b111 == 0b111, || {
            format!("axes mask {:#b}", feedback.axes_mask)
        })?;
        demand(feedback.is_finite(), || "a number that is not finite".to_owned())?;
        stale += u32::from(sample.now_ns.abs_diff(feedback.time_ns) > 100_000_000);
        if let Some(last) = last {
            demand(feedback.sequence >= last.feedback.sequence, || {
                format!("reply {} after {}", feedback.sequence, last.feedback.sequence)
            })?;
            demand(feedback.time_ns > last.feedback.time_ns, || {
                "time_ns does not increase".to_owned()
            })?;
            demand(feedback.instance == last.feedback.instance, || {
                "the instance changes without a restart".to_owned()
            })?;
        }
        last = Some(*sample);
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
        is_at_rest(feedback) && states(feedback).all(|state| state != Some(DriveState::OperationEnabled))
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

/// Time within which a quick stop must take effect, ns: much less than the lead, after which it is due.
const AT_ONCE_NS: u64 = 120_000_000;
const _: () = assert!(AT_ONCE_NS < LEAD * PERIOD_NS * 3 / 4);

pub(crate) fn quick_stop(stage: &mut Stage<'_>) -> Judged {
    let mut core = up(stage)?;
    core.rest(0.3);
    let _before = core.take_log();
    let requested_ns = monotonic_ns();
    core.request(PowerRequest::QuickStop);
    let stopped =
        |feedback: &Feedback| states(feedback).all(|state| state != Some(DriveState::OperationEnabled));
    core.until("out of operation after a quick stop", LATEST_S, stopped)?;
    let first = core
        .take_log()
        .into_iter()
        .find(|sample| stopped(&sample.feedback));
    let took_ns = first.map_or(u64::MAX, |sample| {
        sample.feedback.time_ns.saturating_sub(requested_ns)
    });
    demand(took_ns <= AT_ONCE_NS, || {
        format!(
            "a quick stop took effect after {} ms, when it was due, and not at once",
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

/// A value that the counter of a core may have when it starts.
const BEGUN_RESETS: u32 = 7;

/// A bridge that can be killed is killed under power, which leaves drives on a fieldbus in fault. Other
/// bridges are judged if their drives go into fault within a second of operation, as with
/// `bridge sim --fault`. Without a fault nothing can be judged.
pub(crate) fn new_core_reset(stage: &mut Stage<'_>) -> Judged {
    let mut core = up(stage)?;
    core.rest(1.0);
    if stage.bridge.can_be_killed() {
        let killed = core.feedback().map(|feedback| feedback.instance);
        stage.bridge.kill();
        stage.start_bridge()?;
        core.until("feedback of the bridge after its kill", LATEST_S, |feedback| {
            Some(feedback.instance) != killed
        })?;
        core.rest(1.0);
    }
    let faults = |feedback: &Feedback| {
        states(feedback)
            .filter(|state| state.is_some_and(DriveState::is_fault))
            .count()
    };
    // Read before the next core starts: its first setpoint may reset them.
    let before = core.feedback().map_or(0, faults);
    if before == 0 {
        return Err(CaseError::left_out("no drive came into fault"));
    }
    drop(core);
    let mut core = stage.open_core()?.with_fault_resets(BEGUN_RESETS);
    core.until("feedback to the next core", LATEST_S, |_| true)?;
    core.rest((LEAD * PERIOD_NS) as f64 * 1e-9 + 1.0);
    let after = core.feedback().map_or(0, faults);
    demand(after >= before, || {
        format!(
            "a core that started with {BEGUN_RESETS} resets has reset the fault of a drive; {}",
            core.describe()
        )
    })?;
    core.bring_up()?;
    follows(&mut core)
}

/// Time after the only setpoint that requests power within which a drive may still come into operation, ns:
/// the longest time for which a bridge continues without setpoints, plus a margin for a busy host.
const POWERED_ALONE_NS: u64 = 100 * PERIOD_NS + 100_000_000;

pub(crate) fn silent_start(stage: &mut Stage<'_>) -> Judged {
    let mut core = up(stage)?;
    core.request(PowerRequest::Off);
    let operates =
        |feedback: &Feedback| states(feedback).any(|state| state == Some(DriveState::OperationEnabled));
    core.until("drives out of operation", LATEST_S, |feedback| {
        is_at_rest(feedback) && !operates(feedback)
    })?;
    core.rest((LEAD * PERIOD_NS) as f64 * 1e-9);
    let _before = core.take_log();
    core.request(PowerRequest::On);
    let mut due_ns = 0;
    core.rest_with(1.5, &mut |setpoint| {
        if due_ns > 0 {
            return Fate::Lost;
        }
        due_ns = setpoint.due_time_ns;
        Fate::Sent
    });
    let log = core.take_log();
    let still_sends = log
        .last()
        .is_some_and(|sample| sample.feedback.time_ns > due_ns + 2 * POWERED_ALONE_NS);
    demand(still_sends, || {
        "no feedback any more without setpoints".to_owned()
    })?;
    let first = log.iter().find(|sample| operates(&sample.feedback));
    let took_ns = first.map_or(0, |sample| sample.feedback.time_ns.saturating_sub(due_ns));
    demand(took_ns <= POWERED_ALONE_NS, || {
        format!(
            "a drive came into operation {} ms after the last setpoint",
            took_ns / 1_000_000
        )
    })?;
    let follows_nobody = log.last().is_some_and(|sample| !is_following(&sample.feedback));
    demand(follows_nobody, || {
        format!(
            "reports that it follows 1.5 s after the last setpoint; {}",
            core.describe()
        )
    })?;
    core.bring_up()?;
    follows(&mut core)
}

pub(crate) fn version(stage: &mut Stage<'_>) -> Judged {
    let mut core = up(stage)?;
    for (interface_version, struct_size) in [(2, 400), (1, 392), (0, 0)] {
        core.move_by(DISTANCE_MM, 0.3, &mut |setpoint| {
            (setpoint.interface_version, setpoint.struct_size) = (interface_version, struct_size);
            Fate::Sent
        });
        core.move_by(-DISTANCE_MM, 0.3, &mut |setpoint| {
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
        .map(|sample| sample.feedback.velocity[0].abs())
        .fold(0.0, f64::max);
    demand(fastest < 1.0, || {
        format!("the axis moved at {fastest:.3} mm/s when only the datum changed")
    })?;
    follows(&mut core)
}

pub(crate) fn core_restart(stage: &mut Stage<'_>) -> Judged {
    stage.start_bridge()?;
    for _ in 0..stage.moments {
        let mut core = stage.open_core()?;
        core.bring_up()?;
        let seconds = stage.between(0.05, 0.5);
        core.move_by(DISTANCE_MM * seconds, seconds, &mut |_| Fate::Sent);
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
        core.move_by(DISTANCE_MM * seconds, seconds, &mut |_| Fate::Sent);
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

/// The position of the first axis before the first core of a case.
fn first_position(stage: &Stage<'_>) -> Result<f64, CaseError> {
    let mut core = stage.open_core()?;
    core.until("feedback to the first core", LATEST_S, |_| true)?;
    let position = core.feedback().map(|feedback| feedback.position[0]);
    position.ok_or_else(|| CaseError::new("no feedback"))
}

pub(crate) fn core_kill(stage: &mut Stage<'_>) -> Judged {
    let program = stage
        .core_program
        .clone()
        .ok_or_else(|| CaseError::new("no program that runs the core"))?;
    stage.start_bridge()?;
    let mut before = first_position(stage)?;
    for _ in 0..stage.moments {
        let mut process = CoreProcess::start(&program, &stage.machine_name, &stage.prefix)?;
        let seconds = stage.between(0.3, 1.8);
        std::thread::sleep(Duration::from_secs_f64(seconds));
        process.kill();
        let pause = stage.between(0.0, 0.3);
        std::thread::sleep(Duration::from_secs_f64(pause));
        // The next core finds the axes stopped, or stopping, near the last setpoints.
        let mut core = stage.open_core()?;
        core.until("feedback after the core was killed", LATEST_S, |_| true)?;
        core.rest(0.6);
        let here = core
            .feedback()
            .copied()
            .ok_or_else(|| CaseError::new("no feedback"))?;
        demand(is_at_rest(&here), || {
            format!("still moves after its core was killed; {}", core.describe())
        })?;
        // A core process starts at the positions of the axes and moves by at most 8 mm.
        let distance = (here.position[0] - before).abs();
        demand(distance <= 8.0 + ALONE, || {
            format!("is {distance:.3} from where its core began")
        })?;
        before = here.position[0];
    }
    let mut core = stage.open_core()?;
    core.bring_up()?;
    follows(&mut core)
}
