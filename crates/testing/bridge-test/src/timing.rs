//! Timing of a bridge's motion: its reported positions, compared with the positions and due times of the
//! setpoints.
//!
//! The lag of a motion is fitted to all its samples by least squares, which resolves a fraction of a period
//! even in a slow motion.

use crate::case::{CaseError, Stage};
use crate::cases::{Judged, demand, up};
use crate::test_core::{Fate, FeedbackSample, LEAD, PERIOD_NS};

/// Distance of the move, mm, and its duration, s: at most 23 mm/s.
const DISTANCE: f64 = 5.0;
const MOVE_S: f64 = 0.4;
/// Maximum deviation (root mean square) of the axis from the fitted motion, mm.
const CLOSE: f64 = 0.2;
/// Time before its due time at which a setpoint may be used, ns: one period, for bridges that round to their
/// periods.
const EARLY_NS: u64 = PERIOD_NS;
/// Maximum lag of a motion in addition to the declared following error, ns: the core permits the distance of
/// 20 ms (`following_time_ms`) unless the machine file sets another time.
const LAG_NS: u64 = 20_000_000;
/// Maximum lag including the declared following error, ns: position loops with a gain of 1 m/min per mm lag
/// by 60 ms.
const DECLARED_LAG_NS: u64 = 60_000_000;
/// Standstill after which an axis at 23 mm/s is off its path.
const STANDING_NS: u64 = 50_000_000;
/// Range of the lags tried, ns, and their step.
const SEARCH_NS: core::ops::RangeInclusive<i64> = -(LEAD as i64 * PERIOD_NS as i64)..=700_000_000;
const COARSE_NS: usize = 1_000_000;
const FINE_NS: usize = 50_000;

/// A setpoint that was sent.
#[derive(Clone, Copy, Debug)]
struct Planned {
    due_ns: u64,
    sequence: u64,
    position: f64,
}

/// The planned position at a time; before the first and after the last setpoint the axis is at rest.
fn planned_at(plan: &[Planned], time_ns: i64) -> f64 {
    let next = plan.partition_point(|planned| planned.due_ns as i64 <= time_ns);
    match (next.checked_sub(1).and_then(|at| plan.get(at)), plan.get(next)) {
        (Some(before), Some(after)) => {
            let span = (after.due_ns - before.due_ns) as f64;
            let part = (time_ns - before.due_ns as i64) as f64 / span;
            before.position + part * (after.position - before.position)
        }
        (Some(only), None) | (None, Some(only)) => only.position,
        (None, None) => f64::NAN,
    }
}

/// Lag of samples of time and position relative to the plan, ns, and their deviation from the shifted plan,
/// mm (root mean square).
fn fitted_lag(plan: &[Planned], samples: &[(u64, f64)]) -> (i64, f64) {
    let error = |lag_ns: i64| {
        let squares = samples.iter().map(|(time_ns, position)| {
            let off = position - planned_at(plan, *time_ns as i64 - lag_ns);
            off * off
        });
        (squares.sum::<f64>() / samples.len().max(1) as f64).sqrt()
    };
    let best = |range: core::ops::RangeInclusive<i64>, step: usize| {
        let tried = range.step_by(step).map(|lag_ns| (lag_ns, error(lag_ns)));
        tried.min_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0, f64::NAN))
    };
    let (near, _) = best(SEARCH_NS, COARSE_NS);
    best(near - COARSE_NS as i64..=near + COARSE_NS as i64, FINE_NS)
}

/// The longest silence of the bridge, minus one period, by its own times, ns.
fn longest_gap_ns(log: &[FeedbackSample]) -> u64 {
    let gaps = log
        .windows(2)
        .map(|pair| pair[1].feedback.time_ns.saturating_sub(pair[0].feedback.time_ns));
    gaps.max().unwrap_or(0).saturating_sub(PERIOD_NS)
}

/// A demand on times. A bridge that the host kept from running for at least as long as its error is not
/// judged.
fn demand_in_time(good: bool, off_ns: u64, log: &[FeedbackSample], what: impl FnOnce() -> String) -> Judged {
    if good {
        return Ok(());
    }
    let gap_ns = longest_gap_ns(log);
    if gap_ns >= off_ns {
        return Err(CaseError::unmeasured(format!(
            "{}; the bridge was silent for {:.1} ms",
            what(),
            ms(gap_ns)
        )));
    }
    Err(CaseError::new(what()))
}

fn ms(ns: u64) -> f64 {
    ns as f64 * 1e-6
}

/// Judges the sequence numbers in the feedback: none before its setpoint is due, and none long after.
fn judge_replies(plan: &[Planned], log: &[FeedbackSample]) -> Judged {
    let mut delays_ns = Vec::new();
    for sample in log {
        let (time_ns, sequence) = (sample.feedback.time_ns, sample.feedback.sequence);
        let Some(planned) = plan.iter().find(|planned| planned.sequence == sequence) else {
            continue;
        };
        let early_ns = planned.due_ns.saturating_sub(time_ns);
        demand(early_ns <= EARLY_NS, || {
            format!(
                "replies to setpoint {sequence} {:.1} ms before it is due",
                ms(early_ns)
            )
        })?;
        delays_ns.push(time_ns.saturating_sub(planned.due_ns));
    }
    delays_ns.sort_unstable();
    let delay_ns = delays_ns.get(delays_ns.len() / 2).copied().unwrap_or(0);
    demand_in_time(delay_ns <= LAG_NS, delay_ns, log, || {
        format!("replies to setpoints {:.1} ms after they were due", ms(delay_ns))
    })
}

