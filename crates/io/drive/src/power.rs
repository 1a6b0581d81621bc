//! The core's request to the power stages, and a bridge's state: the numbers of the bus as enums.

/// The requested state of the drives' power stages.
///
/// ```
/// use evolvent_drive::PowerRequest;
///
/// assert_eq!(PowerRequest::from_number(1), PowerRequest::On);
/// // An unknown number is a quick stop.
/// assert_eq!(PowerRequest::from_number(99), PowerRequest::QuickStop);
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u32)]
pub enum PowerRequest {
    /// No torque.
    #[default]
    Off = 0,
    /// Hold position and follow the setpoints.
    On = 1,
    /// Brake at once by the drive's own quick stop, then no torque.
    QuickStop = 2,
}

impl PowerRequest {
    /// The number on the bus.
    #[must_use]
    pub const fn number(self) -> u32 {
        self as u32
    }

    /// Reads the number of the bus. An undefined number requests the safest state that keeps the axes from
    /// falling: a quick stop.
    #[must_use]
    pub const fn from_number(number: u32) -> Self {
        match number {
            0 => Self::Off,
            1 => Self::On,
            _ => Self::QuickStop,
        }
    }
}

/// State of a bridge.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u32)]
pub enum BridgeState {
    /// No setpoint has arrived yet.
    #[default]
    Waiting = 0,
    /// The drives follow the setpoints.
    Following = 1,
    /// Setpoints are missing; the last motion continues for a few periods.
    Bridging = 2,
    /// Too many are missing: every axis brakes within its limits.
    Braking = 3,
    /// At rest under power, until setpoints arrive that start at the position of the axes.
    Holding = 4,
    /// The power stages are off.
    Off = 5,
}

impl BridgeState {
    /// The number on the bus.
    #[must_use]
    pub const fn number(self) -> u32 {
        self as u32
    }

    /// Whether targets are commanded; otherwise drives that are in operation already wait for the others.
    #[must_use]
    pub const fn has_targets(self) -> bool {
        !matches!(self, Self::Waiting | Self::Off)
    }

    /// Reads the number of the bus; none if it is undefined.
    #[must_use]
    pub const fn from_number(number: u32) -> Option<Self> {
        Some(match number {
            0 => Self::Waiting,
            1 => Self::Following,
            2 => Self::Bridging,
            3 => Self::Braking,
            4 => Self::Holding,
            5 => Self::Off,
            _ => return None,
        })
    }
}

/// A bridge's last problem with setpoints.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u32)]
pub enum Note {
    /// Nothing.
    #[default]
    None = 0,
    /// Numbers are missing in the sequence.
    Gap = 1,
    /// No setpoints arrive.
    Silence = 2,
    /// A setpoint arrived too late to be used.
    Late = 3,
    /// A setpoint that the axes cannot reach in time.
    Jump = 4,
    /// The sequence restarted: the core was restarted.
    Restart = 5,
    /// A number is not finite.
    NotFinite = 6,
    /// A message of another interface version or size.
    Version = 7,
}

impl Note {
    /// The number on the bus.
    #[must_use]
    pub const fn number(self) -> u32 {
        self as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use evolvent_wire::{BRIDGE_NOTES, BRIDGE_STATES, POWER_REQUESTS};

    fn spelled(name: impl core::fmt::Debug) -> String {
        format!("{name:?}").to_uppercase()
    }

    #[test]
    fn numbers_and_names_are_those_of_the_bus() {
        let requests = [PowerRequest::Off, PowerRequest::On, PowerRequest::QuickStop];
        for (request, (name, number)) in requests.into_iter().zip(POWER_REQUESTS) {
            assert_eq!(
                (spelled(request), request.number()),
                (name.replace('_', ""), number)
            );
            assert_eq!(PowerRequest::from_number(number), request);
        }
        for (name, number) in BRIDGE_STATES {
            assert_eq!(
                BridgeState::from_number(number).map(spelled),
                Some(name.to_owned())
            );
        }
        assert_eq!(BridgeState::from_number(BRIDGE_STATES.len() as u32), None);
        let notes = [
            Note::None,
            Note::Gap,
            Note::Silence,
            Note::Late,
            Note::Jump,
            Note::Restart,
            Note::NotFinite,
            Note::Version,
        ];
        assert_eq!(notes.len(), BRIDGE_NOTES.len());
        for (note, (name, number)) in notes.into_iter().zip(BRIDGE_NOTES) {
            assert_eq!((spelled(note), note.number()), (name.replace('_', ""), number));
        }
    }

    #[test]
    fn an_unknown_power_request_stops() {
        for number in [3, 17, u32::MAX] {
            assert_eq!(PowerRequest::from_number(number), PowerRequest::QuickStop);
        }
    }
}
