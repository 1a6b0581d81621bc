//! `evolvent ctl io`: present state of inputs, outputs, switches and spindles.

use std::io::{self, Write};
use std::path::Path;
use std::time::{Duration, Instant};

use evolvent_bus::{
    ClientBus, Feedback, MachineInputs, MachineOutputs, PROBE_STATES, SPINDLE_DIRECTIONS, SpindleReading,
    Status,
};
use evolvent_machine::{MAX_SPINDLES, Machine, SignalKind, SignalSettings};
use evolvent_path::{AxisLetter, AxisMask};
use serde_json::{Value, json};

use crate::signal_watch::SignalWatch;
use crate::{CommandError, Ending};

/// Duration for which messages are collected. A bridge sends several times per input timeout, 100 ms by
/// default.
const LISTENING: Duration = Duration::from_millis(500);
/// Poll interval.
const POLL: Duration = Duration::from_millis(5);

/// A signal and its present value.
#[derive(Clone, Debug, PartialEq)]
struct Signal {
    /// Empty without a machine file.
    name: String,
    kind: SignalKind,
    number: u32,
    /// None if unknown.
    value: Option<f64>,
}

/// A spindle with its present command.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Spindle {
    number: u32,
    /// A number in the list of directions.
    direction: u32,
    commanded_rpm: f64,
    /// Negative counter-clockwise; `None` if unknown.
    measured_rpm: Option<f64>,
}

/// The axes whose switches are closed, as bridges report them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Switches {
    home: AxisMask,
    positive: AxisMask,
    negative: AxisMask,
}

impl Switches {
    /// Combines the reports of all bridges; `None` without any.
    fn of(bridges: &[Feedback]) -> Option<Self> {
        let mask = |of: fn(&Feedback) -> u32| {
            let bits = bridges.iter().map(of).fold(0, |all, bits| all | bits);
            AxisMask::from_bits(bits)
        };
        (!bridges.is_empty()).then(|| Self {
            home: mask(|bridge| bridge.home_switch_mask),
            positive: mask(|bridge| bridge.positive_limit_mask),
            negative: mask(|bridge| bridge.negative_limit_mask),
        })
    }

