//! What a plan is made of, and what is said of it.

use crate::time_law::TimeLaw;

/// A part of the time law: contiguous with its neighbours, the last one ends at rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Piece {
    /// How the parameter runs.
    pub law: TimeLaw,
    /// Length in parameter units.
    pub length: f64,
    /// Duration in s.
    pub duration: f64,
    /// Absolute index of the stretch that it lies in.
    pub stretch: u64,
    /// Offset of its start from the stretch's.
    pub from: f64,
    /// Absolute index of its grid interval.
    pub interval: u64,
}

/// How a plan begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Entry {
    /// At rest.
    Rest,
    /// Moving with this speed and acceleration of the parameter.
    Moving {
        /// Speed, per s.
        v: f64,
        /// Acceleration, per s2.
        a: f64,
    },
}

/// How a plan ends: always at rest at the very end of its window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exit {
    /// The motion is meant to rest there: as fast as the limits allow.
    Rest,
    /// More path will follow: the last interval is gone through gently enough for the motion to go on instead.
    Open,
}

/// The largest ratio of what an axis does to its limit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ratios {
    /// Velocity of an axis, or of the feed.
    pub velocity: f64,
    /// Acceleration.
    pub acceleration: f64,
    /// Jerk.
    pub jerk: f64,
}

/// What a plan came to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanReport {
    /// Newton steps.
    pub iterations: u32,
    /// By what share of its duration the plan may at most be slower than the optimum on its stations, as the
    /// barrier's parameter tells (exact for a convex problem).
    pub gap: f64,
    /// Seconds.
    pub duration: f64,
    /// Stations of the window.
    pub stations: usize,
    /// Whether the last plan served as the start.
    pub warm: bool,
    /// The largest ratios found by the check between stations.
    pub worst: Ratios,
}
