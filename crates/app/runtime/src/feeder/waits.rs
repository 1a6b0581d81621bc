//! Waits of the program: for inputs, the spindle, probing moves and turning cycles.

use std::path::Path;

use evolvent_gcode::{Action, CanonicalCommand};
use evolvent_machine::{AtSpeed, SignalKind};
use evolvent_motion::{ProbeMove, ProbeResult, ProbeVerdict, ProcessCycle, QueueClosed};
use evolvent_path::{Axes, AxisLetter};
use evolvent_planner::{PlanError, PlanSink, Step};
use evolvent_signals::{Awaited, FeedLaw, InputWait, OutputChange, Scheduler, SignalMoment, WaitMode};

use super::links::{CycleLinks, hand_over};
use super::{Feeder, INPUT_NAP};
use crate::news::{StopKind, spindle_name, with_article};
use crate::periphery::UnplannedMove;
use crate::probing::{complaint, objection, probing};
use crate::refusal::{ProgramError, about_line_with, at_origin, cannot_turn};
use crate::source::Commands;
use crate::turning::turning;
use crate::turning_motion::TurningMotion;

/// Result of a command that the program may wait for.
pub(super) enum Waited {
    /// The command needs no wait.
    None,
    /// The command was carried out.
    Over,
    /// Nothing is driven any more.
    Gone,
}

