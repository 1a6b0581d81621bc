//! Excursions from a held program: the operator's side.

use std::fmt::Write as _;

use evolvent_control::{Alarm, JobResult, JogCommand, JogEnable, OperatorCommand, Rejection};
use evolvent_motion::MotionState;
use evolvent_path::{Axes, AxisLetter, AxisMask};
use evolvent_transfer::AxesState;

use super::jog::{FOR_EVER, JogPlan, Steered, limits_here};
use super::jog_intent::{JogIntent, USUAL_FRACTION};
use super::operator::{Job, Operator};
use super::orders::{ActiveJob, CycleCommand};

/// Maximum number of jogs whose return is stored.
const MAX_LEGS: usize = 64;
/// Positions closer than this are the same, mm or degrees.
const SAME: f64 = 1e-9;

/// The motions that led away from the held program.
#[derive(Default)]
pub(super) struct Away {
    /// Jogs, the oldest first. The return passes the start of each in reverse order.
    legs: Vec<Leg>,
    motion: Option<AwayMotion>,
    return_speed: Option<f64>,
    /// RETURN is in progress.
    is_returning: bool,
}

/// A jog of one axis, or several in a row, along one line.
struct Leg {
    from: Axes,
    axis: usize,
}

/// The motion in progress.
enum AwayMotion {
    /// A jog, or the return along one.
    Jog { steered: Box<Steered> },
    /// A motion along the driven path.
    Retrace,
}

impl Away {
    /// The transfer in progress.
    pub(super) fn steered(&mut self) -> Option<&mut Steered> {
        match &mut self.motion {
            Some(AwayMotion::Jog { steered }) => Some(steered),
            _ => None,
        }
    }

    /// After a jog, removes legs that end where they began.
    fn settle(&mut self, here: &Axes) {
        while self.legs.last().is_some_and(|leg| is_same(&leg.from, here)) {
            self.legs.pop();
        }
    }
}

fn is_same(a: &Axes, b: &Axes) -> bool {
    (a - b).iter().all(|distance| distance.abs() <= SAME)
}

impl Operator {
    fn away(&mut self) -> Option<&mut Away> {
        match &mut self.job {
            Job::Program(run) => run.away.as_mut(),
            _ => None,
        }
    }

    /// Whether the axes have left the held program, or are about to.
    pub(super) fn is_away(&self) -> bool {
        matches!(&self.job, Job::Program(run) if run.away.is_some()) || self.view.leaving.is_away
    }

    /// The reason why the program cannot be left here, if any.
    fn objection_to_leaving(&self) -> Option<Rejection> {
        let refused = |text: &str| Some(Rejection::new(Alarm::CannotLeave, text));
        if self.periphery.now().change_numbers().0 != 0 {
            return refused("a tool is being changed; jog when the program is held elsewhere");
        }
        if self.is_waiting() {
            return refused(
                "the program waits for an input or a user-defined M code, and continues by itself",
            );
        }
        if self.stops.stopping || self.view.leaving.may_leave {
            return None;
        }
        match self.view.setpoint.state {
            MotionState::Held | MotionState::ProgramStop => refused(
                "a probing move, a thread or a turning cycle moves the axes; hold the program after it",
            ),
            _ => Some(Alarm::Moving.into()),
        }
    }

    /// Jogs away from the held program.
    ///
    /// # Errors
    /// The program cannot be left here, more than one axis is named, the target is beyond the travel, or
    /// another axis moves.
    pub(super) fn jog_away(&mut self, jog: &JogCommand, client: u64, now_ns: u64) -> Result<u64, Rejection> {
        if let Some(objection) = self.objection_to_leaving() {
            return Err(objection);
        }
        let mut axes = jog.axes.axes();
        let (Some(axis), None) = (axes.next(), axes.next()) else {
            return Err(Rejection::new(
                Alarm::CannotLeave,
                "while a program is held only one axis is jogged at a time, so that the way back is the \
                 reverse of the jogs",
            ));
        };
        let here = self.view.setpoint.position;
        let held = jog.distance.is_none().then(|| JogEnable::held(client, now_ns));
        let job = self.state.job();
        let Job::Program(run) = &mut self.job else {
            return Err(Alarm::NothingRuns.into());
        };
        let away = run.away.get_or_insert_default();
        if away.motion.is_some() {
            let turns = away.legs.last().is_some_and(|leg| leg.axis == axis) && !away.is_returning;
            if !turns || away.steered().is_none_or(|steered| steered.stopping) {
                return Err(Rejection::new(
                    Alarm::Busy,
                    "the axes still move; jog another axis when they are at rest",
                ));
            }
            self.take_over(jog, held)?;
            return Ok(job);
        }
        if away.legs.len() >= MAX_LEGS {
            return Err(Rejection::new(
                Alarm::CannotLeave,
                format!("the way back is stored for at most {MAX_LEGS} jogs; drive it with `return`"),
            ));
        }
        // Consecutive jogs of one axis are one leg.
        let begins_leg = away.legs.last().is_none_or(|leg| leg.axis != axis);
        let begun = self
            .plan_from_rest(jog, held)
            .and_then(|(plan, intent)| self.steer_away(&plan, intent, None));
        if let Some(away) = self.away() {
            match (&begun, begins_leg) {
                (Ok(()), true) => away.legs.push(Leg { from: here, axis }),
                (Ok(()), false) => {}
                (Err(_), _) => self.forget_if_there(),
            }
        }
        begun.map(|()| job)
    }

