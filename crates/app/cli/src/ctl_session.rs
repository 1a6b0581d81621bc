//! One action of `evolvent ctl`: the commands that it needs, and the wait for its end.

use std::io::Write;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use evolvent_bus::{ControlAnswer, ControlClient, ControlRequest, Status, StatusReader, switches};
use evolvent_control::{Alarm, CommandCode, JogEnable, Mode};
use evolvent_runtime::BEFORE_LINE;

use crate::bridge::duration_of;
use crate::ctl_answer::{JobEnd, has_latched_alarm, tell};
use crate::ctl_args::Action;
use crate::ctl_away::is_of_program;
use crate::ctl_request::{
    absolute, handwheel, indexed, jog, letters_mask, mode_of, percent, request, switch, system_number, tool,
    valued, with_text,
};
use crate::signals::stop_at_first;
use crate::{CommandError, Ending};

/// Timeout of an answer: checking a program may take long on a busy host.
const ANSWER: Duration = Duration::from_secs(30);
/// Timeout of a command that stops: its sender must learn soon that no core has received it.
pub(crate) const STOP_ANSWER: Duration = Duration::from_secs(5);
/// Commands that stop, or that prevent an automatic stop.
const STOPPING: [CommandCode; 6] = [
    CommandCode::Estop,
    CommandCode::Off,
    CommandCode::Hold,
    CommandCode::Stop,
    CommandCode::JogStop,
    CommandCode::JogKeep,
];
/// Maximum wait for the check of a long program before it starts.
const CHECKED: Duration = Duration::from_secs(600);

/// Poll interval of the status while a job runs.
pub(crate) const POLL: Duration = Duration::from_millis(5);

/// Number of polls without a new status, over two seconds, after which the core counts as gone. Polls are
/// counted, because a process that was suspended for that time has not polled.
pub(crate) const MAX_POLLS: u32 = 400;

/// Minimum duration of a program stop: user-defined M codes pass through a short one.
const PROGRAM_STOP: Duration = Duration::from_millis(300);

/// Maximum wait for the computation of an approach.
const WAY: Duration = Duration::from_secs(120);

/// End of the status's message while a user-defined M code runs.
const AT_WORK: &str = "is being carried out";

/// Status `state`: at a program stop.
const AT_PROGRAM_STOP: u32 = 7;

/// A client of the control service that carries out one action.
pub(crate) struct Session {
    pub(crate) client: ControlClient,
    pub(crate) reader: StatusReader,
    pub(crate) json: bool,
    /// A signal has arrived.
    pub(crate) interrupted: Arc<AtomicBool>,
}

/// How a command waits for its end.
#[derive(Clone, Copy, PartialEq)]
struct Waiting {
    /// The command that ends the job when this command is interrupted; `None` if the job continues.
    stop: Option<CommandCode>,
    /// Whether a program stop ends the wait.
    until_program_stop: bool,
}

/// A command, and how to wait for its end.
struct Order {
    request: ControlRequest,
    /// `None` if the command is complete with its answer.
    wait: Option<Waiting>,
}

impl Order {
    fn awaited(request: ControlRequest, waiting: Waiting) -> Self {
        Self {
            request,
            wait: Some(waiting),
        }
    }
}

impl From<ControlRequest> for Order {
    fn from(request: ControlRequest) -> Self {
        Self { request, wait: None }
    }
}

/// Result of a START.
enum Started {
    /// The program runs, or waits before its approach; the text to print.
    Runs(String),
    Failed(Box<Status>),
}

