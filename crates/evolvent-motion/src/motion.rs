//! One step of the cycle.

use evolvent_machine::Limits;
use evolvent_path::{AXES, Axes, Jet};
use evolvent_plan::{Outcome, Profile, ScalarLimits, ScalarState, Segment, Step};

use crate::guard::{Extremes, Guard, Violation};
use crate::queue::PlanConsumer;
use crate::setpoint::{Inputs, Setpoint};
use crate::state::{State, flags};

/// Steps and segments passed in one cycle at the most. Runs last half a millisecond or more, so only a broken
/// plan comes near it.
const MOST_PER_CYCLE: usize = 512;
/// What rounding leaves between a rest at the end of a move and its end, parameter units.
const END_ROUNDING: f64 = 1e-11;

/// Where the cycle is in the plan. `Copy`: a step is computed on a copy and kept only if the guard agrees.
#[derive(Clone, Copy, Debug)]
struct Cursor {
    /// Present run, if any: its length, limits and feed.
    run: Option<(f64, ScalarLimits, f64)>,
    profile: Profile,
    /// Seconds since the profile's start.
    time: f64,
    /// Parameter, from the run's start, at which the front segment starts.
    segment_start: f64,
    /// Steps and segments passed but not yet taken from the queue.
    steps: usize,
    segments: usize,
    /// Parameter length of all runs passed.
    travelled: f64,
    /// Seconds of dwell left.
    dwell: f64,
    state: State,
    actions: u32,
    line: u32,
    block: u32,
    starved: bool,
    /// A step of curvature was passed in this cycle.
    joint: bool,
    /// The profile was solved for braking.
    braking: bool,
}

/// Motion of one machine along one plan.
///
/// `step` is pure: it looks at no clock and touches nothing but itself and the queue. It does not allocate, lock
/// or wait, and its work is bounded.
#[derive(Debug)]
pub struct Motion {
    period: f64,
    limits: Limits,
    guard: Guard,
    cursor: Cursor,
    sequence: u64,
    feed_override: f64,
    stop: bool,
    resume_seen: bool,
    fault: Option<Violation>,
    /// Set where even braking on the path breaks a limit: every axis stops by itself.
    quick_stop: Option<[(Profile, f64); AXES]>,
    quick_stop_from: Axes,
    quick_stop_time: f64,
    last: Jet,
}

impl Motion {
    /// At rest at `position`, the first setpoint still to come.
    #[must_use]
    pub fn new(limits: Limits, period_ns: u64, position: Axes) -> Self {
        let period = period_ns as f64 * 1e-9;
        let still = Jet {
            position,
            first: Axes::zeros(),
            second: Axes::zeros(),
            third: Axes::zeros(),
        };
        Self {
            period,
            limits,
            guard: Guard::new(limits, period, position),
            cursor: Cursor {
                run: None,
                profile: Profile::at_rest(0.0),
                time: 0.0,
                segment_start: 0.0,
                steps: 0,
                segments: 0,
                travelled: 0.0,
                dwell: 0.0,
                state: State::Idle,
                actions: 0,
                line: 0,
                block: 0,
                starved: false,
                joint: false,
                braking: false,
            },
            sequence: 0,
            feed_override: 1.0,
            stop: false,
            resume_seen: false,
            fault: None,
            quick_stop: None,
            quick_stop_from: position,
            quick_stop_time: 0.0,
            last: still,
        }
    }

    /// What the guard measured in the published positions.
    #[must_use]
    pub fn extremes(&self) -> &Extremes {
        self.guard.extremes()
    }

    /// The limit that the plan would have broken, if it came to that.
    #[must_use]
    pub fn fault(&self) -> Option<Violation> {
        self.fault
    }

    /// What the cycle is doing.
    #[must_use]
    pub fn state(&self) -> State {
        self.cursor.state
    }

    /// Whether the axes are at rest at a place where the plan may be waited for.
    #[must_use]
    pub fn is_at_rest(&self) -> bool {
        let state = self.cursor.profile.at(self.cursor.time).0;
        self.quick_stop.is_none() && state.v == 0.0 && state.a == 0.0
    }

