//! The handwheel, driven as a jog that is retargeted in motion.

use evolvent_control::{CommandCode, Handwheel, HandwheelReading, OperatorCommand, Rejection};
use evolvent_machine::HandwheelSettings;
use evolvent_path::{Axes, AxisLetter, AxisMask};
use evolvent_transfer::AxesState;

use super::jog::{FOR_EVER, JogPlan, limits_here};
use super::jog_intent::JogIntent;
use super::operator::{Job, Operator};
use super::orders::CycleCommand;
use crate::handwheel_view::HandwheelView;

/// Time by which an axis follows the wheel, s. The speed is chosen so that the remaining distance takes this
/// long, which smooths the single counts of a turning hand into one motion.
const FOLLOW_S: f64 = 0.08;
/// Differences of positions up to this count as zero, mm or degrees.
const SAME: f64 = 1e-9;

/// The operator's state of the handwheel.
pub(crate) struct HandwheelState {
    settings: HandwheelSettings,
    wheel: Handwheel,
    /// Axis and step as chosen by command, for a wheel without selector inputs.
    axis: Option<usize>,
    step: Option<f64>,
    /// Target of the axes; `None` if nothing is left to drive.
    goal: Option<Axes>,
}

impl HandwheelState {
    /// The wheel of a machine, at rest.
    pub(crate) fn new(settings: &HandwheelSettings) -> Self {
        Self {
            wheel: Handwheel::new(settings.counts_per_detent),
            settings: settings.clone(),
            axis: None,
            step: None,
            goal: None,
        }
    }

    /// The wheel's count, and the axis and step that its inputs choose.
    fn reading(&self, view: &HandwheelView) -> HandwheelReading {
        let is_on = |input: u32| view.digital >> input & 1 == 1;
        let settings = &self.settings;
        let axis = if settings.axis_inputs.is_empty() {
            self.axis
        } else {
            // A selector between two positions chooses no axis; neither do two inputs at once.
            let mut chosen = settings.axis_inputs.iter().filter(|(_, input)| is_on(*input));
            match (chosen.next(), chosen.next()) {
                (Some((axis, _)), None) => Some(axis.index()),
                _ => None,
            }
        };
        let number = if settings.step_inputs.is_empty() {
            Some(0)
        } else {
            settings.step_inputs.iter().position(|input| is_on(*input))
        };
        let by_switch = |axis: usize| number.and_then(|number| settings.step(AxisLetter::ALL[axis], number));
        let step = match (settings.step_inputs.is_empty(), self.step) {
            (true, Some(step)) => Some(step),
            _ => axis.and_then(by_switch),
        };
        HandwheelReading {
            counts: view.counts,
            // Without a step no axis follows the wheel.
            axis: axis.filter(|_| step.is_some()),
            step: step.unwrap_or(0.0),
            is_enabled: settings.enable_input.is_none_or(is_on),
        }
    }

    /// Fields of the status: mask of the axis that the wheel moves, whether it is enabled, distance per
    /// detent.
    pub(super) fn numbers(&self, view: &HandwheelView) -> (u32, u32, f64) {
        let reading = self.reading(view);
        let mask = reading.axis.map_or(0, |axis| 1 << axis);
        let step = if mask == 0 { 0.0 } else { reading.step };
        (mask, u32::from(reading.is_enabled), step)
    }

    /// Discards the distance that was not driven yet.
    pub(super) fn rest(&mut self) {
        self.goal = None;
    }
}

impl Operator {
    /// Chooses axis and step.
    ///
    /// # Errors
    /// There is no wheel, or inputs choose axis and step.
    pub(super) fn choose_handwheel(
        &mut self,
        axis: Option<usize>,
        step: Option<f64>,
    ) -> Result<(), Rejection> {
        let Some(handwheel) = &mut self.handwheel else {
            return Err(Rejection::by_rule(
                evolvent_control::Alarm::NoHandwheel,
                CommandCode::Handwheel,
            ));
        };
        let switches = (axis.is_some() && !handwheel.settings.axis_inputs.is_empty())
            || (step.is_some() && !handwheel.settings.step_inputs.is_empty());
        if switches {
            return Err(Rejection::new(
                evolvent_control::Alarm::NoHandwheel,
                "the handwheel has its own switches for this: turn them",
            ));
        }
        (handwheel.axis, handwheel.step) = (axis, step);
        handwheel.goal = None;
        Ok(())
    }