impl Session {
    /// Carries out an action, and waits until it is complete.
    pub(crate) fn act(
        &mut self,
        action: &Action,
        status: &Status,
        out: &mut dyn Write,
        err: &mut dyn Write,
    ) -> Result<Ending, CommandError> {
        let order: Order = match action {
            // Stopping commands have been sent before; the others only read.
            Action::Status
            | Action::Io { .. }
            | Action::Estop
            | Action::Hold
            | Action::Stop
            | Action::JogStop
            | Action::Off => {
                return Ok(Ending::Clean);
            }
            Action::On => return self.switch_on(out),
            Action::Up => return self.bring_up(status, out),
            Action::EstopReset => request(CommandCode::EstopReset).into(),
            Action::Mode { mode } => indexed(CommandCode::Mode, mode_of(*mode) as u32).into(),
            Action::Load { program } => with_text(CommandCode::Load, &absolute(program)?)?.into(),
            Action::Start { program, line, wait } => self.start(status, program.as_deref(), *line, *wait)?,
            Action::Resume => request(CommandCode::Resume).into(),
            Action::Loaded { tool } => match objection_to_loaded(*tool, status) {
                Some(objection) => return Err(CommandError::Failed(objection)),
                None => request(CommandCode::Resume).into(),
            },
            Action::Step => self.step(status)?,
            Action::Reset => request(CommandCode::Reset).into(),
            Action::Clear => request(CommandCode::ClearAlarms).into(),
            Action::Set { output, value } => ControlRequest {
                amount: *value,
                ..with_text(CommandCode::SetOutput, output)?
            }
            .into(),
            Action::SingleStep { state } => switch(CommandCode::SingleStep, *state).into(),
            Action::OptionalStop { state } => switch(CommandCode::OptionalStop, *state).into(),
            Action::BlockDelete { state } => switch(CommandCode::BlockDelete, *state).into(),
            Action::Override { percent: ratio } => percent(CommandCode::FeedOverride, *ratio)?.into(),
            Action::Rapid { percent: ratio } => percent(CommandCode::RapidOverride, *ratio)?.into(),
            Action::Spindle { percent: ratio } => percent(CommandCode::SpindleOverride, *ratio)?.into(),
            Action::Mdi { block, no_wait } => self.mdi(status, &block.join(" "), *no_wait)?,
            Action::Jog {
                axes,
                distance,
                speed,
                seconds,
            } => {
                let duration = duration_of(*seconds)?;
                let jog = jog(axes, *distance, *speed)?;
                let is_away = is_of_program(status);
                if !is_away {
                    self.need_mode(status, Mode::Manual)?;
                }
                if distance.is_some() && is_away {
                    return self.give_away(&jog, out);
                }
                if distance.is_none() {
                    return self.jog_on(&jog, status, duration, out, err);
                }
                Order::awaited(jog, Waiting::stopped_by(CommandCode::JogStop))
            }
            Action::Return { speed } => {
                let way_back = ControlRequest {
                    amount: speed.unwrap_or(0.0) / 60.0,
                    ..request(CommandCode::Return)
                };
                return self.give_away(&way_back, out);
            }
            Action::Retrace { blocks } => {
                return self.give_away(&indexed(CommandCode::Retrace, *blocks), out);
            }
            Action::Handwheel { axis, step } => self.handwheel(status, axis.as_deref(), *step)?,
            Action::Home { axes } => self.home(status, axes.as_deref())?,
            Action::Offset { system, values } => ControlRequest {
                index: system_number(system)?,
                ..valued(CommandCode::WorkOffset, values)?
            }
            .into(),
            Action::TouchOff { values, system } => ControlRequest {
                index: system.as_deref().map_or(Ok(0), system_number)?,
                ..valued(CommandCode::TouchOff, values)?
            }
            .into(),
            Action::Tool {
                number,
                values,
                diameter,
            } => tool(*number, values, *diameter)?.into(),
            Action::ReloadTools => request(CommandCode::Tool).into(),
        };
        self.give(action, &order, out, err)
    }

    /// Resets the emergency stop if it is active, and switches on.
    fn bring_up(&mut self, status: &Status, out: &mut dyn Write) -> Result<Ending, CommandError> {
        if status.machine_state == 0 {
            let answer = self.send(&request(CommandCode::EstopReset))?;
            if answer.verdict != 0 {
                return tell(&answer, None, self.json, out);
            }
        }
        self.switch_on(out)
    }

    fn start(
        &mut self,
        status: &Status,
        program: Option<&Path>,
        line: Option<u32>,
        wait: bool,
    ) -> Result<Order, CommandError> {
        let name = program.map(absolute).transpose()?.unwrap_or_default();
        self.need_mode(status, Mode::Auto)?;
        let goes_on = Waiting {
            stop: None,
            until_program_stop: false,
        };
        Ok(Order {
            request: ControlRequest {
                index: line.unwrap_or(0),
                ..with_text(CommandCode::Start, &name)?
            },
            wait: wait.then_some(goes_on),
        })
    }

    fn step(&mut self, status: &Status) -> Result<Order, CommandError> {
        if status.activity == 0 {
            self.need_mode(status, Mode::Auto)?;
        }
        Ok(request(CommandCode::Step).into())
    }

