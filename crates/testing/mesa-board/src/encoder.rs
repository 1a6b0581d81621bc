//! A quadrature counter, the servo drive at a PWM output, and the axis that both belong to.

/// Bits of the control register that can be written.
const CONTROL: u32 = 0x7FF8;
const CLEAR_ON_INDEX: u32 = 1 << 5;
const LATCH_ON_INDEX: u32 = 1 << 4;
const JUST_ONCE: u32 = 1 << 6;

/// A counter with timestamp, and the shaft that it counts.
#[derive(Clone, Debug)]
pub(crate) struct Encoder {
    /// Counts of the shaft since the beginning.
    shaft: f64,
    /// Shaft at which the counter reads zero.
    zero: i64,
    latched: u16,
    control: u32,
    timestamp: u16,
    last: i64,
    /// Counts a turn: the index is at every multiple.
    counts_per_turn: i64,
    /// Counts/s at full PWM.
    full_speed: f64,
    speed: f64,
    /// Something holds the shaft.
    is_held: bool,
}

impl Default for Encoder {
    fn default() -> Self {
        Self {
            shaft: 0.0,
            zero: 0,
            latched: 0,
            control: 0,
            timestamp: 0,
            last: 0,
            counts_per_turn: 4000,
            full_speed: 200_000.0,
            speed: 0.0,
            is_held: false,
        }
    }
}

/// Time constant of the drive's velocity loop, s.
const LAG_S: f64 = 0.002;
/// Longest step of the drive's simulation, s.
const STEP_S: f64 = 0.000_2;

impl Encoder {
    pub(crate) fn count(&self) -> u32 {
        let count = (self.shaft.floor() as i64 - self.zero) as u16;
        u32::from(self.timestamp) << 16 | u32::from(count)
    }

    pub(crate) fn control(&self) -> u32 {
        let index = self.shaft.floor() as i64;
        let at_index = index.rem_euclid(self.counts_per_turn) == 0;
        u32::from(self.latched) << 16 | self.control | u32::from(at_index) << 2
    }

    pub(crate) const fn set_control(&mut self, value: u32) {
        self.control = value & CONTROL;
    }

    pub(crate) fn clear(&mut self) {
        self.zero = self.shaft.floor() as i64;
    }

    pub(crate) const fn shaft(&self) -> f64 {
        self.shaft
    }

    pub(crate) const fn set_shaft(&mut self, shaft: f64) {
        self.shaft = shaft;
        self.zero = shaft as i64;
        self.last = shaft as i64;
    }

    /// A hand turns the shaft, and the counter counts it.
    pub(crate) const fn turn(&mut self, counts: f64) {
        self.shaft += counts;
    }

    /// Something holds the shaft, whatever its drive does.
    pub(crate) const fn hold(&mut self, is_held: bool) {
        self.is_held = is_held;
    }

    /// Counts a turn, and counts/s at full duty.
    pub(crate) const fn set_drive(&mut self, counts_per_turn: i64, full_speed: f64) {
        self.counts_per_turn = counts_per_turn;
        self.full_speed = full_speed;
    }

    /// As after power-up; the shaft stays where it is.
    pub(crate) fn reset(&mut self) {
        (self.control, self.latched) = (0, 0);
        self.clear();
    }

    /// Goes on in time. `duty`: -1 to 1, what the drive at this axis is asked for.
    pub(crate) fn advance(&mut self, time_s: f64, duty: f64, timestamp: u16) {
        let mut rest = time_s;
        while rest > 0.0 {
            let step = rest.min(STEP_S);
            rest -= step;
            let wanted = duty * self.full_speed;
            self.speed += (wanted - self.speed) * (1.0 - (-step / LAG_S).exp());
            if self.is_held || wanted == 0.0 && self.speed.abs() < 1.0 {
                self.speed = 0.0;
            }
            self.shaft += self.speed * step;
            self.pass();
        }
        if self.last != self.shaft.floor() as i64 {
            self.last = self.shaft.floor() as i64;
            self.timestamp = timestamp;
        }
    }

    /// The index lies at every multiple of a turn.
    fn pass(&mut self) {
        let now = self.shaft.floor() as i64;
        let (before, after) = (self.last.min(now), self.last.max(now));
        let index = after.div_euclid(self.counts_per_turn) * self.counts_per_turn;
        if index <= before || self.control & (CLEAR_ON_INDEX | LATCH_ON_INDEX) == 0 {
            return;
        }
        if self.control & LATCH_ON_INDEX != 0 {
            self.latched = (index - self.zero) as u16;
        }
        if self.control & CLEAR_ON_INDEX != 0 {
            self.zero = index;
        }
        if self.control & JUST_ONCE != 0 {
            self.control &= !(CLEAR_ON_INDEX | LATCH_ON_INDEX);
        }
    }
}
