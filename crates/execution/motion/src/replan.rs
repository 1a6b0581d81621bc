//! Requests another plan from the planner and takes over the reply.
//!
//! A time-optimal plan is made for one override. For another override the cycle requests a plan from the
//! position that it will reach one lead later, and drives on until then; the reply takes over at exactly that
//! setpoint. For a lower override the plan is slowed down meanwhile ([`Slowdown`]), and the request is made
//! once the rate is constant. At rest the cycle waits until the reply arrives. Holds and stops need no
//! planner.
//!
//! [`Slowdown`]: crate::slowdown::Slowdown

use core::ops::ControlFlow;

use evolvent_planner::{ReplanRequest, Step, TimedSegment};

use crate::advance::MAX_RESTS_PER_CYCLE;
use crate::cursor::{ActiveMotion, Cursor};
use crate::path_executor::PathExecutor;
use crate::queue::PlanConsumer;
use crate::scale::Scale;
use crate::setpoint::Inputs;
use crate::state::MotionState;

/// Time from a request to the position at which its reply takes over, s: planning takes at most half of it.
const LEAD_S: f64 = 0.010;
/// Minimum lead in cycles.
const MIN_LEAD: u64 = 2;
/// Maximum number of doublings of the time between wasted requests in motion: 0.3 s then.
const MAX_DOUBLINGS: u32 = 6;
/// Maximum number of pieces that are searched for a position ahead.
const MAX_AHEAD: usize = 1 << 15;

/// An open request.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PendingReplan {
    id: u64,
    factor: f64,
    /// Number of the setpoint after which its reply takes over; `None` at rest.
    after: Option<u64>,
}

/// The requests of the cycle, and their outcome.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ReplanState {
    /// The override for which the pieces ahead are planned.
    pub(crate) factor: f64,
    open: Option<PendingReplan>,
    requested: u64,
    /// The plan step at which the last reply at rest continues.
    answered_at: Option<u64>,
    /// Number of consecutive requests without success.
    unanswered: u32,
    /// Setpoint before which there is no further request, because the last one failed.
    not_before: u64,
    /// Number of consecutive wasted requests in motion, and the setpoint before which there is no other one.
    /// Each may make the planner append a window that is never driven, so an input that keeps changing must
    /// not cause one every few cycles.
    wasted: u32,
    waste_until: u64,
    pub(crate) lead: u64,
}

impl ReplanState {
    pub(crate) fn new(period: f64) -> Self {
        Self {
            factor: 1.0,
            open: None,
            requested: 0,
            answered_at: None,
            unanswered: 0,
            not_before: 0,
            wasted: 0,
            waste_until: 0,
            lead: ((LEAD_S / period).ceil() as u64).max(MIN_LEAD),
        }
    }

    /// Whether a request is open.
    pub(crate) fn has_open(&self) -> bool {
        self.open.is_some()
    }

    /// Whether a plan for this override has been requested and the planner has not missed a request.
    pub(crate) fn is_waiting_for(&self, factor: f64) -> bool {
        self.unanswered == 0 && self.open.is_some_and(|open| open.factor == factor)
    }

    /// Withdraws an open request in motion; `sequence` is the number of the next setpoint.
    pub(crate) fn withdraw(&mut self, sequence: u64, queue: &PlanConsumer) {
        if let Some(PendingReplan {
            id, after: Some(_), ..
        }) = self.open
        {
            self.open = None;
            self.waste(id, sequence, queue);
        }
    }

    /// Request `id` is wasted: the planner continues the plan that is driven.
    fn waste(&mut self, id: u64, sequence: u64, queue: &PlanConsumer) {
        queue.withdraw_request(id);
        self.wasted = (self.wasted + 1).min(MAX_DOUBLINGS);
        self.waste_until = sequence + (self.lead << self.wasted) / 2;
    }

    /// The pieces ahead are planned for this override.
    pub(crate) fn planned_for(&mut self, factor: f64) {
        self.factor = factor;
    }

    /// A plan has been taken over.
    fn is_met(&mut self) {
        (self.unanswered, self.wasted) = (0, 0);
    }