    fn mdi(&mut self, status: &Status, block: &str, no_wait: bool) -> Result<Order, CommandError> {
        self.need_mode(status, Mode::Mdi)?;
        let waiting = Waiting {
            stop: Some(CommandCode::Stop),
            until_program_stop: true,
        };
        Ok(Order {
            request: with_text(CommandCode::Mdi, block)?,
            wait: (!no_wait).then_some(waiting),
        })
    }

    fn handwheel(
        &mut self,
        status: &Status,
        axis: Option<&str>,
        step: Option<f64>,
    ) -> Result<Order, CommandError> {
        if axis.is_some() {
            self.need_mode(status, Mode::Manual)?;
        }
        Ok(handwheel(axis, step)?.into())
    }

    fn home(&mut self, status: &Status, letters: Option<&str>) -> Result<Order, CommandError> {
        let home = ControlRequest {
            axes_mask: letters.map_or(Ok(0), letters_mask)?,
            ..request(CommandCode::Home)
        };
        self.need_mode(status, Mode::Manual)?;
        Ok(Order::awaited(home, Waiting::stopped_by(CommandCode::Stop)))
    }

    /// Sends an order, waits for its job if requested, and reports the result.
    fn give(
        &mut self,
        action: &Action,
        order: &Order,
        out: &mut dyn Write,
        err: &mut dyn Write,
    ) -> Result<Ending, CommandError> {
        if order.wait.is_some() {
            self.catch_signals()?;
        }
        let mut answer = self.send(&order.request)?;
        // A long program is checked before it starts.
        let deadline = Instant::now() + CHECKED;
        while answer.alarm == Alarm::Checking.number() && Instant::now() < deadline {
            std::thread::sleep(POLL);
            answer = self.send(&order.request)?;
        }
        let starts = matches!(action, Action::Start { .. }) && answer.verdict == 0;
        if starts {
            let text = match self.started(action, &answer)? {
                Started::Runs(text) => text,
                Started::Failed(status) => return self.tell_end(&answer, Some(&status), false, out),
            };
            if !self.json {
                writeln!(out, "{text}").map_err(|error| CommandError::Failed(error.to_string()))?;
            }
        }
        let result = match order.wait {
            Some(waiting) if answer.verdict == 0 => Some(self.await_job(answer.job, waiting, err)?),
            _ => None,
        };
        self.tell_end(&answer, result.as_ref(), false, out)
    }

    /// Prints the answer and the end of the job, if it was waited for.
    fn tell_end(
        &self,
        answer: &ControlAnswer,
        status: Option<&Status>,
        by_own_stop: bool,
        out: &mut dyn Write,
    ) -> Result<Ending, CommandError> {
        let end = status.map(|status| JobEnd { status, by_own_stop });
        tell(answer, end.as_ref(), self.json, out)
    }

    /// The program that was started; with a start line also the approach, before which the machine waits.
    fn started(&mut self, action: &Action, answer: &ControlAnswer) -> Result<Started, CommandError> {
        let is_in_the_middle = matches!(action, Action::Start { line: Some(2..), .. });
        let deadline = Instant::now() + WAY;
        while is_in_the_middle && Instant::now() < deadline {
            let status = self.latest()?.filter(|status| status.job == answer.job);
            let Some(status) = status else {
                std::thread::sleep(POLL);
                continue;
            };
            // An objection to the approach ends the job.
            if status.job_result != 0 {
                return Ok(Started::Failed(Box::new(status)));
            }
            let message = status.operator_message();
            if message.starts_with(BEFORE_LINE) && !message.ends_with("is being computed") {
                return Ok(Started::Runs(format!(
                    "{}\n{message}\n`evolvent ctl resume` starts the approach",
                    answer.text().split(": stopped before").next().unwrap_or_default()
                )));
            }
            std::thread::sleep(POLL);
        }
        Ok(Started::Runs(answer.text().to_owned()))
    }

    /// From now on the first signal ends the motion of this command.
    pub(crate) fn catch_signals(&self) -> Result<(), CommandError> {
        let interrupted = Arc::clone(&self.interrupted);
        stop_at_first(move || interrupted.store(true, Ordering::Relaxed))
    }

    pub(crate) fn send(&mut self, request: &ControlRequest) -> Result<ControlAnswer, CommandError> {
        let stops = STOPPING.iter().any(|&code| request.command == code as u32);
        self.client
            .command(request, if stops { STOP_ANSWER } else { ANSWER })
            .map_err(|error| CommandError::Failed(error.to_string()))
    }

