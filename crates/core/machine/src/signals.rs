//! The machine's inputs, outputs, spindles and emergency-stop chain.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Maximum number of digital inputs, and of digital outputs: numbers 0 to 63.
pub const MAX_DIGITAL: u32 = 64;
/// Maximum number of analog inputs, and of analog outputs: numbers 0 to 15.
pub const MAX_ANALOG: u32 = 16;
/// Maximum number of spindles: numbers 0 to 3.
pub const MAX_SPINDLES: u32 = 4;

/// Digital or analog.
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
    /// Maximum number of signals of this kind.
    #[must_use]
    pub const fn max(self) -> u32 {
        match self {
            Self::Digital => MAX_DIGITAL,
            Self::Analog => MAX_ANALOG,
        }
    }

    /// Its name in the machine file.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Digital => "digital",
            Self::Analog => "analog",
        }
    }
}

/// The reaction of an output to an event.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum OutputRule {
    /// It keeps the value set by the program.
    #[default]
    Keep,
    /// It takes its safe value.
    Safe,
}

/// One input as written.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct InputFile {
    /// Name for messages and commands: letters, digits, - and _, at most 32.
    #[schemars(length(min = 1, max = 32), regex(pattern = "^[A-Za-z0-9][A-Za-z0-9_-]*$"))]
    pub(crate) name: String,
    /// "digital" or "analog". Default: "digital".
    #[serde(default)]
    pub(crate) kind: SignalKind,
    /// Number used by programs and bridges: digital 0 to 63 (M66 P), analog 0 to 15 (M66 E).
    #[schemars(range(min = 0, max = 63))]
    pub(crate) number: i64,
    /// Minimum value of an analog input; messages with a lower value are rejected. Default: no limit.
    pub(crate) min: Option<f64>,
    /// Maximum value of an analog input; messages with a higher value are rejected. Default: no limit.
    pub(crate) max: Option<f64>,
}

/// One output as written.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct OutputFile {
    /// Name for messages and commands: letters, digits, - and _, at most 32.
    #[schemars(length(min = 1, max = 32), regex(pattern = "^[A-Za-z0-9][A-Za-z0-9_-]*$"))]
    pub(crate) name: String,
    /// "digital" or "analog". Default: "digital".
    #[serde(default)]
    pub(crate) kind: SignalKind,
    /// Number used by programs and bridges: digital 0 to 63 (M62 to M65 P), analog 0 to 15 (M67, M68 E).
    #[schemars(range(min = 0, max = 63))]
    pub(crate) number: i64,
    /// Safe state of a digital output, also its state at the start and in emergency stop. Default: off.
    pub(crate) safe_on: Option<bool>,
    /// Safe value of an analog output, also its value at the start and in emergency stop. Default: 0.
    pub(crate) safe_value: Option<f64>,
    /// Minimum value of an analog output; programs that set a lower one are rejected. Default: no limit.
    pub(crate) min: Option<f64>,
    /// Maximum value of an analog output; programs that set a higher one are rejected. Default: no limit.
    pub(crate) max: Option<f64>,
    /// "keep" or "safe" while a feed hold has stopped the axes; the output is restored afterwards. Default: "keep".
    #[serde(default)]
    pub(crate) on_hold: OutputRule,
    /// "keep" or "safe" when a program or MDI command is stopped. Default: "keep"; after a fault always safe.
    #[serde(default)]
    pub(crate) on_stop: OutputRule,
    /// "keep" or "safe" at the end of the program. Default: "keep".
    #[serde(default)]
    pub(crate) on_end: OutputRule,
}

/// One spindle as written.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct SpindleFile {
    /// Number used by programs ($) and bridges, 0 to 3. Default: 0.
    #[serde(default)]
    #[schemars(range(min = 0, max = 3))]
    pub(crate) number: i64,
    /// Maximum speed, rpm: programs that command more are rejected, as is feedback above twice this speed.
    #[schemars(range(min = 0.001, max = 1e6))]
    pub(crate) max_rpm: f64,
    /// Whether it can also turn counter-clockwise (M4). Default: true.
    pub(crate) reverse: Option<bool>,
    /// Whether a bridge measures it (service `spindle`): feed then waits until the speed is reached, and a fault or missing
    /// feedback of the spindle stops the machine. Default: false.
    #[serde(default)]
    pub(crate) feedback: bool,
    /// Name of the digital input that is on while the commanded speed is reached, for a spindle without feedback: feed waits for
    /// it.
    pub(crate) at_speed_input: Option<String>,
    /// Time limit for the speed, and for the angle of M19 without Q, after which the program stops, s. Default: 10.
    #[schemars(range(min = 0.1, max = 600))]
    pub(crate) at_speed_timeout_s: Option<f64>,
    /// Rate of change of the speed when braking and reversing, rpm per second: rigid tapping then starts the reversal early, so
    /// that the tap stops at the depth. Default: none, the reversal starts at the depth and the tap overshoots.
    #[schemars(range(min = 1, max = 1e7))]
    pub(crate) acceleration_rpm_s: Option<f64>,
    /// Maximum rate of change of the commanded speed, rpm per second, for a drive without a ramp of its own. Default: none, the
    /// command changes at once.
    #[schemars(range(min = 1, max = 1e7))]
    pub(crate) ramp_rpm_s: Option<f64>,
}

/// The probe as written.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct ProbeFile {
    /// Permitted travel after contact, mm: probing at a feed that needs more is rejected. Default: no limit.
    #[schemars(range(min = 0.0001, max = 1000.0))]
    pub(crate) overtravel_mm: Option<f64>,
}

