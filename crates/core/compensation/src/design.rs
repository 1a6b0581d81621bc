//! From the errors of a machine to the limits that remain for the planner.

use evolvent_path::{AXES, Axes, AxisLetter};

use crate::axis_compensation::AxisCompensation;
use crate::compensation::Compensation;
use crate::screw_table::ScrewTable;
use crate::squareness::{LINEAR, Squareness};

/// Fraction of each limit that the take-up of the backlash may use. Tuned: 0.05 to 0.3; the take-up time
/// grows with the inverse cube root of the fraction, the time of a program with the fraction. At 0.02 mm and
/// 200 m/s3 the take-up lasts 48 ms.
const TAKE_UP_FRACTION: f64 = 0.1;
/// Fraction of each limit that must remain for the ideal motion. A table that needs more has a wrong point.
const MIN_REMAINING: f64 = 0.5;
/// Maximum slope of a correction. A steeper table is in another unit.
const MAX_SLOPE: f64 = 0.05;
/// Maximum squareness error, 10 mm/m.
const MAX_SQUARENESS: f64 = 0.01;

/// Maximum velocity, acceleration and jerk of an axis, in mm or degrees and seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisLimits {
    /// mm/s or degrees/s.
    pub velocity: f64,
    /// mm/s2 or degrees/s2.
    pub acceleration: f64,
    /// mm/s3 or degrees/s3.
    pub jerk: f64,
}

/// An offset from a temperature model outside the core.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThermalSettings {
    /// Maximum magnitude, mm or degrees.
    pub max_offset: f64,
    /// Maximum rate of change, mm/s or degrees/s.
    pub max_offset_velocity: f64,
}

/// The geometric errors of an axis. Lengths in mm or degrees.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AxisErrors {
    /// Lost motion at reversal, in addition to the table.
    pub backlash: f64,
    /// Corrections over the position.
    pub table: Option<ScrewTable>,
    /// Distance by which the axis must move back to count as reversed.
    pub hysteresis: f64,
    /// Thermal offset, if the axis has one.
    pub thermal: Option<ThermalSettings>,
}

impl AxisErrors {
    fn is_none(&self) -> bool {
        self.backlash == 0.0 && self.table.is_none() && self.thermal.is_none()
    }
}

/// The geometric errors of a machine.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MachineErrors {
    /// Errors of each axis.
    pub axes: [AxisErrors; AXES],
    /// Squareness errors between X, Y and Z.
    pub squareness: Squareness,
}

/// A limit of an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Excess {
    /// Velocity.
    Velocity,
    /// Acceleration.
    Acceleration,
    /// Jerk.
    Jerk,
}

/// The reason why errors cannot be corrected within the limits.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum DesignError {
    /// The corrections need more than half of a limit.
    #[error("axis {}: the corrections leave only {remaining:.6} of the {quantity:?} limit {limit} for the \
             motion{}",
        axis.letter(), near(*.position))]
    Reserve {
        /// The axis.
        axis: AxisLetter,
        /// The limit.
        quantity: Excess,
        /// Value of the limit.
        limit: f64,
        /// What remains of the limit for the ideal motion.
        remaining: f64,
        /// Position at which the table is roughest.
        position: Option<f64>,
    },
    /// A correction is steeper than that of any screw.
    #[error("axis {}: near {position} the table changes by {slope:.4} mm per mm; at most {MAX_SLOPE} can be \
             an error of a screw",
        axis.letter())]
    Slope {
        /// The axis.
        axis: AxisLetter,
        /// The slope.
        slope: f64,
        /// Its position.
        position: f64,
    },
    /// A number is negative, not finite, or too large.
    #[error("{what}: {value} is out of range, 0 to {max}")]
    Value {
        /// Name of the quantity.
        what: &'static str,
        /// Its value.
        value: f64,
        /// The maximum.
        max: f64,
    },
}

fn near(position: Option<f64>) -> String {
    position.map_or_else(String::new, |position| {
        format!("; the table is roughest near {position:.4}")
    })
}

/// The corrections of a machine, and the limits that remain for the planner.
#[derive(Clone, Debug, PartialEq)]
pub struct Design {
    errors: MachineErrors,
    /// Length of one moving average, s; `None` for an axis without corrections of its own.
    average_s: [Option<f64>; AXES],
    planner_limits: [Option<AxisLimits>; AXES],
    max: Axes,
}

