//! An axis of the board file: a step generator, or an encoder and a PWM generator.

use evolvent_bridge::{GantryFile, axis_letter};
use evolvent_config::{ConfigDocument, ConfigError};
use schemars::JsonSchema;
use serde::Deserialize;

use super::MAX_UNITS;
use super::pins::PinFile;
use crate::board_settings::{Actuator, BoardAxis, Gains, StepTiming};

/// Maximum time of a step generator: 14 bits of 10 ns.
const MAX_TIME_NS: f64 = 163_830.0;

/// An axis.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct AxisFile {
    /// Letter of the axis in the machine file.
    pub(super) letter: String,
    /// A stepper: number of the step generator.
    #[schemars(range(max = 15))]
    pub(super) stepgen: Option<u32>,
    /// Steps a mm; of a rotary axis steps a degree.
    #[serde(rename = "steps_per_unit")]
    pub(super) steps: Option<f64>,
    /// How long a step pulse is, ns.
    pub(super) step_length_ns: Option<f64>,
    /// Shortest time between two step pulses, ns.
    pub(super) step_space_ns: Option<f64>,
    /// How long the direction stands before a step, ns.
    pub(super) direction_setup_ns: Option<f64>,
    /// How long the direction stands after a step, ns.
    pub(super) direction_hold_ns: Option<f64>,
    /// A servo: number of the encoder.
    #[schemars(range(max = 15))]
    pub(super) encoder: Option<u32>,
    /// Counts a mm (four to a line); of a rotary axis counts a degree.
    #[serde(rename = "counts_per_unit")]
    pub(super) counts: Option<f64>,
    /// The index pulse of the encoder is low: its falling edge is the pulse, not its rising one.
    #[serde(default)]
    pub(super) index_inverted: bool,
    /// Number of the PWM generator (or analog output) that gives the drive its velocity.
    #[schemars(range(max = 15))]
    pub(super) pwm: Option<u32>,
    /// Velocity at full output, mm/s; of a rotary axis degrees/s.
    pub(super) full_velocity: Option<f64>,
    /// Proportional gain of the position loop, 1/s.
    pub(super) p_gain: Option<f64>,
    /// Integral gain, 1/s2.
    #[serde(default)]
    pub(super) i_gain: f64,
    /// Derivative gain.
    #[serde(default)]
    pub(super) d_gain: f64,
    /// The motor turns against the axis.
    #[serde(default)]
    pub(super) inverted: bool,
    /// The machine coordinate at which the axis stands when the board is set up, until it is homed.
    #[serde(default)]
    pub(super) zero: f64,
    /// Output that switches the drive on.
    pub(super) enable: Option<PinFile>,
    /// Input by which the drive reports a fault.
    pub(super) fault: Option<PinFile>,
    /// Home switch.
    pub(super) home_switch: Option<PinFile>,
    /// Limit switch at the negative end.
    pub(super) negative_limit: Option<PinFile>,
    /// Limit switch at the positive end.
    pub(super) positive_limit: Option<PinFile>,
    /// This is the second motor of a gantry: another entry without it moves the same axis.
    pub(super) gantry: Option<GantryFile>,
}

impl AxisFile {
    /// Checks all axes, each alone and as the motors of gantries.
    pub(super) fn check_all(
        listed: &[Self],
        sheet: &ConfigDocument<'_>,
    ) -> Result<Vec<BoardAxis>, ConfigError> {
        let mut axes: Vec<BoardAxis> = Vec::new();
        for (i, axis) in listed.iter().enumerate() {
            let key = format!("axis[{i}]");
            let checked = axis.check(sheet, &key)?;
            let is_same = |other: &BoardAxis| {
                other.axis == checked.axis && other.gantry.is_some() == checked.gantry.is_some()
            };
            if axes.iter().any(is_same) {
                return Err(sheet.error(
                    &format!("{key}.letter"),
                    "another entry moves this axis".to_owned(),
                    "give each axis one entry, or make this the second motor of a gantry: [axis.gantry]",
                ));
            }
            axes.push(checked);
        }
        if axes.is_empty() {
            return Err(sheet.error("axis", "no axis is listed".to_owned(), "list each axis: [[axis]]"));
        }
        check_gantries(&axes, sheet)?;
        Ok(axes)
    }

