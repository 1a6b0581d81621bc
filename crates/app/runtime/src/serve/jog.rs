//! Jogs: their targets, and transitions from a motion in progress.

use evolvent_control::{Activity, Alarm, JogCommand, JogEnable, OperatorCommand, Rejection};
use evolvent_machine::Limits;
use evolvent_motion::{MotionState, TransferExecutor};
use evolvent_path::{AXES, Axes, AxisMask, feed_rate};
use evolvent_transfer::AxesState;

use super::jog_intent::{JogIntent, MIN_SPEED};
use super::leaving::Away;
use super::operator::{Job, Operator};
use super::orders::CycleCommand;
use crate::job_start::SteeredStart;

/// Time from ordering a retarget of a jog to its effect, ns.
const TURN_LEAD_NS: u64 = 12_000_000;
/// Deadline of a steered motion that needs no dead-man switch.
pub(super) const FOR_EVER: u64 = u64::MAX;

/// Limits for the present state of the axes. An axis that is not homed may move its travel's length in either
/// direction; one beyond its travel may come back.
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

/// Limits of a steered motion: each axis at most at its given speed.
fn slowed(limits: &Limits, from: &AxesState, speed: &Axes) -> Limits {
    let mut slowed = *limits;
    let present = from.unavoidable_speed(limits);
    for i in 0..AXES {
        if limits.present[i] {
            // An axis above its new speed may keep its present speed while it slows down. The limit of an
            // axis may be below the minimum speed, for which `clamp` would panic.
            let wanted = speed[i].max(1.0001 * present[i]).max(MIN_SPEED);
            slowed.velocity[i] = wanted.min(limits.velocity[i]);
        }
    }
    slowed
}

/// A jog: start, target and speeds.
pub(super) struct JogPlan {
    pub(super) limits: Limits,
    pub(super) from: AxesState,
    pub(super) to: Axes,
    /// Maximum speed of each axis.
    pub(super) speed: Axes,
    /// Each axis moves independently and slows down to its speed at once. Otherwise all axes arrive at the
    /// same time.
    pub(super) slows_down_first: bool,
    /// When it ends by itself.
    pub(super) until_ns: u64,
}

impl JogPlan {
    /// `speed` for the axes of the mask; the other axes, which do not move, keep their maximum.
    pub(super) fn speeds(limits: &Limits, axes: AxisMask, speed: f64) -> Axes {
        Axes::from_fn(|i, _| {
            if axes.contains(i) {
                speed
            } else {
                limits.velocity[i]
            }
        })
    }

    /// The programmed speed in the metric of feeds, mm/s or degrees/s.
    fn programmed_speed(&self) -> f64 {
        let moves = |i: usize| self.limits.present[i] && self.to[i] != self.from.position[i];
        feed_rate(&Axes::from_fn(|i, _| {
            if moves(i) {
                self.speed[i].min(self.limits.velocity[i])
            } else {
                0.0
            }
        }))
    }

    /// Computes the motion.
    ///
    /// # Errors
    /// There is no such motion within the limits.
    pub(super) fn steering(&self) -> Result<TransferExecutor, Rejection> {
        // Solves what the trace contains, so that recomputation gives the same bits.
        self.recorded(false)
            .solve(&self.limits)
            .map(TransferExecutor::new)
            .map_err(|error| Rejection::new(Alarm::SoftLimit, error.to_string()))
    }

    /// The motion as the trace records it.
    pub(super) fn recorded(&self, is_turn: bool) -> SteeredStart {
        let slowed = slowed(&self.limits, &self.from, &self.speed);
        SteeredStart {
            is_turn,
            velocity: slowed.velocity,
            travel_min: slowed.travel_min,
            travel_max: slowed.travel_max,
            from: self.from,
            to: self.to,
            cruise: self.slows_down_first.then_some(self.speed),
        }
    }
}

/// A change of a steered motion on its way to the cycle.
pub(super) struct PendingTurn {
    pub(super) order: u64,
    pub(super) steering: TransferExecutor,
    /// The change corresponds to the intent; `false` if the intent has changed since.
    is_intended: bool,
}