/// The emergency-stop chain as written.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct EstopFile {
    /// Name of the digital input that reads the chain.
    pub(crate) input: String,
    /// State of the input while the chain is closed and the machine may run. Default: true, so that a broken wire stops the
    /// machine.
    pub(crate) closed: Option<bool>,
}

/// Monitoring of the inputs.
#[derive(Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct SignalsFile {
    /// Age of the newest message after which inputs count as unknown, ms. Default: 100.
    #[schemars(range(min = 1, max = 10000))]
    pub(crate) input_timeout_ms: Option<f64>,
}

/// One input.
#[derive(Clone, Debug, PartialEq)]
pub struct InputSettings {
    /// Name in messages and commands.
    pub name: String,
    /// Digital or analog.
    pub kind: SignalKind,
    /// Number in programs and on the bus.
    pub number: u32,
    /// Minimum and maximum value of an analog input.
    pub range: [f64; 2],
}

/// One output.
#[derive(Clone, Debug, PartialEq)]
pub struct OutputSettings {
    /// Name in messages and commands.
    pub name: String,
    /// Digital or analog.
    pub kind: SignalKind,
    /// Number in programs and on the bus.
    pub number: u32,
    /// Value at the start, in emergency stop, and where a rule demands it; 0 or 1 for a digital output.
    pub safe: f64,
    /// Minimum and maximum value of an analog output.
    pub range: [f64; 2],
    /// Reaction to a feed hold that has stopped the axes.
    pub on_hold: OutputRule,
    /// Reaction to a stop of the program.
    pub on_stop: OutputRule,
    /// Reaction to the end of the program.
    pub on_end: OutputRule,
}

/// One spindle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpindleSettings {
    /// Number in programs and on the bus.
    pub number: u32,
    /// Maximum speed, rpm.
    pub max_rpm: f64,
    /// Whether it can also turn counter-clockwise.
    pub reverse: bool,
    /// How the core detects that the commanded speed is reached.
    pub at_speed: AtSpeed,
    /// Time limit for that, s.
    pub at_speed_timeout_s: f64,
    /// Rate of change of the speed, rpm per second, if known.
    pub acceleration_rpm_s: Option<f64>,
    /// Maximum rate of change of the commanded speed, rpm per second; `None` if it changes at once.
    pub ramp_rpm_s: Option<f64>,
}

/// How the core detects that a spindle has reached its speed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum AtSpeed {
    /// Not at all: feed starts at once.
    #[default]
    Unknown,
    /// By the feedback of the spindle.
    Feedback,
    /// By this digital input.
    Input(u32),
}

impl SpindleSettings {
    /// Whether a bridge measures it.
    #[must_use]
    pub fn has_feedback(&self) -> bool {
        self.at_speed == AtSpeed::Feedback
    }

    /// Rate at which it brakes and reverses, rpm per second, if known: the smaller of the spindle's own rate
    /// and that of its command.
    #[must_use]
    pub fn braking_rpm_s(&self) -> Option<f64> {
        let rates = [self.acceleration_rpm_s, self.ramp_rpm_s].into_iter().flatten();
        rates.reduce(f64::min)
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
    /// Permitted travel after contact, mm; probing that needs more is rejected.
    pub overtravel_mm: Option<f64>,
}

/// Everything on the machine besides its axes.
#[derive(Clone, Debug, PartialEq)]
pub struct SignalSettings {
    /// In the order of the file.
    pub inputs: Vec<InputSettings>,
    /// In the order of the file.
    pub outputs: Vec<OutputSettings>,
    /// In the order of the file.
    pub spindles: Vec<SpindleSettings>,
    /// The emergency-stop chain, if an input reads it.
    pub estop: Option<EstopSettings>,
    /// The probe, if there is one.
    pub probe: Option<ProbeSettings>,
    /// Age of the newest message after which inputs count as unknown, s.
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
    /// The input of this kind and number.
    #[must_use]
    pub fn input(&self, kind: SignalKind, number: u32) -> Option<&InputSettings> {
        self.inputs
            .iter()
            .find(|input| input.kind == kind && input.number == number)
    }

    /// The output of this kind and number.
    #[must_use]
    pub fn output(&self, kind: SignalKind, number: u32) -> Option<&OutputSettings> {
        self.outputs
            .iter()
            .find(|output| output.kind == kind && output.number == number)
    }

    /// The spindle with this number.
    #[must_use]
    pub fn spindle(&self, number: u32) -> Option<&SpindleSettings> {
        self.spindles.iter().find(|spindle| spindle.number == number)
    }

    /// Bit i set: the machine has spindle i. A file without spindles has number 0.
    #[must_use]
    pub fn spindle_mask(&self) -> u32 {
        if self.spindles.is_empty() {
            return 1;
        }
        self.spindles
            .iter()
            .fold(0, |mask, spindle| mask | 1 << spindle.number)
    }

    /// Maximum speed of each spindle, rpm; infinite where it is unknown.
    #[must_use]
    pub fn max_rpm(&self) -> [f64; MAX_SPINDLES as usize] {
        std::array::from_fn(|number| {
            self.spindle(number as u32)
                .map_or(f64::INFINITY, |spindle| spindle.max_rpm)
        })
    }

    /// Whether there is nothing besides the axes.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.inputs.is_empty() && self.outputs.is_empty() && self.spindles.is_empty() && self.probe.is_none()
    }
}
