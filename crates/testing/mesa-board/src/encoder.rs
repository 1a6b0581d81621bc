//! A quadrature counter, the servo drive at a PWM output, and their axis.

/// Writable bits of the control register.
const CONTROL: u32 = 0x7FF8;
const CLEAR_ON_INDEX: u32 = 1 << 5;
const LATCH_ON_INDEX: u32 = 1 << 4;
const JUST_ONCE: u32 = 1 << 6;
/// The rising edge of the index input counts; otherwise the falling one.
const RISING: u32 = 1 << 3;

/// A counter with timestamp, and the shaft that it counts.
#[derive(Clone, Debug)]
pub(crate) struct Encoder {
    /// Counts of the shaft since the start.
    shaft: f64,
    /// Shaft position at which the counter reads zero.
    zero: i64,
    latched: u16,
    control: u32,
    timestamp: u16,
    last: i64,
    /// Counts per turn. The index input is on at one count per turn, `index_count` plus a multiple of a turn.
    counts_per_turn: i64,
    index_count: i64,
    has_index: bool,
    /// Counts/s at full PWM.
    full_speed: f64,
    speed: f64,
    /// The shaft is blocked.
    is_held: bool,
    /// For a spindle: acceleration, counts/s2, and amplitude of the ripple of three cycles per turn.
    inertia: Option<(f64, f64)>,
    /// Fraction of the counts that the counter misses.
    loss: f64,
    /// Fraction of a count missed so far.
    lost: f64,
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
            index_count: 0,
            has_index: true,
            full_speed: 200_000.0,
            speed: 0.0,
            is_held: false,
            inertia: None,
            loss: 0.0,
            lost: 0.0,
        }
    }
}

/// Time constant of the drive's velocity loop, s.
const LAG_S: f64 = 0.002;
/// Deceleration of a stalled spindle, as a multiple of its drive's.
const STALL_FACTOR: f64 = 20.0;
/// Longest step of the drive's simulation, s.
const STEP_S: f64 = 0.000_2;

impl Encoder {
    pub(crate) fn count(&self) -> u32 {
        let count = (self.shaft.floor() as i64 - self.zero) as u16;
        u32::from(self.timestamp) << 16 | u32::from(count)
    }

