//! The cases of outputs and inputs: digital output 0 is wired to digital input 0, which is what the core sees of it.

use evolvent_bridge_sim::monotonic_ns;
use evolvent_bus::MachineInputs;

use crate::case::{CaseError, Stage};
use crate::cases::{Judged, demand};
use crate::test_core::{LATEST_S, TestCore};

/// How long a bridge may take to read an input, on a host that is busy, ns.
const READING_NS: u64 = 300_000_000;

/// A core that a bridge with signals has answered.
fn signalling(stage: &mut Stage<'_>) -> Result<TestCore, CaseError> {
    stage.start_bridge()?;
    let mut core = stage.open_core()?;
    core.until("feedback of a bridge", LATEST_S, |_| true)?;
    core.set_output(false);
    let begin_ns = monotonic_ns();
    while core.take_inputs().is_empty() {
        core.rest(0.05);
        demand(monotonic_ns() - begin_ns < (LATEST_S * 1e9) as u64, || {
            "no inputs come; a bridge without any is tested without --signals".to_owned()
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
            "time_ns of inputs does not grow".to_owned()
        })?;
        demand(message.instance == before.instance, || {
            "the instance changes without a restart".to_owned()
        })?;
        demand(message.analog.iter().all(|value| value.is_finite()), || {
            "an analog input that is not finite".to_owned()
        })?;
        demand(message.digital & !message.digital_mask == 0, || {
            "digital inputs are on that were not read".to_owned()
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
            // By the bridge's own time, which the case before has checked.
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
            return Err(CaseError::new("no inputs come behind a change of outputs"));
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

pub(crate) fn output_safe(stage: &mut Stage<'_>) -> Judged {
    let mut core = signalling(stage)?;
    core.set_output(true);
    core.rest(0.8);
    let on = core.take_inputs().pop();
    demand(on.is_some_and(|(_, message)| message.digital & 1 == 1), || {
        "output 0 does not come on, as input 0 says".to_owned()
    })?;
    core.be_silent(1.2);
    let log = core.take_inputs();
    demand(log.len() >= 3, || {
        "no inputs come while the core is silent".to_owned()
    })?;
    let last = log.last().map(|(_, message)| *message);
    demand(last.is_some_and(|message| message.digital & 1 == 0), || {
        "output 0 is still on 1.2 s after the last message of the core: the safe value is off".to_owned()
    })?;
    core.until("feedback after the silence", LATEST_S, |_| true)?;
    core.set_output(true);
    core.rest(0.8);
    let again = core.take_inputs().pop();
    demand(again.is_some_and(|(_, message)| message.digital & 1 == 1), || {
        "output 0 stays off after the core is heard again".to_owned()
    })
}
