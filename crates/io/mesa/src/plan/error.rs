//! Why a board file does not fit a board.

use thiserror::Error;

use crate::packet::PacketFull;
use crate::smart_serial::RemoteError;

/// Why a board does not support its board file.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum PlanError {
    /// Another board.
    #[error("the board has the name {found}, the board file has {wanted}: correct `name` or `address`")]
    Name {
        /// The name found on the network.
        found: String,
        /// The name in the file.
        wanted: String,
    },
    /// A kind of module is missing, or has too few instances.
    #[error(
        "the board file uses {what} {unit}, but the firmware of this {board} has {instances}: correct the \
         number, or write a bit file with more of them"
    )]
    Module {
        /// Its function.
        what: &'static str,
        /// Its number, from 0.
        unit: usize,
        /// The board.
        board: String,
        /// Number of instances of the board.
        instances: usize,
    },
    /// A module that the bridge does not support.
    #[error(
        "the {what} module is of a kind that is not known (version {version}, {registers} registers, stride \
         {stride}): the \
         firmware is newer than this software"
    )]
    Kind {
        /// Its function.
        what: &'static str,
        /// Its version.
        version: u8,
        /// Its registers.
        registers: u8,
        /// Its stride.
        stride: u16,
    },
    /// A module pin that is not connected to a pin of the board.
    #[error("{what} {unit} has no pin on this board: choose another number")]
    NoPin {
        /// Its function.
        what: &'static str,
        /// Its number.
        unit: usize,
    },
    /// A pin that the board does not have.
    #[error("pin {pin} is not a pin of this board, which has {pins}: correct the number")]
    Pin {
        /// The pin.
        pin: usize,
        /// Number of pins of the board.
        pins: usize,
    },
    /// A pin with two uses.
    #[error("pin {pin} is driven by {by}: choose another")]
    Taken {
        /// The pin.
        pin: usize,
        /// A key of the board file, or a module.
        by: String,
    },
    /// An output where the board has an input, or the other way round.
    #[error("pin {pin} is {function}: choose {wanted}")]
    Function {
        /// The pin.
        pin: usize,
        /// What the firmware has at the pin.
        function: String,
        /// "an input" or "an output".
        wanted: &'static str,
    },
    /// An error of a pin of the board file.
    #[error("{file}: {key}: {cause}")]
    At {
        /// The file.
        file: String,
        /// The key of the pin.
        key: String,
        /// The error.
        cause: Box<PlanError>,
    },
    /// A watchdog that would trip between two packets.
    #[error(
        "watchdog_ms is {watchdog_ms}, and packets come every {period_ms:.3} ms: give at least two periods, \
         preferably ten"
    )]
    Watchdog {
        /// Its time.
        watchdog_ms: f64,
        /// The period of the core.
        period_ms: f64,
    },
    /// A time that is too long.
    #[error(
        "{what} of {time_ns} ns is more than the step generators of this board can ({most_ns:.0} ns): \
         shorten it"
    )]
    Time {
        /// Which.
        what: &'static str,
        /// The time.
        time_ns: f64,
        /// The maximum.
        most_ns: f64,
    },
    /// The times, rounded up to clocks, do not permit the maximum velocity.
    #[error(
        "step generator {unit}: {needed:.0} steps/s needed, {possible:.0} possible at this board's clock: \
         shorten its times"
    )]
    StepRate {
        /// Its number.
        unit: usize,
        /// Steps/s at the maximum velocity.
        needed: f64,
        /// Steps/s permitted by the times.
        possible: f64,
    },
    /// More counts of a spindle between two readings than a 16-bit counter can resolve.
    #[error("encoder {unit} counts {counts:.0} in a period, more than 30000: choose a higher control rate")]
    Counts {
        /// Its number.
        unit: usize,
        /// Counts per period at the maximum speed.
        counts: f64,
    },
    /// A 16-bit counter may wrap before the session ends for lack of replies.
    #[error(
        "{what} {unit} overflows in {longest_ms:.1} ms at 1.2 times the maximum speed, which is not detected \
         while max_lost_packets = {max_lost} replies are missing: {}",
        cure(*.permitted)
    )]
    TurnsOver {
        /// Encoder or step generator.
        what: &'static str,
        /// Its number.
        unit: usize,
        /// Maximum time without a reading.
        longest_ms: f64,
        /// Maximum number of consecutive missing replies.
        max_lost: u32,
        /// Periods in that time.
        permitted: u32,
    },
    /// A pin without a filter.
    #[error("pin {pin} has no filter on this board (InM): remove `slow`")]
    NoFilter {
        /// The pin.
        pin: usize,
    },
    /// A smart-serial device lacks data that the file requires.
    #[error(transparent)]
    Remote(#[from] RemoteError),
    /// The registers exceed a packet.
    #[error(transparent)]
    Full(#[from] PacketFull),
}

/// The remedy for a counter that may overflow within this number of periods.
fn cure(periods: u32) -> String {
    match periods.saturating_sub(1) {
        0 => "choose a higher control rate, or fewer counts".to_owned(),
        most => format!("choose max_lost_packets = {most} or less, or a higher control rate"),
    }
}
