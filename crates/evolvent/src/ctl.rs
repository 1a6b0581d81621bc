//! `evolvent ctl`: an operator at the command line.

use std::io::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use evolvent_bus::{
    ClientBus, ClientConfig, ControlAnswer, ControlClient, ControlRequest, Status, StatusReader,
    list_machines,
};
use evolvent_control::{Alarm, CommandCode, DeadMan, JobResult, Mode};
use serde_json::json;

use crate::ctl_args::{Action, CtlArgs, ModeArg, Switch};
use crate::ctl_request::{absolute, jog, letters_mask, request, system_number, valued, with_text};
use crate::ctl_status::{status_to_json, write_status};
use crate::{CommandError, Ending};

/// How long to wait for an answer: a busy host may take long to look at a program.
const ANSWER: Duration = Duration::from_secs(30);
/// The same of a command that stops: whoever gives it must know soon that nobody hears it.
const STOP_ANSWER: Duration = Duration::from_secs(5);
/// Commands that stop, or keep what stops by itself.
const STOPPING: [CommandCode; 6] = [
    CommandCode::Estop,
    CommandCode::Off,
    CommandCode::Hold,
    CommandCode::Stop,
    CommandCode::JogStop,
    CommandCode::JogKeep,
];
/// How long the check of a long program is waited for before it starts.
const CHECKED: Duration = Duration::from_secs(600);
/// How often the status is looked at while a job runs.
const POLL: Duration = Duration::from_millis(5);
/// Looks in vain, of two seconds, after which the core has gone. Looks are counted, because a process that was kept from running
/// that long has not looked.
const MOST_LOOKS: u32 = 400;

pub(crate) fn run(args: &CtlArgs, out: &mut dyn Write, err: &mut dyn Write) -> Result<Ending, CommandError> {
    if !(0.0..=3600.0).contains(&args.patience) {
        return Err(CommandError::Usage("--patience must be 0 to 3600 s".to_owned()));
    }
    let failed = |error: &dyn std::fmt::Display| CommandError::Failed(error.to_string());
    let name = match &args.machine_name {
        Some(name) => name.clone(),
        None => only_machine(args)?,
    };
    let config = ClientConfig {
        prefix: args.bus_prefix.clone(),
        wait: Duration::from_secs_f64(args.patience),
        ..ClientConfig::new(&name)
    };
    let bus = ClientBus::open(&config).map_err(|error| failed(&error))?;
    let mut reader = bus.status().map_err(|error| failed(&error))?;
    let status = fresh_status(&mut reader)?;
    if matches!(args.action, Action::Status) {
        let written = if args.json {
            writeln!(out, "{}", status_to_json(&status, bus.axes()))
        } else {
            write_status(out, &status, bus.axes(), &name)
        };
        written.map_err(|error| failed(&error))?;
        return Ok(Ending::Clean);
    }
    let client = ControlClient::open(&config).map_err(|error| failed(&error))?;
    let mut session = Session {
        client,
        reader,
        json: args.json,
    };
    session.act(&args.action, &status, out, err)
}

/// The machine that is served, if it is only one.
fn only_machine(args: &CtlArgs) -> Result<String, CommandError> {
    let mut machines =
        list_machines(args.bus_prefix.as_deref()).map_err(|error| CommandError::Failed(error.to_string()))?;
    match machines.len() {
        1 => Ok(machines.remove(0)),
        0 => Err(CommandError::Failed(
            "no machine is served on this computer by this user; start `evolvent serve`".to_owned(),
        )),
        _ => Err(CommandError::Usage(format!(
            "several machines are served: {}; choose one with --machine-name",
            machines.join(", ")
        ))),
    }
}

