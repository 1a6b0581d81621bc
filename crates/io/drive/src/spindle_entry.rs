//! Messages about spindles, checked on arrival.

use evolvent_wire::{SPINDLES, SpindleFeedback};

/// A speed above the spindle's maximum by more than this factor is implausible.
const MAX_OVERSPEED: f64 = 2.0;

/// Why a message was not used. The spindle keeps its state, and becomes unknown if no valid message arrives
/// in time.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum SpindleFault {
    /// An invalid spindle, flag, fraction of a turn or speed.
    #[error("its spindle, flags, fraction of a turn or speed is invalid")]
    Invalid,
    /// The machine file has no such spindle.
    #[error("the machine has no spindle {0} with feedback")]
    NoSpindle(u32),
    /// More than twice its maximum speed.
    #[error("spindle {spindle} turns at {speed_rpm} rpm, more than twice its max_rpm")]
    Overspeed {
        /// Which.
        spindle: u32,
        /// Its speed.
        speed_rpm: f64,
    },
    /// The time is ahead of this computer's clock.
    #[error("its time is {0} ns ahead of this computer's clock")]
    Ahead(u64),
    /// The time is too long ago.
    #[error("its time is {0} ns ago")]
    Past(u64),
    /// The number or the time does not grow.
    #[error("its number or time is not above that of the previous message")]
    Repeated,
    /// Another bridge reports the same spindle.
    #[error("another bridge reports its spindle")]
    Claimed,
}

/// Checks every message and keeps the state of the spindles. Neither allocates nor waits.
///
/// ```
/// use evolvent_drive::{SpindleEntry, SpindleFault};
/// use evolvent_wire::SpindleFeedback;
///
/// let mut entry = SpindleEntry::new(100_000_000).with_spindle(0, 6000.0);
/// let message = SpindleFeedback { sequence: 1, time_ns: 5_000_000, speed_rpm: 800.0, ..Default::default() };
/// entry.take(&message, 6_000_000)?;
/// assert_eq!(entry.known(6_000_000, 0).map(|known| known.speed_rpm), Some(800.0));
/// assert_eq!(entry.known(200_000_000, 0), None, "too long ago");
/// assert!(entry.has_reported(0));
/// let runaway = SpindleFeedback { sequence: 2, speed_rpm: 13_000.0, ..message };
/// assert!(matches!(entry.take(&runaway, 6_000_000), Err(SpindleFault::Overspeed { .. })));
/// # Ok::<(), SpindleFault>(())
/// ```
#[derive(Clone, Debug)]
pub struct SpindleEntry {
    /// Maximum speed of each spindle that has feedback, rpm.
    max_rpm: [Option<f64>; SPINDLES],
    timeout_ns: u64,
    newest: [Option<SpindleFeedback>; SPINDLES],
    refused: u64,
    last_fault: Option<SpindleFault>,
}

impl SpindleEntry {
    /// For a machine without spindles. `timeout_ns`: maximum age of the newest message of a spindle.
    #[must_use]
    pub const fn new(timeout_ns: u64) -> Self {
        Self {
            max_rpm: [None; SPINDLES],
            timeout_ns,
            newest: [None; SPINDLES],
            refused: 0,
            last_fault: None,
        }
    }

    /// Adds a spindle that has feedback. Numbers out of range are ignored.
    #[must_use]
    pub fn with_spindle(mut self, number: u32, max_rpm: f64) -> Self {
        if let Some(slot) = self.max_rpm.get_mut(number as usize) {
            *slot = Some(max_rpm);
        }
        self
    }

    /// Number of messages that were not used, and why the last was not.
    #[must_use]
    pub const fn refused(&self) -> (u64, Option<SpindleFault>) {
        (self.refused, self.last_fault)
    }

    /// Accepts a message that has arrived at `now_ns` of CLOCK_MONOTONIC.
    ///
    /// # Errors
    /// Its fault; it is then not used, and counted.
    pub fn take(&mut self, message: &SpindleFeedback, now_ns: u64) -> Result<(), SpindleFault> {
        let result = self.check(message, now_ns);
        match result {
            Ok(()) => {
                let mut message = *message;
                // Never later than its arrival.
                message.time_ns = message.time_ns.min(now_ns);
                self.newest[message.spindle as usize] = Some(message);
            }
            Err(fault) => {
                self.refused += 1;
                self.last_fault = Some(fault);
            }
        }
        result
    }

    /// The last report of a spindle, if it is not too old.
    #[must_use]
    pub fn known(&self, now_ns: u64, spindle: u32) -> Option<SpindleFeedback> {
        let newest = (*self.newest.get(spindle as usize)?)?;
        (now_ns.saturating_sub(newest.time_ns) <= self.timeout_ns).then_some(newest)
    }

