//! Chord and chord error for a rate, feed and radius, or the missing one of the three.

use std::fmt::Write as _;

use evolvent_config::plain;
use evolvent_machine::{
    RateInput, chord_error_increments, chord_feed_limit_mm_s, max_chord_mm, min_radius_for_chord_mm, rate_for,
};
use serde_json::{Value, json};

/// One point of the paper's diagrams: two of the three values yield the third at the permitted error, all
/// three yield the error.
#[derive(Clone, Copy, Debug, Default)]
pub struct ChordQuestion {
    /// Control rate, Hz.
    pub rate_hz: Option<f64>,
    /// Feed, mm/min.
    pub feed_mm_min: Option<f64>,
    /// Radius of curvature of the path, mm.
    pub radius_mm: Option<f64>,
}

/// Why a point could not be computed.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum ChordQuestionError {
    /// A number that is not above 0, or too large.
    #[error("{name} {} is impossible: give a number above 0 and up to {max:e}", plain(*.value))]
    Impossible {
        /// Name of the number: `rate`, `feed`, `radius`, `increments per mm` or `permitted error`.
        name: &'static str,
        /// The value given.
        value: f64,
        /// The maximum accepted.
        max: f64,
    },
    /// Fewer than two of the three values.
    #[error("give two of rate, feed and radius for the third, or all three for the chord error")]
    TooFew,
}

/// The result for one rate, feed and radius.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChordPoint {
    rate_hz: f64,
    feed_mm_min: f64,
    radius_mm: f64,
    /// The value that was computed.
    found: Option<&'static str>,
    chord_mm: f64,
    error_increments: f64,
    longest_chord_mm: f64,
    increments_per_mm: f64,
    permitted: f64,
}

impl ChordQuestion {
    /// Whether any of the three values is given.
    #[must_use]
    pub fn is_given(self) -> bool {
        self.rate_hz.is_some() || self.feed_mm_min.is_some() || self.radius_mm.is_some()
    }

    /// Computes the point with the increments and the permitted error of `input`.
    ///
    /// # Errors
    /// Fewer than two of the three values, or invalid numbers.
    pub fn point(self, input: &RateInput) -> Result<ChordPoint, ChordQuestionError> {
        for (name, value, max) in [
            ("rate", self.rate_hz, 1e9),
            ("feed", self.feed_mm_min, 1e9),
            ("radius", self.radius_mm, 1e9),
            ("increments per mm", Some(input.increments_per_mm), 1e9),
            ("permitted error", Some(input.permitted_error_increments), 1e6),
        ] {
            if let Some(value) = value
                && !(value > 0.0 && value <= max)
            {
                return Err(ChordQuestionError::Impossible { name, value, max });
            }
        }
        let (k, permitted) = (input.increments_per_mm, input.permitted_error_increments);
        let (rate_hz, feed_mm_min, radius_mm, found) = match (self.rate_hz, self.feed_mm_min, self.radius_mm)
        {
            (Some(rate), Some(feed), Some(radius)) => (rate, feed, radius, None),
            (Some(rate), None, Some(radius)) => {
                let feed = chord_feed_limit_mm_s(rate, 1.0 / radius, k, permitted) * 60.0;
                (rate, feed, radius, Some("feed"))
            }
            (None, Some(feed), Some(radius)) => (
                rate_for(feed / 60.0, radius, k, permitted),
                feed,
                radius,
                Some("rate"),
            ),
            (Some(rate), Some(feed), None) => {
                let radius = min_radius_for_chord_mm(feed / 60.0 / rate, k, permitted);
                (rate, feed, radius, Some("radius"))
            }
            _ => return Err(ChordQuestionError::TooFew),
        };
        let chord_mm = feed_mm_min / 60.0 / rate_hz;
        Ok(ChordPoint {
            rate_hz,
            feed_mm_min,
            radius_mm,
            found,
            chord_mm,
            // Without a limit there is no point at which an error could be stated.
            error_increments: if chord_mm.is_finite() {
                chord_error_increments(feed_mm_min / 60.0, rate_hz, radius_mm, k)
            } else {
                f64::NAN
            },
            longest_chord_mm: max_chord_mm(radius_mm, k, permitted),
            increments_per_mm: k,
            permitted,
        })
    }
}

impl ChordPoint {
    fn is_permitted(&self) -> bool {
        // The computed value is on the limit, except for rounding.
        self.found.is_some() || self.error_increments <= self.permitted
    }

    /// As a JSON object; infinite values are null.
    #[must_use]
    pub fn json(&self) -> Value {
        let number = |value: f64| {
            if value.is_finite() {
                json!(value)
            } else {
                Value::Null
            }
        };
        json!({
            "rate_hz": number(self.rate_hz),
            "feed_mm_min": number(self.feed_mm_min),
            "radius_mm": number(self.radius_mm),
            "found": self.found,
            "chord_mm": number(self.chord_mm),
            "chord_increments": number(self.chord_mm * self.increments_per_mm),
            "chord_error_increments": number(self.error_increments),
            "chord_error_mm": number(self.error_increments / self.increments_per_mm),
            "longest_chord_mm": number(self.longest_chord_mm),
            "increments_per_mm": self.increments_per_mm,
            "permitted_error_increments": self.permitted,
            "is_permitted": self.is_permitted(),
        })
    }

