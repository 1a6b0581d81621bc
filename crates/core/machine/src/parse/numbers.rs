//! Checks numbers of a machine file: in range, in exactly one unit.

use super::{Check, MAX_NUMBER, MIN_NUMBER};
use crate::error::MachineError;

impl Check<'_> {
    /// A number within its range, or its default.
    pub(super) fn or_default(
        &self,
        key: &str,
        value: Option<f64>,
        default: f64,
        [min, max]: [f64; 2],
    ) -> Result<f64, MachineError> {
        let value = value.unwrap_or(default);
        self.number(key, value, min, max).map(|()| value)
    }

    pub(super) fn required(&self, at: &str, key: &str, value: Option<f64>) -> Result<f64, MachineError> {
        let key = format!("{at}.{key}");
        let Some(value) = value else {
            return Err(self.error(&key, "missing".to_owned(), "add this key to the axis"));
        };
        self.number(&key, value, -MAX_NUMBER, MAX_NUMBER)?;
        Ok(value)
    }

    /// Exactly one of the keys `QUANTITY_UNIT`, as a positive limit in mm or degrees and seconds.
    pub(super) fn exactly_one_of(
        &self,
        at: &str,
        quantity: &str,
        units: &[(&str, Option<f64>, f64)],
    ) -> Result<f64, MachineError> {
        if let Some(value) = self.at_most_one_of(at, quantity, units)? {
            return Ok(value);
        }
        Err(self.error(
            &format!("{at}.{quantity}_{}", units.first().map_or("", |unit| unit.0)),
            "missing".to_owned(),
            format!("add {} to the axis", alternatives(quantity, units)),
        ))
    }

    pub(super) fn at_most_one_of(
        &self,
        at: &str,
        quantity: &str,
        units: &[(&str, Option<f64>, f64)],
    ) -> Result<Option<f64>, MachineError> {
        let mut found: Option<(f64, &str)> = None;
        for &(unit, value, factor) in units {
            let Some(value) = value else { continue };
            let key = format!("{at}.{quantity}_{unit}");
            if let Some((_, first)) = found {
                return Err(self.error(
                    &key,
                    format!("given twice: {quantity}_{first} is already present"),
                    format!("keep one of {}", alternatives(quantity, units)),
                ));
            }
            self.number(
                &key,
                value,
                as_written(MIN_NUMBER / factor),
                as_written(MAX_NUMBER / factor),
            )?;
            found = Some((value * factor, unit));
        }
        Ok(found.map(|(value, _)| value))
    }

    pub(super) fn number(&self, key: &str, value: f64, min: f64, max: f64) -> Result<(), MachineError> {
        Ok(self.document.number(key, value, min, max)?)
    }

    pub(super) fn whole_number<T: TryFrom<i64>>(
        &self,
        key: &str,
        value: i64,
        min: i64,
        max: i64,
    ) -> Result<T, MachineError> {
        if (min..=max).contains(&value)
            && let Ok(value) = T::try_from(value)
        {
            return Ok(value);
        }
        let range = format!("give a whole number from {min} to {max}");
        Err(self.error(key, format!("{value} is out of range"), range))
    }
}

/// Rounds a limit in another unit to remove the error of the conversion: 1e-9 instead of
/// 9.999999999999999e-10.
fn as_written(limit: f64) -> f64 {
    format!("{limit:.12e}").parse().unwrap_or(limit)
}

fn alternatives(quantity: &str, units: &[(&str, Option<f64>, f64)]) -> String {
    let keys: Vec<_> = units
        .iter()
        .map(|(unit, _, _)| format!("{quantity}_{unit}"))
        .collect();
    keys.join(" or ")
}
