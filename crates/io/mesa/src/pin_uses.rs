//! Every pin and unit that a board file names, with its key, to find conflicts between entries.

use evolvent_config::{ConfigDocument, ConfigError};

use crate::board_settings::{
    Actuator, BoardSettings, InputSource, OutputTarget, Pin, SpindleOrienting, SpindleSpeed,
};

/// A pin that the board file names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct PinUse {
    /// Its key, such as `axis[0].enable`.
    pub(crate) key: String,
    pub(crate) pin: Pin,
    /// Whether the bridge drives it.
    pub(crate) is_driven: bool,
}

/// A unit of a module that the board file names.
struct UnitUse {
    key: String,
    what: &'static str,
    unit: usize,
}

impl BoardSettings {
    /// All pins, in the order of the file's kinds of entries.
    pub(crate) fn pin_uses(&self) -> Vec<PinUse> {
        let mut uses = Vec::new();
        let mut add = |key: String, pin: Option<Pin>, is_driven: bool| {
            uses.extend(pin.map(|pin| PinUse { key, pin, is_driven }));
        };
        for (i, axis) in self.axes.iter().enumerate() {
            let [home, negative, positive] = axis.switches;
            for (name, pin, is_driven) in [
                ("enable", axis.enable, true),
                ("fault", axis.fault, false),
                ("home_switch", home, false),
                ("negative_limit", negative, false),
                ("positive_limit", positive, false),
            ] {
                add(format!("axis[{i}].{name}"), pin, is_driven);
            }
        }
        for (i, input) in self.inputs.iter().enumerate() {
            if let InputSource::Pin(pin) = input.source {
                add(format!("input[{i}]"), Some(pin), false);
            }
        }
        for (i, output) in self.outputs.iter().enumerate() {
            if let OutputTarget::Pin(pin) = output.target {
                add(format!("output[{i}]"), Some(pin), true);
            }
        }
        for (i, spindle) in self.spindles.iter().enumerate() {
            let (orient, oriented) = match spindle.orienting {
                Some(SpindleOrienting::Drive { command, reached, .. }) => (Some(command), Some(reached)),
                _ => (None, None),
            };
            for (name, pin, is_driven) in [
                ("forward", spindle.forward, true),
                ("reverse", spindle.reverse, true),
                ("enable", spindle.enable, true),
                ("orient", orient, true),
                ("fault", spindle.fault, false),
                ("at_speed", spindle.at_speed, false),
                ("oriented", oriented, false),
            ] {
                add(format!("{}.{name}", self.spindle_key(i)), pin, is_driven);
            }
        }
        let [flood, mist] = self.coolant;
        add("flood".to_owned(), flood, true);
        add("mist".to_owned(), mist, true);
        uses
    }

    /// The key of a spindle: `[spindle]` of older files has no index.
    pub(crate) fn spindle_key(&self, i: usize) -> String {
        if self.has_single_spindle {
            "spindle".to_owned()
        } else {
            format!("spindle[{i}]")
        }
    }

    fn unit_uses(&self) -> Vec<UnitUse> {
        let mut uses = Vec::new();
        let mut add = |key: String, what, unit| uses.push(UnitUse { key, what, unit });
        for (i, axis) in self.axes.iter().enumerate() {
            match axis.actuator {
                Actuator::Steps { unit, .. } => add(format!("axis[{i}].stepgen"), "step generator", unit),
                Actuator::Servo { encoder, pwm, .. } => {
                    add(format!("axis[{i}].encoder"), "encoder", encoder);
                    add(format!("axis[{i}].pwm"), "PWM generator", pwm);
                }
            }
        }
        for (i, input) in self.inputs.iter().enumerate() {
            if let InputSource::Encoder { unit, .. } = input.source {
                add(format!("input[{i}].encoder"), "encoder", unit);
            }
        }
        for (i, output) in self.outputs.iter().enumerate() {
            if let OutputTarget::Pwm { unit, .. } = output.target {
                add(format!("output[{i}].pwm"), "PWM generator", unit);
            }
        }
        for (i, spindle) in self.spindles.iter().enumerate() {
            let key = self.spindle_key(i);
            match spindle.speed {
                Some(SpindleSpeed::Pwm { unit, .. }) => add(format!("{key}.pwm"), "PWM generator", unit),
                Some(SpindleSpeed::Remote { remote, .. }) => {
                    add(format!("{key}.remote"), "spindle of [[remote]]", remote);
                }
                None => {}
            }
            if let Some(angle) = spindle.angle {
                add(format!("{key}.encoder"), "encoder", angle.encoder);
            }
        }
        uses
    }

    /// Checks that no two entries of the file have the same unit, and no output the pin of another entry.
    /// Inputs may share a pin, such as a switch that is home and limit, with the same filter.
    pub(crate) fn check_uses(&self, sheet: &ConfigDocument<'_>) -> Result<(), ConfigError> {
        let units = self.unit_uses();
        for (i, unit) in units.iter().enumerate() {
            let is_same = |other: &&UnitUse| (other.what, other.unit) == (unit.what, unit.unit);
            if let Some(other) = units[..i].iter().find(is_same) {
                let what = format!("{} {} already belongs to {}", unit.what, unit.unit, other.key);
                return Err(sheet.error(&unit.key, what, "give each entry its own"));
            }
        }
        let pins = self.pin_uses();
        for (i, pin) in pins.iter().enumerate() {
            for other in pins[..i].iter().filter(|other| is_one_terminal(pin, other)) {
                let key = format!("{}.pin", pin.key);
                if pin.is_driven || other.is_driven {
                    let what = format!("pin {} already belongs to {}", pin.pin.pin, other.key);
                    return Err(sheet.error(&key, what, "give each output a pin that nothing else has"));
                }
                if pin.pin.slow != other.pin.slow {
                    let what = format!("pin {} has another filter at {}", pin.pin.pin, other.key);
                    return Err(sheet.error(&key, what, "give both `slow` or neither"));
                }
            }
        }
        Ok(())
    }
}

/// Whether two uses are of one terminal. Inputs and outputs of a smart-serial device are numbered separately.
fn is_one_terminal(one: &PinUse, other: &PinUse) -> bool {
    let is_same = (one.pin.pin, one.pin.remote) == (other.pin.pin, other.pin.remote);
    is_same && (one.pin.remote.is_none() || one.is_driven == other.is_driven)
}
