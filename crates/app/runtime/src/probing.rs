//! Converts a probing move of a program to one of the machine, and explains its result.

use std::convert::Infallible;
use std::path::Path;

use evolvent_gcode::{Diagnostic, Move, MoveKind, PathMode};
use evolvent_motion::{ProbeMove, ProbeResult, ProbeVerdict, Probing};
use evolvent_planner::MoveValidator;

use crate::job::Setup;
use crate::refusal::{about_line_with, explain};

/// Time that a change of the probe takes to the cycle besides the lead, s: the publisher polls every
/// millisecond, and bridges send as often.
const NOTICE_S: f64 = 0.002;

/// Why a probing move is refused.
pub(crate) enum ProbeObjection {
    Words(String, String),
    Travel(evolvent_planner::PlanError<Infallible>),
}

impl ProbeObjection {
    pub(crate) fn diagnostic(self, file: &Path, line: u32) -> Diagnostic {
        match self {
            Self::Words(message, help) => about_line_with(message, Some(help), file, line),
            Self::Travel(error) => explain(&error, file, line),
        }
    }
}

fn lead_s(setup: &Setup) -> f64 {
    f64::from(setup.machine.lead_cycles(setup.period_ns)) * setup.period_ns as f64 * 1e-9
}

/// The machine's objection to a probing move, if any.
pub(crate) fn objection(order: &ProbeMove, setup: &Setup) -> Option<ProbeObjection> {
    let Some(probe) = setup.machine.signals.probe else {
        return Some(ProbeObjection::Words(
            "G38: the machine file has no probe".to_owned(),
            "add [probe] to the machine file; a bridge reports the state of the probe on the bus".to_owned(),
        ));
    };
    // The stop after contact ends before the end of the move, so it is within the travel if the move is.
    let motion = Move {
        curve: order.curve,
        kind: MoveKind::Feed,
        feed_mm_s: order.feed_mm_s,
        path_mode: PathMode::ExactPath,
    };
    let limits = setup.machine.limits();
    if let Err(error) = MoveValidator::new(&limits).validate(&motion) {
        return Some(ProbeObjection::Travel(error));
    }
    let feed = order.feed_mm_s;
    let delay_s = lead_s(setup) + NOTICE_S;
    let distance = order.stopping_distance(&limits) + feed * delay_s;
    let max_overtravel = probe.overtravel_mm?;
    (order.toward && distance > max_overtravel).then(|| {
        ProbeObjection::Words(
            format!(
                "G38 at {:.1} mm/min continues for up to {distance:.3} mm after contact ({:.1} ms until it \
                 is detected, then the stop), but probe.overtravel_mm is {max_overtravel}",
                feed * 60.0,
                delay_s * 1e3
            ),
            "probe more slowly".to_owned(),
        )
    })
}

/// The move as the cycle takes it.
pub(crate) fn probing(order: ProbeMove, setup: &Setup) -> Probing {
    Probing::new(order, &setup.machine.limits(), lead_s(setup))
}

/// The error and its remedy; `None` if the program continues.
pub(crate) fn complaint(result: &ProbeResult, toward: bool, must: bool) -> Option<(String, String)> {
    let event = if toward { "contact" } else { "loss of contact" };
    let (message, help) = match result.verdict {
        ProbeVerdict::Contact | ProbeVerdict::Imagined => return None,
        ProbeVerdict::NoContact if !must => return None,
        ProbeVerdict::NoContact => (
            format!("the probe has reached the end of the move without {event}"),
            format!(
                "move the end of the move farther, check probe and wiring, or write {} and check #5070",
                if toward { "G38.3" } else { "G38.5" }
            ),
        ),
        // As in LinuxCNC, G38.3 and G38.5 do not make this an error.
        ProbeVerdict::ChangedBefore if !must => return None,
        ProbeVerdict::ChangedBefore if toward => (
            "the probe is tripped before the move begins; nothing has moved".to_owned(),
            "move it clear first (G38.4 away from the part), and check its wiring and sense".to_owned(),
        ),
        ProbeVerdict::ChangedBefore => (
            "the probe is open before the move begins, so there is no contact to lose; nothing has moved"
                .to_owned(),
            "make contact first (G38.2)".to_owned(),
        ),
        ProbeVerdict::Lost => (
            "the state of the probe became unknown while it moved; the axes have stopped".to_owned(),
            "check the bridge: `evolvent top NAME` shows the probe".to_owned(),
        ),
        ProbeVerdict::Unknown => (
            "the state of the probe is unknown; nothing has moved".to_owned(),
            "start the bridge that reads it and reports it as OPEN or TRIPPED in its inputs".to_owned(),
        ),
        ProbeVerdict::NoPosition => (
            "contact was made, but its position was not received in time".to_owned(),
            "check that the bridge sends feedback, and that its times are correct".to_owned(),
        ),
    };
    Some((message, help))
}
