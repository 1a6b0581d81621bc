//! The elements of a plan, and its report.

use crate::time_law::TimeLaw;

/// A part of the time law, contiguous with its neighbours; the last one ends at rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimeLawPiece {
    /// The parameter as a function of time.
    pub law: TimeLaw,
    /// Length in parameter units.
    pub length: f64,
    /// Duration in s.
    pub duration_s: f64,
    /// Absolute index of its segment.
    pub segment: u64,
    /// Offset of its start from the start of the segment.
    pub from: f64,
    /// Absolute index of its grid interval.
    pub interval: u64,
}

/// How a plan starts.
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

/// How a plan ends: always at rest at the end of its window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exit {
    /// The motion stops there, as fast as the limits permit.
    Rest,
    /// More path will follow: the last interval is passed gently enough for the motion to continue instead.
    Open,
}

/// Maximum ratios of the motion of an axis to its limit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ratios {
    /// Velocity of an axis, or feed.
    pub velocity: f64,
    /// Acceleration.
    pub acceleration: f64,
    /// Jerk.
    pub jerk: f64,
}

/// Report of a plan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanReport {
    /// Newton steps.
    pub iterations: u32,
    /// Upper bound of the relative excess of the duration over the optimum on the same stations, from the
    /// barrier parameter (exact for a convex problem).
    pub gap: f64,
    /// Duration in s.
    pub duration_s: f64,
    /// Number of stations of the window.
    pub stations: usize,
    /// Whether the previous plan served as a warm start.
    pub warm: bool,
    /// Maximum ratios found by the check between stations.
    pub worst: Ratios,
}
