//! A beam with a motor and a home switch at each side: a gantry.

/// Hysteresis of a switch: it opens this far above the edge at which it closes, mm.
const HYSTERESIS: f64 = 0.06;

/// The motor of one side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BeamMotor {
    /// The motor of the step generator of this number.
    Steps(usize),
    /// The shaft at the encoder of this number.
    Shaft(usize),
}

/// One side of a beam.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BeamSide {
    /// Its motor.
    pub motor: BeamMotor,
    /// Steps or counts per mm; negative for a motor that turns against the axis.
    pub per_mm: f64,
    /// Initial position, mm.
    pub start_mm: f64,
    /// Pin of its home switch, low while the switch is closed.
    pub switch_pin: usize,
    /// Position at which the switch closes, towards smaller positions, mm.
    pub switch_mm: f64,
}

/// A beam, square while both sides have the same position. A motor loses steps if its side is held, or if it
/// would rack the beam beyond its maximum twist.
#[derive(Clone, Copy, Debug)]
pub struct Beam {
    sides: [BeamSide; 2],
    max_rack_mm: f64,
    position: [f64; 2],
    motor: [Option<f64>; 2],
    held: [bool; 2],
    closed: [bool; 2],
    is_wired: [bool; 2],
}

impl Beam {
    /// Creates a beam that twists by at most `max_rack_mm`.
    #[must_use]
    pub fn new(sides: [BeamSide; 2], max_rack_mm: f64) -> Self {
        Self {
            position: sides.map(|side| side.start_mm),
            motor: [None; 2],
            held: [false; 2],
            closed: [false; 2],
            is_wired: [true; 2],
            sides,
            max_rack_mm,
        }
    }

    /// Positions of the sides, mm.
    #[must_use]
    pub const fn position_mm(&self) -> [f64; 2] {
        self.position
    }

    /// Blocks or releases a side.
    pub const fn hold(&mut self, side: usize, is_held: bool) {
        self.held[side] = is_held;
    }

    /// Moves a side without its motor, as a motor without torque permits.
    pub fn slip(&mut self, side: usize, mm: f64) {
        self.position[side] += mm;
    }

    /// Connects or breaks the wire of a switch: a broken one reads open.
    pub const fn wire_switch(&mut self, side: usize, is_wired: bool) {
        self.is_wired[side] = is_wired;
    }

    pub(crate) const fn sides(&self) -> &[BeamSide; 2] {
        &self.sides
    }

    pub(crate) const fn is_held(&self, side: usize) -> bool {
        self.held[side]
    }

    /// Moves the sides with their motors. Returns the levels at the pins of the switches.
    pub(crate) fn follow(&mut self, motors: [f64; 2]) -> [(usize, bool); 2] {
        for (side, now) in motors.into_iter().enumerate() {
            let before = self.motor[side].replace(now).unwrap_or(now);
            let other = self.position[1 - side];
            if !self.held[side] {
                let wanted = self.position[side] + (now - before) / self.sides[side].per_mm;
                self.position[side] = wanted.clamp(other - self.max_rack_mm, other + self.max_rack_mm);
            }
            let above = if self.closed[side] { HYSTERESIS } else { 0.0 };
            self.closed[side] = self.position[side] <= self.sides[side].switch_mm + above;
        }
        core::array::from_fn(|side| {
            let is_closed = self.closed[side] && self.is_wired[side];
            (self.sides[side].switch_pin, !is_closed)
        })
    }
}
