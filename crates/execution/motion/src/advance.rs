//! Advances the cursor along the plan by one period.

use evolvent_path::Jet;
use evolvent_planner::{ScalarState, Segment, Step, TimedSegment};

use crate::cursor::{ActiveMotion, Cursor};
use crate::path_executor::PathExecutor;
use crate::queue::PlanConsumer;
use crate::run_drive::{Pace, RunProgress};
use crate::setpoint::Inputs;
use crate::slowdown::Ahead;
use crate::state::MotionState;
use crate::takeover::Takeover;

/// Maximum number of steps, segments and marks passed in one cycle. Pieces are about as long as the shortest
/// blocks of the path, so only a broken plan comes near this number.
const MAX_PER_CYCLE: usize = 4096;
/// Maximum number of rest steps without duration that are passed in one cycle: a program may have thousands
/// in a row, more than the queue holds.
pub(crate) const MAX_RESTS_PER_CYCLE: u64 = 32;
/// Rounding between a rest at the end of a move and the end of the move, parameter units.
const END_ROUNDING: f64 = 1e-11;
/// A block that starts within this distance of the end of a piece starts with the next piece, parameter
/// units: path lengths and block positions are summed independently.
const NEXT_PIECE: f64 = 1e-6;

impl PathExecutor {
    /// Advances the cursor by one period.
    pub(crate) fn advance(
        &mut self,
        cursor: &mut Cursor,
        inputs: &Inputs,
        changed: bool,
        queue: &mut PlanConsumer,
    ) {
        let standing = self.stop_requested(cursor, inputs);
        let brake = standing || self.feed_override == 0.0;
        let pace = Pace {
            brake,
            feed_override: self.feed_override,
        };
        // A profile is solved once, and again only when one of its inputs has changed.
        if let ActiveMotion::Run(run) = &cursor.drive
            && (brake != run.braking || (changed && !brake))
        {
            cursor.solve_run(pace, queue);
        }
        let mut left = match &mut cursor.slowdown {
            Some(slowdown) => {
                let mut ahead = Ahead {
                    preview: &mut self.preview,
                    queue,
                };
                slowdown.advance(self.period, &self.limits, &mut ahead)
            }
            None => self.period,
        };
        let rests = cursor.rest.passed;
        for _ in 0..MAX_PER_CYCLE {
            let goes_on = match cursor.drive {
                ActiveMotion::Run(_) => match cursor.advance_run(&mut left, queue) {
                    RunProgress::Within => false,
                    RunProgress::Levelled => {
                        cursor.solve_run(pace, queue);
                        true
                    }
                    RunProgress::Left(carried) => {
                        self.enter(cursor, carried, pace, inputs, queue);
                        true
                    }
                },
                ActiveMotion::TimedSegment { .. } => cursor.advance_segment(&mut left, queue),
                ActiveMotion::Still => match cursor.wait_at_rest(left, standing, rests) {
                    None => false,
                    Some(from) => self.enter(cursor, from, pace, inputs, queue),
                },
            };
            if !goes_on {
                break;
            }
        }
        if cursor.slowdown.is_some_and(|slowdown| slowdown.is_at_rest())
            && let ActiveMotion::TimedSegment { flow, .. } = cursor.drive
        {
            // The plan rests within a piece. The slowdown is kept as the mark that only a new plan continues
            // from here.
            let x = cursor.now().0.x;
            cursor.leave(&flow);
            cursor.rest.x = x;
            cursor.travelled = flow.path + x;
        }
        self.settle(cursor, standing, inputs);
    }

    /// Enters the next step. Returns `false` if it has to be waited for, and if nothing more is entered in
    /// this cycle.
    fn enter(
        &mut self,
        cursor: &mut Cursor,
        from: ScalarState,
        pace: Pace,
        inputs: &Inputs,
        queue: &mut PlanConsumer,
    ) -> bool {
        let at_rest = from.v <= 0.0;
        let standing = self.stop_requested(cursor, inputs);
        if at_rest && standing {
            return false;
        }
        // A reserved step counts as missing until a step is linked to it.
        let found = queue.occupant(cursor.step).and_then(|index| {
            let step = queue.step(index)?;
            Some((index, step, queue.is_final(index)))
        });
        let is_known = found.is_some_and(|(_, step, is_final)| {
            // A stop has ended within a piece: another plan is made from there in any case.
            is_final || !step.begins_motion() || cursor.slowdown.is_some()
        });
        if at_rest && !queue.record_lookup(is_known) {
            return false;
        }
        let Some((index, step, is_final)) = found else {
            return queue.record_lookup(false);
        };
        // A feed of zero only prevents motion. A dwell, an output or a stop takes effect when it is reached.
        if at_rest && pace.brake && step.begins_motion() {
            return false;
        }
        cursor.step = index;
        self.enter_step(cursor, step, (from, is_final), pace, inputs, queue)
    }

