//! `evolvent ctl`: an operator at the command line.

use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use clap::{Args, Subcommand, ValueEnum};
use evolvent_bus::{
    ClientBus, ClientConfig, ControlAnswer, ControlClient, ControlRequest, Status, StatusReader,
    list_machines,
};
use evolvent_control::{Alarm, CommandCode, DeadMan, JobResult, Mode};
use evolvent_path::{AXES, AxisLetter};
use serde_json::json;

use crate::ctl_status::{status_to_json, write_status};
use crate::{CommandError, Ending};

/// How long to wait for an answer.
const ANSWER: Duration = Duration::from_secs(5);
/// How long the check of a long program is waited for before it starts.
const CHECKED: Duration = Duration::from_secs(600);
/// How often the status is looked at while a job runs.
const POLL: Duration = Duration::from_millis(5);

/// Options of `evolvent ctl`.
#[derive(Debug, Args)]
pub(crate) struct CtlArgs {
    /// The machine's name. Default: the one that is served on this computer, if it is only one.
    #[arg(long, value_name = "NAME", global = true)]
    machine_name: Option<String>,
    /// Prefix of the bus's files, as the core has it.
    #[arg(long, value_name = "PREFIX", global = true)]
    bus_prefix: Option<String>,
    /// Print one JSON object.
    #[arg(long, global = true)]
    json: bool,
    /// How long to wait for a core that is not up yet, s.
    #[arg(long, value_name = "S", default_value_t = 1.0, global = true)]
    patience: f64,
    #[command(subcommand)]
    action: Action,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Switch {
    On,
    Off,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum ModeArg {
    Auto,
    Manual,
    Mdi,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// What the machine is doing.
    Status,
    /// Every axis stops by itself, the drives lose power.
    Estop,
    /// Leave the emergency stop.
    EstopReset,
    /// Enable the drives; waits until they are.
    On,
    /// Take power from the drives.
    Off,
    /// Out of the emergency stop and on, in one.
    Up,
    /// Change the mode. Commands that need one change it by themselves.
    Mode {
        /// The mode.
        mode: ModeArg,
    },
    /// Load a program.
    Load {
        /// The program's file.
        program: PathBuf,
    },
    /// Start the loaded program.
    Start {
        /// Begin at this line; the machine shows the way there and waits for `resume`.
        #[arg(long, value_name = "N")]
        line: Option<u32>,
        /// Wait for its end.
        #[arg(long)]
        wait: bool,
    },
    /// Hold the feed.
    Hold,
    /// Go on after a hold or a program stop.
    Resume,
    /// Run one block.
    Step,
    /// Stop within the limits and end the job.
    Stop,
    /// Clear the alarms and forget modes.
    Reset,
    /// Clear the alarms.
    Clear,
    /// Stop after each block.
    SingleStep {
        /// on or off.
        state: Switch,
    },
    /// Stop at M1, in programs that are started from now on.
    OptionalStop {
        /// on or off.
        state: Switch,
    },
    /// Leave out lines that begin with `/`, in programs that are started from now on.
    BlockDelete {
        /// on or off.
        state: Switch,
    },
    /// Feed override, 0 to 200 percent.
    Override {
        /// Percent.
        percent: f64,
    },
    /// Rapid override, 0 to 100 percent, for jobs that are started from now on.
    Rapid {
        /// Percent.
        percent: f64,
    },
    /// Spindle override, 0 to 200 percent.
    Spindle {
        /// Percent.
        percent: f64,
    },
    /// Execute one block and wait for its end.
    Mdi {
        /// The block.
        block: String,
        /// Do not wait.
        #[arg(long)]
        no_wait: bool,
    },
    /// Move by hand: `jog X+` as long as this command runs, `jog X+ Y- --distance 5` by an increment.
    Jog {
        /// Axes with their directions.
        #[arg(required = true, value_name = "AXIS+|AXIS-")]
        axes: Vec<String>,
        /// By so much each, mm or degrees.
        #[arg(long, value_name = "MM")]
        distance: Option<f64>,
        /// Each at so much at the most, mm/min or degrees/min. Default: a fifth of what the axis can.
        #[arg(long, value_name = "MM_MIN")]
        speed: Option<f64>,
        /// A jog without a distance ends after so long; else with Ctrl-C.
        #[arg(long, value_name = "S")]
        seconds: Option<f64>,
    },
    /// End a jog.
    JogStop,
    /// Home axes, all if none is named, and wait for the end.
    Home {
        /// Letters, as in XYZ.
        axes: Option<String>,
    },
    /// Set a work offset: `offset G54 X10 Y-5`, machine coordinates.
    Offset {
        /// G54 to G59.3.
        system: String,
        /// Axes with values.
        #[arg(required = true, value_name = "AXIS VALUE")]
        values: Vec<String>,
    },
    /// Set the work offset so that the present position reads these values: `touch-off X0 Y0`.
    TouchOff {
        /// Axes with values.
        #[arg(required = true, value_name = "AXIS VALUE")]
        values: Vec<String>,
        /// G54 to G59.3. Default: the active one.
        #[arg(long)]
        system: Option<String>,
    },
    /// Set a tool's offsets and diameter: `tool 7 Z120.5 --diameter 6`.
    Tool {
        /// Its number.
        number: u32,
        /// Axes with offsets.
        #[arg(value_name = "AXIS VALUE")]
        values: Vec<String>,
        /// Diameter, mm.
        #[arg(long, value_name = "MM")]
        diameter: Option<f64>,
    },
    /// Read the tool table again.
    ReloadTools,
}

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
    let deadline = Instant::now() + Duration::from_secs(2);
    let mut first: Option<u64> = None;
    loop {
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
        if Instant::now() > deadline {
            return Err(CommandError::Failed(
                "the core has gone: its status stands still; start it again".to_owned(),
            ));
        }
        std::thread::sleep(POLL);
    }
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
        self.client
            .command(request, ANSWER)
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
        let mut sequence = 0;
        let mut changed = Instant::now();
        loop {
            if let Some(status) = self.latest()? {
                if status.job > job || (status.job == job && status.job_result != 0) {
                    return Ok(status);
                }
                if status.sequence != sequence {
                    (sequence, changed) = (status.sequence, Instant::now());
                }
            }
            if changed.elapsed() > Duration::from_secs(2) {
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

fn request(code: CommandCode) -> ControlRequest {
    ControlRequest {
        command: code as u32,
        ..ControlRequest::default()
    }
}

fn with_text(code: CommandCode, text: &str) -> Result<ControlRequest, CommandError> {
    let mut wanted = request(code);
    if !wanted.set_text(text) {
        return Err(CommandError::Usage(format!(
            "{} bytes are too long for a command",
            text.len()
        )));
    }
    Ok(wanted)
}

/// The core has another working folder.
fn absolute(path: &Path) -> Result<String, CommandError> {
    let path = std::path::absolute(path)
        .map_err(|error: io::Error| CommandError::Usage(format!("{}: {error}", path.display())))?;
    path.to_str().map(str::to_owned).ok_or_else(|| {
        CommandError::Usage(format!(
            "{}: the name is no UTF-8; rename the file",
            path.display()
        ))
    })
}

fn axis_of(letter: char) -> Result<usize, CommandError> {
    AxisLetter::from_letter(letter)
        .map(AxisLetter::index)
        .ok_or_else(|| CommandError::Usage(format!("{letter:?} is no axis; use letters of XYZABCUVW")))
}

fn letters_mask(letters: &str) -> Result<u32, CommandError> {
    letters
        .chars()
        .try_fold(0, |mask, letter| Ok(mask | 1 << axis_of(letter)?))
}

/// `X10` or `X=10` each.
fn valued(code: CommandCode, words: &[String]) -> Result<ControlRequest, CommandError> {
    let mut wanted = request(code);
    let mut values = [0.0; AXES];
    for word in words {
        let bad = || CommandError::Usage(format!("{word:?} is no axis with a value, as in X12.5"));
        let mut letters = word.chars();
        let axis = axis_of(letters.next().ok_or_else(bad)?)?;
        let number = letters.as_str().trim_start_matches('=');
        values[axis] = number.parse().map_err(|_| bad())?;
        wanted.axes_mask |= 1 << axis;
    }
    wanted.values = values;
    Ok(wanted)
}

fn jog(axes: &[String], distance: Option<f64>, speed: Option<f64>) -> Result<ControlRequest, CommandError> {
    let mut wanted = ControlRequest {
        index: u32::from(distance.is_some()),
        amount: speed.unwrap_or(0.0) / 60.0,
        ..request(CommandCode::Jog)
    };
    for word in axes {
        let mut letters = word.chars();
        let (Some(letter), Some(sign), None) = (letters.next(), letters.next(), letters.next()) else {
            return Err(CommandError::Usage(format!(
                "{word:?} is no axis with a direction, as in X+"
            )));
        };
        let sign = match sign {
            '+' => 1.0,
            '-' => -1.0,
            _ => {
                return Err(CommandError::Usage(format!(
                    "{word:?} is no axis with a direction, as in X+"
                )));
            }
        };
        let axis = axis_of(letter)?;
        wanted.axes_mask |= 1 << axis;
        wanted.values[axis] = sign * distance.unwrap_or(1.0);
    }
    Ok(wanted)
}

/// 1 for G54 to 9 for G59.3.
fn system_number(name: &str) -> Result<u32, CommandError> {
    const NAMES: [&str; 9] = [
        "G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3",
    ];
    let found = NAMES.iter().position(|known| known.eq_ignore_ascii_case(name));
    found
        .map(|index| index as u32 + 1)
        .ok_or_else(|| CommandError::Usage(format!("{name:?} is none of G54 to G59.3")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_become_masks_and_values() {
        let offset = valued(CommandCode::WorkOffset, &["X10".into(), "z=-2.5".into()]).unwrap();
        assert_eq!(offset.axes_mask, 0b101);
        assert_eq!((offset.values[0], offset.values[2]), (10.0, -2.5));
        assert!(valued(CommandCode::WorkOffset, &["Q1".into()]).is_err());
        assert!(valued(CommandCode::WorkOffset, &["X".into()]).is_err());
        let jog_both = jog(&["X+".into(), "Y-".into()], Some(5.0), Some(600.0)).unwrap();
        assert_eq!((jog_both.axes_mask, jog_both.index), (0b11, 1));
        assert_eq!(
            (jog_both.values[0], jog_both.values[1], jog_both.amount),
            (5.0, -5.0, 10.0)
        );
        assert!(jog(&["X".into()], None, None).is_err());
        assert!(jog(&["X*".into()], None, None).is_err());
        assert_eq!(letters_mask("xZ").unwrap(), 0b101);
        assert_eq!(system_number("g59.3").unwrap(), 9);
        assert!(system_number("G60").is_err());
    }
}
