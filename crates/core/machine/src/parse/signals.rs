//! Checks inputs, outputs, spindles and the emergency-stop chain, each alone and in combination.

use std::collections::BTreeMap;

use evolvent_config::shortened;

use super::{Check, MAX_NUMBER};
use crate::error::MachineError;
use crate::file::MachineFile;
use crate::signals::{
    AtSpeed, EstopSettings, InputFile, InputSettings, MAX_SPINDLES, OutputFile, OutputSettings,
    ProbeSettings, SignalKind, SignalSettings, SpindleFile, SpindleSettings,
};

/// Names and numbers already in use, with the entry that uses them.
#[derive(Default)]
struct Taken {
    names: BTreeMap<String, String>,
    digital: BTreeMap<i64, String>,
    analog: BTreeMap<i64, String>,
}

impl Check<'_> {
    pub(super) fn signals(&self, raw: &MachineFile) -> Result<SignalSettings, MachineError> {
        let mut taken = Taken::default();
        let mut inputs = Vec::new();
        for (index, input) in raw.input.iter().enumerate() {
            inputs.push(self.input(&format!("input[{index}]"), input, &mut taken)?);
        }
        // Inputs and outputs have separate number ranges but share their names.
        taken.digital.clear();
        taken.analog.clear();
        let mut outputs = Vec::new();
        for (index, output) in raw.output.iter().enumerate() {
            outputs.push(self.output(&format!("output[{index}]"), output, &mut taken)?);
        }
        let timeout = raw.signals.input_timeout_ms;
        let timeout_ms = self.or_default("signals.input_timeout_ms", timeout, 100.0, [1.0, 10_000.0])?;
        Ok(SignalSettings {
            spindles: self.spindles(raw, &inputs)?,
            estop: self.estop(raw, &inputs)?,
            probe: self.probe(raw)?,
            inputs,
            outputs,
            input_timeout_s: timeout_ms / 1000.0,
        })
    }

    fn input(&self, at: &str, raw: &InputFile, taken: &mut Taken) -> Result<InputSettings, MachineError> {
        let number = self.signal(at, &raw.name, raw.kind, raw.number, taken)?;
        Ok(InputSettings {
            name: raw.name.clone(),
            kind: raw.kind,
            number,
            range: self.range(at, raw.kind, raw.min, raw.max)?,
        })
    }

    fn output(&self, at: &str, raw: &OutputFile, taken: &mut Taken) -> Result<OutputSettings, MachineError> {
        let number = self.signal(at, &raw.name, raw.kind, raw.number, taken)?;
        let range = self.range(at, raw.kind, raw.min, raw.max)?;
        let safe = match (raw.kind, raw.safe_on, raw.safe_value) {
            (SignalKind::Digital, _, Some(_)) => {
                let what = "the safe state of a digital output is not a number".to_owned();
                return Err(self.error(&format!("{at}.safe_value"), what, "write safe_on = true or false"));
            }
            (SignalKind::Analog, Some(_), _) => {
                let what = "the safe value of an analog output is a number".to_owned();
                return Err(self.error(&format!("{at}.safe_on"), what, "write safe_value and a number"));
            }
            (SignalKind::Digital, on, None) => f64::from(u8::from(on.unwrap_or(false))),
            (SignalKind::Analog, None, value) => {
                let safe = value.unwrap_or(0.0);
                let key = format!("{at}.safe_value");
                self.number(&key, safe, -MAX_NUMBER, MAX_NUMBER)?;
                if !(range[0]..=range[1]).contains(&safe) {
                    let what = format!("{safe} is not between min and max, {} and {}", range[0], range[1]);
                    return Err(self.error(&key, what, "give a safe_value between min and max"));
                }
                safe
            }
        };
        Ok(OutputSettings {
            name: raw.name.clone(),
            kind: raw.kind,
            number,
            safe,
            range,
            on_hold: raw.on_hold,
            on_stop: raw.on_stop,
            on_end: raw.on_end,
        })
    }

    /// Checks name and number of an input or output.
    fn signal(
        &self,
        at: &str,
        name: &str,
        kind: SignalKind,
        number: i64,
        taken: &mut Taken,
    ) -> Result<u32, MachineError> {
        let good = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        let starts = name.starts_with(|c: char| c.is_ascii_alphanumeric());
        let key = format!("{at}.name");
        if !starts || name.len() > 32 || !name.chars().all(good) {
            let what = format!("{:?} is not a valid signal name", shortened(name));
            let advice = "use 1 to 32 letters, digits, '-' and '_', starting with a letter or digit";
            return Err(self.error(&key, what, advice));
        }
        if let Some(first) = taken.names.insert(name.to_owned(), at.to_owned()) {
            let what = format!("the name {name:?} is already used by {first}");
            return Err(self.error(&key, what, "give every input and output its own name"));
        }
        let key = format!("{at}.number");
        let checked = self.whole_number(&key, number, 0, i64::from(kind.max()) - 1)?;
        let numbers = match kind {
            SignalKind::Digital => &mut taken.digital,
            SignalKind::Analog => &mut taken.analog,
        };
        if let Some(first) = numbers.insert(number, at.to_owned()) {
            let what = format!("{} number {number} is already used by {first}", kind.name());
            return Err(self.error(&key, what, "choose another number"));
        }
        Ok(checked)
    }

    fn range(
        &self,
        at: &str,
        kind: SignalKind,
        min: Option<f64>,
        max: Option<f64>,
    ) -> Result<[f64; 2], MachineError> {
        for (key, bound) in [("min", min), ("max", max)] {
            let Some(bound) = bound else { continue };
            let key = format!("{at}.{key}");
            if kind == SignalKind::Digital {
                let what = "a digital signal has no range".to_owned();
                return Err(self.error(&key, what, "remove the key, or write kind = \"analog\""));
            }
            self.number(&key, bound, -MAX_NUMBER, MAX_NUMBER)?;
        }
        let range = [min.unwrap_or(-MAX_NUMBER), max.unwrap_or(MAX_NUMBER)];
        if range[0] >= range[1] {
            let what = format!("{} is not above min, {}", range[1], range[0]);
            return Err(self.error(&format!("{at}.max"), what, "give a max above min"));
        }
        Ok(range)
    }

    fn spindles(
        &self,
        raw: &MachineFile,
        inputs: &[InputSettings],
    ) -> Result<Vec<SpindleSettings>, MachineError> {
        let mut spindles: Vec<SpindleSettings> = Vec::new();
        for (index, spindle) in raw.spindle.iter().enumerate() {
            let key = format!("spindle[{index}].number");
            let number = self.whole_number(&key, spindle.number, 0, i64::from(MAX_SPINDLES) - 1)?;
            if spindles.iter().any(|other| other.number == number) {
                let what = format!("spindle {number} already exists");
                return Err(self.error(&key, what, "give every spindle its own number, 0 to 3"));
            }
            self.number(&format!("spindle[{index}].max_rpm"), spindle.max_rpm, 1e-3, 1e6)?;
            if let Some(rate) = spindle.acceleration_rpm_s {
                self.number(&format!("spindle[{index}].acceleration_rpm_s"), rate, 1.0, 1e7)?;
            }
            if let Some(rate) = spindle.ramp_rpm_s {
                self.number(&format!("spindle[{index}].ramp_rpm_s"), rate, 1.0, 1e7)?;
            }
            spindles.push(SpindleSettings {
                number,
                max_rpm: spindle.max_rpm,
                reverse: spindle.reverse.unwrap_or(true),
                at_speed: self.at_speed(index, spindle, inputs)?,
                at_speed_timeout_s: self.or_default(
                    &format!("spindle[{index}].at_speed_timeout_s"),
                    spindle.at_speed_timeout_s,
                    10.0,
                    [0.1, 600.0],
                )?,
                acceleration_rpm_s: spindle.acceleration_rpm_s,
                ramp_rpm_s: spindle.ramp_rpm_s,
            });
        }
        Ok(spindles)
    }

    fn at_speed(
        &self,
        index: usize,
        spindle: &SpindleFile,
        inputs: &[InputSettings],
    ) -> Result<AtSpeed, MachineError> {
        let key = format!("spindle[{index}].at_speed_input");
        let Some(name) = &spindle.at_speed_input else {
            return Ok(if spindle.feedback {
                AtSpeed::Feedback
            } else {
                AtSpeed::Unknown
            });
        };
        if spindle.feedback {
            let what = "the spindle has feedback, which reports when the speed is reached".to_owned();
            return Err(self.error(&key, what, "remove one of the two keys"));
        }
        Ok(AtSpeed::Input(self.digital_input(&key, name, inputs)?))
    }

    /// The number of the digital input with this name.
    fn digital_input(&self, key: &str, name: &str, inputs: &[InputSettings]) -> Result<u32, MachineError> {
        self.input_of_kind(key, name, inputs, SignalKind::Digital)
    }

    /// The number of the input of this kind with this name.
    pub(super) fn input_of_kind(
        &self,
        key: &str,
        name: &str,
        inputs: &[InputSettings],
        kind: SignalKind,
    ) -> Result<u32, MachineError> {
        let Some(input) = inputs.iter().find(|input| input.name == name) else {
            let what = format!("there is no input called {:?}", shortened(name));
            return Err(self.error(key, what, "name one of the file's [[input]], or add it"));
        };
        if input.kind != kind {
            let what = format!("the input {:?} is {}", input.name, input.kind.name());
            let article = if kind == SignalKind::Analog { "an" } else { "a" };
            return Err(self.error(key, what, format!("name {article} {} input", kind.name())));
        }
        Ok(input.number)
    }

    fn probe(&self, raw: &MachineFile) -> Result<Option<ProbeSettings>, MachineError> {
        let Some(probe) = &raw.probe else { return Ok(None) };
        if let Some(overtravel_mm) = probe.overtravel_mm {
            self.number("probe.overtravel_mm", overtravel_mm, 1e-4, 1000.0)?;
        }
        Ok(Some(ProbeSettings {
            overtravel_mm: probe.overtravel_mm,
        }))
    }

    fn estop(
        &self,
        raw: &MachineFile,
        inputs: &[InputSettings],
    ) -> Result<Option<EstopSettings>, MachineError> {
        let Some(estop) = &raw.estop else { return Ok(None) };
        Ok(Some(EstopSettings {
            input: self.digital_input("estop.input", &estop.input, inputs)?,
            closed: estop.closed.unwrap_or(true),
        }))
    }
}
