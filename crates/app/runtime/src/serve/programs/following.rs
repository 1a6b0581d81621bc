//! What a running program needs from the operator's side: tool changes, user-defined M codes, and its end.

use std::sync::mpsc::TryRecvError;
use std::time::Instant;

use evolvent_config::no_reply;
use evolvent_control::{Alarm, JobResult};
use evolvent_machine::Magazine;
use evolvent_motion::MotionState;

use super::{
    AT_WORK, ChangeBeginning, NO_SAVER, NUMBERS_LEFT, PLANNER_TIMEOUT, StepBehind, UserCommand, sentence,
};
use crate::news::{ExternalEventKind, Moment, StopKind, UserCall};
use crate::periphery::{CHANGE_BEGINS, Changer, Periphery, TOOL_CHANGE_CODE, change_abandoned};
use crate::refusal::ProgramError;
use crate::serve::files::READING_TIMEOUT;
use crate::serve::jog::limits_here;
use crate::serve::modes::After;
use crate::serve::operator::{Job, Operator};
use crate::serve::orders::CycleCommand;
use crate::user_code::{UserCodes, UserNews};

impl Operator {
    pub(in crate::serve) fn follow_program(&mut self) {
        self.follow_tool_savings();
        let setpoint = self.view.setpoint;
        let Job::Program(run) = &mut self.job else { return };
        self.program.track.receive(&run.planning.news);
        let message = &mut self.message;
        let modal = self.program.track.reach(&setpoint, |notice| {
            if notice.is_message {
                let is_at_rest = matches!(notice.moment, Moment::Rest(_));
                message.pass_on(&notice.text, &setpoint, is_at_rest);
            }
        });
        if let Some(modal) = modal {
            self.program.modes.modal = modal;
        }
        self.message.follow(setpoint.state);
        if let Some(periphery) = self.program.track.take_periphery(&setpoint)
            && !self.stops.is_emergency
        {
            self.take_periphery(periphery);
        }
        if let Some(stop) = self.program.track.take_stop(&setpoint) {
            self.handle_stop(stop);
        }
        self.follow_beginning();
        self.follow_command();
        let Job::Program(run) = &mut self.job else { return };
        if run.saving.is_some() {
            self.follow_saving();
            return;
        }
        if let Some(result) = run.ended {
            // Nothing else begins before the program is over.
            if run
                .command
                .as_ref()
                .is_some_and(|command| !command.program.is_over())
                || run.beginning.is_some()
            {
                return;
            }
            let result = if run.has_failed && result == JobResult::Stopped {
                JobResult::Failed
            } else {
                result
            };
            let ended_at = *run.ended_at.get_or_insert_with(Instant::now);
            if let Some((report, planned)) = run.planning.take_result() {
                let after = run.after.take();
                self.program.numbers = (report.next_block, report.next_action);
                self.finish_program(result, planned, after);
            } else if ended_at.elapsed() > PLANNER_TIMEOUT {
                self.leave_planner(result);
            }
            return;
        }
        if let Some(job) = run.planning.take_if_ready() {
            let limits = limits_here(&self.limits, &setpoint.position, self.state.homed());
            self.begin_within(&limits);
            let order = self.order(CycleCommand::Follow(job));
            self.book.notes.sends_plan(order, self.state.job());
            if self.stops.hold {
                // For a hold that came earlier: the cycle has new inputs with each job.
                self.order(CycleCommand::Hold);
            }
            return;
        }
        if setpoint.state != MotionState::Running {
            return;
        }
        match run.step {
            Some(StepBehind::LineAfter(block)) if setpoint.block > block => {
                run.step = Some(StepBehind::Line {
                    block: setpoint.block,
                    line: setpoint.line,
                });
            }
            // A line may have several blocks, for example a canned cycle.
            Some(StepBehind::Line { block, line }) if setpoint.block > block && setpoint.line != line => {
                run.step = None;
                self.stops.hold = true;
                self.order(CycleCommand::Hold);
            }
            _ => {}
        }
    }

    /// Takes over the program's present state of spindle, coolant and tool.
    fn take_periphery(&mut self, periphery: Periphery) {
        self.periphery.reach(periphery);
        let is_resolved = periphery.is_tool_known && self.store.change.is_some();
        if periphery.tool != self.store.tool || is_resolved {
            let is_random = self.setup.machine.program.magazine == Magazine::Random;
            let saving = self.store.take_tool(periphery.tool, is_random);
            self.files.tool_savings.push(saving);
        }
    }

    /// Checks whether the record of the tool in the spindle was written.
    fn follow_tool_savings(&mut self) {
        let mut failures = Vec::new();
        self.files.tool_savings.retain(|saving| match saving.try_recv() {
            Err(TryRecvError::Empty) => true,
            Ok(Ok(_)) => false,
            Ok(Err(error)) => {
                failures.push(error.to_string());
                false
            }
            Err(TryRecvError::Disconnected) => {
                failures.push(NO_SAVER.to_owned());
                false
            }
        });
        for text in failures {
            self.store.forget_saved();
            self.raise(self.view.setpoint.sequence, Alarm::NotKept, text);
        }
    }

