//! Faults that the simulation can produce.

use core::fmt;
use core::str::FromStr;

use thiserror::Error;

/// Letters in the order of the axes.
const LETTERS: &str = "XYZABCUVW";

/// Kinds of faults.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum FaultKind {
    /// Feedback arrives 100 ms late.
    Late,
    /// No feedback.
    Silent,
    /// The same feedback is repeated, with its old time stamp.
    Frozen,
    /// The encoder of one axis shows a constant position while the axis moves.
    Stuck,
    /// A drive goes into fault.
    Fault,
    /// A drive loses its enabling input and switches off.
    Off,
    /// The reported position of one axis jumps by 5 mm or degrees.
    Jump,
    /// One axis is blocked and lags its target.
    Blocked,
    /// The reported position is NaN.
    Nan,
    /// The reported position is impossible.
    Wild,
    /// The time stamps are an hour ahead.
    Ahead,
    /// The load sensor reads zero, as it does without supply.
    LoadZero,
    /// The load sensor sends nothing.
    LoadLost,
    /// The load sensor repeats the same reading.
    LoadFrozen,
    /// The load sensor sends NaN.
    LoadNan,
    /// The load sensor reads the end of its range.
    LoadSaturated,
    /// The load sensor reads far below zero, as with a broken wire.
    LoadNegative,
    /// The drives of the spindles go into fault.
    SpindleFault,
    /// The spindles send nothing.
    SpindleSilent,
    /// The spindles run at half of their speed.
    SpindleSlow,
    /// The spindles are stalled by the cut.
    SpindleStall,
    /// The home switch of one axis is stuck closed.
    SwitchClosed,
    /// The home switch of one axis is stuck open.
    SwitchOpen,
    /// The encoder of one axis has no index pulses.
    IndexMissing,
    /// The absolute encoder of one axis has lost its zero.
    AbsoluteLost,
}

impl FaultKind {
    /// All kinds with their names.
    pub const ALL: [(Self, &'static str); 25] = [
        (Self::Late, "late"),
        (Self::Silent, "silent"),
        (Self::Frozen, "frozen"),
        (Self::Stuck, "stuck"),
        (Self::Fault, "fault"),
        (Self::Off, "off"),
        (Self::Jump, "jump"),
        (Self::Blocked, "blocked"),
        (Self::Nan, "nan"),
        (Self::Wild, "wild"),
        (Self::Ahead, "ahead"),
        (Self::LoadZero, "load-zero"),
        (Self::LoadLost, "load-lost"),
        (Self::LoadFrozen, "load-frozen"),
        (Self::LoadNan, "load-nan"),
        (Self::LoadSaturated, "load-saturated"),
        (Self::LoadNegative, "load-negative"),
        (Self::SpindleFault, "spindle-fault"),
        (Self::SpindleSilent, "spindle-silent"),
        (Self::SpindleSlow, "spindle-slow"),
        (Self::SpindleStall, "spindle-stall"),
        (Self::SwitchClosed, "switch-closed"),
        (Self::SwitchOpen, "switch-open"),
        (Self::IndexMissing, "index-missing"),
        (Self::AbsoluteLost, "absolute-lost"),
    ];

    /// Whether this is a fault of the load sensor, which does not affect the drives.
    #[must_use]
    pub const fn is_of_load(self) -> bool {
        matches!(
            self,
            Self::LoadZero
                | Self::LoadLost
                | Self::LoadFrozen
                | Self::LoadNan
                | Self::LoadSaturated
                | Self::LoadNegative
        )
    }

    /// Whether this is a fault of the spindles, which does not affect the drives.
    #[must_use]
    pub const fn is_of_spindle(self) -> bool {
        matches!(
            self,
            Self::SpindleFault | Self::SpindleSilent | Self::SpindleSlow | Self::SpindleStall
        )
    }

    /// Whether this fault has an effect only during homing: a switch, an index pulse or an absolute encoder.
    #[must_use]
    pub const fn is_of_homing(self) -> bool {
        matches!(
            self,
            Self::SwitchClosed | Self::SwitchOpen | Self::IndexMissing | Self::AbsoluteLost
        )
    }

    /// The name on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        Self::ALL
            .iter()
            .find(|(kind, _)| *kind == self)
            .map_or("", |(_, name)| name)
    }
}

