//! What can be wrong with drives or bridge, with the numbers that tell it.

use thiserror::Error;

/// Letters in the order of the axes.
const LETTERS: [char; 9] = ['X', 'Y', 'Z', 'A', 'B', 'C', 'U', 'V', 'W'];

fn letter(axis: usize) -> char {
    LETTERS.get(axis).copied().unwrap_or('?')
}

fn ms(ns: u64) -> f64 {
    (ns / 1000) as f64 / 1000.0
}

/// Why the machine must stop: the first thing that was found wrong with what comes back. `Copy`, so that the cycle may
/// make and return it. Axes are indices into X Y Z A B C U V W; lengths are mm or degrees.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum DriveAlarm {
    /// No feedback ever came.
    #[error("no feedback within {:.0} ms: start the drive bridge, or see why it does not answer", ms(*waited_ns))]
    Missing {
        /// Time since power was requested.
        waited_ns: u64,
    },
    /// Feedback came, and comes no more.
    #[error(
        "the last feedback is {:.1} ms old, {:.1} ms are allowed (it answered setpoint {sequence}): the bridge has died \
         or is cut off, restart it",
        ms(*age_ns), ms(*limit_ns)
    )]
    Stale {
        /// Age of the newest sample.
        age_ns: u64,
        /// The oldest allowed.
        limit_ns: u64,
        /// The setpoint that it answered.
        sequence: u64,
    },
    /// Messages come, but their samples do not grow younger.
    #[error(
        "feedback comes, but has repeated the sample of setpoint {sequence} for {:.1} ms: the bridge runs without its \
         drives, check the fieldbus",
        ms(*age_ns)
    )]
    Frozen {
        /// Age of the newest sample.
        age_ns: u64,
        /// The setpoint that it answered.
        sequence: u64,
    },
    /// An axis was commanded to move and its encoder shows the same number.
    #[error(
        "axis {} was moved by {commanded:.3} and its feedback stayed at {position:.3} to the last bit: check its encoder",
        letter(*axis)
    )]
    FrozenAxis {
        /// The axis.
        axis: usize,
        /// Commanded travel since the position last changed.
        commanded: f64,
        /// The position that does not change.
        position: f64,
    },
    /// A number is none.
    #[error("the feedback of axis {} is not a number: check its encoder and the bridge", letter(*axis))]
    NotFinite {
        /// The axis.
        axis: usize,
    },
    /// The bridge does not speak of an axis that the machine has.
    #[error("the bridge sends nothing of axis {}: give it the machine's axes", letter(*axis))]
    AxisMissing {
        /// The axis.
        axis: usize,
    },
    /// A drive is in fault.
    #[error(
        "the drive of axis {} is in fault (status word {status_word:#06x}, error code {error_code:#06x}): see the \
         drive's manual, remove the cause, reset",
        letter(*axis)
    )]
    DriveFault {
        /// The axis.
        axis: usize,
        /// Object 6041h.
        status_word: u32,
        /// Object 603Fh of the first axis in fault.
        error_code: u32,
    },
    /// A drive that was in operation is so no more, without a fault.
    #[error(
        "the drive of axis {} has switched off by itself (status word {status_word:#06x}): check its enabling input and \
         its supply",
        letter(*axis)
    )]
    DriveOff {
        /// The axis.
        axis: usize,
        /// Object 6041h.
        status_word: u32,
    },
    /// A drive does not come into operation.
    #[error(
        "the drive of axis {} was not ready within {:.0} ms (status word {status_word:#06x}): check supply, safety \
         circuit and bridge",
        letter(*axis), ms(*waited_ns)
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
        "the feedback of axis {} jumped by {step:.3} in {:.2} ms, {bound:.3} are possible: check encoder and cable, and \
         home again",
        letter(*axis), ms(*interval_ns)
    )]
    Jump {
        /// The axis.
        axis: usize,
        /// The step.
        step: f64,
        /// The largest possible.
        bound: f64,
        /// Time between the two samples.
        interval_ns: u64,
    },
    /// The axis is not where it was commanded.
    #[error(
        "axis {} is {error:.3} off its setpoint, {bound:.3} are allowed at {velocity:.1} a second: look for a blocked \
         axis or a weak drive, or allow more (following_error_* in the machine file)",
        letter(*axis)
    )]
    FollowingError {
        /// The axis.
        axis: usize,
        /// Demanded minus actual.
        error: f64,
        /// The largest allowed at this velocity.
        bound: f64,
        /// Commanded velocity, the recent peak.
        velocity: f64,
    },
    /// A limit switch was run onto.
    #[error(
        "axis {} has run onto its {} limit switch: jog it off the other way",
        letter(*axis), if *positive { "positive" } else { "negative" }
    )]
    LimitSwitch {
        /// The axis.
        axis: usize,
        /// Which end.
        positive: bool,
    },
    /// The bridge was started anew under power.
    #[error(
        "the bridge was restarted while power was on: switch off and on again, and home if it has lost its positions"
    )]
    BridgeRestarted,
    /// The bridge stopped following.
    #[error(
        "the bridge has stopped the axes by itself (bridge state {state}, note {note}): it got no usable setpoints; see \
         the core's lateness and the bridge's messages"
    )]
    BridgeStopped {
        /// A number of the bus's list of bridge states.
        state: u32,
        /// A number of the bus's list of notes.
        note: u32,
    },
    /// Answers to what was never asked.
    #[error(
        "the bridge answers setpoint {sequence}, the last sent is {sent}: it belongs to another core, restart it"
    )]
    Implausible {
        /// The setpoint that is answered.
        sequence: u64,
        /// The newest that was sent.
        sent: u64,
    },
    /// A sample is from the future.
    #[error(
        "the feedback's time_ns is {:.1} ms ahead of this computer's CLOCK_MONOTONIC, so its age cannot be told: let the \
         bridge send the time at which it sampled, in ns of that clock",
        ms(*ahead_ns)
    )]
    AheadOfTime {
        /// By how much.
        ahead_ns: u64,
    },
    /// A field has a value that it cannot have.
    #[error(
        "the feedback's {field}{} is {value:.6e}, at most {bound:.6e} is possible: check encoder and bridge, nothing of \
         this message was used",
        axis.map(|axis| format!(" of axis {}", letter(axis))).unwrap_or_default()
    )]
    Unbelievable {
        /// Its name on the bus.
        field: &'static str,
        /// The axis, of a field that has a value for each.
        axis: Option<usize>,
        /// The value.
        value: f64,
        /// The largest magnitude.
        bound: f64,
    },
    /// Positions are named by another datum.
    #[error("the bridge still names positions by datum {found}, the core by {expected}: home again")]
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

    /// Whether the drives themselves still follow setpoints as far as is known, so that a stop along the path is worth
    /// commanding; otherwise a quick stop of the drives is all that is left.
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
