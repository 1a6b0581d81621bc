//! Checks that a board file fits a machine file.

use evolvent_drive::SpindleIndex;
use evolvent_machine::{HomingMethod, Machine, SignalKind, SignalSettings};
use evolvent_path::AxisLetter;
use thiserror::Error;

use crate::board_settings::{
    Actuator, BoardAxis, BoardSettings, InputSource, OutputTarget, SpindleOrienting, SpindleSpeed,
};

/// Maximum speed of squaring, as a fraction of the maximum velocity: motors may exceed that velocity by this
/// fraction.
const SQUARE_FRACTION: f64 = 0.2;

/// Why a board file does not fit a machine file.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum FitError {
    /// The board moves an axis that the machine does not have.
    #[error(
        "an entry moves {letter}, which the machine file does not have: remove it, or add the axis there"
    )]
    NoAxis {
        /// The axis.
        letter: char,
    },
    /// Nothing moves an axis.
    #[error(
        "nothing moves {letter}: add an [[axis]] with this letter, because the core uses one drive bridge"
    )]
    NoEntry {
        /// The axis.
        letter: char,
    },
    /// The step timing does not permit the maximum velocity.
    #[error(
        "{letter}: {needed:.0} steps/s needed, {possible:.0} possible: shorten step_length_ns or \
         step_space_ns if the drive permits, use fewer steps per unit, or lower max_velocity in the machine \
         file"
    )]
    StepRate {
        /// The axis.
        letter: char,
        /// Steps/s at the maximum velocity.
        needed: f64,
        /// Steps/s permitted by step length and space.
        possible: f64,
    },
    /// The maximum velocity exceeds that of the drive at full output.
    #[error(
        "{letter}: a velocity of {needed:.3} per second needed, {possible:.3} possible at full output: \
         lower max_velocity in the \
         machine file, or correct full_velocity"
    )]
    FullVelocity {
        /// The axis.
        letter: char,
        /// Value of the machine file.
        needed: f64,
        /// Value of the board file.
        possible: f64,
    },
    /// A beam that is squared faster than the motors can move in addition to the motion of the axis.
    #[error(
        "{letter}: a square_speed of {speed:.3} per second is more than a fifth of max_velocity, {most:.3}: \
         motors move with both at the same time; lower square_speed"
    )]
    SquareSpeed {
        /// The axis.
        letter: char,
        /// Value of the board file.
        speed: f64,
        /// The maximum.
        most: f64,
    },
    /// The machine file homes an axis by the index pulse, and the axis has no encoder.
    #[error(
        "{letter} is homed by the index pulse of its encoder in the machine file, but has a step generator \
         without an encoder: home it by `switch`"
    )]
    NoIndex {
        /// The axis.
        letter: char,
    },
    /// A name that is not in the machine file.
    #[error(
        "`{name}` is not a {kind} {direction} of the machine file: correct the name, or add [[{direction}]] \
         there"
    )]
    NoSignal {
        /// The name.
        name: String,
        /// "digital" or "analog".
        kind: &'static str,
        /// "input" or "output".
        direction: &'static str,
    },
    /// A spindle that is measured, and cannot reach its speed.
    #[error(
        "spindle {number}: max_rpm of the machine file is {needed:.0}, and {possible:.0} possible at full \
         output: lower max_rpm, or correct full_rpm"
    )]
    FullSpeed {
        /// Its number.
        number: usize,
        /// Value of the machine file.
        needed: f64,
        /// Value of the board file.
        possible: f64,
    },
    /// A spindle that is turned to an angle faster than it may turn.
    #[error(
        "spindle {number}: orientation at {speed:.1} rpm is above its max_rpm, {most:.1}: lower \
         orientation.rpm"
    )]
    OrientationSpeed {
        /// Its number.
        number: usize,
        /// Value of the board file.
        speed: f64,
        /// The maximum.
        most: f64,
    },
    /// A spindle that is not in the machine file.
    #[error("spindle {number} is not in the machine file: correct its number, or add [[spindle]] there")]
    NoSpindle {
        /// Its number.
        number: usize,
    },
}

