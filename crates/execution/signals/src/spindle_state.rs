//! The state of a spindle, as the cycle uses it.

/// Bits below the number of the command.
const BITS: u32 = 5;
/// The highest command number that fits into a double beside the bits.
const MAX_COMMAND: u64 = (1 << (f64::MANTISSA_DIGITS - BITS)) - 1;

/// The state of a spindle with respect to its last command.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SpindleState {
    /// The number of its last command, assigned by the thread of the program. Numbers increase.
    pub command: u64,
    /// It executes that command and has reached its speed.
    pub at_speed: bool,
    /// It executes that command and is stopped at its angle.
    pub oriented: bool,
    /// Its drive is in fault.
    pub fault: bool,
    /// It is commanded to turn, and its rotation is not reported.
    pub silent: bool,
    /// Its angle is counted from the index pulse.
    pub indexed: bool,
}

impl SpindleState {
    /// Follows its command at once: a spindle with the virtual clock.
    pub const OBEDIENT: Self = Self {
        command: MAX_COMMAND,
        at_speed: true,
        oriented: true,
        fault: false,
        silent: false,
        indexed: true,
    };

    /// The state as one number, exactly: for a trace.
    #[must_use]
    pub fn to_number(self) -> f64 {
        let bits = [
            self.at_speed,
            self.oriented,
            self.fault,
            self.silent,
            self.indexed,
        ];
        let low = bits
            .iter()
            .rev()
            .fold(0, |number, bit| number << 1 | u64::from(*bit));
        (self.command.min(MAX_COMMAND) << BITS | low) as f64
    }

    /// The state with this number; `None` if there is none.
    #[must_use]
    pub fn from_number(number: f64) -> Option<Self> {
        let whole = number as u64;
        if whole as f64 != number || whole >> BITS > MAX_COMMAND {
            return None;
        }
        let bit = |at: u32| whole >> at & 1 == 1;
        Some(Self {
            command: whole >> BITS,
            at_speed: bit(0),
            oriented: bit(1),
            fault: bit(2),
            silent: bit(3),
            indexed: bit(4),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_state_comes_back_from_its_number() {
        for command in [0, 1, 77, u64::from(u32::MAX), MAX_COMMAND] {
            for bits in 0..32_u64 {
                let number = (command << BITS | bits) as f64;
                let state = SpindleState::from_number(number).unwrap();
                assert_eq!((state.command, state.to_number()), (command, number));
            }
        }
        assert_eq!(
            SpindleState::from_number(SpindleState::OBEDIENT.to_number()),
            Some(SpindleState::OBEDIENT)
        );
        for number in [-1.0, 0.5, f64::NAN, f64::INFINITY, 1e300] {
            assert_eq!(SpindleState::from_number(number), None, "{number}");
        }
    }
}
