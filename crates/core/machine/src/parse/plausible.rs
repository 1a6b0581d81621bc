//! Warnings for values of a machine file that are possible but implausible.

use super::Check;
use crate::file::{AxisFile, MachineFile};
use crate::homing::{HomingMethod, HomingSettings};
use crate::machine::Axis;

/// Plausible speeds, from the slowest feed to the fastest linear motor, mm/s.
const LINEAR_SPEED: [f64; 2] = [0.1, 20_000.0];
/// The same from the slowest dividing head to spindles that are driven as axes (100 000 rpm), degrees/s.
const ROTARY_SPEED: [f64; 2] = [0.1, 600_000.0];
/// Linear motors without a load reach about 50 g, mm/s2.
const MAX_ACCELERATION_MM_S2: f64 = 500_000.0;
/// Heavy planers need a second to reach their speed.
const MAX_TIME_TO_SPEED_S: f64 = 60.0;
/// The softest machines need a tenth of a second to reach their acceleration.
const MAX_TIME_TO_ACCELERATION_S: f64 = 5.0;
/// Fraction of the travel by which the search for a switch may exceed it. An axis that is not homed may be
/// that far outside.
const SEARCH_BEYOND: f64 = 0.1;

impl Check<'_> {
    /// The warnings, with file, line, key and what to do, in the form of errors.
    pub(super) fn warnings(
        &self,
        raw: &MachineFile,
        axes: &[Axis],
        homing: &[HomingSettings],
    ) -> Vec<String> {
        let given = raw.axis.iter().zip(axes).enumerate();
        let of_axes =
            given.flat_map(|(index, (raw, axis))| self.of_axis(&format!("axis[{index}]"), raw, axis));
        let of_homing = homing.iter().enumerate().filter_map(|(index, settings)| {
            let axis = axes.iter().find(|axis| axis.letter == settings.axis)?;
            self.of_homing(&format!("homing[{index}]"), settings, axis)
        });
        of_axes.chain(of_homing).collect()
    }

    fn of_axis(&self, at: &str, raw: &AxisFile, axis: &Axis) -> Vec<String> {
        let letter = axis.letter.letter();
        let [velocity_key, acceleration_key, jerk_key] = keys_of(raw);
        let (unit, [slowest, fastest]) = match axis.letter.is_rotary() {
            true => ("deg", ROTARY_SPEED),
            false => ("mm", LINEAR_SPEED),
        };
        let (velocity, acceleration, jerk) = (axis.max_velocity, axis.max_acceleration, axis.max_jerk);
        let mut found = Vec::new();
        let mut warn = |key: &str, what: String| {
            let advice = "check the number and its unit";
            found.push(self.error(&format!("{at}.{key}"), what, advice).to_string());
        };
        if velocity < slowest {
            warn(
                velocity_key,
                format!("axis {letter} has at most {velocity} {unit}/s, slower than any machine"),
            );
        } else if velocity > fastest {
            warn(
                velocity_key,
                format!("axis {letter} has up to {velocity} {unit}/s, faster than any machine"),
            );
        }
        if !axis.letter.is_rotary() && acceleration > MAX_ACCELERATION_MM_S2 {
            let g = acceleration / crate::rate::GRAVITY_MM_S2;
            warn(
                acceleration_key,
                format!("axis {letter} accelerates with {g:.0} g, more than any machine"),
            );
        } else if velocity / acceleration > MAX_TIME_TO_SPEED_S {
            let time = velocity / acceleration;
            warn(
                acceleration_key,
                format!(
                    "axis {letter} takes {time:.0} s to reach its maximum velocity with this acceleration"
                ),
            );
        }
        if acceleration / jerk > MAX_TIME_TO_ACCELERATION_S {
            let time = acceleration / jerk;
            warn(
                jerk_key,
                format!("axis {letter} takes {time:.0} s to reach its maximum acceleration with this jerk"),
            );
        }
        found
    }

    /// Warns of a switch or index pulse that the search does not reach from any position in the travel.
    fn of_homing(&self, at: &str, settings: &HomingSettings, axis: &Axis) -> Option<String> {
        if axis.unlimited.is_some() {
            return None;
        }
        let unit = if axis.letter.is_rotary() { "deg" } else { "mm" };
        let (name, within, search) = match settings.method {
            HomingMethod::Switch => ("switch", 0.0, "the search covers 1.1 times the travel".to_owned()),
            HomingMethod::SwitchThenIndex { within, .. } => (
                "index",
                within,
                format!("the search covers 1.1 times the travel, and index_within_{unit} after the switch"),
            ),
            HomingMethod::Index { within } => (
                "index",
                within,
                format!("the search covers index_within_{unit} from the position of the axis"),
            ),
            HomingMethod::Absolute => return None,
        };
        let reach = SEARCH_BEYOND * (axis.travel_max - axis.travel_min) + within;
        let reference = settings.reference;
        if (axis.travel_min - reach..=axis.travel_max + reach).contains(&reference) {
            return None;
        }
        let what = format!(
            "{reference} {unit} is far outside the travel of axis {}, {} to {} {unit}: {search}",
            axis.letter.letter(),
            axis.travel_min,
            axis.travel_max
        );
        let advice = "check the number: it is a machine coordinate";
        Some(
            self.error(&format!("{at}.{name}_{unit}"), what, advice)
                .to_string(),
        )
    }
}

/// The keys of velocity, acceleration and jerk.
fn keys_of(raw: &AxisFile) -> [&'static str; 3] {
    let given = |keys: &[(&'static str, Option<f64>)]| {
        let key = keys.iter().find(|(_, value)| value.is_some());
        key.map_or("letter", |(key, _)| *key)
    };
    [
        given(&[
            ("max_velocity_mm_min", raw.max_velocity_mm_min),
            ("max_velocity_mm_s", raw.max_velocity_mm_s),
            ("max_velocity_deg_min", raw.max_velocity_deg_min),
            ("max_velocity_deg_s", raw.max_velocity_deg_s),
        ]),
        given(&[
            ("max_acceleration_mm_s2", raw.max_acceleration_mm_s2),
            ("max_acceleration_m_s2", raw.max_acceleration_m_s2),
            ("max_acceleration_g", raw.max_acceleration_g),
            ("max_acceleration_deg_s2", raw.max_acceleration_deg_s2),
        ]),
        given(&[
            ("max_jerk_mm_s3", raw.max_jerk_mm_s3),
            ("max_jerk_m_s3", raw.max_jerk_m_s3),
            ("max_jerk_deg_s3", raw.max_jerk_deg_s3),
        ]),
    ]
}
