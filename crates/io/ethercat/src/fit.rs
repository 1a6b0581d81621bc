//! Comparison of a network with a machine.

use evolvent_drive::InterpolationTime;
use evolvent_machine::{ControlRate, HomingMethod, HomingSettings, Machine, PeriodError, SignalKind};
use evolvent_path::AxisLetter;
use thiserror::Error;

use crate::network::{Network, NetworkDevice};
use crate::signal::{Channel, ChannelForm, NetworkOutput, OutputSource};

/// Maximum increments per second: the velocity offset (60B1h) holds twice as many.
const MAX_INCREMENTS_PER_S: f64 = 1e9;
/// Rates that drives usually have, Hz.
const USUAL_RATES_HZ: [u32; 5] = [250, 500, 1000, 2000, 4000];

/// Why a network does not match a machine.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum FitError {
    /// The file is as a scan wrote it.
    #[error(
        "`unchecked` is true: the axes have guessed values; check increments, gear, turn and direction of \
         each, then remove that line"
    )]
    Unchecked,
    /// A device drives an axis that the machine does not have.
    #[error(
        "a device drives {letter}, which the machine file does not have: remove it, or add the axis there"
    )]
    NoAxis {
        /// The axis.
        letter: char,
    },
    /// An axis has no device.
    #[error("no device drives {letter}: add one with this axis, because the core uses one drive bridge")]
    NoDevice {
        /// The axis.
        letter: char,
    },
    /// The drive's increments are coarser than the machine's.
    #[error(
        "the drive of {letter} has {drive} increments per unit, the machine file {machine}: lower \
         increments_per_mm or increments_per_degree there"
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
        "the travel of {letter} takes {increments:.0} increments of its drive, of which 32 bits hold \
         4294967296: choose fewer increments per turn in the drive"
    )]
    Travel {
        /// The axis.
        letter: char,
        /// Increments.
        increments: f64,
    },
    /// The maximum velocity exceeds the drive's units.
    #[error(
        "{letter} at its largest velocity takes {increments:.0} increments per second, more than 10^9: \
         choose fewer increments per turn in the drive"
    )]
    Velocity {
        /// The axis.
        letter: char,
        /// Increments per second.
        increments: f64,
    },
    /// Object 60C2h cannot hold the period of the machine file's rate.
    #[error(
        "the drives cannot be set to the period of the machine file, {period_ns} ns ({rate}): object 60C2h \
         holds a whole number from 1 to 255 times a power of ten seconds; write rate = {usual_hz} there"
    )]
    Period {
        /// The rate as the machine file gives it.
        rate: String,
        /// Its period, ns.
        period_ns: u64,
        /// The next usual rate that is not slower, Hz.
        usual_hz: u32,
    },
    /// The rate of the machine is invalid.
    #[error(transparent)]
    Rate(#[from] PeriodError),
    /// Both the core and the drive would home it.
    #[error(
        "{letter} is homed by its drive and also by the core: write method = \"absolute\" in its [[homing]] \
         of the machine file, or remove [device.axis.homing] here"
    )]
    HomedTwice {
        /// The axis.
        letter: char,
    },
    /// The machine file homes an axis by the index pulse, which its drive does not latch.
    #[error(
        "{letter} is homed by the index pulse of its encoder in the machine file, but its drive latches \
         none: give index_probe, the touch probe that latches the zero impulse"
    )]
    NoIndex {
        /// The axis.
        letter: char,
    },
    /// A device has a signal that the machine does not have.
    #[error(
        "device `{device}` has the {direction} `{name}`, which the machine file does not have: check the \
         name, or add [[{direction}]] there"
    )]
    NoSignal {
        /// The device.
        device: String,
        /// `input` or `output`.
        direction: &'static str,
        /// Name of the signal, or `spindle` with its number.
        name: String,
    },
    /// One file has a digital signal and the other an analog one.
    #[error(
        "device `{device}`: the {direction} `{name}` is {machine} in the machine file; an entry with \
         `values` is analog, one without is digital"
    )]
    SignalKind {
        /// The device.
        device: String,
        /// `input` or `output`.
        direction: &'static str,
        /// Name of the signal.
        name: String,
        /// Kind in the machine file.
        machine: &'static str,
    },
    /// The machine file permits more than the channel provides.
    #[error(
        "device `{device}`: the output `{name}` may be {asked} in the machine file, but its channel supports \
         {least} to {most}: set min and max there, or `raw` and `values` here"
    )]
    SignalRange {
        /// The device.
        device: String,
        /// Name of the signal, or `spindle` with its number.
        name: String,
        /// The permitted value.
        asked: f64,
        /// Lowest value of the channel.
        least: f64,
        /// Highest value of the channel.
        most: f64,
    },
}