    fn named(&self) -> [(&'static str, AxisMask); 3] {
        [
            ("home", self.home),
            ("positive limit", self.positive),
            ("negative limit", self.negative),
        ]
    }
}

/// The received messages.
#[derive(Clone, Debug, Default)]
pub(crate) struct Periphery {
    inputs: Vec<Signal>,
    outputs: Vec<Signal>,
    spindles: Vec<Spindle>,
    probe: u32,
    /// Whether names from a machine file are available.
    is_named: bool,
    /// `None` if no bridge sends feedback.
    switches: Option<Switches>,
    /// Why the core discards messages of inputs, so that their values are unknown.
    pub(crate) discarded: Vec<String>,
}

/// Prints inputs, outputs, switches and spindles. `machine` is the machine file, which contains the names.
pub(crate) fn run(
    bus: &ClientBus,
    machine: Option<&Path>,
    json: bool,
    out: &mut dyn Write,
) -> Result<Ending, CommandError> {
    let failed = |error: &dyn std::fmt::Display| CommandError::Failed(error.to_string());
    let settings = match machine {
        Some(file) => Some(
            Machine::load(file)
                .map_err(|error| CommandError::Usage(error.to_string()))?
                .signals,
        ),
        None => None,
    };
    let periphery = listen(bus, settings).map_err(|error| failed(&error))?;
    let written = if json {
        writeln!(out, "{}", periphery.to_json())
    } else {
        periphery.write(out)
    };
    written.map_err(|error| failed(&error))?;
    Ok(Ending::Clean)
}

/// Collects messages for [`LISTENING`].
fn listen(
    bus: &ClientBus,
    settings: Option<SignalSettings>,
) -> Result<Periphery, Box<dyn std::error::Error>> {
    let (mut signals, mut status) = (SignalWatch::open(bus, settings)?, bus.status()?);
    let (mut reports, mut feedback) = (bus.feedback()?, Vec::<Feedback>::new());
    let begin = Instant::now();
    while begin.elapsed() < LISTENING {
        signals.poll()?;
        while let Some(message) = reports.receive()? {
            feedback.retain(|known| known.instance != message.instance);
            feedback.push(message);
        }
        std::thread::sleep(POLL);
    }
    Ok(Periphery {
        switches: Switches::of(&feedback),
        ..signals.periphery(status.latest()?.as_ref())
    })
}

impl Periphery {
    pub(crate) fn of(
        settings: Option<&SignalSettings>,
        outputs: Option<&MachineOutputs>,
        bridges: &[MachineInputs],
        status: Option<&Status>,
    ) -> Self {
        let mut found = Self {
            probe: bridges.iter().map(|bridge| bridge.probe).max().unwrap_or(0),
            is_named: settings.is_some(),
            ..Self::default()
        };
        for kind in [SignalKind::Digital, SignalKind::Analog] {
            for number in 0..kind.max() {
                let read = bridges
                    .iter()
                    .rev()
                    .find_map(|bridge| input(bridge, kind, number));
                let named = settings.and_then(|settings| settings.input(kind, number));
                if let Some(signal) = signal(kind, number, named.map(|input| &input.name), settings, read) {
                    found.inputs.push(signal);
                }
                let set = outputs.and_then(|outputs| output(outputs, kind, number));
                let named = settings.and_then(|settings| settings.output(kind, number));
                if let Some(signal) = signal(kind, number, named.map(|output| &output.name), settings, set) {
                    found.outputs.push(signal);
                }
            }
        }
        if let Some(outputs) = outputs {
            let there = (0..MAX_SPINDLES).filter(|number| outputs.spindle_mask >> number & 1 == 1);
            found.spindles = there
                .map(|number| {
                    let at = number as usize;
                    let of_it = |reading: &SpindleReading| reading.number == number;
                    let reading = status.and_then(|status| status.spindles().find(of_it));
                    Spindle {
                        number,
                        direction: outputs.spindle_direction[at],
                        // The field keeps the last speed while the spindle is stopped or oriented.
                        commanded_rpm: match outputs.spindle_direction[at] {
                            1 | 2 => outputs.spindle_rpm[at],
                            _ => 0.0,
                        },
                        measured_rpm: reading.and_then(|reading| reading.measured_rpm),
                    }
                })
                .collect();
        }
        found
    }

    pub(crate) fn to_json(&self) -> Value {
        let list = |signals: &[Signal]| -> Vec<Value> {
            let each = signals.iter().map(|signal| {
                json!({
                    "name": (!signal.name.is_empty()).then_some(&signal.name),
                    "kind": signal.kind.name(),
                    "number": signal.number,
                    "value": signal.value,
                })
            });
            each.collect()
        };
        let spindles: Vec<Value> = (self.spindles.iter())
            .map(|spindle| {
                json!({
                    "number": spindle.number,
                    "direction": word(&SPINDLE_DIRECTIONS, spindle.direction),
                    "commanded_rpm": spindle.commanded_rpm,
                    "measured_rpm": spindle.measured_rpm,
                })
            })
            .collect();
        json!({
            "inputs": list(&self.inputs),
            "outputs": list(&self.outputs),
            "spindles": spindles,
            "probe": word(&PROBE_STATES, self.probe),
            "switches": self.switches.map(|switches| {
                switches.named().map(|(name, closed)| (name.replace(' ', "_"), json!(letters(closed))))
                    .into_iter()
                    .collect::<serde_json::Map<_, _>>()
            }),
            "discarded": self.discarded,
        })
    }

    /// Inputs and outputs, each kind in lines of at most 100 characters; nothing if there are none.
    pub(crate) fn lines(&self) -> Vec<String> {
        let mut lines = Vec::new();
        for (heading, signals) in [("inputs", &self.inputs), ("outputs", &self.outputs)] {
            let mut line = heading.to_owned();
            for signal in signals {
                let name = match signal.name.as_str() {
                    "" => format!("{} {}", signal.kind.name(), signal.number),
                    name => name.to_owned(),
                };
                let item = format!("{name} {}", shown(signal));
                if line.len() + item.len() > 97 {
                    lines.push(std::mem::replace(&mut line, " ".repeat(heading.len())));
                }
                line.push_str("   ");
                line.push_str(&item);
            }
            if !signals.is_empty() {
                lines.push(line);
            }
        }
        lines
    }

    fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        for (heading, signals) in [("inputs", &self.inputs), ("outputs", &self.outputs)] {
            if signals.is_empty() {
                let why = if self.is_named {
                    "none"
                } else {
                    "none is sent; --machine FILE lists those of the machine"
                };
                writeln!(out, "{heading}: {why}")?;
                continue;
            }
            if self.is_named {
                writeln!(out, "{heading}")?;
            } else {
                writeln!(out, "{heading} by number; --machine FILE adds their names")?;
            }
            for signal in signals {
                if self.is_named {
                    write!(out, "  {:<32}", signal.name)?;
                }
                let (kind, number) = (signal.kind.name(), signal.number);
                writeln!(out, "  {kind:<7} {number:>2}  {}", shown(signal))?;
            }
        }
        for spindle in &self.spindles {
            let direction = word(&SPINDLE_DIRECTIONS, spindle.direction);
            let (number, rpm) = (spindle.number, spindle.commanded_rpm);
            write!(out, "spindle {number}: {direction}, commanded {rpm:.1} rpm")?;
            match spindle.measured_rpm {
                Some(rpm) => writeln!(out, ", measured {rpm:.1} rpm")?,
                None => writeln!(out)?,
            }
        }
        writeln!(out, "probe: {}", word(&PROBE_STATES, self.probe))?;
        match &self.switches {
            None => writeln!(out, "switches: unknown, no bridge sends feedback")?,
            Some(switches) => {
                let closed = switches.named().map(|(name, closed)| {
                    let axes = letters(closed).join(" ");
                    format!("{name} {}", if axes.is_empty() { "none" } else { &axes })
                });
                writeln!(out, "switches closed: {}", closed.join(", "))?;
            }
        }
        for text in &self.discarded {
            writeln!(
                out,
                "the core discards the messages of a bridge, so that its inputs are unknown: {text}"
            )?;
        }
        Ok(())
    }
}

fn letters(axes: AxisMask) -> Vec<String> {
    axes.axes()
        .map(|axis| AxisLetter::ALL[axis].letter().to_string())
        .collect()
}

/// A signal that is in the machine file or, without one, has a value.
fn signal(
    kind: SignalKind,
    number: u32,
    name: Option<&String>,
    settings: Option<&SignalSettings>,
    value: Option<f64>,
) -> Option<Signal> {
    let is_listed = match settings {
        Some(_) => name.is_some(),
        None => value.is_some(),
    };
    is_listed.then(|| Signal {
        name: name.cloned().unwrap_or_default(),
        kind,
        number,
        value,
    })
}

fn input(bridge: &MachineInputs, kind: SignalKind, number: u32) -> Option<f64> {
    match kind {
        SignalKind::Digital => bridge.digital_input(number).map(f64::from),
        SignalKind::Analog => bridge.analog_input(number),
    }
}

fn output(outputs: &MachineOutputs, kind: SignalKind, number: u32) -> Option<f64> {
    match kind {
        SignalKind::Digital => outputs.digital_output(number).map(f64::from),
        SignalKind::Analog => outputs.analog_output(number),
    }
}

fn shown(signal: &Signal) -> String {
    match (signal.kind, signal.value) {
        (_, None) => "unknown".to_owned(),
        (SignalKind::Digital, Some(value)) => if value == 0.0 { "off" } else { "on" }.to_owned(),
        (SignalKind::Analog, Some(value)) => value.to_string(),
    }
}

