//! The cases of the beginning: the first setpoint is near the axes or far from them.

use evolvent_drive::{DriveState, PowerRequest};

use crate::case::{CaseError, Stage};
use crate::cases::{CLOSE, Judged, demand, extent, follows, is_at_rest, up};
use crate::test_core::{Fate, FeedbackSample, LATEST_S, PERIOD_NS, TestCore, is_following, states};

/// Distance from which on a setpoint counts as elsewhere, mm: a bridge may begin within 1 mm, and a drive may
/// hold its position with an error of `CLOSE`.
pub(crate) const ELSEWHERE: f64 = 1.0 + CLOSE;
/// Speed of setpoints that pass by, mm/s.
const PASSING: f64 = 20.0;
/// Distance between axes and first setpoint at which most bridges begin, mm.
const BESIDE: f64 = 0.4;
/// Acceleration of the fastest axis that is permitted, mm/s2: 2 g.
const HARDEST: f64 = 20_000.0;

pub(crate) fn begin(stage: &mut Stage<'_>) -> Judged {
    let mut core = up(stage)?;
    let silence = |core: &mut TestCore| {
        core.rest_with(1.0, &mut |_| Fate::Lost);
        let sample = core.feedback().copied();
        let _before = core.take_log();
        sample.ok_or_else(|| CaseError::new("no feedback any more without setpoints"))
    };
    for (axis, off) in [(0, ELSEWHERE), (1, -ELSEWHERE), (2, ELSEWHERE)] {
        let here = silence(&mut core)?.position[axis];
        begins_elsewhere(&mut core, 0.6, axis, here + off)?;
    }
    // The drives are off, and on again: the reference is the position that the bridge reports while they are
    // off.
    core.request(PowerRequest::Off);
    let here = core.until("drives out of operation", LATEST_S, |feedback| {
        is_at_rest(feedback) && states(feedback).all(|state| state != Some(DriveState::OperationEnabled))
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

/// Setpoints at rest begin elsewhere for an axis: the bridge neither moves nor reports that it follows them.
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
    let reports_following = log.last().is_some_and(|sample| is_following(&sample.feedback));
    demand(!reports_following, || {
        format!("reports that it follows setpoints that begin {ELSEWHERE} mm from axis {axis}")
    })
}

pub(crate) fn begin_beside(stage: &mut Stage<'_>) -> Judged {
    let mut core = up(stage)?;
    // When drives come into operation, and when a bridge holds its axes without setpoints.
    for (axis, off, by_power) in [
        (0, BESIDE, true),
        (1, -BESIDE, false),
        (2, BESIDE, true),
        (0, -BESIDE, false),
    ] {
        if by_power {
            core.request(PowerRequest::Off);
            core.until("drives out of operation", LATEST_S, |feedback| {
                is_at_rest(feedback)
                    && states(feedback).all(|state| state != Some(DriveState::OperationEnabled))
            })?;
        } else {
            core.rest_with(1.0, &mut |_| Fate::Lost);
        }
        let here =
            (core.feedback()).ok_or_else(|| CaseError::new("no feedback any more without setpoints"))?;
        let mut position = here.position;
        let from = position[axis];
        position[axis] += off;
        core.set_position(position);
        core.request(PowerRequest::On);
        let _before = core.take_log();
        core.rest(0.3);
        // A bridge that does not begin at this distance holds its axes.
        core.until(
            "the axis at its setpoints, or not following",
            LATEST_S,
            |feedback| {
                let is_there = (feedback.position[axis] - position[axis]).abs() <= CLOSE;
                let operates = states(feedback).all(|state| state == Some(DriveState::OperationEnabled));
                operates && (is_there || !is_following(feedback))
            },
        )?;
        core.rest(0.3);
        judge_duration(&core.take_log(), axis, from, off)?;
        core.bring_up()?;
    }
    follows(&mut core)
}

/// The axis takes at least the time that `HARDEST` permits. So does its target, if the bridge declares the
/// following error.
fn judge_duration(log: &[FeedbackSample], axis: usize, from: f64, off: f64) -> Judged {
    // From a tenth to nine tenths of the distance, with acceleration over its first half and deceleration
    // over the second.
    let min_s = 2.0 * (1.0 - 0.2_f64.sqrt()) * (off.abs() / HARDEST).sqrt();
    for (what, declared) in [("axis", 0.0), ("target of axis", 1.0)] {
        let mut left_ns = 0;
        for sample in log {
            let feedback = &sample.feedback;
            let position = feedback.position[axis] + declared * feedback.following_error[axis];
            let part = (position - from) / off;
            if part <= 0.1 {
                left_ns = feedback.time_ns;
            } else if part >= 0.9 {
                let took_s = feedback.time_ns.saturating_sub(left_ns) as f64 * 1e-9;
                demand(left_ns == 0 || took_s >= min_s, || {
                    format!(
                        "the {what} {axis} moved {:.1} mm to the first setpoints in {:.1} ms: no axis can",
                        off.abs(),
                        took_s * 1e3
                    )
                })?;
                break;
            }
        }
    }
    Ok(())
}
