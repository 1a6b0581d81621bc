//! Commands of clients: checked, carried out and answered.

use evolvent_bus::{ControlAnswer, ControlRequest, Payload};
use evolvent_control::{
    Alarm, CommandCode, CommandVerdict, JobResult, OperatorCommand, OperatorInputs, RawCommand, Rejection,
};
use evolvent_drive::PowerRequest;

use super::modes::Modes;
use super::operator::{Job, Operator};
use super::orders::CycleCommand;
use crate::news::ExternalEventKind;

impl Operator {
    /// Checks a request and carries it out. Returns the answer; `None` while its files are being read, until
    /// [`Operator::finish_reading`] returns it.
    pub(crate) fn answer(&mut self, request: &ControlRequest, now_ns: u64) -> Option<ControlAnswer> {
        if !request.is_compatible() {
            self.malformed += 1;
            return Some(self.composed(request, Err((CommandVerdict::Rejected, Alarm::Malformed.into()))));
        }
        let raw = RawCommand {
            command: request.command,
            axes_mask: request.axes_mask,
            index: request.index,
            amount: request.amount,
            values: request.values,
            text: request.text(),
        };
        let operator_inputs = self.operator_inputs();
        let considered = self
            .state
            .authorize(request.client, request.serial, &raw, &operator_inputs);
        let carried_out = match considered {
            Err(refused) => Err(refused),
            Ok(command) if self.book.is_crowded() && !is_always_carried_out(&command) => {
                let text = "more commands arrived than the cycle could execute, so this one has no effect; \
                            find the client that sends too many";
                Err(self.state.refuse(Rejection::new(Alarm::OrdersLost, text)))
            }
            Ok(command) => match self.begin_reading(request, &command) {
                Some(Ok(reading)) => {
                    self.files.reading = Some(reading);
                    return None;
                }
                Some(Err(refusal)) => Err(self.state.refuse(refusal)),
                None => self
                    .carry_out(&command, request.client, now_ns)
                    .and_then(|job| self.unless_lost(&command, job))
                    .map_err(|refusal| self.state.refuse(refusal))
                    .inspect(|_| self.state.commit(&command, now_ns, true)),
            },
        };
        Some(self.composed(request, carried_out))
    }

    /// Rejects a command whose orders did not fit into the queue, except the emergency stop, which such
    /// orders cause anyway.
    pub(super) fn unless_lost(&mut self, command: &OperatorCommand, job: u64) -> Result<u64, Rejection> {
        if self.give_up_lost_orders() && *command != OperatorCommand::Estop {
            return Err(Alarm::OrdersLost.into());
        }
        Ok(job)
    }

    pub(super) fn operator_inputs(&self) -> OperatorInputs {
        OperatorInputs {
            present: self.present,
            is_held: self.is_held(),
            is_ending: self.stops.ending,
            is_away: self.is_away(),
            is_chain_open: self.view.is_chain_open,
        }
    }

    /// The answer to a request: the job that it begins, or the reason for its rejection.
    pub(super) fn composed(
        &self,
        request: &ControlRequest,
        result: Result<u64, (CommandVerdict, Rejection)>,
    ) -> ControlAnswer {
        let mut answer = ControlAnswer {
            client: request.client,
            serial: request.serial,
            command: request.command,
            sequence: self.view.setpoint.sequence,
            ..ControlAnswer::default()
        };
        match result {
            Ok(job) => {
                answer.job = job;
                let starts = [CommandCode::Start as u32, CommandCode::Step as u32].contains(&request.command);
                if job > 0 && starts {
                    answer.set_text(&self.started());
                }
            }
            Err((verdict, refusal)) => {
                answer.verdict = verdict as u32;
                answer.alarm = refusal.alarm.number();
                answer.set_text(&refusal.text);
            }
        }
        answer
    }

    pub(super) fn note_command(&mut self, command: &OperatorCommand) {
        self.record(
            ExternalEventKind::Command,
            command.code() as u32,
            command.to_string(),
            command.value(),
        );
    }

