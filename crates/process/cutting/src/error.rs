//! Errors of forces and of laws.

use evolvent_config::plain;
use thiserror::Error;

/// Why a law has no force for a cut. Small and without own text, so that the cycle may return it.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum ForceError {
    /// The cutting speed is zero, negative or NaN.
    #[error("no cutting force at a speed of {speed_m_min} m/min: give a positive speed")]
    Speed {
        /// As given.
        speed_m_min: f64,
    },
    /// The depth of cut is zero, negative or NaN.
    #[error("no cutting force at a depth of {depth_mm} mm: give a positive depth")]
    Depth {
        /// As given.
        depth_mm: f64,
    },
    /// The feed is zero, negative or NaN.
    #[error("no cutting force at a feed of {feed_mm_rev} mm/rev: give a positive feed")]
    Feed {
        /// As given.
        feed_mm_rev: f64,
    },
    /// The denominator of a rational law has a zero at this feed: the force would be infinite at some speed.
    #[error(
        "the force law has a pole at a feed of {feed_mm_rev} mm/rev: (f k5)^2 is {ratio} times 4 g k6 and \
         must be below 1; choose another rake angle, feed or law"
    )]
    Pole {
        /// As given.
        feed_mm_rev: f64,
        /// `(f k5)^2 / (4 g k6)`.
        ratio: f64,
    },
    /// The cut is outside the table.
    #[error(
        "the table of forces ends before {} {quantity}: it covers {min} to {max}; extend the table",
        plain(*.value)
    )]
    Outside {
        /// Quantity with its unit.
        quantity: &'static str,
        /// As given.
        value: f64,
        /// First entry.
        min: f64,
        /// Last entry.
        max: f64,
    },
    /// The law gives a force that is negative or NaN.
    #[error(
        "the force law gives {tangential_n} N at {speed_m_min} m/min and {depth_mm} mm: it does not hold \
         there; choose another law or cut"
    )]
    Negative {
        /// Force by the law.
        tangential_n: f64,
        /// As given.
        speed_m_min: f64,
        /// As given.
        depth_mm: f64,
    },
}

/// Why coefficients are not a valid law.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum LawError {
    /// A number is not finite or out of range.
    #[error("{name} is {}: give a number from {min} to {max}", plain(*.value))]
    Number {
        /// The coefficient.
        name: &'static str,
        /// As given.
        value: f64,
        /// Minimum.
        min: f64,
        /// Maximum.
        max: f64,
    },
    /// The rational law has a pole at this rake angle, at any feed.
    #[error(
        "at a rake angle of {rake_deg} degrees the force law has a pole: (f k5)^2 is {ratio} times 4 g k6 \
         and must be below 1; choose another rake angle or law"
    )]
    Pole {
        /// As given.
        rake_deg: f64,
        /// `(f k5)^2 / (4 g k6)`.
        ratio: f64,
    },
    /// The factor of the lead angle is not positive.
    #[error(
        "at a lead angle of {lead_deg} degrees the force law's factor is {factor}: it holds for smaller \
         angles"
    )]
    Lead {
        /// As given.
        lead_deg: f64,
        /// The factor.
        factor: f64,
    },
    /// An axis of a table does not increase, or is too short or too long.
    #[error("the table's axis {axis} must have 1 to 200 rising, positive entries; entry {entry} is {}", plain(*.value))]
    Axis {
        /// Name of the axis.
        axis: &'static str,
        /// Index of the entry, from 0.
        entry: usize,
        /// The entry.
        value: f64,
    },
    /// An axis of a table has one entry, and no exponent for other values.
    #[error("the table has one entry along {axis}: add the exponent {axis}_exponent")]
    NoExponent {
        /// Name of the axis.
        axis: &'static str,
    },
    /// The numbers of forces do not match the axes.
    #[error(
        "the table needs force_n as {feeds} lists (feeds) of {depths} lists (depths) of {speeds} forces \
         (speeds)"
    )]
    Shape {
        /// Entries along the feed.
        feeds: usize,
        /// Entries along the depth.
        depths: usize,
        /// Entries along the speed.
        speeds: usize,
    },
}
