//! The machine's inputs, outputs, spindles and emergency-stop chain.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Digital inputs or outputs of a machine at most: numbers 0 to 63.
pub const MAX_DIGITAL: u32 = 64;
/// Analog inputs or outputs of a machine at most: numbers 0 to 15.
pub const MAX_ANALOG: u32 = 16;
/// Spindles of a machine at most: numbers 0 to 3.
pub const MAX_SPINDLES: u32 = 4;

/// On and off, or a number.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum SignalKind {
    /// On or off.
    #[default]
    Digital,
    /// A number.
    Analog,
}

impl SignalKind {
    /// How many of a kind a machine has at most.
    #[must_use]
    pub const fn most(self) -> u32 {
        match self {
            Self::Digital => MAX_DIGITAL,
            Self::Analog => MAX_ANALOG,
        }
    }

    /// The word of the machine file.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Digital => "digital",
            Self::Analog => "analog",
        }
    }
}

/// What an output does when something happens to the machine.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum OutputRule {
    /// It stays as the program has set it.
    #[default]
    Keep,
    /// It takes its safe value.
    Safe,
}

/// One input as it is written.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct InputFile {
    /// Name for messages and commands: letters, digits, - and _, at most 32.
    #[schemars(length(min = 1, max = 32), regex(pattern = "^[A-Za-z0-9][A-Za-z0-9_-]*$"))]
    pub(crate) name: String,
    /// "digital" or "analog"; "digital" where it is not given.
    #[serde(default)]
    pub(crate) kind: SignalKind,
    /// Number by which programs and bridges name it: digital 0 to 63 (M66 P), analog 0 to 15 (M66 E).
    #[schemars(range(min = 0, max = 63))]
    pub(crate) number: i64,
    /// Lowest value of an analog input; a message with a lower one is refused. No bound where it is not given.
    pub(crate) min: Option<f64>,
    /// Highest value of an analog input; a message with a higher one is refused. No bound where it is not given.
    pub(crate) max: Option<f64>,
}

/// One output as it is written.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct OutputFile {
    /// Name for messages and commands: letters, digits, - and _, at most 32.
    #[schemars(length(min = 1, max = 32), regex(pattern = "^[A-Za-z0-9][A-Za-z0-9_-]*$"))]
    pub(crate) name: String,
    /// "digital" or "analog"; "digital" where it is not given.
    #[serde(default)]
    pub(crate) kind: SignalKind,
    /// Number by which programs and bridges name it: digital 0 to 63 (M62 to M65 P), analog 0 to 15 (M67, M68 E).
    #[schemars(range(min = 0, max = 63))]
    pub(crate) number: i64,
    /// Safe state of a digital output; off where it is not given. It has it at the start and in emergency stop, too.
    pub(crate) safe_on: Option<bool>,
    /// Safe value of an analog output; 0 where it is not given. It has it at the start and in emergency stop, too.
    pub(crate) safe_value: Option<f64>,
    /// Lowest value of an analog output; programs that ask for less are refused. No bound where it is not given.
    pub(crate) min: Option<f64>,
    /// Highest value of an analog output; programs that ask for more are refused. No bound where it is not given.
    pub(crate) max: Option<f64>,
    /// "keep" or "safe" while a feed hold has stopped the axes; after it the output is as before. "keep" where it is not given.
    #[serde(default)]
    pub(crate) on_hold: OutputRule,
    /// "keep" or "safe" when a program or MDI is stopped; "keep" where it is not given. After a fault it is always safe.
    #[serde(default)]
    pub(crate) on_stop: OutputRule,
    /// "keep" or "safe" at the end of the program; "keep" where it is not given.
    #[serde(default)]
    pub(crate) on_end: OutputRule,
}

/// One spindle as it is written.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct SpindleFile {
    /// Number by which programs ($) and bridges name it, 0 to 3; 0 where it is not given.
    #[serde(default)]
    #[schemars(range(min = 0, max = 3))]
    pub(crate) number: i64,
    /// Highest speed, rpm: programs that ask for more are refused, and feedback above twice of it, too.
    #[schemars(range(min = 0.001, max = 1e6))]
    pub(crate) max_rpm: f64,
    /// Whether it turns counter-clockwise, too (M4); true where it is not given.
    pub(crate) reverse: Option<bool>,
    /// Whether a bridge measures it (service `spindle`): feed then waits until the speed is reached, and a spindle that is in fault
    /// or falls silent stops the machine. False where it is not given.
    #[serde(default)]
    pub(crate) feedback: bool,
    /// Name of the digital input that is on while the commanded speed is reached, where the spindle has no feedback: feed waits
    /// for it.
    pub(crate) at_speed_input: Option<String>,
    /// How long feed waits for the speed, and M19 without Q for the angle, before the program is stopped, s; 10 where it is not
    /// given.
    #[schemars(range(min = 0.1, max = 600))]
    pub(crate) at_speed_timeout_s: Option<f64>,
    /// By how much its speed changes, rpm per second, when it is braked and turned back: rigid tapping turns it back so much before
    /// the depth, and the tap stops there. Where it is not given it turns back at the depth, and the tap goes on meanwhile.
    #[schemars(range(min = 1, max = 1e7))]
    pub(crate) acceleration_rpm_s: Option<f64>,
}