    /// Whether a report of this spindle has been accepted, whatever its age.
    #[must_use]
    pub fn has_reported(&self, spindle: u32) -> bool {
        self.newest.get(spindle as usize).is_some_and(Option::is_some)
    }

    fn check(&self, message: &SpindleFeedback, now_ns: u64) -> Result<(), SpindleFault> {
        if !message.is_valid() {
            return Err(SpindleFault::Invalid);
        }
        let spindle = message.spindle;
        let max_rpm = self.max_rpm[spindle as usize].ok_or(SpindleFault::NoSpindle(spindle))?;
        if message.speed_rpm.abs() > MAX_OVERSPEED * max_rpm {
            let speed_rpm = message.speed_rpm;
            return Err(SpindleFault::Overspeed { spindle, speed_rpm });
        }
        if message.time_ns > now_ns.saturating_add(self.timeout_ns) {
            return Err(SpindleFault::Ahead(message.time_ns - now_ns));
        }
        if now_ns.saturating_sub(message.time_ns) > self.timeout_ns {
            return Err(SpindleFault::Past(now_ns - message.time_ns));
        }
        match &self.newest[spindle as usize] {
            Some(before) if before.instance == message.instance => {
                if message.sequence > before.sequence && message.time_ns >= before.time_ns {
                    Ok(())
                } else {
                    Err(SpindleFault::Repeated)
                }
            }
            Some(_) if self.known(now_ns, spindle).is_some() => Err(SpindleFault::Claimed),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn entry() -> SpindleEntry {
        SpindleEntry::new(100 * MS)
            .with_spindle(0, 3000.0)
            .with_spindle(2, 500.0)
    }

    fn message(sequence: u64, time_ns: u64) -> SpindleFeedback {
        SpindleFeedback {
            sequence,
            time_ns,
            instance: 7,
            fraction: 0.25,
            speed_rpm: 1000.0,
            ..SpindleFeedback::default()
        }
    }

    #[test]
    fn wrong_messages_are_refused_and_change_nothing() {
        let now = 1000 * MS;
        let good = message(5, now);
        let wrong = [
            (
                SpindleFeedback {
                    fraction: 1.0,
                    ..good
                },
                SpindleFault::Invalid,
            ),
            (
                SpindleFeedback {
                    fraction: f64::NAN,
                    ..good
                },
                SpindleFault::Invalid,
            ),
            (SpindleFeedback { spindle: 4, ..good }, SpindleFault::Invalid),
            (
                SpindleFeedback {
                    flags: 1 << 9,
                    ..good
                },
                SpindleFault::Invalid,
            ),
            (SpindleFeedback { spindle: 1, ..good }, SpindleFault::NoSpindle(1)),
            (
                SpindleFeedback {
                    speed_rpm: -6001.0,
                    ..good
                },
                SpindleFault::Overspeed {
                    spindle: 0,
                    speed_rpm: -6001.0,
                },
            ),
            (
                SpindleFeedback {
                    time_ns: now + 101 * MS,
                    ..good
                },
                SpindleFault::Ahead(101 * MS),
            ),
            (
                SpindleFeedback {
                    time_ns: now - 101 * MS,
                    ..good
                },
                SpindleFault::Past(101 * MS),
            ),
            (message(4, now), SpindleFault::Repeated),
            (message(5, now - MS), SpindleFault::Repeated),
            (
                SpindleFeedback {
                    instance: 8,
                    ..message(1, now)
                },
                SpindleFault::Claimed,
            ),
        ];
        for (at, (message, fault)) in wrong.into_iter().enumerate() {
            let mut entry = entry();
            entry.take(&self::message(4, now), now).unwrap();
            assert_eq!(entry.take(&message, now), Err(fault), "{at}");
            assert_eq!(entry.known(now, 0), Some(self::message(4, now)), "{at}");
            assert_eq!(entry.refused(), (1, Some(fault)), "{at}");
            entry.take(&good, now).unwrap();
        }
    }

    #[test]
    fn restarted_bridge_is_accepted_after_timeout() {
        let mut entry = entry();
        entry.take(&message(9, 1000 * MS), 1000 * MS).unwrap();
        let next = SpindleFeedback {
            instance: 8,
            ..message(1, 1100 * MS)
        };
        assert_eq!(entry.take(&next, 1100 * MS), Err(SpindleFault::Claimed));
        let later = SpindleFeedback {
            time_ns: 1101 * MS,
            ..next
        };
        entry.take(&later, 1101 * MS).unwrap();
        assert_eq!(entry.known(1101 * MS, 0), Some(later));
        assert_eq!(entry.known(1202 * MS, 0), None);
    }

    #[test]
    fn a_time_that_is_a_little_ahead_counts_as_now() {
        let mut entry = entry();
        entry.take(&message(1, 1050 * MS), 1000 * MS).unwrap();
        assert!(entry.known(1100 * MS, 0).is_some());
        assert!(entry.known(1101 * MS, 0).is_none());
    }
}