/// Maximum magnitudes of a correction and of its derivatives by the position.
#[derive(Clone, Copy, Debug, Default)]
struct Roughness {
    /// Of the complete correction, in either direction.
    whole: [f64; 4],
    /// Of half of the difference between the directions, including the backlash.
    half: [f64; 4],
}

impl Design {
    /// Designs the corrections for these errors and the limits of the existing axes.
    ///
    /// # Errors
    /// [`DesignError`] if a number is out of range, or if the corrections leave too little of a limit.
    pub fn new(errors: &MachineErrors, limits: &[Option<AxisLimits>; AXES]) -> Result<Self, DesignError> {
        check(errors)?;
        let mut average_s = [None; AXES];
        let mut slides = *limits;
        let mut max = Axes::zeros();
        for i in 0..AXES {
            let (Some(limit), errors) = (limits[i], &errors.axes[i]) else {
                continue;
            };
            if errors.is_none() {
                continue;
            }
            let rough = roughness(errors);
            let time_s = average_time(errors, &rough, &limit);
            average_s[i] = Some(time_s);
            slides[i] = Some(remaining(AxisLetter::ALL[i], errors, &rough, &limit, time_s)?);
            max[i] = rough.whole[0] + errors.thermal.map_or(0.0, |thermal| thermal.max_offset);
        }
        let mut planner_limits = slides;
        for i in 0..LINEAR {
            let (Some(limit), Some(slide)) = (limits[i], slides[i]) else {
                continue;
            };
            let mut left = slide;
            for j in 0..LINEAR {
                let (coupling, Some(other)) = (errors.squareness.coupling(i, j), slides[j]) else {
                    continue;
                };
                left.velocity -= coupling * other.velocity;
                left.acceleration -= coupling * other.acceleration;
                left.jerk -= coupling * other.jerk;
            }
            enough(AxisLetter::ALL[i], &limit, &left, None)?;
            planner_limits[i] = Some(left);
        }
        Ok(Self {
            errors: errors.clone(),
            average_s,
            planner_limits,
            max,
        })
    }

    /// Whether nothing is corrected.
    #[must_use]
    pub fn is_none(&self) -> bool {
        self.errors.squareness.is_none() && self.average_s.iter().all(Option::is_none)
    }

    /// The limits for the ideal motion of an axis; `None` if the axis does not exist.
    #[must_use]
    pub fn planner_limits(&self, axis: usize) -> Option<AxisLimits> {
        self.planner_limits[axis]
    }

    /// Maximum correction of each axis without the squareness terms, mm or degrees.
    #[must_use]
    pub fn largest_correction(&self) -> Axes {
        self.max
    }

    /// Motion of `axis` per motion of axis `other` that the squareness correction causes.
    #[must_use]
    pub fn coupling(&self, axis: usize, other: usize) -> f64 {
        self.errors.squareness.coupling(axis, other)
    }

    /// Time in which an axis takes up its backlash, s.
    #[must_use]
    pub fn take_up_s(&self, axis: usize) -> Option<f64> {
        self.average_s[axis].map(|average_s| 3.0 * average_s)
    }

    /// Creates the compensation for a cycle of `period_s`, at rest at the ideal `position`; the direction of
    /// each axis is unknown. Allocates.
    #[must_use]
    pub fn compensation(&self, period_s: f64, position: Axes) -> Compensation {
        let slides = self.errors.squareness.slides(&position);
        let axes = std::array::from_fn(|i| {
            self.average_s[i].map(|average_s| {
                let n = (average_s / period_s).ceil() as usize;
                AxisCompensation::new(&self.errors.axes[i], n, period_s, slides[i])
            })
        });
        Compensation::new(self.errors.squareness, axes)
    }
}

fn check(errors: &MachineErrors) -> Result<(), DesignError> {
    let within = |what, value: f64, max: f64| {
        if (0.0..=max).contains(&value) {
            Ok(())
        } else {
            Err(DesignError::Value { what, value, max })
        }
    };
    for axis in &errors.axes {
        within("backlash", axis.backlash, 10.0)?;
        within("hysteresis", axis.hysteresis, 1.0)?;
        if let Some(thermal) = axis.thermal {
            within("maximum thermal offset", thermal.max_offset, 10.0)?;
            within("rate of the thermal offset", thermal.max_offset_velocity, 1.0)?;
        }
    }
    let Squareness { xy, xz, yz } = errors.squareness;
    for angle in [xy, xz, yz] {
        within("squareness", angle.abs(), MAX_SQUARENESS)?;
    }
    Ok(())
}