    /// Changes the mode if another one is in force; the command itself reports why it is not possible.
    fn need_mode(&mut self, status: &Status, mode: Mode) -> Result<(), CommandError> {
        if status.mode != mode as u32 {
            self.send(&indexed(CommandCode::Mode, mode as u32))?;
        }
        Ok(())
    }

    fn switch_on(&mut self, out: &mut dyn Write) -> Result<Ending, CommandError> {
        let answer = self.send(&request(CommandCode::On))?;
        if answer.verdict != 0 {
            return tell(&answer, None, self.json, out);
        }
        // The machine file limits the time that drives may take, and the core raises an alarm after it.
        let (mut sequence, mut polls) = (0, 0);
        loop {
            polls += 1;
            if let Some(status) = self.latest()? {
                if status.sequence != sequence {
                    (sequence, polls) = (status.sequence, 0);
                }
                let seen = status.cycles > answer.sequence + 1;
                if seen && status.machine_state == 2 {
                    return tell(&answer, None, self.json, out);
                }
                if seen && has_latched_alarm(&status) {
                    return self.tell_end(&answer, Some(&status), false, out);
                }
                // Another client has switched off, so the machine will not come on.
                if status.cycles > answer.sequence + 100 && status.power != 1 {
                    return Err(CommandError::Failed(
                        "power was switched off before the drives were enabled".to_owned(),
                    ));
                }
            }
            if polls > MAX_POLLS {
                return Err(CommandError::Failed("the core has ended".to_owned()));
            }
            std::thread::sleep(POLL);
        }
    }

    pub(crate) fn is_interrupted(&self) -> bool {
        self.interrupted.load(Ordering::Relaxed)
    }

    pub(crate) fn latest(&mut self) -> Result<Option<Status>, CommandError> {
        self.reader
            .latest()
            .map_err(|error| CommandError::Failed(error.to_string()))
    }

    /// The status at the end of a job. Prints a tool change that the job waits for.
    fn await_job(&mut self, job: u64, waiting: Waiting, err: &mut dyn Write) -> Result<Status, CommandError> {
        let (mut sequence, mut polls) = (0, 0);
        let (mut stopped_since, mut is_stopped): (Option<Instant>, bool) = (None, false);
        let mut reported = None;
        loop {
            polls += 1;
            if self.interrupted.load(Ordering::Relaxed) && !is_stopped {
                is_stopped = true;
                let Some(code) = waiting.stop else {
                    return Err(CommandError::Failed(
                        "interrupted; the program continues, `evolvent ctl stop` stops it".to_owned(),
                    ));
                };
                self.send(&request(code))?;
            }
            if let Some(status) = self.latest()? {
                if status.job > job || (status.job == job && status.job_result != 0) {
                    if is_stopped {
                        return Err(CommandError::Failed(
                            "interrupted: the axes were stopped".to_owned(),
                        ));
                    }
                    return Ok(status);
                }
                let wanted = (status.tool_change == 1).then_some(status.tool_wanted);
                if wanted.is_some() && wanted != reported && !self.json {
                    // If standard error is closed, nobody is left to inform.
                    drop(writeln!(
                        err,
                        "{}; `evolvent ctl resume` resumes",
                        status.operator_message()
                    ));
                }
                reported = wanted;
                // A wait for a speed, an angle or an input ends by itself, and `resume` does not end it.
                let is_at_stop = status.job == job
                    && status.state == AT_PROGRAM_STOP
                    && status.switches & switches::INPUT_WAIT == 0
                    && wanted.is_none()
                    && !status.operator_message().ends_with(AT_WORK);
                if !is_at_stop {
                    stopped_since = None;
                } else if waiting.until_program_stop
                    && stopped_since.get_or_insert_with(Instant::now).elapsed() > PROGRAM_STOP
                {
                    return Err(CommandError::Failed(
                        "the block waits at a program stop: `evolvent ctl resume` continues, `evolvent ctl \
                         stop` ends it"
                            .to_owned(),
                    ));
                }
                if status.sequence != sequence {
                    (sequence, polls) = (status.sequence, 0);
                }
            }
            if polls > MAX_POLLS {
                return Err(CommandError::Failed("the core has ended".to_owned()));
            }
            std::thread::sleep(POLL);
        }
    }

