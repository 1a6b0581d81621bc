//! The spindle of a device in the network file: a drive in cyclic synchronous velocity.

use evolvent_bridge::{OrientationFile, SpindleIndexFile, check_gear};
use evolvent_config::{ConfigDocument, ConfigError};
use evolvent_drive::{OrientationSettings, SpindleEncoderSettings, SpindleIndex};
use schemars::JsonSchema;
use serde::Deserialize;

use super::axis::{direct, yes};
use crate::pdo::{Extras, TargetObject};
use crate::zero_impulse::ProbeNumber;

/// Bits of 6064h.
const COUNTER_BITS: u32 = 32;

/// A spindle drive: mode 9, target velocity 60FFh, angle by its position 6064h.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct SpindleFile {
    /// Number in the machine file.
    #[serde(default)]
    #[schemars(range(max = 3))]
    number: u32,
    /// Increments of the drive's position a turn of the motor, whose encoder it is.
    #[schemars(range(min = 1))]
    increments_per_turn: u32,
    /// Turns of the motor, and turns of the spindle in the same time.
    #[serde(default = "direct")]
    gear: [u32; 2],
    /// The motor turns counter-clockwise while the spindle turns clockwise.
    #[serde(default)]
    inverted: bool,
    /// What the target velocity (60FFh) is at 1 rpm of the motor. Default: increments per second.
    velocity_per_rpm: Option<f64>,
    /// Touch probe (1: 60BAh, or 2: 60BCh) that latches the zero impulse of the encoder.
    #[schemars(range(min = 1, max = 2))]
    index_probe: Option<u8>,
    /// Where the zero impulse comes from.
    index: Option<SpindleIndexFile>,
    /// The encoder knows its angle at power-up: the spindle is at angle 0 where the drive's position is this.
    absolute_zero: Option<i32>,
    /// Increments by which a zero impulse may be away from its place. More are lost increments.
    index_tolerance: Option<u32>,
    /// Of the commanded speed, by which the speed may differ and counts as reached.
    #[serde(default = "fiftieth")]
    at_speed_tolerance: f64,
    /// M19 by a position loop of the bridge.
    orientation: Option<OrientationFile>,
    /// Process data are written to the drive as the bridge needs them; else those are taken that it has.
    #[serde(default = "yes")]
    map: bool,
}

const fn fiftieth() -> f64 {
    0.02
}

/// A spindle drive, checked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NetworkSpindle {
    /// Number in the machine file.
    pub number: usize,
    /// Its encoder.
    pub encoder: SpindleEncoderSettings,
    /// The motor turns counter-clockwise while the spindle turns clockwise.
    pub inverted: bool,
    /// Target velocity at 1 rpm of the spindle.
    pub velocity_per_rpm: f64,
    /// The touch probe that latches the zero impulse.
    pub index_probe: Option<ProbeNumber>,
    /// M19.
    pub orientation: Option<OrientationSettings>,
    /// Whether process data are written.
    pub map: bool,
}

impl NetworkSpindle {
    pub(crate) const fn extras(&self) -> Extras {
        Extras {
            target: TargetObject::Velocity,
            velocity_offset: false,
            torque_offset: false,
            following_error: false,
            touch_probe: false,
            index_probe: self.index_probe,
            digital_outputs: false,
        }
    }

    /// Whether its angle is known after its zero impulse.
    #[must_use]
    pub fn knows_angle(&self) -> bool {
        self.encoder.index != SpindleIndex::None
    }
}

impl SpindleFile {
    pub(super) fn check(&self, sheet: &ConfigDocument<'_>, key: &str) -> Result<NetworkSpindle, ConfigError> {
        let at = |name: &str| format!("{key}.{name}");
        sheet.number(&at("number"), f64::from(self.number), 0.0, 3.0)?;
        sheet.number(
            &at("increments_per_turn"),
            f64::from(self.increments_per_turn),
            4.0,
            1e9,
        )?;
        let index_file = self.index.unwrap_or_default();
        check_gear(self.gear, index_file, sheet, key)?;
        sheet.number(&at("at_speed_tolerance"), self.at_speed_tolerance, 0.001, 0.5)?;
        let index_probe = match self.index_probe {
            None => None,
            Some(1) => Some(ProbeNumber::One),
            Some(2) => Some(ProbeNumber::Two),
            Some(other) => {
                return Err(sheet.error(
                    &at("index_probe"),
                    format!("{other} is not a touch probe: drives have the touch probes 1 and 2"),
                    "give 1 for 60BAh, or 2 for 60BCh",
                ));
            }
        };
        let index = match (index_probe, self.absolute_zero, self.index) {
            (None, Some(zero), None) => {
                if self.gear[0] != self.gear[1] {
                    return Err(sheet.error(
                        &at("absolute_zero"),
                        "an absolute encoder behind a gear does not know the angle of the spindle".to_owned(),
                        "remove absolute_zero, and give index_probe and index = \"encoder\"",
                    ));
                }
                SpindleIndex::Absolute {
                    zero: i64::from(zero),
                }
            }
            (Some(_), None, index) if index != Some(SpindleIndexFile::None) => index_file.index(),
            (None, None, None | Some(SpindleIndexFile::None)) => SpindleIndex::None,
            (None, None, Some(_)) => {
                return Err(sheet.error(
                    &at("index"),
                    "an index needs the touch probe that latches it".to_owned(),
                    "give index_probe: 1 or 2",
                ));
            }
            _ => {
                return Err(sheet.error(
                    key,
                    "index_probe, absolute_zero and index = \"none\" exclude each other".to_owned(),
                    "give index_probe for an encoder with a zero impulse, absolute_zero for one that knows \
                     its angle",
                ));
            }
        };
        if self.orientation.is_some() && index == SpindleIndex::None {
            return Err(sheet.error(
                &at("orientation"),
                "without an index there is no angle to turn to".to_owned(),
                "give index_probe or absolute_zero, or remove orientation",
            ));
        }
        let index_tolerance = self
            .index_tolerance
            .unwrap_or(8.max(self.increments_per_turn / 200));
        let [motor, spindle] = self.gear.map(f64::from);
        let of_motor = self
            .velocity_per_rpm
            .unwrap_or(f64::from(self.increments_per_turn) / 60.0);
        sheet.number(&at("velocity_per_rpm"), of_motor, 1e-6, 1e9)?;
        Ok(NetworkSpindle {
            number: self.number as usize,
            encoder: SpindleEncoderSettings {
                counter_bits: COUNTER_BITS,
                counts_per_turn: self.increments_per_turn,
                gear: self.gear,
                inverted: self.inverted,
                index,
                index_tolerance,
                at_speed_fraction: self.at_speed_tolerance,
            },
            inverted: self.inverted,
            velocity_per_rpm: of_motor * motor / spindle,
            index_probe,
            orientation: match self.orientation {
                Some(orientation) => Some(orientation.check(sheet, &at("orientation"))?),
                None => None,
            },
            map: self.map,
        })
    }
}
