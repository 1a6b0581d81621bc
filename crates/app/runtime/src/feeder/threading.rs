//! Threading: the feeder collects the pieces of a pass and waits until it is complete.

use std::path::Path;

use evolvent_gcode::CanonicalCommand;
use evolvent_motion::{QueueClosed, ThreadPass, ThreadResult, Threading, ThreadingSender};
use evolvent_planner::{PlanError, PlanSink, Step};
use evolvent_signals::{OutputChange, SignalMoment};

use super::Feeder;
use super::links::hand_over;
use crate::periphery::{SpindlePass, UnplannedMove};
use crate::refusal::{ProgramError, at_origin};
use crate::threading::{ThreadChain, complaint};

/// Why a pass is not complete.
pub(super) enum ThreadTrouble {
    /// The program has an error, or the machine has not carried it out.
    Program(ProgramError),
    /// Nothing is driven any more.
    Gone,
}

impl From<QueueClosed> for ThreadTrouble {
    fn from(_: QueueClosed) -> Self {
        Self::Gone
    }
}

impl<S: PlanSink<Error = QueueClosed>> Feeder<'_, S> {
    /// Passes threading passes on to this sender.
    pub(crate) fn threading_by(mut self, threadings: Option<ThreadingSender>) -> Self {
        self.links.threadings = threadings;
        self
    }

    /// Takes a piece of a thread. Any other command, and a piece of another pass, first completes the
    /// preceding pass. Returns whether the piece was taken.
    pub(super) fn collect_thread(
        &mut self,
        command: &CanonicalCommand,
        program: &Path,
    ) -> Result<bool, ThreadTrouble> {
        if self.chain.take(command) {
            return Ok(true);
        }
        if self.chain.is_empty() {
            return Ok(false);
        }
        let chain = std::mem::take(&mut self.chain);
        self.cut_thread(&chain, program)?;
        Ok(self.chain.take(command))
    }

    /// Waits for the spindle speed, stops, and cuts a pass.
    fn cut_thread(&mut self, chain: &ThreadChain, program: &Path) -> Result<(), ThreadTrouble> {
        let Some(first) = chain.first() else {
            return Ok(());
        };
        let line = first.line;
        let rpm = self.periphery.outputs.spindle(chain.spindle()).constant_rpm();
        let (pass, run_in_mm) = match chain.pass_on(rpm, self.setup) {
            Ok(pass) => pass,
            Err(refusal) => {
                let diagnostic = at_origin(first, program, |file, line| refusal.diagnostic(file, line));
                return Err(ThreadTrouble::Program(self.wrong(diagnostic)));
            }
        };
        match self.suspend_override(chain.spindle(), line) {
            Ok(()) => {}
            Err(PlanError::Sink(gone)) => return Err(gone.into()),
            // A rest is within every limit.
            Err(_) => return Err(ThreadTrouble::Gone),
        }
        if let Some((message, help)) = self.await_speeds(line)? {
            return Err(ThreadTrouble::Program(
                self.refused(first, program, message, help),
            ));
        }
        let result = self.drive_thread(chain, pass, run_in_mm, line)?;
        self.planner.set_position(&result.stop_position);
        if let Some((message, help)) = complaint(&result, rpm) {
            return Err(ThreadTrouble::Program(
                self.refused(first, program, message, help),
            ));
        }
        self.report_blocks(false);
        Ok(())
    }

    fn drive_thread(
        &mut self,
        chain: &ThreadChain,
        pass: ThreadPass,
        run_in_mm: f64,
        line: u32,
    ) -> Result<ThreadResult, QueueClosed> {
        let mut change = std::mem::replace(&mut self.next.change, OutputChange::at(SignalMoment::Block(0)));
        let action = self.actions;
        self.actions += 1;
        if chain.spindle() != self.next.follows {
            self.next.follows = chain.spindle();
            change.follows = Some(chain.spindle());
        }
        // Sent again for a spindle that turned before the program began.
        change.spindle = Some(self.spindle_target(chain.spindle()));
        // The pass is not a block: changes with it take effect where it begins, at rest.
        change.moment = SignalMoment::Rest(action);
        self.schedule(|signals| signals.change(change))?;
        self.periphery.follows_angle = Some(chain.spindle());
        self.periphery.in_pass = Some(SpindlePass {
            spindle: chain.spindle(),
            is_tap: chain.is_tap(),
            motion: UnplannedMove {
                feed_mm_s: chain.feed_mm_s(pass.turns_per_s),
                end: pass.legs.last().map_or(pass.start, |leg| leg.end),
            },
        });
        self.report_periphery(action);
        let what = if chain.is_tap() { "tap" } else { "thread" };
        let text = format!("{what} in step with the spindle: in phase {run_in_mm:.3} mm after its start");
        self.reporter.announce(action, line, false, &text);
        if chain.is_tap() {
            self.report_reversal(
                chain.spindle(),
                pass.tap.map_or(0.0, |tap| 60.0 * tap.turns_per_s),
            )?;
        }
        (self.last_line, self.end_line) = (0, line);
        self.planner.rest(&Step::Action { action, line })?;
        let threading = Box::new(Threading::new(pass, &self.setup.machine.limits()));
        hand_over(&mut self.links.threadings, &mut self.planner, threading)?;
        self.planner.rest(&Step::Thread { line })?;
        let result = self.await_result(|links| {
            let threadings = links.threadings.as_mut()?;
            Some((threadings.result(), threadings.is_abandoned()))
        })?;
        let text = format!(
            "{what}: done, at most {:.4} mm off the spindle's angle",
            result.worst_mm
        );
        if complaint(&result, 0.0).is_none() {
            self.reporter.announce_in_passing(line, false, &text);
            // The next pass follows the spindle again, and stalls are monitored elsewhere again.
            self.periphery.in_pass = None;
            let action = self.actions;
            self.actions += 1;
            self.report_periphery(action);
            self.planner.rest(&Step::Action { action, line })?;
        }
        Ok(result)
    }

    /// Reports the next two actions, which the pass itself carries out: the spindle turns back at this speed,
    /// and then as before.
    fn report_reversal(&mut self, spindle: u32, back_rpm: f64) -> Result<(), QueueClosed> {
        use evolvent_gcode::SpindleDirection::{Clockwise, CounterClockwise, Stopped};
        let before = self.periphery.outputs;
        let back = match before.spindle(spindle).direction {
            Clockwise => CounterClockwise,
            CounterClockwise => Clockwise,
            Stopped => Stopped,
        };
        let mut reversed = before;
        if let Some(output) = reversed.spindles.get_mut(spindle as usize) {
            (output.direction, output.speed_rpm) = (back, back_rpm);
        }
        for outputs in [reversed, before] {
            self.periphery.outputs = outputs;
            self.command_spindle(spindle);
            self.turn_virtual_spindle(spindle)?;
            self.report_periphery(self.actions);
            self.actions += 1;
        }
        Ok(())
    }
}