    /// Continues a tool change once its mark is written.
    fn follow_beginning(&mut self) {
        let Job::Program(run) = &mut self.job else { return };
        let Some(beginning) = &run.beginning else { return };
        let failure = match beginning.saving.try_recv() {
            Ok(Ok(_)) => None,
            Ok(Err(error)) => Some(error.to_string()),
            Err(TryRecvError::Empty) if beginning.begun.elapsed() < READING_TIMEOUT => return,
            Err(TryRecvError::Empty) => Some(no_reply(READING_TIMEOUT).to_string()),
            Err(TryRecvError::Disconnected) => Some(NO_SAVER.to_owned()),
        };
        let Some(ChangeBeginning { call, stop, .. }) = run.beginning.take() else {
            return;
        };
        let is_over = run.ended.is_some() || self.stops.stopping;
        if failure.is_none() && !is_over {
            self.carry_out_command(call, stop);
            return;
        }
        // No part of the change has been carried out.
        let saving = self.store.forget_change();
        self.files.tool_savings.push(saving);
        if let Some(text) = failure {
            let text = format!("the tool change cannot be recorded, so it does not begin: {text}");
            if let Job::Program(run) = &mut self.job {
                run.has_failed = true;
            }
            self.raise(self.view.setpoint.sequence, Alarm::UserCommand, text);
            self.stops.stopping = true;
            self.order(CycleCommand::Stop);
        }
    }

    /// Starts a user-defined M code.
    fn carry_out_command(&mut self, call: UserCall, stop: u32) {
        let Job::Program(run) = &mut self.job else { return };
        run.command = Some(UserCommand {
            call,
            stop,
            program: UserCodes::of(&self.setup).start(call),
            is_done: false,
            is_cancelled: false,
        });
        self.message.tell_of_wait(&format!("{}{AT_WORK}", call.text()));
    }

    /// If a job ends in the middle of a tool change, the tool in the spindle is unknown.
    pub(in crate::serve) fn judge_change(&mut self) {
        if let Some(mark) = self.store.change
            && self.store.is_change_under_way
        {
            self.store.is_change_under_way = false;
            let failure = match &mut self.job {
                Job::Program(run) => run.failure.take(),
                _ => None,
            };
            let text = match failure {
                Some(failure) => mark.sentence_behind(&failure),
                None => mark.sentence(),
            };
            self.raise(self.view.setpoint.sequence, Alarm::ToolChange, text);
        }
    }

    /// Switches spindle and coolant off, whatever switched them on, and ends a change that waits for the
    /// operator.
    pub(in crate::serve) fn switch_periphery_off(&mut self) {
        let now = self.periphery.now();
        if let Some((Changer::Operator, tool)) = now.change {
            let text = change_abandoned(tool, now.tool);
            self.record(ExternalEventKind::Warning, 0, text.clone(), None);
            self.message.tell(text);
        }
        let ends_surface_speed = self.periphery.now().outputs.has_surface_speed();
        self.periphery.switch_off(self.view.setpoint.sequence);
        if ends_surface_speed {
            self.refresh_modes();
        }
    }

    /// The same if no program runs. A program that is being stopped switches them off where it stops.
    pub(in crate::serve) fn switch_off_at_rest(&mut self) {
        if !matches!(self.job, Job::Program(_)) {
            self.switch_periphery_off();
        }
    }

    /// Ends the job without its planner's thread, which hangs in a file system.
    fn leave_planner(&mut self, result: JobResult) {
        let setpoint = self.view.setpoint;
        // The numbers that the thread has assigned are unknown and must not be assigned again.
        let (block, action) = self.program.numbers;
        self.program.numbers = (
            block.max(setpoint.block).saturating_add(NUMBERS_LEFT),
            action.max(setpoint.actions).saturating_add(NUMBERS_LEFT),
        );
        let file = self.state.program().unwrap_or("the program").to_owned();
        let text = format!("{file}: {}", no_reply(PLANNER_TIMEOUT));
        self.raise(setpoint.sequence, Alarm::Program, text);
        self.refresh_modes();
        self.end_job(result);
    }

    /// Handles a stop at which the program waits.
    fn handle_stop(&mut self, (action, kind): (u32, StopKind)) {
        let Job::Program(run) = &mut self.job else { return };
        if !matches!(kind, StopKind::User(_)) {
            // The program waits here anyway.
            run.step = None;
        }
        match kind {
            // The cycle continues by itself after a wait for an input.
            StopKind::Program | StopKind::ToolChange(_) | StopKind::Input => {}
            StopKind::Step => {
                if !self.program.switches.is_single_step() {
                    self.order(CycleCommand::GoOn(action + 1));
                }
            }
            StopKind::User(call) => {
                let changes = [TOOL_CHANGE_CODE, CHANGE_BEGINS].contains(&call.number);
                match call.words {
                    [Some(tool), _] if changes => {
                        // Tool numbers are integers.
                        run.beginning = Some(ChangeBeginning {
                            call,
                            stop: action + 1,
                            saving: self.store.begin_change(tool as u32),
                            begun: Instant::now(),
                        });
                        self.message.tell_of_wait(&format!("{}{AT_WORK}", call.text()));
                    }
                    _ => self.carry_out_command(call, action + 1),
                }
            }
        }
    }

