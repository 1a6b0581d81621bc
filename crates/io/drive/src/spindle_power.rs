//! Whether the drive of a spindle may have torque.

/// Whether the drive of a spindle is to be enabled. Only a command enables it. It then keeps its torque until
/// the spindle stands, because it brakes while it is enabled; a spindle without torque stays without, however
/// it turns: by a hand, coasting, or by the noise of its encoder.
///
/// ```
/// use evolvent_drive::SpindlePower;
///
/// let mut power = SpindlePower::default();
/// assert!(!power.step(false, false, false), "turned by hand");
/// assert!(power.step(true, false, true), "M3");
/// assert!(power.step(false, false, true), "M5: it brakes");
/// assert!(!power.step(false, true, true), "it stands");
/// assert!(!power.step(false, false, false), "turned by hand again");
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SpindlePower {
    is_on: bool,
}

impl SpindlePower {
    /// One period. `is_commanded`: the core has it turn, or hold an angle; `stands`: it is at rest;
    /// `has_torque`: the drive has torque, where that is known, otherwise true. Returns whether the drive is
    /// to be enabled.
    pub const fn step(&mut self, is_commanded: bool, stands: bool, has_torque: bool) -> bool {
        self.is_on = is_commanded || self.is_on && !stands && has_torque;
        self.is_on
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn torque_that_was_lost_while_braking_does_not_come_back() {
        let mut power = SpindlePower::default();
        assert!(power.step(true, true, false), "on the way to operation");
        assert!(power.step(true, false, true));
        assert!(power.step(false, false, true));
        // Safe torque off while it turns, then its chain closes.
        assert!(!power.step(false, false, false));
        assert!(!power.step(false, false, true));
        assert!(power.step(true, false, false), "a command");
    }
}
