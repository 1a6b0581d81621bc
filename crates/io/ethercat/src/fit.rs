//! Whether a network fits a machine.

use evolvent_machine::Machine;
use evolvent_path::AxisLetter;
use thiserror::Error;

use crate::network::Network;

/// Increments a second that fit the velocity offset (60B1h) twice over.
const MAX_INCREMENTS_PER_S: f64 = 1e9;

/// Why a network does not fit a machine.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum FitError {
    /// The file is as a scan wrote it.
    #[error(
        "`unchecked` is true: the axes hold guesses; check increments, gear, turn and direction of each, then remove that line"
    )]
    Unchecked,
    /// A device drives an axis that the machine has not.
    #[error(
        "a device drives {letter}, which the machine file does not have: remove it, or add the axis there"
    )]
    NoAxis {
        /// The axis.
        letter: char,
    },
    /// An axis has no device.
    #[error("no device drives {letter}: add one with this axis, because the core speaks to one bridge")]
    NoDevice {
        /// The axis.
        letter: char,
    },
    /// The drive's increments are coarser than the machine's.
    #[error(
        "the drive of {letter} has {drive} increments per unit, the machine file {machine}: lower increments_per_mm or increments_per_degree there"
    )]
    Coarse {
        /// The axis.
        letter: char,
        /// Increments of the drive.
        drive: f64,
        /// Increments of the machine.
        machine: f64,
    },
    /// The travel does not fit the drive's position.
    #[error(
        "the travel of {letter} takes {increments:.0} increments of its drive, of which 32 bits hold 4294967296: choose fewer increments per turn in the drive"
    )]
    Travel {
        /// The axis.
        letter: char,
        /// Increments.
        increments: f64,
    },
    /// The largest velocity is more than the drive's units hold.
    #[error(
        "{letter} at its largest velocity takes {increments:.0} increments a second, more than 10^9: choose fewer increments per turn in the drive"
    )]
    Velocity {
        /// The axis.
        letter: char,
        /// Increments a second.
        increments: f64,
    },
}

/// Compares axes, resolution, travel and velocity of both files.
///
/// # Errors
/// The first thing that does not fit.
pub fn check_fit(machine: &Machine, network: &Network) -> Result<(), FitError> {
    if network.is_unchecked {
        return Err(FitError::Unchecked);
    }
    let driven = network.devices.iter().filter_map(|device| device.axis);
    for axis in driven.clone() {
        if !machine
            .axes
            .iter()
            .any(|listed| listed.letter.index() == axis.axis)
        {
            let letter = AxisLetter::ALL.iter().find(|letter| letter.index() == axis.axis);
            return Err(FitError::NoAxis {
                letter: letter.map_or('?', |letter| letter.letter()),
            });
        }
    }
    let increments = machine.increments();
    for listed in &machine.axes {
        let letter = listed.letter.letter();
        let Some(axis) = driven.clone().find(|axis| axis.axis == listed.letter.index()) else {
            return Err(FitError::NoDevice { letter });
        };
        let per_unit = axis.scale.per_unit();
        let grid = increments[axis.axis];
        if per_unit < grid {
            return Err(FitError::Coarse {
                letter,
                drive: per_unit,
                machine: grid,
            });
        }
        let travel = per_unit * (listed.travel_max - listed.travel_min);
        if travel > f64::from(u32::MAX) {
            return Err(FitError::Travel {
                letter,
                increments: travel,
            });
        }
        let velocity = per_unit * listed.max_velocity;
        if velocity > MAX_INCREMENTS_PER_S {
            return Err(FitError::Velocity {
                letter,
                increments: velocity,
            });
        }
    }
    Ok(())
}
