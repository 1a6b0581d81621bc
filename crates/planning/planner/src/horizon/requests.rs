//! What the cycle requests: a plan from a position ahead of it for another override, or from rest.

use evolvent_timing::{Entry, Place};

use super::{Horizon, PendingBranch, PlanFrontier, Rest};
use crate::step::{Answer, PlanSink, Request};

impl<S: PlanSink> Horizon<S> {
    /// Serves the request that is open, as soon as enough path is known: how much that is must not depend on how
    /// the program's text happens to arrive. `true` if it was answered: what was solved before is gone.
    pub(super) fn serve(&mut self) -> Result<bool, S::Error> {
        let mut gone = false;
        if let Some(request) = self.sink.request() {
            gone = self.settle();
            self.request = Some(request);
        }
        let Some(request) = self.request else {
            return Ok(false);
        };
        let front = self.front_at(&request);
        if matches!(front.entry, Entry::Rest) {
            // Nothing is in a hurry: the next windows follow from here.
            let known = self.planned_until(front.place);
            self.windows.spare.extend(self.windows.planned.drain(known..));
            self.front = front;
            self.reply(&request, Some(self.appended));
            return Ok(true);
        }
        let Some((until, exit)) = self.window(&front) else {
            // Rounding may have the place where the path rests anyway; otherwise more of it will come.
            let here = |rest: &Rest| rest.at <= front.place.interval;
            let at_rest = self.rests.get(front.rest).is_some_and(here);
            if at_rest {
                self.reply(&request, None);
            }
            return Ok(gone || at_rest);
        };
        // The window in which the place lies is what the cycle drives there.
        let known = self.planned_until(front.place);
        if let Some(planned) = known.checked_sub(1).and_then(|k| self.windows.planned.get(k)) {
            self.optimizer.recall(&planned.memory);
        }
        if request.rate < 1.0 {
            self.optimizer.slow_down(request.rate);
        }
        let solved = self.solve_some(&front, until, exit);
        let (until, exit) = solved.unwrap_or((until, exit));
        if solved.is_err() || self.pieces.is_empty() {
            if let Some(planned) = self.windows.planned.back() {
                self.optimizer.recall(&planned.memory);
            }
            self.reply(&request, None);
            return Ok(true);
        }
        self.windows.cut.extend(self.windows.planned.drain(known..));
        let (steps, segments, marks) = (self.pieces.len() + 3, self.segments_needed(), self.marks_needed());
        while !self.sink.has_room(steps, segments, marks) {
            // The cycle may have stopped and request from there: then it takes nothing before that is answered.
            if let Some(newer) = self.sink.request() {
                self.windows.planned.append(&mut self.windows.cut);
                if let Some(planned) = self.windows.planned.back() {
                    self.optimizer.recall(&planned.memory);
                }
                self.pieces.clear();
                self.request = Some(newer);
                return Ok(true);
            }
            self.sink.wait()?;
        }
        if self.front.link.is_none() && !self.front.waits {
            // What follows a rest follows its step: a cycle that drives on as planned must not find the answer there.
            self.append_wait()?;
            self.front.waits = true;
        }
        self.windows.fork = Some(PendingBranch {
            id: request.id,
            front: self.front,
            windows: 0,
        });
        let step = self.appended;
        self.front = front;
        self.commit(until, exit)?;
        self.reply(&request, Some(step));
        Ok(true)
    }

    /// Settles which plan is in force. `true` if the last answer came too late, so that it is the one before.
    pub(super) fn settle(&mut self) -> bool {
        let Some(fork) = self.windows.fork.take() else {
            return false;
        };
        if self.sink.taken() >= fork.id {
            self.windows.spare.extend(self.windows.cut.drain(..));
            return false;
        }
        let left = self.windows.planned.len().saturating_sub(fork.windows);
        self.windows.spare.extend(self.windows.planned.drain(left..));
        self.windows.planned.append(&mut self.windows.cut);
        self.front = fork.front;
        if let Some(planned) = self.windows.planned.back() {
            self.optimizer.recall(&planned.memory);
        }
        true
    }

    fn reply(&mut self, request: &Request, step: Option<u64>) {
        self.request = None;
        self.pieces.clear();
        self.sink.answer(Answer { id: request.id, step });
    }

    fn front_at(&self, request: &Request) -> PlanFrontier {
        let interval = request.interval;
        let length = self.grid.interval_length(interval).unwrap_or(0.0);
        let x = (request.offset - self.interval_start(interval)).clamp(0.0, length);
        let moving = request.v > 0.0;
        let passed = |rest: &Rest| match rest.step {
            Some(_) => rest.index < request.rests,
            None => rest.at < interval || (moving && rest.at == interval),
        };
        let rest = (0..self.rests.len())
            .rev()
            .find(|&k| passed(&self.rests[k]))
            .map_or(0, |k| k + 1);
        // A place at an interval's end is the start of the next.
        let place = if x >= length {
            Place {
                interval: interval + 1,
                x: 0.0,
            }
        } else {
            Place { interval, x }
        };
        PlanFrontier {
            place,
            entry: if moving {
                Entry::Moving {
                    v: request.v,
                    a: request.a,
                }
            } else {
                Entry::Rest
            },
            link: None,
            rest,
            feed_factor: request.feed_factor,
            waits: false,
        }
    }
}