/// The probe as it is written.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct ProbeFile {
    /// How far the machine may go on after contact, mm: probing at a feed that needs more is refused. No bound where it is not given.
    #[schemars(range(min = 0.0001, max = 1000.0))]
    pub(crate) overtravel_mm: Option<f64>,
}

/// The emergency-stop chain as it is written.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct EstopFile {
    /// Name of the digital input that reads the chain.
    pub(crate) input: String,
    /// State of the input while the chain is closed, so that the machine may run; true where it is not given, so that a broken
    /// wire stops.
    pub(crate) closed: Option<bool>,
}

/// How inputs are watched.
#[derive(Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct SignalsFile {
    /// Inputs whose newest message is older than this are unknown, ms; 100 where it is not given.
    #[schemars(range(min = 1, max = 10000))]
    pub(crate) input_timeout_ms: Option<f64>,
}

/// One input.
#[derive(Clone, Debug, PartialEq)]
pub struct InputSettings {
    /// For messages and commands.
    pub name: String,
    /// Digital or analog.
    pub kind: SignalKind,
    /// Number in programs and on the bus.
    pub number: u32,
    /// Lowest and highest value of an analog input.
    pub range: [f64; 2],
}

/// One output.
#[derive(Clone, Debug, PartialEq)]
pub struct OutputSettings {
    /// For messages and commands.
    pub name: String,
    /// Digital or analog.
    pub kind: SignalKind,
    /// Number in programs and on the bus.
    pub number: u32,
    /// Its value at the start, in emergency stop, and where a rule says so; of a digital output 0 or 1.
    pub safe: f64,
    /// Lowest and highest value of an analog output.
    pub range: [f64; 2],
    /// While a feed hold has stopped the axes.
    pub on_hold: OutputRule,
    /// When a program is stopped.
    pub on_stop: OutputRule,
    /// At the end of the program.
    pub on_end: OutputRule,
}

/// One spindle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpindleSettings {
    /// Number in programs and on the bus.
    pub number: u32,
    /// Highest speed, rpm.
    pub max_rpm: f64,
    /// Whether it turns counter-clockwise, too.
    pub reverse: bool,
    /// What tells that the commanded speed is reached.
    pub at_speed: AtSpeed,
    /// How long is waited for that, s.
    pub at_speed_timeout_s: f64,
    /// By how much its speed changes, rpm per second, where that is known.
    pub acceleration_rpm_s: Option<f64>,
}

/// What tells that a spindle has reached its speed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum AtSpeed {
    /// Nothing: feed begins at once.
    #[default]
    Unknown,
    /// The spindle's feedback, which tells more besides.
    Feedback,
    /// This digital input.
    Input(u32),
}

impl SpindleSettings {
    /// Whether a bridge measures it.
    #[must_use]
    pub fn has_feedback(&self) -> bool {
        self.at_speed == AtSpeed::Feedback
    }
}

/// The emergency-stop chain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EstopSettings {
    /// Number of the digital input.
    pub input: u32,
    /// State of the input while the chain is closed.
    pub closed: bool,
}

/// The probe.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ProbeSettings {
    /// How far the machine may go on after contact, mm; probing that needs more is refused.
    pub overtravel_mm: Option<f64>,
}

/// What the machine has beside its axes.
#[derive(Clone, Debug, PartialEq)]
pub struct SignalSettings {
    /// In the order of the file.
    pub inputs: Vec<InputSettings>,
    /// In the order of the file.
    pub outputs: Vec<OutputSettings>,
    /// In the order of the file.
    pub spindles: Vec<SpindleSettings>,
    /// The emergency-stop chain, where an input reads it.
    pub estop: Option<EstopSettings>,
    /// The probe, where there is one.
    pub probe: Option<ProbeSettings>,
    /// Inputs whose newest message is older than this are unknown, s.
    pub input_timeout_s: f64,
}

impl Default for SignalSettings {
    fn default() -> Self {
        Self {
            inputs: Vec::new(),
            outputs: Vec::new(),
            spindles: Vec::new(),
            estop: None,
            probe: None,
            input_timeout_s: 0.1,
        }
    }
}

impl SignalSettings {
    /// The input of a number.
    #[must_use]
    pub fn input(&self, kind: SignalKind, number: u32) -> Option<&InputSettings> {
        self.inputs
            .iter()
            .find(|input| input.kind == kind && input.number == number)
    }

    /// The output of a number.
    #[must_use]
    pub fn output(&self, kind: SignalKind, number: u32) -> Option<&OutputSettings> {
        self.outputs
            .iter()
            .find(|output| output.kind == kind && output.number == number)
    }

    /// The spindle of a number.
    #[must_use]
    pub fn spindle(&self, number: u32) -> Option<&SpindleSettings> {
        self.spindles.iter().find(|spindle| spindle.number == number)
    }

    /// Whether the machine has anything beside its axes.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.inputs.is_empty() && self.outputs.is_empty() && self.spindles.is_empty() && self.probe.is_none()
    }
}
