//! Asking the planner for another plan, and taking it over.
//!
//! A plan of pieces is made for one override. When that, or a hold, is wanted otherwise, the cycle asks for a plan
//! from the place where it will be a lead time later, and goes on as planned until then; the answer takes over at
//! just that setpoint. At rest there is no hurry: the cycle stands until the answer comes. A hold slows path time at once,
//! as far as the plan leaves room ([`Ease`]), and the answer takes over from there; one that nobody answers slows it to
//! rest, by the room that the plan leaves, or where that is not known by the limits alone ([`Slow`]).
//!
//! [`Ease`]: crate::ease::Ease

use evolvent_plan::{Flow, Request, Step};

use crate::advance::MOST_RESTS_PER_CYCLE;
use crate::cursor::{Cursor, Drive};
use crate::motion::Motion;
use crate::queue::PlanConsumer;
use crate::setpoint::Inputs;
use crate::slow::Slow;
use crate::state::State;

/// Time from a request to where its answer takes over, s: a re-plan takes half of it at the most.
const LEAD_S: f64 = 0.010;
/// The same for the first request of a hold or stop that cannot slow path time at once. It is worth a try: a plan that
/// only brakes is found sooner, and if it comes too late the next request leaves it the usual time.
const BRAKE_LEAD_S: f64 = 0.002;
/// Cycles of lead at the least.
const LEAST_LEAD: u64 = 2;
/// Requests for a stop in a row that may go unanswered.
pub(crate) const MOST_UNANSWERED: u32 = 2;
/// Pieces that a place ahead is looked for in.
const MOST_AHEAD: usize = 1 << 15;

/// What the pieces ahead were planned for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Aim {
    pub(crate) brake: bool,
    pub(crate) factor: f64,
}

/// A request that is open.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Asked {
    id: u64,
    aim: Aim,
    /// Its answer follows the setpoint of this number; none at rest.
    after: Option<u64>,
}

/// What the cycle has asked for, and how that went.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Asking {
    pub(crate) aim: Aim,
    open: Option<Asked>,
    asked: u64,
    pub(crate) unanswered: u32,
    /// How long half of the way to rest without an answer has to be at the least, s, as far as that was tried.
    pub(crate) rest_half: f64,
    /// No further request before this setpoint: the last one could not be met.
    not_before: u64,
    pub(crate) lead: u64,
    brake_lead: u64,
}

impl Asking {
    pub(crate) fn new(period: f64) -> Self {
        Self {
            aim: Aim {
                brake: false,
                factor: 1.0,
            },
            open: None,
            asked: 0,
            unanswered: 0,
            rest_half: 0.0,
            not_before: 0,
            lead: ((LEAD_S / period).ceil() as u64).max(LEAST_LEAD),
            brake_lead: ((BRAKE_LEAD_S / period).ceil() as u64).max(LEAST_LEAD),
        }
    }

    /// Whether a request is open.
    pub(crate) fn has_open(&self) -> bool {
        self.open.is_some()
    }

    /// Whether the request that is open is for a stop.
    pub(crate) fn asks_to_brake(&self) -> bool {
        self.open.is_some_and(|open| open.aim.brake)
    }

    /// What was asked for is met no more.
    pub(crate) fn withdraw(&mut self) {
        self.open = None;
    }

    /// The pieces to come are planned for this override.
    pub(crate) fn plan_for(&mut self, factor: f64) {
        self.aim.factor = factor;
    }

    /// A request was not met. Only those for a stop are counted: a feed that cannot be had makes no hold slower.
    fn miss(&mut self, aim: Aim) {
        self.unanswered = self.unanswered.saturating_add(u32::from(aim.brake));
    }
}

impl Motion {
    /// Whether a plan ahead may be driven as it is.
    pub(crate) fn plan_fits(&self, brake: bool) -> bool {
        let aim = self.asking.aim;
        self.asking.open.is_none() && !brake && !aim.brake && aim.factor == self.feed_override
    }

