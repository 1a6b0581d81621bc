//! Outputs, spindle, coolant and the feed law: changes with a block or at rest.

use evolvent_gcode::{Action, CanonicalCommand, Move, MoveKind, Outputs, SPINDLES, SpindleDirection};
use evolvent_motion::QueueClosed;
use evolvent_planner::{PlanError, PlanSink, Step};
use evolvent_signals::{FeedLaw, OutputChange, OverrideSwitches, Scheduler, SignalMoment, SpindleTarget};

use super::{CARRIER_NAP, Feeder};
use crate::news::describe;

/// Changes that take effect with the next block.
pub(super) struct NextBlock {
    /// Outputs that change with it (M62, M63, M67), and the line that set them last.
    pub(super) change: OutputChange,
    pub(super) line: u32,
    /// The feed law that was scheduled last.
    pub(super) feed_law: FeedLaw,
    /// Whether feed and rapid override apply to the commands read from here on.
    pub(super) override_counts: bool,
    /// The overrides in force, as set by the program last.
    pub(super) switches: OverrideSwitches,
    /// The spindle whose override is off because a pass followed it.
    pub(super) without_override: Option<u32>,
    /// For each spindle: it was given a speed, and no feed move has waited for it yet.
    pub(super) awaits_speed: [bool; SPINDLES],
    /// For each spindle: a rapid has moved the tool along X since the spindle reached the speed for the
    /// radius.
    pub(super) has_left_radius: [bool; SPINDLES],
    /// The spindle whose angle the motion follows, as scheduled last.
    pub(super) follows: u32,
}

impl NextBlock {
    pub(super) fn new(outputs: &Outputs) -> Self {
        Self {
            change: OutputChange::at(SignalMoment::Block(0)),
            line: 0,
            feed_law: FeedLaw::default(),
            override_counts: true,
            switches: OverrideSwitches::default(),
            without_override: None,
            awaits_speed: outputs.spindles.map(|spindle| spindle.is_rotating()),
            has_left_radius: [false; SPINDLES],
            follows: 0,
        }
    }
}