    pub(crate) fn control(&self) -> u32 {
        let count = self.shaft.floor() as i64;
        let at_index = self.has_index && self.is_at(count, self.index_count);
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

    pub(crate) fn set_shaft(&mut self, shaft: f64) {
        self.shaft = shaft;
        self.zero = shaft.floor() as i64;
        self.last = shaft.floor() as i64;
    }

    /// Turns the shaft, as by hand; the counter counts it.
    pub(crate) const fn turn(&mut self, counts: f64) {
        self.shaft += counts;
    }

    /// Blocks or releases the shaft, against its drive.
    pub(crate) const fn hold(&mut self, is_held: bool) {
        self.is_held = is_held;
    }

    /// Sets counts per turn, and counts/s at full duty.
    pub(crate) const fn set_drive(&mut self, counts_per_turn: i64, full_speed: f64) {
        self.counts_per_turn = counts_per_turn;
        self.full_speed = full_speed;
    }

    /// Makes this the spindle's encoder: acceleration, counts/s2, and amplitude of the ripple of three cycles
    /// per turn.
    pub(crate) const fn set_inertia(&mut self, acceleration: f64, ripple: f64) {
        self.inertia = Some((acceleration, ripple));
    }

    /// Sets the fraction of the counts that the counter misses from now on.
    pub(crate) const fn set_loss(&mut self, loss: f64) {
        self.loss = loss;
    }

    /// The count within a turn at which the index input is on.
    pub(crate) const fn set_index(&mut self, count: i64) {
        self.index_count = count;
    }

    /// Whether the counter is armed to latch the next index.
    pub(crate) const fn index_is_armed(&self) -> bool {
        self.control & (LATCH_ON_INDEX | CLEAR_ON_INDEX) != 0
    }

    /// Connects or disconnects the index input.
    pub(crate) const fn set_has_index(&mut self, has_index: bool) {
        self.has_index = has_index;
    }

    const fn is_at(&self, count: i64, target: i64) -> bool {
        (count - target).rem_euclid(self.counts_per_turn) == 0
    }

    /// Resets to the state after power-up; the shaft keeps its position.
    pub(crate) fn reset(&mut self) {
        (self.control, self.latched) = (0, 0);
        self.clear();
    }

    /// Advances the time. `duty`: the command of this axis's drive, -1 to 1.
    pub(crate) fn advance(&mut self, time_s: f64, duty: f64, timestamp: u16) {
        let mut rest = time_s;
        while rest > 0.0 {
            let step = rest.min(STEP_S);
            rest -= step;
            let wanted = duty * self.full_speed;
            let lagging = (wanted - self.speed) * (1.0 - (-step / LAG_S).exp());
            let (max_change, ripple) = match self.inertia {
                Some((acceleration, ripple)) if self.is_held => (STALL_FACTOR * acceleration * step, ripple),
                Some((acceleration, ripple)) => (acceleration * step, ripple),
                None => (f64::INFINITY, 0.0),
            };
            let has_inertia = self.inertia.is_some();
            self.speed += if self.is_held {
                (-self.speed).clamp(-max_change, max_change)
            } else {
                lagging.clamp(-max_change, max_change)
            };
            if self.is_held && !has_inertia || wanted == 0.0 && self.speed.abs() < 1.0 {
                self.speed = 0.0;
            }
            let turns = self.shaft / self.counts_per_turn as f64;
            let uneven = 1.0 + ripple * (3.0 * std::f64::consts::TAU * turns).sin();
            self.shaft += self.speed * uneven * step;
            self.pass(timestamp);
        }
    }

    /// Moves the counter to the shaft, and handles the edges of the index input in between.
    fn pass(&mut self, timestamp: u16) {
        let now = self.shaft.floor() as i64;
        let (before, upwards) = (self.last, now > self.last);
        if now == before {
            return;
        }
        self.last = now;
        if self.loss > 0.0 {
            self.lost += self.loss * (now - before) as f64;
            let whole = self.lost.trunc();
            self.lost -= whole;
            self.zero += whole as i64;
        }
        if self.loss >= 1.0 {
            return;
        }
        self.timestamp = timestamp;
        if !self.has_index || self.control & (CLEAR_ON_INDEX | LATCH_ON_INDEX) == 0 {
            return;
        }
        // The count just after the edge. The input switches on when the count reaches the index count, and
        // off when it leaves it.
        let after_edge = match (self.control & RISING != 0, upwards) {
            (true, _) => self.index_count,
            (false, true) => self.index_count + 1,
            (false, false) => self.index_count - 1,
        };
        let turns = self.counts_per_turn;
        let distance = if upwards {
            (after_edge - before - 1).rem_euclid(turns) + 1
        } else {
            -((before - after_edge - 1).rem_euclid(turns) + 1)
        };
        if distance.abs() > (now - before).abs() {
            return;
        }
        let count = before + distance;
        if self.control & LATCH_ON_INDEX != 0 {
            self.latched = (count - self.zero) as u16;
        }
        if self.control & CLEAR_ON_INDEX != 0 {
            self.zero = count;
        }
        if self.control & JUST_ONCE != 0 {
            self.control &= !(CLEAR_ON_INDEX | LATCH_ON_INDEX);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An encoder whose shaft is turned by hand from a count.
    fn turned(control: u32, from: f64, by: f64) -> Encoder {
        let mut encoder = Encoder::default();
        encoder.set_index(7);
        encoder.set_shaft(from);
        encoder.zero = 0;
        encoder.set_control(control);
        encoder.turn(by);
        encoder.advance(1e-6, 0.0, 1);
        encoder
    }

    #[test]
    fn requested_edge_is_latched_once_from_either_side() {
        let once = LATCH_ON_INDEX | JUST_ONCE;
        for (control, from, by, expected) in [
            (once | RISING, 0.5, 20.0, Some(7)),
            (once | RISING, 20.5, -20.0, Some(7)),
            (once, 0.5, 20.0, Some(8)),
            (once, 20.5, -20.0, Some(6)),
            // From within the pulse, only its end occurs, and the beginning of the next one a turn later.
            (once | RISING, 7.5, 20.0, None),
            (once | RISING, 7.5, 4001.0, Some(4007)),
            (once, 7.5, 1.0, Some(8)),
            (once | RISING, 0.5, 6.0, None),
            (once | RISING, 8.5, 3990.0, None),
            (RISING, 0.5, 20.0, None),
        ] {
            let encoder = turned(control, from, by);
            let latched = (encoder.control & LATCH_ON_INDEX == 0 && encoder.latched != 0)
                .then_some(encoder.control() >> 16);
            assert_eq!(latched, expected, "{control:X} {from} {by}");
        }
        let cleared = turned(CLEAR_ON_INDEX | JUST_ONCE | RISING, 0.5, 20.0);
        assert_eq!(cleared.count() & 0xFFFF, 13, "counts from the pulse on");
    }
}