    fn miss(&mut self) {
        self.unanswered = self.unanswered.saturating_add(1);
    }
}

impl PathExecutor {
    /// Whether the plan from plan step `step` on may be driven as it is. A plan for a start from there may be
    /// driven even if the override has changed since: otherwise an override that changes in every cycle would
    /// never let the axes start.
    pub(crate) fn plan_fits(&self, step: u64, brake: bool) -> bool {
        let asking = &self.replan;
        let is_wanted = asking.factor == self.feed_override || asking.answered_at == Some(step);
        asking.open.is_none() && !brake && is_wanted
    }

    /// Takes over a reply that is due. `refused`: the reply failed in the recorded cycle.
    pub(crate) fn take_answer(&mut self, cursor: &mut Cursor, queue: &mut PlanConsumer, refused: bool) {
        let Some(open) = self.replan.open else { return };
        let reply = match open.after {
            Some(after) if self.sequence <= after => return,
            _ => queue.reply(open.id),
        };
        // At rest the cycle can wait.
        if open.after.is_none() && !queue.record_lookup(reply.is_some()) {
            return;
        }
        match reply {
            // The axes are stopping or at rest: they do not reach the position for which the reply was made.
            Some(_) if open.after.is_some() && (cursor.state == MotionState::Fault || cursor.is_still()) => {
                self.replan.withdraw(self.sequence, queue);
            }
            Some(reply) => {
                self.replan.open = None;
                let step = reply.step.filter(|_| !refused);
                match step.map(|step| (step, queue.step(step))) {
                    // In motion the next piece must be there; at rest it may arrive later.
                    Some((step, Some(Step::TimedSegment(flow)))) if open.after.is_some() => {
                        cursor.step = step;
                        cursor.starved = false;
                        cursor.slowdown = None;
                        cursor.start(flow);
                        self.replan.factor = open.factor;
                        self.replan.is_met();
                        queue.acknowledge_replan(open.id);
                    }
                    // Taking over the reply frees the queue of the steps before it, which the planner may
                    // need in order to append the new plan. The new plan is therefore entered in a later
                    // cycle, whether or not it has arrived.
                    Some((step, _)) if open.after.is_none() => {
                        cursor.step = step;
                        self.replan.answered_at = Some(step);
                        cursor.rest.stays = true;
                        cursor.starved = false;
                        cursor.slowdown = None;
                        self.replan.factor = open.factor;
                        self.replan.is_met();
                        queue.acknowledge_replan(open.id);
                    }
                    _ => self.refuse(open, queue),
                }
            }
            // Recorded as refused: later waiting shows in the trace as a failed look.
            None => {
                self.replan.open = None;
                self.refuse(open, queue);
            }
        }
    }

    /// A request has failed.
    fn refuse(&mut self, request: PendingReplan, queue: &PlanConsumer) {
        self.lag.refused = true;
        self.replan.not_before = self.sequence + self.replan.lead;
        self.replan.miss();
        if request.after.is_some() {
            self.replan.waste(request.id, self.sequence, queue);
        }
    }

