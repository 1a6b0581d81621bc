//! A step generator and its motor.

/// Fractional bits of the accumulator: 16 bits of whole steps, 32 below.
const FRACTION: u32 = 32;
/// The accumulator has 48 bits.
const MASK: u64 = (1 << 48) - 1;

/// A step generator of HostMot2.
#[derive(Clone, Debug, Default)]
pub(crate) struct StepGenerator {
    pub(crate) rate: u32,
    /// Largest magnitude of the commanded rate.
    fastest: u32,
    accumulator: u64,
    pub(crate) mode: u32,
    pub(crate) dir_setup: u32,
    pub(crate) dir_hold: u32,
    pub(crate) step_length: u32,
    pub(crate) step_space: u32,
    /// Steps that have left the pins.
    pub(crate) steps_out: i64,
    motor: StepMotor,
}

/// A stepper with step and direction inputs: it follows every pulse, unless the rate changes too fast.
#[derive(Clone, Copy, Debug)]
struct StepMotor {
    /// Steps/s and steps/s2.
    max_rate: f64,
    max_jump: f64,
    rate: f64,
    position: f64,
    stalls: u32,
}

impl Default for StepMotor {
    fn default() -> Self {
        Self {
            max_rate: 1e6,
            max_jump: 1e6,
            rate: 0.0,
            position: 0.0,
            stalls: 0,
        }
    }
}

impl StepGenerator {
    pub(crate) fn set_rate(&mut self, rate: u32) {
        self.rate = rate;
        self.fastest = self.fastest.max((rate as i32).unsigned_abs());
    }

    /// Returns the largest magnitude of the rate since the last call.
    pub(crate) fn take_fastest(&mut self) -> u32 {
        core::mem::take(&mut self.fastest)
    }

    /// The top 32 bits: 16 bits of whole steps, 16 below.
    pub(crate) const fn accumulator(&self) -> u32 {
        (self.accumulator >> 16) as u32
    }

    pub(crate) const fn set_accumulator(&mut self, value: u32) {
        self.accumulator = (value as u64) << 16;
    }

    /// Minimum number of clocks per step, by the configured times.
    fn clocks_per_step(&self) -> u64 {
        u64::from(self.step_length) + u64::from(self.step_space) + 2
    }

    /// Advances by a number of clocks. `reaches_motor`: the pins are outputs of the generator.
    pub(crate) fn advance(&mut self, clocks: u64, clock_hz: f64, reaches_motor: bool) {
        let rate = i128::from(self.rate as i32);
        // The configured times limit the rate of pulses.
        let max_rate = (1_i128 << FRACTION) / i128::from(self.clocks_per_step());
        let rate = rate.clamp(-max_rate, max_rate);
        let before = self.accumulator;
        let moved = rate * i128::from(clocks);
        self.accumulator = (i128::from(before) + moved) as u64 & MASK;
        let whole = |accumulator: u64| (accumulator >> FRACTION) as i64;
        // Number of changes of the whole part, over any number of wraps of the accumulator.
        let steps = ((i128::from(before) + moved) >> FRACTION) as i64 - whole(before);
        if reaches_motor {
            self.steps_out += steps;
            let rate = rate as f64 * clock_hz / f64::from(2.0_f32.powi(FRACTION as i32));
            self.motor.follow(rate, steps, clocks as f64 / clock_hz);
        }
    }

    pub(crate) const fn motor_position(&self) -> f64 {
        self.motor.position
    }

    pub(crate) const fn motor_stalls(&self) -> u32 {
        self.motor.stalls
    }

    /// Sets the limits of the motor: maximum rate, and maximum step change of the rate, steps/s.
    pub(crate) const fn set_motor(&mut self, max_rate: f64, max_jump: f64) {
        self.motor.max_rate = max_rate;
        self.motor.max_jump = max_jump;
    }

    /// Resets to the state after power-up; the motor keeps its position.
    pub(crate) fn reset(&mut self) {
        *self = Self {
            motor: StepMotor {
                rate: 0.0,
                ..self.motor
            },
            steps_out: self.steps_out,
            ..Self::default()
        };
    }
}

impl StepMotor {
    fn follow(&mut self, rate: f64, steps: i64, time_s: f64) {
        if time_s <= 0.0 {
            return;
        }
        if (rate - self.rate).abs() > self.max_jump || rate.abs() > self.max_rate {
            // The motor loses steps, and stops until the rate is low enough to start again.
            self.stalls += 1;
            self.rate = 0.0;
            return;
        }
        self.rate = rate;
        self.position += steps as f64;
    }
}