fn judge_motion(plan: &[Planned], log: &[FeedbackSample]) -> Judged {
    let samples = |declared: f64| {
        let of = |sample: &FeedbackSample| {
            let feedback = &sample.feedback;
            (
                feedback.time_ns,
                feedback.position[0] + declared * feedback.following_error[0],
            )
        };
        log.iter().map(of).collect::<Vec<_>>()
    };
    let (lag_ns, off) = fitted_lag(plan, &samples(0.0));
    // The declared following error gives the target positions of the drives.
    let (target_lag_ns, _) = fitted_lag(plan, &samples(1.0));
    let late_ns = lag_ns.max(0).unsigned_abs();
    let early_ns = lag_ns.min(0).unsigned_abs();
    demand_in_time(early_ns <= EARLY_NS, early_ns, log, || {
        format!("the axis moves {:.1} ms before setpoints are due", ms(early_ns))
    })?;
    let is_in_time = late_ns <= LAG_NS || late_ns <= DECLARED_LAG_NS && target_lag_ns <= LAG_NS as i64;
    demand_in_time(is_in_time, late_ns, log, || {
        format!("the axis follows {:.1} ms after setpoints were due", ms(late_ns))
    })?;
    demand_in_time(off <= CLOSE, STANDING_NS, log, || {
        format!("the axis is {off:.3} from the path of the setpoints on average")
    })
}

pub(crate) fn due(stage: &mut Stage<'_>) -> Judged {
    let mut core = up(stage)?;
    core.rest((LEAD * PERIOD_NS) as f64 * 1e-9 + 0.2);
    let _before = core.take_log();
    let mut plan = Vec::new();
    let mut take = |setpoint: &mut evolvent_bus::Setpoint| {
        plan.push(Planned {
            due_ns: setpoint.due_time_ns,
            sequence: setpoint.sequence,
            position: setpoint.position[0],
        });
        Fate::Sent
    };
    core.rest_with(0.05, &mut take);
    core.move_by(DISTANCE, MOVE_S, &mut take);
    // The move ends a lead later, and later still with a bridge that lags.
    core.rest_with((LEAD * PERIOD_NS) as f64 * 1e-9 + 0.7, &mut take);
    let log = core.take_log();
    demand(!log.is_empty(), || "no feedback".to_owned())?;
    judge_replies(&plan, &log)?;
    judge_motion(&plan, &log)?;
    crate::cases::follows(&mut core)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A move to and fro, with one setpoint per period from one second on.
    fn plan() -> Vec<Planned> {
        (0..300)
            .map(|i| Planned {
                due_ns: 1_000_000_000 + i * PERIOD_NS,
                sequence: i,
                position: 2.5 * (1.0 - (i as f64 * core::f64::consts::TAU / 300.0).cos()),
            })
            .collect()
    }

    #[test]
    fn a_lag_is_found_to_a_fraction_of_a_period() {
        let plan = plan();
        for wanted_ns in [-6_000_000, -1_300_000, 0, 700_000, 25_000_000, 480_000_000] {
            let samples: Vec<(u64, f64)> = (0..600)
                .map(|i| {
                    let time_ns = 900_000_000 + i * PERIOD_NS + 123_456;
                    // An encoder of 10 um.
                    let position = planned_at(&plan, time_ns as i64 - wanted_ns);
                    (time_ns, (position * 100.0).round() / 100.0)
                })
                .collect();
            let (found_ns, off) = fitted_lag(&plan, &samples);
            assert!(
                (found_ns - wanted_ns).abs() < 300_000,
                "{found_ns} for {wanted_ns}"
            );
            assert!(off < 0.01, "{off}");
        }
    }

    #[test]
    fn an_axis_that_does_not_move_is_far_from_the_path() {
        let plan = plan();
        let samples: Vec<(u64, f64)> = (0..600).map(|i| (1_000_000_000 + i * PERIOD_NS, 5.0)).collect();
        assert!(fitted_lag(&plan, &samples).1 > CLOSE);
    }

    /// Feedback of a bridge that lags by `lag_ns` and pauses for `pause_ns` in the middle of the move.
    fn log(lag_ns: i64, pause_ns: u64) -> Vec<FeedbackSample> {
        let plan = plan();
        let report = |i: u64| {
            let time_ns = 900_000_000 + i * PERIOD_NS + if i > 200 { pause_ns } else { 0 };
            let mut feedback = evolvent_bus::Feedback {
                time_ns,
                ..Default::default()
            };
            feedback.position[0] = planned_at(&plan, time_ns as i64 - lag_ns);
            FeedbackSample {
                now_ns: time_ns,
                feedback,
            }
        };
        (0..600).map(report).collect()
    }

    #[test]
    fn only_a_long_enough_pause_explains_a_lag() {
        let judged = |lag_ns, pause_ns| judge_motion(&plan(), &log(lag_ns, pause_ns));
        assert_eq!(judged(15_000_000, 0), Ok(()));
        assert_eq!(judged(-1_000_000, 0), Ok(()));
        for (lag_ns, short_ns, long_ns) in [
            (30_000_000, 10_000_000, 40_000_000),
            (-6_000_000, 2_000_000, 8_000_000),
        ] {
            for pause_ns in [0, short_ns] {
                let error = judged(lag_ns, pause_ns).expect_err("late, or early");
                assert!(!error.is_unmeasured(), "{lag_ns}, {pause_ns}: {error}");
            }
            let error = judged(lag_ns, long_ns).expect_err("late, or early");
            assert!(error.is_unmeasured(), "{lag_ns}: {error}");
        }
    }
}
