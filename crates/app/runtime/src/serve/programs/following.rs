//! What a running program needs from the operator: tool changes, user-defined M codes, its end.

use std::sync::mpsc::TryRecvError;
use std::time::Instant;

use evolvent_config::no_reply;
use evolvent_control::{Alarm, JobResult};
use evolvent_machine::Magazine;
use evolvent_motion::State;

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
        if let Some(modal) = self.program.track.reach(&setpoint, |notice| match notice.moment {
            _ if !notice.is_message => {}
            Moment::Rest(_) if setpoint.state == State::ProgramStop => message.tell_of_stop(&*notice.text),
            _ => message.tell(&*notice.text),
        }) {
            self.program.modes.modal = modal;
        }
        self.message.follow(setpoint.state);
        if let Some(periphery) = self.program.track.take_periphery(&setpoint)
            && !self.stops.is_emergency
        {
            self.take_periphery(periphery);
        }
        if let Some(stop) = self.program.track.take_stop(&setpoint) {
            self.stands_at(stop);
        }
        self.follow_beginning();
        self.follow_command();
        let Job::Program(run) = &mut self.job else { return };
        if run.saving.is_some() {
            self.follow_saving();
            return;
        }
        if let Some(result) = run.ended {
            // Nothing else begins before it is over.
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
            let limits = limits_here(&self.limits, &setpoint.position, self.desk.homed());
            self.begin_within(&limits);
            let order = self.order(CycleCommand::Follow(job));
            self.book.notes.sends_plan(order, self.desk.job());
            if self.stops.hold {
                // A hold that came before: with the job the cycle has got inputs of its own.
                self.order(CycleCommand::Hold);
            }
            return;
        }
        if setpoint.state != State::Running {
            return;
        }
        match run.step {
            Some(StepBehind::LineAfter(block)) if setpoint.block > block => {
                run.step = Some(StepBehind::Line {
                    block: setpoint.block,
                    line: setpoint.line,
                });
            }
            // A line may have several blocks: cycles do.
            Some(StepBehind::Line { block, line }) if setpoint.block > block && setpoint.line != line => {
                run.step = None;
                self.stops.hold = true;
                self.order(CycleCommand::Hold);
            }
            _ => {}
        }
    }

    /// Spindle, coolant and tool as the program has them now.
    fn take_periphery(&mut self, periphery: Periphery) {
        self.periphery.reach(periphery);
        let is_resolved = periphery.is_tool_known && self.keep.change.is_some();
        if periphery.tool != self.keep.tool || is_resolved {
            let is_random = self.setup.machine.program.magazine == Magazine::Random;
            let saving = self.keep.take_tool(periphery.tool, is_random);
            self.files.tool_savings.push(saving);
        }
    }

    /// Hears whether the tool in the spindle was written.
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
            self.keep.forget_saved();
            self.raise(self.view.setpoint.sequence, Alarm::NotKept, text);
        }
    }

    /// Goes on with a tool change once it is noted that it is under way.
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
        // Nothing of it has been done.
        let saving = self.keep.forget_change();
        self.files.tool_savings.push(saving);
        if let Some(text) = failure {
            let text = format!("the tool change cannot be noted, so it does not begin: {text}");
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
        self.message.tell_of_stop(format!("{}{AT_WORK}", call.text()));
    }

    /// A job that ends in the middle of a tool change leaves an unknown tool in the spindle.
    pub(in crate::serve) fn judge_change(&mut self) {
        if let Some(mark) = self.keep.change
            && self.keep.is_change_under_way
        {
            self.keep.is_change_under_way = false;
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

    /// Spindle and coolant go off, whatever has switched them on. A change that waits for the operator ends.
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

    /// The same where no program runs; one that runs and is being stopped has them off where it stops.
    pub(in crate::serve) fn switch_off_at_rest(&mut self) {
        if !matches!(self.job, Job::Program(_)) {
            self.switch_periphery_off();
        }
    }

    /// The planner's thread hangs, in a file system that does not reply: the job ends without it.
    fn leave_planner(&mut self, result: JobResult) {
        let setpoint = self.view.setpoint;
        // Numbers that the thread has given are not known, and are not given twice.
        let (block, action) = self.program.numbers;
        self.program.numbers = (
            block.max(setpoint.block).saturating_add(NUMBERS_LEFT),
            action.max(setpoint.actions).saturating_add(NUMBERS_LEFT),
        );
        let file = self.desk.program().unwrap_or("the program").to_owned();
        let text = format!("{file}: {}", no_reply(PLANNER_TIMEOUT));
        self.raise(setpoint.sequence, Alarm::Program, text);
        self.refresh_modes();
        self.end_job(result);
    }

    /// The program waits at this stop.
    fn stands_at(&mut self, (action, kind): (u32, StopKind)) {
        let Job::Program(run) = &mut self.job else { return };
        if !matches!(kind, StopKind::User(_)) {
            // It waits here anyway.
            run.step = None;
        }
        match kind {
            // The cycle goes on after a wait for an input.
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
                        // Numbers of tools are whole.
                        run.beginning = Some(ChangeBeginning {
                            call,
                            stop: action + 1,
                            saving: self.keep.begin_change(tool as u32),
                            begun: Instant::now(),
                        });
                        self.message.tell_of_stop(format!("{}{AT_WORK}", call.text()));
                    }
                    _ => self.carry_out_command(call, action + 1),
                }
            }
        }
    }

    /// Hears a user-defined M code, and goes on when it is done.
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
                // One that was told to end has not failed.
                UserNews::Ended(Err(_)) if command.is_cancelled => {}
                UserNews::Ended(Err(text)) => {
                    run.has_failed = true;
                    failure = Some(text);
                }
            }
        }
        let line = command.call.line;
        // After the stop it is forgotten.
        let setpoint = &self.view.setpoint;
        let is_behind = command.is_done && setpoint.actions > command.stop;
        if is_behind || setpoint.state == State::Running {
            run.command = None;
        }
        for text in lines {
            self.message.tell(&*text);
            self.record(ExternalEventKind::Output, line, text, None);
        }
        if let Some(stop) = done {
            if self.message.text().ends_with(AT_WORK) {
                self.message.clear();
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
                // As it was planned, not foreseen: a parameter may be what an input gave.
                let followed = self.program.modes.modal.tool_offset;
                let (kept, tools) = match planned {
                    Ok(Some(left)) => {
                        self.program.parameters.clone_from(&left.volatile);
                        (left.kept, left.tools)
                    }
                    _ => (Some(after.kept), after.tools),
                };
                self.keep.memory.kept = kept;
                self.keep.memory.tools = tools.or_else(|| self.keep.memory.tools.take());
                self.program.modes = after.modes;
                // A tool that was measured in the block is as long as it was found to be.
                self.program.modes.modal.tool_offset = followed;
            }
            // A copy: what the planner's thread has allocated is to be free as a whole when it ends, so that
            // the next one finds its part of the heap as this one has found it.
            (JobResult::Done, Ok(Some(left)), None) => self.keep.memory.clone_from(&left),
            (JobResult::Failed, Err(error), _) => {
                let lines_before = self.lines_before();
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
        let saving = self.keep.save(self.keep.memory.clone());
        if let Job::Program(run) = &mut self.job {
            run.saving = Some((result, saving, Instant::now()));
        }
    }

    /// Ends the job once what it has left is written.
    fn follow_saving(&mut self) {
        let Job::Program(run) = &self.job else { return };
        let Some((result, saving, begun)) = &run.saving else {
            return;
        };
        let result = *result;
        let failure = match saving.try_recv() {
            Ok(Ok(memory)) => {
                self.keep.take_saved(memory);
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