/// A scheduled fault: `KIND@SECONDS[+DURATION][:AXIS]`, as in `silent@2.5+0.1` or `jump@3:Y`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fault {
    /// Kind of the fault.
    pub kind: FaultKind,
    /// Start, ns after the drives were first operational.
    pub at_ns: u64,
    /// Duration, ns; without end if `None`.
    pub duration_ns: Option<u64>,
    /// Index of the axis; the first axis of the machine if `None`.
    pub axis: Option<usize>,
}

impl Fault {
    /// Whether the fault is active at `now_ns`.
    #[must_use]
    pub const fn is_active(&self, now_ns: u64) -> bool {
        let begun = now_ns >= self.at_ns;
        match self.duration_ns {
            Some(duration_ns) => begun && now_ns - self.at_ns < duration_ns,
            None => begun,
        }
    }
}

/// A text that is not a fault.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error(
    "{text:?} is not a fault: give KIND@SECONDS[+DURATION][:AXIS] with one of late, silent, frozen, stuck, \
     fault, off, jump, blocked, nan, wild, ahead, load-zero, load-lost, load-frozen, load-nan, \
     load-saturated, load-negative, spindle-fault, spindle-silent, spindle-slow, spindle-stall, \
     switch-closed, switch-open, index-missing, absolute-lost, as in `jump@2.5:Y`"
)]
pub struct FaultError {
    text: String,
}

impl FromStr for Fault {
    type Err = FaultError;

    fn from_str(text: &str) -> Result<Self, FaultError> {
        let failed = || FaultError {
            text: text.chars().take(60).collect(),
        };
        let ns = |text: &str| -> Result<u64, FaultError> {
            let seconds: f64 = text.parse().map_err(|_| failed())?;
            if !(0.0..=1e6).contains(&seconds) {
                return Err(failed());
            }
            Ok((seconds * 1e9) as u64)
        };
        let (name, rest) = text.split_once('@').ok_or_else(failed)?;
        let (kind, _) = FaultKind::ALL
            .into_iter()
            .find(|(_, known)| *known == name)
            .ok_or_else(failed)?;
        let (times, axis) = match rest.split_once(':') {
            None => (rest, None),
            Some((times, letter)) => {
                let known = letter.len() == 1;
                let index = LETTERS.find(&letter.to_ascii_uppercase()).filter(|_| known);
                (times, Some(index.ok_or_else(failed)?))
            }
        };
        let (at, duration) = match times.split_once('+') {
            None => (times, None),
            Some((at, duration)) => (at, Some(ns(duration)?)),
        };
        Ok(Self {
            kind,
            at_ns: ns(at)?,
            duration_ns: duration,
            axis,
        })
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}@{}", self.kind.name(), self.at_ns as f64 / 1e9)?;
        if let Some(duration_ns) = self.duration_ns {
            write!(f, "+{}", duration_ns as f64 / 1e9)?;
        }
        match self.axis.and_then(|axis| LETTERS.chars().nth(axis)) {
            Some(letter) => write!(f, ":{letter}"),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read() {
        for text in [
            "late@0",
            "silent@2.5+0.1",
            "jump@3:Y",
            "fault@0.25+1:W",
            "nan@1000000",
            "load-zero@3.5",
        ] {
            let fault: Fault = text.parse().expect("a fault");
            assert_eq!(fault.to_string(), text);
        }
        let fault: Fault = "off@1.5+0.5:z".parse().expect("a fault");
        assert_eq!((fault.kind, fault.axis), (FaultKind::Off, Some(2)));
        let active: Vec<bool> = [1.4, 1.5, 1.9, 2.0]
            .into_iter()
            .map(|seconds| fault.is_active((seconds * 1e9) as u64))
            .collect();
        assert_eq!(active, [false, true, true, false]);
    }

    #[test]
    fn anything_else_is_refused_with_a_pattern() {
        for text in [
            "",
            "@",
            "late",
            "late@",
            "late@x",
            "late@-1",
            "late@nan",
            "late@1e9",
            "late@1:Q",
            "late@1:",
            "late@1:XY",
            "late@1+",
            "tired@1",
            "late@1:é",
        ] {
            let error = text.parse::<Fault>().expect_err(text);
            assert!(error.to_string().contains("jump@2.5:Y"), "{error}");
        }
    }
}