    /// Enters a step from state `from`; `is_final` if the step cannot change any more.
    fn enter_step(
        &mut self,
        cursor: &mut Cursor,
        step: Step,
        (from, is_final): (ScalarState, bool),
        pace: Pace,
        inputs: &Inputs,
        queue: &mut PlanConsumer,
    ) -> bool {
        match step {
            Step::Run(run) => {
                cursor.starved = !is_final;
                cursor.rest.position = None;
                cursor.enter_run(&run, from, pace, queue);
            }
            Step::TimedSegment(flow) => {
                // A stop within a piece, or a plan for another override: both are replaced before any motion.
                if cursor.slowdown.is_some() || !self.plan_fits(cursor.step, pace.brake) {
                    self.rest_step = Some(step);
                    return false;
                }
                cursor.starved = false;
                cursor.start(flow);
            }
            Step::Wait => {
                self.rest_step = Some(step);
                return false;
            }
            Step::Dwell { seconds, line } => {
                cursor.line = line;
                cursor.rest.dwell = seconds;
                if seconds <= 0.0 {
                    cursor.pass_rest();
                }
            }
            Step::ProgramStop { line } | Step::InputWait { line } => {
                cursor.line = line;
                // A request to resume from before the machine was here does not count: it cannot refer to
                // this stop.
                let stood_here = cursor.state == MotionState::ProgramStop;
                if !inputs.resume || self.resume_seen || !stood_here {
                    cursor.state = MotionState::ProgramStop;
                    return false;
                }
                self.resume_seen = true;
                cursor.state = MotionState::Running;
                cursor.pass_rest();
            }
            Step::Action { action, line } => {
                cursor.line = line;
                cursor.actions = action + 1;
                cursor.pass_rest();
            }
            Step::Turning { line } | Step::Probe { line } | Step::Thread { line } => {
                cursor.line = line;
                cursor.state = MotionState::Running;
                cursor.rest.takeover = Some(match step {
                    Step::Probe { .. } => Takeover::Probing,
                    Step::Thread { .. } => Takeover::Threading,
                    _ => Takeover::Process,
                });
                return false;
            }
            Step::End { line } => {
                if line > 0 {
                    cursor.line = line;
                }
                cursor.state = MotionState::Done;
                return false;
            }
        }
        true
    }

    /// The state after the step.
    fn settle(&mut self, cursor: &mut Cursor, standing: bool, inputs: &Inputs) {
        if !inputs.resume {
            self.resume_seen = false;
        }
        if matches!(cursor.state, MotionState::Done | MotionState::Fault) {
            return;
        }
        let still = match &cursor.drive {
            ActiveMotion::Still => true,
            ActiveMotion::Run(run) => run.rests(),
            ActiveMotion::TimedSegment { .. } => false,
        };
        cursor.state = if self.stop {
            if still {
                MotionState::Stopped
            } else {
                MotionState::Stopping
            }
        } else if standing {
            if still {
                MotionState::Held
            } else {
                MotionState::Holding
            }
        } else if cursor.rest.dwell > 0.0 {
            MotionState::Dwell
        } else if cursor.is_still() && cursor.state == MotionState::ProgramStop {
            MotionState::ProgramStop
        } else if cursor.is_still() && cursor.state == MotionState::Idle {
            MotionState::Idle
        } else {
            MotionState::Running
        };
    }

