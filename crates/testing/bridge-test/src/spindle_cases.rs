//! The cases of a spindle: the core sends speeds and receives the angle.

use evolvent_bridge_sim::monotonic_ns;
use evolvent_bus::{SpindleFeedback, spindle_flags};

use crate::case::{CaseError, Stage};
use crate::cases::{Judged, demand, up};
use crate::test_core::{LATEST_S, TestCore};

/// Speed of the spindle: slow for any spindle, and fast enough to judge its angle.
const RPM: f64 = 300.0;
/// "At speed" means within 10 % of the command; bridges have their own tolerance, usually 2 to 5 %.
const NEAR: f64 = 0.1;
/// Maximum deviation of an angle from the line fitted to all angles, turns. An error of 1 ms in the time of a
/// sample deviates by 0.005, a count of a coarse encoder (100 counts) by 0.01.
const STEADY: f64 = 0.03;
/// Maximum time to reach the speed or to stop, s.
const RAMP_S: f64 = 8.0;
/// Speed below which a spindle is at standstill, rpm.
const STANDING_RPM: f64 = 15.0;
/// Time over which a speed is computed from angles, ns.
const SPAN_NS: u64 = 60_000_000;

fn turns(message: &SpindleFeedback) -> f64 {
    message.turns as f64 + message.fraction
}

/// Whether the angle counts from the index pulse.
const fn is_indexed(message: &SpindleFeedback) -> bool {
    message.flags & spindle_flags::INDEXED != 0
}

/// Speed from the angles and times of two messages, rpm.
fn speed_between(from: &SpindleFeedback, to: &SpindleFeedback) -> f64 {
    let seconds = to.time_ns.saturating_sub(from.time_ns) as f64 * 1e-9;
    (turns(to) - turns(from)) / seconds.max(1e-9) * 60.0
}

/// Judges every message of a sequence.
fn judge_messages(log: &[(u64, SpindleFeedback)]) -> Judged {
    let mut stale = 0;
    for (now_ns, message) in log {
        demand((0.0..1.0).contains(&message.fraction), || {
            format!("a fraction of {}", message.fraction)
        })?;
        demand(message.speed_rpm.is_finite(), || {
            "a speed that is not finite".to_owned()
        })?;
        stale += usize::from(now_ns.abs_diff(message.time_ns) > 100_000_000);
    }
    for pair in log.windows(2) {
        let [before, next] = [pair[0].1, pair[1].1];
        demand(next.sequence > before.sequence, || {
            format!("spindle message {} after {}", next.sequence, before.sequence)
        })?;
        demand(next.time_ns > before.time_ns, || {
            "time_ns of the spindle does not increase".to_owned()
        })?;
        demand(next.instance == before.instance, || {
            "the instance of the spindle changes without a restart".to_owned()
        })?;
    }
    demand(stale * 10 <= log.len(), || {
        let all = log.len();
        format!("{stale} of {all} angles are more than 0.1 s off CLOCK_MONOTONIC")
    })
}

/// Judges that AT_SPEED is set for a command of `rpm` only if the reported speed and the speed by angles are
/// near it.
fn judge_at_speed(log: &[(u64, SpindleFeedback)], since: u64, rpm: f64) -> Judged {
    let near = |speed: f64| (speed - rpm).abs() <= (NEAR * rpm.abs()).max(STANDING_RPM);
    let mut past = 0;
    for (i, (_, message)) in log.iter().enumerate() {
        let is_reported = message.outputs_sequence >= since && message.flags & spindle_flags::AT_SPEED != 0;
        if !is_reported {
            continue;
        }
        demand(near(message.speed_rpm), || {
            format!("at speed at {:.1} rpm of {rpm}", message.speed_rpm)
        })?;
        while log[past].1.time_ns.saturating_add(SPAN_NS) < message.time_ns && past + 1 < i {
            past += 1;
        }
        let from = &log[past].1;
        // Judged only if the whole span is at speed: before, the speed was still changing.
        let is_alike = |other: &SpindleFeedback| {
            other.outputs_sequence >= since
                && other.flags & spindle_flags::AT_SPEED != 0
                && is_indexed(other) == is_indexed(message)
        };
        let is_whole = log[past..i].iter().all(|(_, other)| is_alike(other));
        if is_whole && message.time_ns.saturating_sub(from.time_ns) > SPAN_NS / 2 {
            let speed = speed_between(from, message);
            let is_close = (speed - rpm).abs() <= (2.0 * NEAR * rpm.abs()).max(2.0 * STANDING_RPM);
            demand(is_close, || {
                format!("at speed, and the angle turns at {speed:.1} rpm of {rpm}")
            })?;
        }
    }
    Ok(())
}

