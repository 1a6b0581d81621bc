//! The rational control rate of a machine and of each of its axes.

mod point;

use evolvent_machine::{
    MAX_RATE_HZ, MIN_RATE_HZ, Machine, RateInput, RationalRate, figures_svg_of_axes, period_ns_of,
    rational_rate,
};
use serde_json::{Value, json};

pub use point::{ChordPoint, ChordQuestion, ChordQuestionError};

use crate::error::AnalysisError;

/// The rational control rate: the rate at which, under the machine's limits, no chord between two setpoints
/// deviates from the curve by more than the permitted error (docs/theory-control-rate.md).
#[derive(Clone, Debug)]
pub struct RateReport {
    machine: Option<String>,
    input: RateInput,
    rate: RationalRate,
    /// The limits of each linear axis alone.
    axis_inputs: Vec<(char, RateInput)>,
    /// The rational control rate of each linear axis alone.
    axes: Vec<(char, RationalRate)>,
}

impl RateReport {
    /// Computes the rates for limits; with a machine, also for each of its linear axes alone.
    ///
    /// # Errors
    /// A limit that is not positive, or no limit at all.
    pub fn new(machine: Option<&Machine>, input: &RateInput) -> Result<Self, AnalysisError> {
        let rate = rational_rate(input).map_err(AnalysisError::input)?;
        let axis_inputs = machine.map_or_else(Vec::new, |machine| axis_inputs(machine, input));
        let axes = axis_inputs
            .iter()
            .filter_map(|(letter, input)| Some((*letter, rational_rate(input).ok()?)))
            .collect();
        Ok(Self {
            machine: machine.map(|machine| machine.name.clone()),
            input: *input,
            rate,
            axis_inputs,
            axes,
        })
    }

    fn name(&self) -> &str {
        self.machine.as_deref().unwrap_or("given limits")
    }

    /// Permitted feed over radius, rate over feed and rate over acceleration as one SVG.
    ///
    /// # Errors
    /// The figures cannot be drawn.
    pub fn svg(&self) -> Result<String, AnalysisError> {
        figures_svg_of_axes(&self.input, &self.axis_inputs, self.name()).map_err(AnalysisError::failed)
    }

    /// All numbers as a JSON object; unlimited values are null.
    #[must_use]
    pub fn json(&self) -> Value {
        let (input, rate) = (&self.input, &self.rate);
        // Unlimited numbers are null.
        let limit = |value: f64| {
            if value.is_finite() {
                json!(value)
            } else {
                Value::Null
            }
        };
        let axes: Vec<_> = self
            .axes
            .iter()
            .map(|(letter, rate)| {
                json!({
                    "axis": letter.to_string(),
                    "rate_hz": rate.rate_hz,
                    "radius_mm": rate.radius_mm,
                    "feed_mm_min": rate.feed_mm_min,
                    "limited_by": rate.limited_by.as_str(),
                })
            })
            .collect();
        json!({
            "machine": self.machine,
            "rate_hz": rate.rate_hz,
            "period_ns": rate.period_ns,
            "radius_mm": rate.radius_mm,
            "feed_mm_min": rate.feed_mm_min,
            "limited_by": rate.limited_by.as_str(),
            "and_by": rate.and_by.map(|limit| limit.as_str()),
            "loop_rate_hz": fitted(rate).0,
            "loop_period_ns": fitted(rate).1,
            "max_feed_mm_min": limit(input.max_feed_mm_s * 60.0),
            "acceleration_mm_s2": limit(input.acceleration_mm_s2),
            "jerk_mm_s3": limit(input.jerk_mm_s3),
            "increments_per_mm": input.increments_per_mm,
            "permitted_error_increments": input.permitted_error_increments,
            "min_radius_mm": input.min_radius_mm,
            "axes": axes,
        })
    }

    /// All numbers as a table.
    #[must_use]
    pub fn text(&self) -> String {
        let (name, input, rate) = (self.name(), &self.input, &self.rate);
        let limit = |value: f64, unit: &str| {
            if value.is_finite() {
                let digits = format!("{value:.6}");
                format!("{} {unit}", digits.trim_end_matches('0').trim_end_matches('.'))
            } else {
                "not limited".to_owned()
            }
        };
        let by = match rate.and_by {
            Some(below) => format!(
                "{}, and {} at smaller radii",
                rate.limited_by.as_str(),
                below.as_str()
            ),
            None => rate.limited_by.as_str().to_owned(),
        };
        let mut lines = vec![
            format!(
                "{name}: rational control rate {:.2} Hz, period {} ns",
                rate.rate_hz, rate.period_ns
            ),
            format!("  needed at radius     {:.3} mm", rate.radius_mm),
            format!(
                "  with a feed of       {:.1} mm/min, limited by {by}",
                rate.feed_mm_min
            ),
            format!(
                "  largest feed         {}",
                limit(input.max_feed_mm_s * 60.0, "mm/min")
            ),
            format!(
                "  largest acceleration {}",
                limit(input.acceleration_mm_s2 / 1000.0, "m/s2")
            ),
            format!(
                "  largest jerk         {}",
                limit(input.jerk_mm_s3 / 1000.0, "m/s3")
            ),
            format!("  grid                 {} increments/mm", input.increments_per_mm),
            format!(
                "  permitted error      {} increments",
                input.permitted_error_increments
            ),
            format!("  smallest radius      {} mm", input.min_radius_mm),
        ];
        for (letter, rate) in &self.axes {
            lines.push(format!(
                "  axis {letter} alone         {:.2} Hz, at {:.3} mm and {:.1} mm/min, limited by {}",
                rate.rate_hz,
                rate.radius_mm,
                rate.feed_mm_min,
                rate.limited_by.as_str()
            ));
        }
        if rate.rate_hz < MIN_RATE_HZ {
            lines.push(format!(
                "  the minimum rate of the loop is {MIN_RATE_HZ} Hz, so the loop would run at that rate"
            ));
        } else if rate.rate_hz > MAX_RATE_HZ {
            lines.push(format!(
                "  the maximum rate of the loop is {MAX_RATE_HZ} Hz: there the feed in curves is reduced to \
                 keep the error"
            ));
        }
        lines.push(String::new());
        lines.join("\n")
    }
}

/// The limits of each linear axis alone.
fn axis_inputs(machine: &Machine, input: &RateInput) -> Vec<(char, RateInput)> {
    let linear = machine.axes.iter().filter(|axis| !axis.letter.is_rotary());
    let alone = linear.map(|axis| {
        let input = RateInput {
            max_feed_mm_s: machine
                .max_feed_mm_s
                .unwrap_or(f64::INFINITY)
                .min(axis.max_velocity),
            acceleration_mm_s2: axis.max_acceleration,
            jerk_mm_s3: axis.max_jerk,
            ..*input
        };
        (axis.letter.letter(), input)
    });
    alone.collect()
}

/// The rate and period of the control loop, within its bounds.
fn fitted(rate: &RationalRate) -> (f64, u64) {
    let hz = rate.rate_hz.clamp(MIN_RATE_HZ, MAX_RATE_HZ);
    (hz, period_ns_of(hz))
}
