//! A spindle at a board: a motor with inertia and an analog speed command, and the encoder on its shaft.

/// Source of the spindle's speed command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SpindleCommand {
    /// A PWM generator whose sign is the direction.
    SignedPwm {
        /// Its number.
        unit: usize,
    },
    /// A PWM generator, and a contact for each direction.
    Contacts {
        /// Its number.
        unit: usize,
        /// Pin for clockwise.
        forward: usize,
        /// Pin for counter-clockwise.
        reverse: usize,
    },
    /// The spindle terminals of the 7I76 on smart serial.
    Field,
}

/// A spindle and its encoder.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spindle {
    /// The encoder on its shaft.
    pub encoder: usize,
    /// Its drive's command.
    pub command: SpindleCommand,
    /// Counts per turn; the index input is on at one of them.
    pub counts_per_turn: i64,
    /// Speed at full output, rpm.
    pub full_rpm: f64,
    /// Acceleration, rpm per second.
    pub acceleration_rpm_s: f64,
    /// Amplitude of the speed ripple, three cycles per turn, as a ratio of the speed.
    pub ripple: f64,
}

impl Spindle {
    /// A spindle that reaches 3000 rpm at full output in 1.5 s, with 4096 counts per turn and no ripple.
    #[must_use]
    pub const fn usual(encoder: usize, command: SpindleCommand) -> Self {
        Self {
            encoder,
            command,
            counts_per_turn: 4096,
            full_rpm: 3000.0,
            acceleration_rpm_s: 2000.0,
            ripple: 0.0,
        }
    }
}
