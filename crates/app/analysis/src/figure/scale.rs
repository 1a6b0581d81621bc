//! Conversion of values to pixels, and tick labels.

/// A linear scale.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scale {
    low: f64,
    high: f64,
    from: f64,
    per: f64,
}

impl Scale {
    /// `low` at pixel `from`, `high` at pixel `to`.
    pub(crate) fn new(low: f64, high: f64, from: f64, to: f64) -> Self {
        Self {
            low,
            high,
            from,
            per: (to - from) / (high - low).max(1e-300),
        }
    }

    pub(crate) fn at(&self, value: f64) -> f64 {
        self.from + (value - self.low) * self.per
    }

    pub(crate) fn low(&self) -> f64 {
        self.low
    }

    pub(crate) fn high(&self) -> f64 {
        self.high
    }
}

/// Multiples of 1, 2 or 5 times a power of ten between `low` and `high`, about `count` of them.
pub(crate) fn nice_ticks(low: f64, high: f64, count: usize) -> Vec<f64> {
    let raw = (high - low) / count.max(1) as f64;
    if !raw.is_finite() || raw <= 0.0 {
        return Vec::new();
    }
    let power = 10_f64.powi(raw.log10().floor() as i32);
    let step = [1.0, 2.0, 5.0, 10.0]
        .into_iter()
        .map(|factor| factor * power)
        .find(|step| *step >= raw)
        .unwrap_or(10.0 * power);
    let (first, last) = ((low / step).ceil() as i64, (high / step).floor() as i64);
    (first..=last.min(first + 50))
        // Division by an integer yields the intended decimal.
        .map(|k| {
            if step < 1.0 {
                k as f64 / (1.0 / step).round()
            } else {
                k as f64 * step
            }
        })
        .collect()
}

/// A number with thin spaces between thousands and without redundant digits.
pub(crate) fn grouped(value: f64) -> String {
    // Six significant digits.
    let digits = 10_f64.powi((5 - value.abs().max(1e-9).log10().floor() as i32).clamp(0, 6));
    let text = format!("{}", (value.abs() * digits).round() / digits);
    let (whole, rest) = text.split_once('.').map_or((text.as_str(), ""), |parts| parts);
    let mut result = String::new();
    if value < 0.0 {
        result.push('\u{2212}');
    }
    for (k, digit) in whole.chars().enumerate() {
        if k > 0 && (whole.len() - k).is_multiple_of(3) && whole.len() > 4 {
            result.push('\u{2009}');
        }
        result.push(digit);
    }
    if !rest.is_empty() {
        result.push('.');
        result.push_str(rest);
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_within() {
        assert_eq!(nice_ticks(0.0, 10.0, 5), [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]);
        assert_eq!(nice_ticks(-0.34, 0.34, 4), [-0.2, 0.0, 0.2]);
        assert_eq!(nice_ticks(0.0, 3600.0, 7), [0.0, 1000.0, 2000.0, 3000.0]);
        assert!(nice_ticks(1.0, 1.0, 4).is_empty() && nice_ticks(0.0, f64::NAN, 4).is_empty());
    }

    #[test]
    fn numbers_are_grouped_from_five_digits_on() {
        assert_eq!(grouped(200_000.0), "200\u{2009}000");
        assert_eq!(grouped(5000.0), "5000");
        assert_eq!(grouped(-12_345.5), "\u{2212}12\u{2009}345.5");
        assert_eq!(grouped(0.1 + 0.2), "0.3");
        assert_eq!(grouped(1000.0 / 3.0), "333.333");
        assert_eq!(grouped(0.0), "0");
    }
}
