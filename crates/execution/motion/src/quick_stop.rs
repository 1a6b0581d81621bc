//! Every axis stops by itself: the last resort, which leaves the path.
//!
//! A stop brings acceleration to zero as well, which a path that turns back in front of the edge of the
//! travel does not: at the same jerk the axis would go beyond the edge by up to `A^3 / (24 J^2)`. Such an
//! axis takes as much more jerk as it needs to stop at the edge, within its acceleration.

use evolvent_machine::Limits;
use evolvent_path::{AXES, Axes, Jet};
use evolvent_planner::{Profile, ScalarLimits, ScalarState};

use crate::guard::{Guard, SLACK, TRAVEL_SLACK};

/// How often the jerk of an axis is doubled until it stops within its travel, and steps of the search for the
/// least that does. From an acceleration within the limit, 2^10 times the jerk is nearly a step of
/// acceleration at any control rate.
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
    /// From the last published position and its planned derivatives. Real-time safe.
    pub(crate) fn new(limits: &Limits, from: Axes, last: &Jet) -> Self {
        let mut axes = [(Profile::at_rest(0.0), 1.0); AXES];
        for i in 0..AXES {
            let (velocity, acceleration) = (last.first[i], last.second[i]);
            // The last setpoint has left, so its position is sound; its derivatives are not worth a wrong
            // motion.
            if !limits.present[i] || !velocity.is_finite() || !acceleration.is_finite() {
                continue;
            }
            let sign = if velocity < 0.0 { -1.0 } else { 1.0 };
            // What the guard has let pass is kept: cutting it off would be a step of acceleration.
            let most = SLACK * limits.acceleration[i];
            let state = ScalarState {
                x: 0.0,
                v: velocity.abs(),
                a: (sign * acceleration).clamp(-most, most),
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

    /// The same, and an axis that would leave its travel all the same (the plan led it there) stands from
    /// here on, while the others finish their stops. Whether one does. Real-time safe.
    pub(crate) fn advance_within(&mut self, guard: &Guard, period: f64) -> (Jet, bool) {
        let mut jet = self.advance(period);
        let mut stands = false;
        for i in 0..AXES {
            if guard.check_axis(i, jet.position[i]).is_err() {
                stands = true;
                self.from[i] = guard.past()[0][i];
                self.axes[i] = (Profile::at_rest(0.0), 1.0);
                jet.position[i] = self.from[i];
                (jet.first[i], jet.second[i], jet.third[i]) = (0.0, 0.0, 0.0);
            }
        }
        (jet, stands)
    }
}

/// The fastest stop that goes no farther than `left`: with more jerk than the limit where it needs that, and
/// with the most of it where none is enough.
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

/// How far a stop goes: to its end, or to where it turns back as its deceleration is more than its speed
/// needs.
fn farthest(from: ScalarState, stop: &Profile, jerk: f64) -> f64 {
    let below = from.a * from.a - 2.0 * jerk * from.v;
    if from.a < 0.0 && below > 0.0 {
        from.after((-from.a - below.sqrt()) / jerk, jerk).x
    } else {
        stop.end().x
    }
}