    /// Position and time derivatives at the cursor. Advances over segments and block marks that have been
    /// passed.
    pub(crate) fn evaluate(&self, cursor: &mut Cursor, queue: &mut PlanConsumer) -> (Jet, Option<Segment>) {
        let (now, jerk) = cursor.now();
        cursor.joint = false;
        if let Some((stretch, from)) = cursor.piece_at {
            for _ in 0..MAX_PER_CYCLE {
                if cursor.segment >= stretch {
                    break;
                }
                cursor.segment += 1;
                cursor.joint |= queue
                    .segment(cursor.segment)
                    .is_some_and(|segment| segment.marks.joint);
            }
            cursor.segment_start = -from;
        }
        let Some(mut segment) = queue.segment(cursor.segment) else {
            return (Jet::at_rest(self.last.position), None);
        };
        if matches!(cursor.drive, ActiveMotion::Run(_)) {
            for _ in 0..MAX_PER_CYCLE {
                if now.x < cursor.segment_start + segment.length {
                    break;
                }
                let Some(next) = queue.segment(cursor.segment + 1) else {
                    break;
                };
                cursor.segment_start += segment.length;
                cursor.segment += 1;
                cursor.joint |= next.marks.joint;
                segment = next;
            }
        }
        let path = cursor.path();
        // If the path rests at the end of the piece, whether the next block is known yet depends on the speed
        // of the planner.
        let next_piece = match &cursor.drive {
            ActiveMotion::TimedSegment { flow, .. } => {
                let length = flow.piece.length;
                flow.path + (length - NEXT_PIECE).max(0.5 * length)
            }
            _ => f64::INFINITY,
        };
        for _ in 0..MAX_PER_CYCLE {
            match queue.mark(cursor.mark) {
                Some(mark)
                    if path + END_ROUNDING >= mark.start && mark.start < next_piece && !cursor.is_still() =>
                {
                    cursor.mark += 1;
                    (cursor.line, cursor.block) = (mark.line, mark.block);
                }
                _ => break,
            }
        }
        let x = (now.x - cursor.segment_start).min(segment.length);
        let mut place = segment.jet(x);
        // At rest at the end of a move the position is exactly the programmed one.
        let last = segment.from + segment.length >= segment.curve.domain() - END_ROUNDING;
        if cursor.is_still() && last && segment.length - x <= END_ROUNDING {
            place.position = segment.curve.end();
        }
        if cursor.is_still()
            && let Some(position) = cursor.rest.position
        {
            return (Jet::at_rest(position), Some(segment));
        }
        if cursor.is_still() {
            // Zero times a derivative may be -0.0, and whether the segment is known yet depends on the speed
            // of the planner.
            return (Jet::at_rest(place.position), Some(segment));
        }
        (place.compose(now.v, now.a, jerk), Some(segment))
    }
}

impl Cursor {
    /// Drives a timed segment for the rest of the period. Returns whether another segment starts within the
    /// period.
    fn advance_segment(&mut self, left: &mut f64, queue: &mut PlanConsumer) -> bool {
        let ActiveMotion::TimedSegment { flow, time } = &mut self.drive else {
            return false;
        };
        let rest = flow.piece.duration_s - *time;
        if *left < rest {
            *time += *left;
            return false;
        }
        *left -= rest.max(0.0);
        let flow = *flow;
        self.leave(&flow);
        let rests = flow.rests_at_end();
        let (next, is_unfinished) = queue.settle_successor(self.step, rests);
        self.step = next;
        // A rest of the plan ends a slowdown. A step after it that was not final is entered from rest like
        // any other.
        let stays = (self.slowdown.is_some() || is_unfinished) && rests;
        if let Some(Step::TimedSegment(flow)) = queue.step(next)
            && !stays
        {
            self.starved |= is_unfinished;
            self.start(flow);
            return true;
        }
        // Rest steps take effect in the following cycle. The plan rests, so the slowdown is over.
        self.slowdown = None;
        false
    }

    /// At rest, with `left` of the period remaining: the state from which the next step is entered, if it is
    /// entered in this cycle. `rests` is the number of rest steps passed before this cycle.
    fn wait_at_rest(&mut self, left: f64, standing: bool, rests: u64) -> Option<ScalarState> {
        if std::mem::take(&mut self.rest.stays) {
            return None;
        }
        if self.rest.dwell > 0.0 {
            if !standing {
                self.rest.dwell -= left;
            }
            if self.rest.dwell <= 0.0 {
                self.rest.dwell = 0.0;
                self.pass_rest();
            }
            return None;
        }
        (self.rest.passed - rests < MAX_RESTS_PER_CYCLE).then_some(ScalarState {
            x: self.rest.x,
            v: 0.0,
            a: 0.0,
        })
    }

    /// Passes a completed rest step.
    pub(crate) fn pass_rest(&mut self) {
        self.step += 1;
        self.rest.passed += 1;
    }

    /// Starts a timed segment.
    pub(crate) fn start(&mut self, flow: TimedSegment) {
        self.drive = ActiveMotion::TimedSegment { flow, time: 0.0 };
        self.rest.position = None;
        self.interval = flow.piece.interval;
        self.piece_at = Some((flow.piece.segment, flow.piece.from));
        self.travelled = flow.path;
    }

    /// Rests at the end of a timed segment.
    fn leave(&mut self, flow: &TimedSegment) {
        self.drive = ActiveMotion::Still;
        self.rest.x = flow.piece.length;
        self.travelled = flow.path + flow.piece.length;
    }
}

impl Cursor {
    /// Whether the motion is a rapid, or, at the end of the present segment at rest, whether the next one is.
    pub(crate) fn is_rapid(&self, segment: &Segment, queue: &mut PlanConsumer) -> bool {
        let left = self.segment_start + segment.length - self.now().0.x;
        if self.is_still() && left <= NEXT_PIECE {
            let next = queue.segment(self.segment + 1);
            return next.is_some_and(|segment| segment.marks.rapid);
        }
        segment.marks.rapid
    }
}