    fn check(&self, sheet: &ConfigDocument<'_>, key: &str) -> Result<BoardAxis, ConfigError> {
        let at = |name: &str| format!("{key}.{name}");
        let letter = axis_letter(sheet, &at("letter"), &self.letter)?;
        let (actuator, per_unit) = match (self.stepgen, self.encoder) {
            (Some(unit), None) => self.check_steps(sheet, key, unit)?,
            (None, Some(encoder)) => self.check_servo(sheet, key, encoder)?,
            _ => {
                return Err(sheet.error(
                    key,
                    "an axis needs either `stepgen` or `encoder`".to_owned(),
                    "give stepgen for step and direction, encoder and pwm for an analog servo",
                ));
            }
        };
        sheet.number(&at("zero"), self.zero, -1e6, 1e6)?;
        let pin = |pin: Option<PinFile>, name: &str| PinFile::check_any(pin, sheet, &at(name));
        Ok(BoardAxis {
            axis: letter.index(),
            actuator,
            per_unit,
            inverted: self.inverted,
            zero: self.zero,
            enable: PinFile::check_driven(self.enable, sheet, &at("enable"))?,
            fault: pin(self.fault, "fault")?,
            switches: [
                pin(self.home_switch, "home_switch")?,
                pin(self.negative_limit, "negative_limit")?,
                pin(self.positive_limit, "positive_limit")?,
            ],
            gantry: match self.gantry {
                Some(gantry) => Some(gantry.check(sheet, &at("gantry"))?),
                None => None,
            },
        })
    }

    /// A step generator, and its steps per unit.
    fn check_steps(
        &self,
        sheet: &ConfigDocument<'_>,
        key: &str,
        unit: u32,
    ) -> Result<(Actuator, f64), ConfigError> {
        let at = |name: &str| format!("{key}.{name}");
        sheet.number(&at("stepgen"), f64::from(unit), 0.0, MAX_UNITS)?;
        let needed = |name: &str, value, minimum, maximum| {
            needed(sheet, key, ("a step generator", name), value, minimum..=maximum)
        };
        let per_unit = needed("steps_per_unit", self.steps, 1e-3, 1e7)?;
        let time = |name: &str, value: Option<f64>| needed(name, value, 20.0, MAX_TIME_NS);
        let timing = StepTiming {
            length_ns: time("step_length_ns", self.step_length_ns)?,
            space_ns: time("step_space_ns", self.step_space_ns)?,
            setup_ns: time("direction_setup_ns", self.direction_setup_ns)?,
            hold_ns: time("direction_hold_ns", self.direction_hold_ns)?,
        };
        if self.index_inverted {
            return Err(sheet.error(
                &at("index_inverted"),
                "a step generator has no index pulse".to_owned(),
                "remove index_inverted",
            ));
        }
        let unit = unit as usize;
        Ok((Actuator::Steps { unit, timing }, per_unit))
    }

