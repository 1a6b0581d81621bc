//! The limits that a drive reports, compared with those of its axis or spindle in the machine file.

use core::fmt;

use evolvent_machine::Machine;
use evolvent_path::AxisLetter;
use thiserror::Error;

use crate::network::NetworkDevice;

/// Maximum motor speed (6080h), maximum profile velocity (607Fh), maximum acceleration (60C5h), quick stop
/// deceleration (6085h).
pub(crate) const MOTOR_SPEED: u16 = 0x6080;
pub(crate) const PROFILE_VELOCITY: u16 = 0x607F;
pub(crate) const ACCELERATION: u16 = 0x60C5;
pub(crate) const QUICK_STOP: u16 = 0x6085;
/// Quick stop option (605Ah), and the units of velocities (60A9h) and accelerations (60AAh).
pub(crate) const QUICK_STOP_OPTION: u16 = 0x605A;
pub(crate) const VELOCITY_UNIT: u16 = 0x60A9;
pub(crate) const ACCELERATION_UNIT: u16 = 0x60AA;

/// Time after power off for which the bridge keeps the voltage of an axis that brakes, s.
const VOLTAGE_S: f64 = 2.0;
/// Products of decimal numbers differ in their last digits.
const ROUNDING: f64 = 1.0 + 1e-9;

/// Notation of units in 60A9h and 60AAh: the numerator in bits 16 to 23, the denominator in bits 8 to 15, and
/// in bits 24 to 31 the power of ten.
const TURNS: u8 = 0xB4;
const INCREMENTS: u8 = 0xB5;
const TURNS_PER_MINUTE: u8 = 0xC0;
const PER_SECOND: u8 = 0x03;
const PER_MINUTE: u8 = 0x47;
const PER_SECOND_SQUARED: u8 = 0x57;

/// What a drive reports at start-up; `None` for an object that it lacks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct ReportedLimits {
    pub(crate) motor_speed: Option<u32>,
    pub(crate) profile_velocity: Option<u32>,
    pub(crate) velocity_unit: Option<u32>,
    pub(crate) acceleration: Option<u32>,
    pub(crate) quick_stop: Option<u32>,
    pub(crate) quick_stop_option: Option<u16>,
    pub(crate) acceleration_unit: Option<u32>,
}

/// What a drive moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Driven {
    /// An axis, by its index into X Y Z A B C U V W.
    Axis(usize),
    /// A spindle, by its number.
    Spindle(usize),
}

impl Driven {
    const fn unit(self) -> &'static str {
        match self {
            Self::Spindle(_) => "rpm",
            Self::Axis(axis) if is_rotary(axis) => "degrees/s",
            Self::Axis(_) => "mm/s",
        }
    }
}

const fn is_rotary(axis: usize) -> bool {
    axis < AxisLetter::ALL.len() && AxisLetter::ALL[axis].is_rotary()
}

impl fmt::Display for Driven {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Axis(axis) => write!(f, "{}", AxisLetter::letter_of(*axis)),
            Self::Spindle(number) => write!(f, "spindle {number}"),
        }
    }
}

/// The machine file permits a speed that the motor must not have.
#[derive(Clone, Debug, PartialEq, Error)]
#[error(
    "`{name}`: the machine file permits {driven} {asked} {unit}, the maximum motor speed of the drive \
     (6080h), {motor_rpm} rpm, is {most} {unit}: lower the maximum velocity there, correct gear, turn and \
     increments_per_turn here, or raise 6080h if the motor bears it",
    unit = driven.unit(), asked = short(*.asked), most = short(*.most)
)]
pub struct LimitError {
    /// The device.
    pub name: String,
    /// What it moves.
    pub driven: Driven,
    /// Of the machine file.
    pub asked: f64,
    /// Of the drive, in the same unit.
    pub most: f64,
    /// Object 6080h.
    pub motor_rpm: u32,
}

/// A limit of a drive that is lower than that of the machine file, and of which CiA 402 does not say that it
/// holds for cyclic targets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LimitNote {
    /// What the drive moves.
    pub driven: Driven,
    /// The object: 607Fh, 60C5h or 6085h.
    pub object: u16,
    /// Of the machine file.
    pub asked: f64,
    /// Of the drive, in the same unit.
    pub most: f64,
    /// Maximum velocity in the machine file.
    pub velocity: f64,
}

