//! `evolvent top`: a running machine on a terminal, from its status, inputs and outputs on the bus.

use evolvent_path::AxisMask;
use std::fmt::Write as _;
use std::io::{self, IsTerminal, Write};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use clap::Args;
use evolvent_bus::{BusError, ClientBus, ClientConfig, STATES, Status, StatusReader, switches};
use evolvent_machine::{Machine, SignalSettings};
use serde_json::json;

use crate::ctl_io::Periphery;
use crate::ctl_status::{
    is_diameter, is_tool_unknown, probe_state, spindle_words, spindles, uncounted_override,
};
use crate::signal_watch::SignalWatch;
use crate::terminal::Terminal;
use crate::{CommandError, Ending};

/// An older status belongs to a core that has ended.
const STALE: Duration = Duration::from_millis(500);
/// Maximum wait of a single snapshot for a core and its status.
const PATIENCE: Duration = Duration::from_secs(2);
/// Time in which a snapshot receives inputs and outputs.
const LISTENING: Duration = Duration::from_millis(300);
/// Duration of one search for a core in full-screen mode, between two checks of the keys.
const CONNECT_TIMEOUT: Duration = Duration::from_millis(300);
/// Colours; they end with the letter m, and no part of them is visible.
const BOLD: &str = "\x1b[1m";
const RED: &str = "\x1b[31m";
const PLAIN: &str = "\x1b[0m";

/// Options of `evolvent top`.
#[derive(Debug, Args)]
pub(crate) struct TopArgs {
    /// The machine's name.
    #[arg(value_name = "NAME")]
    machine_name: String,
    /// Prefix of the bus's files.
    #[arg(long, value_name = "PREFIX")]
    bus_prefix: Option<String>,
    /// Machine file: names of inputs and outputs.
    #[arg(long, value_name = "FILE")]
    machine: Option<PathBuf>,
    /// Time between two updates, in ms.
    #[arg(long, value_name = "MS", default_value_t = 100, value_parser = clap::value_parser!(u64).range(20..=10_000))]
    every: u64,
    /// Print one snapshot and end: the default if the output is not a terminal.
    #[arg(long)]
    once: bool,
    /// Print one snapshot as one JSON object.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &TopArgs, out: &mut dyn Write) -> Result<Ending, CommandError> {
    let settings = match &args.machine {
        Some(file) => Some(
            Machine::load(file)
                .map_err(|error| CommandError::Usage(error.to_string()))?
                .signals,
        ),
        None => None,
    };
    if args.once || args.json || !io::stdout().is_terminal() {
        return snapshot(args, settings.as_ref(), out);
    }
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
        signal_hook::flag::register(signal, Arc::clone(&stop))
            .map_err(|error| CommandError::Failed(format!("signals cannot be watched: {error}")))?;
    }
    let mut terminal = Terminal::take(out).map_err(write_error)?;
    watch(args, settings.as_ref(), &mut terminal, &stop)?;
    Ok(Ending::Clean)
}

#[expect(clippy::needless_pass_by_value, reason = "given to map_err by name")]
fn write_error(error: io::Error) -> CommandError {
    CommandError::Failed(format!("the screen cannot be written: {error}"))
}

/// A connection to the core.
struct Client {
    bus: ClientBus,
    status: StatusReader,
    signals: SignalWatch,
}

fn open(args: &TopArgs, settings: Option<&SignalSettings>, wait: Duration) -> Result<Client, BusError> {
    let mut config = ClientConfig::new(&args.machine_name);
    config.prefix.clone_from(&args.bus_prefix);
    config.wait = wait;
    let bus = ClientBus::open(&config)?;
    Ok(Client {
        status: bus.status()?,
        signals: SignalWatch::open(&bus, settings.cloned())?,
        bus,
    })
}