    /// Receives events of a user-defined M code, and continues the program when it is done.
    fn follow_command(&mut self) {
        let (mut lines, mut failure, mut done) = (Vec::new(), None, None);
        let Job::Program(run) = &mut self.job else { return };
        let Some(command) = &mut run.command else { return };
        while let Some(news) = command.program.poll() {
            match news {
                UserNews::Line(line) => lines.push(format!("M{}: {line}", command.call.number)),
                UserNews::Ended(Ok(())) => {
                    command.is_done = true;
                    done = Some(command.stop);
                }
                // A code that was cancelled has not failed.
                UserNews::Ended(Err(_)) if command.is_cancelled => {}
                UserNews::Ended(Err(text)) => {
                    run.has_failed = true;
                    failure = Some(text);
                }
            }
        }
        let line = command.call.line;
        // Once the program has left the stop, the code is dropped.
        let setpoint = &self.view.setpoint;
        let is_behind = command.is_done && setpoint.actions > command.stop;
        if is_behind || setpoint.state == MotionState::Running {
            run.command = None;
        }
        for text in lines {
            self.message.tell(&*text);
            self.record(ExternalEventKind::Output, line, text, None);
        }
        if let Some(stop) = done {
            if self.message.text().ends_with(AT_WORK) {
                self.message.end_wait();
            }
            self.order(CycleCommand::GoOn(stop));
        }
        if let Some(text) = failure {
            let sequence = self.view.setpoint.sequence;
            self.raise(sequence, Alarm::UserCommand, text);
            self.stops.stopping = true;
            self.order(CycleCommand::Stop);
        }
    }

    pub(in crate::serve) fn finish_program(
        &mut self,
        result: JobResult,
        planned: Result<Option<crate::memory::ProgramMemory>, ProgramError>,
        after: Option<After>,
    ) {
        let sequence = self.view.setpoint.sequence;
        if let Some(modal) = self.program.track.finish()
            && result == JobResult::Done
        {
            self.program.modes.modal = modal;
        }
        match (result, planned, after) {
            (JobResult::Done, planned, Some(after)) => {
                // As planned, not as simulated: a parameter may depend on an input.
                let followed = self.program.modes.modal.tool_offset;
                let (kept, tools) = match planned {
                    Ok(Some(left)) => {
                        self.program.parameters.clone_from(&left.volatile);
                        (left.kept, left.tools)
                    }
                    _ => (Some(after.kept), after.tools),
                };
                self.store.memory.kept = kept;
                self.store.memory.tools = tools.or_else(|| self.store.memory.tools.take());
                self.program.modes = after.modes;
                // A tool that was measured in the block has its measured length.
                self.program.modes.modal.tool_offset = followed;
            }
            // Copied, so that everything the planner's thread has allocated is freed when it ends. Otherwise
            // the next planner would find a different heap.
            (JobResult::Done, Ok(Some(left)), None) => self.store.memory.clone_from(&left),
            (JobResult::Failed, Err(error), _) => {
                let lines_before = self.program.lines_before;
                let text = match &error {
                    ProgramError::Text { diagnostic, .. } => sentence(diagnostic, lines_before),
                    ProgramError::Read { .. } => error.to_string(),
                };
                if let Job::Program(run) = &mut self.job {
                    run.failure = Some(text.clone());
                }
                self.raise(sequence, Alarm::Program, text);
            }
            _ => {}
        }
        self.refresh_modes();
        let saving = self.store.save(self.store.memory.clone());
        if let Job::Program(run) = &mut self.job {
            run.saving = Some((result, saving, Instant::now()));
        }
    }

    /// Ends the job once its state is saved.
    fn follow_saving(&mut self) {
        let Job::Program(run) = &self.job else { return };
        let Some((result, saving, begun)) = &run.saving else {
            return;
        };
        let result = *result;
        let failure = match saving.try_recv() {
            Ok(Ok(memory)) => {
                self.store.take_saved(memory);
                None
            }
            Ok(Err(error)) => Some(error.to_string()),
            Err(TryRecvError::Empty) if begun.elapsed() < READING_TIMEOUT => return,
            Err(TryRecvError::Empty) => Some(no_reply(READING_TIMEOUT).to_string()),
            Err(TryRecvError::Disconnected) => Some(NO_SAVER.to_owned()),
        };
        if let Some(text) = failure {
            self.raise(self.view.setpoint.sequence, Alarm::NotKept, text);
        }
        self.end_job(result);
    }
}