/// A status that is not older than its publisher.
fn fresh_status(reader: &mut StatusReader) -> Result<Status, CommandError> {
    let mut first: Option<u64> = None;
    for _ in 0..MOST_LOOKS {
        let latest = reader
            .latest()
            .map_err(|error| CommandError::Failed(error.to_string()))?;
        if let Some(status) = latest {
            // One that stays as it is may be a dead core's.
            if first.is_some_and(|first| status.sequence > first) {
                return Ok(status);
            }
            first.get_or_insert(status.sequence);
        }
        std::thread::sleep(POLL);
    }
    Err(CommandError::Failed(
        "the core has gone: its status stands still; start it again".to_owned(),
    ))
}

struct Session {
    client: ControlClient,
    reader: StatusReader,
    json: bool,
}

impl Session {
    fn act(
        &mut self,
        action: &Action,
        status: &Status,
        out: &mut dyn Write,
        err: &mut dyn Write,
    ) -> Result<Ending, CommandError> {
        let simple = |code: CommandCode| request(code);
        let switch = |code: CommandCode, state: Switch| ControlRequest {
            index: u32::from(matches!(state, Switch::On)),
            ..request(code)
        };
        let percent = |code: CommandCode, percent: f64| ControlRequest {
            amount: percent / 100.0,
            ..request(code)
        };
        let (wanted, wait) = match action {
            Action::Status => return Ok(Ending::Clean),
            Action::Estop => (simple(CommandCode::Estop), false),
            Action::EstopReset => (simple(CommandCode::EstopReset), false),
            Action::On => return self.switch_on(out),
            Action::Up => {
                if status.machine_state == 0 {
                    let answer = self.send(&simple(CommandCode::EstopReset))?;
                    if answer.verdict != 0 {
                        return self.tell(&answer, None, out);
                    }
                }
                return self.switch_on(out);
            }
            Action::Off => (simple(CommandCode::Off), false),
            Action::Mode { mode } => {
                let mode = match mode {
                    ModeArg::Auto => Mode::Auto,
                    ModeArg::Manual => Mode::Manual,
                    ModeArg::Mdi => Mode::Mdi,
                };
                (
                    ControlRequest {
                        index: mode as u32,
                        ..request(CommandCode::Mode)
                    },
                    false,
                )
            }
            Action::Load { program } => (with_text(CommandCode::Load, &absolute(program)?)?, false),
            Action::Start { line, wait } => {
                self.need_mode(status, Mode::Auto)?;
                let index = line.unwrap_or(0);
                let start = ControlRequest {
                    index,
                    ..request(CommandCode::Start)
                };
                (start, *wait)
            }
            Action::Hold => (simple(CommandCode::Hold), false),
            Action::Resume => (simple(CommandCode::Resume), false),
            Action::Step => {
                if status.activity == 0 {
                    self.need_mode(status, Mode::Auto)?;
                }
                (simple(CommandCode::Step), false)
            }
            Action::Stop => (simple(CommandCode::Stop), false),
            Action::Reset => (simple(CommandCode::Reset), false),
            Action::Clear => (simple(CommandCode::ClearAlarms), false),
            Action::SingleStep { state } => (switch(CommandCode::SingleStep, *state), false),
            Action::OptionalStop { state } => (switch(CommandCode::OptionalStop, *state), false),
            Action::BlockDelete { state } => (switch(CommandCode::BlockDelete, *state), false),
            Action::Override { percent: ratio } => (percent(CommandCode::FeedOverride, *ratio), false),
            Action::Rapid { percent: ratio } => (percent(CommandCode::RapidOverride, *ratio), false),
            Action::Spindle { percent: ratio } => (percent(CommandCode::SpindleOverride, *ratio), false),
            Action::Mdi { block, no_wait } => {
                self.need_mode(status, Mode::Mdi)?;
                (with_text(CommandCode::Mdi, block)?, !no_wait)
            }
            Action::Jog {
                axes,
                distance,
                speed,
                seconds,
            } => {
                let jog = jog(axes, *distance, *speed)?;
                self.need_mode(status, Mode::Manual)?;
                if distance.is_none() {
                    return self.jog_on(&jog, *seconds, out, err);
                }
                (jog, true)
            }
            Action::JogStop => (simple(CommandCode::JogStop), false),
            Action::Home { axes } => {
                let axes_mask = match axes {
                    None => 0,
                    Some(letters) => letters_mask(letters)?,
                };
                self.need_mode(status, Mode::Manual)?;
                let home = ControlRequest {
                    axes_mask,
                    ..request(CommandCode::Home)
                };
                (home, true)
            }
            Action::Offset { system, values } => (
                ControlRequest {
                    index: system_number(system)?,
                    ..valued(CommandCode::WorkOffset, values)?
                },
                false,
            ),
            Action::TouchOff { values, system } => (
                ControlRequest {
                    index: system.as_deref().map_or(Ok(0), system_number)?,
                    ..valued(CommandCode::TouchOff, values)?
                },
                false,
            ),
            Action::Tool {
                number,
                values,
                diameter,
            } => {
                if *number == 0 {
                    return Err(CommandError::Usage("tools are numbered from 1".to_owned()));
                }
                (
                    ControlRequest {
                        index: *number,
                        amount: diameter.unwrap_or(-1.0),
                        ..valued(CommandCode::Tool, values)?
                    },
                    false,
                )
            }
            Action::ReloadTools => (simple(CommandCode::Tool), false),
        };
        let mut answer = self.send(&wanted)?;
        // A long program is checked before it starts.
        let deadline = Instant::now() + CHECKED;
        while answer.alarm == Alarm::Checking.number() && Instant::now() < deadline {
            std::thread::sleep(POLL);
            answer = self.send(&wanted)?;
        }
        let result = if wait && answer.verdict == 0 {
            Some(self.await_job(answer.job)?)
        } else {
            None
        };
        self.tell(&answer, result.as_ref(), out)
    }

