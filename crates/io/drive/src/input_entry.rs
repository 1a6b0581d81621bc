//! Messages about the machine's inputs, checked on arrival.

use evolvent_wire::{ANALOG_SIGNALS, AXES, MachineInputs, PROBE_STATES};

/// Maximum number of bridges that read inputs at the same time: the connections of the bus.
const SOURCES: usize = 4;
/// States of the probe, as in [`PROBE_STATES`].
const PROBE_NONE: u32 = 0;
const PROBE_TRIPPED: u32 = 2;

/// Why a message was not used. The inputs keep their values, and become unknown if no valid message arrives
/// in time.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum InputFault {
    /// A value is not a number.
    #[error("an analog value or a latched position is not a number")]
    NotFinite,
    /// The time is ahead of this computer's clock.
    #[error("its time is {0} ns ahead of this computer's clock")]
    Ahead(u64),
    /// The time is too long ago.
    #[error("its time is {0} ns ago")]
    Past(u64),
    /// The number or the time does not grow.
    #[error("its number or time is not above that of the previous message")]
    Repeated,
    /// The machine file has no such digital input.
    #[error("the machine has no digital input {0}")]
    NoDigital(u32),
    /// The machine file has no such analog input.
    #[error("the machine has no analog input {0}")]
    NoAnalog(u32),
    /// Outside the machine file's range.
    #[error("analog input {number} is {value}, out of its range")]
    OutOfRange {
        /// Which.
        number: u32,
        /// Its value.
        value: f64,
    },
    /// The state of the probe is unknown.
    #[error("{0} is not a state of a probe")]
    Probe(u32),
    /// Another bridge reads the same input.
    #[error("another bridge reads one of its inputs")]
    Claimed,
    /// More bridges than connections.
    #[error("too many bridges read inputs")]
    TooMany,
}

/// A bridge's report of the probe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KnownProbe {
    /// It makes contact.
    pub is_tripped: bool,
    /// Number of times that it has tripped since the start of the bridge.
    pub trips: u64,
    /// Time of the last change, ns of CLOCK_MONOTONIC, never ahead of this computer's clock; none if the
    /// bridge does not know.
    pub time_ns: Option<u64>,
    /// Positions that the drives latched at that time.
    pub position: [f64; AXES],
    /// Bit i set: the drive of axis i has.
    pub latched_mask: u32,
    /// The start of the bridge.
    pub instance: u64,
}

/// The known inputs of a machine.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct KnownInputs {
    /// Bit i set: the state of digital input i is known.
    pub digital_known: u64,
    /// Bit i: state of digital input i.
    pub digital: u64,
    /// Bit i set: the value of analog input i is known.
    pub analog_known: u32,
    /// Values of the analog inputs; 0 if unknown.
    pub analog: [f64; ANALOG_SIGNALS],
    /// The probe; none if no bridge reports it.
    pub probe: Option<KnownProbe>,
}

/// The last message of one bridge.
#[derive(Clone, Copy, Debug)]
struct Source {
    message: MachineInputs,
    /// Its time, but never later than its arrival.
    time_ns: u64,
}

/// Checks every message and knows which inputs are known. Neither allocates nor waits.
#[derive(Clone, Debug)]
pub struct InputEntry {
    digital: u64,
    analog: u32,
    ranges: [[f64; 2]; ANALOG_SIGNALS],
    timeout_ns: u64,
    sources: [Option<Source>; SOURCES],
    refused: u64,
    last_fault: Option<InputFault>,
}

impl InputEntry {
    /// For a machine with these digital inputs, one bit each. `timeout_ns`: maximum age of the newest
    /// message.
    #[must_use]
    pub fn new(digital: u64, timeout_ns: u64) -> Self {
        Self {
            digital,
            analog: 0,
            ranges: [[0.0; 2]; ANALOG_SIGNALS],
            timeout_ns,
            sources: [None; SOURCES],
            refused: 0,
            last_fault: None,
        }
    }

    /// Adds an analog input with its range. Numbers out of range are ignored.
    #[must_use]
    pub fn with_analog(mut self, number: u32, range: [f64; 2]) -> Self {
        if let Some(slot) = self.ranges.get_mut(number as usize) {
            *slot = range;
            self.analog |= 1 << number;
        }
        self
    }