/// Compares axes, resolution, travel, velocity and the period of both files, and signals: those of the
/// network file exist in the machine file, with the same kind, and analog outputs reach every value that
/// programs may request.
///
/// # Errors
/// The first difference.
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
        let mut drives = driven
            .clone()
            .filter(|axis| axis.axis == listed.letter.index())
            .peekable();
        if drives.peek().is_none() {
            return Err(FitError::NoDevice { letter });
        }
        for axis in drives {
            // Once its drive has homed, it is equivalent to one with an absolute encoder.
            let by_core = |homing: &HomingSettings| {
                homing.axis == listed.letter && homing.method != HomingMethod::Absolute
            };
            if axis.homing.is_some() && machine.homing.iter().any(by_core) {
                return Err(FitError::HomedTwice { letter });
            }
            let by_index = machine.homing.iter().any(|homing| {
                let is_index = matches!(
                    homing.method,
                    HomingMethod::Index { .. } | HomingMethod::SwitchThenIndex { .. }
                );
                homing.axis == listed.letter && is_index
            });
            if by_index && axis.gantry.is_none() && axis.index_probe.is_none() {
                return Err(FitError::NoIndex { letter });
            }
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
            // The counts of an unlimited axis wrap around, and are tracked.
            if listed.unlimited.is_none() && travel > f64::from(u32::MAX) {
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
    }
    check_period(machine)?;
    for device in &network.devices {
        if let Some(spindle) = device.spindle
            && machine.signals.spindle(spindle.number as u32).is_none()
        {
            return Err(FitError::NoSignal {
                device: device.name.clone(),
                direction: "spindle",
                name: format!("spindle {}", spindle.number),
            });
        }
        check_inputs(machine, device)?;
        for output in &device.outputs {
            check_output(machine, device, output)?;
        }
    }
    Ok(())
}

/// Checks whether the drives can use the period of the machine file. `serve --rate` may choose another, which
/// each session checks.
fn check_period(machine: &Machine) -> Result<(), FitError> {
    let period_ns = machine.period_ns(machine.rate)?;
    if InterpolationTime::from_period_ns(period_ns).is_ok() {
        return Ok(());
    }
    let is_enough = |hz: &&u32| u64::from(**hz) * period_ns >= 1_000_000_000;
    let [.., fastest] = USUAL_RATES_HZ;
    Err(FitError::Period {
        rate: match machine.rate {
            ControlRate::Rational => "rate = \"rational\"".to_owned(),
            ControlRate::Hz(hz) => format!("rate = {hz}"),
        },
        period_ns,
        usual_hz: USUAL_RATES_HZ.iter().find(is_enough).copied().unwrap_or(fastest),
    })
}