    /// Whether nothing will move any more.
    #[must_use]
    pub fn is_over(&self) -> bool {
        match self.cursor.state {
            State::Done | State::Stopped => true,
            State::Fault => match &self.quick_stop {
                None => self.is_at_rest(),
                Some(axes) => axes
                    .iter()
                    .all(|(profile, _)| self.quick_stop_time >= profile.duration()),
            },
            _ => false,
        }
    }

    /// Computes the next setpoint, one period after the last.
    pub fn step(&mut self, inputs: &Inputs, queue: &mut PlanConsumer) -> Setpoint {
        let wanted = if inputs.feed_override.is_nan() {
            0.0
        } else {
            inputs.feed_override.clamp(0.0, 2.0)
        };
        let changed = wanted != self.feed_override;
        self.feed_override = wanted;
        self.stop |= inputs.stop;

        if self.quick_stop.is_none() {
            let mut cursor = self.cursor;
            self.advance(&mut cursor, inputs, changed, queue);
            let (mut jet, mut segment) = self.evaluate(&mut cursor, queue);
            if let Err(violation) = self
                .guard
                .check(&jet.position, cursor.joint, self.fault.is_some())
            {
                self.fault.get_or_insert(violation);
                cursor = self.cursor;
                cursor.state = State::Fault;
                self.advance(&mut cursor, inputs, false, queue);
                (jet, segment) = self.evaluate(&mut cursor, queue);
                if self.guard.check(&jet.position, cursor.joint, true).is_err() {
                    self.start_quick_stop();
                }
            }
            if self.quick_stop.is_none() {
                return self.publish(cursor, jet, segment.as_ref(), queue);
            }
        }
        self.step_quick_stop()
    }

    fn publish(
        &mut self,
        mut cursor: Cursor,
        jet: Jet,
        segment: Option<&Segment>,
        queue: &mut PlanConsumer,
    ) -> Setpoint {
        self.guard.publish(&jet.position, cursor.joint);
        let (state, _) = cursor.profile.at(cursor.time);
        let marks = segment.map(|segment| segment.marks).unwrap_or_default();
        let mut bits = 0;
        for (set, bit) in [
            (marks.blend, flags::BLEND),
            (marks.rapid, flags::RAPID),
            (cursor.joint, flags::JOINT),
            (cursor.starved, flags::STARVED),
            (matches!(cursor.state, State::Holding | State::Held), flags::HOLD),
            (self.fault.is_some(), flags::GUARD),
        ] {
            if set {
                bits |= bit;
            }
        }
        queue.take(cursor.steps, cursor.segments);
        (cursor.steps, cursor.segments) = (0, 0);
        // At rest the front segment is that of the next move, not of the step that is waited for.
        if let (Some(segment), Some(_)) = (segment, cursor.run) {
            (cursor.line, cursor.block) = (segment.line, segment.block);
        }
        let path_mm = cursor.travelled + if cursor.run.is_some() { state.x } else { 0.0 };
        self.cursor = cursor;
        self.last = jet;
        if self.is_over() {
            bits |= flags::LAST;
        }
        self.setpoint(jet, path_mm, bits)
    }

    fn setpoint(&mut self, jet: Jet, path_mm: f64, flags: u32) -> Setpoint {
        let sequence = self.sequence;
        self.sequence += 1;
        Setpoint {
            sequence,
            position: jet.position,
            velocity: jet.first,
            acceleration: jet.second,
            jerk: jet.third,
            path_mm,
            feed_mm_s: feed_metric(&jet.first),
            feed_override: self.feed_override,
            line: self.cursor.line,
            block: self.cursor.block,
            state: self.cursor.state,
            flags,
            actions: self.cursor.actions,
        }
    }

