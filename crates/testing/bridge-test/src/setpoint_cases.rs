//! The cases of setpoints that are missing, late, impossible or not finite.

use evolvent_bus::Feedback;
use evolvent_drive::BridgeState;

use crate::begin_cases::ELSEWHERE;
use crate::case::{CaseError, Stage};
use crate::cases::{ALONE, CLOSE, DISTANCE_MM, Judged, demand, extent, follows, is_at_rest, up};
use crate::test_core::{Fate, LEAD, PERIOD_NS};

/// A jump that persists, mm.
const JUMP: f64 = 2.0;
/// Stopping distance from the middle of a move of 0.6 s, ten periods of continued motion included, mm.
const ROLLING: f64 = 1.2;
/// Delays after the due time that are too late, ns: a bridge may wait for setpoints for some periods, for the
/// sake of a busy host, and no longer.
const TOO_LATE_NS: [u64; 2] = [30 * PERIOD_NS, 500_000_000];

/// Whether a bridge has stopped by itself: at rest and not following.
fn has_stopped(feedback: &Feedback) -> bool {
    is_at_rest(feedback) && BridgeState::from_number(feedback.bridge_state) != Some(BridgeState::Following)
}

pub(crate) fn gaps(stage: &mut Stage<'_>) -> Judged {
    let mut core = up(stage)?;
    let before = core.feedback().map_or(0, |feedback| feedback.missed_setpoints);
    let mut lost = 0;
    core.swing(DISTANCE_MM, 1.0, &mut |setpoint| {
        if setpoint.sequence % 40 == 7 {
            lost += 1;
            return Fate::Lost;
        }
        Fate::Sent
    });
    core.rest(0.3);
    let log = core.take_log();
    let stopped = log.iter().find(|sample| {
        !matches!(
            BridgeState::from_number(sample.feedback.bridge_state),
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
    core.move_by(DISTANCE_MM, 0.5, &mut |_| {
        sent += 1;
        if sent < half { Fate::Sent } else { Fate::Lost }
    });
    core.rest_with(1.0, &mut |_| Fate::Lost);
    let newest = core
        .feedback()
        .copied()
        .ok_or_else(|| CaseError::new("no feedback any more without setpoints"))?;
    demand(has_stopped(&newest), || {
        format!("is not at rest 1 s after the last setpoint; {}", core.describe())
    })?;
    let distance = (newest.position[0] - from).abs();
    demand(distance <= DISTANCE_MM / 2.0 + ALONE, || {
        format!("moved {distance:.3} by itself")
    })?;
    // The core continues from another position as if nothing had happened.
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
    // A smooth move whose setpoints are each sent some time after they are due.
    core.rest(0.2);
    for late_ns in TOO_LATE_NS {
        // Earlier setpoints are due by now, and the axes are at rest.
        core.rest((LEAD * PERIOD_NS) as f64 * 1e-9);
        let _before = core.take_log();
        for by in [DISTANCE_MM, -DISTANCE_MM] {
            core.move_by(by, 0.4, &mut |setpoint| {
                setpoint.due_time_ns -= LEAD * PERIOD_NS + late_ns;
                Fate::Sent
            });
        }
        let moved = extent(&core.take_log());
        demand(moved <= CLOSE, || {
            format!(
                "followed setpoints that arrived {} ms late for {moved:.3}",
                late_ns / 1_000_000
            )
        })?;
        core.bring_up()?;
    }
    // Setpoints at another position that were due two seconds ago.
    core.rest_with(0.6, &mut |setpoint| {
        setpoint.due_time_ns -= 2_000_000_000;
        setpoint.position[0] += DISTANCE_MM;
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

/// Due times that no core sends: near zero, the maximum, and an hour ahead.
const IMPOSSIBLE_NS: [fn(u64) -> u64; 3] = [|_| 1, |_| u64::MAX, |due_ns| due_ns + 3_600_000_000_000];

pub(crate) fn due_times(stage: &mut Stage<'_>) -> Judged {
    let mut core = up(stage)?;
    for due_of in IMPOSSIBLE_NS {
        // A single impossible one among good ones counts as missing.
        let mut count = 0;
        core.move_by(DISTANCE_MM, 0.5, &mut |setpoint| {
            count += 1;
            if count == 100 {
                setpoint.due_time_ns = due_of(setpoint.due_time_ns);
            }
            Fate::Sent
        });
        core.rest((LEAD * PERIOD_NS) as f64 * 1e-9 + 0.3);
        let off = core.commanded()[0] - core.feedback().map_or(f64::NAN, |feedback| feedback.position[0]);
        demand(off.abs() <= CLOSE, || {
            format!(
                "is {off:.3} off after a move with one impossible due time; {}",
                core.describe()
            )
        })?;
        // All setpoints are impossible.
        let _before = core.take_log();
        for by in [-DISTANCE_MM, DISTANCE_MM] {
            core.move_by(by, 0.5, &mut |setpoint| {
                setpoint.due_time_ns = due_of(setpoint.due_time_ns);
                Fate::Sent
            });
        }
        core.rest_with(0.3, &mut |_| Fate::Lost);
        let moved = extent(&core.take_log());
        demand(moved <= CLOSE, || {
            format!(
                "impossible due times were followed for {moved:.3}; {}",
                core.describe()
            )
        })?;
        core.bring_up()?;
    }
    // Decreasing due times: each is a period before the last one.
    core.rest((LEAD * PERIOD_NS) as f64 * 1e-9);
    let _before = core.take_log();
    let mut count = 0;
    core.move_by(DISTANCE_MM, 0.15, &mut |setpoint| {
        setpoint.due_time_ns -= 2 * count * PERIOD_NS;
        count += 1;
        Fate::Sent
    });
    core.rest_with(0.5, &mut |_| Fate::Lost);
    let moved = extent(&core.take_log());
    demand(moved <= CLOSE, || {
        format!(
            "due times that go backwards were followed for {moved:.3}; {}",
            core.describe()
        )
    })?;
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
    // From here on all setpoints are wild.
    core.rest_with(0.6, &mut |setpoint| {
        setpoint.position[0] += 400.0;
        Fate::Sent
    });
    let moved = extent(&core.take_log());
    demand(moved <= CLOSE, || {
        format!("a jump by 400 mm was followed for {moved:.3}")
    })?;
    core.bring_up()?;
    // Jumps that an axis could cover in the time for which a bridge waits for setpoints.
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
    core.move_by(DISTANCE_MM, 0.6, &mut |setpoint| {
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
    demand(moved <= DISTANCE_MM / 2.0 + ROLLING, || {
        format!(
            "moved {moved:.3} in a move with a jump by {JUMP} mm after {} mm",
            DISTANCE_MM / 2.0
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
    demand(log.iter().all(|sample| sample.feedback.is_finite()), || {
        "replies with a number that is not finite".to_owned()
    })?;
    let moved = extent(&log);
    demand(moved <= CLOSE, || {
        format!("moved by {moved:.3} at numbers that are not finite")
    })?;
    core.bring_up()?;
    follows(&mut core)
}
