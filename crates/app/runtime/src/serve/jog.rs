//! Jogs: where to, and how from a motion that goes on.

use evolvent_control::{Activity, Alarm, Command, JogCommand, JogEnable, Rejection};
use evolvent_machine::Limits;
use evolvent_motion::TransferExecutor;
use evolvent_path::{AXES, Axes, AxisLetter, AxisMask};
use evolvent_transfer::{AxesState, Sync, Transfer};

use super::leaving::Away;
use super::operator::{Job, Operator};
use super::orders::CycleCommand;
use super::recorded::steered_start;
use crate::job_start::SteeredStart;

/// Time from asking for a turn of a jog to where it counts, ns.
const TURN_LEAD_NS: u64 = 12_000_000;
/// A steered motion that needs no dead-man.
pub(super) const FOR_EVER: u64 = u64::MAX;
/// Share of an axis's velocity at which it is jogged where no speed is given.
const USUAL_FRACTION: f64 = 0.2;

/// Maximum distance of a jog without one, mm or degrees: a thousand turns of an unlimited rotary axis.
const MAX_DISTANCE: f64 = 360_000.0;

/// Limits for the axes as they are: an axis whose zero is unknown may go its travel's length either way, and one
/// that stands beyond its travel may come back.
pub(crate) fn limits_here(machine: &Limits, position: &Axes, homed: AxisMask) -> Limits {
    let mut limits = *machine;
    for i in 0..AXES {
        if !machine.present[i] {
            continue;
        }
        if !homed.contains(i) {
            let length = 1.2 * (machine.travel_max[i] - machine.travel_min[i]);
            limits.travel_min[i] = position[i] - length;
            limits.travel_max[i] = position[i] + length;
        }
        limits.travel_min[i] = limits.travel_min[i].min(position[i]);
        limits.travel_max[i] = limits.travel_max[i].max(position[i]);
    }
    limits
}

/// Where a jog from `position` ends.
///
/// # Errors
/// An increment would leave the travel: axis, where to, and by how much.
pub(crate) fn target(jog: &JogCommand, position: &Axes, limits: &Limits) -> Result<Axes, Rejection> {
    let mut target = *position;
    for i in 0..AXES {
        if !jog.axes.contains(i) {
            continue;
        }
        let (low, high) = (limits.travel_min[i], limits.travel_max[i]);
        match &jog.distance {
            None if jog.direction[i] > 0.0 => target[i] = high.min(position[i] + MAX_DISTANCE),
            None => target[i] = low.max(position[i] - MAX_DISTANCE),
            Some(distance) => {
                target[i] = position[i] + distance[i];
                let beyond = (low - target[i]).max(target[i] - high);
                if beyond > 0.0 || beyond.is_nan() {
                    let limit = if target[i] > high { high } else { low };
                    return Err(Rejection::new(
                        Alarm::SoftLimit,
                        format!(
                            "axis {} would go to {:.4}, {beyond:.4} beyond its travel limit of {limit:.4}",
                            AxisLetter::ALL[i].letter(),
                            target[i],
                        ),
                    ));
                }
            }
        }
    }
    Ok(target)
}

/// A steered motion from a state to rest at `target`, the axes of `mask` no faster than `speed` each.
///
/// # Errors
/// There is no such motion within the limits.
pub(crate) fn steering(
    limits: &Limits,
    from: &AxesState,
    target: &Axes,
    axes: AxisMask,
    speed: Option<f64>,
) -> Result<TransferExecutor, Rejection> {
    let slowed = slowed(limits, from, axes, speed);
    let to = AxesState::at_rest(*target);
    Transfer::solve(&slowed, from, &to, Sync::Time)
        .map(TransferExecutor::new)
        .map_err(|error| Rejection::new(Alarm::SoftLimit, error.to_string()))
}

/// The limits of a steered motion: the axes of `mask` no faster than `speed` each.
pub(super) fn slowed(limits: &Limits, from: &AxesState, axes: AxisMask, speed: Option<f64>) -> Limits {
    let mut slowed = *limits;
    for i in 0..AXES {
        if !limits.present[i] {
            continue;
        }
        let wanted = if axes.contains(i) {
            speed.unwrap_or(USUAL_FRACTION * limits.velocity[i])
        } else {
            limits.velocity[i]
        };
        // What moves faster than is wanted now may do so while it slows down.
        let (v, a, j) = (from.velocity[i], from.acceleration[i], limits.jerk[i]);
        let present = v.abs().max((v + a * a.abs() / (2.0 * j)).abs());
        slowed.velocity[i] = wanted.max(1.0001 * present).clamp(1e-3, limits.velocity[i]);
    }
    slowed
}

