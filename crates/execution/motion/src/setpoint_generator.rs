//! The state of the machine across jobs.

use evolvent_machine::Limits;
use evolvent_path::{Axes, Jet};
use evolvent_wire::flags;

use crate::guard::{Extremes, Guard, Violation};
use crate::path_executor::{PathExecutor, feed_metric};
use crate::quick_stop::QuickStop;
use crate::setpoint::Setpoint;
use crate::state::MotionState;
use crate::transfer_executor::{TransferExecutor, fits};

/// The machine across its jobs and between them: the number of the next setpoint, the memory of the guard,
/// the position of the axes.
///
/// A job is a [`PathExecutor`] along a plan, or a [`TransferExecutor`]. It begins at rest where the last one
/// ended, so that the setpoints and the measurements of the guard continue without a jump. At rest there is
/// also one setpoint per period. `Copy`; no method allocates.
#[derive(Clone, Copy, Debug)]
pub struct SetpointGenerator {
    limits: Limits,
    period: f64,
    guard: Guard,
    sequence: u64,
    last: Jet,
    line: u32,
    block: u32,
    actions: u32,
    path_mm: f64,
    feed_override: f64,
    fault: Option<Violation>,
    /// Every axis stops on its own.
    quick_stop: Option<QuickStop>,
}

impl SetpointGenerator {
    /// The state at rest at `position`.
    #[must_use]
    pub fn new(limits: Limits, period_ns: u64, position: Axes) -> Self {
        let period = period_ns as f64 * 1e-9;
        Self {
            limits,
            period,
            guard: Guard::new(limits, period, position),
            sequence: 0,
            last: Jet::at_rest(position),
            line: 0,
            block: 0,
            actions: 0,
            path_mm: 0.0,
            feed_override: 1.0,
            fault: None,
            quick_stop: None,
        }
    }

    /// Number of the next setpoint.
    #[must_use]
    pub fn sequence(&self) -> u64 {
        self.sequence
    }

    /// The control period, s.
    pub(crate) fn period(&self) -> f64 {
        self.period
    }

    pub(crate) fn guard(&self) -> &Guard {
        &self.guard
    }

    /// The last commanded position, machine coordinates.
    #[must_use]
    pub fn position(&self) -> Axes {
        self.last.position
    }

    /// What the guard measured in the published positions.
    #[must_use]
    pub fn extremes(&self) -> &Extremes {
        self.guard.extremes()
    }

    /// The violation for which the guard has rejected a setpoint since the last call.
    pub fn take_fault(&mut self) -> Option<Violation> {
        self.fault.take()
    }

    /// Whether axes are stopping on their own.
    #[must_use]
    pub fn is_quick_stopping(&self) -> bool {
        self.quick_stop.is_some()
    }

    /// Sets the override that setpoints report.
    pub fn set_override(&mut self, factor: f64) {
        self.feed_override = factor;
    }

    /// Sets the position at rest: the same position has new coordinates, or the machine was moved without
    /// power. The memory of the guard starts again there.
    pub fn relocate(&mut self, limits: Limits, position: Axes) {
        let extremes = *self.guard.extremes();
        self.limits = limits;
        self.guard = Guard::resting(limits, self.period, position, extremes);
        self.last = Jet::at_rest(position);
    }

    /// Sets the state at rest at `position`, with `sequence` the number of the next setpoint and `path_mm`
    /// the path of the last job, to recompute a recording from a point in the middle.
    pub fn restart_at(&mut self, limits: Limits, sequence: u64, position: Axes, path_mm: f64) {
        self.relocate(limits, position);
        self.quick_stop = None;
        self.fault = None;
        (self.sequence, self.path_mm) = (sequence, path_mm);
    }

    /// One setpoint at rest, or of axes that are stopping on their own.
    pub fn rest(&mut self, state: MotionState) -> Setpoint {
        if let Some(stop) = &mut self.quick_stop {
            let (jet, is_at_edge) = stop.advance_within(&self.guard, self.period);
            if stop.is_over() {
                self.quick_stop = None;
            }
            let bits = if is_at_edge { flags::GUARD } else { 0 };
            return self.publish(jet, MotionState::Stopping, bits);
        }
        let jet = Jet::at_rest(self.last.position);
        self.publish(jet, state, 0)
    }