    /// Advances the cursor by one period.
    fn advance(&mut self, cursor: &mut Cursor, inputs: &Inputs, changed: bool, queue: &mut PlanConsumer) {
        let standing = self.stop || inputs.hold || cursor.state == State::Fault;
        let brake = standing || self.feed_override == 0.0;
        // A profile is solved once, and again only when something that it was solved for has changed.
        if cursor.run.is_some() && (brake != cursor.braking || (changed && !brake)) {
            let (now, _) = cursor.profile.at(cursor.time);
            Self::solve(cursor, now, brake, self.feed_override, queue);
        }
        let mut left = self.period;
        for _ in 0..MOST_PER_CYCLE {
            if let Some((length, _, _)) = cursor.run {
                let rest = cursor.profile.duration() - cursor.time;
                if left < rest || cursor.profile.outcome() == Outcome::Rests {
                    cursor.time = (cursor.time + left).min(cursor.profile.duration());
                    break;
                }
                left -= rest.max(0.0);
                let end = cursor.profile.end();
                cursor.run = None;
                cursor.steps += 1;
                cursor.travelled += length;
                cursor.segment_start -= length;
                let carried = ScalarState {
                    x: end.x - length,
                    ..end
                };
                cursor.profile = Profile::at_rest(carried.x);
                cursor.time = 0.0;
                self.enter(cursor, carried, brake, inputs, queue);
            } else {
                let from = cursor.profile.end();
                if cursor.dwell > 0.0 {
                    if !standing {
                        cursor.dwell -= left;
                    }
                    if cursor.dwell > 0.0 {
                        break;
                    }
                    cursor.dwell = 0.0;
                    cursor.steps += 1;
                    break;
                }
                if !self.enter(
                    cursor,
                    ScalarState {
                        x: from.x,
                        v: 0.0,
                        a: 0.0,
                    },
                    brake,
                    inputs,
                    queue,
                ) {
                    break;
                }
            }
        }
        self.settle(cursor, standing, inputs);
    }

