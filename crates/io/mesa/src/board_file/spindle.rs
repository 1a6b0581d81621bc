//! The spindles of the board file.

use std::borrow::Cow;
use std::fmt;

use evolvent_bridge::{OrientationFile, SpindleIndexFile, check_gear};
use evolvent_config::{ConfigDocument, ConfigError};
use evolvent_drive::{SpindleEncoderSettings, SpindleIndex};
use schemars::{JsonSchema, Schema, SchemaGenerator};
use serde::de::value::MapAccessDeserializer;
use serde::de::{MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};

use super::MAX_UNITS;
use super::pins::PinFile;
use crate::board_settings::{BoardAxis, BoardSpindle, SpindleAngleSource, SpindleOrienting, SpindleSpeed};

/// Bits of an encoder's counter.
const COUNTER_BITS: u32 = 16;

/// `[[spindle]]`, one for each; a single `[spindle]` of older files is read too.
#[derive(Clone, Debug, Default)]
pub(super) struct SpindleFiles {
    /// It is written as a table.
    pub(super) is_single: bool,
    spindles: Vec<SpindleFile>,
}

/// A spindle.
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct SpindleFile {
    /// Number in the machine file.
    #[serde(default)]
    #[schemars(range(max = 3))]
    number: u32,
    /// The PWM generator (or analog output) of its speed.
    #[schemars(range(max = 15))]
    pwm: Option<u32>,
    /// The [[remote]] with the spindle outputs (SpinOut, SpinEna, SpinDir), from 0.
    #[schemars(range(max = 3))]
    remote: Option<u32>,
    /// Speed at full output, rpm.
    full_rpm: Option<f64>,
    /// The analog value is negative counter-clockwise, as for a servo drive of +-10 V.
    #[serde(default)]
    signed: bool,
    /// Output for clockwise.
    forward: Option<PinFile>,
    /// Output for counter-clockwise.
    reverse: Option<PinFile>,
    /// Output that enables the drive: while the spindle is to turn or to hold an angle, and until it stands.
    enable: Option<PinFile>,
    /// Input by which the drive reports a fault.
    fault: Option<PinFile>,
    /// Input by which the drive reports that the speed is reached, beside the encoder.
    at_speed: Option<PinFile>,
    /// Number of the encoder of the spindle.
    #[schemars(range(max = 15))]
    encoder: Option<u32>,
    /// Counts per turn of the encoder, four to a line.
    #[schemars(range(min = 4, max = 10_000_000))]
    counts_per_rev: Option<u32>,
    /// Turns of the encoder, and turns of the spindle in the same time.
    gear: Option<[u32; 2]>,
    /// The encoder counts down while the spindle turns clockwise.
    #[serde(default)]
    inverted: bool,
    /// Where the index pulse comes from.
    index: Option<SpindleIndexFile>,
    /// The index pulse is low: its falling edge is the pulse, not its rising one.
    #[serde(default)]
    index_inverted: bool,
    /// Counts by which an index pulse may be away from its place: its width, and an uneven coupling. More are lost counts.
    #[schemars(range(max = 100_000))]
    index_tolerance: Option<u32>,
    /// Of the commanded speed, by which the speed may differ and counts as reached.
    at_speed_tolerance: Option<f64>,
    /// M19 by a position loop of the bridge on the speed.
    orientation: Option<OrientationFile>,
    /// Output that makes the drive turn the spindle to its own angle (M19).
    orient: Option<PinFile>,
    /// Input by which the drive reports that the spindle is there.
    oriented: Option<PinFile>,
    /// The angle to which the drive turns the spindle, degrees from the index pulse, as M19 R names it.
    oriented_deg: Option<f64>,
}

impl<'de> Deserialize<'de> for SpindleFiles {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct OneOrMore;
        impl<'de> Visitor<'de> for OneOrMore {
            type Value = SpindleFiles;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("tables [[spindle]]")
            }

            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<SpindleFiles, A::Error> {
                Ok(SpindleFiles {
                    is_single: true,
                    spindles: vec![SpindleFile::deserialize(MapAccessDeserializer::new(map))?],
                })
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<SpindleFiles, A::Error> {
                let mut spindles = Vec::new();
                while let Some(spindle) = seq.next_element()? {
                    spindles.push(spindle);
                }
                Ok(SpindleFiles {
                    is_single: false,
                    spindles,
                })
            }
        }
        deserializer.deserialize_any(OneOrMore)
    }
}

impl JsonSchema for SpindleFiles {
    fn schema_name() -> Cow<'static, str> {
        "SpindleFiles".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let one = generator.subschema_for::<SpindleFile>();
        schemars::json_schema!({
            "anyOf": [{ "type": "array", "maxItems": 4, "items": one }, one]
        })
    }
}