/// A jog: from where to where, and how fast.
pub(super) struct JogWay {
    pub(super) limits: Limits,
    pub(super) from: AxesState,
    pub(super) to: Axes,
    pub(super) axes: AxisMask,
    /// Of each axis at most; none for the usual one.
    pub(super) speed: Option<f64>,
    /// When it ends by itself.
    pub(super) until_ns: u64,
}

impl JogWay {
    pub(super) fn steering(&self) -> Result<TransferExecutor, Rejection> {
        steering(&self.limits, &self.from, &self.to, self.axes, self.speed)
    }

    /// For the trace.
    pub(super) fn recorded(&self, is_turn: bool) -> SteeredStart {
        let limits = slowed(&self.limits, &self.from, self.axes, self.speed);
        steered_start(&limits, &self.from, &self.to, is_turn)
    }
}

/// A steered motion: `t` of setpoint `n` is `(n + 1 - begin)` periods.
pub(super) struct Steered {
    pub(super) steering: TransferExecutor,
    pub(super) order: u64,
    pub(super) begin: Option<u64>,
    /// A change that is under way, and its order.
    pub(super) turn: Option<(u64, TransferExecutor)>,
    pub(super) stopping: bool,
    pub(super) target: Axes,
}

impl Operator {
    /// Where the axes will be with setpoint `sequence`, if nothing intervenes.
    pub(super) fn foreseen(&self, steered: &Steered, sequence: u64) -> Option<AxesState> {
        let periods = sequence + 1 - steered.begin?;
        let time = periods as f64 * self.setup.period_ns as f64 * 1e-9;
        let point = steered.steering.transfer().at(time);
        Some(AxesState {
            position: point.position,
            velocity: point.velocity,
            acceleration: point.acceleration,
        })
    }

    pub(super) fn jog(
        &mut self,
        jog: &JogCommand,
        client: u64,
        now_ns: u64,
        command: &Command,
    ) -> Result<u64, Rejection> {
        if matches!(self.job, Job::Program(_)) {
            return self.jog_away(jog, client, now_ns, command);
        }
        let here = self.view.setpoint.position;
        let limits = limits_here(&self.limits, &here, self.desk.homed());
        let held = jog.distance.is_none().then(|| JogEnable::held(client, now_ns));
        let until = held.map_or(FOR_EVER, JogEnable::until_ns);
        let after = self.turn_behind();
        if let Job::Jog { steered, .. } = &self.job {
            let Some(from) = self.foreseen(steered, after).filter(|_| !steered.stopping) else {
                return Err(Rejection::new(
                    Alarm::Busy,
                    "the last jog is coming to rest; jog again then",
                ));
            };
            // An increment adds to the one under way.
            let base = if jog.distance.is_some() {
                steered.target
            } else {
                from.position
            };
            let way = JogWay {
                to: target(jog, &base, &limits)?,
                limits,
                from,
                axes: jog.axes,
                speed: jog.max_velocity,
                until_ns: until,
            };
            self.turn_jog(&way, after, Some(command))?;
            self.rest_handwheel();
            if let Job::Jog {
                held: old,
                by_handwheel,
                ..
            } = &mut self.job
            {
                (*old, *by_handwheel) = (held, false);
            }
            return Ok(self.desk.job());
        }
        let way = JogWay {
            to: target(jog, &here, &limits)?,
            limits,
            from: AxesState::at_rest(here),
            axes: jog.axes,
            speed: jog.max_velocity,
            until_ns: until,
        };
        self.rest_handwheel();
        self.begin_jog(&way, held, false, Some(command))
    }

    /// The setpoint after which a turn that is ordered now can count.
    pub(super) fn turn_behind(&self) -> u64 {
        self.view.setpoint.sequence + TURN_LEAD_NS.div_ceil(self.setup.period_ns).max(4)
    }

    /// Begins a jog at rest; the number of its job.
    ///
    /// # Errors
    /// There is no such motion within the limits.
    pub(super) fn begin_jog(
        &mut self,
        way: &JogWay,
        held: Option<JogEnable>,
        by_handwheel: bool,
        command: Option<&Command>,
    ) -> Result<u64, Rejection> {
        let steering = way.steering()?;
        let steered = self.steer(&way.limits, steering, way.to, way.until_ns, command);
        self.book
            .notes
            .sends(steered.order, self.desk.job() + 1, way.recorded(false));
        self.job = Job::Jog {
            steered,
            held,
            by_handwheel,
        };
        Ok(self.desk.job_begins(Activity::Jog))
    }

    /// Turns the jog under way over after a setpoint.
    ///
    /// # Errors
    /// There is no such motion within the limits.
    pub(super) fn turn_jog(
        &mut self,
        way: &JogWay,
        after: u64,
        command: Option<&Command>,
    ) -> Result<(), Rejection> {
        let turned = way.steering()?;
        let what = CycleCommand::Turn {
            after,
            steering: Box::new(turned),
        };
        let id = match command {
            Some(command) => self.send(what, command),
            None => self.order(what),
        };
        self.book.notes.sends(id, self.desk.job(), way.recorded(true));
        self.order(CycleCommand::KeepJogging(way.until_ns));
        let steered = match &mut self.job {
            Job::Jog { steered, .. } => Some(&mut **steered),
            Job::Program(run) => run.away.as_mut().and_then(Away::steered),
            _ => None,
        };
        if let Some(steered) = steered {
            steered.turn = Some((id, turned));
            steered.target = way.to;
        }
        Ok(())
    }

