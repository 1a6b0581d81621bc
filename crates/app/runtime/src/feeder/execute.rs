//! Commands as steps of the plan.

use evolvent_gcode::{Action, CanonicalCommand, Move, MoveKind};
use evolvent_motion::QueueClosed;
use evolvent_path::Curve;
use evolvent_planner::{PlanError, PlanSink, Step};
use evolvent_signals::{OutputChange, OverrideSwitches, SignalMoment};

use super::{CARRIER_NAP, Feeder};
use crate::news::{Moment, StopKind, UserCall, describe};
use crate::periphery::{change_begins, tool_request};
use crate::switches::SwitchState;

impl<S: PlanSink<Error = QueueClosed>> Feeder<'_, S> {
    /// Plans a command. Returns `false` at the end of the program.
    pub(super) fn execute(&mut self, command: &CanonicalCommand) -> Result<bool, PlanError<QueueClosed>> {
        let line = command.line;
        match &command.action {
            Action::Move(motion) => {
                self.go_by(command, motion);
                self.push_move(motion, line, command.continues)?;
            }
            Action::Dwell { seconds } => {
                if self.reporter.has_passing() {
                    let action = self.actions;
                    self.actions += 1;
                    self.reporter.release(Moment::Rest(action));
                    self.planner
                        .rest(&Step::Action { action, line })
                        .map_err(PlanError::Sink)?;
                }
                self.planner
                    .rest(&Step::Dwell {
                        seconds: *seconds,
                        line,
                    })
                    .map_err(PlanError::Sink)?;
            }
            Action::ProgramStop { optional, .. } => {
                if !optional || self.switches.optional_stop {
                    self.stop(line, StopKind::Program)?;
                }
            }
            Action::UserCommand { number, p, q } => {
                let call = UserCall {
                    number: *number,
                    words: [*p, *q],
                    line,
                };
                self.counts.user_commands += 1;
                self.stop(line, StopKind::User(call))?;
            }
            Action::ProgramEnd => return Ok(false),
            Action::BeginToolChange(tool) => {
                let call = change_begins(*tool, self.periphery.tool, line);
                self.counts.tool_changes += 1;
                self.periphery.apply(&command.action);
                self.stop(line, StopKind::User(call))?;
            }
            Action::ChangeTool(tool) => self.change_tool(&command.action, *tool, line)?,
            Action::Output {
                index,
                on,
                synchronised,
            } => {
                let (index, on) = (*index, *on);
                let text = format!("output {index} {}", if on { "on" } else { "off" });
                let set = |change: &mut OutputChange| change.set_digital(index, on);
                self.set_output(line, *synchronised, &text, set)?;
            }
            Action::AnalogOutput {
                index,
                value,
                synchronised,
            } => {
                let (index, value) = (*index, *value);
                let text = format!("analog output {index} {value}");
                let set = |change: &mut OutputChange| change.set_analog(index, value);
                self.set_output(line, *synchronised, &text, set)?;
            }
            Action::Overrides {
                feed,
                spindles,
                adaptive,
                feed_stop,
                cycle,
            } => {
                let switches = OverrideSwitches {
                    feed: *feed,
                    spindles: *spindles,
                    adaptive: *adaptive,
                    feed_stop: *feed_stop,
                };
                self.switch_overrides(switches, *cycle, line)?;
            }
            Action::Spindle { .. }
            | Action::SurfaceSpeed { .. }
            | Action::Coolant { .. }
            | Action::ToolNumber(_) => {
                self.switch(&command.action, line)?;
            }
            Action::Warning(text) => self.warn_once(line, text),
            other => {
                if let Some(text) = describe(other) {
                    // Neither a message nor the selection of a tool is a reason to stop.
                    let is_message = !matches!(other, Action::SelectTool(_));
                    self.reporter.announce_in_passing(line, is_message, &text);
                }
            }
        }
        Ok(true)
    }

    /// Reports a warning of the interpreter once per line, since loops repeat it.
    fn warn_once(&mut self, line: u32, text: &str) {
        if self.reporter.warned.insert(line) {
            self.warn(line, text);
        }
    }

    /// Reports a warning without a stop.
    pub(super) fn warn(&mut self, line: u32, text: &str) {
        self.reporter
            .announce_in_passing(line, true, &format!("warning: {text}"));
    }

    /// Stops and waits for a resume. The number of a preceding action identifies the stop.
    pub(super) fn stop(&mut self, line: u32, kind: StopKind) -> Result<(), PlanError<QueueClosed>> {
        let action = self.actions;
        self.actions += 1;
        self.reporter.stop(action, kind);
        match kind {
            StopKind::User(call) => {
                self.report_periphery(action);
                self.reporter.announce(action, line, false, &call.text());
                self.hand_to_carrier(action, call)?;
            }
            StopKind::ToolChange(tool) => {
                self.report_periphery(action);
                let text = tool_request(tool, self.periphery.tool);
                self.reporter.announce(action, line, true, &text);
            }
            StopKind::Program | StopKind::Step | StopKind::Input => {}
        }
        self.last_line = 0;
        self.planner
            .rest(&Step::Action { action, line })
            .map_err(PlanError::Sink)?;
        self.planner
            .rest(&Step::ProgramStop { line })
            .map_err(PlanError::Sink)
    }

    pub(super) fn hand_to_carrier(
        &mut self,
        action: u32,
        call: UserCall,
    ) -> Result<(), PlanError<QueueClosed>> {
        let Some(carrier) = &mut self.links.carrier else {
            return Ok(());
        };
        while carrier.stops.is_full() {
            if carrier.controls.is_abandoned() || carrier.stops.is_abandoned() {
                return Err(PlanError::Sink(QueueClosed));
            }
            std::thread::sleep(CARRIER_NAP);
        }
        let _gone = carrier.stops.push(action);
        let _gone = carrier.calls.send((action, call));
        Ok(())
    }

    /// `continues`: the move is a further part of the preceding one and has its number.
    pub(super) fn push_move(
        &mut self,
        motion: &Move,
        line: u32,
        continues: bool,
    ) -> Result<(), PlanError<QueueClosed>> {
        let mut motion = *motion;
        let SwitchState {
            single_step,
            rapid_override,
            ..
        } = self.switches;
        // After another stop, and before the first move, no stop is needed.
        if single_step && self.last_line != line && self.last_line > 0 {
            self.stop(self.last_line, StopKind::Step)?;
        }
        if motion.kind == MoveKind::Rapid && rapid_override < 1.0 && self.next.override_counts {
            motion.feed_mm_s = rapid_override * self.rapid_speed(&motion.curve);
        }
        if let (MoveKind::Feed, Some(max_feed)) = (motion.kind, self.setup.machine.max_feed_mm_s) {
            motion.feed_mm_s = motion.feed_mm_s.min(max_feed);
        }
        if motion.kind == MoveKind::Feed {
            self.restore_override();
        }
        let block = self.next_block - u32::from(continues && self.next_block > 0);
        if !self.next.change.is_empty() {
            let nothing = OutputChange::at(SignalMoment::Block(block));
            let mut change = std::mem::replace(&mut self.next.change, nothing);
            change.moment = SignalMoment::Block(block);
            self.schedule(|signals| signals.change(change))
                .map_err(PlanError::Sink)?;
        }
        self.reporter.release(Moment::Block(block));
        self.planner.push(&motion, line, block)?;
        self.counts.moves += u64::from(block == self.next_block);
        self.next_block = block + 1;
        self.last_line = line;
        self.counts.path_mm += motion.curve.length();
        if self.reporter.with_blocks {
            self.end_line = line;
        }
        self.reporter.queued(&motion, line, block, self.counts.path_mm);
        Ok(())
    }

    /// The speed in the feed metric at which the first axis reaches its limit along the chord of a rapid.
    /// Never 0.
    pub(super) fn rapid_speed(&self, curve: &Curve) -> f64 {
        let limits = self.setup.machine.limits();
        let difference = curve.end() - curve.start();
        let length = curve.length();
        let mut speed = f64::INFINITY;
        for axis in 0..difference.len() {
            if limits.present[axis] && difference[axis] != 0.0 {
                speed = speed.min(limits.velocity[axis] * length / difference[axis].abs());
            }
        }
        if speed.is_finite() { speed.max(1e-3) } else { 1.0 }
    }

    /// Adds an action of the periphery, which takes effect at rest.
    pub(super) fn act(&mut self, line: u32, text: &str) -> Result<(), PlanError<QueueClosed>> {
        let action = self.actions;
        self.actions += 1;
        self.reporter.announce(action, line, false, text);
        self.planner
            .rest(&Step::Action { action, line })
            .map_err(PlanError::Sink)
    }
}
