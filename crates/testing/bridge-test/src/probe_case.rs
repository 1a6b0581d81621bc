//! The case of a touch probe: the first axis moves until contact, twice, and the contact position is computed
//! as a core computes it.

use evolvent_bridge_sim::monotonic_ns;
use evolvent_bus::MachineInputs;

use crate::case::{CaseError, Stage};
use crate::cases::{Judged, demand, up};
use crate::test_core::{FeedbackSample, LATEST_S, LEAD, PERIOD_NS, TestCore};

/// Values of the probe's state.
const OPEN: u32 = 1;
const TRIPPED: u32 = 2;
/// Distance within which contact must occur, mm.
pub(crate) const REACH_MM: f64 = 5.0;
/// Speeds of the two approaches, mm/s. A time that is late by 20 ms shows as a difference of 0.05 mm.
const SPEEDS: [f64; 2] = [0.5, 3.0];
/// Maximum difference between the two contacts, mm: one of them is late by the interval between two readings
/// of the input, at most 5 ms.
const SAME: f64 = 0.03;
/// Maximum difference between a latched position and the position by feedback at the same time, mm.
const LATCHED: f64 = 0.05;
/// Time before a contact over which the velocity must be constant, ns. It must also be constant for half of
/// this time after the contact.
const EVEN_NS: u64 = 100_000_000;
/// Maximum time from the time stamp of a message to its reading, ns.
const STAMP_NS: u64 = 2_000_000;

/// One approach: the messages of the probe and the positions of the axis.
struct Approach {
    /// mm/s.
    speed: f64,
    inputs: Vec<MachineInputs>,
    feedback: Vec<FeedbackSample>,
}

fn newest(inputs: &[(u64, MachineInputs)]) -> Option<&MachineInputs> {
    inputs.last().map(|(_, message)| message)
}

/// Opens a core with drives in operation whose bridge reports an open probe.
fn open(stage: &mut Stage<'_>) -> Result<TestCore, CaseError> {
    let mut core = up(stage)?;
    let begin_ns = monotonic_ns();
    loop {
        core.take_inputs();
        core.rest(0.2);
        let inputs = core.take_inputs();
        let state = newest(&inputs).map(|message| message.probe);
        if state == Some(OPEN) {
            return Ok(core);
        }
        demand(monotonic_ns() - begin_ns < (LATEST_S * 1e9) as u64, || {
            let description = state.map_or("no inputs arrive".to_owned(), |state| {
                format!("its state is {state}")
            });
            format!(
                "the probe is not open at the start ({description}); a bridge without one is tested \
                 without --probe"
            )
        })?;
    }
}

/// Moves the first axis until the probe trips, and stops.
fn approach(core: &mut TestCore, speed: f64) -> Approach {
    core.take_log();
    core.take_inputs();
    let from = core.commanded()[0];
    let mut inputs = Vec::new();
    let trips = |inputs: &[MachineInputs]| inputs.last().is_some_and(|message| message.probe == TRIPPED);
    core.creep(speed, &mut |core| {
        inputs.extend(core.take_inputs().into_iter().map(|(_, message)| message));
        core.commanded()[0] - from < REACH_MM && !trips(&inputs)
    });
    // Sent setpoints are due a lead later.
    core.rest((LEAD * PERIOD_NS) as f64 * 1e-9 + 0.3);
    inputs.extend(core.take_inputs().into_iter().map(|(_, message)| message));
    Approach {
        speed,
        inputs,
        feedback: core.take_log(),
    }
}

/// Judges the sequence of messages of the probe.
fn judge_messages(inputs: &[MachineInputs]) -> Judged {
    for message in inputs {
        demand(matches!(message.probe, OPEN | TRIPPED), || {
            format!(
                "the state of the probe is {}: 1 is open, 2 tripped",
                message.probe
            )
        })?;
        demand(message.probe_time_ns <= message.time_ns + STAMP_NS, || {
            let late = message.probe_time_ns - message.time_ns;
            format!("the probe changes {late} ns after the message that reports it")
        })?;
    }
    for pair in inputs.windows(2) {
        let [before, next] = [&pair[0], &pair[1]];
        demand(next.probe_trips >= before.probe_trips, || {
            format!(
                "{} trips of the probe after {}",
                next.probe_trips, before.probe_trips
            )
        })?;
        let has_tripped = next.probe == TRIPPED && before.probe == OPEN;
        demand(!has_tripped || next.probe_trips > before.probe_trips, || {
            "the probe trips, and probe_trips does not increase".to_owned()
        })?;
        let is_same = next.probe == before.probe && next.probe_trips == before.probe_trips;
        demand(!is_same || next.probe_time_ns == before.probe_time_ns, || {
            "probe_time_ns changes without a change of the probe".to_owned()
        })?;
    }
    Ok(())
}