/// A steered motion: `t` of setpoint `n` is `(n + 1 - begin)` periods.
pub(super) struct Steered {
    pub(super) steering: TransferExecutor,
    pub(super) order: u64,
    pub(super) begin: Option<u64>,
    pub(super) turn: Option<PendingTurn>,
    pub(super) stopping: bool,
    /// The speed that was last programmed, mm/s or degrees/s.
    pub(super) programmed_speed: f64,
    /// The combined target of the jogs so far.
    intent: JogIntent,
    /// The cycle does not drive the newest intent yet.
    is_pending: bool,
}

impl Steered {
    /// The state of the axes at setpoint `sequence` if nothing intervenes.
    pub(super) fn foreseen(&self, sequence: u64, period_ns: u64) -> Option<AxesState> {
        let periods = sequence + 1 - self.begin?;
        let time = periods as f64 * period_ns as f64 * 1e-9;
        let point = self.steering.transfer().at(time);
        Some(AxesState {
            position: point.position,
            velocity: point.velocity,
            acceleration: point.acceleration,
        })
    }

    /// Notes that the cycle has applied an order with this setpoint.
    pub(super) fn applied(&mut self, order: u64, sequence: u64) {
        if self.order == order {
            self.begin = Some(sequence);
        } else if let Some(turn) = self.turn.take_if(|turn| turn.order == order) {
            (self.steering, self.begin) = (turn.steering, Some(sequence));
            if turn.is_intended {
                self.is_pending = false;
            }
        }
    }

    /// Notes that a change came back from the cycle. If it was not reported as applied before, it was too
    /// late.
    pub(super) fn turn_returned(&mut self, order: u64) {
        self.turn.take_if(|turn| turn.order == order);
    }

    /// Handles a keep-alive of a client. Returns the time until which the axes may move, ns of
    /// CLOCK_MONOTONIC; `None` if the jog needs none.
    fn renew(&mut self, client: u64, now_ns: u64) -> Result<Option<u64>, Rejection> {
        let Some(held) = self.intent.held() else {
            return Ok(None);
        };
        if held.renew(client, now_ns) {
            return Ok(Some(held.until_ns()));
        }
        let text = "the jog belongs to another client, and this command does not renew it; send JOG to take \
                    it over";
        Err(Rejection::new(Alarm::Busy, text))
    }
}

impl Operator {
    pub(super) fn jog(&mut self, jog: &JogCommand, client: u64, now_ns: u64) -> Result<u64, Rejection> {
        if matches!(self.job, Job::Program(_)) {
            return self.jog_away(jog, client, now_ns);
        }
        let held = jog.distance.is_none().then(|| JogEnable::held(client, now_ns));
        if matches!(self.job, Job::Jog { .. }) {
            self.take_over(jog, held)?;
            self.rest_handwheel();
            if let Job::Jog { by_handwheel, .. } = &mut self.job {
                *by_handwheel = false;
            }
            return Ok(self.state.job());
        }
        let (plan, intent) = self.plan_from_rest(jog, held)?;
        self.rest_handwheel();
        self.begin_jog(&plan, intent, false)
    }

    /// A jog that begins at rest here.
    ///
    /// # Errors
    /// An increment would leave the travel.
    pub(super) fn plan_from_rest(
        &self,
        jog: &JogCommand,
        held: Option<JogEnable>,
    ) -> Result<(JogPlan, JogIntent), Rejection> {
        let here = self.view.setpoint.position;
        let limits = limits_here(&self.limits, &here, self.state.homed());
        let mut intent = JogIntent::none().taken_over_by(jog, held, &limits);
        let plan = intent.plan(&limits, AxesState::at_rest(here), until(held))?;
        intent.goes_to(&plan.to);
        Ok((plan, intent))
    }

    /// Replaces the jog in progress.
    ///
    /// # Errors
    /// An increment would leave the travel, or the motion is stopping.
    pub(super) fn take_over(&mut self, jog: &JogCommand, held: Option<JogEnable>) -> Result<(), Rejection> {
        let here = self.view.setpoint.position;
        let limits = limits_here(&self.limits, &here, self.state.homed());
        let (after, period_ns) = (self.turn_behind(), self.setup.period_ns);
        let is_braking = self.view.setpoint.state == MotionState::Stopping;
        let Some(steered) = self.steered().filter(|steered| !steered.stopping && !is_braking) else {
            return Err(Rejection::new(
                Alarm::Busy,
                "the last jog is still stopping; jog again when the axes are at rest",
            ));
        };
        let intent = steered.intent.taken_over_by(jog, held, &limits);
        let foreseen = steered.foreseen(after, period_ns);
        let from = foreseen.unwrap_or_else(|| AxesState::at_rest(here));
        // A jog that cannot be driven is rejected now, even if it has to wait for the preceding change.
        intent.plan(&limits, from, until(held))?.steering()?;
        steered.intent = intent;
        steered.is_pending = true;
        if let Some(turn) = &mut steered.turn {
            turn.is_intended = false;
        }
        self.drive_intent()
    }

