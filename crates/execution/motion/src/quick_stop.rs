//! Every axis stops by itself: the last resort, which leaves the path.

use evolvent_machine::Limits;
use evolvent_path::{AXES, Axes, Jet};
use evolvent_planner::{Profile, ScalarLimits, ScalarState};

use crate::guard::SLACK;

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
            // The last setpoint has left, so its position is sound; its derivatives are not worth a wrong motion.
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
            let limits = ScalarLimits {
                velocity: limits.velocity[i],
                acceleration: bound,
                jerk: limits.jerk[i],
            };
            axes[i] = (Profile::brake(state, f64::INFINITY, 0.0, &limits), sign);
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
}
