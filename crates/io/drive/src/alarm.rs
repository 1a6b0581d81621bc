//! Faults of drives or bridge, with their alarm numbers.

use evolvent_path::AxisLetter;
use evolvent_wire::{BRIDGE_NOTES, BRIDGE_STATES};
use thiserror::Error;

/// What to do about an error code of a drive.
const fn fault_advice(error_code: u32) -> &'static str {
    match error_code {
        // CiA 402: communication. Bridges report it of every drive whose data they do not have.
        0x7500..=0x75FF => {
            "its link to the bridge was lost, and possibly that of other drives; read the bridge's messages, \
             check cables and supplies, reset"
        }
        _ => "see the drive's manual, remove the cause, reset",
    }
}

/// The name of a number on the bus, after a space; nothing if it has none.
fn named(names: &[(&'static str, u32)], number: u32) -> String {
    let name = names.iter().find(|(_, known)| *known == number);
    name.map_or_else(String::new, |(name, _)| format!(" {name}"))
}

fn ms(ns: u64) -> f64 {
    (ns / 1000) as f64 / 1000.0
}

/// Why the machine must stop: the first fault found in the feedback. `Copy`, so that the cycle can create and
/// return it. Axes are indices into X Y Z A B C U V W; lengths are mm or degrees.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum DriveAlarm {
    /// No feedback has arrived.
    #[error("no feedback within {:.0} ms: start the drive bridge, or check why it does not reply", ms(*waited_ns))]
    Missing {
        /// Time since power was requested.
        waited_ns: u64,
    },
    /// Feedback arrived before, and has stopped.
    #[error(
        "the last feedback is {:.1} ms old, {:.1} ms are permitted (it replied to setpoint {sequence}): the \
         bridge has died \
         or is cut off, restart it",
        ms(*age_ns), ms(*limit_ns)
    )]
    Stale {
        /// Age of the newest sample.
        age_ns: u64,
        /// The maximum age permitted.
        limit_ns: u64,
        /// The setpoint that it replied to.
        sequence: u64,
    },
    /// Messages arrive, but their samples do not become newer.
    #[error(
        "feedback arrives, but has repeated the sample of setpoint {sequence} for {:.1} ms: the bridge runs \
         without its drives, check the fieldbus",
        ms(*age_ns)
    )]
    Frozen {
        /// Age of the newest sample.
        age_ns: u64,
        /// The setpoint that it replied to.
        sequence: u64,
    },
    /// An axis was commanded to move and its encoder shows the same value.
    #[error(
        "axis {} was moved by {commanded:.3} and its feedback stayed at {position:.3} to the last bit: \
         check its encoder",
        AxisLetter::letter_of(*axis)
    )]
    FrozenAxis {
        /// The axis.
        axis: usize,
        /// Commanded travel since the position last changed.
        commanded: f64,
        /// The position that does not change.
        position: f64,
    },
    /// A value is not a number.
    #[error("the feedback of axis {} is not a number: check its encoder and the bridge", AxisLetter::letter_of(*axis))]
    NotFinite {
        /// The axis.
        axis: usize,
    },
    /// The bridge sends no values for an axis of the machine.
    #[error("the bridge sends no values for axis {}: configure it for the machine's axes", AxisLetter::letter_of(*axis))]
    AxisMissing {
        /// The axis.
        axis: usize,
    },
    /// A drive is in fault.
    #[error(
        "the drive of axis {} is in fault (status word {status_word:#06x}, error code {error_code:#06x}): {}",
        AxisLetter::letter_of(*axis),
        fault_advice(*error_code)
    )]
    DriveFault {
        /// The axis.
        axis: usize,
        /// Object 6041h.
        status_word: u32,
        /// Object 603Fh of the first axis in fault.
        error_code: u32,
    },
    /// A drive has left operation without a fault.
    #[error(
        "the drive of axis {} has switched itself off (status word {status_word:#06x}): check its enable \
         input and its supply; a drive that homes by itself switches off to home: switch on again afterwards",
        AxisLetter::letter_of(*axis)
    )]
    DriveOff {
        /// The axis.
        axis: usize,
        /// Object 6041h.
        status_word: u32,
    },
    /// A drive does not come into operation.
    #[error(
        "the drive of axis {} was not ready within {:.0} ms (status word {status_word:#06x}): check supply, \
         safety circuit and bridge; if the drive homes by itself, wait until it has homed, then switch off \
         and on",
        AxisLetter::letter_of(*axis), ms(*waited_ns)
    )]
    NotEnabled {
        /// The axis.
        axis: usize,
        /// Object 6041h.
        status_word: u32,
        /// Time since power was requested.
        waited_ns: u64,
    },
    /// The position stepped further than the axis can move.
    #[error(
        "the feedback of axis {} jumped by {step:.3} in {:.2} ms, {bound:.3} are possible: check encoder \
         and cable, and \
         home again",
        AxisLetter::letter_of(*axis), ms(*interval_ns)
    )]
    Jump {
        /// The axis.
        axis: usize,
        /// The step.
        step: f64,
        /// The maximum possible.
        bound: f64,
        /// Time between the two samples.
        interval_ns: u64,
    },
    /// The axis is not at its commanded position.
    #[error(
        "axis {} is {error:.3} off its setpoint, {bound:.3} is permitted at {velocity:.1} per second: check \
         for a blocked axis or a weak drive, or permit more (following_error_* in the machine file)",
        AxisLetter::letter_of(*axis)
    )]
    FollowingError {
        /// The axis.
        axis: usize,
        /// Demanded minus actual.
        error: f64,
        /// The maximum permitted at this velocity.
        bound: f64,
        /// Commanded velocity, the recent peak.
        velocity: f64,
    },
    /// The axis has run onto a limit switch.
    #[error(
        "axis {} has run onto its {} limit switch: jog it off the switch in the other direction",
        AxisLetter::letter_of(*axis), if *positive { "positive" } else { "negative" }
    )]
    LimitSwitch {
        /// The axis.
        axis: usize,
        /// Which end.
        positive: bool,
    },
    /// The bridge was restarted under power.
    #[error(
        "the bridge was restarted while power was on: switch off and on again, and home if it has lost its \
         positions"
    )]
    BridgeRestarted,
    /// The bridge stopped following.
    #[error(
        "the bridge has stopped the axes (bridge state {state}{}, note {note}{}): it received no usable \
         setpoints, or has ended its session; check the core's lateness and the bridge's messages",
        named(&BRIDGE_STATES, *state), named(&BRIDGE_NOTES, *note)
    )]
    BridgeStopped {
        /// A number of the bus's list of bridge states.
        state: u32,
        /// A number of the bus's list of notes.
        note: u32,
    },
    /// Replies to setpoints that were never sent.
    #[error(
        "the bridge replies to setpoint {sequence}, the last sent is {sent}: it belongs to another core, \
         restart it"
    )]
    Implausible {
        /// The setpoint that it replies to.
        sequence: u64,
        /// The newest one sent.
        sent: u64,
    },
    /// A sample is from the future.
    #[error(
        "the feedback's time_ns is {:.1} ms ahead of this computer's CLOCK_MONOTONIC, so its age is \
         unknown: the bridge has to send the time at which it sampled, in ns of that clock",
        ms(*ahead_ns)
    )]
    AheadOfTime {
        /// By how much.
        ahead_ns: u64,
    },
    /// A field has an impossible value.
    #[error(
        "the feedback's {field}{} is {value:.6e}, at most {bound:.6e} is possible: check {} and bridge; the \
         whole message was rejected",
        axis.map(|axis| format!(" of axis {}", AxisLetter::letter_of(axis))).unwrap_or_default(),
        source_of(field)
    )]
    Unbelievable {
        /// Its name on the bus.
        field: &'static str,
        /// The axis, for a field with one value per axis.
        axis: Option<usize>,
        /// The value.
        value: f64,
        /// The maximum magnitude.
        bound: f64,
    },
    /// Positions refer to another datum.
    #[error("the bridge still uses datum {found}, the core datum {expected}: home again")]
    Datum {
        /// The core's.
        expected: u64,
        /// The bridge's.
        found: u64,
    },
}