/// Notes about a valid pair of files: a probe that no drive reports, axes that only their drives home, and
/// spindles that are measured according to only one of the files.
#[must_use]
pub fn fit_notes(machine: &Machine, network: &Network) -> Vec<String> {
    let mut notes = Vec::new();
    let drives = || network.devices.iter().filter_map(|device| device.axis);
    if machine.signals.probe.is_none() {
        // A drive's report is not used.
    } else if !drives().any(|axis| axis.touch_probe) {
        notes.push(
            "the machine file has [probe], and no drive of the network file has touch_probe = true: G38 \
             ends with an error unless another bridge reports the probe"
                .to_owned(),
        );
    } else if !drives().any(|axis| axis.probe_input_bit.is_some()) {
        notes.push(
            "the machine file has [probe], and no drive of the network file has probe_input_bit, so whether \
             the probe is open is unknown: G38 ends with an error unless another bridge reports it; give \
             the bit of 60FDh to an axis whose drive has the probe"
                .to_owned(),
        );
    }
    for listed in &machine.axes {
        let mut drives = network.devices.iter().filter_map(|device| device.axis);
        let is_homed_by_drive = drives
            .any(|axis| axis.axis == listed.letter.index() && axis.homing.is_some() && axis.gantry.is_none());
        if is_homed_by_drive && !machine.homing.iter().any(|homing| homing.axis == listed.letter) {
            let letter = listed.letter.letter();
            notes.push(format!(
                "{letter} is homed by its drive and has no [[homing]] in the machine file: its coordinates \
                 jump when the drive finds its zero, and the core no longer counts it as homed; write \
                 [[homing]] with axis = \"{letter}\" and method = \"absolute\""
            ));
        }
    }
    for device in &network.devices {
        let is_drive = device.is_drive();
        let brake = device.outputs.iter().find(|output| output.channel.bit == 0);
        if let Some(output) = brake.filter(|_| is_drive) {
            let what = match &output.source {
                OutputSource::Named(name) => format!("the output `{name}`"),
                OutputSource::Function(..) => "an output".to_owned(),
            };
            notes.push(format!(
                "device `{}`: {what} is bit 0 of 60FEh, which CiA 402 gives to the holding brake: the drive \
                 no longer sets it by itself; see its manual for which state releases it",
                device.name
            ));
        }
    }
    for listed in &machine.signals.spindles {
        let number = listed.number;
        let mut drives = network.devices.iter().filter_map(|device| device.spindle);
        let drive = drives.find(|spindle| spindle.number == number as usize);
        notes.extend(match (listed.has_feedback(), drive) {
            (true, None) => Some(format!(
                "spindle {number} has feedback = true in the machine file and no [device.spindle] in the \
                 network file: threads, M19 and every feed after M3 wait for another bridge that measures it"
            )),
            (false, Some(_)) => Some(format!(
                "spindle {number} is measured by its drive, but the measurement is not used: write feedback \
                 = true at its [[spindle]] in the machine file"
            )),
            (true, Some(drive)) if !drive.knows_angle() => Some(format!(
                "spindle {number} has neither index_probe nor absolute_zero: its speed is measured, but its \
                 angle is not known, and threads and M19 are rejected"
            )),
            (true, Some(drive)) if drive.orientation.is_none() => Some(format!(
                "spindle {number}: M19 is not possible, because nothing turns it to an angle (orientation)"
            )),
            _ => None,
        });
    }
    notes
}

const fn kind(channel: &Channel) -> SignalKind {
    if channel.is_analog() {
        SignalKind::Analog
    } else {
        SignalKind::Digital
    }
}

fn check_inputs(machine: &Machine, device: &NetworkDevice) -> Result<(), FitError> {
    for input in &device.inputs {
        let listed = machine
            .signals
            .inputs
            .iter()
            .find(|listed| listed.name == input.name);
        let listed = listed.map(|listed| listed.kind);
        check_kind(device, "input", &input.name, listed, kind(&input.channel))?;
    }
    Ok(())
}

/// Whether the machine file has a signal of this name and of the kind of its channel.
fn check_kind(
    device: &NetworkDevice,
    direction: &'static str,
    name: &str,
    listed: Option<SignalKind>,
    of_channel: SignalKind,
) -> Result<(), FitError> {
    let (device, name) = (device.name.clone(), name.to_owned());
    match listed {
        None => Err(FitError::NoSignal {
            device,
            direction,
            name,
        }),
        Some(listed) if listed != of_channel => Err(FitError::SignalKind {
            device,
            direction,
            name,
            machine: listed.name(),
        }),
        Some(_) => Ok(()),
    }
}

fn check_output(machine: &Machine, device: &NetworkDevice, output: &NetworkOutput) -> Result<(), FitError> {
    let (name, asked) = match &output.source {
        OutputSource::Named(name) => {
            let listed = machine.signals.outputs.iter().find(|listed| listed.name == *name);
            let of_list = listed.map(|listed| listed.kind);
            check_kind(device, "output", name, of_list, kind(&output.channel))?;
            let asked = listed.map_or([f64::NAN; 3], |listed| {
                [listed.range[0], listed.range[1], listed.safe]
            });
            (name.clone(), asked)
        }
        OutputSource::Function(function, number) if function.is_of_spindle() => {
            let name = format!("spindle {number}");
            match machine.signals.spindle(*number) {
                None => {
                    return Err(FitError::NoSignal {
                        device: device.name.clone(),
                        direction: "output",
                        name,
                    });
                }
                Some(spindle) => (name, [0.0, spindle.max_rpm, 0.0]),
            }
        }
        OutputSource::Function(..) => return Ok(()),
    };
    let ChannelForm::Analog(analog) = output.channel.form else {
        return Ok(());
    };
    let [least, most] = analog.range();
    // Without min and max in the machine file a program may request any value; the channel clamps it.
    let asked = asked
        .into_iter()
        .find(|asked| asked.is_finite() && !(least..=most).contains(asked));
    match asked {
        Some(asked) => Err(FitError::SignalRange {
            device: device.name.clone(),
            name,
            asked,
            least,
            most,
        }),
        None => Ok(()),
    }
}
