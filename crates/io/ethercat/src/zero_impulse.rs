//! The latch of the encoder's zero impulse by a touch probe of the drive, on request of the core.

/// A touch probe function of the drive (CiA 402): its bits in 60B8h and 60B9h, and the object with its
/// position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProbeNumber {
    /// Bits 0 to 7; 60BAh.
    One,
    /// Bits 8 to 15; 60BCh.
    Two,
}

impl ProbeNumber {
    const fn shift(self) -> u32 {
        match self {
            Self::One => 0,
            Self::Two => 8,
        }
    }
}

/// Bits of 60B8h: enabled, first event only, source 01b (zero impulse), rising edge.
const ARM: u16 = 1 | 1 << 2 | 1 << 4;
/// Periods for which the function is off before it is commanded again: a drive may take several to detect
/// either change.
const OFF_PERIODS: u8 = 4;
/// Bits of 60B9h.
const ENABLED: u16 = 1;
const STORED: u16 = 1 << 1;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Phase {
    /// Nothing is to be latched.
    #[default]
    Off,
    /// An earlier latch must be switched off first: the drive keeps it until then.
    Clearing,
    /// The function is commanded; the drive has not reported yet that it is enabled.
    Arming,
    /// The drive latches the next impulse.
    Armed,
}

/// Result of one period.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Latched {
    /// Nothing new.
    Nothing,
    /// From now on the drive latches the next impulse.
    Armed,
    /// The impulse occurred at this position, in increments of the drive.
    At(i32),
}

/// The latch of one drive. A plain value; used by the cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct ZeroImpulse {
    phase: Phase,
    /// Periods since the function was commanded, at most [`OFF_PERIODS`].
    off_for: u8,
}

impl ZeroImpulse {
    pub(crate) const fn new() -> Self {
        Self {
            phase: Phase::Off,
            off_for: 0,
        }
    }

    /// Latches the next impulse; a latch in progress begins again.
    pub(crate) const fn arm(&mut self) {
        self.phase = Phase::Clearing;
    }

    /// Cancels the latch.
    pub(crate) const fn disarm(&mut self) {
        self.phase = Phase::Off;
    }

    /// One period: status (60B9h) and position of the touch probe.
    pub(crate) const fn step(&mut self, probe: ProbeNumber, status: u16, position: i32) -> Latched {
        let status = status >> probe.shift();
        let (enabled, stored) = (status & ENABLED != 0, status & STORED != 0);
        self.off_for = match self.phase {
            Phase::Arming | Phase::Armed => 0,
            Phase::Off | Phase::Clearing if self.off_for < OFF_PERIODS => self.off_for + 1,
            Phase::Off | Phase::Clearing => OFF_PERIODS,
        };
        match self.phase {
            Phase::Clearing if !enabled && !stored && self.off_for == OFF_PERIODS => {
                self.phase = Phase::Arming;
            }
            Phase::Arming | Phase::Armed if stored => {
                self.phase = Phase::Off;
                return Latched::At(position);
            }
            Phase::Arming if enabled => {
                self.phase = Phase::Armed;
                return Latched::Armed;
            }
            _ => {}
        }
        Latched::Nothing
    }

    /// Its bits of 60B8h.
    pub(crate) const fn function(&self, probe: ProbeNumber) -> u16 {
        match self.phase {
            Phase::Off | Phase::Clearing => 0,
            Phase::Arming | Phase::Armed => ARM << probe.shift(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A drive according to CiA 402 that takes some periods for each change: latched data persist until the
    /// function is off.
    struct Drive {
        probe: ProbeNumber,
        functions: [u16; 3],
        enabled: bool,
        stored: Option<i32>,
    }

    impl Drive {
        fn new(probe: ProbeNumber) -> Self {
            Self {
                probe,
                functions: [0; 3],
                // State left by an earlier session.
                enabled: true,
                stored: Some(-9),
            }
        }

        fn period(&mut self, function: u16, impulse: Option<i32>) -> u16 {
            self.functions.rotate_right(1);
            self.functions[0] = function;
            let mine = self.functions[2] >> self.probe.shift() & 0xFF;
            if mine & 1 == 0 {
                (self.enabled, self.stored) = (false, None);
            } else {
                assert_eq!(mine, 0b1_0101);
                self.enabled = true;
                self.stored = self.stored.or(impulse);
            }
            let status = u16::from(self.enabled) | u16::from(self.stored.is_some()) << 1;
            status << self.probe.shift()
        }
    }

    #[test]
    fn first_impulse_after_arming_counts_despite_old_one() {
        for probe in [ProbeNumber::One, ProbeNumber::Two] {
            let (mut drive, mut latch) = (Drive::new(probe), ZeroImpulse::default());
            let (mut armed, mut seen) = (Vec::new(), Vec::new());
            for period in 0..200 {
                if [20, 100, 102, 130].contains(&period) {
                    latch.arm();
                }
                // One occurs while the earlier latch is still on in the drive, but off for the bridge.
                let impulse = (period % 25 == 0 || period == 104).then_some(1000 + period);
                let status = drive.period(latch.function(probe), impulse);
                match latch.step(probe, status, drive.stored.unwrap_or(0)) {
                    Latched::Armed => armed.push(period),
                    Latched::At(position) => seen.push(position),
                    Latched::Nothing => {}
                }
            }
            assert_eq!(seen, [1025, 1125, 1150], "{armed:?}");
            assert_eq!(armed.len(), 3, "{armed:?}");
        }
    }

    #[test]
    fn what_is_disarmed_latches_nothing() {
        let mut latch = ZeroImpulse::default();
        latch.arm();
        for _ in 0..OFF_PERIODS {
            assert_eq!(latch.step(ProbeNumber::One, 0, 0), Latched::Nothing);
        }
        assert_eq!(latch.step(ProbeNumber::One, ENABLED, 0), Latched::Armed);
        latch.disarm();
        assert_eq!(latch.function(ProbeNumber::One), 0);
        assert_eq!(
            latch.step(ProbeNumber::One, ENABLED | STORED, 5),
            Latched::Nothing
        );
    }

    /// A request right after another: the drive must detect that the function was off, although its status is
    /// clear all the time.
    #[test]
    fn latch_is_off_for_some_periods_before_rearming() {
        let mut latch = ZeroImpulse::default();
        let (mut off, mut shortest) = (u8::MAX, u8::MAX);
        for period in 0..60 {
            if period % 7 == 0 {
                latch.arm();
            }
            let _nothing = latch.step(ProbeNumber::Two, 0, 0);
            if latch.function(ProbeNumber::Two) == 0 {
                off = off.saturating_add(1);
            } else if off > 0 {
                (shortest, off) = (shortest.min(off), 0);
            }
        }
        assert!((3..7).contains(&shortest), "{shortest}");
    }
}
