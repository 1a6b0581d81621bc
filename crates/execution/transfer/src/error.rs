//! Why a transfer cannot be made.

use std::fmt;

use evolvent_path::AxisLetter;

/// Which of the two states of a transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TransferEnd {
    /// Where it begins.
    Start,
    /// Where it ends.
    Target,
}

impl fmt::Display for TransferEnd {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Start => "start",
            Self::Target => "target",
        })
    }
}

/// The quantity of a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// mm or degrees.
    Position,
    /// Per s.
    Velocity,
    /// Per s2.
    Acceleration,
    /// Per s3.
    Jerk,
}

impl fmt::Display for Quantity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Position => "position",
            Self::Velocity => "velocity",
            Self::Acceleration => "acceleration",
            Self::Jerk => "jerk",
        })
    }
}

/// Why a transfer cannot be made. Numbers in mm (degrees for rotary axes) and s.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum TransferError {
    /// A limit is not a usable number.
    #[error(
        "the {quantity} limit of axis {} is {value}; it must be a number above 0 (1e-6 to 1e12)", .axis.letter()
    )]
    Limit {
        /// The axis.
        axis: AxisLetter,
        /// Which limit.
        quantity: Quantity,
        /// Its value.
        value: f64,
    },
    /// A number of a state is not finite.
    #[error("the {end} {quantity} of axis {} is {value}; give a finite number", .axis.letter())]
    NotFinite {
        /// The axis.
        axis: AxisLetter,
        /// Start or target.
        end: TransferEnd,
        /// Which number.
        quantity: Quantity,
        /// Its value.
        value: f64,
    },
    /// An axis moves that the machine does not have.
    #[error("the machine has no axis {}, but it is to move; leave its position and keep it at rest", .axis.letter())]
    NoSuchAxis {
        /// The axis.
        axis: AxisLetter,
    },
    /// A state exceeds a limit, or must exceed it immediately afterwards.
    #[error(
        "axis {} at the {end} has a {quantity} of {value}, beyond its limit of {limit}; \
         slow down first, or choose a slower target", .axis.letter()
    )]
    BeyondLimit {
        /// The axis.
        axis: AxisLetter,
        /// Start or target.
        end: TransferEnd,
        /// The quantity that is too large.
        quantity: Quantity,
        /// Its value; for velocity, including the speed that the present acceleration adds.
        value: f64,
        /// The limit.
        limit: f64,
    },
    /// A position is outside the travel.
    #[error(
        "axis {} at the {end} is at {position}, outside its travel of {min} to {max}; choose another \
         position",
        .axis.letter()
    )]
    OutsideTravel {
        /// The axis.
        axis: AxisLetter,
        /// Start or target.
        end: TransferEnd,
        /// The position.
        position: f64,
        /// Lowest position of the travel.
        min: f64,
        /// Highest position of the travel.
        max: f64,
    },
    /// Every move that was found between the two states leaves the travel.
    #[error(
        "on its way axis {} would go to {position}, outside its travel of {min} to {max}: it is too fast to \
         reverse before that; start at a lower velocity or further inside", .axis.letter()
    )]
    LeavesTravel {
        /// The axis.
        axis: AxisLetter,
        /// The farthest position.
        position: f64,
        /// Lowest position of the travel.
        min: f64,
        /// Highest position of the travel.
        max: f64,
    },
    /// A straight line was requested, but the axes do not move along it at the start or at the target.
    #[error(
        "axis {} does not move along the straight line at the {end}: its {quantity} is off by {off}; \
         stop first, or do without the straight line", .axis.letter()
    )]
    NotStraight {
        /// The axis.
        axis: AxisLetter,
        /// Start or target.
        end: TransferEnd,
        /// Velocity or acceleration.
        quantity: Quantity,
        /// The deviation.
        off: f64,
    },
    /// Axes that move independently arrive at different times, so they cannot be moving at the target.
    #[error(
        "without synchronisation axes arrive at different times, so all must end at rest, but axis {} is to \
         end at velocity {velocity} and acceleration {acceleration}; synchronise in time", .axis.letter()
    )]
    ArrivesMoving {
        /// The axis.
        axis: AxisLetter,
        /// Its velocity at the target.
        velocity: f64,
        /// Its acceleration at the target.
        acceleration: f64,
    },
    /// Neither the move of ruckig nor the one that replaces it could be verified.
    #[error(
        "no move within the limits was found: that of axis {} reaches a {quantity} of {value} (limit \
         {limit}); please report these states and limits, and stop first", .axis.letter()
    )]
    Unsolved {
        /// The axis that failed.
        axis: AxisLetter,
        /// The quantity that exceeds its limit.
        quantity: Quantity,
        /// Its maximum.
        value: f64,
        /// Its limit.
        limit: f64,
    },
}
