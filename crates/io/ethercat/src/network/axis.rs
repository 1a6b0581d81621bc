//! The axis of a device in the network file: what its motor turns, and the second drive of a gantry.

use evolvent_bridge::{GantryFile, axis_letter};
use evolvent_config::{ConfigDocument, ConfigError};
use schemars::JsonSchema;
use serde::Deserialize;

use super::NetworkAxis;
use super::homing::HomingFile;
use crate::scale::Scale;
use crate::zero_impulse::ProbeNumber;

/// What a drive turns.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct AxisFile {
    /// Letter of the axis in the machine file.
    pub(super) letter: String,
    /// Increments of the drive's position a turn of the motor.
    #[schemars(range(min = 1))]
    pub(super) increments_per_turn: u32,
    /// Turns of the motor, and turns of the other side of the gear in the same time.
    #[serde(default = "direct")]
    pub(super) gear: [u32; 2],
    /// What one turn after the gear moves the axis, in mm; the lead of a screw.
    pub(super) turn_mm: Option<f64>,
    /// The same for a rotary axis, in degrees.
    pub(super) turn_deg: Option<f64>,
    /// The motor turns against the axis.
    #[serde(default)]
    pub(super) inverted: bool,
    /// Whether the encoder knows its position at power-up.
    #[serde(default)]
    pub(super) absolute: bool,
    /// The machine coordinate, in mm or degrees, at which the drive's position is zero. Of an axis that is homed and not absolute, where it is when the bridge finds it first.
    #[serde(default)]
    pub(super) zero: f64,
    /// Process data are written to the drive as the bridge needs them; else those are taken that it has.
    #[serde(default = "yes")]
    pub(super) map: bool,
    /// The velocity of the setpoints is handed on as velocity offset (60B1h).
    #[serde(default)]
    pub(super) velocity_offset: bool,
    /// Inertia of motor and load at the motor, kg m2: their acceleration is handed on as torque offset (60B2h).
    pub(super) inertia_kg_m2: Option<f64>,
    /// Rated torque of the motor, N m; needed with an inertia.
    pub(super) rated_torque_n_m: Option<f64>,
    /// Bit of the digital inputs (60FDh) with the home switch.
    #[schemars(range(max = 31))]
    pub(super) home_switch_bit: Option<u8>,
    /// Bits 0 and 1 of the digital inputs (60FDh) are limit switches.
    #[serde(default)]
    pub(super) limit_switches: bool,
    /// The following error of the feedback is the drive's own (60F4h).
    #[serde(default)]
    pub(super) following_error: bool,
    /// Touch probe 1 (60B8h, 60B9h, 60BAh) latches positions at its rising edge.
    #[serde(default)]
    pub(super) touch_probe: bool,
    /// Bit of the digital inputs (60FDh) with the probe.
    #[schemars(range(max = 31))]
    pub(super) probe_input_bit: Option<u8>,
    /// Touch probe (1: 60BAh, or 2: 60BCh) that latches the encoder's zero impulse for homing by index pulse.
    #[schemars(range(min = 1, max = 2))]
    pub(super) index_probe: Option<u8>,
    /// The drive finds its machine zero by itself when power is first requested: the axis moves then.
    pub(super) homing: Option<HomingFile>,
    /// This is the second drive of a gantry: another device without it drives the same axis.
    pub(super) gantry: Option<GantryFile>,
}

pub(super) const fn yes() -> bool {
    true
}

pub(super) const fn direct() -> [u32; 2] {
    [1, 1]
}