    /// Carries a command out. Returns the number of the job that it begins, or 0.
    pub(super) fn carry_out(
        &mut self,
        command: &OperatorCommand,
        client: u64,
        now_ns: u64,
    ) -> Result<u64, Rejection> {
        if let Some(order) = self.order_of(command)? {
            let is_of_power = matches!(order, CycleCommand::Power(_));
            let id = self.send(order, command);
            if is_of_power {
                self.power_order = id;
            }
            return Ok(0);
        }
        let mut job = 0;
        match command {
            OperatorCommand::Resume => {
                self.resume(command);
                return Ok(0);
            }
            OperatorCommand::Step => {
                self.program.switches.set_single_step(true);
                self.resume(command);
                return Ok(0);
            }
            OperatorCommand::Stop => {
                self.cancel_reading();
                self.stop(command);
                return Ok(0);
            }
            OperatorCommand::JogKeep => {
                self.keep_jogging(client, now_ns)?;
                return Ok(0);
            }
            OperatorCommand::SingleStep(on) => {
                self.program.switches.set_single_step(*on);
                self.step_on(*on);
            }
            OperatorCommand::Return { max_velocity: speed } => {
                self.drive_back(*speed, command)?;
                return Ok(0);
            }
            OperatorCommand::Retrace(blocks) => {
                self.retrace(*blocks, command)?;
                return Ok(0);
            }
            OperatorCommand::Jog(jog) => job = self.jog(jog, client, now_ns)?,
            OperatorCommand::Home(mask) => job = self.home(*mask)?,
            OperatorCommand::OptionalStop(on) => self.program.switches.set_optional_stop(*on),
            OperatorCommand::BlockDelete(on) => self.program.switches.set_block_delete(*on),
            OperatorCommand::RapidOverride(ratio) => self.program.switches.set_rapid_override(*ratio),
            OperatorCommand::Handwheel { axis, step } => self.choose_handwheel(*axis, *step)?,
            // Commands with files are carried out after the files were read.
            OperatorCommand::Load(_)
            | OperatorCommand::Start(_)
            | OperatorCommand::Mdi(_)
            | OperatorCommand::WorkOffset { .. }
            | OperatorCommand::TouchOff { .. }
            | OperatorCommand::Tool(_)
            | OperatorCommand::ReloadTools
            | OperatorCommand::SetMode(_)
            // These are orders to the cycle, except JOG_STOP after its jog has ended.
            | OperatorCommand::Estop
            | OperatorCommand::EstopReset
            | OperatorCommand::SetOutput { .. }
            | OperatorCommand::On
            | OperatorCommand::Off
            | OperatorCommand::Hold
            | OperatorCommand::FeedOverride(_)
            | OperatorCommand::SpindleOverride(_)
            | OperatorCommand::JogStop
            | OperatorCommand::Reset
            | OperatorCommand::ClearAlarms => {}
        }
        self.note_command(command);
        Ok(job)
    }

    /// The order to the cycle that carries a command out, apart from changes of the operator's state; `None`
    /// for other commands.
    fn order_of(&mut self, command: &OperatorCommand) -> Result<Option<CycleCommand>, Rejection> {
        Ok(Some(match command {
            OperatorCommand::Estop => {
                self.break_off(JobResult::Stopped);
                CycleCommand::Emergency
            }
            OperatorCommand::EstopReset => CycleCommand::LeaveEstop,
            OperatorCommand::SetOutput { name, value } => {
                CycleCommand::Outputs(self.output_change(name, *value)?)
            }
            // Without power the cycle follows the drives, so the core is already where they are.
            OperatorCommand::On => CycleCommand::Power(PowerRequest::On),
            OperatorCommand::Off => {
                self.switch_periphery_off();
                self.cancel_reading();
                CycleCommand::Power(PowerRequest::Off)
            }
            OperatorCommand::Hold => {
                self.stops.hold = !self.stops.stopping;
                if self.stop_away() {
                    self.order(CycleCommand::StopSteering);
                }
                CycleCommand::Hold
            }
            OperatorCommand::FeedOverride(ratio) => CycleCommand::Override(*ratio),
            OperatorCommand::SpindleOverride(ratio) => CycleCommand::SpindleOverride(*ratio),
            OperatorCommand::JogStop => {
                if let Job::Jog { steered, .. } = &mut self.job {
                    steered.stopping = true;
                    CycleCommand::Stop
                } else if self.stop_away() {
                    CycleCommand::StopSteering
                } else {
                    return Ok(None);
                }
            }
            OperatorCommand::Reset => {
                self.switch_periphery_off();
                let settings = self.setup_here().interpreter_settings();
                if let Ok(modes) = Modes::at_start(&settings) {
                    self.program.modes = modes;
                }
                self.message.clear();
                CycleCommand::Clear
            }
            OperatorCommand::ClearAlarms => {
                self.message.clear();
                CycleCommand::Clear
            }
            _ => return Ok(None),
        }))
    }
}

/// Whether a command is carried out however far the cycle lags behind, because it stops something. Its orders
/// bypass the queue, or occupy one entry in it however often the command comes.
const fn is_always_carried_out(command: &OperatorCommand) -> bool {
    matches!(
        command,
        OperatorCommand::Estop
            | OperatorCommand::Stop
            | OperatorCommand::Off
            | OperatorCommand::Hold
            | OperatorCommand::JogStop
            | OperatorCommand::FeedOverride(_)
            | OperatorCommand::SpindleOverride(_)
    )
}
