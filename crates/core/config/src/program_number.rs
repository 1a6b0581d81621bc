//! Numbers in generated part programs.

use std::fmt::{self, Display, Formatter};

/// A number in a part program: decimal, never with an exponent, a negative zero or zeros at its end.
///
/// ```
/// use evolvent_config::ProgramNumber;
///
/// assert_eq!(ProgramNumber::exact(0.1).to_string(), "0.1");
/// assert_eq!(ProgramNumber::rounded(-12.5000004, 4).to_string(), "-12.5");
/// assert_eq!(ProgramNumber::without_noise(-1.8e-14).to_string(), "0");
/// assert_eq!(ProgramNumber::without_noise(39.99999999999999).to_string(), "40");
/// assert_eq!(ProgramNumber::without_noise(-0.6286620252129866).to_string(), "-0.6286620252129866");
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProgramNumber {
    value: f64,
    decimals: Option<usize>,
}

impl ProgramNumber {
    /// The shortest decimal that reads back as the same bits: for numbers given by the user, and numbers from
    /// which others follow.
    #[must_use]
    pub const fn exact(value: f64) -> Self {
        Self {
            value,
            decimals: None,
        }
    }

    /// Nine decimals if they differ from the value only by rounding errors, otherwise all digits: for
    /// computed coordinates, which have to end exactly where the next curve begins.
    #[must_use]
    pub fn without_noise(value: f64) -> Self {
        let short = (value * 1e9).round() * 1e-9;
        Self {
            value,
            decimals: ((value - short).abs() <= 1e-12).then_some(9),
        }
    }

    /// Rounded to this number of decimals: for coordinates that need no more.
    #[must_use]
    pub const fn rounded(value: f64, decimals: usize) -> Self {
        Self {
            value,
            decimals: Some(decimals),
        }
    }
}

impl Display for ProgramNumber {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let text = match self.decimals {
            Some(decimals) => format!("{:.decimals$}", self.value),
            None => self.value.to_string(),
        };
        let text = if text.contains('.') {
            text.trim_end_matches('0').trim_end_matches('.')
        } else {
            &text
        };
        f.write_str(if text == "-0" { "0" } else { text })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn program_numbers_are_plain_decimals() {
        for (value, exact, rounded) in [
            (0.0, "0", "0"),
            (-0.0, "0", "0"),
            (-1.83e-16, "-0.000000000000000183", "0"),
            (-0.00004, "-0.00004", "0"),
            (-0.00006, "-0.00006", "-0.0001"),
            (100.0, "100", "100"),
            (-1200.0, "-1200", "-1200"),
            (0.30000000000000004, "0.30000000000000004", "0.3"),
            (2.50004, "2.50004", "2.5"),
            (1e21, "1000000000000000000000", "1000000000000000000000"),
            (1e-7, "0.0000001", "0"),
        ] {
            assert_eq!(ProgramNumber::exact(value).to_string(), exact);
            assert_eq!(ProgramNumber::rounded(value, 4).to_string(), rounded);
        }
        assert_eq!(ProgramNumber::rounded(-3.7, 0).to_string(), "-4");
    }
}
