//! Whether the drive of a spindle may have torque.

/// Whether the drive of a spindle is to be enabled. Only a command enables it. It then keeps its torque until
/// the spindle is at standstill, because it brakes only while it is enabled. A spindle without torque stays
/// without torque while it turns by hand, coasts, or shows encoder noise.
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
    /// Runs one period. `is_commanded`: the core commands a speed or an angle. `stands`: the spindle is at
    /// rest. `has_torque`: the drive has torque; true if unknown. Returns whether the drive is to be enabled.
    pub const fn step(&mut self, is_commanded: bool, stands: bool, has_torque: bool) -> bool {
        self.is_on = is_commanded || self.is_on && !stands && has_torque;
        self.is_on
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn torque_lost_while_braking_does_not_return() {
        let mut power = SpindlePower::default();
        assert!(power.step(true, true, false), "on the way to operation");
        assert!(power.step(true, false, true));
        assert!(power.step(false, false, true));
        // Safe torque off during rotation; then its chain closes again.
        assert!(!power.step(false, false, false));
        assert!(!power.step(false, false, true));
        assert!(power.step(true, false, false), "a command");
    }
}