    /// Takes over an answer that is due.
    pub(crate) fn take_answer(&mut self, cursor: &mut Cursor, queue: &mut PlanConsumer) {
        let Some(open) = self.asking.open else { return };
        let answer = match open.after {
            Some(after) if self.sequence <= after => return,
            _ if self.withhold => None,
            _ => queue.answer(open.id),
        };
        match answer {
            // Path time is being slowed by now: the place that the answer was made for is not met.
            Some(_) if open.after.is_some() && (cursor.slow.is_some() || cursor.state == State::Fault) => {
                self.asking.open = None;
            }
            Some(answer) => {
                self.asking.open = None;
                let step = answer.step.filter(|_| !self.refuse);
                match step.map(|step| (step, queue.step(step))) {
                    // In motion the next piece must be there; at rest it may still come.
                    Some((step, Some(Step::Flow(flow)))) if open.after.is_some() => {
                        cursor.step = step;
                        cursor.starved = false;
                        cursor.ease = None;
                        cursor.start(flow);
                        self.asking.aim = open.aim;
                        self.asking.unanswered = 0;
                        queue.took_answer(open.id);
                    }
                    Some((step, _)) if open.after.is_none() => {
                        cursor.step = step;
                        cursor.starved = false;
                        (cursor.slow, cursor.ease) = (None, None);
                        self.asking.aim = open.aim;
                        self.asking.unanswered = 0;
                        queue.took_answer(open.id);
                    }
                    _ => {
                        self.refused = true;
                        self.asking.not_before = self.sequence + self.asking.lead;
                        self.asking.miss(open.aim);
                    }
                }
            }
            // At rest there is time.
            None if open.after.is_none() => self.waited = true,
            None => {
                self.waited = true;
                self.asking.open = None;
                self.asking.miss(open.aim);
            }
        }
    }

    /// Asks where something else is wanted than the pieces ahead were planned for.
    pub(crate) fn ask(&mut self, inputs: &Inputs, queue: &mut PlanConsumer) {
        let cursor = self.cursor;
        if self.asking.open.is_some()
            || self.quick_stop.is_some()
            || matches!(cursor.state, State::Done | State::Fault | State::Stopped)
        {
            return;
        }
        let brake = self.is_told_to_stand(&cursor, inputs) || self.feed_override == 0.0;
        let aim = Aim {
            brake,
            factor: if brake {
                self.asking.aim.factor
            } else {
                self.feed_override
            },
        };
        match cursor.drive {
            Drive::Run(_) => {}
            Drive::Flow { flow, time } => {
                let fits = aim == self.asking.aim && !cursor.starved && cursor.ease.is_none();
                if cursor.slow.is_some() || cursor.ease.is_some_and(|ease| ease.comes_to_rest()) || fits {
                    return;
                }
                if brake && (queue.has_no_planner() || self.asking.unanswered > MOST_UNANSWERED) {
                    self.cursor.slow = Some(Slow::new(&self.limits));
                    return;
                }
                // A hold does not wait because another wish could not be met.
                if (self.sequence < self.asking.not_before && !brake) || queue.has_no_planner() {
                    return;
                }
                let lead = if brake && self.asking.unanswered == 0 && cursor.ease.is_none() {
                    self.asking.brake_lead
                } else {
                    self.asking.lead
                };
                let seconds = self.period * lead as f64;
                let ahead = cursor.ease.map_or(seconds, |ease| ease.ahead(seconds));
                if let Some((flow, time)) = foresee(cursor.step, flow, time + ahead, queue) {
                    let (mut state, jerk) = flow.piece.law.at(time);
                    if let Some(ease) = cursor.ease {
                        (state, _) = ease.scale(seconds).apply(state, jerk);
                    }
                    // The last setpoint is number `sequence - 1`.
                    let after = self.sequence - 1 + lead;
                    self.send(aim, Some(after), place(&flow, state.x, state.v, state.a), queue);
                }
            }
            Drive::Still => {
                if brake || self.sequence < self.asking.not_before {
                    return;
                }
                match queue.step(cursor.step) {
                    // A hold without a planner came to rest within a piece.
                    Some(Step::Flow(flow)) if cursor.slow.is_some() => {
                        self.send(aim, None, place(&flow, cursor.rest_x, 0.0, 0.0), queue);
                    }
                    Some(Step::Flow(flow)) if aim != self.asking.aim => {
                        self.send(aim, None, place(&flow, 0.0, 0.0, 0.0), queue);
                    }
                    Some(Step::Wait) => {
                        let rest = Request {
                            segment: cursor.segment,
                            offset: cursor.rest_x - cursor.segment_start,
                            interval: cursor.interval,
                            ..EMPTY
                        };
                        self.send(aim, None, rest, queue);
                    }
                    _ => {}
                }
            }
        }
    }

    fn send(&mut self, aim: Aim, after: Option<u64>, place: Request, queue: &mut PlanConsumer) {
        self.asking.asked += 1;
        let request = Request {
            id: self.asking.asked,
            rests: self.cursor.rests,
            brake: aim.brake,
            feed_factor: aim.factor,
            ..place
        };
        if queue.ask(request) {
            self.asking.open = Some(Asked {
                id: request.id,
                aim,
                after,
            });
        } else {
            self.asking.miss(aim);
        }
    }

