//! The retract from an aborted thread.

use evolvent_machine::Limits;
use evolvent_path::Jet;
use evolvent_planner::{Outcome, Profile, ScalarLimits, ScalarState};

use crate::quick_stop::QuickStop;

/// A quick stop of every axis, and a retract of one axis out of the thread. If that axis already moves
/// outwards it continues; otherwise it stops first.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ThreadRetreat {
    stop: QuickStop,
    /// The retract; `None` if the direction is unknown or the target is outside the travel.
    lift: Option<Lift>,
    limits: ScalarLimits,
}

#[derive(Clone, Copy, Debug)]
struct Lift {
    axis: usize,
    clear: f64,
    /// Start position, direction and profile; `None` while the axis has to stop first.
    drive: Option<(f64, f64, Profile)>,
    time: f64,
}

impl ThreadRetreat {
    /// A retract from the state of the last setpoint. `clear_at`: the axis and its position, mm, at which the
    /// tool is clear of the thread. Real-time safe.
    pub(crate) fn new(limits: &Limits, now: &Jet, clear_at: Option<(usize, f64)>) -> Self {
        let of_axis = |axis: usize| ScalarLimits {
            velocity: limits.velocity[axis],
            acceleration: limits.acceleration[axis],
            jerk: limits.jerk[axis],
        };
        let mut retreat = Self {
            stop: QuickStop::new(limits, now.position, now),
            lift: None,
            limits: of_axis(clear_at.map_or(0, |(axis, _)| axis)),
        };
        let Some((axis, clear)) = clear_at.filter(|(axis, clear)| {
            limits.present[*axis] && (limits.travel_min[*axis]..=limits.travel_max[*axis]).contains(clear)
        }) else {
            return retreat;
        };
        let mut lift = Lift {
            axis,
            clear,
            drive: None,
            time: 0.0,
        };
        let sign = (clear - now.position[axis]).signum();
        let moves_out = sign * now.first[axis] > 0.0 && sign * now.second[axis] >= 0.0;
        if moves_out {
            // If it would overshoot, it stops first.
            let from = ScalarState {
                x: 0.0,
                v: sign * now.first[axis],
                a: sign * now.second[axis],
            };
            lift.begin(now.position[axis], from, &retreat.limits);
            lift.drive = lift
                .drive
                .filter(|(_, _, profile)| profile.outcome() != Outcome::Overruns);
        }
        retreat.lift = Some(lift);
        retreat
    }

    /// Whether every axis is at rest and the retract is done. Real-time safe.
    pub(crate) fn is_over(&self) -> bool {
        self.stop.is_over() && self.lift.as_ref().is_none_or(Lift::is_over)
    }

    /// Position and derivatives one period later. Real-time safe.
    pub(crate) fn advance(&mut self, period_s: f64) -> Jet {
        let mut jet = self.stop.advance(period_s);
        if let Some(lift) = &mut self.lift {
            let axis = lift.axis;
            if lift.drive.is_none() && jet.first[axis] == 0.0 && jet.second[axis] == 0.0 {
                let from = ScalarState {
                    x: 0.0,
                    v: 0.0,
                    a: 0.0,
                };
                lift.begin(jet.position[axis], from, &self.limits);
            } else {
                lift.advance(&mut jet, period_s);
            }
        }
        jet
    }
}

impl Lift {
    fn begin(&mut self, at: f64, from: ScalarState, limits: &ScalarLimits) {
        let length = (self.clear - at).abs();
        let profile = Profile::solve(from, length, 0.0, 0.0, limits);
        self.drive = Some((at, (self.clear - at).signum(), profile));
        self.time = 0.0;
    }

    fn is_over(&self) -> bool {
        self.drive
            .is_some_and(|(_, _, profile)| self.time >= profile.duration())
    }

    fn advance(&mut self, jet: &mut Jet, period_s: f64) {
        let Some((from, sign, profile)) = &self.drive else {
            return;
        };
        self.time += period_s;
        let (now, jerk) = profile.at(self.time);
        let axis = self.axis;
        jet.position[axis] = from + sign * now.x;
        (jet.first[axis], jet.second[axis], jet.third[axis]) = (sign * now.v, sign * now.a, sign * jerk);
        if self.is_over() && now.v.abs() < 1e-9 {
            // Exactly at the target, and at rest.
            jet.position[axis] = self.clear;
            (jet.first[axis], jet.second[axis], jet.third[axis]) = (0.0, 0.0, 0.0);
        }
    }
}

#[cfg(test)]
mod tests {
    use evolvent_path::{AXES, Axes};
    use evolvent_random::Random;

    use super::*;

    const PERIOD_S: f64 = 1e-3;

    /// X during a retract from this velocity; positions relative to the state of the last setpoint.
    fn x_of(limits: &Limits, velocity: f64, clear: f64) -> (Vec<f64>, Jet) {
        let mut now = Jet::at_rest(Axes::zeros());
        (now.first[0], now.first[2]) = (velocity, -20.0);
        let mut retreat = ThreadRetreat::new(limits, &now, Some((0, clear)));
        let mut out = vec![-2.0 * velocity * PERIOD_S, -velocity * PERIOD_S, 0.0];
        let mut last = now;
        for _ in 0..100_000 {
            if retreat.is_over() {
                return (out, last);
            }
            last = retreat.advance(PERIOD_S);
            out.push(last.position[0]);
        }
        panic!("no end");
    }

    fn limits() -> Limits {
        Limits {
            present: [true; AXES],
            velocity: Axes::repeat(100.0),
            acceleration: Axes::repeat(1000.0),
            jerk: Axes::repeat(20_000.0),
            travel_min: Axes::repeat(-40.0),
            travel_max: Axes::repeat(40.0),
            home: Axes::zeros(),
        }
    }

    #[test]
    fn only_a_tool_that_moves_inwards_turns_back() {
        let mut random = Random::seeded(1605);
        for _ in 0..200 {
            let clear = random.between(15.0, 39.0) * random.one_of(&[1.0, -1.0]);
            let velocity = random.between(-20.0, 20.0);
            let (out, last) = x_of(&limits(), velocity, clear);
            assert_eq!(
                (last.position[0], last.first, last.second),
                (clear, Axes::zeros(), Axes::zeros())
            );
            let inwards: f64 = out[2..]
                .windows(2)
                .map(|pair| ((pair[0] - pair[1]) * clear.signum()).max(0.0))
                .sum();
            // From rest to rest a velocity v is removed within 1.5 v^2 / a, plus a distance for the jerk.
            let braking = 1.5 * velocity * velocity / 1000.0 + 1.0;
            if velocity * clear > 0.0 {
                let first = out[2..].windows(2).take(5);
                for pair in first {
                    assert!(
                        (pair[1] - pair[0]).abs() >= 0.999 * velocity.abs() * PERIOD_S,
                        "it stops first"
                    );
                }
                assert!(inwards < 1e-9, "{inwards} mm inwards from {velocity} to {clear}");
            } else {
                assert!(
                    inwards < braking,
                    "{inwards} mm inwards from {velocity} to {clear}"
                );
            }
            for four in out.windows(4) {
                let jerk = (four[3] - 3.0 * four[2] + 3.0 * four[1] - four[0]) / PERIOD_S.powi(3);
                assert!(jerk.abs() <= 20_000.0 * 1.02, "{jerk}");
            }
        }
    }

    #[test]
    fn an_axis_does_not_retract_beyond_its_travel() {
        let (out, last) = x_of(&limits(), 10.0, 40.5);
        assert!(last.position[0] < 1.0 && out.len() < 200, "{last:?}");
    }
}