    /// Starts a job along a plan here, at rest. Returns `false` without effect if it begins elsewhere.
    pub fn attach(&self, motion: &mut PathExecutor) -> bool {
        let here = self.last.position;
        let there = motion.last.position;
        let near = (0..here.len()).all(|i| !self.limits.present[i] || (here[i] - there[i]).abs() <= 1e-9);
        if near && self.is_at_rest() {
            motion.begin_at(self.guard, self.sequence, self.actions, self.block);
        }
        near && self.is_at_rest()
    }

    /// Takes over the state of a job along a plan after each of its setpoints.
    pub fn follow(&mut self, motion: &PathExecutor, setpoint: &Setpoint) {
        self.guard = *motion.guard();
        self.sequence = setpoint.sequence + 1;
        self.last = motion.last;
        (self.line, self.block, self.actions) = (setpoint.line, setpoint.block, setpoint.actions);
        self.path_mm = setpoint.path_mm;
        self.fault = self.fault.or(motion.fault());
    }

    /// Ends a job, where the axes are at rest.
    pub fn end(&mut self) {
        self.last = Jet::at_rest(self.guard.past()[0]);
        self.line = 0;
    }

    /// Whether a transfer begins at the present state of the axes. To be checked before it is driven.
    #[must_use]
    pub fn can_steer(&self, steering: &TransferExecutor) -> bool {
        self.quick_stop.is_none() && fits(steering.transfer(), &self.last, &self.limits)
    }

    /// Replaces a transfer in motion by another one that begins at the state of the last setpoint. Returns
    /// whether it does.
    pub fn turn(&self, steering: &mut TransferExecutor, to: &TransferExecutor) -> bool {
        steering.turn_to(to.transfer(), &self.last, &self.limits)
    }

    /// One setpoint of a transfer.
    pub fn steer(&mut self, steering: &mut TransferExecutor) -> Setpoint {
        let (jet, state) = steering.advance(self.period, &self.last, &self.limits);
        if let Err(violation) = self.guard.check(&jet.position, false, steering.is_stopping()) {
            self.fault.get_or_insert(violation);
            self.emergency();
            return self.rest(MotionState::Fault);
        }
        self.publish(jet, state, 0)
    }

    /// One setpoint of a motion that the caller evaluates.
    pub(crate) fn lead(&mut self, jet: Jet, joint: bool, is_stopping: bool) -> Setpoint {
        if let Err(violation) = self.guard.check(&jet.position, joint, is_stopping) {
            self.fault.get_or_insert(violation);
            self.emergency();
            return self.rest(MotionState::Fault);
        }
        self.publish_near(jet, MotionState::Running, 0, joint)
    }

    /// Sets the position at rest to `position`, which is close: the next setpoint is exactly there.
    pub(crate) fn rest_at(&mut self, position: Axes) {
        self.last = Jet::at_rest(position);
    }

    /// Stops every axis on its own, as fast as its acceleration and jerk permit. The present motion is over.
    pub fn emergency(&mut self) {
        if self.quick_stop.is_none() && !self.is_at_rest() {
            let from = self.guard.past()[0];
            self.quick_stop = Some(QuickStop::new(&self.limits, from, &self.last));
        }
    }

    /// Whether nothing moved in the last setpoint.
    #[must_use]
    pub fn is_at_rest(&self) -> bool {
        self.quick_stop.is_none() && self.last.first == Axes::zeros() && self.last.second == Axes::zeros()
    }

    fn publish(&mut self, jet: Jet, state: MotionState, bits: u32) -> Setpoint {
        self.publish_near(jet, state, bits, false)
    }

    /// `joint`: near a step of exact-path mode.
    fn publish_near(&mut self, mut jet: Jet, state: MotionState, bits: u32, joint: bool) -> Setpoint {
        // The travel is the last limit: beyond it the only action left is to stand still.
        let mut bits = if joint { bits | flags::JOINT } else { bits };
        if self.guard.check_position(&jet.position).is_err() {
            jet = Jet::at_rest(self.guard.past()[0]);
            self.quick_stop = None;
            bits |= flags::GUARD;
        }
        self.guard.publish(&jet.position, joint);
        self.last = jet;
        let sequence = self.sequence;
        self.sequence += 1;
        Setpoint {
            sequence,
            position: jet.position,
            velocity: jet.first,
            acceleration: jet.second,
            jerk: jet.third,
            path_mm: self.path_mm,
            feed_mm_s: feed_metric(&jet.first),
            feed_override: self.feed_override,
            line: 0,
            block: self.block,
            state,
            flags: bits,
            actions: self.actions,
        }
    }
}