/// Commands a speed and waits until it is reached. Returns the messages from the command on.
fn turn(core: &mut TestCore, rpm: f64) -> Result<(u64, Vec<(u64, SpindleFeedback)>), CaseError> {
    let wanted = core.set_spindle(rpm);
    let mut log = Vec::new();
    let begin_ns = monotonic_ns();
    let is_there = |(_, message): &(u64, SpindleFeedback)| {
        message.outputs_sequence >= wanted.sequence && message.flags & spindle_flags::AT_SPEED != 0
    };
    while !log.last().is_some_and(is_there) {
        core.rest(0.02);
        log.extend(core.take_spindle());
        demand(monotonic_ns() - begin_ns < (RAMP_S * 1e9) as u64, || {
            let last = log
                .last()
                .map_or("no message of spindle 0".to_owned(), |(_, message)| {
                    format!(
                        "{:.1} rpm, flags {:#x}, outputs {} of {}",
                        message.speed_rpm, message.flags, message.outputs_sequence, wanted.sequence
                    )
                });
            format!("not at {rpm} rpm within {RAMP_S} s: {last}")
        })?;
    }
    Ok((wanted.sequence, log))
}

/// Judges the angle during half a second at speed.
fn judge_steady(log: &[(u64, SpindleFeedback)], rpm: f64) -> Judged {
    let log: Vec<_> = (log.iter())
        .filter(|(_, message)| {
            log.last()
                .is_some_and(|(_, last)| is_indexed(message) == is_indexed(last))
        })
        .collect();
    let (Some((_, first)), Some((_, last))) = (log.first(), log.last()) else {
        return Err(CaseError::new("no angle arrives while the spindle turns"));
    };
    demand(log.len() >= 20, || {
        format!("{} messages of the spindle in half a second", log.len())
    })?;
    let mean = speed_between(first, last);
    demand((mean - rpm).abs() <= NEAR * rpm.abs(), || {
        format!("the angle turns at {mean:.1} rpm instead of {rpm} rpm")
    })?;
    let reported = log.iter().map(|(_, message)| message.speed_rpm).sum::<f64>() / log.len() as f64;
    demand((reported - mean).abs() <= 0.05 * rpm.abs(), || {
        format!("speed_rpm is {reported:.1}, and the angle turns at {mean:.1} rpm")
    })?;
    let off = |message: &SpindleFeedback| {
        let seconds = message.time_ns.saturating_sub(first.time_ns) as f64 * 1e-9;
        (turns(message) - turns(first) - mean / 60.0 * seconds).abs()
    };
    let unsteady = log.iter().filter(|(_, message)| off(message) > STEADY).count();
    demand(unsteady * 50 <= log.len(), || {
        let all = log.len();
        format!("{unsteady} of {all} angles differ from those of an even speed at their time_ns")
    })
}

/// Opens a core that has commanded its spindle to stop, as cores do at first.
fn standing(stage: &mut Stage<'_>) -> Result<TestCore, CaseError> {
    let mut core = up(stage)?;
    core.set_spindle(0.0);
    core.rest(0.5);
    core.take_spindle();
    Ok(core)
}

pub(crate) fn spindle_angle(stage: &mut Stage<'_>) -> Judged {
    let mut core = standing(stage)?;
    for rpm in [RPM, -RPM, 0.0] {
        let (since, mut log) = turn(&mut core, rpm)?;
        core.rest(0.3);
        log.extend(core.take_spindle());
        let steady = if rpm == 0.0 {
            None
        } else {
            core.rest(0.5);
            Some(core.take_spindle())
        };
        log.extend(steady.iter().flatten());
        judge_messages(&log)?;
        judge_at_speed(&log, since, rpm)?;
        if let Some(steady) = steady {
            judge_steady(&steady, rpm)?;
        }
    }
    Ok(())
}

pub(crate) fn spindle_safe(stage: &mut Stage<'_>) -> Judged {
    let mut core = standing(stage)?;
    let (since, log) = turn(&mut core, RPM)?;
    judge_messages(&log)?;
    judge_at_speed(&log, since, RPM)?;
    let begin_ns = monotonic_ns();
    let mut log = Vec::new();
    loop {
        core.be_silent(0.7);
        log.extend(core.take_spindle());
        let last = log.last().map(|(_, message): &(u64, SpindleFeedback)| *message);
        let is_recent = |last: &SpindleFeedback| monotonic_ns().saturating_sub(last.time_ns) < 500_000_000;
        let Some(last) = last.filter(is_recent) else {
            return Err(CaseError::new("no angle arrives while the core is silent"));
        };
        let before = log
            .iter()
            .rfind(|(_, message)| message.time_ns.saturating_add(200_000_000) < last.time_ns);
        let is_stopped = |(_, before): &(u64, SpindleFeedback)| {
            last.speed_rpm.abs() <= STANDING_RPM && speed_between(before, &last).abs() <= STANDING_RPM
        };
        if before.is_some_and(is_stopped) {
            break;
        }
        demand(monotonic_ns() - begin_ns < (RAMP_S * 1e9) as u64, || {
            let speed = last.speed_rpm;
            format!("it turns at {speed:.1} rpm {RAMP_S} s after the last message of the core")
        })?;
    }
    judge_at_speed(&log, since, RPM)?;
    core.until("feedback after the silence", LATEST_S, |_| true)?;
    let (since, log) = turn(&mut core, RPM)?;
    judge_messages(&log)?;
    judge_at_speed(&log, since, RPM)
}
