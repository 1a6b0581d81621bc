//! What can keep a plan from being made.

use thiserror::Error;

/// Why there is no new plan. Whatever it is, the plan before stays valid and ends at rest on known path.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum FeedError {
    /// The place to start from is not on known path, or not before the end of the window.
    #[error(
        "the plan would start at interval {interval}, offset {x}, outside the known intervals {first}..{until}: start on known path"
    )]
    Place {
        /// The interval given.
        interval: u64,
        /// The offset given.
        x: f64,
        /// The first interval that is still known.
        first: u64,
        /// The end of the window.
        until: u64,
    },
    /// The window holds more intervals than one re-plan may.
    #[error("the window holds {intervals} intervals, of which {most} may be planned at once: end it earlier")]
    Window {
        /// Intervals asked for.
        intervals: u64,
        /// Most that one plan may hold.
        most: u64,
    },
    /// Speed or acceleration at the start, or the feed factor, is no usable number.
    #[error(
        "speed {v}, acceleration {a} and feed factor {factor} are not all finite and in range: give a speed of at least 0 and a factor between 0.001 and 2"
    )]
    State {
        /// Speed of the parameter at the start.
        v: f64,
        /// Acceleration of the parameter at the start.
        a: f64,
        /// Factor on the programmed feeds.
        factor: f64,
    },
    /// No motion within the limits was found from this state: it may be that there is none.
    #[error(
        "found no motion within the limits from speed {v} and acceleration {a} at interval {interval}, offset {x}: keep the plan before, which ends at rest"
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
