//! Motions of a served machine, setpoint by setpoint.

use evolvent_control::JobResult;
use evolvent_drive::PowerRequest;
use evolvent_motion::{MotionState, Setpoint, TransferExecutor};
use evolvent_trace::inputs as recorded;

use super::{CycleState, ServedParts};
use crate::cycle_sample::input_bits;
use crate::serve::orders::{ActiveJob, CycleEvent, Following};
use crate::signal_loop::SignalLoop;
use crate::turning_motion::{turning_fault, turning_output};

impl ServedParts {
    pub(super) fn drop_turn(&mut self, now: &mut CycleState) {
        if let Some(turn) = now.turn.take() {
            self.report(turn.returned());
        }
    }

    /// Computes one setpoint of whatever moves the axes.
    pub(super) fn step(&mut self, now: &mut CycleState, deadline: u64) -> Setpoint {
        (now.notes.turned, now.plan_setpoint) = (None, None);
        now.notes.input_bits = if std::mem::take(&mut now.relocated) {
            recorded::RELOCATED
        } else {
            0
        };
        let mut work = std::mem::replace(&mut now.work, ActiveJob::None);
        let (mut setpoint, result) = match &mut work {
            ActiveJob::None => {
                let state = if now.faulted {
                    MotionState::Fault
                } else {
                    MotionState::Idle
                };
                (self.generator.rest(state), None)
            }
            ActiveJob::Follow(job) => match now.excursion.take() {
                None => self.follow(now, job),
                Some(excursion) => self.follow_away(now, job, excursion, deadline),
            },
            ActiveJob::Steer(steering) => self.steer(now, steering, deadline),
        };
        now.work = work;
        if let Some(violation) = self.generator.take_fault()
            && !now.faulted
        {
            now.faulted = true;
            let sequence = setpoint.sequence;
            self.report(CycleEvent::Guard { sequence, violation });
        }
        if let Some(result) = result {
            let sequence = setpoint.sequence;
            now.program.is_end = true;
            self.drop_turn(now);
            self.end_excursion(now);
            let work = std::mem::replace(&mut now.work, ActiveJob::None);
            if !self.generator.is_quick_stopping() {
                self.generator.end();
            }
            now.inputs.hold = false;
            now.inputs.stop = false;
            self.report(CycleEvent::Ended {
                sequence,
                result,
                work,
            });
        }
        if now.faulted && matches!(setpoint.state, MotionState::Stopped | MotionState::Stopping) {
            setpoint.state = MotionState::Fault;
        }
        if now.power_off_at_rest && now.is_idle() && self.generator.is_at_rest() {
            now.power_off_at_rest = false;
            now.drive.power = PowerRequest::Off;
        }
        setpoint
    }

    pub(super) fn follow(
        &mut self,
        now: &mut CycleState,
        job: &mut Following,
    ) -> (Setpoint, Option<JobResult>) {
        // A resume applies to the stop that it was meant for, and to no later one.
        let is_meant = now.stops.go_on.is_some() && now.stops.go_on == now.stops.at_stop;
        now.inputs.resume = is_meant && !now.inputs.resume;
        let waiting = self.signals.as_ref().filter(|signals| signals.is_waiting());
        let at_wait = waiting.is_some();
        if let Some(signals) = waiting {
            // Only the end of the wait continues the program here.
            now.inputs.resume = signals.is_over() && job.motion.can_leave_wait(&mut job.queue);
        }
        let trouble = self.signals.as_ref().and_then(SignalLoop::spindle_in_trouble);
        now.inputs.stop |= trouble.is_some();
        let before = job.motion.plan_step();
        now.inputs.probe = self.probe;
        if let Some(signals) = &self.signals {
            now.inputs.spindle = signals.spindle_at(job.motion.next_sequence());
        }
        let switches = self.signals.as_ref().map(SignalLoop::overrides);
        let mut inputs = now.inputs.switched_by(&switches.unwrap_or_default());
        let spindle_overrides = self.counted_overrides(now);
        if let Some(signals) = &mut self.signals {
            inputs.feed_override *=
                signals.feed_ratio(now.last.as_ref(), job.motion.is_rapid(), &spindle_overrides);
        }
        let mut setpoint = job.motion.step(&inputs, &mut job.queue);
        now.stops.has_left_wait = at_wait && now.inputs.resume && job.motion.plan_step() != before;
        if let (Some(spindle), false) = (trouble, now.faulted) {
            let sequence = setpoint.sequence;
            self.report_once(now, CycleEvent::Spindle { sequence, spindle });
        }
        if let (Some(reason), false) = (turning_fault(&job.motion), now.faulted) {
            let sequence = setpoint.sequence;
            self.report_once(now, CycleEvent::Turning { sequence, reason });
        }
        now.notes.turned = turning_output(&job.motion).and_then(|output| output.transition);
        now.notes.input_bits |= recorded::FOLLOWS | input_bits(&inputs, &job.motion);
        now.stops.at_stop = (setpoint.state == MotionState::ProgramStop).then_some(setpoint.actions);
        self.generator.follow(&job.motion, &setpoint);
        if setpoint.state == MotionState::Done && job.flags.has_failed() {
            setpoint.state = MotionState::Stopped;
        }
        if job.motion.is_stuck(&mut job.queue) {
            let sequence = setpoint.sequence;
            self.report_once(now, CycleEvent::PlannerGone { sequence });
            return (setpoint, Some(JobResult::Fault));
        }
        let result = job.motion.is_over().then(|| result_of(now, job, &setpoint));
        (setpoint, result)
    }