    /// Orders the motion of the present intent, once the preceding change has come back from the cycle. A
    /// change that was too late is ordered again.
    ///
    /// # Errors
    /// There is no such motion within the limits.
    fn drive_intent(&mut self) -> Result<(), Rejection> {
        let here = self.view.setpoint.position;
        let limits = limits_here(&self.limits, &here, self.state.homed());
        let (after, period_ns) = (self.turn_behind(), self.setup.period_ns);
        let Some(steered) = self.steered() else {
            return Ok(());
        };
        let (true, Some(from), None, false) = (
            steered.is_pending,
            steered.foreseen(after, period_ns),
            &steered.turn,
            steered.stopping,
        ) else {
            return Ok(());
        };
        let mut intent = steered.intent.clone();
        let until_ns = until(intent.held().copied());
        let plan = intent.plan(&limits, from, until_ns)?;
        intent.goes_to(&plan.to);
        self.turn_jog(&plan, after, true)?;
        if let Some(steered) = self.steered() {
            steered.intent = intent;
        }
        Ok(())
    }

    /// Continues a jog that waits for the preceding change. If it can no longer be driven from the present
    /// state of the axes, the axes stop.
    pub(super) fn follow_jog(&mut self) {
        let Err(refusal) = self.drive_intent() else { return };
        self.message.tell(format!("the jog was stopped: {refusal}"));
        if let Some(steered) = self.steered() {
            steered.stopping = true;
            self.order(CycleCommand::StopSteering);
        }
    }

    /// If the motion ended before the cycle applied the last jog, that jog begins from here, in the same job.
    /// Returns whether there was one.
    pub(super) fn goes_on_from_rest(&mut self) -> bool {
        let here = self.view.setpoint.position;
        let limits = limits_here(&self.limits, &here, self.state.homed());
        let Some(steered) = self.steered().filter(|steered| !steered.stopping) else {
            return false;
        };
        if !std::mem::take(&mut steered.is_pending) {
            return false;
        }
        let mut intent = steered.intent.clone();
        let until_ns = until(intent.held().copied());
        let begun = intent
            .plan(&limits, AxesState::at_rest(here), until_ns)
            .and_then(|plan| {
                intent.goes_to(&plan.to);
                let begun = self.steer(&plan, intent, None)?;
                self.book
                    .notes
                    .sends(begun.order, self.state.job(), plan.recorded(false));
                Ok(begun)
            });
        match (begun, self.steered()) {
            (Ok(begun), Some(steered)) => {
                *steered = *begun;
                true
            }
            (Err(refusal), _) => {
                self.message.tell(format!("the jog was stopped: {refusal}"));
                false
            }
            _ => false,
        }
    }

    /// The programmed speed of a jog or homing move in progress.
    pub(super) fn steered_speed(&self) -> Option<f64> {
        match &self.job {
            Job::Jog { steered, .. } => Some(steered.programmed_speed),
            Job::Homing { steered, .. } => steered.as_deref().map(|steered| steered.programmed_speed),
            _ => None,
        }
    }

    /// The transfer in progress.
    pub(super) fn steered(&mut self) -> Option<&mut Steered> {
        match &mut self.job {
            Job::Jog { steered, .. } => Some(steered),
            Job::Homing { steered, .. } => steered.as_deref_mut(),
            Job::Program(run) => run.away.as_mut().and_then(Away::steered),
            Job::None => None,
        }
    }

    /// The setpoint after which a change ordered now can take effect.
    pub(super) fn turn_behind(&self) -> u64 {
        self.view.setpoint.sequence + TURN_LEAD_NS.div_ceil(self.setup.period_ns).max(4)
    }

