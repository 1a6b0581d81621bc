//! Faults that the simulation can produce.

use core::fmt;
use core::str::FromStr;

use thiserror::Error;

/// Kinds of faults.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum FaultKind {
    /// Frames do not come back.
    Loss,
    /// Frames come back 5 ms late.
    Delay,
    /// Every second frame is overtaken by the next one.
    Reorder,
    /// A device does not increment the working counter of logical datagrams, and accepts no outputs.
    WorkingCounter,
    /// The cable before a device is open; the devices after it continue without the fieldbus.
    Break,
    /// A device has no supply; the devices after it are cut off.
    Gone,
    /// A drive faults: 2310h, continuous overcurrent.
    Drive,
    /// A drive faults: 4310h, overtemperature.
    Temperature,
    /// A drive's safe torque off.
    TorqueOff,
    /// A drive's load is blocked.
    Blocked,
    /// Both limit switches of a drive are closed.
    Limit,
    /// A drive's encoder gives no zero impulse.
    IndexMissing,
    /// The clock of a device does not follow the reference, but runs at the rate of its crystal.
    ClockFree,
    /// SDO requests are aborted: 0800 0000h, general error.
    SdoAbort,
    /// Replies to SDO requests are for another object.
    SdoWrong,
    /// The mailbox takes 300 ms to reply.
    SlowMailbox,
    /// An emergency message (7121h) is in the mailbox in PRE-OP, and precedes each SDO reply.
    Emergency,
    /// A device refuses SAFE-OP: AL status code 0024h, invalid input mapping.
    RefuseSafeOp,
    /// A device refuses OP: AL status code 0035h, invalid sync cycle time.
    RefuseOp,
}

impl FaultKind {
    /// All kinds with their names.
    pub const ALL: [(Self, &'static str); 19] = [
        (Self::Loss, "loss"),
        (Self::Delay, "delay"),
        (Self::Reorder, "reorder"),
        (Self::WorkingCounter, "wkc"),
        (Self::Break, "break"),
        (Self::Gone, "gone"),
        (Self::Drive, "drive"),
        (Self::Temperature, "temperature"),
        (Self::TorqueOff, "sto"),
        (Self::Blocked, "blocked"),
        (Self::Limit, "limit"),
        (Self::IndexMissing, "index-missing"),
        (Self::ClockFree, "clock-free"),
        (Self::SdoAbort, "sdo-abort"),
        (Self::SdoWrong, "sdo-wrong"),
        (Self::SlowMailbox, "slow-mailbox"),
        (Self::Emergency, "emergency"),
        (Self::RefuseSafeOp, "refuse-safe-op"),
        (Self::RefuseOp, "refuse-op"),
    ];

    /// The name on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        Self::ALL
            .iter()
            .find(|(kind, _)| *kind == self)
            .map_or("", |(_, name)| name)
    }
}

/// A scheduled fault: `KIND@SECONDS[+DURATION][:DEVICE]`, as in `loss@2.5+0.01` or `gone@3+1:2`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fault {
    /// Kind of the fault.
    pub kind: FaultKind,
    /// Start, ns after all devices were first in OP.
    pub at_ns: u64,
    /// Duration, ns; without end if `None`.
    pub duration_ns: Option<u64>,
    /// Position of the device in the ring.
    pub device: usize,
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
    "`{text}` is no fault: expected KIND@SECONDS[+DURATION][:DEVICE], for example `loss@2.5+0.01`, with \
     KIND one of {kinds}"
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
    let kind = FaultKind::ALL.iter().find(|(_, known)| *known == name)?.0;
    let (times, device) = rest
        .split_once(':')
        .map_or((rest, Some(0)), |(times, device)| (times, device.parse().ok()));
    let (at, duration) = times
        .split_once('+')
        .map_or((times, None), |(at, duration)| (at, Some(duration)));
    let ns = |text: &str| {
        text.parse::<f64>()
            .ok()
            .filter(|s| (0.0..1e6).contains(s))
            .map(|s| (s * 1e9) as u64)
    };
    let duration_ns = match duration {
        Some(duration) => Some(ns(duration)?),
        None => None,
    };
    Some(Fault {
        kind,
        at_ns: ns(at)?,
        duration_ns,
        device: device?,
    })
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}@{}", self.kind.name(), self.at_ns as f64 * 1e-9)?;
        if let Some(duration_ns) = self.duration_ns {
            write!(f, "+{}", duration_ns as f64 * 1e-9)?;
        }
        write!(f, ":{}", self.device)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_and_faults() {
        for (_, name) in FaultKind::ALL {
            let fault: Fault = format!("{name}@2.5+0.01:3").parse().expect("a fault");
            assert_eq!(fault.to_string(), format!("{name}@2.5+0.01:3"));
            assert!(
                !fault.is_active(2_499_999_999)
                    && fault.is_active(2_500_000_000)
                    && !fault.is_active(2_510_000_000)
            );
        }
        for bad in [
            "", "loss", "loss@", "loss@x", "loss@-1", "loss@1+", "loss@1:x", "fire@1", "loss@NaN",
        ] {
            assert!(bad.parse::<Fault>().is_err(), "{bad}");
        }
    }
}
