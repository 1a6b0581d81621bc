//! The combined target of jogs, and the motion to it from a state of the axes.

use evolvent_control::{Alarm, JogCommand, JogEnable, Rejection};
use evolvent_machine::Limits;
use evolvent_path::{AXES, Axes, AxisLetter};
use evolvent_transfer::AxesState;

use super::jog::JogPlan;

/// Jog speed without a given speed, as a fraction of the axis's velocity limit.
pub(super) const USUAL_FRACTION: f64 = 0.2;
/// Maximum distance of a jog without a given distance, mm or degrees: a thousand turns of an unlimited rotary
/// axis.
const MAX_DISTANCE: f64 = 360_000.0;
/// Lowest speed of a jog, mm/s or degrees/s.
pub(super) const MIN_SPEED: f64 = 1e-3;

/// The goal of an axis.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Goal {
    /// Stop as soon as it can.
    Stop,
    /// Stop at this position.
    At(f64),
    /// Stop this far from the position at which the axis would stop now.
    Further(f64),
    /// Move in this direction to the end of the travel.
    Along(f64),
}

/// The combined target of the jogs of one motion.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct JogIntent {
    goals: [Goal; AXES],
    /// Maximum speed of each axis.
    speed: Axes,
    /// A further increment is added to it.
    is_increment: bool,
    /// The dead-man switch of a continuous jog.
    held: Option<JogEnable>,
}

impl JogIntent {
    /// No target: a jog that takes over stops whatever moves.
    pub(super) fn none() -> Self {
        Self {
            goals: [Goal::Stop; AXES],
            speed: Axes::repeat(MIN_SPEED),
            is_increment: false,
            held: None,
        }
    }

    /// The intent after another jog. An increment is added to an increment. Otherwise axes that the jog does
    /// not name stop, and an increment counts from where its axis would stop.
    pub(super) fn taken_over_by(&self, jog: &JogCommand, held: Option<JogEnable>, limits: &Limits) -> Self {
        let is_increment = jog.distance.is_some();
        let mut after = if is_increment && self.is_increment {
            self.clone()
        } else {
            Self::none()
        };
        (after.is_increment, after.held) = (is_increment, held);
        for i in jog.axes.axes() {
            let speed = jog.max_velocity.unwrap_or(USUAL_FRACTION * limits.velocity[i]);
            after.speed[i] = speed.clamp(MIN_SPEED, limits.velocity[i].max(MIN_SPEED));
            after.goals[i] = match (&jog.distance, after.goals[i]) {
                (None, _) => Goal::Along(jog.direction[i]),
                (Some(distance), Goal::At(target)) => Goal::At(target + distance[i]),
                (Some(distance), Goal::Further(far)) => Goal::Further(far + distance[i]),
                (Some(distance), Goal::Stop | Goal::Along(_)) => Goal::Further(distance[i]),
            };
        }
        after
    }

    /// The dead-man switch, if any.
    pub(super) fn held(&mut self) -> Option<&mut JogEnable> {
        self.held.as_mut()
    }

    /// The motion from a state.
    ///
    /// # Errors
    /// An increment would leave the travel; the error names axis, target and excess.
    pub(super) fn plan(&self, limits: &Limits, from: AxesState, until_ns: u64) -> Result<JogPlan, Rejection> {
        let (stopped, unavoidable) = (from.stopped(limits), from.unavoidable_speed(limits));
        let (mut to, mut speed) = (from.position, self.speed);
        for i in (0..AXES).filter(|i| limits.present[*i]) {
            let (low, high) = (limits.travel_min[i], limits.travel_max[i]);
            to[i] = match self.goals[i] {
                Goal::Stop => {
                    // The axis brakes at once instead of first moving at a set speed.
                    speed[i] = (1.0001 * unavoidable[i]).max(MIN_SPEED);
                    stopped[i].clamp(low, high)
                }
                Goal::Along(direction) if direction > 0.0 => high.min(from.position[i] + MAX_DISTANCE),
                Goal::Along(_) => low.max(from.position[i] - MAX_DISTANCE),
                Goal::At(target) => within(i, target, low, high)?,
                Goal::Further(distance) => within(i, stopped[i] + distance, low, high)?,
            };
        }
        Ok(JogPlan {
            limits: *limits,
            slows_down_first: !(self.is_increment && from.is_at_rest()),
            from,
            to,
            speed,
            until_ns,
        })
    }

    /// Notes that a motion to these positions was ordered: further increments count from them.
    pub(super) fn goes_to(&mut self, to: &Axes) {
        for (i, goal) in self.goals.iter_mut().enumerate() {
            if let Goal::Further(_) = goal {
                *goal = Goal::At(to[i]);
            }
        }
    }
}

/// The target of an increment, if it is within the travel.
fn within(axis: usize, target: f64, low: f64, high: f64) -> Result<f64, Rejection> {
    let beyond = (low - target).max(target - high);
    if beyond > 0.0 || beyond.is_nan() {
        let limit = if target > high { high } else { low };
        return Err(Rejection::new(
            Alarm::SoftLimit,
            format!(
                "axis {} would go to {target:.4}, {beyond:.4} beyond its travel limit of {limit:.4}",
                AxisLetter::ALL[axis].letter(),
            ),
        ));
    }
    Ok(target)
}

