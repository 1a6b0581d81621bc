//! The latch of an encoder's index pulse by the board, on request of the core.
//!
//! The board keeps latching until a pulse has come (Just Once), so the write that arms it must not be
//! repeated once it has arrived: a repetition would latch the pulse after that. Each arming therefore has a
//! number, which the same packet stores in a scratch word of the board.

/// Control bits of an encoder: quadrature, with the long filter.
pub(crate) const QUADRATURE: u32 = 1 << 11;
/// The rising edge of the index input counts; otherwise the falling one.
pub(crate) const INDEX_RISING: u32 = 1 << 3;
/// The count is latched at the pulse; the board clears this bit with Just Once.
const LATCH_ON_INDEX: u32 = 1 << 4;
const JUST_ONCE: u32 = 1 << 6;

/// The command that arms the latch of an encoder, in one packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct IndexCommand {
    /// The encoder.
    pub(crate) unit: usize,
    /// Its control register.
    pub(crate) control: u32,
    /// Number of this arming.
    pub(crate) number: u16,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Phase {
    #[default]
    Off,
    /// The arming is to be written with the next packet.
    Sending,
    /// It was written, and no reading has shown yet whether it arrived.
    Sent,
    /// The board latches the next pulse.
    Armed,
}

/// Result of a reading.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum IndexReading {
    /// Nothing new.
    Nothing,
    /// From now on the board latches the next pulse.
    Armed,
    /// The pulse occurred at this count.
    At(u16),
}

/// The latch of one encoder at a time. A plain value; used by the cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct EncoderIndex {
    phase: Phase,
    unit: usize,
    rising: bool,
    number: u16,
}

impl EncoderIndex {
    /// Latches the next pulse of an encoder; a latch in progress begins again.
    pub(crate) const fn arm(&mut self, unit: usize, rising: bool) {
        (self.phase, self.unit, self.rising) = (Phase::Sending, unit, rising);
        // A board that has just been set up has 0.
        self.number = if self.number == u16::MAX {
            1
        } else {
            self.number + 1
        };
    }

    /// Cancels the latch. A latch that is still armed in the board has no effect.
    pub(crate) const fn disarm(&mut self) {
        self.phase = Phase::Off;
    }

    /// The encoder whose control register readings contain.
    pub(crate) const fn watched(&self) -> Option<usize> {
        match self.phase {
            Phase::Off => None,
            Phase::Sending | Phase::Sent | Phase::Armed => Some(self.unit),
        }
    }

    /// The command for the next packet.
    pub(crate) const fn command(&mut self) -> Option<IndexCommand> {
        if !matches!(self.phase, Phase::Sending) {
            return None;
        }
        self.phase = Phase::Sent;
        let rising = if self.rising { INDEX_RISING } else { 0 };
        Some(IndexCommand {
            unit: self.unit,
            control: QUADRATURE | rising | LATCH_ON_INDEX | JUST_ONCE,
            number: self.number,
        })
    }

    /// Evaluates a reading: the number of the last arming that has arrived, and the control register of the
    /// encoder.
    pub(crate) const fn take(&mut self, number: u16, control: u32) -> IndexReading {
        match self.phase {
            Phase::Off | Phase::Sending => IndexReading::Nothing,
            // The packet with it was lost.
            Phase::Sent | Phase::Armed if number != self.number => {
                self.phase = Phase::Sending;
                IndexReading::Nothing
            }
            Phase::Sent | Phase::Armed if control & LATCH_ON_INDEX == 0 => {
                self.phase = Phase::Off;
                IndexReading::At((control >> 16) as u16)
            }
            Phase::Sent => {
                self.phase = Phase::Armed;
                IndexReading::Armed
            }
            Phase::Armed => IndexReading::Nothing,
        }
    }
}

#[cfg(test)]
mod tests {
    use evolvent_random::Random;

    use super::*;

    /// A board whose packets are lost at random in either direction: the reported pulse is the first one
    /// after the arming arrived, never a later one.
    #[test]
    fn first_pulse_after_arming_is_sent_despite_losses() {
        let mut random = Random::new();
        for _ in 0..2000 {
            let (mut latch, mut control, mut number) = (EncoderIndex::default(), QUADRATURE, 0);
            let (mut expected, mut reported, mut armed) = (None, None, false);
            let mut asked = 0;
            for period in 0..400_u16 {
                // Pulses occur independent of readings.
                let reading = (random.bits() % 10 < 7).then_some((number, control));
                if let Some((number, control)) = reading {
                    match latch.take(number, control) {
                        IndexReading::Armed => armed = true,
                        IndexReading::At(count) => reported = Some(count),
                        IndexReading::Nothing => {}
                    }
                }
                if period == 20 || period == 60 && random.bits().is_multiple_of(2) {
                    latch.arm(3, true);
                    (expected, reported, armed, asked) = (None, None, false, period);
                }
                let command = latch.command();
                if let Some(command) = command.filter(|_| random.bits() % 10 < 7) {
                    assert_eq!(command.unit, 3);
                    (control, number) = (control & 0xFFFF_0000 | command.control, command.number);
                    assert_eq!(expected, None, "armed twice, with a pulse between");
                }
                if random.bits().is_multiple_of(30) && control & LATCH_ON_INDEX != 0 {
                    control = u32::from(period) << 16 | control & 0xFFEF;
                    if number == latch.number {
                        expected = Some(period);
                    }
                }
            }
            assert_eq!(reported, expected, "asked at {asked}, armed {armed}");
        }
    }

    #[test]
    fn numbers_are_never_that_of_a_board_without_one() {
        let mut latch = EncoderIndex {
            number: u16::MAX,
            ..EncoderIndex::default()
        };
        latch.arm(0, false);
        let command = latch.command().expect("a command");
        assert_eq!((command.number, command.control), (1, 0x850));
        assert_eq!(latch.take(0, 0), IndexReading::Nothing, "not arrived");
        assert_eq!(latch.command().map(|command| command.number), Some(1));
        latch.disarm();
        assert_eq!((latch.watched(), latch.command()), (None, None));
    }
}