impl<S: PlanSink<Error = QueueClosed>> Feeder<'_, S> {
    /// Carries out a command and waits until it is complete.
    pub(super) fn wait_out(
        &mut self,
        command: &CanonicalCommand,
        commands: &mut Commands,
        program: &Path,
    ) -> Result<Waited, ProgramError> {
        let line = command.line;
        if let Action::OrientSpindle {
            spindle,
            degrees,
            timeout_s,
            ..
        } = command.action
        {
            match self.orient(&command.action, spindle, degrees, timeout_s, line) {
                Ok(None) => {}
                Ok(Some((message, help))) => {
                    return Err(self.refused(command, program, message, help));
                }
                Err(_gone) => return Ok(Waited::Gone),
            }
            self.report_blocks(false);
            return Ok(Waited::Over);
        }
        if let Action::Turning(cycle) = &command.action {
            let turning = turning(cycle, self.setup).map_err(|what| ProgramError::Text {
                file: self.file.clone(),
                diagnostic: Box::new(at_origin(command, program, |file, line| {
                    cannot_turn(what, file, line)
                })),
            })?;
            return Ok(match self.turn(turning, command.line) {
                Ok(()) => Waited::Over,
                Err(_gone) => Waited::Gone,
            });
        }
        if let Action::WaitInput {
            index,
            analog,
            mode,
            timeout_s,
        } = command.action
        {
            let kind = if analog {
                SignalKind::Analog
            } else {
                SignalKind::Digital
            };
            match self.wait_for_input(kind, index, mode, timeout_s, line) {
                // -1 for an unknown input, as after a timeout.
                Ok(value) => commands.set_input_result(value.unwrap_or(-1.0)),
                Err(_gone) => return Ok(Waited::Gone),
            }
            self.report_blocks(false);
            return Ok(Waited::Over);
        }
        if let Action::Probe {
            curve,
            feed_mm_s: feed,
            toward,
            must,
        } = command.action
        {
            let order = ProbeMove {
                curve,
                feed_mm_s: feed,
                toward,
            };
            if let Some(objection) = objection(&order, self.setup) {
                return Err(self.wrong(at_origin(command, program, |file, line| {
                    objection.diagnostic(file, line)
                })));
            }
            let Ok(result) = self.probe(order, line) else {
                return Ok(Waited::Gone);
            };
            if let Some((message, help)) = complaint(&result, toward, must) {
                return Err(self.wrong(at_origin(command, program, |file, line| {
                    about_line_with(message, Some(help), file, line)
                })));
            }
            let tripped = result.verdict == ProbeVerdict::Contact;
            commands.set_probe_result(&result.position, &result.stop_position, tripped);
            if let Some((message, help)) = self.log_probe(commands, tripped) {
                return Err(self.refused(command, program, message, help));
            }
            self.report_blocks(false);
            return Ok(Waited::Over);
        }
        Ok(Waited::None)
    }

    /// Stops and starts a turning cycle.
    pub(super) fn turn(&mut self, turning: TurningMotion, line: u32) -> Result<(), QueueClosed> {
        // Its passes use the feed at the speed that the cycle was planned for.
        self.set_feed_law(FeedLaw::Time);
        let turning: Box<dyn ProcessCycle> = Box::new(turning);
        hand_over(&mut self.links.processes, &mut self.planner, turning)?;
        if !self.next.change.is_empty() {
            // The passes of the cycle are not blocks: changes with them take effect where they begin, at
            // rest.
            let change = OutputChange {
                moment: SignalMoment::Rest(self.actions),
                ..self.next.change
            };
            self.next.change = OutputChange::at(SignalMoment::Block(0));
            let action = self.actions;
            self.actions += 1;
            self.schedule(|signals| signals.change(change))?;
            self.planner.rest(&Step::Action { action, line })?;
        }
        self.last_line = 0;
        self.planner.rest(&Step::Turning { line })
    }

    /// Waits until every spindle has its last commanded speed. Returns the reason if one does not reach it in
    /// time.
    pub(super) fn await_speeds(&mut self, line: u32) -> Result<Option<(String, String)>, QueueClosed> {
        for (number, awaits) in std::mem::take(&mut self.next.awaits_speed)
            .into_iter()
            .enumerate()
        {
            if !awaits {
                continue;
            }
            let late = self.await_speed(number as u32, line)?;
            if late.is_some() {
                return Ok(late);
            }
        }
        Ok(None)
    }

    /// Waits for the speed of one spindle, if anything reports it.
    fn await_speed(&mut self, number: u32, line: u32) -> Result<Option<(String, String)>, QueueClosed> {
        let output = self.periphery.outputs.spindle(number);
        let turns = output.is_rotating() && output.speed().rpm_at(0.0) > 0.0;
        let Some(spindle) = self.setup.machine.signals.spindle(number).filter(|_| turns) else {
            return Ok(None);
        };
        let speed = match output.surface {
            Some(surface) => format!("{} m/min", surface.speed_m_min),
            None => format!("{} rpm", output.constant_rpm()),
        };
        let timeout_s = spindle.at_speed_timeout_s;
        let has_ramp = spindle.ramp_rpm_s.is_some();
        let by_command = Awaited::AtSpeed {
            spindle: spindle.number,
            command: self.periphery.spindle_commands[number as usize],
        };
        let by_input = |number| Awaited::Input {
            kind: SignalKind::Digital,
            number,
            mode: WaitMode::High,
        };
        // The input refers to the present command, so the ramp has to end first.
        let awaited = match spindle.at_speed {
            AtSpeed::Unknown if !has_ramp => return Ok(None),
            AtSpeed::Unknown | AtSpeed::Feedback => [Some(by_command), None],
            AtSpeed::Input(input) if has_ramp => [Some(by_command), Some(by_input(input))],
            AtSpeed::Input(input) => [Some(by_input(input)), None],
        };
        let name = spindle_name(number);
        let text = format!("wait for {name}: {speed}, {timeout_s} s at most");
        let mut reached = true;
        for awaited in awaited.into_iter().flatten() {
            reached = reached && self.wait_for(awaited, timeout_s, line, true, &text)?.is_some();
        }
        Ok((!reached && !self.is_abandoned()).then(|| {
            let message = format!(
                "{} did not reach {speed} within {timeout_s} s, and feed waits for it",
                with_article(number)
            );
            let help = "check its drive and its speed; a larger at_speed_timeout_s at its [[spindle]] in the \
                        machine file gives it more time";
            (message, help.to_owned())
        }))
    }

    /// Turns the stopped spindle to an angle and waits until it is there (M19). Returns the reason if it does
    /// not reach the angle in time.
    pub(super) fn orient(
        &mut self,
        action: &Action,
        spindle: u32,
        degrees: f64,
        timeout_s: f64,
        line: u32,
    ) -> Result<Option<(String, String)>, QueueClosed> {
        match self.switch(action, line) {
            Ok(()) => {}
            Err(PlanError::Sink(gone)) => return Err(gone),
            // Nothing else can fail at rest.
            Err(_) => return Ok(None),
        }
        self.next.awaits_speed[spindle as usize] = false;
        let default_s = self.setup.machine.signals.spindle(spindle);
        let timeout_s = if timeout_s > 0.0 {
            timeout_s
        } else {
            default_s.map_or(10.0, |spindle| spindle.at_speed_timeout_s)
        };
        let awaited = Awaited::Oriented {
            spindle,
            command: self.periphery.spindle_commands[spindle as usize],
        };
        let text = format!(
            "wait for {}: at {degrees} degrees, {timeout_s} s at most",
            spindle_name(spindle)
        );
        let reached = self.wait_for(awaited, timeout_s, line, true, &text)?.is_some();
        Ok((!reached && !self.is_abandoned()).then(|| {
            let name = with_article(spindle);
            let message = format!("M19: {name} is not at {degrees} degrees after {timeout_s} s");
            let help = "check its drive; a larger Q of M19 gives it more time, in seconds";
            (message, help.to_owned())
        }))
    }

    /// Whether nothing is driven, or what was driven has ended: no reply comes any more.
    pub(super) fn is_abandoned(&self) -> bool {
        self.links.signals.as_ref().is_none_or(Scheduler::is_abandoned)
    }

    /// Stops, probes, and returns the result. The next move begins where the axes have stopped.
    pub(super) fn probe(&mut self, order: ProbeMove, line: u32) -> Result<ProbeResult, QueueClosed> {
        let mut change = std::mem::replace(&mut self.next.change, OutputChange::at(SignalMoment::Block(0)));
        let action = self.actions;
        self.actions += 1;
        if !change.is_empty() {
            // The move is not a block: changes with it take effect where it begins, at rest.
            change.moment = SignalMoment::Rest(action);
            self.schedule(|signals| signals.change(change))?;
        }
        let text = if order.toward {
            "probe until contact (G38)"
        } else {
            "probe until contact is lost (G38)"
        };
        let end = order.curve.end();
        self.periphery.in_probe = Some(UnplannedMove {
            feed_mm_s: order.feed_mm_s,
            end,
        });
        self.report_periphery(action);
        self.reporter.announce(action, line, false, text);
        (self.last_line, self.end_line) = (0, line);
        self.planner.rest(&Step::Action { action, line })?;
        let probing = Box::new(probing(order, self.setup));
        let result = if hand_over(&mut self.links.probings, &mut self.planner, probing)? {
            self.planner.rest(&Step::Probe { line })?;
            self.await_result(|links| {
                links
                    .probings
                    .as_mut()
                    .map(|probings| (probings.result(), probings.is_abandoned()))
            })?
        } else {
            // Nothing is driven.
            ProbeResult {
                verdict: ProbeVerdict::Imagined,
                position: end,
                stop_position: end,
            }
        };
        self.planner.set_position(&result.stop_position);
        let coordinates = |position: &Axes| {
            let present = self.setup.machine.limits().present;
            let words = AxisLetter::ALL.iter().filter(|axis| present[axis.index()]);
            let words = words.map(|axis| format!("{}{:.4}", axis.letter(), position[axis.index()]));
            words.collect::<Vec<_>>().join(" ")
        };
        let text = match result.verdict {
            ProbeVerdict::Contact => format!(
                "probe changed at {} (machine coordinates)",
                coordinates(&result.position)
            ),
            ProbeVerdict::Imagined => {
                "warning: time is virtual and no contact is known: the move goes to its end, as if the probe \
                 had not changed"
                    .to_owned()
            }
            _ => "probe: no change".to_owned(),
        };
        if result.verdict != ProbeVerdict::Imagined || self.reporter.warned.insert(line) {
            self.reporter.announce_in_passing(line, true, &text);
        }
        self.periphery.in_probe = None;
        if result.verdict != ProbeVerdict::Imagined {
            let action = self.actions;
            self.actions += 1;
            self.report_periphery(action);
            self.planner.rest(&Step::Action { action, line })?;
        }
        Ok(result)
    }

    /// Stops, waits there for an input, and returns its value.
    pub(super) fn wait_for_input(
        &mut self,
        kind: SignalKind,
        number: u32,
        mode: u32,
        timeout_s: f64,
        line: u32,
    ) -> Result<Option<f64>, QueueClosed> {
        let signals = &self.setup.machine.signals;
        let name = signals.input(kind, number).map_or("", |input| &input.name);
        let what = ["its value", "its rise", "its fall", "on", "off"];
        let what = what.get(mode as usize).copied().unwrap_or_default();
        let text = match mode {
            0 => format!("read input {name} (M66)"),
            _ => format!("wait for input {name}: {what}, {timeout_s} s at most (M66)"),
        };
        let awaited = Awaited::Input {
            kind,
            number,
            mode: WaitMode::from_number(mode).unwrap_or(WaitMode::Immediate),
        };
        self.wait_for(awaited, timeout_s, line, mode != 0, &text)
    }

    /// Stops and waits there; `None` after the timeout, and if nothing is driven.
    pub(super) fn wait_for(
        &mut self,
        awaited: Awaited,
        timeout_s: f64,
        line: u32,
        is_message: bool,
        text: &str,
    ) -> Result<Option<f64>, QueueClosed> {
        let action = self.actions;
        self.actions += 1;
        self.reporter.stop(action, StopKind::Input);
        self.reporter.announce(action, line, is_message, text);
        let wait = InputWait {
            action,
            awaited,
            // The cast saturates, and a wait of the largest number never ends.
            timeout_cycles: (timeout_s * 1e9 / self.setup.period_ns as f64).ceil() as u64,
        };
        self.schedule(|signals| signals.wait(wait))?;
        self.last_line = 0;
        self.planner.rest(&Step::Action { action, line })?;
        self.planner.rest(&Step::InputWait { line })?;
        if self.links.signals.is_none() {
            // Nothing is driven: the same result as after a timeout.
            return Ok(None);
        }
        let result = self.await_result(|links| {
            let signals = links.signals.as_mut()?;
            Some((signals.result(), signals.is_abandoned()))
        })?;
        Ok(result.value)
    }

    /// Waits until the cycle has returned a result. `poll` returns the result, if there is one, and whether
    /// nothing is driven any more.
    pub(super) fn await_result<R>(
        &mut self,
        poll: impl Fn(&mut CycleLinks) -> Option<(Option<R>, bool)>,
    ) -> Result<R, QueueClosed> {
        loop {
            match poll(&mut self.links) {
                Some((Some(result), _)) => return Ok(result),
                Some((None, false)) => {}
                _ => return Err(QueueClosed),
            }
            // Replies to holds and overrides in the meantime.
            self.planner.poll()?;
            self.report_blocks(false);
            std::thread::sleep(INPUT_NAP);
        }
    }

    /// Whether anything reports that a spindle has its speed.
    pub(super) fn knows_speed(&self, number: u32) -> bool {
        let spindle = self.setup.machine.signals.spindle(number);
        spindle.is_some_and(|spindle| spindle.at_speed != AtSpeed::Unknown || spindle.ramp_rpm_s.is_some())
    }
}
