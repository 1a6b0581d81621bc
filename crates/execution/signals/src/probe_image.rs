//! The probe at one instant, and the part of it that a cycle uses.

use self::probe_numbers::{CHANGES, POSITION, STATE};

/// Numbers of the values of a probe.
pub mod probe_numbers {
    /// Its state: 0 open, 1 tripped, 2 with the virtual clock when no contact is reported.
    pub const STATE: u32 = 0;
    /// Number of changes whose position is known.
    pub const CHANGES: u32 = 1;
    /// Position of axis 0 at the last change; the positions of the other axes follow.
    pub const POSITION: u32 = 2;
    /// Number of values.
    pub const COUNT: u32 = POSITION + 9;
}

/// Number of axes whose position a contact records.
const AXES: usize = 9;

/// The state of a probe.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ProbeState {
    /// No bridge reports the probe, or the last report is too old.
    #[default]
    Unknown,
    /// No contact.
    Open,
    /// Contact.
    Tripped,
    /// With the virtual clock, no contact is reported: contacts do not occur.
    Imagined,
}

/// The probe at one instant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ProbeImage {
    /// Its state.
    pub state: ProbeState,
    /// Number of changes so far whose position is known.
    pub changes: u32,
    /// Position of the axes at the last of these changes, machine coordinates (mm, degrees).
    pub position: [f64; AXES],
}

impl ProbeImage {
    /// Records one more change, at this position. Real-time safe.
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

    /// Sets a value by its number. Numbers that do not exist are ignored. Real-time safe.
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

/// The probe as one cycle uses it: its newest image, and what happened since the previous cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ProbeInput {
    /// The newest sample.
    pub now: ProbeImage,
    /// It was tripped in a sample since the previous cycle.
    pub was_tripped: bool,
    /// It was open in a sample since the previous cycle.
    pub was_open: bool,
}

impl ProbeInput {
    /// Processes one more sample of the same cycle. Real-time safe.
    pub(crate) fn observe(&mut self, image: &ProbeImage) {
        self.now = *image;
        self.was_tripped |= image.state == ProbeState::Tripped;
        self.was_open |= image.state == ProbeState::Open;
    }

    /// Returns the values of this cycle. The next cycle begins with the newest sample. Real-time safe.
    pub(crate) fn take(&mut self) -> Self {
        let taken = *self;
        (self.was_tripped, self.was_open) = (false, false);
        let now = taken.now;
        self.observe(&now);
        taken
    }
}