impl DriveAlarm {
    /// The alarm's stable number: 400 to 417.
    #[must_use]
    pub const fn number(&self) -> u32 {
        match self {
            Self::Missing { .. } => 400,
            Self::Stale { .. } => 401,
            Self::Frozen { .. } => 402,
            Self::FrozenAxis { .. } => 403,
            Self::NotFinite { .. } => 404,
            Self::AxisMissing { .. } => 405,
            Self::DriveFault { .. } => 406,
            Self::DriveOff { .. } => 407,
            Self::NotEnabled { .. } => 408,
            Self::Jump { .. } => 409,
            Self::FollowingError { .. } => 410,
            Self::LimitSwitch { .. } => 411,
            Self::BridgeRestarted => 412,
            Self::BridgeStopped { .. } => 413,
            Self::Implausible { .. } => 414,
            Self::Datum { .. } => 415,
            Self::AheadOfTime { .. } => 416,
            Self::Unbelievable { .. } => 417,
        }
    }

    /// Whether the drives still follow setpoints as far as is known, so that a stop along the path can be
    /// commanded; otherwise only a quick stop of the drives is left.
    #[must_use]
    pub const fn drives_follow(&self) -> bool {
        matches!(
            self,
            Self::Stale { .. }
                | Self::Frozen { .. }
                | Self::LimitSwitch { .. }
                | Self::FollowingError { .. }
                | Self::Jump { .. }
                | Self::FrozenAxis { .. }
                | Self::NotFinite { .. }
                | Self::Implausible { .. }
                | Self::Datum { .. }
                | Self::AheadOfTime { .. }
                | Self::Unbelievable { .. }
        )
    }
}

/// The source of a field, for the alarm's text: an implausible position may come from an encoder with another
/// zero.
fn source_of(field: &str) -> &'static str {
    match field {
        "position" => "encoder, `zero` of the axis in the bridge's file,",
        _ => "encoder",
    }
}
