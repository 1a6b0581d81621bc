//! Requests of the cycle: a plan from a position ahead of it for another override, or from rest.

use evolvent_timing::{Entry, PathPosition};

use super::{Horizon, PendingBranch, PlanFrontier, RESERVED_STEPS, RestPoint};
use crate::step::{PlanSink, ReplanReply, ReplanRequest};

impl<S: PlanSink> Horizon<S> {
    /// Replies to the open request as soon as enough path is known. That amount must not depend on how the
    /// program text arrives. True if the request received its reply, which discards an earlier solution.
    pub(super) fn serve(&mut self) -> Result<bool, S::Error> {
        let mut gone = false;
        if let Some(request) = self.sink.request() {
            gone = self.settle();
            self.request = Some(request);
        }
        let pending = self.windows.pending_branch;
        if pending.is_some_and(|pending| self.is_withdrawn(pending.id)) {
            gone |= self.settle();
        }
        let Some(request) = self.request.filter(|request| !self.is_withdrawn(request.id)) else {
            self.request = None;
            return Ok(gone);
        };
        let frontier = self.frontier_at(&request);
        if matches!(frontier.entry, Entry::Rest) {
            // No deadline: the next windows start here.
            let known = self.windows_up_to(request.step);
            self.windows.spare.extend(self.windows.planned.drain(known..));
            self.frontier = frontier;
            self.reply(&request, Some(self.appended));
            return Ok(true);
        }
        let Some((until, exit)) = self.window(&frontier) else {
            // The path may stop at this position up to rounding; otherwise more path will arrive.
            let here = |rest: &RestPoint| rest.at <= frontier.position.interval;
            let at_rest = self.rests.get(frontier.rest).is_some_and(here);
            if at_rest {
                self.reply(&request, None);
            }
            return Ok(gone || at_rest);
        };
        // The cycle executes the window that contains the position.
        let known = self.windows_up_to(request.step);
        if let Some(planned) = known.checked_sub(1).and_then(|k| self.windows.planned.get(k)) {
            self.optimizer.restore(&planned.snapshot);
        }
        if request.rate < 1.0 {
            self.optimizer.slow_down(request.rate);
        }
        let solved = self.solve_shorter(&frontier, until, exit);
        let (until, exit) = solved.unwrap_or((until, exit));
        if solved.is_err() || self.pieces.is_empty() {
            self.restore_optimizer();
            self.reply(&request, None);
            return Ok(true);
        }
        self.windows.cut.extend(self.windows.planned.drain(known..));
        let (steps, segments, marks) = (self.pieces.len() + 3, self.segments_needed(), self.marks_needed());
        // The cycle may have stopped and sent a request from there; until that has a reply, it accepts no
        // other.
        let newer = self.sink.request();
        let is_overtaken = newer.is_some() || self.is_withdrawn(request.id);
        // Replies that were never executed may have used the capacity reserved for others. Only the cycle
        // frees it, and it may be waiting for this reply, or for windows of the plan that it executes.
        let capacity = steps + RESERVED_STEPS;
        if is_overtaken || !self.sink.has_capacity(capacity, segments, marks) {
            self.windows.planned.append(&mut self.windows.cut);
            self.restore_optimizer();
            if is_overtaken {
                self.pieces.clear();
                self.request = newer;
            } else {
                self.reply(&request, None);
            }
            return Ok(true);
        }
        if self.frontier.link.is_none() && !self.frontier.is_waiting {
            // The successor of a stop follows its step: a cycle that continues as planned must not find the
            // reply there.
            self.sink.reserve_link()?;
            self.frontier.link = Some(self.appended);
            self.appended += 1;
            self.sink.commit(self.appended);
        }
        self.windows.pending_branch = Some(PendingBranch {
            id: request.id,
            frontier: self.frontier,
            windows: 0,
        });
        let step = self.appended;
        self.frontier = frontier;
        self.commit(until, exit)?;
        self.reply(&request, Some(step));
        Ok(true)
    }

    /// Determines which plan is in force. True if the last reply came too late or its request was withdrawn,
    /// so that the previous plan remains.
    pub(super) fn settle(&mut self) -> bool {
        let Some(pending_branch) = self.windows.pending_branch.take() else {
            return false;
        };
        if self.sink.acknowledged() >= pending_branch.id {
            self.windows.spare.extend(self.windows.cut.drain(..));
            return false;
        }
        let left = self.windows.planned.len().saturating_sub(pending_branch.windows);
        self.windows.spare.extend(self.windows.planned.drain(left..));
        self.windows.planned.append(&mut self.windows.cut);
        self.frontier = pending_branch.frontier;
        self.restore_optimizer();
        self.pieces.clear();
        true
    }

    /// Whether the cycle takes over no reply to request `id` any more.
    fn is_withdrawn(&self, id: u64) -> bool {
        self.sink.withdrawn() >= id
    }

    /// Continues after the last window of the plan in force.
    pub(super) fn restore_optimizer(&mut self) {
        if let Some(planned) = self.windows.planned.back() {
            self.optimizer.restore(&planned.snapshot);
        }
    }

    fn reply(&mut self, request: &ReplanRequest, step: Option<u64>) {
        self.request = None;
        self.pieces.clear();
        self.sink.reply(ReplanReply { id: request.id, step });
    }

    fn frontier_at(&self, request: &ReplanRequest) -> PlanFrontier {
        let interval = request.interval;
        let length = self.grid.interval_length(interval).unwrap_or(0.0);
        let x = (request.offset - self.interval_start(interval)).clamp(0.0, length);
        let moving = request.v > 0.0;
        let passed = |rest: &RestPoint| match rest.step {
            Some(_) => rest.index < request.rests,
            None => rest.at < interval || (moving && rest.at == interval),
        };
        let rest = (0..self.rests.len())
            .rev()
            .find(|&k| passed(&self.rests[k]))
            .map_or(0, |k| k + 1);
        // A position at the end of an interval is the start of the next.
        let position = if x >= length {
            PathPosition {
                interval: interval + 1,
                x: 0.0,
            }
        } else {
            PathPosition { interval, x }
        };
        PlanFrontier {
            position,
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
            is_waiting: false,
        }
    }
}