fn letter_of(axis: usize) -> char {
    let letter = AxisLetter::ALL.iter().find(|letter| letter.index() == axis);
    letter.map_or('?', |letter| letter.letter())
}

/// Compares axes, velocities and names of both files.
///
/// # Errors
/// The first mismatch.
pub fn check_fit(machine: &Machine, board: &BoardSettings) -> Result<(), FitError> {
    check_axes(machine, board)?;
    check_signals(&machine.signals, board)?;
    check_spindles(&machine.signals, board)
}

/// Every axis has a motor, and every motor an axis.
fn check_axes(machine: &Machine, board: &BoardSettings) -> Result<(), FitError> {
    for axis in &board.axes {
        if !machine
            .axes
            .iter()
            .any(|listed| listed.letter.index() == axis.axis)
        {
            let letter = letter_of(axis.axis);
            return Err(FitError::NoAxis { letter });
        }
    }
    for listed in &machine.axes {
        let letter = listed.letter.letter();
        let mut motors = board
            .axes
            .iter()
            .filter(|axis| axis.axis == listed.letter.index())
            .peekable();
        if motors.peek().is_none() {
            return Err(FitError::NoEntry { letter });
        }
        let max_velocity = max_velocity(machine, board, listed.letter.index());
        let by_index = machine.homing.iter().any(|homing| {
            let is_index = matches!(
                homing.method,
                HomingMethod::Index { .. } | HomingMethod::SwitchThenIndex { .. }
            );
            homing.axis == listed.letter && is_index
        });
        for motor in motors {
            if by_index && matches!(motor.actuator, Actuator::Steps { .. }) {
                return Err(FitError::NoIndex { letter });
            }
            check_motor(motor, letter, listed.max_velocity, max_velocity)?;
        }
    }
    Ok(())
}

fn check_signals(signals: &SignalSettings, board: &BoardSettings) -> Result<(), FitError> {
    for input in &board.inputs {
        let kind = match input.source {
            InputSource::Pin(_) => SignalKind::Digital,
            InputSource::Encoder { .. } | InputSource::Remote { .. } => SignalKind::Analog,
        };
        let known = signals
            .inputs
            .iter()
            .any(|listed| listed.name == input.name && listed.kind == kind);
        if !known {
            return Err(FitError::NoSignal {
                name: input.name.clone(),
                kind: kind.name(),
                direction: "input",
            });
        }
    }
    for output in &board.outputs {
        let kind = match output.target {
            OutputTarget::Pin(_) => SignalKind::Digital,
            OutputTarget::Pwm { .. } => SignalKind::Analog,
        };
        let known = signals
            .outputs
            .iter()
            .any(|listed| listed.name == output.name && listed.kind == kind);
        if !known {
            return Err(FitError::NoSignal {
                name: output.name.clone(),
                kind: kind.name(),
                direction: "output",
            });
        }
    }
    Ok(())
}

fn check_spindles(signals: &SignalSettings, board: &BoardSettings) -> Result<(), FitError> {
    for spindle in &board.spindles {
        let number = spindle.number;
        let Some(listed) = signals.spindle(number as u32) else {
            return Err(FitError::NoSpindle { number });
        };
        let full_rpm = match spindle.speed {
            Some(SpindleSpeed::Pwm { full_rpm, .. } | SpindleSpeed::Remote { full_rpm, .. }) => full_rpm,
            None => f64::INFINITY,
        };
        if spindle.angle.is_some() && full_rpm < listed.max_rpm {
            return Err(FitError::FullSpeed {
                number,
                needed: listed.max_rpm,
                possible: full_rpm,
            });
        }
        if let Some(SpindleOrienting::Loop(settings)) = spindle.orienting
            && settings.max_rpm > listed.max_rpm
        {
            return Err(FitError::OrientationSpeed {
                number,
                speed: settings.max_rpm,
                most: listed.max_rpm,
            });
        }
    }
    Ok(())
}

