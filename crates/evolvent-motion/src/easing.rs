//! Slowing path time for a hold or stop, by the room that the plan ahead leaves: at once while the planner is asked, and to
//! rest where it does not answer.

use evolvent_machine::Limits;
use evolvent_path::{AXES, Jet};
use evolvent_plan::Step;

use crate::advance::by_time;
use crate::asking::MOST_UNANSWERED;
use crate::cursor::{Cursor, Drive};
use crate::ease::{Ease, Room};
use crate::motion::Motion;
use crate::queue::PlanConsumer;
use crate::setpoint::Inputs;
use crate::state::State;

/// Pieces whose room for slowing is looked at; where there are more in so short a time, none is.
const MOST_EASED: usize = 32;
/// By how much longer than the last one the next way to rest is that is tried: what the last one was too short by and a
/// little more.
const REST_MORE: f64 = 1.02;
/// At the most.
const REST_GROWTH: f64 = 1.6;
/// Longest way to rest, in lengths of the least that there is at this speed.
const LONGEST_REST: f64 = 4.0;

/// What was found ahead.
enum Ahead {
    /// The plan, as far as it was looked at.
    Known,
    /// It comes to rest by itself.
    Rests,
    /// The planner may still change it, or it has too many pieces.
    Unknown,
}

impl Motion {
    /// Slows path time at once where a hold or stop has just been asked for, as far as the plan ahead leaves room.
    /// Not in a cycle that has met an answer: a recorded run tells only once whether a cycle has waited.
    pub(crate) fn ease_into(&mut self, cursor: &mut Cursor, inputs: &Inputs, queue: &mut PlanConsumer) {
        let brake = self.is_told_to_stand(cursor, inputs) || self.feed_override == 0.0;
        let is_asked_for = self.asking.aim.brake || self.asking.asks_to_brake();
        let is_free = cursor.slow.is_none() && cursor.ease.is_none() && !cursor.starved;
        if !brake || is_asked_for || !is_free || self.asking.unanswered > 0 || cursor.state == State::Fault {
            return;
        }
        let mut room = Room::new(self.period * (self.asking.lead + 1) as f64);
        if let Ahead::Known = self.look_ahead(cursor, &mut room, queue) {
            cursor.ease = room.ease();
            if cursor.ease.is_some() {
                self.asking.withdraw();
            }
        }
    }

    /// Comes to rest where requests for a stop have gone unanswered: in about the least time that the plan ahead leaves
    /// room for, and in the very cycle that finds it. One way is tried in a cycle, so that its work is bounded.
    pub(crate) fn ease_to_rest(&mut self, cursor: &mut Cursor, inputs: &Inputs, queue: &mut PlanConsumer) {
        let brake = self.is_told_to_stand(cursor, inputs) || self.feed_override == 0.0;
        let has_waited = self.asking.unanswered >= MOST_UNANSWERED && !self.asking.aim.brake;
        if !brake || !has_waited || cursor.state == State::Fault {
            self.asking.rest_half = 0.0;
            return;
        }
        let base = cursor.ease.map_or(Some(1.0), |ease| ease.rate_behind());
        let (Some(base), Drive::Flow { flow, time }) = (base, cursor.drive) else {
            return;
        };
        if cursor.slow.is_some() || cursor.starved {
            return;
        }
        let Some(segment) = queue.segment(flow.piece.stretch) else {
            return;
        };
        let (state, jerk) = flow.piece.law.at(time);
        let x = (flow.piece.from + state.x).min(segment.length);
        let now = by_time(&segment.jet(x), state.v, state.a, jerk);
        let least = least_half(&self.limits, &now, base).max(self.period);
        let mut room = Room::to_rest(least.max(self.asking.rest_half), base);
        if let Ahead::Known = self.look_ahead(cursor, &mut room, queue) {
            match room.rest() {
                Ok(rest) => {
                    cursor.ease = Some(rest);
                    self.asking.withdraw();
                }
                // Where the plan is at its limits itself no length will do, until that is behind.
                Err(growth) if growth.is_infinite() => {}
                Err(growth) => {
                    let half = room.half() * (REST_MORE * growth).min(REST_GROWTH);
                    self.asking.rest_half = half.min(LONGEST_REST * least);
                }
            }
        }
    }

    /// Gathers the room that the plan leaves from here on.
    fn look_ahead(&mut self, cursor: &Cursor, room: &mut Room, queue: &mut PlanConsumer) -> Ahead {
        let Drive::Flow { flow, time } = cursor.drive else {
            return Ahead::Rests;
        };
        let (mut step, mut flow, mut time, mut ahead) = (cursor.step, flow, time, 0.0);
        for _ in 0..MOST_EASED {
            let Some(segment) = queue.segment(flow.piece.stretch) else {
                return Ahead::Unknown;
            };
            let end = flow.piece.duration.min(time + (room.span() - ahead));
            let parts = room.parts(end - time);
            for part in 0..=parts {
                let at = time + (end - time) * f64::from(part) / f64::from(parts);
                let (state, jerk) = flow.piece.law.at(at);
                let x = (flow.piece.from + state.x).min(segment.length);
                let jet = by_time(&segment.jet(x), state.v, state.a, jerk);
                room.include(&self.limits, &jet, ahead + at - time);
            }
            ahead += end - time;
            if end < flow.piece.duration || ahead >= room.span() {
                return Ahead::Known;
            }
            let (next, is_final) = queue.successor(step);
            match queue.step(next) {
                Some(Step::Flow(next)) if is_final && !self.withhold => flow = next,
                // It comes to rest there anyway.
                Some(_) if is_final && !self.withhold => return Ahead::Rests,
                _ => {
                    self.waited = true;
                    return Ahead::Unknown;
                }
            }
            (step, time) = (next, 0.0);
        }
        Ahead::Unknown
    }
}

/// Half of the least time in which path time, which passes at the rate `base`, could come to rest were the plan to go on
/// without acceleration.
fn least_half(limits: &Limits, now: &Jet, base: f64) -> f64 {
    let mut half: f64 = 0.0;
    for i in (0..AXES).filter(|&i| limits.present[i]) {
        let speed = base * now.first[i].abs() / Ease::REST_SHARE;
        half = half
            .max(speed / limits.acceleration[i])
            .max((speed / limits.jerk[i]).sqrt());
    }
    half * (1.0 + 1e-6)
}