impl<S: PlanSink<Error = QueueClosed>> Feeder<'_, S> {
    /// Passes a change on to the cycle, before its block or action is added to the plan.
    pub(super) fn schedule(&mut self, hand: impl Fn(&mut Scheduler) -> bool) -> Result<(), QueueClosed> {
        let Some(signals) = &mut self.links.signals else {
            return Ok(());
        };
        while !hand(signals) {
            if signals.is_abandoned() {
                return Err(QueueClosed);
            }
            self.planner.poll()?;
            std::thread::sleep(CARRIER_NAP);
        }
        Ok(())
    }

    /// Sets an output with the next block, or at rest.
    pub(super) fn set_output(
        &mut self,
        line: u32,
        is_synchronised: bool,
        text: &str,
        set: impl Fn(&mut OutputChange),
    ) -> Result<(), PlanError<QueueClosed>> {
        if is_synchronised {
            set(&mut self.next.change);
            self.next.line = line;
            return Ok(());
        }
        self.set_at_rest(line, text, set)
    }

    /// Sets an output at rest, in the order of the program.
    pub(super) fn set_at_rest(
        &mut self,
        line: u32,
        text: &str,
        set: impl Fn(&mut OutputChange),
    ) -> Result<(), PlanError<QueueClosed>> {
        let mut change = OutputChange::at(SignalMoment::Rest(self.actions));
        set(&mut change);
        self.schedule(|signals| signals.change(change))
            .map_err(PlanError::Sink)?;
        self.act(line, text)?;
        // An action takes no time, so the next move would begin in the same period. The dwell gives the new
        // value one setpoint at rest.
        let seconds = self.setup.period_ns as f64 * 1e-9;
        let dwell = Step::Dwell { seconds, line };
        self.planner.rest(&dwell).map_err(PlanError::Sink)
    }

    /// Sets which overrides are in force from the next block on. A tapping cycle needs its programmed feed
    /// from the first setpoint on, so the machine stops before it.
    pub(super) fn switch_overrides(
        &mut self,
        switches: OverrideSwitches,
        cycle: Option<&'static str>,
        line: u32,
    ) -> Result<(), PlanError<QueueClosed>> {
        self.next.override_counts = switches.feed;
        (self.next.switches, self.next.without_override) = (switches, None);
        let Some(cycle) = cycle else {
            self.next.change.overrides = Some(switches);
            return Ok(());
        };
        self.next.change.overrides = None;
        let text = if switches.feed {
            format!("overrides as before {cycle}")
        } else {
            format!("{cycle}: overrides off")
        };
        self.set_at_rest(line, &text, |change| change.overrides = Some(switches))
    }

    /// Switches off the override of a spindle that a pass follows, until the next feed move. Otherwise it
    /// would change the speed at which the pass began, and that at which a tap retracts.
    pub(super) fn suspend_override(&mut self, spindle: u32, line: u32) -> Result<(), PlanError<QueueClosed>> {
        let mut switches = self.next.switches;
        let counts = switches.spindles.get_mut(spindle as usize);
        let Some(counts) = counts.filter(|counts| **counts && self.next.without_override != Some(spindle))
        else {
            return Ok(());
        };
        *counts = false;
        self.next.without_override = Some(spindle);
        self.next.change.overrides = None;
        self.command_spindle(spindle);
        self.report_periphery(self.actions);
        let text = format!("spindle {spindle}: override off while motion follows it");
        self.set_at_rest(line, &text, |change| change.overrides = Some(switches))
    }

    /// Restores the override of a spindle that a pass has followed, from the next block on.
    pub(super) fn restore_override(&mut self) {
        if self.next.without_override.take().is_some() {
            self.next.change.overrides = Some(self.next.switches);
        }
    }

    /// Warns of outputs that wait for a move which never comes, as LinuxCNC does.
    pub(super) fn warn_of_outputs_without_move(&mut self) {
        if !self.next.change.sets_outputs() {
            return;
        }
        let text = "warning: no move follows this output, so it does not change: write a move after it, or \
                    M64, M65 or M68";
        self.reporter.announce_in_passing(self.next.line, true, text);
    }

    /// Sets the feed law of a move, by time or by spindle, from its block on.
    pub(super) fn go_by(&mut self, command: &CanonicalCommand, motion: &Move) {
        let outputs = &self.periphery.outputs;
        if motion.kind == MoveKind::Rapid {
            let moves_x = motion.curve.start()[0] != motion.curve.end()[0];
            for (has_left, spindle) in self.next.has_left_radius.iter_mut().zip(&outputs.spindles) {
                *has_left |= spindle.is_rotating() && spindle.surface.is_some() && moves_x;
            }
            return;
        }
        let spindle = outputs.spindle(command.feed_spindle);
        let law = match command.feed_mm_rev {
            Some(_) if spindle.is_rotating() => FeedLaw::Revolution {
                spindle: command.feed_spindle,
                speed: spindle.speed(),
            },
            _ => FeedLaw::Time,
        };
        self.set_feed_law(law);
    }

    pub(super) fn set_feed_law(&mut self, law: FeedLaw) {
        if law != self.next.feed_law {
            self.next.feed_law = law;
            self.next.change.feed_law = Some(law);
        }
    }

    /// Sets the feed law to time if the next action stops the spindle that feed follows. Otherwise the block
    /// that changes the law could not begin.
    fn release_feed(&mut self, spindle: u32) -> Result<(), PlanError<QueueClosed>> {
        if self.next.feed_law.spindle() != Some(spindle)
            || self.periphery.outputs.spindle(spindle).is_rotating()
        {
            return Ok(());
        }
        self.next.feed_law = FeedLaw::Time;
        self.next.change.feed_law = None;
        let change = OutputChange {
            feed_law: Some(FeedLaw::Time),
            ..OutputChange::at(SignalMoment::Rest(self.actions))
        };
        self.schedule(|signals| signals.change(change))
            .map_err(PlanError::Sink)
    }

    /// Notes that the next action commands a spindle, for whose speed feed moves will wait.
    pub(super) fn command_spindle(&mut self, spindle: u32) {
        let index = spindle as usize;
        if let (Some(command), Some(awaits)) = (
            self.periphery.spindle_commands.get_mut(index),
            self.next.awaits_speed.get_mut(index),
        ) {
            *command = u64::from(self.actions) + 1;
            *awaits = true;
        }
    }

    /// With the virtual clock, a spindle turns as commanded from the next action on.
    pub(super) fn turn_virtual_spindle(&mut self, spindle: u32) -> Result<(), QueueClosed> {
        let change = OutputChange {
            spindle: Some(self.spindle_target(spindle)),
            ..OutputChange::at(SignalMoment::Rest(self.actions))
        };
        self.schedule(|signals| signals.change(change))
    }

    /// The present command to a spindle.
    pub(super) fn spindle_target(&self, spindle: u32) -> SpindleTarget {
        let output = self.periphery.outputs.spindle(spindle);
        SpindleTarget {
            spindle,
            sign: match output.direction {
                SpindleDirection::Stopped => 0.0,
                SpindleDirection::Clockwise => 1.0,
                SpindleDirection::CounterClockwise => -1.0,
            },
            speed: output.speed(),
        }
    }

    /// Applies an action of the periphery at rest.
    pub(super) fn switch(&mut self, action: &Action, line: u32) -> Result<(), PlanError<QueueClosed>> {
        self.periphery.apply(action);
        if let Action::Spindle { spindle, .. }
        | Action::SurfaceSpeed { spindle, .. }
        | Action::OrientSpindle { spindle, .. } = action
        {
            self.command_spindle(*spindle);
            self.turn_virtual_spindle(*spindle).map_err(PlanError::Sink)?;
            self.release_feed(*spindle)?;
        }
        self.report_periphery(self.actions);
        match describe(action) {
            Some(text) => self.act(line, &text),
            None => Ok(()),
        }
    }

    /// Reports the state of the periphery from the action of this number on.
    pub(super) fn report_periphery(&self, action: u32) {
        self.reporter.periphery(action, self.periphery);
    }
}