fn snapshot(
    args: &TopArgs,
    settings: Option<&SignalSettings>,
    out: &mut dyn Write,
) -> Result<Ending, CommandError> {
    let failed = |error: &dyn std::fmt::Display| CommandError::Failed(error.to_string());
    let mut client = open(args, settings, PATIENCE).map_err(|error| failed(&error))?;
    if settings.is_some() {
        // A bridge sends several times in this time.
        thread::sleep(LISTENING);
    }
    let end = Instant::now() + PATIENCE;
    let status = loop {
        if let Some(status) = client.status.latest().map_err(|error| failed(&error))? {
            break status;
        }
        if Instant::now() >= end {
            let text = format!(
                "{} has sent no status for {} s: its core has ended",
                args.machine_name,
                PATIENCE.as_secs()
            );
            return Err(CommandError::Failed(text));
        }
        thread::sleep(Duration::from_millis(5));
    };
    let axes = client.bus.axes();
    client.signals.poll().map_err(|error| failed(&error))?;
    let periphery = client.signals.periphery(Some(&status));
    let written = if args.json {
        let mut object = to_json(&args.machine_name, &status, axes);
        if settings.is_some() {
            object["signals"] = periphery.to_json();
        }
        writeln!(out, "{object}")
    } else {
        out.write_all(picture(&args.machine_name, &status, axes, &periphery, None, false).as_bytes())
    };
    written.map_err(write_error)?;
    Ok(Ending::Clean)
}

/// Draws until the user ends it. Waits for a core that has ended.
fn watch(
    args: &TopArgs,
    settings: Option<&SignalSettings>,
    terminal: &mut Terminal<'_>,
    stop: &AtomicBool,
) -> Result<(), CommandError> {
    let every = Duration::from_millis(args.every);
    let mut client: Option<Client> = None;
    let mut newest: Option<(Status, Instant)> = None;
    while !stop.load(Ordering::Relaxed) && !terminal.wants_to_end() {
        if client.is_none() {
            match open(args, settings, CONNECT_TIMEOUT) {
                Ok(opened) => client = Some(opened),
                Err(error) => {
                    let text = format!("{}: {error}\n\nq ends\n", args.machine_name);
                    terminal.draw(&text).map_err(write_error)?;
                }
            }
        }
        let mut lost = false;
        if let Some(client) = &mut client {
            match client.status.latest() {
                Ok(Some(status)) => {
                    if newest
                        .as_ref()
                        .is_none_or(|(before, _)| before.sequence != status.sequence)
                    {
                        newest = Some((status, Instant::now()));
                    }
                }
                Ok(None) => {}
                Err(_) => lost = true,
            }
            lost |= client.signals.poll().is_err();
            if let Some((status, since)) = &newest {
                let age = since.elapsed();
                let periphery = client.signals.periphery(Some(status));
                let text = picture(
                    &args.machine_name,
                    status,
                    client.bus.axes(),
                    &periphery,
                    (age > STALE).then_some(age),
                    true,
                );
                terminal.draw(&text).map_err(write_error)?;
                // A core that restarts creates its services again.
                lost |= age > 4 * STALE;
            }
        }
        if lost {
            client = None;
            newest = None;
        }
        thread::sleep(every);
    }
    Ok(())
}

const MACHINE_STATES: [&str; 3] = ["EMERGENCY STOP", "off", "on"];
const MODES: [&str; 3] = ["automatic", "manual", "MDI"];
const FLAGS: [(u32, &str); 7] = [
    (1, "LATE"),
    (2, "hold"),
    (4, "blend"),
    (8, "rapid"),
    (16, "joint"),
    (32, "STARVED"),
    (64, "GUARD"),
];

fn state_name(state: u32) -> String {
    STATES.iter().find(|(_, number)| *number == state).map_or_else(
        || format!("state {state}"),
        |(name, _)| name.to_lowercase().replace('_', " "),
    )
}

/// The machine as text. `stale` is how old the snapshot is, if it is too old.
fn picture(
    name: &str,
    status: &Status,
    axes: &str,
    periphery: &Periphery,
    stale: Option<Duration>,
    colours: bool,
) -> String {
    let mut picture = Picture {
        status,
        colours,
        text: String::new(),
    };
    picture.heading(name, stale);
    picture.what_it_waits_for();
    picture.program();
    picture.axes(axes);
    picture.motion();
    for line in periphery.lines().iter().chain(&periphery.discarded) {
        let _ = writeln!(picture.text, "{}", one_line(line));
    }
    picture.core_loop();
    if colours {
        picture.text.push_str("\nq ends\n");
    }
    picture.text
}