#[cfg(test)]
mod tests {
    use evolvent_path::AxisMask;

    use super::*;
    use crate::serve::jog::FOR_EVER;
    use crate::serve::jog::tests::machine;

    fn jog(axis: usize, distance: Option<f64>, direction: f64, speed: f64) -> JogCommand {
        let along = |value: f64| {
            let mut axes = Axes::zeros();
            axes[axis] = value;
            axes
        };
        JogCommand {
            axes: AxisMask::one(axis),
            distance: distance.map(along),
            direction: along(direction),
            max_velocity: Some(speed),
        }
    }

    /// The state during a jog of X at a speed.
    fn at_speed(velocity: f64) -> AxesState {
        let mut state = AxesState::at_rest(Axes::zeros());
        state.velocity[0] = velocity;
        state
    }

    /// Drives a jog in steps of a millisecond. Returns the highest speed of each axis, and the end position.
    fn driven(plan: &JogPlan) -> (Axes, Axes) {
        let steering = plan.steering().unwrap();
        let transfer = steering.transfer();
        let mut top = Axes::zeros();
        for ms in 0..=(transfer.duration_s() * 1e3) as u32 {
            let speed = transfer.at(f64::from(ms) * 1e-3).velocity.map(f64::abs);
            top = top.zip_map(&speed, f64::max);
        }
        (top, transfer.at(transfer.duration_s()).position)
    }

    #[test]
    fn soft_limits_end_jogs_and_reject_increments() {
        let rest = AxesState::at_rest(Axes::zeros());
        let intent = |jog: &JogCommand| JogIntent::none().taken_over_by(jog, None, &machine());
        let plan = intent(&jog(0, None, -1.0, 20.0))
            .plan(&machine(), rest, FOR_EVER)
            .unwrap();
        assert_eq!(plan.to.as_slice()[..3], [-400.0, 0.0, 0.0]);
        let beyond = intent(&jog(0, Some(412.5), 0.0, 20.0)).plan(&machine(), rest, FOR_EVER);
        let Err(refusal) = beyond else {
            panic!("an increment out of the travel")
        };
        assert_eq!(refusal.alarm, Alarm::SoftLimit);
        assert!(
            refusal.text.contains("axis X") && refusal.text.contains("12.5"),
            "{refusal}"
        );
    }

    #[test]
    fn an_increment_ends_a_continuous_jog_where_it_stops() {
        let limits = machine();
        let continuous = JogIntent::none().taken_over_by(&jog(0, None, 1.0, 10.0), None, &limits);
        // Of another axis.
        let increment = continuous.taken_over_by(&jog(1, Some(1.0), 0.0, 1.0), None, &limits);
        let from = at_speed(10.0);
        let stopped = from.stopped(&limits)[0];
        let (top, end) = driven(&increment.plan(&limits, from, FOR_EVER).unwrap());
        assert!(
            (end[0] - stopped).abs() < 1e-9 && end[1] == 1.0 && stopped < 0.2,
            "{end}"
        );
        assert!(top[0] < 10.002 && top[1] < 1.0001, "{top}");
        // Of the same axis, in the other direction.
        let back = continuous.taken_over_by(&jog(0, Some(-1.0), 0.0, 1.0), None, &limits);
        let (top, end) = driven(&back.plan(&limits, from, FOR_EVER).unwrap());
        assert!(
            (end[0] - (stopped - 1.0)).abs() < 1e-9 && top[0] < 10.002,
            "{top} {end}"
        );
    }

    #[test]
    fn increments_add_up_and_axes_keep_their_speeds() {
        let limits = machine();
        let first = JogIntent::none().taken_over_by(&jog(0, Some(50.0), 0.0, 10.0), None, &limits);
        let mut first = first.taken_over_by(&jog(0, Some(-20.0), 0.0, 12.0), None, &limits);
        let from = AxesState::at_rest(Axes::zeros());
        first.goes_to(&first.plan(&limits, from, FOR_EVER).unwrap().to);
        let both = first.taken_over_by(&jog(1, Some(5.0), 0.0, 3.0), None, &limits);
        let both = both.taken_over_by(&jog(0, Some(1.0), 0.0, 11.0), None, &limits);
        let (top, end) = driven(&both.plan(&limits, at_speed(12.0), FOR_EVER).unwrap());
        assert_eq!(end.as_slice()[..3], [31.0, 5.0, 0.0]);
        assert!(
            (11.9..12.002).contains(&top[0]) && (2.9..3.0001).contains(&top[1]),
            "{top}"
        );
        // A continuous jog ends all increments.
        let held = both.taken_over_by(&jog(2, None, 1.0, 4.0), None, &limits);
        let plan = held.plan(&limits, at_speed(11.0), FOR_EVER).unwrap();
        assert!(
            plan.to[0] < 0.3 && plan.to[1] == 0.0 && plan.to[2] == 400.0,
            "{}",
            plan.to
        );
    }
}
