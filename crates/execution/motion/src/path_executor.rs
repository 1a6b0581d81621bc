//! One step of the cycle.

use evolvent_machine::Limits;
use evolvent_path::{Axes, Jet};
use evolvent_planner::{Segment, Step};
use evolvent_wire::flags;

use crate::cursor::{ActiveMotion, Cursor};
use crate::driven_path::DrivenPath;
use crate::guard::{Extremes, Guard, Violation};
use crate::plan_preview::PlanPreview;
use crate::probing::Probing;
use crate::process_cycle::ProcessSlot;
use crate::queue::PlanConsumer;
use crate::quick_stop::QuickStop;
use crate::replan::ReplanState;
use crate::replay::PlannerLag;
use crate::setpoint::{Inputs, Setpoint};
use crate::slowdown::{Lead, Slowdown};
use crate::state::MotionState;
use crate::threading::Threading;

/// Minimum feed override for which a plan is made.
const MIN_OVERRIDE: f64 = 0.001;

/// Motion of one machine along one plan.
///
/// `step` is pure: it reads no clock and changes only itself and the queue. It does not allocate, lock or
/// wait, and its work is bounded.
#[derive(Debug)]
pub struct PathExecutor {
    pub(crate) period: f64,
    pub(crate) limits: Limits,
    pub(crate) guard: Guard,
    pub(crate) cursor: Cursor,
    pub(crate) sequence: u64,
    pub(crate) feed_override: f64,
    pub(crate) stop: bool,
    pub(crate) resume_seen: bool,
    pub(crate) fault: Option<Violation>,
    /// Set if even braking on the path violates a limit: every axis stops on its own.
    pub(crate) quick_stop: Option<QuickStop>,
    pub(crate) last: Jet,
    pub(crate) is_rapid: bool,
    pub(crate) replan: ReplanState,
    /// The plan ahead, for a slowdown.
    pub(crate) preview: PlanPreview,
    /// The plan step before which the axes are at rest and for which another plan may be requested, as the
    /// last step found it.
    pub(crate) rest_step: Option<Step>,
    /// The lag of the planner in the last step.
    pub(crate) lag: PlannerLag,
    /// A process cycle that moves the axes, or that has ended the run.
    pub(crate) process: ProcessSlot,
    /// A probing move that moves the axes.
    pub(crate) probing: Option<Box<Probing>>,
    /// A pass of threading that moves the axes.
    pub(crate) threading: Option<Box<Threading>>,
}

impl PathExecutor {
    /// An executor at rest at `position` that has computed no setpoint; the plan is made for 100 % feed.
    #[must_use]
    pub fn new(limits: Limits, period_ns: u64, position: Axes) -> Self {
        let period = period_ns as f64 * 1e-9;
        Self {
            period,
            limits,
            guard: Guard::new(limits, period, position),
            cursor: Cursor::at_start(),
            sequence: 0,
            feed_override: 1.0,
            stop: false,
            resume_seen: false,
            fault: None,
            quick_stop: None,
            last: Jet::at_rest(position),
            is_rapid: false,
            replan: ReplanState::new(period),
            preview: PlanPreview::new(&limits),
            rest_step: None,
            lag: PlannerLag::default(),
            process: ProcessSlot::default(),
            probing: None,
            threading: None,
        }
    }

    /// Sets the feed override for which the first plan is made.
    #[must_use]
    pub fn planned_for(mut self, feed_override: f64) -> Self {
        self.feed_override = checked_override(feed_override);
        self.replan.planned_for(self.feed_override);
        self
    }

    /// Continues from the state in which another job has left the machine.
    pub(crate) fn begin_at(&mut self, guard: Guard, sequence: u64, actions: u32, block: u32) {
        self.guard = guard;
        self.sequence = sequence;
        self.cursor.actions = actions;
        self.cursor.block = block;
    }

    pub(crate) fn guard(&self) -> &Guard {
        &self.guard
    }

    /// Continues at rest, with the memory of `guard`.
    pub(crate) fn rejoin(&mut self, guard: &Guard) {
        self.guard = *guard;
    }

    /// Whether the axes may leave the position at which the program is held, and return to it: the program is
    /// held or at a program stop, and no probing move, thread or process cycle moves the axes.
    #[must_use]
    pub fn can_be_left(&self) -> bool {
        matches!(self.cursor.state, MotionState::Held | MotionState::ProgramStop)
            && self.is_at_rest()
            && !self.process.is_active()
            && self.probing.is_none()
            && self.threading.is_none()
            && !self.stop
    }

    /// Adds the last setpoint to the driven path. `is_switched`: an output has changed with it. Real-time
    /// safe.
    pub fn note_driven(&self, path: &mut DrivenPath, setpoint: &Setpoint, is_switched: bool) {
        let others = self.process().is_some() || self.probing.is_some() || self.threading.is_some();
        let is_barred = others || self.process.is_active() || self.quick_stop.is_some();
        path.note(setpoint, &self.last, self.period, is_switched, is_barred);
    }