    /// Jogs until a signal arrives or the time is up.
    fn jog_on(
        &mut self,
        jog: &ControlRequest,
        status: &Status,
        duration: Option<Duration>,
        out: &mut dyn Write,
        err: &mut dyn Write,
    ) -> Result<Ending, CommandError> {
        self.catch_signals()?;
        let is_away = is_of_program(status);
        let stop = Arc::clone(&self.interrupted);
        let answer = self.send(jog)?;
        if answer.verdict != 0 {
            return tell(&answer, None, self.json, out);
        }
        if duration.is_none() && !self.json {
            drop(writeln!(err, "jogging; Ctrl-C stops"));
        }
        let begin = Instant::now();
        let every = Duration::from_nanos(JogEnable::PATIENCE_NS / 3);
        let over = |begin: Instant| duration.is_some_and(|duration| begin.elapsed() >= duration);
        let mut renewed = Instant::now();
        while !stop.load(Ordering::Relaxed) && !over(begin) {
            if renewed.elapsed() >= every {
                renewed = Instant::now();
                let kept = self.send(&request(CommandCode::JogKeep))?;
                // Another client has taken over the jog, so this one must not stop it.
                if kept.alarm == Alarm::Busy.number() {
                    return tell(&kept, None, self.json, out);
                }
            }
            if let Some(status) = self.latest()?
                && status.job == answer.job
                && status.job_result != 0
            {
                return self.tell_end(&answer, Some(&status), false, out);
            }
            std::thread::sleep(POLL);
        }
        self.send(&request(CommandCode::JogStop))?;
        // The signal was handled.
        self.interrupted.store(false, Ordering::Relaxed);
        if is_away {
            self.await_rest(&answer)?;
            return tell(&answer, None, self.json, out);
        }
        let status = self.await_job(answer.job, Waiting::stopped_by(CommandCode::JogStop), err)?;
        self.tell_end(&answer, Some(&status), true, out)
    }
}

impl Waiting {
    const fn stopped_by(code: CommandCode) -> Self {
        Self {
            stop: Some(code),
            until_program_stop: false,
        }
    }
}

/// The reason why a tool cannot be confirmed: the machine does not wait for it.
fn objection_to_loaded(tool: Option<u32>, status: &Status) -> Option<String> {
    let wanted = status.tool_wanted;
    match (status.tool_change, tool) {
        (1, Some(tool)) if tool != wanted => Some(format!(
            "the machine waits for tool {wanted}, not for tool {tool}; put tool {wanted} into the spindle, \
             or stop the program"
        )),
        (1, _) => None,
        _ => Some("the machine waits for no tool".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_block_is_one_argument_or_its_words() {
        use clap::Parser as _;

        for (words, expected) in [
            (&["ctl", "mdi", "G1 X50 F100"][..], "G1 X50 F100"),
            (&["ctl", "mdi", "G1", "X50", "F100"], "G1 X50 F100"),
            (&["ctl", "mdi", "G91", "G1", "X-5", "--no-wait"], "G91 G1 X-5"),
        ] {
            let parsed = CtlCommand::try_parse_from(words).expect("words of ctl");
            let Action::Mdi { block, no_wait } = parsed.ctl.action else {
                panic!("{words:?}");
            };
            assert_eq!((block.join(" ").as_str(), no_wait), (expected, words.len() == 6));
        }
        assert!(CtlCommand::try_parse_from(["ctl", "mdi"]).is_err());
    }

    #[derive(Debug, clap::Parser)]
    struct CtlCommand {
        #[command(flatten)]
        ctl: crate::ctl_args::CtlArgs,
    }

    #[test]
    fn only_the_tool_that_is_waited_for_is_confirmed() {
        let waiting = Status {
            tool_change: 1,
            tool_wanted: 3,
            ..Status::default()
        };
        assert_eq!(objection_to_loaded(Some(3), &waiting), None);
        assert_eq!(objection_to_loaded(None, &waiting), None);
        let other = objection_to_loaded(Some(4), &waiting);
        assert!(other.is_some_and(|text| text.contains("waits for tool 3")));
        // This confirms neither a running changer nor a program stop.
        for tool_change in [0, 2] {
            let status = Status {
                tool_change,
                ..waiting
            };
            assert!(objection_to_loaded(None, &status).is_some());
        }
    }
}