    /// Whether the axes stand, not at the plan's end, and nobody is left to plan on.
    pub fn is_stuck(&self, queue: &mut PlanConsumer) -> bool {
        if !queue.has_no_planner() || !self.is_at_rest() || self.is_over() || self.turning.is_some() {
            return false;
        }
        let step = self.cursor.step;
        let goes_on = match queue.step(step) {
            None | Some(Step::Wait) => false,
            Some(_) => queue.is_final(step),
        };
        self.asking.open.is_some() || !goes_on
    }

    /// Whether the next step meets nothing that the planner may still change, so that it does not depend on how
    /// fast the planner is. The virtual clock waits for this.
    pub fn is_ready(&self, queue: &mut PlanConsumer) -> bool {
        let cursor = &self.cursor;
        if self.is_over() || self.quick_stop.is_some() || self.turning.is_some() || queue.is_abandoned() {
            return true;
        }
        let mut step = cursor.step;
        if let Some(open) = self.asking.open {
            let due = open.after.is_none_or(|after| self.sequence > after);
            let answer = if due { queue.answer(open.id) } else { None };
            if due && answer.is_none() && !queue.has_no_planner() {
                return false;
            }
            // The step after this goes on where the answer says: that must be known as well.
            if let Some(next) = answer.and_then(|answer| answer.step) {
                if queue.step(next).is_none() {
                    return queue.has_no_planner();
                }
                if open.after.is_none() {
                    step = next;
                }
            }
        }
        let first = step;
        let (flow, time) = match cursor.drive {
            Drive::Flow { flow, time } => (flow, time),
            Drive::Run(_) => return queue.has_final_ahead(step),
            // Steps at rest that take no time are passed in one cycle: what follows them must be known, if it gets there.
            Drive::Still => loop {
                if step >= first + MOST_RESTS_PER_CYCLE {
                    return true;
                }
                match queue.step(step) {
                    None => return false,
                    Some(Step::Run(_)) => return queue.has_final_ahead(cursor.step),
                    Some(Step::Flow(flow)) if queue.is_final(step) => break (flow, 0.0),
                    Some(Step::Flow(_)) => return false,
                    Some(Step::Wait | Step::End { .. }) => return true,
                    Some(Step::Turning { .. }) => return queue.is_final(step),
                    Some(Step::Dwell { seconds, .. }) if seconds > 0.0 => return queue.is_final(step),
                    Some(Step::Dwell { .. } | Step::Action { .. } | Step::ProgramStop { .. }) => step += 1,
                }
            },
        };
        // Everything that the step, or a request that it makes, can see.
        let mut left = time + self.period * (2 * self.asking.lead + 4) as f64 - flow.piece.duration;
        // A tail that was claimed is driven to its end.
        let mut tail = cursor.starved;
        for _ in 0..MOST_AHEAD {
            if left < 0.0 {
                return true;
            }
            let (next, is_final) = queue.successor(step);
            tail |= queue.is_claimed(step);
            match queue.step(next) {
                Some(Step::Flow(flow)) if is_final || tail => left -= flow.piece.duration,
                Some(Step::Flow(_)) | None => return false,
                Some(_) => return true,
            }
            step = next;
        }
        true
    }
}

const EMPTY: Request = Request {
    id: 0,
    segment: 0,
    offset: 0.0,
    interval: 0,
    v: 0.0,
    a: 0.0,
    rests: 0,
    brake: false,
    feed_factor: 1.0,
};

fn place(flow: &Flow, x: f64, v: f64, a: f64) -> Request {
    Request {
        segment: flow.piece.stretch,
        offset: flow.piece.from + x,
        interval: flow.piece.interval,
        v,
        a,
        ..EMPTY
    }
}

/// The piece, and the time in it, `time` seconds after the start of `flow`; none if the axes come to rest before.
/// Settles the way to there.
fn foresee(step: u64, flow: Flow, time: f64, queue: &mut PlanConsumer) -> Option<(Flow, f64)> {
    let (mut step, mut flow, mut time) = (step, flow, time);
    for _ in 0..MOST_AHEAD {
        if time < flow.piece.duration {
            return Some((flow, time));
        }
        time -= flow.piece.duration;
        (step, _) = queue.claim_successor(step);
        flow = match queue.step(step) {
            Some(Step::Flow(next)) => next,
            _ => return None,
        };
    }
    None
}