/// Maximum velocity of the motors of an axis: that of the machine file, plus that of squaring if there are
/// two.
pub(crate) fn max_velocity(machine: &Machine, board: &BoardSettings, axis: usize) -> f64 {
    let listed = machine.axes.iter().find(|listed| listed.letter.index() == axis);
    let mut motors = board.axes.iter().filter(|motor| motor.axis == axis);
    let squaring = motors.find_map(|motor| motor.gantry);
    listed.map_or(0.0, |listed| listed.max_velocity) + squaring.map_or(0.0, |gantry| gantry.square_velocity)
}

/// Checks that a motor of an axis reaches `needed`, which is `max_velocity` of the machine file plus the
/// velocity of squaring.
fn check_motor(motor: &BoardAxis, letter: char, max_velocity: f64, needed: f64) -> Result<(), FitError> {
    if let Some(gantry) = motor.gantry
        && gantry.square_velocity > SQUARE_FRACTION * max_velocity
    {
        return Err(FitError::SquareSpeed {
            letter,
            speed: gantry.square_velocity,
            most: SQUARE_FRACTION * max_velocity,
        });
    }
    match motor.actuator {
        Actuator::Steps { timing, .. } => {
            let needed = motor.per_unit * needed;
            let possible = 1e9 / (timing.length_ns + timing.space_ns);
            if needed > possible {
                return Err(FitError::StepRate {
                    letter,
                    needed,
                    possible,
                });
            }
        }
        Actuator::Servo { full_velocity, .. } => {
            if needed > full_velocity {
                return Err(FitError::FullVelocity {
                    letter,
                    needed,
                    possible: full_velocity,
                });
            }
        }
    }
    Ok(())
}

/// Notes about a valid pair of files: motors that are coarser than the machine's increments, and spindles
/// that are measured according to only one of the files.
#[must_use]
pub fn fit_notes(machine: &Machine, board: &BoardSettings) -> Vec<String> {
    let mut notes = coarse_motors(machine, board);
    if machine.signals.probe.is_some() {
        notes.push(
            "the machine file has [probe], and this bridge has no probe input: G38 ends with an error \
             unless another bridge reports the probe; run one beside this, or remove [probe], so that check \
             and plan refuse G38"
                .to_owned(),
        );
    }
    for listed in &machine.signals.spindles {
        let number = listed.number;
        let spindle = board
            .spindles
            .iter()
            .find(|spindle| spindle.number == number as usize);
        let angle = spindle.and_then(|spindle| spindle.angle);
        notes.extend(match (listed.has_feedback(), angle) {
            (true, None) => Some(format!(
                "spindle {number} has feedback = true in the machine file and no encoder in the board file: \
                 threads, M19 and every feed after M3 wait for another bridge that measures it; give encoder \
                 and counts_per_rev at its [[spindle]]"
            )),
            (false, Some(_)) => Some(format!(
                "spindle {number} has an encoder in the board file, but it is not used: write feedback = \
                 true at its [[spindle]] in the machine file"
            )),
            (true, Some(angle)) if angle.settings.index == SpindleIndex::None => Some(format!(
                "spindle {number} has index = \"none\": its speed is measured, but its angle is not known, \
                 and threads and M19 are rejected"
            )),
            (true, Some(angle)) if angle.settings.index == SpindleIndex::PerEncoderTurn => Some(format!(
                "spindle {number} has its index on an encoder behind a gear: after a restart of the bridge a \
                 thread that was begun before may not be matched again"
            )),
            _ => None,
        });
        if let Some(spindle) = spindle
            && angle.is_some()
            && listed.has_feedback()
            && spindle.knows_angle()
            && spindle.orienting.is_none()
        {
            notes.push(format!(
                "spindle {number}: M19 is not possible, because nothing turns it to an angle (orientation, \
                 or orient and oriented)"
            ));
        }
    }
    notes
}

fn coarse_motors(machine: &Machine, board: &BoardSettings) -> Vec<String> {
    let increments = machine.increments();
    let coarse = board
        .axes
        .iter()
        .filter(|axis| axis.per_unit < increments[axis.axis]);
    coarse
        .map(|axis| {
            format!(
                "{}: the motor has {} steps or counts per unit, the machine file {} increments: finer \
                 positions are between two steps",
                letter_of(axis.axis),
                axis.per_unit,
                increments[axis.axis]
            )
        })
        .collect()
}
