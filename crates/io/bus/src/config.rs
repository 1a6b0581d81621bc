//! Settings with which core and clients open the bus.

use core::time::Duration;

/// Snapshots that a reader of every status may lag behind; 5 MB of shared memory with all 40 readers.
pub const STATUS_BUFFER: usize = 64;

/// The largest setpoint buffer, in setpoints; with 9 axes and 12 subscribers 310 MB of shared memory.
pub const MAX_SETPOINT_BUFFER: usize = 65_536;

/// Setpoint connections reserved for bridges: the number of bridges that may send feedback.
pub const PLACES_FOR_BRIDGES: usize = 4;

/// Status and control connections reserved for operators who must get through, above all to stop.
pub const PLACES_FOR_OPERATORS: usize = 8;

/// How the core opens the bus.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BusConfig {
    /// The machine's name: letters, digits, `-` and `_`, at most 64.
    pub machine_name: String,
    /// iceoryx2's file prefix. Cores and clients with different prefixes do not see each other. None:
    /// iceoryx2's own, from its configuration file, so that foreign clients need none.
    pub prefix: Option<String>,
    /// The control period in ns.
    pub period_ns: u64,
    /// The letters of the machine's axes in order, like `XYZ`.
    pub axes: String,
    /// Setpoints that a subscriber may lag behind before it loses the oldest.
    pub setpoint_buffer: usize,
    /// Maximum number of simultaneous setpoint readers; [`PLACES_FOR_BRIDGES`] connections remain for
    /// bridges.
    pub max_setpoint_subscribers: usize,
    /// Maximum wait for other cores to open, and for the removal of a killed run's resources.
    pub open_timeout: Duration,
}

impl BusConfig {
    /// The default settings: one second of setpoints, but 256 to 16 384 of them, and 8 subscribers.
    #[must_use]
    pub fn new(machine_name: &str, axes: &str, period_ns: u64) -> Self {
        let per_second = 1_000_000_000 / period_ns.max(1);
        Self {
            machine_name: machine_name.to_owned(),
            prefix: None,
            period_ns,
            axes: axes.to_owned(),
            setpoint_buffer: per_second.clamp(256, 16_384) as usize,
            max_setpoint_subscribers: 8,
            // Cores of all prefixes open one after the other: a busy host may let each of them wait.
            open_timeout: Duration::from_secs(20),
        }
    }
}

/// How a client opens the bus.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ClientConfig {
    /// The machine's name.
    pub machine_name: String,
    /// The core's prefix; see [`BusConfig::prefix`].
    pub prefix: Option<String>,
    /// The control period that the client is made for, in ns; any if none.
    pub period_ns: Option<u64>,
    /// The axes that the client is made for; any if none.
    pub axes: Option<String>,
    /// Maximum wait for a core that is not up yet.
    pub wait: Duration,
}

impl ClientConfig {
    /// A client that accepts any period and axes and waits 5 s for the core.
    #[must_use]
    pub fn new(machine_name: &str) -> Self {
        Self {
            machine_name: machine_name.to_owned(),
            prefix: None,
            period_ns: None,
            axes: None,
            wait: Duration::from_secs(5),
        }
    }
}