fn word(list: &[(&str, u32)], number: u32) -> String {
    list.iter()
        .find(|(_, known)| *known == number)
        .map_or_else(|| format!("unknown {number}"), |(name, _)| name.to_lowercase())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal_watch::accepted;

    const SIGNALS: &str = "
[[input]]
name = \"door\"
number = 3
[[input]]
name = \"load\"
kind = \"analog\"
number = 2
[[output]]
name = \"clamp\"
number = 63
";

    fn settings() -> SignalSettings {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/machines/mill-3axis.toml");
        let text = std::fs::read_to_string(file).unwrap();
        Machine::parse(&format!("{text}{SIGNALS}"), "io.toml")
            .unwrap()
            .signals
    }

    #[test]
    fn signals_are_named_and_unknown_without_a_value() {
        let outputs = MachineOutputs {
            digital_mask: 1 << 63,
            digital: 1 << 63,
            ..MachineOutputs::default()
        };
        let bridge = MachineInputs {
            digital_mask: 1 << 3 | 1 << 5,
            digital: 1 << 5,
            ..MachineInputs::default()
        };
        let settings = settings();
        let whole = Periphery::of(Some(&settings), Some(&outputs), &[bridge], None).to_json();
        assert_eq!(
            whole["inputs"],
            json!([
                {"name": "door", "kind": "digital", "number": 3, "value": 0.0},
                {"name": "load", "kind": "analog", "number": 2, "value": null},
            ])
        );
        assert_eq!(whole["outputs"][0]["value"], 1.0);
        // Without a machine file, signals with a value are listed by number.
        let bare = Periphery::of(None, None, &[bridge], None);
        let numbers: Vec<u32> = bare.inputs.iter().map(|signal| signal.number).collect();
        assert_eq!((numbers, bare.outputs.len()), (vec![3, 5], 0));
        let mut page = Vec::new();
        bare.write(&mut page).unwrap();
        let page = String::from_utf8(page).unwrap();
        let begin =
            "inputs by number; --machine FILE adds their names\n  digital  3  off\n  digital  5  on\n";
        assert!(page.starts_with(begin), "{page}");
        let mut page = Vec::new();
        Periphery::of(Some(&settings), None, &[], None)
            .write(&mut page)
            .unwrap();
        let page = String::from_utf8(page).unwrap();
        // Including the switches, since there is no bridge.
        assert_eq!(page.matches("unknown").count(), 4, "{page}");
    }

    /// The message keeps the last speed, which an oriented spindle does not turn at.
    #[test]
    fn only_a_turning_spindle_has_a_commanded_speed() {
        for (direction, expected) in [(0, 0.0), (1, 600.0), (2, 600.0), (3, 0.0)] {
            let mut outputs = MachineOutputs {
                spindle_mask: 1,
                ..MachineOutputs::default()
            };
            (outputs.spindle_direction[0], outputs.spindle_rpm[0]) = (direction, 600.0);
            let shown = Periphery::of(None, Some(&outputs), &[], None).to_json();
            assert_eq!(shown["spindles"][0]["commanded_rpm"], expected, "{direction}");
        }
    }

    #[test]
    fn switches_of_all_bridges_are_shown_by_axis() {
        let [one, other] =
            [(1, 0b001, 0b100, 0), (2, 0b010, 0, 0b1)].map(|(instance, home, positive, negative)| Feedback {
                instance,
                home_switch_mask: home,
                positive_limit_mask: positive,
                negative_limit_mask: negative,
                ..Feedback::default()
            });
        let shown = Periphery {
            switches: Switches::of(&[one, other]),
            ..Periphery::default()
        };
        assert_eq!(
            shown.to_json()["switches"],
            json!({"home": ["X", "Y"], "positive_limit": ["Z"], "negative_limit": ["X"]})
        );
        let mut page = Vec::new();
        shown.write(&mut page).unwrap();
        let page = String::from_utf8(page).unwrap();
        assert!(
            page.contains("switches closed: home X Y, positive limit Z, negative limit X"),
            "{page}"
        );
        assert_eq!(Switches::of(&[]), None);
    }

    #[test]
    fn discarded_inputs_are_unknown_with_their_reason() {
        let settings = settings();
        let good = MachineInputs {
            digital_mask: 1 << 3,
            digital: 1 << 3,
            ..MachineInputs::default()
        };
        // The machine has no input 5.
        let bad = MachineInputs {
            digital_mask: 1 << 3 | 1 << 5,
            ..good
        };
        let (used, discarded) = accepted(Some(&settings), &[good, bad], 1_000);
        assert_eq!((used.len(), discarded.len()), (1, 1));
        assert!(discarded[0].contains("no digital input 5"), "{discarded:?}");
        assert_eq!(accepted(None, &[bad], 1_000).0.len(), 1);
    }

    #[test]
    fn an_input_that_is_not_a_number_is_unknown() {
        let mut bridge = MachineInputs {
            analog_mask: 1 << 2,
            ..MachineInputs::default()
        };
        bridge.analog[2] = f64::NAN;
        assert_eq!(input(&bridge, SignalKind::Analog, 2), None);
    }
}
