//! The interpolation time period (object 60C2h): a drive must know the time from target to target.

use thiserror::Error;

/// Object 60C2h: `value` times ten to the `index` seconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InterpolationTime {
    /// Sub-index 1.
    pub value: u8,
    /// Sub-index 2, a power of ten.
    pub index: i8,
}

/// Why a drive cannot use a period.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum InterpolationError {
    /// The object cannot hold the number.
    #[error(
        "a period of {period_ns} ns is not a whole number from 1 to 255 times a power of ten seconds: set \
         the machine's \
         rate so that it becomes {nearest_ns} ns"
    )]
    NotRepresentable {
        /// The cycle's period in ns.
        period_ns: u64,
        /// The nearest period that it can hold.
        nearest_ns: u64,
    },
}

impl InterpolationTime {
    /// Converts the period of the cycle exactly.
    ///
    /// # Errors
    /// The period has more digits than the object holds; the error names the nearest period that fits. A
    /// drive with a period other than that of the setpoints moves in steps.
    ///
    /// ```
    /// use evolvent_drive::InterpolationTime;
    ///
    /// let time = InterpolationTime::from_period_ns(250_000)?;
    /// assert_eq!(time.period_ns(), 250_000);
    /// assert!(InterpolationTime::from_period_ns(1_264_809).is_err(), "no whole number of a power of ten");
    /// # Ok::<(), evolvent_drive::InterpolationError>(())
    /// ```
    pub fn from_period_ns(period_ns: u64) -> Result<Self, InterpolationError> {
        let mut nearest_ns: Option<u64> = None;
        let mut unit_ns = 1_u64;
        for index in -9..=0_i8 {
            let value = period_ns.saturating_add(unit_ns / 2) / unit_ns;
            let value = value.clamp(1, 255);
            let found_ns = value * unit_ns;
            if found_ns == period_ns {
                let value = u8::try_from(value).unwrap_or(u8::MAX);
                return Ok(Self { value, index });
            }
            if nearest_ns.is_none_or(|best| found_ns.abs_diff(period_ns) < best.abs_diff(period_ns)) {
                nearest_ns = Some(found_ns);
            }
            unit_ns *= 10;
        }
        Err(InterpolationError::NotRepresentable {
            period_ns,
            nearest_ns: nearest_ns.unwrap_or(1_000_000),
        })
    }

    /// The period in ns.
    #[must_use]
    pub const fn period_ns(self) -> u64 {
        let exponent = self.index + 9;
        if exponent < 0 || exponent > 9 {
            return 0;
        }
        self.value as u64 * 10_u64.pow(exponent as u32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn usual_rates_are_exact() {
        for (period_ns, value, index) in [
            (1_000_000, 100, -5),
            (500_000, 50, -5),
            (250_000, 25, -5),
            (1_250_000, 125, -5),
            (4_000_000, 40, -4),
            (125_000, 125, -6),
        ] {
            let time = InterpolationTime::from_period_ns(period_ns).expect("exact");
            assert_eq!(time.period_ns(), period_ns);
            // The same time may have several representations.
            let seconds = f64::from(value) * 10_f64.powi(index);
            assert!((time.period_ns() as f64 * 1e-9 - seconds).abs() < 1e-12);
        }
    }

    #[test]
    fn periods_are_exact_or_nearest_possible_is_named() {
        for period_ns in (28_571..4_000_000).step_by(997) {
            match InterpolationTime::from_period_ns(period_ns) {
                Ok(time) => assert_eq!(time.period_ns(), period_ns),
                Err(InterpolationError::NotRepresentable { nearest_ns, .. }) => {
                    assert!(InterpolationTime::from_period_ns(nearest_ns).is_ok());
                    let off = nearest_ns.abs_diff(period_ns) as f64 / period_ns as f64;
                    assert!(off < 0.02, "{period_ns} {nearest_ns}");
                }
            }
        }
        for absurd in [0, u64::MAX, u64::MAX / 2] {
            assert!(InterpolationTime::from_period_ns(absurd).is_err());
        }
    }
}
