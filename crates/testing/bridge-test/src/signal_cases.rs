//! The cases of outputs and inputs: digital output 0 is wired to digital input 0, so that the core can
//! observe it.

use evolvent_bridge_sim::monotonic_ns;
use evolvent_bus::MachineInputs;

use crate::case::{CaseError, Stage};
use crate::cases::{Judged, demand};
use crate::test_core::{FeedbackSample, LATEST_S, PERIOD_NS, TestCore};

/// Maximum time that a bridge takes to read an input on a busy host, ns.
const READING_NS: u64 = 300_000_000;
/// Silence of the core after which the outputs are safe, ns.
const SAFE_NS: u64 = 200_000_000;
/// Additional delay until input 0 shows it, ns: a period of the bridge, and 20 ms for the wiring (a relay,
/// the filter of the input).
const SAFE_VISIBLE_NS: u64 = PERIOD_NS + 20_000_000;

/// Opens a core to which a bridge with signals has replied.
fn signalling(stage: &mut Stage<'_>) -> Result<TestCore, CaseError> {
    stage.start_bridge()?;
    let mut core = stage.open_core()?;
    core.until("feedback of a bridge", LATEST_S, |_| true)?;
    core.set_output(false);
    let begin_ns = monotonic_ns();
    while core.take_inputs().is_empty() {
        core.rest(0.05);
        demand(monotonic_ns() - begin_ns < (LATEST_S * 1e9) as u64, || {
            "no inputs arrive; a bridge without inputs is tested without --signals".to_owned()
        })?;
    }
    Ok(core)
}

pub(crate) fn inputs(stage: &mut Stage<'_>) -> Judged {
    let mut core = signalling(stage)?;
    core.take_inputs();
    core.rest(2.0);
    let log = core.take_inputs();
    demand(log.len() >= 20, || {
        format!("{} messages of inputs in 2 s", log.len())
    })?;
    let mut stale = 0;
    for pair in log.windows(2) {
        let [(_, before), (now_ns, message)] = pair else {
            continue;
        };
        demand(message.sequence > before.sequence, || {
            format!("input message {} after {}", message.sequence, before.sequence)
        })?;
        demand(message.time_ns > before.time_ns, || {
            "time_ns of inputs does not increase".to_owned()
        })?;
        demand(message.instance == before.instance, || {
            "the instance changes without a restart".to_owned()
        })?;
        demand(message.analog.iter().all(|value| value.is_finite()), || {
            "an analog input that is not finite".to_owned()
        })?;
        demand(message.digital & !message.digital_mask == 0, || {
            "digital inputs that were not read are on".to_owned()
        })?;
        stale += usize::from(now_ns.abs_diff(message.time_ns) > 100_000_000);
    }
    demand(stale * 10 < log.len(), || {
        format!(
            "{stale} of {} inputs are more than 0.1 s off CLOCK_MONOTONIC",
            log.len()
        )
    })
}

pub(crate) fn output_due(stage: &mut Stage<'_>) -> Judged {
    let mut core = signalling(stage)?;
    for round in 0..2 * stage.moments.max(1) {
        let on = round % 2 == 0;
        let pause = stage.between(0.01, 0.2);
        core.rest(pause);
        core.take_inputs();
        let wanted = core.set_output(on);
        core.rest(1.0);
        let log = core.take_inputs();
        let is_set = |message: &MachineInputs| message.digital & 1 == u64::from(on);
        for (_, message) in &log {
            // Uses the bridge's own time, which an earlier case has checked.
            if message.time_ns < wanted.due_time_ns {
                demand(!is_set(message), || {
                    let early = wanted.due_time_ns - message.time_ns;
                    format!(
                        "the output was set {:.1} ms before it was due",
                        early as f64 * 1e-6
                    )
                })?;
                demand(message.outputs_sequence < wanted.sequence, || {
                    "outputs_sequence names outputs that are not due".to_owned()
                })?;
            }
        }
        let late_ns = wanted.due_time_ns + READING_NS;
        let last = log.iter().rfind(|(_, message)| message.time_ns > late_ns);
        let Some((_, last)) = last else {
            return Err(CaseError::new("no inputs arrive after a change of outputs"));
        };
        demand(is_set(last), || {
            format!(
                "output 0 is not {} 0.3 s after it was due, as input 0 says",
                if on { "on" } else { "off" }
            )
        })?;
        demand(last.outputs_sequence >= wanted.sequence, || {
            format!("outputs_sequence stays at {}", last.outputs_sequence)
        })?;
    }
    Ok(())
}

/// The longest interval between these times, minus the median interval, ns.
fn longest_gap_ns(times_ns: impl Iterator<Item = u64>) -> u64 {
    let times_ns: Vec<u64> = times_ns.collect();
    let mut gaps_ns: Vec<u64> = times_ns
        .windows(2)
        .map(|pair| pair[1].saturating_sub(pair[0]))
        .collect();
    gaps_ns.sort_unstable();
    let usual_ns = gaps_ns.get(gaps_ns.len() / 2).copied().unwrap_or(0);
    gaps_ns.last().map_or(0, |longest_ns| longest_ns - usual_ns)
}

