//! Homing by the drive itself (mode of operation 6).

/// Inputs of homing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Sight {
    pub(crate) negative_limit: bool,
    pub(crate) positive_limit: bool,
    /// Motor turns relative to an index pulse, which occurs at whole turns.
    pub(crate) turns: f64,
    /// The encoder has index pulses.
    pub(crate) has_index: bool,
}

/// Progress, as shown in bits 10, 12 and 13 of the status word.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum HomingState {
    #[default]
    Idle,
    /// Towards the limit switch.
    Searching,
    /// Away from the switch, until it opens.
    Leaving,
    /// Further, until the index pulse.
    AwaitingIndex,
    Attained,
    Failed,
}

/// Methods of object 6098h: 1 and 2 limit switch and index, 17 and 18 limit switch, 33 and 34 index, 35 and
/// 37 here.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Homing {
    pub(crate) state: HomingState,
    method: i8,
    last_turns: f64,
}

impl Homing {
    pub(crate) const fn start(&mut self, method: i8, turns: f64) {
        self.method = method;
        self.last_turns = turns;
        self.state = match method {
            1 | 2 | 17 | 18 => HomingState::Searching,
            33 | 34 => HomingState::AwaitingIndex,
            35 | 37 => HomingState::Attained,
            _ => HomingState::Failed,
        };
    }

    pub(crate) const fn stop(&mut self) {
        self.state = HomingState::Idle;
    }

    /// Direction of the search.
    const fn sign(self) -> f64 {
        if matches!(self.method, 2 | 18 | 34) {
            1.0
        } else {
            -1.0
        }
    }

    /// Runs one step. Returns the speed, with the magnitude of `fast` or `slow`, and the home position once
    /// it is found.
    pub(crate) fn step(&mut self, sight: Sight, fast: f64, slow: f64) -> (f64, Option<f64>) {
        let negative = self.sign() < 0.0;
        let pressed = if negative {
            sight.negative_limit
        } else {
            sight.positive_limit
        };
        let last = core::mem::replace(&mut self.last_turns, sight.turns);
        match self.state {
            HomingState::Searching if pressed => {
                self.state = HomingState::Leaving;
                (0.0, None)
            }
            HomingState::Searching => (self.sign() * fast, None),
            HomingState::Leaving if pressed => (-self.sign() * slow, None),
            HomingState::Leaving if matches!(self.method, 1 | 2) => {
                self.state = HomingState::AwaitingIndex;
                (-self.sign() * slow, None)
            }
            HomingState::Leaving => {
                self.state = HomingState::Attained;
                (0.0, Some(sight.turns))
            }
            HomingState::AwaitingIndex => {
                let speed = if matches!(self.method, 1 | 2) {
                    -self.sign()
                } else {
                    self.sign()
                } * slow;
                let index = if speed > 0.0 {
                    sight.turns.floor()
                } else {
                    sight.turns.ceil()
                };
                let passes = (last - index) * (sight.turns - index) <= 0.0 && last != sight.turns;
                if passes && sight.has_index {
                    self.state = HomingState::Attained;
                    return (0.0, Some(index));
                }
                (speed, None)
            }
            HomingState::Idle | HomingState::Attained | HomingState::Failed => (0.0, None),
        }
    }
}