    /// Number of messages that were not used, and why the last was not.
    #[must_use]
    pub fn refused(&self) -> (u64, Option<InputFault>) {
        (self.refused, self.last_fault)
    }

    /// Accepts a message that has arrived at `now_ns` of CLOCK_MONOTONIC.
    ///
    /// # Errors
    /// Its fault; it is then not used, and counted.
    pub fn take(&mut self, message: &MachineInputs, now_ns: u64) -> Result<(), InputFault> {
        let result = self.check(message, now_ns).map(|slot| {
            self.sources[slot] = Some(Source {
                message: *message,
                time_ns: message.time_ns.min(now_ns),
            });
        });
        if let Err(fault) = result {
            self.refused += 1;
            self.last_fault = Some(fault);
        }
        result
    }

    /// The inputs at this time: the last values of the bridges that are not too old.
    pub fn known(&mut self, now_ns: u64) -> KnownInputs {
        let mut known = KnownInputs::default();
        for slot in &mut self.sources {
            let Some(source) = slot else { continue };
            if now_ns.saturating_sub(source.time_ns) > self.timeout_ns {
                *slot = None;
                continue;
            }
            let message = &source.message;
            known.digital_known |= message.digital_mask;
            known.digital |= message.digital & message.digital_mask;
            known.analog_known |= message.analog_mask;
            for (index, value) in known.analog.iter_mut().enumerate() {
                if message.analog_mask >> index & 1 == 1 {
                    *value = message.analog[index];
                }
            }
            if message.probe != PROBE_NONE {
                known.probe = Some(KnownProbe {
                    is_tripped: message.probe == PROBE_TRIPPED,
                    trips: message.probe_trips,
                    time_ns: (message.probe_time_ns > 0).then_some(message.probe_time_ns.min(source.time_ns)),
                    position: message.probe_position,
                    latched_mask: message.probe_latched_mask,
                    instance: message.instance,
                });
            }
        }
        known
    }

    /// The index of its source.
    fn check(&self, message: &MachineInputs, now_ns: u64) -> Result<usize, InputFault> {
        if !message.is_finite() {
            return Err(InputFault::NotFinite);
        }
        if message.time_ns > now_ns.saturating_add(self.timeout_ns) {
            return Err(InputFault::Ahead(message.time_ns - now_ns));
        }
        if now_ns.saturating_sub(message.time_ns) > self.timeout_ns {
            return Err(InputFault::Past(now_ns - message.time_ns));
        }
        let foreign = message.digital_mask & !self.digital;
        if foreign != 0 {
            return Err(InputFault::NoDigital(foreign.trailing_zeros()));
        }
        let foreign = message.analog_mask & !self.analog;
        if foreign != 0 {
            return Err(InputFault::NoAnalog(foreign.trailing_zeros()));
        }
        for (index, [min, max]) in self.ranges.into_iter().enumerate() {
            let value = message.analog[index];
            if message.analog_mask >> index & 1 == 1 && !(min..=max).contains(&value) {
                let number = index as u32;
                return Err(InputFault::OutOfRange { number, value });
            }
        }
        if !PROBE_STATES.iter().any(|&(_, state)| state == message.probe) {
            return Err(InputFault::Probe(message.probe));
        }
        let mut free = None;
        for (index, slot) in self.sources.iter().enumerate() {
            let Some(source) = slot else {
                free = free.or(Some(index));
                continue;
            };
            let before = &source.message;
            if before.instance == message.instance {
                let grows = message.sequence > before.sequence && message.time_ns >= before.time_ns;
                return if grows {
                    Ok(index)
                } else {
                    Err(InputFault::Repeated)
                };
            }
            let is_old = now_ns.saturating_sub(source.time_ns) > self.timeout_ns;
            if is_old {
                free = free.or(Some(index));
            } else if before.digital_mask & message.digital_mask != 0
                || before.analog_mask & message.analog_mask != 0
                || before.probe != PROBE_NONE && message.probe != PROBE_NONE
            {
                return Err(InputFault::Claimed);
            }
        }
        free.ok_or(InputFault::TooMany)
    }
}
