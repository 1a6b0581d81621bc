//! The check of feedback on arrival: a bridge's message is used only if it can be true.
//!
//! A message that fails is not used at all. One invalid field means that sender and receiver disagree, so its
//! other fields are not reliable either.

use evolvent_path::AxisMask;
use evolvent_wire::{AXES, Feedback};

use crate::alarm::DriveAlarm;

/// Homing increments the datum one by one, so it never exceeds this.
const MAX_DATUM: u64 = u32::MAX as u64;
/// A velocity is differentiated from encoder steps and a collision adds to it: plausible up to this multiple
/// of the axis's limit.
const VELOCITY_FACTOR: f64 = 10.0;
/// Drives deliver a few times their rated torque.
const MAX_TORQUE_RATIO: f64 = 100.0;
/// A phase error above a second is implausible.
const MAX_PHASE_ERROR_NS: u64 = 1_000_000_000;
/// An axis that was never referenced counts from anywhere near its zero: the far end of its travel, plus this
/// multiple of the travel.
const REACH_FACTOR: f64 = 2.0;

/// The possible values of a machine's feedback. Lengths are mm or degrees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeedbackBounds {
    /// Bit i set: the machine has axis i. Other axes are ignored.
    pub axes: AxisMask,
    /// Maximum lead of `time_ns` over the receiver's clock, ns: the receiver may have been suspended since it
    /// read its clock, and a bridge may convert a fieldbus time.
    pub ahead_ns: u64,
    /// Largest distance of a position from zero.
    pub reach: [f64; AXES],
    /// Maximum commanded velocity of the axis, per second.
    pub max_velocity: [f64; AXES],
}

impl FeedbackBounds {
    /// Bounds for a machine of which only the axes are known: 20 ms, 1 km, 1 km/s.
    #[must_use]
    pub const fn new(axes: AxisMask) -> Self {
        Self {
            axes,
            ahead_ns: 20_000_000,
            reach: [1e6; AXES],
            max_velocity: [1e6; AXES],
        }
    }

    /// Sets travel and velocity limit of one axis.
    pub fn set_axis(&mut self, axis: usize, travel: [f64; 2], max_velocity: f64) {
        let [min, max] = travel;
        if axis < AXES {
            self.reach[axis] = min.abs().max(max.abs()) + REACH_FACTOR * (max - min).abs();
            self.max_velocity[axis] = max_velocity;
        }
    }

    /// Checks every field of a message that has just been received, at `now_ns` of the clock of `time_ns`.
    ///
    /// # Errors
    /// The first impossible field: [`DriveAlarm::NotFinite`], [`DriveAlarm::AheadOfTime`] or
    /// [`DriveAlarm::Unbelievable`].
    pub fn check(&self, now_ns: u64, feedback: &Feedback) -> Result<(), DriveAlarm> {
        if feedback.time_ns > now_ns.saturating_add(self.ahead_ns) {
            return Err(DriveAlarm::AheadOfTime {
                ahead_ns: feedback.time_ns - now_ns,
            });
        }
        let all_axes = AxisMask::ALL.bits();
        let masks = [
            ("axes_mask", feedback.axes_mask),
            ("home_switch_mask", feedback.home_switch_mask),
            ("positive_limit_mask", feedback.positive_limit_mask),
            ("negative_limit_mask", feedback.negative_limit_mask),
            ("absolute_mask", feedback.absolute_mask),
        ];
        for (field, mask) in masks {
            within(field, None, f64::from(mask), f64::from(all_axes))?;
        }
        let states = evolvent_wire::BRIDGE_STATES.len() as f64 - 1.0;
        within("bridge_state", None, f64::from(feedback.bridge_state), states)?;
        within("datum", None, feedback.datum as f64, MAX_DATUM as f64)?;
        within(
            "error_code",
            None,
            f64::from(feedback.error_code),
            f64::from(u16::MAX),
        )?;
        let phase = feedback.phase_error_ns.unsigned_abs();
        within("phase_error_ns", None, phase as f64, MAX_PHASE_ERROR_NS as f64)?;
        // NaN means that no pulse has been latched.
        if !feedback.index_position.is_nan() {
            let reach = self.axes.axes().map(|axis| self.reach[axis]).fold(0.0, f64::max);
            within("index_position", None, feedback.index_position, reach)?;
        }
        let here = self.axes & AxisMask::from_bits(feedback.axes_mask);
        for axis in here.axes() {
            let status_word = f64::from(feedback.status_word[axis]);
            within("status_word", Some(axis), status_word, f64::from(u16::MAX))?;
            // A following error is the difference of two positions.
            for (field, value, bound) in [
                ("position", feedback.position[axis], self.reach[axis]),
                (
                    "velocity",
                    feedback.velocity[axis],
                    VELOCITY_FACTOR * self.max_velocity[axis],
                ),
                (
                    "following_error",
                    feedback.following_error[axis],
                    2.0 * self.reach[axis],
                ),
                ("torque_ratio", feedback.torque_ratio[axis], MAX_TORQUE_RATIO),
            ] {
                if !value.is_finite() {
                    return Err(DriveAlarm::NotFinite { axis });
                }
                within(field, Some(axis), value, bound)?;
            }
        }
        Ok(())
    }
}

fn within(field: &'static str, axis: Option<usize>, value: f64, bound: f64) -> Result<(), DriveAlarm> {
    if value.abs() <= bound {
        return Ok(());
    }
    Err(DriveAlarm::Unbelievable {
        field,
        axis,
        value,
        bound,
    })
}