impl SpindleFiles {
    pub(super) fn check(
        &self,
        axes: &[BoardAxis],
        sheet: &ConfigDocument<'_>,
    ) -> Result<Vec<BoardSpindle>, ConfigError> {
        let mut checked: Vec<BoardSpindle> = Vec::new();
        for (i, spindle) in self.spindles.iter().enumerate() {
            let key = if self.is_single {
                "spindle".to_owned()
            } else {
                format!("spindle[{i}]")
            };
            let spindle = spindle.check(sheet, &key)?;
            if checked.iter().any(|other| other.number == spindle.number) {
                let what = format!("another entry is spindle {}", spindle.number);
                return Err(sheet.error(&format!("{key}.number"), what, "give each its own number, 0 to 3"));
            }
            let unit = spindle.angle.map(|angle| angle.encoder);
            let of_axis = axes
                .iter()
                .any(|axis| axis.encoder().is_some() && axis.encoder() == unit);
            let of_spindle = |other: &BoardSpindle| other.angle.map(|angle| angle.encoder) == unit;
            if unit.is_some() && (of_axis || checked.iter().any(of_spindle)) {
                return Err(sheet.error(
                    &format!("{key}.encoder"),
                    "this encoder also belongs to another entry".to_owned(),
                    "give the number of the spindle's own encoder",
                ));
            }
            checked.push(spindle);
        }
        Ok(checked)
    }
}

impl SpindleFile {
    fn check(&self, sheet: &ConfigDocument<'_>, key: &str) -> Result<BoardSpindle, ConfigError> {
        let at = |name: &str| format!("{key}.{name}");
        sheet.number(&at("number"), f64::from(self.number), 0.0, 3.0)?;
        let output = |pin: Option<PinFile>, name: &str| PinFile::check_driven(pin, sheet, &at(name));
        let input = |pin: Option<PinFile>, name: &str| PinFile::check_any(pin, sheet, &at(name));
        let speed = self.speed(sheet, key)?;
        if self.signed && !matches!(speed, Some(SpindleSpeed::Pwm { .. })) {
            return Err(sheet.error(
                &at("signed"),
                "only the speed on a PWM generator can have a sign".to_owned(),
                "give pwm and full_rpm, or remove signed",
            ));
        }
        let angle = self.angle(sheet, key)?;
        let spindle = BoardSpindle {
            number: self.number as usize,
            speed,
            forward: output(self.forward, "forward")?,
            reverse: output(self.reverse, "reverse")?,
            enable: output(self.enable, "enable")?,
            fault: input(self.fault, "fault")?,
            at_speed: input(self.at_speed, "at_speed")?,
            angle,
            orienting: self.orienting(speed, sheet, key)?,
        };
        if angle.is_none() {
            let given = [
                ("fault", self.fault.is_some()),
                ("at_speed", self.at_speed.is_some()),
                ("orientation", self.orientation.is_some()),
                ("orient", self.orient.is_some()),
            ];
            if let Some((name, _)) = given.into_iter().find(|(_, is_given)| *is_given) {
                return Err(sheet.error(
                    &at(name),
                    format!("{name} is reported with the angle, and this spindle has no encoder"),
                    "give encoder and counts_per_rev; without an encoder make the pin an [[input]], and \
                     name it as at_speed_input in the machine file",
                ));
            }
        }
        Ok(spindle)
    }

    fn speed(&self, sheet: &ConfigDocument<'_>, key: &str) -> Result<Option<SpindleSpeed>, ConfigError> {
        let at = |name: &str| format!("{key}.{name}");
        if let Some(full_rpm) = self.full_rpm {
            sheet.number(&at("full_rpm"), full_rpm, 1e-3, 1e6)?;
        }
        match (self.pwm, self.remote, self.full_rpm) {
            (None, None, None) => Ok(None),
            (Some(unit), None, Some(full_rpm)) => {
                sheet.number(&at("pwm"), f64::from(unit), 0.0, MAX_UNITS)?;
                Ok(Some(SpindleSpeed::Pwm {
                    unit: unit as usize,
                    full_rpm,
                    signed: self.signed,
                }))
            }
            (None, Some(remote), Some(full_rpm)) => Ok(Some(SpindleSpeed::Remote {
                remote: remote as usize,
                full_rpm,
            })),
            _ => Err(sheet.error(
                key,
                "pwm or remote, and full_rpm, belong together".to_owned(),
                "give pwm and full_rpm, or remote and full_rpm, or none",
            )),
        }
    }