    /// As a table.
    #[must_use]
    pub fn text(&self) -> String {
        let mut text = String::new();
        let mark = |name: &str| if self.found == Some(name) { "  (found)" } else { "" };
        let number = |value: f64, digits: usize| {
            if value.is_finite() {
                format!("{value:.digits$}")
            } else {
                "any".to_owned()
            }
        };
        // Writing to a string cannot fail.
        let _ = writeln!(text, "one point, at {} increments/mm", self.increments_per_mm);
        let _ = writeln!(
            text,
            "  control rate         {} Hz{}",
            number(self.rate_hz, 3),
            mark("rate")
        );
        let _ = writeln!(
            text,
            "  feed                 {} mm/min{}",
            number(self.feed_mm_min, 3),
            mark("feed")
        );
        let _ = writeln!(
            text,
            "  radius               {} mm{}",
            number(self.radius_mm, 6),
            mark("radius")
        );
        let _ = writeln!(
            text,
            "  step                 {} mm, {} increments (at most {} mm on this radius)",
            number(self.chord_mm, 6),
            number(self.chord_mm * self.increments_per_mm, 3),
            number(self.longest_chord_mm, 6)
        );
        let _ = writeln!(
            text,
            "  chord error          {} increments, {} um; {} permitted: {}",
            number(self.error_increments, 6),
            number(1e3 * self.error_increments / self.increments_per_mm, 6),
            self.permitted,
            if self.is_permitted() { "kept" } else { "EXCEEDED" }
        );
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn input(k: f64) -> RateInput {
        RateInput {
            max_feed_mm_s: f64::INFINITY,
            acceleration_mm_s2: f64::INFINITY,
            jerk_mm_s3: f64::INFINITY,
            increments_per_mm: k,
            permitted_error_increments: 1.0,
            min_radius_mm: 0.25,
        }
    }

    /// Equation (1) as printed in the paper, evaluated with sufficient precision.
    fn printed(rate: f64, feed: f64, radius: f64, k: f64) -> f64 {
        let (h, r) = (feed * k / (2.0 * 60.0 * rate), radius * k);
        r - (r * r - h * h).sqrt()
    }

    #[test]
    fn the_error_is_that_of_the_printed_equation_1() {
        for (rate, feed, radius) in [
            (350.0, 11_548.0, 37.76),
            (500.0, 6000.0, 0.25),
            (1000.0, 1000.0, 2.0),
        ] {
            let args = ChordQuestion {
                rate_hz: Some(rate),
                feed_mm_min: Some(feed),
                radius_mm: Some(radius),
            };
            let point = args.point(&input(1000.0)).unwrap();
            let expected = printed(rate, feed, radius, 1000.0);
            assert!(
                (point.error_increments / expected - 1.0).abs() < 1e-6,
                "{point:?}"
            );
            assert!((point.chord_mm - feed / 60.0 / rate).abs() < 1e-12);
            assert_eq!(point.is_permitted(), expected <= 1.0);
        }
    }

    #[test]
    fn rate_feed_and_radius_each_follow_from_the_others() {
        for (rate, feed, k) in [
            (500.0, 6000.0, 1000.0),
            (3500.0, 11_548.0, 1e5),
            (250.0, 30_000.0, 1e4),
        ] {
            let (all, given) = (ChordQuestion::default(), input(k));
            let radius = ChordQuestion {
                rate_hz: Some(rate),
                feed_mm_min: Some(feed),
                ..all
            };
            let radius = radius.point(&given).unwrap();
            // By (1) the error there is the permitted one.
            assert!(
                (printed(rate, feed, radius.radius_mm, k) - 1.0).abs() < 1e-3,
                "{radius:?}"
            );
            let back = ChordQuestion {
                rate_hz: Some(rate),
                radius_mm: Some(radius.radius_mm),
                ..all
            };
            assert!((back.point(&given).unwrap().feed_mm_min / feed - 1.0).abs() < 1e-9);
            let back = ChordQuestion {
                feed_mm_min: Some(feed),
                radius_mm: Some(radius.radius_mm),
                ..all
            };
            assert!((back.point(&given).unwrap().rate_hz / rate - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn one_number_alone_or_a_wrong_one_is_refused() {
        let one = ChordQuestion {
            feed_mm_min: Some(1000.0),
            ..ChordQuestion::default()
        };
        assert_eq!(one.point(&input(1000.0)), Err(ChordQuestionError::TooFew));
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let args = ChordQuestion {
                feed_mm_min: Some(bad),
                rate_hz: Some(500.0),
                ..ChordQuestion::default()
            };
            let Err(ChordQuestionError::Impossible { name, .. }) = args.point(&input(1000.0)) else {
                panic!("{bad}")
            };
            assert_eq!(name, "feed");
        }
    }
}