    /// Begins a transfer of the excursion at rest.
    fn steer_away(
        &mut self,
        plan: &JogPlan,
        intent: JogIntent,
        command: Option<&OperatorCommand>,
    ) -> Result<(), Rejection> {
        let steered = self.steer(plan, intent, command)?;
        self.book
            .notes
            .sends(steered.order, self.state.job(), plan.recorded(false));
        if let Some(away) = self.away() {
            away.motion = Some(AwayMotion::Jog { steered });
        }
        Ok(())
    }

    /// Notes that the motion of an excursion is to stop; the program stays held. Returns whether anything
    /// moves; if so, [`CycleCommand::StopSteering`] stops it.
    pub(super) fn stop_away(&mut self) -> bool {
        let Some(away) = self.away() else { return false };
        away.is_returning = false;
        if let Some(steered) = away.steered() {
            steered.stopping = true;
        }
        away.motion.is_some()
    }

    /// RETURN: drives back to the held program.
    ///
    /// # Errors
    /// The axes are not away, or still move.
    pub(super) fn drive_back(
        &mut self,
        speed: Option<f64>,
        command: &OperatorCommand,
    ) -> Result<(), Rejection> {
        if !self.is_away() {
            return Err(Rejection::new(
                Alarm::NothingRuns,
                "the axes are where the program is held; `resume` continues",
            ));
        }
        let Some(away) = self.away() else {
            return Err(Alarm::Moving.into());
        };
        if away.motion.is_some() {
            return Err(Alarm::Moving.into());
        }
        (away.is_returning, away.return_speed) = (true, speed);
        self.go_back(Some(command))
    }

    /// Begins the next leg of the return.
    fn go_back(&mut self, command: Option<&OperatorCommand>) -> Result<(), Rejection> {
        let here = self.view.setpoint.position;
        let limits = limits_here(&self.limits, &here, self.state.homed());
        let is_retraced = self.view.leaving.is_retraced;
        let Some(away) = self.away() else { return Ok(()) };
        let Some(leg) = away.legs.last() else {
            if is_retraced {
                self.retrace_by(0, command);
            } else {
                // The axes are back: a jog that comes now is not part of the return.
                away.is_returning = false;
            }
            return Ok(());
        };
        let mut to = here;
        to[leg.axis] = leg.from[leg.axis];
        let speed = away
            .return_speed
            .unwrap_or(USUAL_FRACTION * limits.velocity[leg.axis]);
        let plan = JogPlan {
            speed: JogPlan::speeds(&limits, AxisMask::one(leg.axis), speed),
            slows_down_first: false,
            to,
            limits,
            from: AxesState::at_rest(here),
            until_ns: FOR_EVER,
        };
        self.steer_away(&plan, JogIntent::none(), command)
    }

    /// RETRACE: drives backwards along the path of the program.
    ///
    /// # Errors
    /// The program cannot be left here, the axes were jogged away or still move, or the path is not known so
    /// far back.
    pub(super) fn retrace(&mut self, blocks: u32, command: &OperatorCommand) -> Result<(), Rejection> {
        if let Some(objection) = self.objection_to_leaving() {
            return Err(objection);
        }
        if let Some(away) = self.away() {
            if away.motion.is_some() {
                return Err(Alarm::Moving.into());
            }
            if !away.legs.is_empty() {
                return Err(Rejection::new(
                    Alarm::CannotRetrace,
                    "the axes were jogged off the path; drive back with `return` first",
                ));
            }
        }
        let known = self.view.leaving.blocks_before;
        if blocks > known {
            let text = format!(
                "the path can be retraced by {known} block starts from here, not by {blocks}: before them \
                 the program had an action, an output, a probing move or a thread, or the path is no longer \
                 stored"
            );
            return Err(Rejection::new(Alarm::CannotRetrace, text));
        }
        if let Job::Program(run) = &mut self.job {
            run.away.get_or_insert_default();
        }
        self.retrace_by(blocks, Some(command));
        Ok(())
    }