    /// Sends a request if the pieces ahead are not planned for the present override.
    pub(crate) fn request_replan(&mut self, inputs: &Inputs, queue: &mut PlanConsumer) {
        let cursor = self.cursor;
        if self.replan.open.is_some()
            || self.quick_stop.is_some()
            || matches!(
                cursor.state,
                MotionState::Done | MotionState::Fault | MotionState::Stopped
            )
        {
            return;
        }
        if self.stop_requested(&cursor, inputs) || self.feed_override == 0.0 {
            return;
        }
        let needs_other = self.feed_override != self.replan.factor;
        if self.sequence < self.replan.not_before {
            return;
        }
        match cursor.drive {
            ActiveMotion::Run(_) => {}
            ActiveMotion::TimedSegment { flow, time } => {
                let rate = match cursor.slowdown {
                    None => Some(1.0),
                    Some(slowdown) => slowdown.steady_rate().filter(|rate| *rate > 0.0),
                };
                let fits = !needs_other && !cursor.starved && cursor.slowdown.is_none();
                let may_request = self.sequence >= self.replan.waste_until && !queue.has_no_planner();
                let Some(rate) = rate.filter(|_| !fits && may_request) else {
                    return;
                };
                let seconds = self.period * self.replan.lead as f64;
                let from = (cursor.step, flow, time + rate * seconds);
                if let Some((step, flow, time)) = self.predict(from, queue) {
                    let (state, jerk) = flow.piece.law.at(time);
                    let steady = Scale {
                        rate,
                        first: 0.0,
                        second: 0.0,
                    };
                    let (state, _) = steady.apply(state, jerk);
                    // The last setpoint is number `sequence - 1`.
                    let after = self.sequence - 1 + self.replan.lead;
                    let request = ReplanRequest {
                        rate,
                        ..request_at(step, &flow, state.x, state.v, state.a)
                    };
                    self.send(Some(after), request, queue);
                }
            }
            // The step that this cycle has found, not a newer one: only that can be replayed.
            ActiveMotion::Still => match self.rest_step {
                // A stop has ended within a piece.
                Some(Step::TimedSegment(flow)) if cursor.slowdown.is_some() => {
                    self.send(
                        None,
                        request_at(cursor.step, &flow, cursor.rest.x, 0.0, 0.0),
                        queue,
                    );
                }
                Some(Step::TimedSegment(flow)) if needs_other => {
                    self.send(None, request_at(cursor.step, &flow, 0.0, 0.0, 0.0), queue);
                }
                Some(Step::Wait) => {
                    let rest = ReplanRequest {
                        step: cursor.step,
                        segment: cursor.segment,
                        offset: cursor.rest.x - cursor.segment_start,
                        interval: cursor.interval,
                        ..EMPTY
                    };
                    self.send(None, rest, queue);
                }
                _ => {}
            },
        }
    }

    /// The step and piece that contain the point `time` seconds after the start of `flow`, which is plan step
    /// `step`, and the time since the start of that piece; `None` if the axes stop before. Settles the
    /// successors up to there.
    fn predict(
        &mut self,
        (mut step, mut flow, mut time): (u64, TimedSegment, f64),
        queue: &mut PlanConsumer,
    ) -> Option<(u64, TimedSegment, f64)> {
        for _ in 0..MAX_AHEAD {
            if time < flow.piece.duration_s {
                return Some((step, flow, time));
            }
            time -= flow.piece.duration_s;
            // Nothing is predicted beyond a rest: the next request is made from there, or after it.
            if flow.rests_at_end() {
                return None;
            }
            (step, _) = queue.settle_successor(step, false);
            flow = match queue.step(step) {
                Some(Step::TimedSegment(next)) => next,
                _ => return None,
            };
        }
        None
    }

    fn send(&mut self, after: Option<u64>, draft: ReplanRequest, queue: &mut PlanConsumer) {
        self.replan.requested += 1;
        let request = ReplanRequest {
            id: self.replan.requested,
            rests: self.cursor.rest.passed,
            feed_factor: self.feed_override,
            ..draft
        };
        if queue.send_request(request) {
            self.replan.open = Some(PendingReplan {
                id: request.id,
                factor: request.feed_factor,
                after,
            });
        } else {
            self.replan.miss();
        }
    }

    /// Whether the axes are at rest, not at the end of the plan, without a planner to continue it.
    pub fn is_stuck(&self, queue: &mut PlanConsumer) -> bool {
        if !queue.has_no_planner()
            || !self.is_at_rest()
            || self.is_over()
            || self.process.is_active()
            || self.probing.is_some()
        {
            return false;
        }
        let step = queue.occupant(self.cursor.step).unwrap_or(self.cursor.step);
        let goes_on = match queue.step(step) {
            None | Some(Step::Wait) => false,
            Some(_) => queue.is_final(step),
        };
        self.replan.open.is_some() || !goes_on
    }

