//! Every axis stops on its own: the last resort, which leaves the path.
//!
//! A stop also brings the acceleration to zero, which a path that turns back before the edge of the travel
//! does not: at the same jerk the axis would pass the edge by up to `A^3 / (24 J^2)`. Such an axis uses as
//! much more jerk as it needs to stop at the edge, within its acceleration.

use evolvent_machine::Limits;
use evolvent_path::{AXES, Axes, Jet};
use evolvent_planner::{Profile, ScalarLimits, ScalarState};

use crate::guard::{Guard, SLACK, TRAVEL_SLACK};

/// Maximum number of doublings of the jerk until an axis stops within its travel, and number of steps in the
/// search for the minimum jerk that suffices. From an acceleration within the limit, 2^10 times the jerk is
/// nearly a step of acceleration at any control rate.
const DOUBLINGS: u32 = 10;
const BISECTIONS: u32 = 12;

/// A stop of each axis from the last published state.
#[derive(Clone, Copy, Debug)]
pub(crate) struct QuickStop {
    axes: [(Profile, f64); AXES],
    from: Axes,
    time: f64,
}

impl QuickStop {
    /// A stop from the last published position and its planned derivatives. Real-time safe.
    pub(crate) fn new(limits: &Limits, from: Axes, last: &Jet) -> Self {
        let mut axes = [(Profile::at_rest(0.0), 1.0); AXES];
        for i in 0..AXES {
            let (velocity, acceleration) = (last.first[i], last.second[i]);
            // The last position was published, so it is valid; invalid derivatives must not cause a wrong
            // motion.
            if !limits.present[i] || !velocity.is_finite() || !acceleration.is_finite() {
                continue;
            }
            let sign = if velocity < 0.0 { -1.0 } else { 1.0 };
            // An acceleration that the guard has accepted is kept: reducing it at once would be a step.
            let max = SLACK * limits.acceleration[i];
            let state = ScalarState {
                x: 0.0,
                v: velocity.abs(),
                a: (sign * acceleration).clamp(-max, max),
            };
            let bound = limits.acceleration[i].max(state.a.abs());
            let left = if velocity < 0.0 {
                from[i] - limits.travel_min[i]
            } else {
                limits.travel_max[i] - from[i]
            };
            let limits = ScalarLimits {
                velocity: limits.velocity[i],
                acceleration: bound,
                jerk: limits.jerk[i],
            };
            axes[i] = (stop_within(state, left + 0.5 * TRAVEL_SLACK, &limits), sign);
        }
        Self {
            axes,
            from,
            time: 0.0,
        }
    }

    /// Whether every axis is at rest. Real-time safe.
    pub(crate) fn is_over(&self) -> bool {
        self.axes
            .iter()
            .all(|(profile, _)| self.time >= profile.duration())
    }

    /// Position and derivatives one period later. Real-time safe.
    pub(crate) fn advance(&mut self, period: f64) -> Jet {
        self.time += period;
        let mut jet = Jet::at_rest(self.from);
        for (i, (profile, sign)) in self.axes.iter().enumerate() {
            let (now, jerk) = profile.at(self.time);
            jet.position[i] += sign * now.x;
            jet.first[i] = sign * now.v;
            jet.second[i] = sign * now.a;
            jet.third[i] = sign * jerk;
        }
        jet
    }

    /// As `advance`, except that an axis that would still leave its travel (because the plan led it there)
    /// stays where it is from now on, while the others finish their stops. Returns whether an axis does.
    /// Real-time safe.
    pub(crate) fn advance_within(&mut self, guard: &Guard, period: f64) -> (Jet, bool) {
        let mut jet = self.advance(period);
        let mut is_at_edge = false;
        for i in 0..AXES {
            if guard.check_axis(i, jet.position[i]).is_err() {
                is_at_edge = true;
                self.from[i] = guard.past()[0][i];
                self.axes[i] = (Profile::at_rest(0.0), 1.0);
                jet.position[i] = self.from[i];
                (jet.first[i], jet.second[i], jet.third[i]) = (0.0, 0.0, 0.0);
            }
        }
        (jet, is_at_edge)
    }
}

/// The fastest stop within the distance `left`: with more jerk than the limit if needed, and with the maximum
/// jerk if no jerk suffices.
fn stop_within(from: ScalarState, left: f64, limits: &ScalarLimits) -> Profile {
    let with = |factor: f64| {
        let limits = ScalarLimits {
            jerk: factor * limits.jerk,
            ..*limits
        };
        Profile::brake(from, f64::INFINITY, 0.0, &limits)
    };
    let fits = |factor: f64| farthest(from, &with(factor), factor * limits.jerk) <= left;
    let (mut over, mut within) = (0.0, 1.0);
    for _ in 0..DOUBLINGS {
        if fits(within) {
            break;
        }
        (over, within) = (within, 2.0 * within);
    }
    if over > 0.0 && fits(within) {
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (over + within);
            if fits(middle) {
                within = middle;
            } else {
                over = middle;
            }
        }
    }
    with(within)
}

/// The distance of a stop: to its end, or to the point at which it turns back because its deceleration is
/// more than its speed needs.
fn farthest(from: ScalarState, stop: &Profile, jerk: f64) -> f64 {
    let below = from.a * from.a - 2.0 * jerk * from.v;
    if from.a < 0.0 && below > 0.0 {
        from.after((-from.a - below.sqrt()) / jerk, jerk).x
    } else {
        stop.end().x
    }
}