fn roughness(errors: &AxisErrors) -> Roughness {
    let mut rough = Roughness::default();
    let table = errors.table.as_ref();
    if let Some(half) = table.and_then(ScrewTable::half_difference) {
        rough.half = half.maxima().map(|(max, _)| max);
    }
    rough.half[0] += 0.5 * errors.backlash;
    rough.whole = rough.half;
    if let Some(table) = table {
        for (whole, (mean, _)) in rough.whole.iter_mut().zip(table.mean().maxima()) {
            *whole += mean;
        }
    }
    rough
}

/// Position at which the correction of a table is steepest (order 1) or roughest (higher orders).
fn worst_position(errors: &AxisErrors, order: usize) -> Option<f64> {
    let table = errors.table.as_ref()?;
    let mean = table.mean().maxima()[order];
    let half = table
        .half_difference()
        .map_or((0.0, 0.0), |half| half.maxima()[order]);
    Some(if mean.0 >= half.0 { mean.1 } else { half.1 })
}

/// The shortest averaging time within the limits. An axis without backlash needs it only for the thermal
/// offset.
fn average_time(errors: &AxisErrors, rough: &Roughness, limit: &AxisLimits) -> f64 {
    let step = rough.half[0];
    let rate = errors.thermal.map_or(0.0, |thermal| thermal.max_offset_velocity);
    let part = |limit: f64| TAKE_UP_FRACTION * limit;
    [
        1.5 * step / part(limit.velocity),
        (4.0 * step / part(limit.acceleration)).sqrt(),
        (8.0 * step / part(limit.jerk)).cbrt(),
        2.0 * rate / part(limit.acceleration),
        (4.0 * rate / part(limit.jerk)).sqrt(),
    ]
    .into_iter()
    .fold(0.0, f64::max)
}

/// The part of an axis' limits that remains, by the chain rule for `y + m(y) + b g(y) + o`.
fn remaining(
    axis: AxisLetter,
    errors: &AxisErrors,
    rough: &Roughness,
    limit: &AxisLimits,
    time_s: f64,
) -> Result<AxisLimits, DesignError> {
    let [_, slope, curve, twist] = rough.whole;
    let [step, step_slope, step_curve, _] = rough.half;
    if slope > MAX_SLOPE {
        return Err(DesignError::Slope {
            axis,
            slope,
            position: worst_position(errors, 1).unwrap_or(0.0),
        });
    }
    let by = |factor: f64, power: i32| {
        if time_s > 0.0 {
            factor / time_s.powi(power)
        } else {
            0.0
        }
    };
    let (b1, b2, b3) = (by(1.5, 1), by(4.0, 2), by(8.0, 3));
    let rate = errors.thermal.map_or(0.0, |thermal| thermal.max_offset_velocity);
    let v = (limit.velocity - b1 * step - rate) / (1.0 + slope);
    let a = (limit.acceleration - curve * v * v - 2.0 * b1 * step_slope * v - b2 * step - by(2.0, 1) * rate)
        / (1.0 + slope);
    let j = (limit.jerk
        - 3.0 * curve * v * a
        - twist * v * v * v
        - 3.0 * b1 * (step_curve * v * v + step_slope * a)
        - 3.0 * b2 * step_slope * v
        - b3 * step
        - by(4.0, 2) * rate)
        / (1.0 + slope);
    let left = AxisLimits {
        velocity: v,
        acceleration: a,
        jerk: j,
    };
    enough(axis, limit, &left, worst_position(errors, 3))?;
    Ok(left)
}

fn enough(
    axis: AxisLetter,
    limit: &AxisLimits,
    left: &AxisLimits,
    position: Option<f64>,
) -> Result<(), DesignError> {
    for (quantity, limit, remaining) in [
        (Excess::Velocity, limit.velocity, left.velocity),
        (Excess::Acceleration, limit.acceleration, left.acceleration),
        (Excess::Jerk, limit.jerk, left.jerk),
    ] {
        if remaining.is_nan() || remaining < MIN_REMAINING * limit {
            return Err(DesignError::Reserve {
                axis,
                quantity,
                limit,
                remaining,
                position,
            });
        }
    }
    Ok(())
}
