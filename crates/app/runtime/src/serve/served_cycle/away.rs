//! Excursions from a held program, and the return.

use evolvent_control::JobResult;
use evolvent_motion::{Excursion, ExcursionEnd, MotionState, Setpoint, TransferExecutor};
use evolvent_trace::inputs as recorded;

use super::jobs::result_of;
use super::{CycleState, ServedParts};
use crate::cycle_sample::input_bits;
use crate::serve::orders::{ActiveJob, CycleEvent, Following, LeavingView};
use crate::signal_loop::SignalLoop;

impl ServedParts {
    /// Whether and how the program can be left, for the view.
    pub(super) fn leaving(&self, now: &CycleState) -> LeavingView {
        let ActiveJob::Follow(job) = &now.work else {
            return LeavingView::default();
        };
        if !job.motion.can_be_left() || self.signals.as_ref().is_some_and(SignalLoop::is_waiting) {
            return LeavingView::default();
        }
        let excursion = now.excursion.as_ref();
        LeavingView {
            may_leave: true,
            is_away: excursion.is_some(),
            is_retraced: excursion.is_some_and(Excursion::is_retraced),
            blocks_before: excursion.map_or_else(
                || self.driven.blocks_driven(),
                |excursion| excursion.blocks_before(&self.driven),
            ),
        }
    }

    /// Computes one setpoint of an excursion. The program is stepped as in a hold.
    pub(super) fn follow_away(
        &mut self,
        now: &mut CycleState,
        job: &mut Following,
        mut excursion: Excursion,
        deadline: u64,
    ) -> (Setpoint, Option<JobResult>) {
        let trouble = self.signals.as_ref().and_then(SignalLoop::spindle_in_trouble);
        now.inputs.stop |= trouble.is_some();
        if deadline > now.keep_until_ns || now.inputs.stop {
            excursion.stop();
        }
        let sequence = self.generator.sequence();
        self.turn_away(now, &mut excursion, sequence);
        let switches = self.signals.as_ref().map(SignalLoop::overrides);
        let mut inputs = now.inputs.switched_by(&switches.unwrap_or_default());
        // The program receives the stop when the axes are at rest, which ends the job.
        inputs.stop &= !excursion.is_moving();
        inputs.resume = false;
        let spindle_overrides = self.counted_overrides(now);
        if let Some(signals) = &mut self.signals {
            inputs.feed_override *=
                signals.feed_ratio(now.last.as_ref(), job.motion.is_rapid(), &spindle_overrides);
        }
        now.notes.input_bits |= recorded::FOLLOWS | recorded::STEERS;
        if excursion.is_stopping() {
            now.notes.input_bits |= recorded::STEERING_STOPS;
        }
        let plan = job.motion.step(&inputs, &mut job.queue);
        now.notes.input_bits |= input_bits(&inputs, &job.motion);
        now.plan_setpoint = Some(plan);
        now.stops.at_stop = (plan.state == MotionState::ProgramStop).then_some(plan.actions);
        let (setpoint, ended) = excursion.step(&mut self.generator, &mut self.driven, &plan);
        if let (Some(spindle), false) = (trouble, now.faulted) {
            self.report_once(now, CycleEvent::Spindle { sequence, spindle });
        }
        if let Some(end) = ended {
            let result = match end {
                ExcursionEnd::Arrived => JobResult::Done,
                ExcursionEnd::Stopped => JobResult::Stopped,
                ExcursionEnd::Fault => JobResult::Fault,
            };
            let work = excursion.take_spent().map_or(ActiveJob::None, ActiveJob::Steer);
            self.drop_turn(now);
            self.report(CycleEvent::AwayEnded {
                sequence,
                result,
                work,
            });
            if end == ExcursionEnd::Fault {
                return (setpoint, Some(JobResult::Fault));
            }
        }
        if job.motion.is_over() {
            // Its transfer, if any, is returned to be dropped.
            now.excursion = Some(excursion);
            return (setpoint, Some(result_of(now, job, &setpoint)));
        }
        if excursion.give_back(&self.generator, &mut job.motion) {
            self.report(CycleEvent::IsBack { sequence });
        } else {
            now.excursion = Some(excursion);
        }
        (setpoint, None)
    }

    /// Changes the transfer of the excursion if a change is due.
    fn turn_away(&mut self, now: &mut CycleState, excursion: &mut Excursion, sequence: u64) {
        let Some(turn) = now.turn.take_if(|turn| turn.after < sequence) else {
            return;
        };
        if turn.after + 1 == sequence && excursion.turn(&self.generator, &turn.steering) {
            now.keep_until_ns = turn.until_ns;
            self.report(CycleEvent::Applied {
                id: turn.id,
                sequence,
            });
        }
        self.report(turn.returned());
    }

    /// Begins a transfer of an excursion. Returns whether it was accepted.
    pub(super) fn leave(&mut self, now: &mut CycleState, steering: Box<TransferExecutor>) -> bool {
        let was_away = now.excursion.is_some();
        let refused = match self.take_excursion(now) {
            None => Err(steering),
            Some(mut excursion) => {
                let refused = excursion.steer(&self.generator, steering);
                now.excursion = (refused.is_ok() || was_away).then_some(excursion);
                refused
            }
        };
        let Err(steering) = refused else {
            now.stops.go_on = None;
            return true;
        };
        self.refuse_leaving(ActiveJob::Steer(steering));
        false
    }

    /// Begins a motion along the driven path. Returns whether it was accepted.
    pub(super) fn retrace(&mut self, now: &mut CycleState, back: u32) -> bool {
        let was_away = now.excursion.is_some();
        let mut counts = false;
        if let Some(mut excursion) = self.take_excursion(now) {
            counts = excursion.retrace(&self.generator, &mut self.driven, &self.limits, back);
            now.excursion = (counts || was_away).then_some(excursion);
        }
        if counts {
            now.stops.go_on = None;
        } else {
            self.refuse_leaving(ActiveJob::None);
        }
        counts
    }

    /// Takes the present excursion, or begins one if the program may be left.
    fn take_excursion(&self, now: &mut CycleState) -> Option<Excursion> {
        // Nothing begins while the job stops.
        if now.faulted || now.inputs.stop {
            return None;
        }
        if now.excursion.is_some() {
            return now.excursion.take();
        }
        let ActiveJob::Follow(job) = &now.work else {
            return None;
        };
        let is_waiting = self.signals.as_ref().is_some_and(SignalLoop::is_waiting);
        // A resume may have been ordered just before.
        let is_at_rest = now.inputs.hold || job.motion.state() == MotionState::ProgramStop;
        if !is_at_rest || is_waiting {
            return None;
        }
        Excursion::begin(&job.motion)
    }

    pub(super) fn refuse_leaving(&mut self, work: ActiveJob) {
        let sequence = self.generator.sequence();
        self.report(CycleEvent::NotLeft { sequence, work });
    }

    /// Ends the excursion together with the program. Its transfer is returned to be dropped.
    pub(super) fn end_excursion(&mut self, now: &mut CycleState) {
        if let Some(mut excursion) = now.excursion.take()
            && let Some(steering) = excursion.take_spent()
        {
            self.report(CycleEvent::Returned(ActiveJob::Steer(steering)));
        }
    }
}
