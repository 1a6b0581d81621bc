//! Handles the events of the cycle.

use evolvent_control::{Alarm, JobResult};

use super::operator::{Job, Operator};
use super::orders::{ActiveJob, CycleCommand, CycleEvent, NotBegun};
use crate::program_cycle::turning_alarm;

impl Operator {
    pub(super) fn handle_event(&mut self, event: CycleEvent) {
        match event {
            CycleEvent::Applied { id, sequence } => self.applied(id, sequence),
            CycleEvent::Spent(schedule) => drop(schedule),
            CycleEvent::EstopChain { sequence } => {
                let alarm = Alarm::EmergencyStopChain;
                self.raise(sequence, alarm, alarm.sentence().to_owned());
                self.state.fall_into_estop();
                self.break_off(JobResult::Fault);
            }
            CycleEvent::Returned(work) => drop(work),
            CycleEvent::TurnReturned { id, work } => {
                drop(work);
                if let Some(steered) = self.steered() {
                    steered.turn_returned(id);
                }
            }
            CycleEvent::NotLeft { work, .. } => self.handle_not_left(work),
            CycleEvent::AwayEnded { result, work, .. } => self.handle_away_ended(result, work),
            CycleEvent::IsBack { .. } => self.handle_is_back(),
            CycleEvent::Ended { result, work, .. } => {
                drop(work);
                self.motion_ended(result);
            }
            CycleEvent::Misplaced {
                sequence,
                cause,
                work,
            } => {
                let is_planned = matches!(work, ActiveJob::Follow(_));
                drop(work);
                if cause == NotBegun::Stopped {
                    self.motion_ended(JobResult::Stopped);
                    return;
                }
                // If something forbids the job, it has its own alarm.
                if cause == NotBegun::Elsewhere && !self.state.has_latched_alarm() {
                    self.raise(sequence, Alarm::Handover, Alarm::Handover.sentence().to_owned());
                }
                match &mut self.job {
                    Job::Program(run) if is_planned => run.ended = Some(JobResult::Fault),
                    _ => self.end_job(JobResult::Fault),
                }
            }
            CycleEvent::Guard { sequence, violation } => {
                let text = format!(
                    "the guard rejected a setpoint: {violation}; the machine was stopped. Please report it \
                     with the trace"
                );
                self.raise(sequence, Alarm::Guard, text);
            }
            CycleEvent::PlannerGone { sequence } => {
                self.raise(sequence, Alarm::Planner, Alarm::Planner.sentence().to_owned());
            }
            CycleEvent::Turning { sequence, reason } => {
                self.raise(sequence, turning_alarm(&reason), reason.text());
            }
            CycleEvent::Spindle { sequence, spindle } => {
                let text = format!("spindle {spindle}: {}", Alarm::Spindle.sentence());
                self.raise(sequence, Alarm::Spindle, text);
            }
            CycleEvent::Late { sequence } => {
                self.raise(sequence, Alarm::Lateness, Alarm::Lateness.sentence().to_owned());
            }
            CycleEvent::Drive { sequence, alarm } => {
                let known = Alarm::from_number(alarm.number()).unwrap_or(Alarm::DriveFault);
                self.raise(sequence, known, alarm.to_string());
                self.lose_power();
            }
            CycleEvent::ReferenceLost { sequence, axes } => self.lose_reference(sequence, axes),
        }
    }

    /// Handles orders that did not fit into the queue: the cycle received an emergency stop instead, and the
    /// jobs that they were to begin end. Returns whether there were any.
    pub(super) fn give_up_lost_orders(&mut self) -> bool {
        let lost = self.book.take_lost();
        if lost.is_empty() {
            return false;
        }
        let alarm = Alarm::OrdersLost;
        self.raise(self.view.setpoint.sequence, alarm, alarm.sentence().to_owned());
        self.state.fall_into_estop();
        for order in lost {
            match order.what {
                CycleCommand::Steer(steering) if matches!(self.job, Job::Program(_)) => {
                    self.handle_not_left(ActiveJob::Steer(steering));
                }
                CycleCommand::Retrace { .. } => self.handle_not_left(ActiveJob::None),
                CycleCommand::Steer(_) | CycleCommand::Follow(_) => self.motion_ended(JobResult::Fault),
                CycleCommand::Turn { .. } => {
                    if let Some(steered) = self.steered() {
                        steered.turn_returned(order.id);
                    }
                }
                CycleCommand::Relocate { renames: true, .. } => {
                    // The coordinates are unchanged. Homing is cancelled below.
                    let _is_known = self.drives.is_refused(order.id, self.view.datum);
                }
                _ => {}
            }
        }
        self.break_off(JobResult::Fault);
        true
    }

    /// The drives have lost power, or lose it at rest: the machine state becomes off.
    pub(super) fn lose_power(&mut self) {
        self.state.drop_power();
        self.switch_off_at_rest();
        self.give_up_waiting(JobResult::Fault);
        self.cancel_homing(JobResult::Fault);
    }

    fn applied(&mut self, id: u64, sequence: u64) {
        self.book.applied(id, sequence);
        if self.drives.is_refused(id, self.view.datum) {
            self.end_homing();
        }
        if let Some(steered) = self.steered() {
            steered.applied(id, sequence);
        }
    }

    fn motion_ended(&mut self, result: JobResult) {
        if matches!(self.job, Job::Jog { .. }) && result == JobResult::Done && self.goes_on_from_rest() {
            return;
        }
        match &mut self.job {
            Job::None => {}
            Job::Program(run) => {
                run.planning.abandon();
                run.ended = Some(result);
                self.cancel_command();
            }
            Job::Jog { .. } => {
                if result != JobResult::Done {
                    self.rest_handwheel();
                }
                self.end_job(result);
            }
            Job::Homing {
                steered, cancelled, ..
            } => {
                *steered = None;
                let fault = (result == JobResult::Fault).then_some(result);
                if let Some(result) = fault.or(*cancelled) {
                    self.end_job(result);
                }
            }
        }
    }
}