    pub(super) fn steer(
        &mut self,
        now: &mut CycleState,
        steering: &mut TransferExecutor,
        deadline: u64,
    ) -> (Setpoint, Option<JobResult>) {
        if deadline > now.keep_until_ns {
            steering.stop();
        }
        let sequence = self.generator.sequence();
        if let Some(turn) = now.turn.take_if(|turn| turn.after < sequence) {
            // If it is too late for the change, the old motion continues to its own end.
            if turn.after + 1 == sequence && self.generator.turn(steering, &turn.steering) {
                now.keep_until_ns = turn.until_ns;
                self.report(CycleEvent::Applied {
                    id: turn.id,
                    sequence,
                });
            }
            self.report(turn.returned());
        }
        now.notes.input_bits |= recorded::STEERS;
        if steering.is_stopping() {
            now.notes.input_bits |= recorded::STOP;
        }
        let setpoint = self.generator.steer(steering);
        let result = match setpoint.state {
            MotionState::Done => Some(JobResult::Done),
            MotionState::Stopped if now.faulted => Some(JobResult::Fault),
            MotionState::Stopped => Some(JobResult::Stopped),
            _ if self.generator.is_quick_stopping() => Some(JobResult::Fault),
            _ => None,
        };
        (setpoint, result)
    }

    /// Stops each axis on its own and ends the motion.
    pub(super) fn emergency(&mut self, now: &mut CycleState) {
        self.generator.emergency();
        now.drive.power = PowerRequest::QuickStop;
        now.power_off_at_rest = true;
        now.power_orders.cancel();
        self.drop_turn(now);
        self.end_excursion(now);
        let work = std::mem::replace(&mut now.work, ActiveJob::None);
        if !matches!(work, ActiveJob::None) {
            now.program.is_end = true;
            let sequence = self.generator.sequence();
            self.report(CycleEvent::Ended {
                sequence,
                result: JobResult::Fault,
                work,
            });
        }
    }

    pub(super) fn report_once(&mut self, now: &mut CycleState, event: CycleEvent) {
        if !now.faulted {
            now.faulted = true;
            self.report(event);
        }
    }

    pub(super) fn stop_for_lateness(&mut self, now: &mut CycleState, sequence: u64) {
        if now.is_idle() {
            return;
        }
        self.report_once(now, CycleEvent::Late { sequence });
        now.stop_work();
    }
}

/// How a job along a plan has ended.
pub(super) fn result_of(now: &CycleState, job: &Following, setpoint: &Setpoint) -> JobResult {
    match setpoint.state {
        MotionState::Fault => JobResult::Fault,
        _ if now.faulted => JobResult::Fault,
        MotionState::Done => JobResult::Done,
        _ if job.flags.has_failed() => JobResult::Failed,
        _ => JobResult::Stopped,
    }
}
