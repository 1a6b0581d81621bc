//! The axes of a machine file.

use evolvent_config::shortened;
use evolvent_path::AxisLetter;

use super::Check;
use crate::error::MachineError;
use crate::file::{AxisFile, AxisKind, MachineFile};
use crate::machine::{Axis, MachineKind, UNLIMITED_DEG};
use crate::rate::GRAVITY_MM_S2;

impl Check<'_> {
    pub(super) fn axes(&self, raw: &MachineFile) -> Result<Vec<Axis>, MachineError> {
        let mut axes: Vec<Axis> = Vec::new();
        for (index, axis) in raw.axis.iter().enumerate() {
            let axis = self.axis(&format!("axis[{index}]"), axis)?;
            let letter = axis.letter.letter();
            if let Some(first) = axes.iter().position(|other| other.letter == axis.letter) {
                return Err(self.error(
                    &format!("axis[{index}].letter"),
                    format!("axis {letter} is defined twice: axis[{first}] already has that letter"),
                    "give each axis its own letter",
                ));
            }
            if axis.letter.is_rotary() && raw.increments_per_degree.is_none() {
                return Err(self.error(
                    "increments_per_degree",
                    format!("missing, but axis {letter} is rotary"),
                    "add increments_per_degree at the top of the file, for example 1000",
                ));
            }
            axes.push(axis);
        }
        if !axes.iter().any(|axis| !axis.letter.is_rotary()) {
            return Err(self.error(
                "axis",
                format!("{} axes, none of them linear", axes.len()),
                "add an [[axis]] with letter \"X\", \"Y\", \"Z\", \"U\", \"V\" or \"W\"",
            ));
        }
        for letter in [AxisLetter::X, AxisLetter::Z] {
            if raw.kind == MachineKind::Lathe && !axes.iter().any(|axis| axis.letter == letter) {
                return Err(self.error(
                    "axis",
                    format!(
                        "a lathe needs the axes X and Z, but {} is missing",
                        letter.letter()
                    ),
                    "add that axis, or write kind = \"mill\"",
                ));
            }
        }
        Ok(axes)
    }

    fn axis(&self, at: &str, raw: &AxisFile) -> Result<Axis, MachineError> {
        let mut letters = raw.letter.chars();
        let letter = match (letters.next().and_then(AxisLetter::from_letter), letters.next()) {
            (Some(letter), None) => letter,
            _ => {
                return Err(self.error(
                    &format!("{at}.letter"),
                    format!("{:?} is not an axis", shortened(&raw.letter)),
                    "use one of X, Y, Z, A, B, C, U, V, W",
                ));
            }
        };
        let rotary = letter.is_rotary();
        if let Some(kind) = raw.kind
            && (kind == AxisKind::Rotary) != rotary
        {
            let is = if rotary { "rotary" } else { "linear" };
            return Err(self.error(
                &format!("{at}.kind"),
                format!("axis {} is {is}", letter.letter()),
                format!(
                    "write kind = \"{is}\", or use another letter: A, B, C are rotary, the others linear"
                ),
            ));
        }
        self.reject_other_unit(at, letter, raw)?;
        self.reject_travel_of_unlimited(at, letter, raw)?;
        let (travel_min, travel_max, home) = if raw.unlimited.is_some() {
            (-UNLIMITED_DEG, UNLIMITED_DEG, ("home_deg", raw.home_deg))
        } else if rotary {
            (
                self.required(at, "travel_min_deg", raw.travel_min_deg)?,
                self.required(at, "travel_max_deg", raw.travel_max_deg)?,
                ("home_deg", raw.home_deg),
            )
        } else {
            (
                self.required(at, "travel_min_mm", raw.travel_min_mm)?,
                self.required(at, "travel_max_mm", raw.travel_max_mm)?,
                ("home_mm", raw.home_mm),
            )
        };
        let unit = if rotary { "deg" } else { "mm" };
        if travel_min >= travel_max {
            return Err(self.error(
                &format!("{at}.travel_min_{unit}"),
                format!("the travel is {travel_min} {unit} to {travel_max} {unit}"),
                "give a minimum below the maximum",
            ));
        }
        let home_key = format!("{at}.{}", home.0);
        let home = home.1.unwrap_or(0.0);
        if !(travel_min..=travel_max).contains(&home) {
            return Err(self.error(
                &home_key,
                format!("home is {home} {unit}, outside the travel of {travel_min} to {travel_max} {unit}"),
                "give a home position within the travel (default: 0)",
            ));
        }
        let [max_velocity, max_acceleration, max_jerk] = self.axis_limits(at, raw, rotary)?;
        Ok(Axis {
            letter,
            travel_min,
            travel_max,
            max_velocity,
            max_acceleration,
            max_jerk,
            home,
            following_error: self
                .at_most_one_of(
                    at,
                    "following_error",
                    &[
                        ("mm", raw.following_error_mm, 1.0),
                        ("deg", raw.following_error_deg, 1.0),
                    ],
                )?
                .unwrap_or(0.5),
            following_time_s: self.or_default(
                &format!("{at}.following_time_ms"),
                raw.following_time_ms,
                20.0,
                [0.0, 10_000.0],
            )? / 1000.0,
            unlimited: raw.unlimited,
        })
    }

    /// An unlimited axis is rotary, and has neither a travel nor a screw table.
    fn reject_travel_of_unlimited(
        &self,
        at: &str,
        letter: AxisLetter,
        raw: &AxisFile,
    ) -> Result<(), MachineError> {
        if raw.unlimited.is_none() {
            return Ok(());
        }
        if !letter.is_rotary() {
            return Err(self.error(
                &format!("{at}.unlimited"),
                format!("axis {} is linear and has a travel", letter.letter()),
                "remove the key: A, B and C are rotary",
            ));
        }
        let keys = [
            ("travel_min_deg", raw.travel_min_deg.is_some()),
            ("travel_max_deg", raw.travel_max_deg.is_some()),
            ("screw_table", raw.screw_table.is_some()),
        ];
        if let Some((key, _)) = keys.iter().find(|(_, is_given)| *is_given) {
            let what = format!("axis {} is unlimited", letter.letter());
            let advice = format!("remove {key}, or remove unlimited");
            return Err(self.error(&format!("{at}.{key}"), what, advice));
        }
        let home = raw.home_deg.unwrap_or(0.0);
        self.number(&format!("{at}.home_deg"), home, -360.0, 360.0)
    }

    /// Velocity, acceleration and jerk, each from the key that is present.
    fn axis_limits(&self, at: &str, raw: &AxisFile, rotary: bool) -> Result<[f64; 3], MachineError> {
        let (velocity, acceleration, jerk) = if rotary {
            (
                vec![
                    ("deg_min", raw.max_velocity_deg_min, 1.0 / 60.0),
                    ("deg_s", raw.max_velocity_deg_s, 1.0),
                ],
                vec![("deg_s2", raw.max_acceleration_deg_s2, 1.0)],
                vec![("deg_s3", raw.max_jerk_deg_s3, 1.0)],
            )
        } else {
            (
                vec![
                    ("mm_min", raw.max_velocity_mm_min, 1.0 / 60.0),
                    ("mm_s", raw.max_velocity_mm_s, 1.0),
                ],
                vec![
                    ("mm_s2", raw.max_acceleration_mm_s2, 1.0),
                    ("m_s2", raw.max_acceleration_m_s2, 1000.0),
                    ("g", raw.max_acceleration_g, GRAVITY_MM_S2),
                ],
                vec![
                    ("mm_s3", raw.max_jerk_mm_s3, 1.0),
                    ("m_s3", raw.max_jerk_m_s3, 1000.0),
                ],
            )
        };
        Ok([
            self.exactly_one_of(at, "max_velocity", &velocity)?,
            self.exactly_one_of(at, "max_acceleration", &acceleration)?,
            self.exactly_one_of(at, "max_jerk", &jerk)?,
        ])
    }

    /// Rejects a linear axis with keys in degrees, and a rotary one with keys in millimetres.
    fn reject_other_unit(&self, at: &str, letter: AxisLetter, raw: &AxisFile) -> Result<(), MachineError> {
        let linear = [
            ("travel_min_mm", raw.travel_min_mm),
            ("travel_max_mm", raw.travel_max_mm),
            ("home_mm", raw.home_mm),
            ("following_error_mm", raw.following_error_mm),
            ("backlash_mm", raw.backlash_mm),
            ("max_velocity_mm_min", raw.max_velocity_mm_min),
            ("max_velocity_mm_s", raw.max_velocity_mm_s),
            ("max_acceleration_mm_s2", raw.max_acceleration_mm_s2),
            ("max_acceleration_m_s2", raw.max_acceleration_m_s2),
            ("max_acceleration_g", raw.max_acceleration_g),
            ("max_jerk_mm_s3", raw.max_jerk_mm_s3),
            ("max_jerk_m_s3", raw.max_jerk_m_s3),
        ];
        let rotary = [
            ("travel_min_deg", raw.travel_min_deg),
            ("travel_max_deg", raw.travel_max_deg),
            ("home_deg", raw.home_deg),
            ("following_error_deg", raw.following_error_deg),
            ("backlash_deg", raw.backlash_deg),
            ("max_velocity_deg_min", raw.max_velocity_deg_min),
            ("max_velocity_deg_s", raw.max_velocity_deg_s),
            ("max_acceleration_deg_s2", raw.max_acceleration_deg_s2),
            ("max_jerk_deg_s3", raw.max_jerk_deg_s3),
        ];
        let (wrong, is, unit) = if letter.is_rotary() {
            (
                &linear[..],
                "rotary",
                "degrees (_deg, _deg_min or _deg_s, _deg_s2, _deg_s3)",
            )
        } else {
            (
                &rotary[..],
                "linear",
                "millimetres (_mm, _mm_min or _mm_s, _mm_s2, _mm_s3)",
            )
        };
        match wrong.iter().find(|(_, value)| value.is_some()) {
            None => Ok(()),
            Some((key, _)) => Err(self.error(
                &format!("{at}.{key}"),
                format!("axis {} is {is} and has no such key", letter.letter()),
                format!("give its travel and limits in {unit}"),
            )),
        }
    }
}