    /// What the guard measured in the published positions.
    #[must_use]
    pub fn extremes(&self) -> &Extremes {
        self.guard.extremes()
    }

    /// The limit that the plan would have violated, if any.
    #[must_use]
    pub fn fault(&self) -> Option<Violation> {
        self.fault
    }

    /// The state of the cycle.
    #[must_use]
    pub fn state(&self) -> MotionState {
        self.cursor.state
    }

    /// Whether the axes are at rest at a position where the cycle may wait for the plan.
    #[must_use]
    pub fn is_at_rest(&self) -> bool {
        let state = self.cursor.now().0;
        let probes = self.probing.as_ref().is_some_and(|probing| !probing.is_at_rest());
        let threads = self
            .threading
            .as_ref()
            .is_some_and(|threading| !threading.is_at_rest());
        let plan_rests = state.v == 0.0 && state.a == 0.0;
        self.quick_stop.is_none() && plan_rests && self.process.is_at_rest() && !probes && !threads
    }

    /// The feed after the last step, as a factor of the programmed one: below the override where corners or
    /// an axis slow the machine down, and 0 at rest and in rapids. `None` along a time-optimal plan, which
    /// does not store the programmed feed.
    #[must_use]
    pub fn feed_factor(&self) -> Option<f64> {
        match &self.cursor.drive {
            ActiveMotion::Still => Some(0.0),
            ActiveMotion::Run(run) => Some(self.cursor.now().0.v / run.feed_u_s),
            ActiveMotion::TimedSegment { .. } => None,
        }
    }

    /// Whether the last setpoint belongs to a rapid or, at rest, whether the next move is one, as far as it
    /// is known.
    #[must_use]
    pub const fn is_rapid(&self) -> bool {
        self.is_rapid
    }

    /// Number of the setpoint that [`step`](Self::step) computes next.
    #[must_use]
    pub fn next_sequence(&self) -> u64 {
        self.sequence
    }

    /// The lag of the planner in the last step. In real time it depends on the speed of the planner, so it is
    /// recorded like an input.
    #[must_use]
    pub fn planner_lag(&self) -> PlannerLag {
        self.lag
    }

    /// Whether the motion is over for good.
    #[must_use]
    pub fn is_over(&self) -> bool {
        match self.cursor.state {
            MotionState::Done | MotionState::Stopped => true,
            MotionState::Fault => match &self.quick_stop {
                None => self.is_at_rest(),
                Some(stop) => stop.is_over(),
            },
            _ => false,
        }
    }

    /// Computes the next setpoint, one period after the last.
    pub fn step(&mut self, inputs: &Inputs, queue: &mut PlanConsumer) -> Setpoint {
        self.step_with(inputs, queue, PlannerLag::default())
    }

    /// The same step with the recorded lag of the planner, although the planner is not late now.
    pub(crate) fn step_with(
        &mut self,
        inputs: &Inputs,
        queue: &mut PlanConsumer,
        recorded: PlannerLag,
    ) -> Setpoint {
        self.lag = PlannerLag::default();
        queue.begin_cycle(recorded.failed_lookup);
        let setpoint = self.advance_cycle(inputs, queue, recorded.refused);
        self.lag.failed_lookup = queue.failed_lookup();
        setpoint
    }