    /// Enters the next step; `false` where it has to be waited for.
    fn enter(
        &mut self,
        cursor: &mut Cursor,
        from: ScalarState,
        brake: bool,
        inputs: &Inputs,
        queue: &mut PlanConsumer,
    ) -> bool {
        let Some(step) = queue.step(cursor.steps) else {
            return false;
        };
        let moving = from.v > 0.0;
        if !moving && brake {
            return false;
        }
        match step {
            Step::Run(run) => {
                let is_final = queue.is_final(cursor.steps);
                if !moving && !is_final {
                    return false;
                }
                cursor.starved = !is_final;
                cursor.run = Some((run.length, run.limits, run.feed));
                Self::solve(cursor, from, brake, self.feed_override, queue);
            }
            Step::Dwell { seconds, line } => {
                cursor.line = line;
                cursor.dwell = seconds;
                if seconds <= 0.0 {
                    cursor.steps += 1;
                }
            }
            Step::ProgramStop { line } => {
                cursor.line = line;
                if !inputs.resume || self.resume_seen {
                    cursor.state = State::ProgramStop;
                    return false;
                }
                self.resume_seen = true;
                cursor.state = State::Running;
                cursor.steps += 1;
            }
            Step::Action { action, line } => {
                cursor.line = line;
                cursor.actions = action + 1;
                cursor.steps += 1;
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

    fn solve(cursor: &mut Cursor, from: ScalarState, brake: bool, feed_override: f64, queue: &PlanConsumer) {
        let Some((length, limits, feed)) = cursor.run else {
            return;
        };
        let exits = queue.exit(cursor.steps);
        cursor.profile = if brake {
            Profile::brake(from, length, exits.doubled, &limits)
        } else {
            let velocity = limits.velocity.min(feed * feed_override);
            let limits = ScalarLimits { velocity, ..limits };
            Profile::solve(
                from,
                length,
                exits.at_override(feed_override),
                exits.doubled,
                &limits,
            )
        };
        cursor.braking = brake;
        cursor.time = 0.0;
    }

    /// The state after the step.
    fn settle(&mut self, cursor: &mut Cursor, standing: bool, inputs: &Inputs) {
        if !inputs.resume {
            self.resume_seen = false;
        }
        if matches!(cursor.state, State::Done | State::Fault) {
            return;
        }
        let (now, _) = cursor.profile.at(cursor.time);
        let still = cursor.run.is_none() || (now.v == 0.0 && cursor.profile.outcome() == Outcome::Rests);
        cursor.state = if self.stop {
            if still { State::Stopped } else { State::Stopping }
        } else if standing {
            if still { State::Held } else { State::Holding }
        } else if cursor.dwell > 0.0 {
            State::Dwell
        } else if cursor.run.is_none() && cursor.state == State::ProgramStop {
            State::ProgramStop
        } else if cursor.run.is_none() && cursor.state == State::Idle {
            State::Idle
        } else {
            State::Running
        };
    }

    /// Position and time derivatives at the cursor; passes segments that lie behind.
    fn evaluate(&self, cursor: &mut Cursor, queue: &mut PlanConsumer) -> (Jet, Option<Segment>) {
        let (now, jerk) = cursor.profile.at(cursor.time);
        cursor.joint = false;
        let Some(mut segment) = queue.segment(cursor.segments) else {
            let mut still = self.last;
            (still.first, still.second, still.third) = (Axes::zeros(), Axes::zeros(), Axes::zeros());
            return (still, None);
        };
        for _ in 0..MOST_PER_CYCLE {
            if now.x < cursor.segment_start + segment.length {
                break;
            }
            let Some(next) = queue.segment(cursor.segments + 1) else {
                break;
            };
            cursor.segment_start += segment.length;
            cursor.segments += 1;
            cursor.joint |= next.marks.joint;
            segment = next;
        }
        let x = (now.x - cursor.segment_start).min(segment.length);
        let mut path = segment.jet(x);
        // At rest at the end of a move the place is the programmed one to the last bit.
        let last = segment.from + segment.length >= segment.curve.domain() - END_ROUNDING;
        if cursor.run.is_none() && last && segment.length - x <= END_ROUNDING {
            path.position = segment.curve.end();
        }
        let (v, a) = (now.v, now.a);
        let jet = Jet {
            position: path.position,
            first: path.first * v,
            second: path.second * (v * v) + path.first * a,
            third: path.third * (v * v * v) + path.second * (3.0 * v * a) + path.first * jerk,
        };
        (jet, Some(segment))
    }

    /// Every axis comes to rest by itself from its last published state: the path is left.
    fn start_quick_stop(&mut self) {
        let mut axes = [(Profile::at_rest(0.0), 1.0); AXES];
        for i in 0..AXES {
            let (velocity, acceleration) = (self.last.first[i], self.last.second[i]);
            // The last setpoint has left, so its position is sound; its derivatives are not worth a wrong motion.
            if !self.limits.present[i] || !velocity.is_finite() || !acceleration.is_finite() {
                continue;
            }
            let sign = if velocity < 0.0 { -1.0 } else { 1.0 };
            let bound = self.limits.acceleration[i];
            let from = ScalarState {
                x: 0.0,
                v: velocity.abs(),
                a: (sign * acceleration).clamp(-bound, bound),
            };
            let limits = ScalarLimits {
                velocity: self.limits.velocity[i],
                acceleration: bound,
                jerk: self.limits.jerk[i],
            };
            axes[i] = (Profile::brake(from, f64::INFINITY, 0.0, &limits), sign);
        }
        self.quick_stop = Some(axes);
        self.quick_stop_from = self.guard.past()[0];
        self.quick_stop_time = 0.0;
        self.cursor.state = State::Fault;
    }

    fn step_quick_stop(&mut self) -> Setpoint {
        self.quick_stop_time += self.period;
        let mut jet = Jet {
            position: self.quick_stop_from,
            ..self.last
        };
        if let Some(axes) = &self.quick_stop {
            for (i, (profile, sign)) in axes.iter().enumerate() {
                let (now, jerk) = profile.at(self.quick_stop_time);
                jet.position[i] += sign * now.x;
                jet.first[i] = sign * now.v;
                jet.second[i] = sign * now.a;
                jet.third[i] = sign * jerk;
            }
        }
        // The travel is the last line; standing still is all that is left beyond it.
        if self.guard.check_place(&jet.position).is_err() {
            jet.position = self.guard.past()[0];
        }
        self.guard.publish(&jet.position, false);
        let mut bits = flags::GUARD;
        if self.is_over() {
            bits |= flags::LAST;
        }
        let path_mm = self.cursor.travelled;
        self.setpoint(jet, path_mm, bits)
    }
}

fn feed_metric(v: &Axes) -> f64 {
    let norm = |i: usize| (v[i] * v[i] + v[i + 1] * v[i + 1] + v[i + 2] * v[i + 2]).sqrt();
    let (xyz, uvw) = (norm(0), norm(6));
    if xyz > 0.0 {
        xyz
    } else if uvw > 0.0 {
        uvw
    } else {
        norm(3)
    }
}
