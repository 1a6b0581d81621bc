//! Waiting for an input (M66).

use evolvent_machine::SignalKind;

use crate::image::InputImage;

/// The condition of a wait.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WaitMode {
    /// None: returns the present value (L0).
    Immediate,
    /// From off to on (L1).
    Rise,
    /// From on to off (L2).
    Fall,
    /// On (L3).
    High,
    /// Off (L4).
    Low,
}

impl WaitMode {
    /// The mode of an L word.
    #[must_use]
    pub const fn from_number(number: u32) -> Option<Self> {
        Some(match number {
            0 => Self::Immediate,
            1 => Self::Rise,
            2 => Self::Fall,
            3 => Self::High,
            4 => Self::Low,
            _ => return None,
        })
    }
}

/// The object of a wait.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Awaited {
    /// An input (M66). An analog one supports only [`WaitMode::Immediate`].
    Input {
        /// Digital or analog.
        kind: SignalKind,
        /// Which input.
        number: u32,
        /// The condition.
        mode: WaitMode,
    },
    /// A spindle that has reached its speed.
    AtSpeed {
        /// The number of the spindle.
        spindle: u32,
        /// The command that it has to execute, or a later one.
        command: u64,
    },
    /// A spindle that is stopped at its angle (M19).
    Oriented {
        /// The number of the spindle.
        spindle: u32,
        /// The command that it has to execute, or a later one.
        command: u64,
    },
}

/// A wait for an input or a spindle, at rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InputWait {
    /// The action at which the machine stops for it.
    pub action: u32,
    /// The object of the wait.
    pub awaited: Awaited,
    /// Number of setpoints after which the wait is given up.
    pub timeout_cycles: u64,
}

/// The result of a wait.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WaitResult {
    /// The wait's action.
    pub action: u32,
    /// The value of the input, 1 for a spindle that meets its condition; `None` after the timeout, or if the
    /// value is unknown.
    pub value: Option<f64>,
}

/// A wait in force.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ActiveWait {
    pub(crate) wait: InputWait,
    /// Setpoints until the one at which the axes are at rest is due.
    lead: u32,
    waited: u64,
    /// The previous state, if known.
    before: Option<bool>,
    /// The edge has occurred.
    edge: bool,
}

impl ActiveWait {
    pub(crate) fn new(wait: InputWait, lead: u32) -> Self {
        Self {
            wait,
            lead,
            waited: 0,
            before: None,
            edge: false,
        }
    }

    /// Processes one sample of the inputs: an edge between two setpoints counts as well.
    pub(crate) fn observe(&mut self, inputs: &InputImage) {
        let Awaited::Input { kind, number, mode } = self.wait.awaited else {
            return;
        };
        let now = inputs.value(kind, number).map(|value| value != 0.0);
        if self.lead == 0 {
            self.edge |= match (mode, self.before, now) {
                (WaitMode::Rise, Some(before), Some(now)) => !before && now,
                (WaitMode::Fall, Some(before), Some(now)) => before && !now,
                _ => false,
            };
        }
        self.before = now;
    }

    /// Called after the samples of one setpoint. Returns the result of the wait once it is over.
    pub(crate) fn step(&mut self, inputs: &InputImage) -> Option<WaitResult> {
        if self.lead > 0 {
            self.lead -= 1;
            return None;
        }
        let result = |value| WaitResult {
            action: self.wait.action,
            value,
        };
        let done = match self.wait.awaited {
            Awaited::Input { kind, number, mode } => {
                let value = inputs.value(kind, number);
                match mode {
                    WaitMode::Immediate => return Some(result(value)),
                    // The awaited value, even if the input has changed back since.
                    WaitMode::Rise => self.edge.then_some(1.0),
                    WaitMode::Fall => self.edge.then_some(0.0),
                    WaitMode::High => value.filter(|value| *value != 0.0).map(|_| 1.0),
                    WaitMode::Low => value.filter(|value| *value == 0.0),
                }
            }
            Awaited::AtSpeed { spindle, command } => inputs
                .spindle(spindle)
                .filter(|state| state.command >= command && state.at_speed)
                .map(|_| 1.0),
            Awaited::Oriented { spindle, command } => inputs
                .spindle(spindle)
                .filter(|state| state.command >= command && state.oriented)
                .map(|_| 1.0),
        };
        if done.is_some() {
            return Some(result(done));
        }
        self.waited += 1;
        (self.waited >= self.wait.timeout_cycles).then(|| result(None))
    }
}