    fn advance_cycle(&mut self, inputs: &Inputs, queue: &mut PlanConsumer, refused: bool) -> Setpoint {
        self.rest_step = None;
        let wanted = checked_override(inputs.feed_override);
        let changed = wanted != self.feed_override;
        self.feed_override = wanted;
        self.stop |= inputs.stop;

        self.process.hand_back(queue);
        if self.quick_stop.is_none() && self.process.is_active() {
            return self.step_process(inputs);
        }
        if self.quick_stop.is_none() && self.probing.is_some() {
            return self.probe(inputs, queue);
        }
        if self.quick_stop.is_none() && self.threading.is_some() {
            return self.thread(inputs, queue);
        }
        if self.quick_stop.is_none() {
            let mut cursor = self.cursor;
            self.slow_down(&mut cursor, inputs, queue);
            self.take_answer(&mut cursor, queue, refused);
            self.advance(&mut cursor, inputs, changed, queue);
            let (mut jet, mut segment) = self.evaluate(&mut cursor, queue);
            if let Err(violation) = self
                .guard
                .check(&jet.position, cursor.joint, self.fault.is_some())
            {
                self.fault.get_or_insert(violation);
                cursor = self.cursor;
                cursor.state = MotionState::Fault;
                self.slow_down(&mut cursor, inputs, queue);
                self.advance(&mut cursor, inputs, false, queue);
                (jet, segment) = self.evaluate(&mut cursor, queue);
                if self.guard.check(&jet.position, cursor.joint, true).is_err() {
                    self.start_quick_stop();
                }
            }
            if self.quick_stop.is_none() {
                let setpoint = self.publish(cursor, jet, segment.as_ref(), queue);
                self.request_replan(inputs, queue);
                if let Some(takeover) = cursor.rest.takeover {
                    self.begin(takeover, queue);
                }
                return setpoint;
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
        let marks = segment.map(|segment| segment.marks).unwrap_or_default();
        self.is_rapid = segment.is_some_and(|segment| cursor.is_rapid(segment, queue));
        // At rest the front segment belongs to the next move, and whether it is known yet depends on the
        // speed of the planner.
        let moves = !cursor.is_still();
        let mut bits = 0;
        for (set, bit) in [
            (moves && marks.blend, flags::BLEND),
            (moves && marks.rapid, flags::RAPID),
            (cursor.joint, flags::JOINT),
            (cursor.starved, flags::STARVED),
            (
                matches!(cursor.state, MotionState::Holding | MotionState::Held),
                flags::HOLD,
            ),
            (self.fault.is_some(), flags::GUARD),
        ] {
            if set {
                bits |= bit;
            }
        }
        // Not for the step that is waited for.
        if let (Some(segment), ActiveMotion::Run(_)) = (segment, &cursor.drive) {
            (cursor.line, cursor.block) = (segment.line, segment.block);
        }
        queue.take(cursor.step, cursor.segment, cursor.mark, cursor.interval);
        let path_mm = cursor.path();
        self.cursor = cursor;
        self.last = jet;
        if self.is_over() {
            bits |= flags::LAST;
        }
        self.setpoint(jet, path_mm, bits)
    }

    /// Starts a slowdown or changes its target, as hold, stop, fault and override require.
    ///
    /// A slowdown to a part of the speed ends when a plan for the override takes over. The override does not
    /// scale rapids: during a rapid only the request is made.
    fn slow_down(&mut self, cursor: &mut Cursor, inputs: &Inputs, queue: &mut PlanConsumer) {
        let ActiveMotion::TimedSegment { flow, time } = cursor.drive else {
            return;
        };
        let brake = self.stop_requested(cursor, inputs) || self.feed_override == 0.0;
        let target = if brake {
            0.0
        } else {
            (self.feed_override / self.replan.factor).min(1.0)
        };
        match &mut cursor.slowdown {
            Some(slowdown) => {
                if self.replan.has_open() && target > 0.0 && slowdown.is_nearly(target) {
                    return;
                }
                if slowdown.lead_to(target) == Lead::FromSteady {
                    self.preview.begin(cursor.step, flow, time);
                }
                match slowdown.steady_rate() {
                    None => self.replan.withdraw(self.sequence, queue),
                    // The rate is back at 1.
                    Some(rate) if rate >= 1.0 => cursor.slowdown = None,
                    Some(_) => {}
                }
            }
            None if target < 1.0 => {
                let rapid = queue
                    .segment(flow.piece.segment)
                    .is_some_and(|segment| segment.marks.rapid);
                if !brake && (rapid || self.replan.is_waiting_for(self.feed_override)) {
                    return;
                }
                self.replan.withdraw(self.sequence, queue);
                self.preview.begin(cursor.step, flow, time);
                cursor.slowdown = Some(Slowdown::new(target));
            }
            None => {}
        }
    }

    /// Whether the axes are to stop on the path and stay there.
    pub(crate) fn stop_requested(&self, cursor: &Cursor, inputs: &Inputs) -> bool {
        self.stop || inputs.hold || cursor.state == MotionState::Fault
    }

    pub(crate) fn setpoint(&mut self, jet: Jet, path_mm: f64, flags: u32) -> Setpoint {
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

    /// Every axis stops on its own from the published motion and leaves the path. Neither the plan nor its
    /// derivatives can be trusted.
    pub(crate) fn start_quick_stop(&mut self) {
        let from = self.guard.past()[0];
        let mut last = self.last;
        if let Some((velocity, acceleration)) = self.guard.measured() {
            (last.first, last.second) = (velocity, acceleration);
        }
        self.quick_stop = Some(QuickStop::new(&self.limits, from, &last));
        self.cursor.state = MotionState::Fault;
    }

    pub(crate) fn step_quick_stop(&mut self) -> Setpoint {
        let jet = match &mut self.quick_stop {
            Some(stop) => stop.advance_within(&self.guard, self.period).0,
            None => self.last,
        };
        self.guard.publish(&jet.position, false);
        // An emergency stop that comes now begins here.
        self.last = jet;
        let mut bits = flags::GUARD;
        if self.is_over() {
            bits |= flags::LAST;
        }
        let path_mm = self.cursor.travelled;
        self.setpoint(jet, path_mm, bits)
    }
}

fn checked_override(factor: f64) -> f64 {
    // NaN fails the comparison.
    if factor >= MIN_OVERRIDE {
        factor.min(2.0)
    } else {
        0.0
    }
}

pub(crate) fn feed_metric(v: &Axes) -> f64 {
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
