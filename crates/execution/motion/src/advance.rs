//! One period along the plan.

use evolvent_path::Jet;
use evolvent_planner::{ScalarState, Segment, Step, TimedSegment};

use crate::cursor::{ActiveMotion, Cursor};
use crate::path_executor::PathExecutor;
use crate::queue::PlanConsumer;
use crate::run_drive::{Pace, RunProgress};
use crate::setpoint::Inputs;
use crate::slowdown::Ahead;
use crate::state::State;
use crate::takeover::Takeover;

/// Steps, segments and marks passed in one cycle at most. Pieces are as short as the path's shortest blocks
/// make them, so only a broken plan comes near it.
const MAX_PER_CYCLE: usize = 4096;
/// Steps at rest that take no time and are passed in one cycle at most: a program may have thousands in a
/// row, more than the queue holds.
pub(crate) const MAX_RESTS_PER_CYCLE: u64 = 32;
/// What rounding leaves between a rest at the end of a move and its end, parameter units.
const END_ROUNDING: f64 = 1e-11;
/// A block that starts within this of a piece's end starts with the next piece, parameter units: path lengths
/// and the places of blocks are sums of their own.
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
        // A profile is solved once, and again only when something that it was solved for has changed.
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
            // Within a piece: that the slowdown stays tells that it goes on from there with a new plan only.
            let x = cursor.now().0.x;
            cursor.leave(&flow);
            cursor.rest.x = x;
            cursor.travelled = flow.path + x;
        }
        self.settle(cursor, standing, inputs);
    }

    /// Enters the next step; `false` where it has to be waited for, and where nothing more is entered in this
    /// cycle.
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
        // Where a place is kept, it is as if the step that will take it had not come yet.
        let found = queue.occupant(cursor.step).and_then(|index| {
            let step = queue.step(index)?;
            Some((index, step, queue.is_final(index)))
        });
        let is_known = found.is_some_and(|(_, step, is_final)| {
            // A stop has ended within a piece: another plan will be made from there anyway.
            is_final || !step.begins_motion() || cursor.slowdown.is_some()
        });
        if at_rest && !queue.look(is_known) {
            return false;
        }
        let Some((index, step, is_final)) = found else {
            return queue.look(false);
        };
        // A feed of zero keeps the axes where they are, and nothing else: a dwell, an output or a stop comes
        // when it is its turn.
        if at_rest && pace.brake && step.begins_motion() {
            return false;
        }
        cursor.step = index;
        self.enter_step(cursor, step, (from, is_final), pace, inputs, queue)
    }

    /// From state `from`, `is_final` if the step cannot change any more.
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
                // A stop within a piece, or a plan for another override: both are replaced before anything
                // moves.
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
                // A request to go on from before the machine was here does not count: it cannot have meant
                // this stop.
                let stood_here = cursor.state == State::ProgramStop;
                if !inputs.resume || self.resume_seen || !stood_here {
                    cursor.state = State::ProgramStop;
                    return false;
                }
                self.resume_seen = true;
                cursor.state = State::Running;
                cursor.pass_rest();
            }
            Step::Action { action, line } => {
                cursor.line = line;
                cursor.actions = action + 1;
                cursor.pass_rest();
            }
            Step::Turning { line } | Step::Probe { line } | Step::Thread { line } => {
                cursor.line = line;
                cursor.state = State::Running;
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
                cursor.state = State::Done;
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
        if matches!(cursor.state, State::Done | State::Fault) {
            return;
        }
        let still = match &cursor.drive {
            ActiveMotion::Still => true,
            ActiveMotion::Run(run) => run.rests(),
            ActiveMotion::TimedSegment { .. } => false,
        };
        cursor.state = if self.stop {
            if still { State::Stopped } else { State::Stopping }
        } else if standing {
            if still { State::Held } else { State::Holding }
        } else if cursor.rest.dwell > 0.0 {
            State::Dwell
        } else if cursor.is_still() && cursor.state == State::ProgramStop {
            State::ProgramStop
        } else if cursor.is_still() && cursor.state == State::Idle {
            State::Idle
        } else {
            State::Running
        };
    }

    /// Position and time derivatives at the cursor; passes segments and blocks that were passed.
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
        // Where the path rests at the piece's end, it is a matter of the planner's speed whether the block
        // after is known yet.
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
        // At rest at the end of a move the place is the programmed one to the last bit.
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
            // Zero times a derivative may be -0.0, and whether there is a segment yet is a matter of the
            // planner's speed.
            return (Jet::at_rest(place.position), Some(segment));
        }
        (place.compose(now.v, now.a, jerk), Some(segment))
    }
}

impl Cursor {
    /// Drives a piece of a time law for the time that is left of the period; whether another one follows in
    /// it.
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
        // A rest of the plan ends a slowdown, and what has not been final is entered from rest like any
        // other.
        let stays = (self.slowdown.is_some() || is_unfinished) && rests;
        if let Some(Step::TimedSegment(flow)) = queue.step(next)
            && !stays
        {
            self.starved |= is_unfinished;
            self.start(flow);
            return true;
        }
        // Rest steps take effect in the cycle after. At rest as planned, nothing is left to be slowed.
        self.slowdown = None;
        false
    }

    /// At rest, with `left` of the period: the state from which the next step is entered, if it is in this
    /// cycle. `rests`: steps at rest passed before this cycle.
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

    /// The step at rest is over.
    pub(crate) fn pass_rest(&mut self) {
        self.step += 1;
        self.rest.passed += 1;
    }

    /// Drives a piece from its start.
    pub(crate) fn start(&mut self, flow: TimedSegment) {
        self.drive = ActiveMotion::TimedSegment { flow, time: 0.0 };
        self.rest.position = None;
        self.interval = flow.piece.interval;
        self.piece_at = Some((flow.piece.segment, flow.piece.from));
        self.travelled = flow.path;
    }

    /// At rest at the end of a piece.
    fn leave(&mut self, flow: &TimedSegment) {
        self.drive = ActiveMotion::Still;
        self.rest.x = flow.piece.length;
        self.travelled = flow.path + flow.piece.length;
    }
}

impl Cursor {
    /// Whether a rapid is driven, or comes next where the present segment has been driven to its end.
    pub(crate) fn is_rapid(&self, segment: &Segment, queue: &mut PlanConsumer) -> bool {
        let left = self.segment_start + segment.length - self.now().0.x;
        if self.is_still() && left <= NEXT_PIECE {
            let next = queue.segment(self.segment + 1);
            return next.is_some_and(|segment| segment.marks.rapid);
        }
        segment.marks.rapid
    }
}
