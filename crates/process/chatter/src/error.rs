//! Errors of predictions.

use evolvent_config::plain;
use evolvent_cutting::ForceError;
use thiserror::Error;

/// Why a case cannot be computed. A result that the model cannot give is not an error: see
/// [`crate::StabilityVerdict`].
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum ChatterError {
    /// A number is not finite or out of range.
    #[error("{name} is {}: give a number from {min} to {max}", plain(*.value))]
    Number {
        /// Name.
        name: &'static str,
        /// As given.
        value: f64,
        /// Minimum.
        min: f64,
        /// Maximum.
        max: f64,
    },
    /// The cutting speed is not above the speed below which the force law is not trusted.
    #[error(
        "the cutting speed of {speed_m_min} m/min is not above the {floor_m_min} m/min from which the force \
         law holds: raise the speed"
    )]
    BelowFloor {
        /// As given.
        speed_m_min: f64,
        /// As given.
        floor_m_min: f64,
    },
    /// The force law has no force.
    #[error(transparent)]
    Force(#[from] ForceError),
    /// No steady cut was found, because the tool bends too far.
    #[error(
        "no steady cut found: at {depth_mm} mm depth the tool is pushed out of the cut; give a smaller \
         depth or a stiffer tool"
    )]
    NoEquilibrium {
        /// As given.
        depth_mm: f64,
    },
    /// The published least squares use one force law only.
    #[error(
        "the least squares of the source take the radial force in proportion to the tangential one: leave \
         out force.radial_law for them"
    )]
    RadialLaw,
    /// The integration in time needs steps that are too small, or too many of them.
    #[error(
        "integration stopped at {time_s} s after {steps} steps: the motion is out of the model; give a \
         smaller disturbance or a looser tolerance"
    )]
    Integration {
        /// Time reached.
        time_s: f64,
        /// Steps taken.
        steps: usize,
    },
    /// The delay equation takes too long.
    #[error(
        "the delay equation is not solved: {waves:.0} waves of the fastest mode pass while a tooth cuts, \
         too many for {modes} modes; give a higher speed or fewer modes, or take the zero order"
    )]
    TooManyWaves {
        /// Waves of the fastest mode in the cut of one tooth period.
        waves: f64,
        /// Modes of both axes.
        modes: usize,
    },
    /// The limit of the delay equation is uncertain.
    #[error(
        "the delay equation has no certain limit: {waves:.0} waves of the fastest mode pass while a tooth \
         cuts, which it cannot tell apart from rounding; take the zero order"
    )]
    Unresolved {
        /// Waves of the fastest mode in the cut of one tooth period.
        waves: f64,
    },
    /// The limit of the delay equation is meaningless.
    #[error(
        "the delay equation has no limit of use: below it a disturbance may grow {growth:.0e} times before \
         it dies out; give a higher speed"
    )]
    Growth {
        /// Upper bound of the growth.
        growth: f64,
    },
    /// Newton's method found no cycle near the given one.
    #[error("no cycle near {amplitude_mm:.4} mm and {frequency_hz:.2} Hz: give more harmonics")]
    NoCycle {
        /// Amplitude at the start of the search.
        amplitude_mm: f64,
        /// Frequency at the start of the search.
        frequency_hz: f64,
    },
}

pub(crate) fn number(name: &'static str, value: f64, min: f64, max: f64) -> Result<(), ChatterError> {
    // No range contains NaN.
    if (min..=max).contains(&value) {
        return Ok(());
    }
    Err(ChatterError::Number {
        name,
        value,
        min,
        max,
    })
}
