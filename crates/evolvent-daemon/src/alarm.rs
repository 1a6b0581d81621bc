//! Why a run ended early, by number.

/// The stable number of what ended a run before its program did: in the bus's status and in the trace's events.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Alarm {
    /// The program cannot be read, or has an error in it; it was run up to there.
    Program = 100,
    /// The guard refused a setpoint that would have broken a limit.
    Guard = 200,
    /// The planner ended without completing its plan.
    Planner = 201,
    /// Too many setpoints in a row left after they were due.
    Lateness = 300,
}

impl Alarm {
    /// The number on the bus and in the trace.
    #[must_use]
    pub const fn number(self) -> u32 {
        self as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_those_that_clients_rely_on() {
        let numbers = [Alarm::Program, Alarm::Guard, Alarm::Planner, Alarm::Lateness].map(Alarm::number);
        assert_eq!(numbers, [100, 200, 201, 300]);
    }
}