/// Whether output 0 became safe in time after the last message of the core had left, by the bridge's inputs
/// during the silence. A bridge that the host kept from running for long enough, as its messages show, is not
/// judged.
fn judge_safe(left_ns: u64, inputs: &[(u64, MachineInputs)], feedback: &[FeedbackSample]) -> Judged {
    demand(inputs.len() >= 3, || {
        "no inputs arrive while the core is silent".to_owned()
    })?;
    let is_on = |(_, message): &(u64, MachineInputs)| message.digital & 1 == 1;
    let safe_at = inputs.iter().rposition(is_on).map_or(0, |last_on| last_on + 1);
    // If it is never safe: the last time that it was on.
    let judged_at = safe_at.min(inputs.len() - 1);
    let after_ns = inputs[judged_at].1.time_ns.saturating_sub(left_ns);
    let late_ns = after_ns.saturating_sub(SAFE_NS);
    if late_ns <= SAFE_VISIBLE_NS {
        return demand(safe_at == judged_at, || {
            let received_ms = after_ns as f64 * 1e-6;
            format!(
                "the last input arrives {received_ms:.0} ms after the last message of the core, and output 0 \
                 is on"
            )
        });
    }
    let what = format!(
        "output 0 {} {:.0} ms after the last message of the core, as input 0 says: the safe value is off, \
         200 ms are permitted, and {:.0} ms until the input shows it",
        if safe_at == judged_at {
            "becomes safe"
        } else {
            "is still on"
        },
        after_ns as f64 * 1e-6,
        SAFE_VISIBLE_NS as f64 * 1e-6
    );
    let gaps_ns = [
        longest_gap_ns(feedback.iter().map(|sample| sample.now_ns)),
        longest_gap_ns(inputs[..=judged_at].iter().map(|(_, message)| message.time_ns)),
    ];
    let gap_ns = gaps_ns[0].max(gaps_ns[1]);
    Err(if late_ns <= SAFE_VISIBLE_NS + gap_ns {
        let silent_ms = gap_ns as f64 * 1e-6;
        CaseError::unmeasured(format!("{what}; the bridge was silent for {silent_ms:.1} ms"))
    } else {
        CaseError::new(what)
    })
}

pub(crate) fn output_safe(stage: &mut Stage<'_>) -> Judged {
    let mut core = signalling(stage)?;
    core.set_output(true);
    core.rest(0.8);
    let on = core.take_inputs().pop();
    demand(on.is_some_and(|(_, message)| message.digital & 1 == 1), || {
        "output 0 does not switch on, as input 0 shows".to_owned()
    })?;
    core.take_log();
    let left_ns = core.outputs_left_ns();
    core.be_silent(1.2);
    judge_safe(left_ns, &core.take_inputs(), &core.take_log())?;
    core.until("feedback after the silence", LATEST_S, |_| true)?;
    core.set_output(true);
    core.rest(0.8);
    let again = core.take_inputs().pop();
    demand(again.is_some_and(|(_, message)| message.digital & 1 == 1), || {
        "output 0 stays off after the core sends again".to_owned()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use evolvent_bus::Feedback;

    const MS: u64 = 1_000_000;

    /// Input 0 is on until `safe_ms` after the core's last message. The bridge sends it every 2 ms, except
    /// during a pause of `pause_ms` before that.
    fn judged(safe_ms: u64, pause_ms: u64) -> Judged {
        let left_ns = 1000 * MS;
        let times = (1..600)
            .map(|i| 2 * i * MS)
            .filter(|after_ns| !(safe_ms.saturating_sub(pause_ms) * MS..safe_ms * MS).contains(after_ns));
        let (mut inputs, mut feedback) = (Vec::new(), Vec::new());
        for after_ns in times {
            let time_ns = left_ns + after_ns;
            let message = MachineInputs {
                time_ns,
                digital: u64::from(after_ns < safe_ms * MS),
                ..MachineInputs::default()
            };
            inputs.push((time_ns, message));
            feedback.push(FeedbackSample {
                now_ns: time_ns,
                feedback: Feedback::default(),
            });
        }
        judge_safe(left_ns, &inputs, &feedback)
    }

    #[test]
    fn outputs_are_safe_in_time_unless_host_paused() {
        for safe_ms in [100, 200, 202, 220] {
            assert_eq!(judged(safe_ms, 0), Ok(()), "{safe_ms}");
        }
        for (safe_ms, pause_ms) in [(226, 0), (250, 10), (600, 0), (600, 200), (5000, 0)] {
            let error = judged(safe_ms, pause_ms).expect_err("late");
            assert!(!error.is_unmeasured(), "{safe_ms}, {pause_ms}: {error}");
        }
        for (safe_ms, pause_ms) in [(250, 40), (600, 400)] {
            let error = judged(safe_ms, pause_ms).expect_err("late");
            assert!(error.is_unmeasured(), "{safe_ms}, {pause_ms}: {error}");
        }
    }
}
