//! Inputs from a file, with the times of their changes, for runs without a machine.

use std::path::Path;

use evolvent_config::{ConfigDocument, ConfigError, TextFileError, read_text};
use evolvent_machine::{AtSpeed, SignalKind, SignalSettings};
use evolvent_motion::Setpoint;
use evolvent_signals::{InputImage, ProbeState, SpindleState, probe_numbers};
use serde::Deserialize;

use crate::signal_loop::SignalName;

/// Maximum size of a file of inputs.
const MAX_BYTES: u64 = 1024 * 1024;
/// Name of the probe in such a file.
const PROBE: &str = "probe";
/// Help for a change with an invalid time.
const WHEN: &str = "give one of at_s, at_path_mm and at_line";

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ScriptFile {
    #[serde(default)]
    change: Vec<ChangeFile>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ChangeFile {
    /// Name of the input.
    input: String,
    /// State of a digital input.
    on: Option<bool>,
    /// Value of an analog input.
    value: Option<f64>,
    /// The input is unknown from then on.
    #[serde(default)]
    unknown: bool,
    /// Path time, s.
    at_s: Option<f64>,
    /// Path travelled, mm.
    at_path_mm: Option<f64>,
    /// Program line that is reached.
    at_line: Option<u32>,
}

impl ChangeFile {
    /// When the change takes place; `None` for the start.
    fn when(&self) -> Result<Option<When>, String> {
        match (self.at_s, self.at_path_mm, self.at_line) {
            (None, None, None) => Ok(None),
            (Some(seconds), None, None) if seconds >= 0.0 && seconds.is_finite() => {
                Ok(Some(When::Seconds(seconds)))
            }
            (None, Some(path), None) if path >= 0.0 && path.is_finite() => Ok(Some(When::Path(path))),
            (None, None, Some(line)) => Ok(Some(When::Line(line))),
            _ => Err("the time of the change is not given by one number of 0 or more".to_owned()),
        }
    }
}

/// When a change takes place.
#[derive(Clone, Copy, Debug, PartialEq)]
enum When {
    Seconds(f64),
    Path(f64),
    Line(u32),
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct ScriptedChange {
    when: When,
    name: SignalName,
    value: Option<f64>,
    done: bool,
}

/// Inputs over the course of a run. Without a file all inputs are unknown except the emergency-stop chain,
/// which is closed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct InputScript {
    begin: InputImage,
    changes: Vec<ScriptedChange>,
    now: InputImage,
    has_begun: bool,
}

/// An error in a file of inputs.
#[derive(Debug, thiserror::Error)]
pub enum InputScriptError {
    /// The file cannot be read.
    #[error(transparent)]
    File(#[from] TextFileError),
    /// A key or value is invalid.
    #[error(transparent)]
    Document(#[from] ConfigError),
}

impl InputScript {
    /// All inputs are unknown, the emergency-stop chain is closed, and spindles follow their commands at
    /// once.
    #[must_use]
    pub fn without_file(settings: &SignalSettings) -> Self {
        let mut begin = InputImage::default();
        if let Some(estop) = settings.estop {
            let closed = f64::from(u8::from(estop.closed));
            begin.set(SignalKind::Digital, estop.input, Some(closed));
        }
        for spindle in &settings.spindles {
            begin.set_spindle(spindle.number, Some(SpindleState::OBEDIENT));
            // An at-speed input is on until the file changes it.
            if let AtSpeed::Input(number) = spindle.at_speed {
                begin.set(SignalKind::Digital, number, Some(1.0));
            }
        }
        if settings.probe.is_some() {
            begin.probe.state = ProbeState::Imagined;
        }
        Self {
            begin,
            ..Self::default()
        }
    }

    /// Reads a file of `[[change]]` tables: `input` (its name), `on`, `value` or `unknown = true`, and
    /// `at_s`, `at_path_mm` or `at_line`; without one of these the change applies from the start. Changes
    /// with the same setpoint apply in the order of the file.
    ///
    /// # Errors
    /// File, line, column and key of the error.
    pub fn load(path: &Path, settings: &SignalSettings) -> Result<Self, InputScriptError> {
        let (text, file) = read_text(path, MAX_BYTES, "file of inputs")?;
        Self::parse(&text, &file, settings)
    }

    /// Like [`InputScript::load`], from a text.
    ///
    /// # Errors
    /// As [`InputScript::load`].
    pub fn parse(text: &str, file: &str, settings: &SignalSettings) -> Result<Self, InputScriptError> {
        let document = ConfigDocument::toml(text, file)?;
        let raw: ScriptFile = document.read()?;
        let mut script = Self::without_file(settings);
        for (index, change) in raw.change.iter().enumerate() {
            let wrong = |key: &str, what: String, advice: &str| {
                document.error(&format!("change[{index}].{key}"), what, advice.to_owned())
            };
            if settings.probe.is_some() && change.input == PROBE {
                let value = match (change.on, change.value, change.unknown) {
                    (Some(on), None, false) => Some(f64::from(u8::from(on))),
                    (None, None, true) => None,
                    _ => {
                        let what = "the probe needs one state".to_owned();
                        let advice = "write on = true (tripped), on = false (open), or unknown = true";
                        return Err(wrong("input", what, advice).into());
                    }
                };
                if script.begin.probe.state == ProbeState::Imagined {
                    script.begin.probe.state = ProbeState::Open;
                }
                match change.when().map_err(|what| wrong("input", what, WHEN))? {
                    None => script.begin.probe.set(probe_numbers::STATE, value),
                    Some(when) => script.changes.push(ScriptedChange {
                        when,
                        name: SignalName::Probe(probe_numbers::STATE),
                        value,
                        done: false,
                    }),
                }
                continue;
            }
            let Some(input) = settings.inputs.iter().find(|input| input.name == change.input) else {
                let names: Vec<_> = settings.inputs.iter().map(|input| input.name.as_str()).collect();
                let what = format!("the machine has no input called {:?}", change.input);
                return Err(wrong(
                    "input",
                    what,
                    &format!("name one of its inputs: {}", names.join(", ")),
                )
                .into());
            };
            let value = match (input.kind, change.on, change.value, change.unknown) {
                (_, None, None, true) => None,
                (SignalKind::Digital, Some(on), None, false) => Some(f64::from(u8::from(on))),
                (SignalKind::Analog, None, Some(value), false)
                    if (input.range[0]..=input.range[1]).contains(&value) =>
                {
                    Some(value)
                }
                (SignalKind::Analog, None, Some(value), false) => {
                    let [min, max] = input.range;
                    let what = format!("{value} is not between {min} and {max}");
                    return Err(wrong("value", what, "give a value in the range of the machine file").into());
                }
                (kind, ..) => {
                    let what = format!("the {} input needs one value", kind.name());
                    let advice =
                        "write on = true or false (digital), value and a number (analog), or unknown = true";
                    return Err(wrong("input", what, advice).into());
                }
            };
            let Some(when) = change.when().map_err(|what| wrong("input", what, WHEN))? else {
                script.begin.set(input.kind, input.number, value);
                continue;
            };
            script.changes.push(ScriptedChange {
                when,
                name: SignalName::Signal(input.kind, input.number),
                value,
                done: false,
            });
        }
        Ok(script)
    }

    /// Returns the image of all inputs after the next change that is due at a setpoint; `None` if no more is
    /// due. Allocates nothing.
    pub(crate) fn next(
        &mut self,
        sequence: u64,
        period_ns: u64,
        last: Option<&Setpoint>,
    ) -> Option<InputImage> {
        let seconds = sequence as f64 * (period_ns as f64 * 1e-9);
        let before = self.now.probe.state;
        let mut image = self.step(seconds, last.map(|last| (last.path_mm, last.line)))?;
        if image.probe.state != before
            && let Some(last) = last
        {
            let mut position = [0.0; 9];
            position.copy_from_slice(last.position.as_slice());
            self.now.probe.locate_change(position);
            image = self.now;
        }
        Some(image)
    }

    /// Returns the inputs after the next change that is due at this time (s), path (mm) and line.
    pub fn step(&mut self, seconds: f64, position: Option<(f64, u32)>) -> Option<InputImage> {
        if !self.has_begun {
            (self.has_begun, self.now) = (true, self.begin);
            return Some(self.now);
        }
        let due = self.changes.iter_mut().find(|change| {
            !change.done
                && match change.when {
                    When::Seconds(at) => seconds >= at,
                    When::Path(at) => position.is_some_and(|(path_mm, _)| path_mm >= at),
                    When::Line(wanted) => position.is_some_and(|(_, line)| line == wanted),
                }
        })?;
        due.done = true;
        due.name.enter(&mut self.now, due.value);
        Some(self.now)
    }
}