    /// An analog servo, and the counts per unit of its encoder.
    fn check_servo(
        &self,
        sheet: &ConfigDocument<'_>,
        key: &str,
        encoder: u32,
    ) -> Result<(Actuator, f64), ConfigError> {
        let at = |name: &str| format!("{key}.{name}");
        sheet.number(&at("encoder"), f64::from(encoder), 0.0, MAX_UNITS)?;
        let needed = |name: &str, value, minimum, maximum| {
            needed(sheet, key, ("an encoder", name), value, minimum..=maximum)
        };
        let per_unit = needed("counts_per_unit", self.counts, 1e-3, 1e7)?;
        let pwm = needed("pwm", self.pwm.map(f64::from), 0.0, MAX_UNITS)? as usize;
        let full_velocity = needed("full_velocity", self.full_velocity, 1e-3, 1e6)?;
        let p = needed("p_gain", self.p_gain, 0.1, 1e4)?;
        sheet.number(&at("i_gain"), self.i_gain, 0.0, 1e6)?;
        sheet.number(&at("d_gain"), self.d_gain, 0.0, 10.0)?;
        let servo = Actuator::Servo {
            encoder: encoder as usize,
            index_rising: !self.index_inverted,
            pwm,
            full_velocity,
            gains: Gains {
                p,
                i: self.i_gain,
                d: self.d_gain,
            },
        };
        Ok((servo, per_unit))
    }
}

/// A value that this actuator needs, within its range.
fn needed(
    sheet: &ConfigDocument<'_>,
    key: &str,
    (actuator, name): (&str, &str),
    value: Option<f64>,
    range: core::ops::RangeInclusive<f64>,
) -> Result<f64, ConfigError> {
    let value =
        value.ok_or_else(|| sheet.error(key, format!("{actuator} needs {name}"), format!("give {name}")))?;
    sheet.number(&format!("{key}.{name}"), value, *range.start(), *range.end())?;
    Ok(value)
}

/// Checks that the two motors of each gantry belong together.
fn check_gantries(axes: &[BoardAxis], sheet: &ConfigDocument<'_>) -> Result<(), ConfigError> {
    for (i, second) in axes.iter().enumerate().filter(|(_, axis)| axis.gantry.is_some()) {
        let key = format!("axis[{i}].gantry");
        let is_first = |axis: &&BoardAxis| axis.axis == second.axis && axis.gantry.is_none();
        let Some(first) = axes.iter().find(is_first) else {
            return Err(sheet.error(
                &key,
                "no other entry moves this axis".to_owned(),
                "give the entry of the first motor the same letter, without [axis.gantry]",
            ));
        };
        let of_steps = |axis: &BoardAxis| matches!(axis.actuator, Actuator::Steps { .. });
        if of_steps(first) != of_steps(second) {
            return Err(sheet.error(
                &key,
                "one motor has a step generator, the other an encoder".to_owned(),
                "give both `stepgen`, or both `encoder` and `pwm`: motors that follow in different ways \
                 rack the beam",
            ));
        }
        if first.zero != second.zero {
            return Err(sheet.error(
                &format!("axis[{i}].zero"),
                "the motors of a gantry start at different coordinates".to_owned(),
                "give `zero` to both or to neither; switches that are not square are what squaring_offset \
                 is for",
            ));
        }
        let key = format!("axis[{i}].home_switch");
        match (first.switches[0], second.switches[0]) {
            (None, None) => {}
            (Some(one), Some(other)) if one.slow == other.slow => {
                if (one.pin, one.remote) == (other.pin, other.remote) {
                    return Err(sheet.error(
                        &key,
                        "both motors of a gantry have this home switch".to_owned(),
                        "give each its own, or remove both: then the beam is assumed to be square",
                    ));
                }
            }
            (Some(_), Some(_)) => {
                return Err(sheet.error(
                    &key,
                    "the home switches of a gantry have different filters".to_owned(),
                    "give both `slow` or neither: one edge would be detected later than the other",
                ));
            }
            (None, Some(_)) | (Some(_), None) => {
                // A key that is missing has no position; the table that it is missing from has one.
                let key = if second.switches[0].is_some() {
                    key
                } else {
                    format!("axis[{i}]")
                };
                return Err(sheet.error(
                    &key,
                    "one motor of a gantry has a home switch, the other has none".to_owned(),
                    "give each its own, or remove it: then the beam is assumed to be square",
                ));
            }
        }
    }
    Ok(())
}