fn pick(list: &[&'static str], at: u32) -> &'static str {
    list.get(at as usize).copied().unwrap_or("?")
}

/// A status that is being written. Writing to a string cannot fail.
struct Picture<'a> {
    status: &'a Status,
    colours: bool,
    text: String,
}

impl Picture<'_> {
    fn paint(&self, code: &'static str, text: &str) -> String {
        if self.colours {
            format!("{code}{text}{PLAIN}")
        } else {
            text.to_owned()
        }
    }

    fn heading(&mut self, name: &str, stale: Option<Duration>) {
        let _ = writeln!(
            self.text,
            "{}  machine {}, {}, {}",
            self.paint(BOLD, name),
            pick(&MACHINE_STATES, self.status.machine_state),
            pick(&MODES, self.status.mode),
            self.paint(BOLD, &state_name(self.status.state))
        );
        if let Some(age) = stale {
            let words = format!("the core has sent nothing for {:.1} s", age.as_secs_f64());
            let _ = writeln!(self.text, "{}", self.paint(RED, &words));
        }
    }

    /// Alarms, and inputs that block the machine.
    fn what_it_waits_for(&mut self) {
        // First, so that a small terminal shows it.
        if self.status.alarm_count > 0 {
            let numbers: Vec<String> = self.status.listed_alarms().iter().map(u32::to_string).collect();
            let words = format!(
                "ALARM {}  {}",
                numbers.join(", "),
                one_line(self.status.alarm_sentence())
            );
            let _ = writeln!(self.text, "{}", self.paint(RED, words.trim_end()));
        }
        if self.status.switches & switches::CHAIN_OPEN != 0 {
            let words = "the emergency-stop chain is open, or no bridge reads it";
            let _ = writeln!(self.text, "{}", self.paint(RED, words));
        }
        if self.status.switches & switches::INPUT_WAIT != 0 {
            let _ = writeln!(
                self.text,
                "waits for an input or a spindle, and continues automatically"
            );
        }
        if let Some(state) = probe_state(self.status) {
            let _ = writeln!(self.text, "probe {state}");
        }
    }

    fn program(&mut self) {
        let program = match self.status.program_name() {
            "" => "no program",
            program => program,
        };
        let line = match self.status.line {
            0 => String::new(),
            line => format!(", line {line}"),
        };
        let _ = writeln!(self.text, "{program}{line}");
        if !self.status.operator_message().is_empty() {
            let _ = writeln!(self.text, "message: {}", one_line(self.status.operator_message()));
        }
    }

    fn axes(&mut self, axes: &str) {
        let _ = writeln!(
            self.text,
            "\n      {:>14} {:>14} {:>12} {:>12} {:>12}",
            "machine", "work", "to go", "velocity", "error"
        );
        for (at, letter) in "XYZABCUVW".chars().enumerate() {
            if !AxisMask::from_bits(self.status.axes_mask).contains(at) || !axes.contains(letter) {
                continue;
            }
            let is_homed = AxisMask::from_bits(self.status.homed_mask).contains(at);
            // As on the screen, X is the value that programs use. Velocity and following error are those of
            // the axis.
            let is_diameter = letter == 'X' && is_diameter(self.status);
            let factor = if is_diameter { 2.0 } else { 1.0 };
            let unit = match letter {
                'A' | 'B' | 'C' => "deg",
                _ if is_diameter => "\u{2300}mm",
                _ => "mm",
            };
            let following = if self.status.has_feedback() {
                format!("{:.4}", self.status.following_error[at])
            } else {
                "-".to_owned()
            };
            let _ = writeln!(
                self.text,
                "{}{} {unit:>3} {:>14.4} {:>14.4} {:>12.4} {:>12.3} {following:>12}",
                self.paint(BOLD, &letter.to_string()),
                if is_homed { '*' } else { ' ' },
                factor * self.status.position_machine[at],
                factor * self.status.position_work[at],
                factor * self.status.distance_to_go[at],
                self.status.velocity[at]
            );
        }
    }

    fn motion(&mut self) {
        let feed = 60.0 * self.status.feed_mm_s;
        let _ = writeln!(
            self.text,
            "\nfeed {:.1} mm/min of {:.1}   override {:.0} %, rapid {:.0} %, spindle {:.0} %{}   {}   T{}{}",
            feed,
            60.0 * self.status.feed_programmed_mm_s,
            100.0 * self.status.override_ratio,
            100.0 * self.status.rapid_override_ratio,
            100.0 * self.status.spindle_override_ratio,
            uncounted_override(self.status),
            spindle_words(self.status, "   "),
            self.status.tool,
            if is_tool_unknown(self.status) { "?" } else { "" }
        );
        let _ = writeln!(
            self.text,
            "path {:.3} mm   longest stop {}   cycle {}, {:.2} Hz   clients {}",
            self.status.path_mm,
            longest_stop(self.status),
            self.status.cycles,
            1e9 / self.status.period_ns.max(1) as f64,
            self.status.setpoint_subscribers
        );
    }

    /// Lateness of the loop, losses, and the flags of the setpoint.
    fn core_loop(&mut self) {
        let us = |ns: u64| ns as f64 * 1e-3;
        let _ = writeln!(
            self.text,
            "wake-up lateness p50 {:.1}, p99.9 {:.1}, max {:.1} us   work p50 {:.1}, p99.9 {:.1}, max {:.1} \
             us",
            us(self.status.wake_lateness_p50_ns),
            us(self.status.wake_lateness_p999_ns),
            us(self.status.wake_lateness_max_ns),
            us(self.status.work_p50_ns),
            us(self.status.work_p999_ns),
            us(self.status.work_max_ns)
        );
        if self.status.phase_error_max_ns > 0.0 {
            let _ = writeln!(
                self.text,
                "drives' clock: drift {:.2} ppm   phase error max {:.1} us",
                self.status.clock_drift_ppm,
                self.status.phase_error_max_ns * 1e-3
            );
        }
        let lost = format!(
            "late setpoints {}, lost setpoints {}, lost records {}",
            self.status.late_cycles, self.status.dropped_setpoints, self.status.dropped_records
        );
        let is_clean =
            self.status.late_cycles + self.status.dropped_setpoints + self.status.dropped_records == 0;
        let _ = writeln!(
            self.text,
            "{}",
            if is_clean { lost } else { self.paint(RED, &lost) }
        );
        let flags: Vec<&str> = FLAGS
            .iter()
            .filter(|(bit, _)| self.status.flags & bit != 0)
            .map(|(_, name)| *name)
            .collect();
        if !flags.is_empty() {
            let _ = writeln!(self.text, "flags {}", flags.join(", "));
        }
    }
}

