//! Errors of planning.

use thiserror::Error;

/// The reason why there is no new plan. The previous plan stays valid and ends at rest on known path.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum FeedError {
    /// The start is not on the known path, or not before the end of the window.
    #[error(
        "the plan would start at interval {interval}, offset {x}, outside the known intervals \
         {first}..{until}: start on known path"
    )]
    PathPosition {
        /// The given interval.
        interval: u64,
        /// The given offset.
        x: f64,
        /// The first known interval.
        first: u64,
        /// The end of the window.
        until: u64,
    },
    /// The window has too many intervals.
    #[error("the window has {intervals} intervals, the maximum is {max}: end it earlier")]
    Window {
        /// Requested number of intervals.
        intervals: u64,
        /// Maximum number of intervals.
        max: u64,
    },
    /// Speed or acceleration at the start, or the feed factor, is out of range.
    #[error(
        "speed {v}, acceleration {a} or feed factor {factor} is out of range: give finite numbers, a speed \
         of at least 0 and a factor from 0.001 to 2"
    )]
    State {
        /// Speed of the parameter at the start.
        v: f64,
        /// Acceleration of the parameter at the start.
        a: f64,
        /// Factor on the programmed feeds.
        factor: f64,
    },
    /// No motion within the limits was found from this state; there may be none.
    #[error(
        "no motion within the limits was found from speed {v} and acceleration {a} at interval {interval}, \
         offset {x}: keep the previous plan, which ends at rest"
    )]
    NoMotion {
        /// The interval of the start.
        interval: u64,
        /// The offset of the start.
        x: f64,
        /// Speed of the parameter at the start.
        v: f64,
        /// Acceleration of the parameter at the start.
        a: f64,
    },
}