/// Position of the first axis at a time, by the feedback.
fn position_at(time_ns: u64, feedback: &[FeedbackSample]) -> Option<f64> {
    let after = feedback
        .iter()
        .position(|sample| sample.feedback.time_ns >= time_ns)?;
    let (next, before) = (
        &feedback[after].feedback,
        &feedback[after.checked_sub(1)?].feedback,
    );
    let fraction = (time_ns - before.time_ns) as f64 / (next.time_ns - before.time_ns).max(1) as f64;
    Some(before.position[0] + fraction * (next.position[0] - before.position[0]))
}

/// Position of the first contact.
fn contact(approach: &Approach) -> Result<f64, CaseError> {
    judge_messages(&approach.inputs)?;
    let Some(tripped) = approach.inputs.iter().find(|message| message.probe == TRIPPED) else {
        return Err(CaseError::new(format!(
            "the probe touches nothing within {REACH_MM} mm of the first axis"
        )));
    };
    let position = position_at(tripped.probe_time_ns, &approach.feedback).ok_or_else(|| {
        CaseError::new("probe_time_ns of a contact is not within the motion that led to it")
    })?;
    // A motion that was interrupted hides a late time stamp.
    let [from_ns, to_ns] = [
        tripped.probe_time_ns.saturating_sub(EVEN_NS),
        tripped.probe_time_ns + EVEN_NS / 2,
    ];
    let ends = [from_ns, to_ns].map(|time_ns| position_at(time_ns, &approach.feedback));
    if let [Some(from), Some(to)] = ends {
        let distance = approach.speed * (to_ns - from_ns) as f64 * 1e-9;
        if (to - from - distance).abs() > 0.1 * distance + SAME {
            return Err(CaseError::unmeasured(format!(
                "{:.3} mm instead of {distance:.3} mm around the contact",
                to - from
            )));
        }
    }
    if tripped.probe_latched_mask & 1 != 0 {
        let off = (tripped.probe_position[0] - position).abs();
        demand(off <= LATCHED, || {
            format!("the latched position is {off:.3} mm from where the axis was at probe_time_ns")
        })?;
    }
    Ok(position)
}

/// Returns to the start of the approach, and waits until the probe is open.
fn go_back(core: &mut TestCore, start: f64) -> Judged {
    let by = start - core.commanded()[0];
    core.take_inputs();
    core.move_by(by, 1.0, &mut |_| crate::test_core::Fate::Sent);
    core.rest((LEAD * PERIOD_NS) as f64 * 1e-9 + 0.3);
    let inputs = core.take_inputs();
    let all: Vec<_> = inputs.iter().map(|(_, message)| *message).collect();
    judge_messages(&all)?;
    demand(
        newest(&inputs).is_some_and(|message| message.probe == OPEN),
        || "the probe is still tripped at a position where it touched nothing before".to_owned(),
    )
}

pub(crate) fn probe(stage: &mut Stage<'_>) -> Judged {
    let mut core = open(stage)?;
    let start = core.commanded()[0];
    let mut contacts = Vec::new();
    for speed in SPEEDS {
        let approach = approach(&mut core, speed);
        contacts.push(contact(&approach)?);
        go_back(&mut core, start)?;
    }
    let apart = (contacts[0] - contacts[1]).abs();
    demand(apart <= SAME, || {
        format!(
            "contacts at {:.3} mm at {} mm/s and at {:.3} mm at {} mm/s: probe_time_ns is late",
            contacts[0], SPEEDS[0], contacts[1], SPEEDS[1]
        )
    })
}
