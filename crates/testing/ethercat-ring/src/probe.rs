//! Touch probe 1 (objects 60B8h to 60BBh).

/// The function (60B8h), its status (60B9h) and the positions that were caught (60BAh, 60BBh), in turns.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Probe {
    function: u16,
    pub(crate) status: u16,
    pub(crate) rising: Option<f64>,
    pub(crate) falling: Option<f64>,
    last_turns: f64,
}

impl Probe {
    pub(crate) fn at(turns: f64) -> Self {
        Self {
            last_turns: turns,
            ..Self::default()
        }
    }

    /// Takes over the function; a rising bit 0 arms anew.
    pub(crate) const fn set_function(&mut self, function: u16) {
        if function & 1 == 0 {
            self.status = 0;
        } else if self.function & 1 == 0 {
            self.status = 1;
        }
        // An edge that is not looked for any more is forgotten, so that it can be looked for again.
        if function >> 4 & 1 == 0 {
            self.status &= !0b10;
        }
        if function >> 5 & 1 == 0 {
            self.status &= !0b100;
        }
        self.function = function;
    }

    /// One step of the motor; the input is on beyond `at`. Where within the step it changes is known exactly.
    pub(crate) fn step(&mut self, turns: f64, at: f64) {
        let (was, is) = (self.last_turns >= at, turns >= at);
        self.last_turns = turns;
        // Bit 2 takes the index pulse instead of the input, which is not simulated.
        if was == is || self.function & 0b101 != 1 {
            return;
        }
        let (enabled, stored) = if is {
            (self.function >> 4 & 1, 0b10)
        } else {
            (self.function >> 5 & 1, 0b100)
        };
        let continuous = self.function >> 1 & 1 == 1;
        if enabled == 0 || self.status & stored != 0 && !continuous {
            return;
        }
        self.status |= stored;
        if is {
            self.rising = Some(at);
        } else {
            self.falling = Some(at);
        }
    }
}