/// A text from the bus may contain anything; here it stays on one line and cannot move the cursor.
fn one_line(text: &str) -> String {
    text.chars()
        .map(|c| if c.is_control() { ' ' } else { c })
        .collect()
}

/// The longest stop by a hold in the job so far.
fn longest_stop(status: &Status) -> String {
    if status.longest_stop_mm > 0.0 {
        format!(
            "{:.3} mm, {:.0} ms (line {})",
            status.longest_stop_mm,
            1e3 * status.longest_stop_s,
            status.longest_stop_line
        )
    } else {
        "-".to_owned()
    }
}

fn to_json(name: &str, status: &Status, axes: &str) -> serde_json::Value {
    let by_axis = |values: &[f64; 9]| -> serde_json::Value {
        "XYZABCUVW"
            .chars()
            .zip(values)
            .filter(|(letter, _)| axes.contains(*letter))
            .map(|(letter, value)| (letter.to_string(), json!(value)))
            .collect::<serde_json::Map<_, _>>()
            .into()
    };
    json!({
        "machine": name,
        "sequence": status.sequence,
        "cycles": status.cycles,
        "period_ns": status.period_ns,
        "state": state_name(status.state),
        "mode": MODES.get(status.mode as usize),
        "machine_state": MACHINE_STATES.get(status.machine_state as usize),
        "program": status.program_name(),
        "line": status.line,
        "flags": status.flags,
        "position_machine": by_axis(&status.position_machine),
        "position_work": by_axis(&status.position_work),
        "distance_to_go": by_axis(&status.distance_to_go),
        "velocity": by_axis(&status.velocity),
        "following_error": status.has_feedback().then(|| by_axis(&status.following_error)),
        "path_mm": status.path_mm,
        "longest_stop_mm": (status.longest_stop_mm > 0.0).then_some(status.longest_stop_mm),
        "longest_stop_s": (status.longest_stop_mm > 0.0).then_some(status.longest_stop_s),
        "longest_stop_line": (status.longest_stop_mm > 0.0).then_some(status.longest_stop_line),
        "parts": status.parts,
        "program_time_s": status.program_time_s,
        "program_held_s": status.program_held_s,
        "feed_mm_s": status.feed_mm_s,
        "override_ratio": status.override_ratio,
        "spindles": spindles(status),
        "late_cycles": status.late_cycles,
        "dropped_records": status.dropped_records,
        "dropped_setpoints": status.dropped_setpoints,
        "setpoint_subscribers": status.setpoint_subscribers,
        "chain_open": status.switches & switches::CHAIN_OPEN != 0,
        "input_wait": status.switches & switches::INPUT_WAIT != 0,
        "probe": probe_state(status),
        "alarms": status.listed_alarms(),
        "alarm_text": status.alarm_sentence(),
        "message": status.operator_message(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn status() -> Status {
        let mut status = Status {
            state: 1,
            machine_state: 2,
            axes_mask: 0b101,
            homed_mask: 1,
            line: 17,
            feed_mm_s: 25.0,
            override_ratio: 1.2,
            late_cycles: 3,
            ..Status::default()
        };
        status.position_machine[2] = -7.5;
        status.set_program("part.ngc");
        status
    }

    #[test]
    fn a_picture_shows_state_axes_feed_and_faults() {
        let mut status = status();
        status.switches =
            switches::CHAIN_OPEN | switches::INPUT_WAIT | switches::PROBE_TRIPPED | switches::TOOL_UNKNOWN;
        status.push_alarm(200);
        status.set_alarm_text("the guard refused\x1b[2J a setpoint");
        let text = picture(
            "mill",
            &status,
            "XZ",
            &Periphery::default(),
            Some(Duration::from_secs(3)),
            false,
        );
        for part in [
            "mill  machine on, automatic, running",
            "nothing for 3.0 s",
            "part.ngc, line 17",
            "X*  mm",
            "Z   mm        -7.5000",
            "feed 1500.0 mm/min",
            "override 120 %",
            "late setpoints 3",
            "ALARM 200",
            "emergency-stop chain is open",
            "waits for an input or a spindle",
            "probe tripped",
            "T0?",
        ] {
            assert!(text.contains(part), "{part} is not in\n{text}");
        }
        assert!(!text.contains("\nY"), "an axis that the machine lacks\n{text}");
        assert!(
            !text.contains('\x1b'),
            "nothing for a terminal where there is none\n{text}"
        );
    }

    #[test]
    fn json_says_the_same() {
        let value = to_json("mill", &status(), "XZ");
        assert_eq!(value["position_machine"], json!({ "X": 0.0, "Z": -7.5 }));
        assert_eq!((&value["state"], &value["line"]), (&json!("running"), &json!(17)));
        // A deviation of 0 would mean that drives follow exactly.
        let mut alone = status();
        alone.following_error = [0.5; 9];
        assert_eq!(to_json("mill", &alone, "XZ")["following_error"]["X"], json!(0.5));
        alone.feedback_age_ns = u64::MAX;
        assert_eq!(to_json("mill", &alone, "XZ")["following_error"], json!(null));
        let line = |status| {
            let text = picture("mill", &status, "XZ", &Periphery::default(), None, false);
            text.lines().find(|line| line.starts_with('Z')).map(str::to_owned)
        };
        assert!(
            line(alone).is_some_and(|line| line.ends_with(" -")),
            "{:?}",
            line(alone)
        );
    }
}
