//! Faults that the simulation can produce.

use core::str::FromStr;

use thiserror::Error;

/// Kinds of faults.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum FaultKind {
    /// Packets are lost on the way to the board.
    LossIn,
    /// Packets are lost on the way back.
    LossOut,
    /// Every second packet is lost, in each direction.
    Half,
    /// Replies are 5 ms late.
    Delay,
    /// Every second reply is overtaken by the one after it.
    Reorder,
    /// The watchdog expires.
    Bite,
    /// The board loses its supply for a moment and starts again.
    Reset,
    /// The configuration cookie has a wrong value.
    Cookie,
    /// Replies are truncated.
    Short,
    /// The field supply of smart-serial devices is off.
    FieldOff,
    /// The index inputs of encoders are not wired.
    IndexMissing,
    /// The cut stalls the spindle.
    SpindleStall,
    /// The encoder of the spindle gives no counts.
    EncoderOff,
    /// The encoder of the spindle loses one count of fifty.
    LostCounts,
}

impl FaultKind {
    /// All kinds with their names.
    pub const ALL: [(Self, &'static str); 14] = [
        (Self::LossIn, "loss-in"),
        (Self::LossOut, "loss-out"),
        (Self::Half, "half"),
        (Self::Delay, "delay"),
        (Self::Reorder, "reorder"),
        (Self::Bite, "bite"),
        (Self::Reset, "reset"),
        (Self::Cookie, "cookie"),
        (Self::Short, "short"),
        (Self::FieldOff, "field-off"),
        (Self::IndexMissing, "index-missing"),
        (Self::SpindleStall, "spindle-stall"),
        (Self::EncoderOff, "encoder-off"),
        (Self::LostCounts, "lost-counts"),
    ];
}

/// A scheduled fault: `KIND@SECONDS[+DURATION]`, as in `loss-out@2.5+0.01`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fault {
    /// Kind of the fault.
    pub kind: FaultKind,
    /// Start, ns after the watchdog was first fed.
    pub at_ns: u64,
    /// Duration, ns; without end if `None`.
    pub duration_ns: Option<u64>,
}

impl Fault {
    /// Whether the fault is active at `now_ns`.
    #[must_use]
    pub const fn is_active(&self, now_ns: u64) -> bool {
        now_ns >= self.at_ns
            && match self.duration_ns {
                Some(duration_ns) => now_ns - self.at_ns < duration_ns,
                None => true,
            }
    }
}

/// A text that is not a fault.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error(
    "`{text}` is no fault: expected KIND@SECONDS[+DURATION], for example `loss-out@2.5+0.01`, with KIND one \
     of {kinds}"
)]
pub struct FaultError {
    text: String,
    kinds: String,
}

impl FromStr for Fault {
    type Err = FaultError;

    fn from_str(text: &str) -> Result<Self, FaultError> {
        parse(text).ok_or_else(|| FaultError {
            text: text.to_owned(),
            kinds: FaultKind::ALL.map(|(_, name)| name).join(", "),
        })
    }
}

fn parse(text: &str) -> Option<Fault> {
    let (name, rest) = text.split_once('@')?;
    let (kind, _) = FaultKind::ALL.into_iter().find(|(_, known)| *known == name)?;
    let (at, duration) = match rest.split_once('+') {
        Some((at, duration)) => (at, Some(duration)),
        None => (rest, None),
    };
    Some(Fault {
        kind,
        at_ns: ns(at)?,
        duration_ns: match duration {
            Some(duration) => Some(ns(duration)?),
            None => None,
        },
    })
}

fn ns(text: &str) -> Option<u64> {
    let seconds: f64 = text.parse().ok()?;
    (0.0..=1e6).contains(&seconds).then_some((seconds * 1e9) as u64)
}
