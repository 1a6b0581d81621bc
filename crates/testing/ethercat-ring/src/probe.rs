//! Touch probes 1 and 2 (objects 60B8h to 60BDh), each at the probe input or at the encoder's zero impulse.

/// Sources of the touch probe functions. Positions are turns of the motor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ProbeSources {
    /// The probe input is on from this position upwards.
    pub(crate) input_turns: f64,
    /// Position of the zero impulse in each turn; `None` if the encoder has none.
    pub(crate) impulse_turns: Option<f64>,
    /// Width of the impulse: one increment.
    pub(crate) impulse_width_turns: f64,
}

/// An edge of a source: whether it rises, and its position.
type Edge = (bool, f64);

/// The function (60B8h), its status (60B9h) and the latched positions (60BAh to 60BDh), in turns.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Probe {
    function: u16,
    pub(crate) status: u16,
    /// Latched at the rising and the falling edge of touch probe 1, then of touch probe 2.
    pub(crate) caught: [Option<f64>; 4],
    last_turns: f64,
}

impl Probe {
    pub(crate) fn at(turns: f64) -> Self {
        Self {
            last_turns: turns,
            ..Self::default()
        }
    }

    /// Sets the function; a rising bit 0 (8) arms touch probe 1 (2) again.
    pub(crate) fn set_function(&mut self, function: u16) {
        for shift in [0, 8] {
            let (old, new) = (self.function >> shift, function >> shift);
            let mut status = self.status >> shift & 0xFF;
            if new & 1 == 0 {
                status = 0;
            } else if old & 1 == 0 {
                status = 1;
            }
            // A disabled edge is cleared, so that it can be latched again.
            if new >> 4 & 1 == 0 {
                status &= !0b10;
            }
            if new >> 5 & 1 == 0 {
                status &= !0b100;
            }
            self.status = self.status & !(0xFF << shift) | status << shift;
        }
        self.function = function;
    }

    /// Processes one step of the motor. The position of an edge within the step is exact.
    pub(crate) fn step(&mut self, turns: f64, sources: &ProbeSources) {
        let last = core::mem::replace(&mut self.last_turns, turns);
        let input = (last >= sources.input_turns) != (turns >= sources.input_turns);
        let input = input.then_some((turns >= sources.input_turns, sources.input_turns));
        let impulse = impulse_edges(last, turns, sources);
        for (number, shift) in [(0, 0), (1, 8)] {
            // Bits 2 and 3 select the source; source 10b (60D0h) is not simulated.
            match self.function >> shift & 0b1101 {
                0b0001 => self.catch(number, input),
                0b0101 => impulse.iter().for_each(|edge| self.catch(number, *edge)),
                _ => {}
            }
        }
    }

    fn catch(&mut self, number: usize, edge: Option<Edge>) {
        let Some((rises, at)) = edge else { return };
        let shift = 8 * number;
        let (function, side) = (self.function >> shift, usize::from(!rises));
        let stored = 0b10 << side << shift;
        let continuous = function >> 1 & 1 == 1;
        if function >> (4 + side) & 1 == 0 || self.status & stored != 0 && !continuous {
            return;
        }
        self.status |= stored;
        self.caught[2 * number + side] = Some(at);
    }
}

/// The edges of the zero impulse that a step passes: those of the first impulse only.
fn impulse_edges(last: f64, turns: f64, sources: &ProbeSources) -> [Option<Edge>; 2] {
    let Some(phase) = sources.impulse_turns.filter(|_| turns != last) else {
        return [None; 2];
    };
    let width = sources.impulse_width_turns;
    // The lower and upper side of the impulse; the direction decides which is entered and which is left.
    let (lower, upper) = (phase, phase + width);
    let (enter, leave) = if turns > last {
        (lower, upper)
    } else {
        (upper, lower)
    };
    let passed = |side: f64| {
        let (from, to) = ((last - side).floor(), (turns - side).floor());
        let edge = if turns > last { from + 1.0 } else { from } + side;
        (from != to).then_some(edge)
    };
    [
        passed(enter).map(|at| (true, at)),
        passed(leave).map(|at| (false, at)),
    ]
}