    fn retrace_by(&mut self, back: u32, command: Option<&OperatorCommand>) {
        self.order(CycleCommand::KeepJogging(FOR_EVER));
        let what = CycleCommand::Retrace { back };
        let id = match command {
            Some(command) => self.send(what, command),
            None => self.order(what),
        };
        self.book.notes.sends_retrace(id, self.state.job(), back);
        if let Some(away) = self.away() {
            away.motion = Some(AwayMotion::Retrace);
        }
    }

    /// Handles a motion of the excursion that the cycle rejected.
    pub(super) fn handle_not_left(&mut self, work: ActiveJob) {
        drop(work);
        if let Some(away) = self.away() {
            (away.motion, away.is_returning) = (None, false);
            // The jog has not moved, so it adds no leg.
            let here = self.view.setpoint.position;
            if let Some(away) = self.away() {
                away.settle(&here);
            }
            self.message.tell_of_job(Alarm::CannotLeave.sentence());
        }
        self.forget_if_there();
    }

    /// Ends an excursion that has not moved.
    fn forget_if_there(&mut self) {
        if let Job::Program(run) = &mut self.job
            && !self.view.leaving.is_away
            && (run.away.as_ref()).is_some_and(|away| away.motion.is_none() && away.legs.is_empty())
        {
            run.away = None;
        }
    }

    /// Handles the end of a motion of the excursion.
    pub(super) fn handle_away_ended(&mut self, result: JobResult, work: ActiveJob) {
        drop(work);
        if result == JobResult::Done && self.goes_on_from_rest() {
            return;
        }
        let here = self.view.setpoint.position;
        let Some(away) = self.away() else { return };
        if let Some(AwayMotion::Jog { .. }) = away.motion.take() {
            away.settle(&here);
        }
        if result != JobResult::Done {
            away.is_returning = false;
        }
        let goes_on = away.is_returning;
        if goes_on && let Err(refusal) = self.go_back(None) {
            if let Some(away) = self.away() {
                away.is_returning = false;
            }
            self.message
                .tell_of_job(format!("the way back was stopped: {refusal}"));
            return;
        }
        if (self.away()).is_some_and(|away| away.motion.is_none()) {
            let return_text = self.return_text();
            self.message.tell_of_job(return_text);
        }
    }

    /// Handles the end of the excursion: the program has the axes again.
    pub(super) fn handle_is_back(&mut self) {
        // A jog that was ordered meanwhile leaves the program again, so its leg is kept.
        if let Job::Program(run) = &mut self.job
            && (run.away.as_ref()).is_none_or(|away| away.motion.is_none())
        {
            run.away = None;
            self.message
                .tell_of_stop("back where the program is held: `resume` continues");
        }
    }

    /// The return as text, leg by leg.
    fn return_text(&self) -> String {
        let Job::Program(run) = &self.job else {
            return String::new();
        };
        let Some(away) = &run.away else {
            return String::new();
        };
        let mut text = "away from the program; the way back:".to_owned();
        let mut here = self.view.setpoint.position;
        for leg in away.legs.iter().rev() {
            let letter = AxisLetter::ALL[leg.axis].letter();
            let distance = leg.from[leg.axis] - here[leg.axis];
            // Writing to a String does not fail.
            let _written = write!(text, " {letter} by {distance:+.4},");
            here = leg.from;
        }
        if self.view.leaving.is_retraced {
            text.push_str(" forwards along the path,");
        }
        text.push_str(" then the program can be resumed. `return` drives it");
        text
    }

    /// The axes that were jogged away, and the number of legs of the return.
    pub(crate) fn away_numbers(&self) -> (AxisMask, u32) {
        let Job::Program(run) = &self.job else {
            return (AxisMask::NONE, 0);
        };
        let Some(away) = &run.away else {
            return (AxisMask::NONE, 0);
        };
        let retraced = u32::from(self.view.leaving.is_retraced);
        let axes = away.legs.iter().map(|leg| leg.axis).collect();
        (axes, away.legs.len() as u32 + retraced)
    }
}