/// A number with at most three decimals.
fn short(number: f64) -> f64 {
    (number * 1e3).round() / 1e3
}

impl fmt::Display for LimitNote {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { driven, object, .. } = self;
        let [asked, most, velocity] = [self.asked, self.most, self.velocity].map(short);
        let unit = driven.unit();
        write!(f, "drive of {driven}: ")?;
        match *object {
            PROFILE_VELOCITY => write!(
                f,
                "its maximum profile velocity (607Fh) is {most} {unit}, the machine file permits {asked}: \
                 some drives limit cyclic targets by it as well"
            ),
            ACCELERATION => write!(
                f,
                "its maximum acceleration (60C5h) is {most} {unit}2, the machine file permits {asked}: \
                 some drives limit cyclic targets by it as well"
            ),
            _ => {
                let stop_s = self.velocity / self.most;
                write!(
                    f,
                    "its quick stop (6085h) brakes with {most} {unit}2, less than the {asked} of the machine \
                     file: from {velocity} {unit} it takes {stop_s:.2} s"
                )?;
                if stop_s > VOLTAGE_S {
                    write!(f, "; after {VOLTAGE_S} s without power it coasts")?;
                }
                Ok(())
            }
        }
    }
}

/// What the machine file permits a drive.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Permitted {
    driven: Driven,
    velocity: f64,
    /// Not of spindles, whose ramps are their drives'.
    acceleration: Option<f64>,
    /// Turns of the motor per second at one unit of velocity.
    motor_turns: f64,
    increments_per_turn: f64,
    /// The unit of 607Fh per unit of velocity, where the network file gives it.
    drive_unit: Option<f64>,
}

fn permitted(machine: &Machine, device: &NetworkDevice) -> Option<Permitted> {
    if let Some(axis) = device.axis {
        let mut axes = machine.axes.iter();
        let listed = axes.find(|listed| listed.letter.index() == axis.axis)?;
        let increments_per_turn = f64::from(axis.increments_per_turn);
        return Some(Permitted {
            driven: Driven::Axis(axis.axis),
            velocity: listed.max_velocity,
            acceleration: Some(listed.max_acceleration),
            motor_turns: axis.scale.per_unit() / increments_per_turn,
            increments_per_turn,
            drive_unit: None,
        });
    }
    let spindle = device.spindle?;
    let listed = machine.signals.spindle(spindle.number as u32)?;
    let [motor, shaft] = spindle.encoder.gear.map(f64::from);
    Some(Permitted {
        driven: Driven::Spindle(spindle.number),
        velocity: listed.max_rpm,
        acceleration: None,
        motor_turns: motor / shaft / 60.0,
        increments_per_turn: f64::from(spindle.encoder.counts_per_turn),
        drive_unit: Some(spindle.velocity_per_rpm),
    })
}

/// Turns of the motor per second, or per second squared, in one unit of 60A9h or 60AAh. Without these objects
/// the unit is that of the position, by which the network file gives the increments of a turn. `None` for
/// units of the load, which depend on factors that drives understand differently.
fn turns(unit: Option<u32>, increments_per_turn: f64) -> Option<f64> {
    let unit = unit.unwrap_or(0);
    if unit == 0 {
        return Some(1.0 / increments_per_turn);
    }
    let [_, denominator, numerator, power] = unit.to_le_bytes();
    let one = match (numerator, denominator) {
        (INCREMENTS, PER_SECOND | PER_SECOND_SQUARED) => 1.0 / increments_per_turn,
        (TURNS, PER_SECOND | PER_SECOND_SQUARED) => 1.0,
        (TURNS, PER_MINUTE) | (TURNS_PER_MINUTE, PER_SECOND) => 1.0 / 60.0,
        _ => return None,
    };
    Some(one * 10_f64.powi(i32::from(power as i8)))
}