    fn send(&mut self, request: &ControlRequest) -> Result<ControlAnswer, CommandError> {
        let stops = STOPPING.iter().any(|&code| request.command == code as u32);
        self.client
            .command(request, if stops { STOP_ANSWER } else { ANSWER })
            .map_err(|error| CommandError::Failed(error.to_string()))
    }

    /// Changes the mode where another one is in force; what is in the way of that is told by the command itself.
    fn need_mode(&mut self, status: &Status, mode: Mode) -> Result<(), CommandError> {
        if status.mode != mode as u32 {
            let change = ControlRequest {
                index: mode as u32,
                ..request(CommandCode::Mode)
            };
            self.send(&change)?;
        }
        Ok(())
    }

    fn switch_on(&mut self, out: &mut dyn Write) -> Result<Ending, CommandError> {
        let answer = self.send(&request(CommandCode::On))?;
        if answer.verdict != 0 {
            return self.tell(&answer, None, out);
        }
        let deadline = Instant::now() + Duration::from_secs(10);
        loop {
            let status = self.latest()?;
            let seen = status.is_some_and(|status| status.cycles > answer.sequence + 1);
            if let Some(status) = status.filter(|_| seen) {
                if status.machine_state == 2 {
                    return self.tell(&answer, None, out);
                }
                if status.alarm_count > 0 {
                    return self.tell(&answer, Some(&status), out);
                }
            }
            if Instant::now() > deadline {
                return Err(CommandError::Failed(
                    "the drives are not enabled after 10 s".to_owned(),
                ));
            }
            std::thread::sleep(POLL);
        }
    }

    fn latest(&mut self) -> Result<Option<Status>, CommandError> {
        self.reader
            .latest()
            .map_err(|error| CommandError::Failed(error.to_string()))
    }

    /// The status at the end of a job.
    fn await_job(&mut self, job: u64) -> Result<Status, CommandError> {
        let (mut sequence, mut looks) = (0, 0);
        loop {
            looks += 1;
            if let Some(status) = self.latest()? {
                if status.job > job || (status.job == job && status.job_result != 0) {
                    return Ok(status);
                }
                if status.sequence != sequence {
                    (sequence, looks) = (status.sequence, 0);
                }
            }
            if looks > MOST_LOOKS {
                return Err(CommandError::Failed("the core has gone".to_owned()));
            }
            std::thread::sleep(POLL);
        }
    }