    fn angle(
        &self,
        sheet: &ConfigDocument<'_>,
        key: &str,
    ) -> Result<Option<SpindleAngleSource>, ConfigError> {
        let at = |name: &str| format!("{key}.{name}");
        let Some(encoder) = self.encoder else {
            let given = [
                ("counts_per_rev", self.counts_per_rev.is_some()),
                ("gear", self.gear.is_some()),
                ("inverted", self.inverted),
                ("index", self.index.is_some()),
                ("index_inverted", self.index_inverted),
                ("index_tolerance", self.index_tolerance.is_some()),
                ("at_speed_tolerance", self.at_speed_tolerance.is_some()),
            ];
            return match given.into_iter().find(|(_, is_given)| *is_given) {
                None => Ok(None),
                Some((name, _)) => Err(sheet.error(
                    &at(name),
                    format!("{name} belongs to an encoder, and none is given"),
                    "give encoder: its number on the board",
                )),
            };
        };
        sheet.number(&at("encoder"), f64::from(encoder), 0.0, MAX_UNITS)?;
        let Some(counts_per_turn) = self.counts_per_rev else {
            return Err(sheet.error(
                key,
                "an encoder needs counts_per_rev".to_owned(),
                "give counts_per_rev: four times the lines of the encoder",
            ));
        };
        sheet.number(&at("counts_per_rev"), f64::from(counts_per_turn), 4.0, 1e7)?;
        let (gear, index) = (self.gear.unwrap_or([1, 1]), self.index.unwrap_or_default());
        check_gear(gear, index, sheet, key)?;
        if index == SpindleIndexFile::None && self.index_inverted {
            return Err(sheet.error(
                &at("index_inverted"),
                "the encoder has no index".to_owned(),
                "remove index_inverted",
            ));
        }
        // A pulse is up to four counts wide, and longer on a coarse sensor.
        let index_tolerance = self.index_tolerance.unwrap_or(8.max(counts_per_turn / 200));
        sheet.number(&at("index_tolerance"), f64::from(index_tolerance), 0.0, 1e5)?;
        let at_speed_tolerance = self.at_speed_tolerance.unwrap_or(0.02);
        sheet.number(&at("at_speed_tolerance"), at_speed_tolerance, 0.001, 0.5)?;
        Ok(Some(SpindleAngleSource {
            encoder: encoder as usize,
            index_rising: !self.index_inverted,
            settings: SpindleEncoderSettings {
                counter_bits: COUNTER_BITS,
                counts_per_turn,
                gear,
                inverted: self.inverted,
                index: index.index(),
                index_tolerance,
                at_speed_fraction: at_speed_tolerance,
            },
        }))
    }

    fn orienting(
        &self,
        speed: Option<SpindleSpeed>,
        sheet: &ConfigDocument<'_>,
        key: &str,
    ) -> Result<Option<SpindleOrienting>, ConfigError> {
        let at = |name: &str| format!("{key}.{name}");
        match (self.orientation, self.orient, self.oriented) {
            (None, None, None) if self.oriented_deg.is_none() => Ok(None),
            (Some(orientation), None, None) if self.oriented_deg.is_none() => {
                let turns_back = self.signed
                    || self.reverse.is_some() && self.forward.is_some()
                    || matches!(speed, Some(SpindleSpeed::Remote { .. }));
                if speed.is_none() || !turns_back {
                    return Err(sheet.error(
                        &at("orientation"),
                        "a position loop needs a speed, and to turn the spindle either way".to_owned(),
                        "give pwm and full_rpm with `signed = true`, or with both `forward` and `reverse`",
                    ));
                }
                if self.index == Some(SpindleIndexFile::None) {
                    return Err(sheet.error(
                        &at("orientation"),
                        "without an index there is no angle to turn to".to_owned(),
                        "remove orientation, or index = \"none\"",
                    ));
                }
                Ok(Some(SpindleOrienting::Loop(
                    orientation.check(sheet, &at("orientation"))?,
                )))
            }
            (None, Some(orient), Some(oriented)) => {
                let angle_deg = self.oriented_deg.unwrap_or(0.0);
                if !(0.0..360.0).contains(&angle_deg) {
                    let what = format!("{angle_deg} is not an angle within a turn");
                    return Err(sheet.error(
                        &at("oriented_deg"),
                        what,
                        "give 0 to below 360, as M19 R names it",
                    ));
                }
                let pin = PinFile::check_driven(Some(orient), sheet, &at("orient"))?;
                let reached = PinFile::check_any(Some(oriented), sheet, &at("oriented"))?;
                Ok(pin
                    .zip(reached)
                    .map(|(command, reached)| SpindleOrienting::Drive {
                        command,
                        reached,
                        angle_deg,
                    }))
            }
            (Some(_), ..) => Err(sheet.error(
                &at("orientation"),
                "either the bridge turns the spindle to an angle or the drive does".to_owned(),
                "give `orientation`, or `orient` and `oriented`",
            )),
            _ => Err(sheet.error(
                key,
                "orient and oriented belong together".to_owned(),
                "give the output that makes the drive turn the spindle to its angle, and the input that \
                 reports that it is there",
            )),
        }
    }
}

impl BoardSpindle {
    /// Whether its angle is known once its index has come.
    #[must_use]
    pub fn knows_angle(&self) -> bool {
        self.angle
            .is_some_and(|angle| angle.settings.index != SpindleIndex::None)
    }
}