/// Compares the limits of a drive with the machine file. 0 and absent objects limit nothing.
///
/// # Errors
/// The machine file permits a speed above the maximum motor speed.
pub(crate) fn check_limits(
    machine: &Machine,
    device: &NetworkDevice,
    reported: &ReportedLimits,
) -> Result<Vec<LimitNote>, LimitError> {
    let Some(permitted) = permitted(machine, device) else {
        return Ok(Vec::new());
    };
    let Permitted {
        driven,
        velocity,
        motor_turns,
        ..
    } = permitted;
    let is_limit = |limit: &u32| *limit > 0;
    if let Some(motor_rpm) = reported.motor_speed.filter(is_limit) {
        let most = f64::from(motor_rpm) / 60.0 / motor_turns;
        if velocity > most * ROUNDING {
            return Err(LimitError {
                name: device.name.clone(),
                driven,
                asked: velocity,
                most,
                motor_rpm,
            });
        }
    }
    let of_turns = |unit| Some(turns(unit, permitted.increments_per_turn)? / motor_turns);
    let velocity_unit = (permitted.drive_unit)
        .map(|per_unit| 1.0 / per_unit)
        .or_else(|| of_turns(reported.velocity_unit));
    let acceleration_unit = of_turns(reported.acceleration_unit);
    // The other options brake along another ramp, or not at all.
    let uses_ramp = matches!(reported.quick_stop_option, None | Some(2 | 6));
    let quick_stop = reported.quick_stop.filter(|_| uses_ramp);
    let mut notes = Vec::new();
    for (object, limit, unit, asked) in [
        (
            PROFILE_VELOCITY,
            reported.profile_velocity,
            velocity_unit,
            Some(velocity),
        ),
        (
            ACCELERATION,
            reported.acceleration,
            acceleration_unit,
            permitted.acceleration,
        ),
        (QUICK_STOP, quick_stop, acceleration_unit, permitted.acceleration),
    ] {
        let (Some(limit), Some(unit), Some(asked)) = (limit.filter(is_limit), unit, asked) else {
            continue;
        };
        let most = f64::from(limit) * unit;
        if asked > most * ROUNDING {
            notes.push(LimitNote {
                driven,
                object,
                asked,
                most,
                velocity,
            });
        }
    }
    Ok(notes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::Network;

    /// X: 500 mm/s and 5000 mm/s2 on a screw of 5 mm are 6000 rpm and 1000 turns/s2 of 2^20 increments. Z is
    /// 1000/3 mm/s by 3 turns of the motor to 2 of a screw of 5.08 mm: 5905.5 rpm.
    fn checked(device: usize, reported: ReportedLimits) -> Result<Vec<LimitNote>, LimitError> {
        let machine = evolvent_file_tests::shipped("machines/mill-ethercat.toml");
        let machine = Machine::parse(&machine, "mill.toml").expect("a machine");
        let network = evolvent_file_tests::shipped("networks/sim-mill.toml");
        let network = Network::parse(&network, "mill.toml").expect("a network");
        check_limits(&machine, &network.devices[device], &reported)
    }

    fn most(device: usize, reported: ReportedLimits) -> Vec<(u16, f64)> {
        let notes = checked(device, reported).expect("no error");
        notes.iter().map(|note| (note.object, note.most)).collect()
    }

    #[test]
    fn the_speed_of_the_motor_is_no_higher_than_its_maximum() {
        let with = |device, rpm| {
            let motor_speed = Some(rpm);
            checked(
                device,
                ReportedLimits {
                    motor_speed,
                    ..ReportedLimits::default()
                },
            )
        };
        assert_eq!(with(1, 6000), Ok(Vec::new()));
        assert_eq!(with(1, 0), Ok(Vec::new()), "not set");
        assert_eq!(with(0, 1), Ok(Vec::new()), "not a drive");
        let error = with(1, 4800).expect_err("too slow");
        assert_eq!((error.driven, error.asked), (Driven::Axis(0), 500.0));
        assert!((error.most - 400.0).abs() < 1e-9, "{error:?}");
        let text = error.to_string();
        assert!(
            text.starts_with("`x-drive`: the machine file permits X 500 mm/s, the maximum motor speed")
                && text.contains("(6080h), 4800 rpm, is 400 mm/s"),
            "{text}"
        );
        assert_eq!(with(3, 5906), Ok(Vec::new()));
        assert!(with(3, 5905).is_err());
    }

    /// The same limit of 5400 rpm and 900 turns/s2 in each unit.
    #[test]
    fn profile_limits_are_noted_in_the_units_of_the_drive() {
        for (limit, unit) in [
            (94_371_840, None),
            (94_371_840, Some(0)),
            (94_371_840, Some(0x00B5_0300)),
            (5_400, Some(0x00B4_4700)),
            (5_400_000, Some(0xFDB4_4700)),
            (90, Some(0x00B4_0300)),
        ] {
            let reported = ReportedLimits {
                profile_velocity: Some(limit),
                velocity_unit: unit,
                ..ReportedLimits::default()
            };
            let found = most(1, reported);
            assert!(
                matches!(found[..], [(0x607F, most)] if (most - 450.0).abs() < 1e-6),
                "{unit:X?}: {found:?}"
            );
        }
        for (limit, unit) in [
            (943_718_400, None),
            (943_718_400, Some(0x00B5_5700)),
            (54_000, Some(0x00C0_0300)),
            (900, Some(0x00B4_5700)),
        ] {
            let reported = ReportedLimits {
                acceleration: Some(limit),
                quick_stop: Some(limit),
                acceleration_unit: unit,
                ..ReportedLimits::default()
            };
            let found = most(1, reported);
            assert!(
                matches!(found[..], [(0x60C5, one), (0x6085, other)]
                    if (one - 4500.0).abs() < 1e-6 && (other - 4500.0).abs() < 1e-6),
                "{unit:X?}: {found:?}"
            );
        }
        // Millimetres, and enough of everything.
        for (limit, unit) in [(1, Some(0xFD01_0300)), (104_857_600, None), (0, None)] {
            let reported = ReportedLimits {
                profile_velocity: Some(limit),
                velocity_unit: unit,
                ..ReportedLimits::default()
            };
            assert_eq!(most(1, reported), [], "{limit} {unit:X?}");
        }
    }

    #[test]
    fn a_long_quick_stop_is_noted_where_the_drive_uses_its_ramp() {
        let with = |quick_stop_option, turns_s2: u32| {
            let reported = ReportedLimits {
                quick_stop: Some(turns_s2 << 20),
                quick_stop_option,
                ..ReportedLimits::default()
            };
            let notes = checked(1, reported).expect("no error");
            notes.first().map(LimitNote::to_string)
        };
        // 200 turns/s2 are 1000 mm/s2: 0.5 s; 40 are 2.5 s.
        for option in [None, Some(2), Some(6)] {
            let text = with(option, 200).expect("a note");
            assert_eq!(
                text,
                "drive of X: its quick stop (6085h) brakes with 1000 mm/s2, less than the 5000 of the \
                 machine file: from 500 mm/s it takes 0.50 s"
            );
            let text = with(option, 40).expect("a note");
            assert!(
                text.ends_with("2.50 s; after 2 s without power it coasts"),
                "{text}"
            );
        }
        for option in [0, 1, 5] {
            assert_eq!(with(Some(option), 200), None, "{option}");
        }
        assert_eq!(with(None, 1000), None);
    }

    /// 3000 rpm of the spindle by 4500 of the motor; 607Fh in the unit of 60FFh, increments per second.
    #[test]
    fn spindles_are_compared_in_the_unit_of_their_target() {
        let machine = evolvent_file_tests::shipped("machines/lathe-ethercat.toml");
        let machine = Machine::parse(&machine, "lathe.toml").expect("a machine");
        let network = evolvent_file_tests::shipped("networks/sim-lathe.toml");
        let network = network.replacen("gear = [1, 1]", "gear = [3, 2]", 1);
        let network = Network::parse(&network, "lathe.toml").expect("a network");
        let device = network.devices.iter().find(|device| device.spindle.is_some());
        let device = device.expect("a spindle");
        let max_rpm = machine.signals.spindle(0).expect("a spindle").max_rpm;
        let spindle = device.spindle.expect("a spindle");
        assert_eq!(spindle.encoder.gear, [3, 2]);
        let motor_rpm = (max_rpm * 1.5) as u32;
        let with = |motor_speed, profile_velocity| {
            let reported = ReportedLimits {
                motor_speed: Some(motor_speed),
                profile_velocity: Some(profile_velocity),
                ..ReportedLimits::default()
            };
            check_limits(&machine, device, &reported)
        };
        let enough = (f64::from(motor_rpm) / 60.0 * f64::from(spindle.encoder.counts_per_turn)).ceil() as u32;
        assert_eq!(with(motor_rpm, enough), Ok(Vec::new()));
        let error = with(motor_rpm - 3, enough).expect_err("too slow");
        assert!((error.most - (max_rpm - 2.0)).abs() < 1e-9, "{error:?}");
        assert!(error.to_string().contains("permits spindle 0"), "{error}");
        let notes = with(motor_rpm, enough / 2).expect("no error");
        assert!((notes[0].most - max_rpm / 2.0).abs() < 1e-3, "{notes:?}");
    }
}