    /// Jogs until a signal comes, or time is up.
    fn jog_on(
        &mut self,
        jog: &ControlRequest,
        seconds: Option<f64>,
        out: &mut dyn Write,
        err: &mut dyn Write,
    ) -> Result<Ending, CommandError> {
        let stop = Arc::new(AtomicBool::new(false));
        for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
            signal_hook::flag::register(signal, Arc::clone(&stop))
                .map_err(|error| CommandError::Failed(format!("signals cannot be caught: {error}")))?;
        }
        let answer = self.send(jog)?;
        if answer.verdict != 0 {
            return self.tell(&answer, None, out);
        }
        if seconds.is_none() && !self.json {
            drop(writeln!(err, "jogging; Ctrl-C stops"));
        }
        let begin = Instant::now();
        let every = Duration::from_nanos(DeadMan::PATIENCE_NS / 3);
        let over = |begin: Instant| seconds.is_some_and(|seconds| begin.elapsed().as_secs_f64() >= seconds);
        let mut renewed = Instant::now();
        while !stop.load(Ordering::Relaxed) && !over(begin) {
            if renewed.elapsed() >= every {
                renewed = Instant::now();
                self.send(&request(CommandCode::JogKeep))?;
            }
            if let Some(status) = self.latest()?
                && status.job == answer.job
                && status.job_result != 0
            {
                return self.tell(&answer, Some(&status), out);
            }
            std::thread::sleep(POLL);
        }
        self.send(&request(CommandCode::JogStop))?;
        let status = self.await_job(answer.job)?;
        self.tell(&answer, Some(&status), out)
    }

    /// Answer and, where it was waited for, how the job ended.
    fn tell(
        &self,
        answer: &ControlAnswer,
        end: Option<&Status>,
        out: &mut dyn Write,
    ) -> Result<Ending, CommandError> {
        let accepted = answer.verdict == 0;
        let result = end.map(|status| status.job_result);
        let is_bad = |status: &Status| {
            status.job == answer.job
                && [JobResult::Failed as u32, JobResult::Fault as u32].contains(&status.job_result)
        };
        let failed = end.is_some_and(|status| is_bad(status) || (answer.job == 0 && status.alarm_count > 0));
        if self.json {
            let verdict = ["accepted", "rejected", "stale"];
            let results = ["none", "done", "stopped", "failed", "fault"];
            let value = json!({
                "verdict": verdict.get(answer.verdict as usize),
                "alarm": (answer.alarm != 0).then_some(answer.alarm),
                "text": answer.text(),
                "sequence": answer.sequence,
                "job": (answer.job != 0).then_some(answer.job),
                "result": result.and_then(|result| results.get(result as usize)),
                "alarms": end.map(|status| status.listed_alarms().to_vec()).unwrap_or_default(),
                "alarm_text": end.map(|status| status.alarm_sentence().to_owned()),
            });
            writeln!(out, "{value}")
                .map_err(|error| CommandError::Failed(format!("the answer cannot be written: {error}")))?;
            return Ok(if accepted && !failed {
                Ending::Clean
            } else {
                Ending::Negative
            });
        }
        if !accepted {
            return Err(CommandError::Failed(format!(
                "{} ({})",
                answer.text(),
                answer.alarm
            )));
        }
        if let Some(status) = end.filter(|_| failed) {
            let number = status.listed_alarms().last().copied().unwrap_or(0);
            let known = Alarm::from_number(number).map_or("", |alarm| alarm.sentence());
            let text = match status.alarm_sentence() {
                "" => known,
                text => text,
            };
            return Err(CommandError::Failed(format!("{text} ({number})")));
        }
        Ok(Ending::Clean)
    }
}
