//! Reasons for the end of a session, and its notices.

use evolvent_drive::{GantryFault, InterpolationError, SettingsError};
use thiserror::Error;

use crate::clock_monitor::ClockFigures;
use crate::drive_limits::{LimitError, LimitNote};
use crate::dump::DumpTrouble;
use crate::pdo::PdoError;
use crate::spindle_drive::SpindleNotice;

/// Why a session did not start, or why it ended.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum SessionError {
    /// No device replies.
    #[error("no device replies: check cable, interface and supply")]
    NoDevices,
    /// The number of devices differs from the file.
    #[error("{found} devices are on the wire, the network file lists {expected}: check cables and the file")]
    Count {
        /// On the wire.
        found: usize,
        /// In the file.
        expected: usize,
    },
    /// A device differs from the file.
    #[error(
        "device {position} (`{name}`): {what} is {found:#x} on the wire and {expected:#x} in the network \
         file: check the order of the devices"
    )]
    Identity {
        /// Position on the wire, from 1.
        position: usize,
        /// Name in the file.
        name: String,
        /// The number that differs.
        what: &'static str,
        /// On the wire.
        found: u32,
        /// In the file.
        expected: u32,
    },
    /// An object cannot be read or written.
    #[error("`{name}`: object {index:04X}h:{sub_index} cannot be {action}: {why}")]
    Object {
        /// Name in the file.
        name: String,
        /// Index.
        index: u16,
        /// Sub-index.
        sub_index: u8,
        /// "read" or "written".
        action: &'static str,
        /// The message of the device or the MainDevice.
        why: String,
    },
    /// Process data cannot be used.
    #[error("`{name}`: {why}")]
    ProcessData {
        /// Name in the file.
        name: String,
        /// The error.
        why: PdoError,
    },
    /// A signal of the file is beyond the process data.
    #[error(
        "`{name}`: the network file has a signal up to bit {bit} of its {direction}s, of which there are \
         {bits}: `--scan` lists them"
    )]
    SignalPlace {
        /// Name in the file.
        name: String,
        /// `input` or `output`.
        direction: &'static str,
        /// The last bit of the signal.
        bit: u32,
        /// Number of bits available.
        bits: usize,
    },
    /// The machine file permits what a drive does not.
    #[error(transparent)]
    DriveLimit(#[from] LimitError),
    /// A drive cannot use the period.
    #[error(transparent)]
    Period(#[from] InterpolationError),
    /// A limit of the machine is invalid.
    #[error(transparent)]
    Limits(#[from] SettingsError),
    /// A device rejected a state.
    #[error("a device did not reach {wanted}: {states}")]
    State {
        /// The state.
        wanted: &'static str,
        /// The state of each device.
        states: String,
    },
    /// The MainDevice cannot continue.
    #[error("{doing}: {why}")]
    Main {
        /// The failed step.
        doing: &'static str,
        /// Why it failed.
        why: String,
    },
    /// Frames stopped returning.
    #[error("{frames} frames in a row did not return: check the cable")]
    Lost {
        /// How many.
        frames: u32,
    },
    /// The library failed.
    #[error("a device sent data that the EtherCAT library cannot handle (such as a broken EEPROM): {what}")]
    Library {
        /// Its message.
        what: String,
    },
    /// A device left OP, or does not reply.
    #[error("the network failed: {states}")]
    Broken {
        /// The state of each device.
        states: String,
    },
}

/// Events of a session, for the log.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Notice {
    /// All devices are in OP.
    Operational { clocks: bool },
    /// The recording of the wire has lost something, or has ended.
    Recording(DumpTrouble),
    /// Measurements of the clocks since then.
    Clocks { figures: ClockFigures },
    /// A drive is in fault.
    DriveFault { axis: usize, code: u16 },
    /// A limit of a drive is lower than that of the machine file.
    Limit(LimitNote),
    /// A spindle, by its number.
    Spindle { number: usize, notice: SpindleNotice },
    /// The drives of a gantry have to stop.
    Gantry { axis: usize, fault: GantryFault },
    /// A gantry was homed by its switches, and its second drive was this far from square.
    Squared { axis: usize, by: f64 },
    /// A drive has found its machine zero, or has not.
    Homed { axis: usize, found: bool },
    /// A device has sent an emergency message while the network came up.
    Emergency { device: usize, code: u16, register: u8 },
    /// A device is in OP, and does not exchange process data.
    DeviceSilent { device: usize },
    /// A device does not reply, or has left OP.
    DeviceLost { device: usize },
    /// Process data returned with a working counter that is too small.
    Short { found: u16, expected: u16 },
}
