//! Homing on the drive in the network file.

use evolvent_config::{ConfigDocument, ConfigError};
use schemars::JsonSchema;
use serde::Deserialize;

use crate::homing::HomingOnDrive;
use crate::scale::Scale;

/// Homing on the drive (mode of operation 6). One unit each: mm for a linear axis, degrees for a rotary one.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct HomingFile {
    /// Object 6098h, as the drive's manual lists methods.
    pub(super) method: i8,
    /// Speed of the search (6099h:1), mm/s.
    pub(super) search_mm_s: Option<f64>,
    /// The same in degrees/s.
    pub(super) search_deg_s: Option<f64>,
    /// Speed of the latch (6099h:2), mm/s.
    pub(super) latch_mm_s: Option<f64>,
    /// The same in degrees/s.
    pub(super) latch_deg_s: Option<f64>,
    /// Acceleration (609Ah), mm/s2; the drive's own where it is not given.
    pub(super) acceleration_mm_s2: Option<f64>,
    /// The same in degrees/s2.
    pub(super) acceleration_deg_s2: Option<f64>,
    /// Machine coordinate of the place that the drive finds, mm or degrees.
    #[serde(default)]
    pub(super) position: f64,
    /// Place in the sequence: axes with the smallest number begin, equal ones together.
    #[serde(default)]
    #[schemars(range(max = 100))]
    pub(super) order: u32,
    /// How long it may take, s.
    #[serde(default = "minute")]
    #[schemars(range(min = 1, max = 600))]
    pub(super) timeout_s: f64,
}

pub(super) const fn minute() -> f64 {
    60.0
}

impl HomingFile {
    pub(super) fn check(
        &self,
        sheet: &ConfigDocument<'_>,
        key: &str,
        scale: Scale,
        is_rotary: bool,
    ) -> Result<HomingOnDrive, ConfigError> {
        // In the unit of the axis, as increments.
        let increments = |name: &str, mm: Option<f64>, deg: Option<f64>| {
            let unit = if is_rotary { "deg" } else { "mm" };
            let value = match (mm, deg, is_rotary) {
                (Some(value), None, false) | (None, Some(value), true) => value,
                (None, None, _) => return Ok(None),
                _ => {
                    return Err(sheet.error(
                        key,
                        format!("{name} has another unit than the axis"),
                        format!("give it in {unit}"),
                    ));
                }
            };
            let increments = value * scale.per_unit();
            if !(1.0..=f64::from(u32::MAX)).contains(&increments) {
                return Err(sheet.error(
                    key,
                    format!("{name} is {increments:.0} increments, which is not within 1 to 4294967295"),
                    "give another speed or acceleration",
                ));
            }
            Ok(Some(increments.round() as u32))
        };
        let needed = |name: &str, value: Option<u32>| {
            value.ok_or_else(|| {
                sheet.error(
                    key,
                    format!("homing needs {name}"),
                    "give it in the unit of the axis",
                )
            })
        };
        sheet.number(&format!("{key}.position"), self.position, -1e6, 1e6)?;
        sheet.number(&format!("{key}.order"), f64::from(self.order), 0.0, 100.0)?;
        sheet.number(&format!("{key}.timeout_s"), self.timeout_s, 1.0, 600.0)?;
        let search = increments("search", self.search_mm_s, self.search_deg_s)?;
        let latch = increments("latch", self.latch_mm_s, self.latch_deg_s)?;
        Ok(HomingOnDrive {
            method: self.method,
            search: needed("the speed of the search", search)?,
            latch: needed("the speed of the latch", latch)?,
            acceleration: increments("acceleration", self.acceleration_mm_s2, self.acceleration_deg_s2)?,
            position: self.position,
            order: self.order,
            timeout_s: self.timeout_s,
        })
    }
}
