//! Outputs as a bridge has to set them: each message when it is due, safe values if the core is silent.

use evolvent_wire::MachineOutputs;

/// Maximum number of messages that are not due yet. Beyond it the last is replaced: every message is
/// complete.
const AHEAD: usize = 64;
/// After this time without a message the core has ended, ns.
const SILENCE_NS: u64 = 200_000_000;
/// A message that is due later than this does not use the clock of this computer, ns.
const LONGEST_LEAD_NS: u64 = 10_000_000_000;

/// Why a message of outputs was not used. The outputs keep their values.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum OutputFault {
    /// A value is not a number.
    #[error("an analog value, or the speed or angle of a spindle, is not a number")]
    NotFinite,
    /// Its due time is implausibly late.
    #[error("it is due {0} ns from now")]
    Ahead(u64),
}

/// Carries out messages of outputs. Neither allocates nor waits.
///
/// ```
/// use evolvent_drive::OutputFollower;
/// use evolvent_wire::MachineOutputs;
///
/// let mut outputs = OutputFollower::default();
/// // Digital output 0 is to be off from 5 ms on; it is safe when it is on.
/// let message = MachineOutputs {
///     sequence: 1,
///     due_time_ns: 5_000_000,
///     digital_mask: 1,
///     safe_digital: 1,
///     ..MachineOutputs::default()
/// };
/// outputs.offer(1_000_000, &message)?;
/// assert_eq!(outputs.step(4_999_999).digital, 1, "not due");
/// assert_eq!(outputs.step(5_000_000).digital, 0);
/// assert_eq!(outputs.step(201_000_001).digital, 1, "the core is silent");
/// # Ok::<(), evolvent_drive::OutputFault>(())
/// ```
#[derive(Clone, Debug)]
pub struct OutputFollower {
    /// In the order of arrival; the first `count` are valid.
    ahead: [MachineOutputs; AHEAD],
    count: usize,
    /// Outputs in force; `None` before the first.
    now: Option<MachineOutputs>,
    heard_ns: u64,
    /// Number of the newest message.
    newest: u64,
}

impl Default for OutputFollower {
    fn default() -> Self {
        Self {
            ahead: [MachineOutputs::default(); AHEAD],
            count: 0,
            now: None,
            heard_ns: 0,
            newest: 0,
        }
    }
}

impl OutputFollower {
    /// Accepts a message. Before the first one of a core is due, its safe values are in force.
    ///
    /// # Errors
    /// It is damaged and was not used.
    pub fn offer(&mut self, now_ns: u64, message: &MachineOutputs) -> Result<(), OutputFault> {
        let mut numbers = (message.analog.iter())
            .chain(&message.safe_analog)
            .chain(&message.spindle_rpm)
            .chain(&message.spindle_angle);
        if numbers.any(|number| !number.is_finite()) {
            return Err(OutputFault::NotFinite);
        }
        let lead_ns = message.due_time_ns.saturating_sub(now_ns);
        if lead_ns > LONGEST_LEAD_NS {
            return Err(OutputFault::Ahead(lead_ns));
        }
        self.heard_ns = now_ns;
        if message.sequence <= self.newest {
            // Another core: the pending messages of the previous one are void.
            self.count = 0;
            self.now = None;
        }
        self.newest = message.sequence;
        if self.now.is_none() {
            self.now = Some(safe(message));
        }
        if self.count == AHEAD {
            self.count -= 1;
        }
        self.ahead[self.count] = *message;
        self.count += 1;
        Ok(())
    }

    /// The present outputs: those of the newest message that is due, or safe ones. `sequence` is that of the
    /// message; 0 while they are safe because none is due yet or the core is silent.
    pub fn step(&mut self, now_ns: u64) -> MachineOutputs {
        let due = self.ahead[..self.count]
            .iter()
            .take_while(|message| message.due_time_ns <= now_ns)
            .count();
        if due > 0 {
            self.now = Some(self.ahead[due - 1]);
            self.ahead.copy_within(due..self.count, 0);
            self.count -= due;
        }
        if now_ns.saturating_sub(self.heard_ns) > SILENCE_NS
            && let Some(now) = &mut self.now
        {
            *now = safe(now);
            self.count = 0;
        }
        self.now.unwrap_or_default()
    }
}

/// The safe outputs of a message: spindles stopped, coolant off. They have no sequence number, so that a
/// report (a stopped spindle) does not count as a reply to a message.
fn safe(message: &MachineOutputs) -> MachineOutputs {
    MachineOutputs {
        sequence: 0,
        digital: message.safe_digital,
        analog: message.safe_analog,
        spindle_direction: Default::default(),
        spindle_rpm: Default::default(),
        coolant: 0,
        ..*message
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn message(sequence: u64, due_ms: u64, digital: u64) -> MachineOutputs {
        MachineOutputs {
            sequence,
            due_time_ns: due_ms * MS,
            digital_mask: 0b11,
            digital,
            safe_digital: 0b10,
            ..MachineOutputs::default()
        }
    }

    #[test]
    fn messages_count_when_they_are_due_and_in_order() {
        let mut outputs = OutputFollower::default();
        assert_eq!(outputs.step(0), MachineOutputs::default());
        for (sequence, due, digital) in [(1, 10, 0b01), (2, 20, 0b11), (3, 20, 0b00), (4, 30, 0b01)] {
            outputs.offer(MS, &message(sequence, due, digital)).unwrap();
        }
        let at = |outputs: &mut OutputFollower, ms: u64| {
            let now = outputs.step(ms * MS);
            (now.sequence, now.digital)
        };
        assert_eq!(at(&mut outputs, 9), (0, 0b10), "safe until the first is due");
        assert_eq!(at(&mut outputs, 10), (1, 0b01));
        assert_eq!(at(&mut outputs, 25), (3, 0b00));
        assert_eq!(at(&mut outputs, 31), (4, 0b01));
        // Silence: safe values, despite pending messages.
        outputs.offer(100 * MS, &message(5, 250, 0b01)).unwrap();
        assert_eq!(at(&mut outputs, 300), (5, 0b01));
        assert_eq!(at(&mut outputs, 301), (0, 0b10));
        // A core that restarts counts from 1.
        outputs.offer(400 * MS, &message(6, 900, 0b01)).unwrap();
        outputs.offer(410 * MS, &message(1, 420, 0b00)).unwrap();
        assert_eq!(at(&mut outputs, 419), (0, 0b10));
        assert_eq!(at(&mut outputs, 420), (1, 0b00));
        outputs.offer(610 * MS, &message(2, 610, 0b00)).unwrap();
        assert_eq!(at(&mut outputs, 800), (2, 0b00), "the other core's never comes");
    }

    #[test]
    fn damaged_outputs_are_ignored_and_flood_keeps_last() {
        let mut outputs = OutputFollower::default();
        outputs.offer(0, &message(1, 0, 0b01)).unwrap();
        let mut bad = message(2, 1, 0b11);
        bad.analog[7] = f64::NAN;
        assert_eq!(outputs.offer(MS, &bad), Err(OutputFault::NotFinite));
        let far = message(2, 20_000, 0b11);
        assert!(matches!(outputs.offer(MS, &far), Err(OutputFault::Ahead(_))));
        assert_eq!(outputs.step(MS).digital, 0b01);
        for sequence in 2..500 {
            outputs
                .offer(2 * MS, &message(sequence, 3, sequence & 0b11))
                .unwrap();
        }
        assert_eq!(outputs.step(3 * MS).sequence, 499);
    }
}