    /// The guard checks the travel for which the next job is planned: the trace has it, so that a stop at its end comes out the
    /// same when it is computed again.
    pub(super) fn begin_within(&mut self, limits: &Limits) {
        self.order(CycleCommand::Within(*limits));
    }

    /// Begins a steered motion at rest.
    pub(super) fn steer(
        &mut self,
        limits: &Limits,
        steering: TransferExecutor,
        target: Axes,
        until_ns: u64,
        command: Option<&Command>,
    ) -> Box<Steered> {
        self.begin_within(limits);
        self.order(CycleCommand::KeepJogging(until_ns));
        let what = CycleCommand::Steer(Box::new(steering));
        let order = match command {
            Some(command) => self.send(what, command),
            None => self.order(what),
        };
        Box::new(Steered {
            steering,
            order,
            begin: None,
            turn: None,
            stopping: false,
            target,
        })
    }

    pub(super) fn keep_jogging(&mut self, client: u64, now_ns: u64) {
        let until = match &mut self.job {
            Job::Jog { held: Some(held), .. } => held.renew(client, now_ns).then(|| held.until_ns()),
            Job::Program(run) => run.away.as_mut().and_then(|away| away.renew(client, now_ns)),
            _ => None,
        };
        if let Some(until) = until {
            self.order(CycleCommand::KeepJogging(until));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn machine() -> Limits {
        let mut present = [false; AXES];
        present[..3].fill(true);
        Limits {
            present,
            velocity: Axes::repeat(500.0),
            acceleration: Axes::repeat(5000.0),
            jerk: Axes::repeat(200_000.0),
            travel_min: Axes::repeat(-400.0),
            travel_max: Axes::repeat(400.0),
            home: Axes::zeros(),
        }
    }

    fn jog(distance: Option<f64>, direction: f64) -> JogCommand {
        let along = |value: f64| {
            let mut axes = Axes::zeros();
            axes[0] = value;
            axes
        };
        JogCommand {
            axes: AxisMask::one(0),
            distance: distance.map(along),
            direction: along(direction),
            max_velocity: Some(20.0),
        }
    }

    #[test]
    fn a_continuous_jog_ends_at_the_soft_limit_and_an_increment_beyond_it_is_refused_with_how_much() {
        let limits = limits_here(&machine(), &Axes::zeros(), AxisMask::from_bits(0b111));
        let to = target(&jog(None, -1.0), &Axes::zeros(), &limits).unwrap();
        assert_eq!(to.as_slice()[..3], [-400.0, 0.0, 0.0]);
        let refusal = target(&jog(Some(412.5), 0.0), &Axes::zeros(), &limits).unwrap_err();
        assert_eq!(refusal.alarm, Alarm::SoftLimit);
        assert!(
            refusal.text.contains("axis X") && refusal.text.contains("12.5"),
            "{refusal}"
        );
    }

    #[test]
    fn an_axis_that_is_not_homed_may_go_its_travel_s_length_and_one_beyond_may_come_back() {
        let mut position = Axes::zeros();
        (position[0], position[1]) = (1000.0, 401.0);
        let limits = limits_here(&machine(), &position, AxisMask::from_bits(0b110));
        assert_eq!((limits.travel_min[0], limits.travel_max[0]), (40.0, 1960.0));
        assert_eq!((limits.travel_min[1], limits.travel_max[1]), (-400.0, 401.0));
    }

    #[test]
    fn a_jog_keeps_its_speed_and_one_in_motion_may_turn_round() {
        let limits = machine();
        let start = AxesState::at_rest(Axes::zeros());
        let forth = steering(
            &limits,
            &start,
            &Axes::from_fn(|i, _| if i == 0 { 50.0 } else { 0.0 }),
            AxisMask::one(0),
            Some(20.0),
        )
        .unwrap();
        let middle = forth.transfer().at(0.5 * forth.transfer().duration_s());
        assert!((middle.velocity[0] - 20.0).abs() < 1e-3, "{middle:?}");
        let moving = AxesState {
            position: middle.position,
            velocity: middle.velocity,
            acceleration: middle.acceleration,
        };
        let back = steering(&limits, &moving, &Axes::zeros(), AxisMask::one(0), Some(5.0)).unwrap();
        let end = back.transfer().at(back.transfer().duration_s());
        assert!(end.position[0].abs() < 1e-9);
    }
}
