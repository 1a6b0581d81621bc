//! Events: numbers that wake sleeping clients.

/// Why a client is woken. The status, published before the event, has the details.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u32)]
pub enum EventKind {
    /// A core has opened the bus.
    CoreOpened = 1,
    /// The core has closed the bus normally.
    CoreClosed = 2,
    /// The core was found dead.
    CoreDied = 3,
    /// A run has started.
    Started = 4,
    /// A feed hold has started.
    Hold = 5,
    /// The run continues after a hold.
    Resumed = 6,
    /// The run was stopped before its end; the machine is at rest.
    Stopped = 7,
    /// The program has ended.
    Done = 8,
    /// A fault is latched; its number is among the status's alarms.
    Fault = 9,
    /// The faults were reset.
    Reset = 10,
    /// Another change of the status.
    StatusChanged = 11,
}

impl EventKind {
    /// All events in the order of their numbers.
    pub const ALL: [Self; 11] = [
        Self::CoreOpened,
        Self::CoreClosed,
        Self::CoreDied,
        Self::Started,
        Self::Hold,
        Self::Resumed,
        Self::Stopped,
        Self::Done,
        Self::Fault,
        Self::Reset,
        Self::StatusChanged,
    ];

    /// The largest number of the event service, with reserve for later events.
    pub const MAX_NUMBER: usize = 63;

    /// The number on the bus.
    #[must_use]
    pub const fn number(self) -> u32 {
        self as u32
    }

    /// The event with a number; none for a number of a later version.
    #[must_use]
    pub fn from_number(number: usize) -> Option<Self> {
        Self::ALL
            .into_iter()
            .find(|kind| kind.number() as usize == number)
    }

    /// The name in the generated bindings.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::CoreOpened => "CORE_OPENED",
            Self::CoreClosed => "CORE_CLOSED",
            Self::CoreDied => "CORE_DIED",
            Self::Started => "STARTED",
            Self::Hold => "HOLD",
            Self::Resumed => "RESUMED",
            Self::Stopped => "STOPPED",
            Self::Done => "DONE",
            Self::Fault => "FAULT",
            Self::Reset => "RESET",
            Self::StatusChanged => "STATUS_CHANGED",
        }
    }
}