    /// Whether everything that the next step can read is final, so that it does not depend on the speed of
    /// the planner. The virtual clock waits for this.
    pub fn is_ready(&self, queue: &mut PlanConsumer) -> bool {
        self.is_ready_from(self.cursor.step, queue)
    }

    /// Whether the machine is at a wait for an input and everything after it that a step can read is known. A
    /// completed wait is left only then, so that the motion after it does not depend on the speed of the
    /// planner.
    pub fn can_leave_wait(&self, queue: &mut PlanConsumer) -> bool {
        let step = self.cursor.step;
        self.cursor.state == MotionState::ProgramStop
            && matches!(queue.step(step), Some(Step::InputWait { .. }))
            && self.is_ready_from(step + 1, queue)
    }

    /// Number of the present plan step: it increases when a rest has been passed.
    #[must_use]
    pub fn plan_step(&self) -> u64 {
        self.cursor.step
    }

    /// As [`is_ready`](Self::is_ready), if the next step begins with plan step `from`.
    fn is_ready_from(&self, from: u64, queue: &mut PlanConsumer) -> bool {
        if self.is_over()
            || self.quick_stop.is_some()
            || self.process.is_active()
            || self.probing.is_some()
            || queue.is_abandoned()
        {
            return true;
        }
        // With the virtual clock a request that does not fit is made in the next step: the planner takes the
        // older ones.
        if !queue.can_request() && !queue.has_no_planner() {
            return false;
        }
        match self.piece_of_next_step(from, queue) {
            ControlFlow::Continue(piece) => self.is_final_ahead(piece, queue),
            ControlFlow::Break(is_ready) => is_ready,
        }
    }

    /// The piece with which the next step begins, or at once whether that step is ready.
    fn piece_of_next_step(&self, from: u64, queue: &mut PlanConsumer) -> ControlFlow<bool, NextPiece> {
        let (step, answered) = self.after_reply(from, queue)?;
        match (self.cursor.drive, answered) {
            // A reply that has arrived takes over now.
            (ActiveMotion::TimedSegment { .. }, Some(flow)) => ControlFlow::Continue(NextPiece {
                step,
                flow,
                time: 0.0,
                is_reply: true,
            }),
            (ActiveMotion::TimedSegment { flow, time }, None) => ControlFlow::Continue(NextPiece {
                step,
                flow,
                time,
                is_reply: false,
            }),
            (ActiveMotion::Run(_), _) => ControlFlow::Break(queue.has_final_ahead(step)),
            (ActiveMotion::Still, _) => first_piece_after_rests(step, queue),
        }
    }

    /// The plan step with which the next step begins, and its piece if an open request's reply takes over in
    /// motion.
    fn after_reply(
        &self,
        from: u64,
        queue: &mut PlanConsumer,
    ) -> ControlFlow<bool, (u64, Option<TimedSegment>)> {
        let Some(open) = self.replan.open else {
            return ControlFlow::Continue((from, None));
        };
        let due = open.after.is_none_or(|after| self.sequence > after);
        let is_moving = matches!(self.cursor.drive, ActiveMotion::TimedSegment { .. });
        if !due && is_moving {
            // When the request was sent, the plan in force was final beyond the position at which the
            // reply takes over; the planner may have left it since.
            return ControlFlow::Break(true);
        }
        let reply = if due { queue.reply(open.id) } else { None };
        if due && reply.is_none() && !queue.has_no_planner() {
            return ControlFlow::Break(false);
        }
        // The step after this one continues where the reply says: that must be known as well.
        if due && open.after.is_none() {
            return ControlFlow::Break(true);
        }
        let Some(next) = reply.and_then(|reply| reply.step) else {
            return ControlFlow::Continue((from, None));
        };
        match queue.step(next) {
            Some(Step::TimedSegment(flow)) if is_moving => ControlFlow::Continue((next, Some(flow))),
            Some(_) => ControlFlow::Continue((from, None)),
            None => ControlFlow::Break(queue.has_no_planner()),
        }
    }