    /// Begins a jog at rest and returns the number of its job.
    ///
    /// # Errors
    /// There is no such motion within the limits.
    pub(super) fn begin_jog(
        &mut self,
        plan: &JogPlan,
        intent: JogIntent,
        by_handwheel: bool,
    ) -> Result<u64, Rejection> {
        let steered = self.steer(plan, intent, None)?;
        self.book
            .notes
            .sends(steered.order, self.state.job() + 1, plan.recorded(false));
        self.job = Job::Jog {
            steered,
            by_handwheel,
        };
        Ok(self.state.job_begins(Activity::Jog))
    }

    /// Retargets the jog in progress after a setpoint. `is_intended` means that the change corresponds to the
    /// present intent.
    ///
    /// # Errors
    /// There is no such motion within the limits.
    pub(super) fn turn_jog(
        &mut self,
        plan: &JogPlan,
        after: u64,
        is_intended: bool,
    ) -> Result<(), Rejection> {
        let turned = plan.steering()?;
        let what = CycleCommand::Turn {
            after,
            until_ns: plan.until_ns,
            steering: Box::new(turned),
        };
        let order = self.order(what);
        self.book
            .notes
            .sends(order, self.state.job(), plan.recorded(true));
        if let Some(steered) = self.steered() {
            steered.programmed_speed = plan.programmed_speed();
            steered.turn = Some(PendingTurn {
                order,
                steering: turned,
                is_intended,
            });
        }
        Ok(())
    }

    /// Sets the travel with which the next job is planned, for the guard. The trace has it too, so that a
    /// stop at its limit is recomputed exactly.
    pub(super) fn begin_within(&mut self, limits: &Limits) {
        self.order(CycleCommand::Within(*limits));
    }

    /// Begins a steered motion at rest. The command is not passed on: a jog is recorded when it is accepted,
    /// since one that replaces another may never be ordered by itself.
    ///
    /// # Errors
    /// There is no such motion within the limits.
    pub(super) fn steer(
        &mut self,
        plan: &JogPlan,
        intent: JogIntent,
        command: Option<&OperatorCommand>,
    ) -> Result<Box<Steered>, Rejection> {
        let steering = plan.steering()?;
        self.begin_within(&plan.limits);
        self.order(CycleCommand::KeepJogging(plan.until_ns));
        let what = CycleCommand::Steer(Box::new(steering));
        let order = match command {
            Some(command) => self.send(what, command),
            None => self.order(what),
        };
        Ok(Box::new(Steered {
            steering,
            order,
            begin: None,
            turn: None,
            stopping: false,
            programmed_speed: plan.programmed_speed(),
            intent,
            is_pending: false,
        }))
    }

    pub(super) fn keep_jogging(&mut self, client: u64, now_ns: u64) -> Result<(), Rejection> {
        let renewed = self
            .steered()
            .map_or(Ok(None), |steered| steered.renew(client, now_ns))?;
        if let Some(until) = renewed {
            self.order(CycleCommand::KeepJogging(until));
        }
        Ok(())
    }
}

/// Time until which a jog may move the axes, ns of CLOCK_MONOTONIC.
pub(super) fn until(held: Option<JogEnable>) -> u64 {
    held.map_or(FOR_EVER, JogEnable::until_ns)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub(in crate::serve) fn machine() -> Limits {
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

    #[test]
    fn unhomed_and_out_of_travel_axes_keep_limited_motion() {
        let mut position = Axes::zeros();
        (position[0], position[1]) = (1000.0, 401.0);
        let limits = limits_here(&machine(), &position, AxisMask::from_bits(0b110));
        assert_eq!((limits.travel_min[0], limits.travel_max[0]), (40.0, 1960.0));
        assert_eq!((limits.travel_min[1], limits.travel_max[1]), (-400.0, 401.0));
    }

    #[test]
    fn a_slow_axis_never_exceeds_its_maximum_speed() {
        let mut limits = machine();
        limits.velocity[1] = 1e-6;
        let from = AxesState::at_rest(Axes::zeros());
        let slowed = slowed(&limits, &from, &Axes::zeros());
        assert_eq!(
            (slowed.velocity[0], slowed.velocity[1]),
            (MIN_SPEED, limits.velocity[1])
        );
    }
}
