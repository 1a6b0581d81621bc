//! The probe at one instant, and what a cycle goes by of it.

use self::probe_numbers::{CHANGES, POSITION, STATE};

/// Numbers of the values of a probe.
pub mod probe_numbers {
    /// Its state: 0 open, 1 tripped, 2 where time is not real and no contact is known.
    pub const STATE: u32 = 0;
    /// Changes whose position is known.
    pub const CHANGES: u32 = 1;
    /// The position of axis 0 at the last of them; those of the other axes follow.
    pub const POSITION: u32 = 2;
    /// How many numbers there are.
    pub const COUNT: u32 = POSITION + 9;
}

/// Axes whose position a contact has.
const AXES: usize = 9;

/// What is known of a probe.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ProbeState {
    /// No bridge says anything of it, or none has for too long.
    #[default]
    Unknown,
    /// No contact.
    Open,
    /// Contact.
    Tripped,
    /// Time is not real and no contact is reported: none is made.
    Imagined,
}

/// The probe at one instant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ProbeImage {
    /// Its state.
    pub state: ProbeState,
    /// How often it has changed so far, as far as the position of the change is known.
    pub changes: u32,
    /// Where the axes were at the last of these changes, machine coordinates (mm, degrees).
    pub position: [f64; AXES],
}

impl ProbeImage {
    /// One more change, at this position. Real-time safe.
    pub fn locate_change(&mut self, position: [f64; AXES]) {
        self.changes = self.changes.wrapping_add(1);
        self.position = position;
    }

    /// A value by its number (see [`probe_numbers`]). Real-time safe.
    #[must_use]
    pub fn value(&self, number: u32) -> Option<f64> {
        match number {
            STATE => match self.state {
                ProbeState::Unknown => None,
                ProbeState::Open => Some(0.0),
                ProbeState::Tripped => Some(1.0),
                ProbeState::Imagined => Some(2.0),
            },
            CHANGES => Some(f64::from(self.changes)),
            _ => self.position.get(number.checked_sub(POSITION)? as usize).copied(),
        }
    }

    /// Sets a value by its number. Numbers that there are not are left alone. Real-time safe.
    pub fn set(&mut self, number: u32, value: Option<f64>) {
        match (number, value) {
            (STATE, None) => self.state = ProbeState::Unknown,
            (STATE, Some(value)) => {
                self.state = match value {
                    0.0 => ProbeState::Open,
                    1.0 => ProbeState::Tripped,
                    _ => ProbeState::Imagined,
                };
            }
            (CHANGES, Some(value)) => self.changes = value as u32,
            (_, Some(value)) => {
                let slot = number
                    .checked_sub(POSITION)
                    .and_then(|axis| self.position.get_mut(axis as usize));
                if let Some(slot) = slot {
                    *slot = value;
                }
            }
            _ => {}
        }
    }
}

/// What a cycle goes by of the probe: its image, and what lies between it and the one of the cycle before.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ProbeInput {
    /// The newest sample.
    pub now: ProbeImage,
    /// It was tripped in a sample since the cycle before.
    pub was_tripped: bool,
    /// It was open in a sample since the cycle before.
    pub was_open: bool,
}

impl ProbeInput {
    /// One more sample of the same cycle. Real-time safe.
    pub(crate) fn observe(&mut self, image: &ProbeImage) {
        self.now = *image;
        self.was_tripped |= image.state == ProbeState::Tripped;
        self.was_open |= image.state == ProbeState::Open;
    }

    /// What this cycle goes by; the next begins with the newest sample. Real-time safe.
    pub(crate) fn take(&mut self) -> Self {
        let taken = *self;
        (self.was_tripped, self.was_open) = (false, false);
        let now = taken.now;
        self.observe(&now);
        taken
    }
}