    /// Whether everything that a step from `piece` on, or a request that it makes, can read is final.
    fn is_final_ahead(&self, piece: NextPiece, queue: &mut PlanConsumer) -> bool {
        let NextPiece {
            mut step,
            flow,
            time,
            is_reply,
        } = piece;
        let mut left = time + self.period * (2 * self.replan.lead + 4) as f64 - flow.piece.duration_s;
        // As far as a slowdown looks ahead, which is a time and a number of pieces: more may not fit into the queue.
        let (ahead_s, mut pieces) = if self.cursor.slowdown.is_some() && !is_reply {
            (self.preview.longest_s(), self.preview.max_pieces())
        } else {
            (0.0, 0)
        };
        // A tail that was claimed is driven to its end.
        let mut tail = self.cursor.starved && !is_reply;
        for _ in 0..MAX_AHEAD {
            if left < 0.0 {
                if ahead_s + left < 0.0 || pieces == 0 {
                    return true;
                }
                pieces -= 1;
            }
            let (next, is_final) = queue.successor(step);
            tail |= queue.is_claimed(step);
            let Some(next) = queue.occupant(next) else {
                return queue.has_no_planner();
            };
            match queue.step(next) {
                Some(Step::TimedSegment(flow)) if is_final || tail => left -= flow.piece.duration_s,
                Some(Step::TimedSegment(_)) | None => return false,
                Some(_) => return true,
            }
            step = next;
        }
        true
    }
}

/// The piece with which a step begins.
#[derive(Clone, Copy, Debug)]
struct NextPiece {
    /// Its plan step.
    step: u64,
    flow: TimedSegment,
    /// Time since its start, s.
    time: f64,
    /// It replaces the present piece, by the reply to a request.
    is_reply: bool,
}

/// The piece that follows a rest at plan step `first`, or at once whether a step from that rest is ready.
fn first_piece_after_rests(first: u64, queue: &mut PlanConsumer) -> ControlFlow<bool, NextPiece> {
    let mut step = first;
    // Rest steps without duration are passed in one cycle: the steps after them must be known, if the cycle
    // reaches them.
    for _ in 0..MAX_RESTS_PER_CYCLE {
        let Some(occupant) = queue.occupant(step) else {
            return ControlFlow::Break(queue.has_no_planner());
        };
        step = occupant;
        match queue.step(step) {
            None => return ControlFlow::Break(false),
            Some(Step::Run(_)) => return ControlFlow::Break(queue.has_final_ahead(first)),
            Some(Step::TimedSegment(flow)) if queue.is_final(step) => {
                return ControlFlow::Continue(NextPiece {
                    step,
                    flow,
                    time: 0.0,
                    is_reply: false,
                });
            }
            Some(Step::TimedSegment(_)) => return ControlFlow::Break(false),
            // The machine stays at a wait for at least one step before it continues.
            Some(Step::Wait | Step::InputWait { .. } | Step::End { .. }) => return ControlFlow::Break(true),
            Some(Step::Turning { .. } | Step::Probe { .. } | Step::Thread { .. }) => {
                return ControlFlow::Break(queue.is_final(step));
            }
            Some(Step::Dwell { seconds, .. }) if seconds > 0.0 => {
                return ControlFlow::Break(queue.is_final(step));
            }
            Some(Step::Dwell { .. } | Step::Action { .. } | Step::ProgramStop { .. }) => step += 1,
        }
    }
    ControlFlow::Break(queue.occupant(step).is_some() || queue.has_no_planner())
}

pub(crate) const EMPTY: ReplanRequest = ReplanRequest {
    id: 0,
    step: 0,
    segment: 0,
    offset: 0.0,
    interval: 0,
    v: 0.0,
    a: 0.0,
    rests: 0,
    rate: 1.0,
    feed_factor: 1.0,
};

/// A request at parameter `x` of a piece, which is plan step `step`.
fn request_at(step: u64, flow: &TimedSegment, x: f64, v: f64, a: f64) -> ReplanRequest {
    ReplanRequest {
        step,
        segment: flow.piece.segment,
        offset: flow.piece.from + x,
        interval: flow.piece.interval,
        v,
        a,
        ..EMPTY
    }
}
