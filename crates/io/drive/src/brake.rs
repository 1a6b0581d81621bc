//! Braking a single axis to rest, within its acceleration and jerk.

/// Position, velocity and acceleration of one axis; mm or degrees, and s.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BrakeState {
    /// Position.
    pub position: f64,
    /// Velocity.
    pub velocity: f64,
    /// Acceleration.
    pub acceleration: f64,
}

/// The fastest stop: at most three pieces of constant jerk.
///
/// In the direction of the braking the acceleration rises with full jerk to its peak, stays there if that is
/// the limit, and falls to zero as the velocity does. An acceleration at the start that is beyond the limit,
/// or that leads beyond rest by itself, is brought back with full jerk; the velocity then overshoots zero by
/// the minimum possible.
///
/// ```
/// use evolvent_drive::{Brake, BrakeState};
///
/// // 100 mm/s at 1000 mm/s2 and 10 000 mm/s3: both ramps last a/j = 0.1 s, and a*a/j = v, so nothing lies between.
/// let start = BrakeState { velocity: 100.0, ..BrakeState::default() };
/// let brake = Brake::new(start, 1000.0, 10_000.0);
/// assert!((brake.duration_s() - 0.2).abs() < 1e-12);
///
/// // Symmetric braking takes half of the way that constant velocity would: v t / 2.
/// let end = brake.at(brake.duration_s());
/// assert!((end.position - 10.0).abs() < 1e-9);
/// assert_eq!((end.velocity, end.acceleration), (0.0, 0.0));
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Brake {
    start: BrakeState,
    jerk: [f64; 3],
    /// Durations of the pieces, s.
    time: [f64; 3],
}

impl Brake {
    /// Brakes from a state to rest. Limits are positive and finite; with an invalid limit or state the brake
    /// is at rest at the start, with duration 0.
    #[must_use]
    pub fn new(start: BrakeState, max_acceleration: f64, max_jerk: f64) -> Self {
        let usable = |limit: f64| limit.is_finite() && limit > 0.0;
        let known =
            start.position.is_finite() && start.velocity.is_finite() && start.acceleration.is_finite();
        if !usable(max_acceleration) || !usable(max_jerk) || !known {
            return Self::at_once(start);
        }
        // Velocity that remains when the acceleration is reduced to zero with full jerk.
        let coasting = start.velocity + start.acceleration * start.acceleration.abs() / (2.0 * max_jerk);
        let direction = if coasting > 0.0 { -1.0 } else { 1.0 };
        let velocity = direction * start.velocity;
        let acceleration = direction * start.acceleration;
        let jerk = direction * max_jerk;
        // Already beyond the limit at the start: it only decreases.
        let limit = max_acceleration.max(acceleration);
        let rise = |peak: f64| (peak - acceleration) / max_jerk;
        let free_peak = libm::sqrt((0.5 * acceleration * acceleration - max_jerk * velocity).max(0.0));
        let free_peak = free_peak.max(acceleration).max(0.0);
        let (peak, held) = if free_peak <= limit {
            (free_peak, 0.0)
        } else {
            let by_ramps = (2.0 * limit * limit - acceleration * acceleration) / (2.0 * max_jerk);
            (limit, ((-velocity - by_ramps) / limit).max(0.0))
        };
        Self {
            start,
            jerk: [jerk, 0.0, -jerk],
            time: [rise(peak).max(0.0), held, peak / max_jerk],
        }
    }

    const fn at_once(start: BrakeState) -> Self {
        Self {
            start: BrakeState {
                position: start.position,
                velocity: 0.0,
                acceleration: 0.0,
            },
            jerk: [0.0; 3],
            time: [0.0; 3],
        }
    }

    /// Adds `shift` to the coordinates of the axis.
    pub(crate) fn rename(&mut self, shift: f64) {
        self.start.position += shift;
    }

    /// Its duration, s.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.time[0] + self.time[1] + self.time[2]
    }

    /// The state this long after the start; after the end the axis is at rest.
    #[must_use]
    pub fn at(&self, time_s: f64) -> BrakeState {
        let mut state = self.start;
        let mut rest = time_s.max(0.0);
        for (jerk, time) in self.jerk.into_iter().zip(self.time) {
            let t = rest.min(time);
            state = BrakeState {
                position: state.position
                    + t * (state.velocity + t * (state.acceleration / 2.0 + t * jerk / 6.0)),
                velocity: state.velocity + t * (state.acceleration + t * jerk / 2.0),
                acceleration: state.acceleration + t * jerk,
            };
            rest -= t;
        }
        if time_s >= self.duration_s() {
            // The remainder due to rounding.
            state.velocity = 0.0;
            state.acceleration = 0.0;
        }
        state
    }
}