    /// Reads the wheel and moves the axis accordingly.
    pub(super) fn follow_handwheel(&mut self) {
        let Some(handwheel) = &mut self.handwheel else {
            return;
        };
        let reading = handwheel.reading(&self.view.handwheel);
        let turned = handwheel.wheel.turn(&reading);
        let is_released = !reading.is_enabled;
        let is_driving = matches!(
            &self.job,
            Job::Jog {
                by_handwheel: true,
                ..
            }
        );
        let may = (is_driving || self.is_idle()) && self.permits_jog() && !self.view.handwheel.is_silent();
        let Some(handwheel) = &mut self.handwheel else {
            return;
        };
        if !may || is_released {
            let is_under_way = handwheel.goal.take().is_some();
            if is_driving && is_under_way {
                self.stop_handwheel();
            }
            return;
        }
        if let Some((axis, distance)) = turned {
            let here = self.view.setpoint.position;
            let limits = limits_here(&self.limits, &here, self.state.homed());
            let goal = handwheel.goal.get_or_insert(here);
            // Distance turned beyond the travel is discarded, so turning back has an immediate effect.
            goal[axis] = (goal[axis] + distance).clamp(limits.travel_min[axis], limits.travel_max[axis]);
        }
        if let Some(goal) = handwheel.goal
            && let Err(refusal) = self.drive_to(&goal, reading.step)
        {
            self.message
                .tell(format!("the handwheel is not followed: {refusal}"));
            self.rest_handwheel();
        }
    }

    fn permits_jog(&self) -> bool {
        self.files.reading.is_none()
            && self
                .state
                .permit(CommandCode::Jog, &self.operator_inputs())
                .is_ok()
    }

    /// Stops the axis: the enabling button was released, or the wheel stopped sending.
    fn stop_handwheel(&mut self) {
        if let Job::Jog { steered, .. } = &mut self.job
            && !steered.stopping
        {
            steered.stopping = true;
            self.send(CycleCommand::Stop, &OperatorCommand::JogStop);
        }
    }

    /// Discards what was turned.
    pub(super) fn rest_handwheel(&mut self) {
        if let Some(handwheel) = &mut self.handwheel {
            handwheel.rest();
        }
    }

    /// Moves the axes to the goal, unless they are on the way to it.
    fn drive_to(&mut self, goal: &Axes, step: f64) -> Result<(), Rejection> {
        let here = self.view.setpoint.position;
        let limits = limits_here(&self.limits, &here, self.state.homed());
        let after = self.turn_behind();
        let from = match &self.job {
            Job::None => {
                if moved(goal, &here).is_empty() {
                    self.rest_handwheel();
                    return Ok(());
                }
                AxesState::at_rest(here)
            }
            Job::Jog { steered, .. } => {
                let transfer = steered.steering.transfer();
                let end = transfer.at(transfer.duration_s()).position;
                let is_right = moved(goal, &end).is_empty();
                if is_right || steered.stopping || steered.turn.is_some() {
                    return Ok(());
                }
                match steered.foreseen(after, self.setup.period_ns) {
                    Some(from) => from,
                    None => return Ok(()),
                }
            }
            Job::Program(_) | Job::Homing { .. } => return Ok(()),
        };
        let axes = moved(goal, &from.position) | moved(&from.velocity, &Axes::zeros());
        let farthest = axes
            .axes()
            .map(|axis| (goal[axis] - from.position[axis]).abs())
            .fold(step, f64::max);
        let jog = JogPlan {
            // At most the speed of the axis: the rest of the distance takes longer and is not lost.
            speed: JogPlan::speeds(&limits, axes, farthest / FOLLOW_S),
            slows_down_first: false,
            limits,
            from,
            to: *goal,
            until_ns: FOR_EVER,
        };
        if matches!(self.job, Job::None) {
            self.begin_jog(&jog, JogIntent::none(), true)?;
        } else {
            self.turn_jog(&jog, after, false)?;
        }
        Ok(())
    }
}

/// The axes in which two positions differ.
fn moved(a: &Axes, b: &Axes) -> AxisMask {
    (0..a.len()).filter(|i| (a[*i] - b[*i]).abs() > SAME).collect()
}