impl AxisFile {
    pub(super) fn check(&self, sheet: &ConfigDocument<'_>, key: &str) -> Result<NetworkAxis, ConfigError> {
        let at = |name: &str| format!("{key}.{name}");
        let letter = axis_letter(sheet, &at("letter"), &self.letter)?;
        let turn = self.check_turn(sheet, key, letter.is_rotary())?;
        let scale = Scale::new(self.increments_per_turn, self.gear, turn).map_err(|error| {
            sheet.error(
                key,
                format!("increments_per_turn, gear and turn give no valid scale: {error}"),
                "give the numbers of the drive's encoder and the gear",
            )
        })?;
        sheet.number(&at("zero"), self.zero, -1e6, 1e6)?;
        let torque_per_acceleration = self.check_torque(sheet, key, scale)?;
        if let Some(bit) = self.home_switch_bit {
            sheet.number(&at("home_switch_bit"), f64::from(bit), 0.0, 31.0)?;
        }
        if let Some(bit) = self.probe_input_bit {
            sheet.number(&at("probe_input_bit"), f64::from(bit), 0.0, 31.0)?;
        }
        if self.touch_probe && self.gantry.is_some() {
            return Err(sheet.error(
                &at("touch_probe"),
                "the second drive of a gantry latches no probed position: that of the first one is the axis"
                    .to_owned(),
                "remove touch_probe here, and give it to the first drive of the axis",
            ));
        }
        let index_probe = self.check_index_probe(sheet, &at("index_probe"))?;
        let homing = match &self.homing {
            Some(homing) => Some(homing.check(sheet, &at("homing"), scale, letter.is_rotary())?),
            None => None,
        };
        if homing.is_some() && self.absolute {
            return Err(sheet.error(
                &at("absolute"),
                "an encoder that knows its position needs no homing".to_owned(),
                "remove `absolute` or `homing`",
            ));
        }
        Ok(NetworkAxis {
            axis: letter.index(),
            scale,
            increments_per_turn: self.increments_per_turn,
            inverted: self.inverted,
            absolute: self.absolute,
            zero: self.zero,
            map: self.map,
            velocity_offset: self.velocity_offset,
            torque_per_acceleration,
            home_switch_bit: self.home_switch_bit,
            limit_switches: self.limit_switches,
            following_error: self.following_error,
            touch_probe: self.touch_probe,
            probe_input_bit: self.probe_input_bit,
            index_probe,
            homing,
            gantry: match &self.gantry {
                Some(gantry) => Some(gantry.check(sheet, &at("gantry"))?),
                None => None,
            },
        })
    }

    /// Checks the touch probe for the zero impulse, which must have no other use.
    fn check_index_probe(
        &self,
        sheet: &ConfigDocument<'_>,
        key: &str,
    ) -> Result<Option<ProbeNumber>, ConfigError> {
        let Some(number) = self.index_probe else {
            return Ok(None);
        };
        if self.gantry.is_some() {
            return Err(sheet.error(
                key,
                "the second drive of a gantry latches no index pulse: that of the first one counts"
                    .to_owned(),
                "remove index_probe here, and give it to the first drive of the axis",
            ));
        }
        if self.absolute {
            return Err(sheet.error(
                key,
                "an encoder that knows its position is not homed by its index pulse".to_owned(),
                "remove `absolute` or `index_probe`",
            ));
        }
        match number {
            1 if self.touch_probe => Err(sheet.error(
                key,
                "touch probe 1 already latches the probe input (touch_probe)".to_owned(),
                "give 2, or remove touch_probe",
            )),
            1 => Ok(Some(ProbeNumber::One)),
            2 => Ok(Some(ProbeNumber::Two)),
            other => Err(sheet.error(
                key,
                format!("{other} is not a touch probe: drives have the touch probes 1 and 2"),
                "give 1 for 60BAh, or 2 for 60BCh",
            )),
        }
    }

    /// What one turn after the gear moves the axis, in its unit.
    fn check_turn(&self, sheet: &ConfigDocument<'_>, key: &str, is_rotary: bool) -> Result<f64, ConfigError> {
        match (self.turn_mm, self.turn_deg, is_rotary) {
            (Some(turn), None, false) | (None, Some(turn), true) => Ok(turn),
            (.., false) => Err(sheet.error(
                key,
                "a linear axis needs turn_mm alone".to_owned(),
                "give what one turn moves it, in mm",
            )),
            (.., true) => Err(sheet.error(
                key,
                "a rotary axis needs turn_deg alone".to_owned(),
                "give what one turn moves it, in degrees",
            )),
        }
    }

    /// Torque in thousandths of the rated torque per acceleration of one unit/s2; 0 without an inertia.
    fn check_torque(&self, sheet: &ConfigDocument<'_>, key: &str, scale: Scale) -> Result<f64, ConfigError> {
        let at = |name: &str| format!("{key}.{name}");
        let Some(inertia) = self.inertia_kg_m2 else {
            return Ok(0.0);
        };
        let Some(torque) = self.rated_torque_n_m else {
            return Err(sheet.error(
                &at("inertia_kg_m2"),
                "an inertia needs a rated torque".to_owned(),
                "give rated_torque_n_m as well",
            ));
        };
        sheet.number(&at("inertia_kg_m2"), inertia, 1e-9, 1e3)?;
        sheet.number(&at("rated_torque_n_m"), torque, 1e-3, 1e6)?;
        let turns = scale.per_unit() / f64::from(self.increments_per_turn);
        Ok(1000.0 * inertia / torque * core::f64::consts::TAU * turns)
    }
}
