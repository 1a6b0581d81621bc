//! The machine file as it is written: keys with their units, before any check of the numbers.
//!
//! The JSON schema is made from these types, so their doc comments are what an editor shows to the person who writes a
//! machine file.

use std::fmt;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::{Error, Visitor};
use serde::{Deserialize, Deserializer};
use serde_json::json;

use crate::corrections::{SquarenessFile, TableFormat, TableUnit};
use crate::handwheel::HandwheelFile;
use crate::homing::HomingFile;
use crate::machine::{
    ControlRate, CycleRecording, FeedbackWish, Kinematics, MAX_RATE_HZ, MIN_RATE_HZ, MachineKind, Magazine,
    OnFull, PathMode, PlannerKind, ToolChange, TurningWords, WithoutToolTable,
};
use crate::signals::{EstopFile, InputFile, OutputFile, ProbeFile, SignalsFile, SpindleFile};

/// A machine as Evolvent controls it: axes, limits, and how the control loop runs.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(title = "Evolvent machine file")]
pub(crate) struct MachineFile {
    /// Name in services and file names: letters, digits, - and _, at most 64.
    #[schemars(length(min = 1, max = 64), regex(pattern = "^[A-Za-z0-9][A-Za-z0-9_-]*$"))]
    pub(crate) name: String,
    /// One line for people.
    #[serde(default)]
    pub(crate) description: String,
    /// "mill" or "lathe".
    pub(crate) kind: MachineKind,
    /// "trivial": each letter of the program drives the axis of that letter.
    #[serde(default)]
    pub(crate) kinematics: Kinematics,
    /// Position increments per millimetre of a linear axis: 1000 is a grid of 1 um.
    #[schemars(range(min = 0.001, max = 1e9))]
    pub(crate) increments_per_mm: f64,
    /// Position increments per degree of a rotary axis; needed where there is one.
    #[schemars(range(min = 0.001, max = 1e9))]
    pub(crate) increments_per_degree: Option<f64>,
    /// Control rate: "rational" (what the machine's limits need) or a number of Hz, 250 to 35000.
    #[serde(default)]
    pub(crate) rate: RateWord,
    /// How many cycles ahead of its due time a setpoint is computed, 1 to 1000. Give this or lead_ms; without either it
    /// is 2 ms in whole cycles, at least 2 cycles.
    #[schemars(range(min = 1, max = 1000))]
    pub(crate) lead_cycles: Option<i64>,
    /// How long ahead of its due time a setpoint is computed, ms: 0.03 to 28; rounded up to whole cycles.
    #[schemars(range(min = 0.03, max = 28.0))]
    pub(crate) lead_ms: Option<f64>,
    /// One entry for each axis, in the order in which positions are reported.
    #[schemars(length(min = 1, max = 9))]
    pub(crate) axis: Vec<AxisFile>,
    /// Limits of the machine as a whole.
    #[serde(default)]
    pub(crate) limits: LimitsFile,
    /// How the path is followed.
    #[serde(default)]
    pub(crate) path: PathFile,
    /// How the control loop runs on this computer.
    #[serde(default)]
    pub(crate) realtime: RealtimeFile,
    /// The recorder.
    #[serde(default)]
    pub(crate) trace: TraceFile,
    /// How the drives are watched.
    #[serde(default)]
    pub(crate) drives: DrivesFile,
    /// What programs find on this machine.
    #[serde(default)]
    pub(crate) program: ProgramFile,
    /// Axes that are homed by a switch.
    #[serde(default)]
    pub(crate) homing: Vec<HomingFile>,
    /// Digital and analog inputs.
    #[serde(default)]
    pub(crate) input: Vec<InputFile>,
    /// Digital and analog outputs.
    #[serde(default)]
    pub(crate) output: Vec<OutputFile>,
    /// Spindles, at most 4.
    #[serde(default)]
    #[schemars(length(max = 4))]
    pub(crate) spindle: Vec<SpindleFile>,
    /// The emergency-stop chain, where an input reads it.
    pub(crate) estop: Option<EstopFile>,
    /// The probe, where there is one.
    pub(crate) probe: Option<ProbeFile>,
    /// The handwheel, where there is one.
    pub(crate) handwheel: Option<HandwheelFile>,
    /// How inputs are watched.
    #[serde(default)]
    pub(crate) signals: SignalsFile,
    /// How far X, Y and Z are off their right angles.
    #[serde(default)]
    pub(crate) squareness: SquarenessFile,
}

/// One axis: linear (X Y Z U V W) with keys in mm, or rotary (A B C) with keys in degrees.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(extend("oneOf" = axis_alternatives()))]
pub(crate) struct AxisFile {
    /// X, Y, Z, A, B, C, U, V or W.
    #[schemars(regex(pattern = "^[XYZABCUVWxyzabcuvw]$"))]
    pub(crate) letter: String,
    /// "linear" or "rotary"; follows from the letter where it is not given.
    pub(crate) kind: Option<AxisKind>,
    /// Lowest position of a linear axis, mm.
    pub(crate) travel_min_mm: Option<f64>,
    /// Highest position of a linear axis, mm.
    pub(crate) travel_max_mm: Option<f64>,
    /// Lowest position of a rotary axis, degrees.
    pub(crate) travel_min_deg: Option<f64>,
    /// Highest position of a rotary axis, degrees.
    pub(crate) travel_max_deg: Option<f64>,
    /// Largest velocity, mm/min.
    pub(crate) max_velocity_mm_min: Option<f64>,
    /// Largest velocity, mm/s.
    pub(crate) max_velocity_mm_s: Option<f64>,
    /// Largest velocity, degrees/min.
    pub(crate) max_velocity_deg_min: Option<f64>,
    /// Largest velocity, degrees/s.
    pub(crate) max_velocity_deg_s: Option<f64>,
    /// Largest acceleration, mm/s2.
    pub(crate) max_acceleration_mm_s2: Option<f64>,
    /// Largest acceleration, m/s2.
    pub(crate) max_acceleration_m_s2: Option<f64>,
    /// Largest acceleration in multiples of 9.81 m/s2.
    pub(crate) max_acceleration_g: Option<f64>,
    /// Largest acceleration, degrees/s2.
    pub(crate) max_acceleration_deg_s2: Option<f64>,
    /// Largest jerk, mm/s3.
    pub(crate) max_jerk_mm_s3: Option<f64>,
    /// Largest jerk, m/s3.
    pub(crate) max_jerk_m_s3: Option<f64>,
    /// Largest jerk, degrees/s3.
    pub(crate) max_jerk_deg_s3: Option<f64>,
    /// Position of a linear axis after homing, mm; 0 where it is not given.
    pub(crate) home_mm: Option<f64>,
    /// Position of a rotary axis after homing, degrees; 0 where it is not given.
    pub(crate) home_deg: Option<f64>,
    /// Following error that is allowed at rest, mm; 0.5 where it is not given.
    pub(crate) following_error_mm: Option<f64>,
    /// Following error that is allowed at rest, degrees; 0.5 where it is not given.
    pub(crate) following_error_deg: Option<f64>,
    /// Following error that is allowed in motion, as the time in which the axis travels it, ms; 20 where it is not given.
    pub(crate) following_time_ms: Option<f64>,
    /// Lost motion of a linear axis at reversal, mm; 0 where it is not given.
    #[schemars(range(min = 0, max = 10))]
    pub(crate) backlash_mm: Option<f64>,
    /// Lost motion of a rotary axis at reversal, degrees; 0 where it is not given.
    #[schemars(range(min = 0, max = 10))]
    pub(crate) backlash_deg: Option<f64>,
    /// File of the screw's errors, relative to the folder of the machine file.
    pub(crate) screw_table: Option<String>,
    /// How that file is written; by the ending .csv or .json where it is not given.
    pub(crate) screw_table_format: Option<TableFormat>,
    /// Unit of the numbers in a file of LinuxCNC; "mm" where it is not given.
    pub(crate) screw_table_unit: Option<TableUnit>,
    /// Name of the analog input that gives how far a linear axis is to be shifted for its thermal growth, mm.
    pub(crate) thermal_input: Option<String>,
    /// Largest shift, mm; 0.1 where it is not given.
    #[schemars(range(min = 0, max = 10))]
    pub(crate) thermal_max_mm: Option<f64>,
    /// How fast the shift is followed, um/s; 1 where it is not given.
    #[schemars(range(min = 0.001, max = 1000))]
    pub(crate) thermal_rate_um_s: Option<f64>,
}

/// Either the linear keys, each limit with exactly one unit, or the rotary ones.
fn axis_alternatives() -> serde_json::Value {
    let exactly_one = |keys: &[&str]| {
        let one: Vec<_> = keys.iter().map(|key| json!({ "required": [key] })).collect();
        json!({ "oneOf": one })
    };
    let none_of = |keys: &[&str]| {
        let any: Vec<_> = keys.iter().map(|key| json!({ "required": [key] })).collect();
        json!({ "not": { "anyOf": any } })
    };
    json!([
        {
            "title": "linear axis",
            "properties": {
                "letter": { "pattern": "^[XYZUVWxyzuvw]$" },
                "kind": { "enum": ["linear"] },
            },
            "required": ["travel_min_mm", "travel_max_mm"],
            "allOf": [
                exactly_one(&["max_velocity_mm_min", "max_velocity_mm_s"]),
                exactly_one(&["max_acceleration_mm_s2", "max_acceleration_m_s2", "max_acceleration_g"]),
                exactly_one(&["max_jerk_mm_s3", "max_jerk_m_s3"]),
                none_of(&[
                    "travel_min_deg", "travel_max_deg", "max_velocity_deg_min", "max_velocity_deg_s",
                    "max_acceleration_deg_s2", "max_jerk_deg_s3", "home_deg", "following_error_deg",
                    "backlash_deg",
                ]),
            ],
        },
        {
            "title": "rotary axis",
            "properties": {
                "letter": { "pattern": "^[ABCabc]$" },
                "kind": { "enum": ["rotary"] },
            },
            "required": ["travel_min_deg", "travel_max_deg", "max_acceleration_deg_s2", "max_jerk_deg_s3"],
            "allOf": [
                exactly_one(&["max_velocity_deg_min", "max_velocity_deg_s"]),
                none_of(&[
                    "travel_min_mm", "travel_max_mm", "max_velocity_mm_min", "max_velocity_mm_s",
                    "max_acceleration_mm_s2", "max_acceleration_m_s2", "max_acceleration_g",
                    "max_jerk_mm_s3", "max_jerk_m_s3", "home_mm", "following_error_mm", "backlash_mm",
                    "screw_table_unit", "thermal_input", "thermal_max_mm", "thermal_rate_um_s",
                ]),
            ],
        },
    ])
}

/// Linear or rotary.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub(crate) enum AxisKind {
    /// Moves along a line; mm.
    Linear,
    /// Turns; degrees.
    Rotary,
}

/// Limits of the machine as a whole.
#[derive(Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct LimitsFile {
    /// Largest contour feed, mm/min, where it is below what the axes allow.
    pub(crate) max_feed_mm_min: Option<f64>,
    /// Largest contour feed, mm/s; instead of max_feed_mm_min.
    pub(crate) max_feed_mm_s: Option<f64>,
}

/// How the path is followed.
#[derive(Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct PathFile {
    /// "blend" (as G64) or "exact" (as G61) until the program says otherwise; "blend" where it is not given.
    #[serde(default)]
    pub(crate) mode: PathMode,
    /// "optimal" (smooth and as fast as the axes allow) or "classic" (blends and look-ahead); "optimal" where it is not
    /// given.
    #[serde(default)]
    pub(crate) planner: PlannerKind,
    /// How far a blend may leave the programmed path, mm; 0.01 where it is not given.
    #[schemars(range(min = 0, max = 100))]
    pub(crate) blend_tolerance_mm: Option<f64>,
    /// In exact-path mode a step of curvature may step the acceleration by jerk times this time, ms; 1 where it is not
    /// given.
    pub(crate) joint_time_ms: Option<f64>,
    /// Permitted chord error between two setpoints, increments; 1 where it is not given.
    pub(crate) chord_error_increments: Option<f64>,
    /// Smallest radius of curvature that the rational control rate allows for, mm; 0.25 where it is not given.
    pub(crate) min_radius_mm: Option<f64>,
    /// An arc whose radii at start and end differ by more than this may be wrong, mm; 0.0283 where it is not given.
    pub(crate) arc_radius_tolerance_mm: Option<f64>,
    /// ... and is wrong if they also differ by more than this part of the radius; 0.001 where it is not given.
    pub(crate) arc_radius_tolerance_ratio: Option<f64>,
    /// How far the end point of an involute may lie off the curve, mm; one increment, at least 0.001, where it is not
    /// given.
    pub(crate) involute_end_tolerance_mm: Option<f64>,
}

/// What programs find on this machine. Paths are relative to the machine file's folder.
#[derive(Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct ProgramFile {
    /// Tool table in LinuxCNC's format, lengths in mm; none where it is not given.
    pub(crate) tool_table: Option<String>,
    /// What G43 H, G41 and G42 find where there is no tool table: "error", or "zero" for offsets and diameters of 0; "error"
    /// where it is not given.
    #[serde(default)]
    pub(crate) without_tool_table: WithoutToolTable,
    /// How M6 puts another tool into the spindle: "operator" stops and asks, "program" runs the executable M6 of
    /// user_code_folder, "subroutine" calls tool_change_subroutine, "none" changes nothing and goes on; "operator" where it is
    /// not given.
    #[serde(default)]
    pub(crate) tool_change: ToolChange,
    /// Name of the subroutine that changes tools, NAME.ngc in a folder of subroutines; "toolchange" where it is not given.
    pub(crate) tool_change_subroutine: Option<String>,
    /// Where its changer puts the tool that it takes out of the spindle: "fixed" into its own pocket, "random" into the pocket of
    /// the tool that it fetches; "fixed" where it is not given.
    #[serde(default)]
    pub(crate) magazine: Magazine,
    /// File of the parameters that are kept from run to run, in LinuxCNC's format; nothing is kept where it is not given.
    pub(crate) parameters: Option<String>,
    /// Folder of the files that programs write by LOGOPEN, LOGAPPEND and PROBEOPEN; "logs" in the state folder where it is not
    /// given.
    pub(crate) log_folder: Option<String>,
    /// Folders in which subroutines NAME.ngc are looked for, after the program's own.
    #[serde(default)]
    pub(crate) subroutines: Vec<String>,
    /// Which of M100 to M199 this machine knows, for example [101, 150]; none where it is not given.
    #[serde(default)]
    pub(crate) user_codes: Vec<i64>,
    /// Folder of their programs, called M100 to M199, and of M6; the machine file's own where it is not given.
    pub(crate) user_code_folder: Option<String>,
    /// How long one of them may take, s; 10 where it is not given.
    #[schemars(range(min = 0.1, max = 86400))]
    pub(crate) user_code_timeout_s: Option<f64>,
    /// What X, R and U of the turning cycles G82 and G75 of a lathe are: "diameter", "radius", or "mode" for what G7 and G8
    /// say; "diameter" where it is not given.
    #[serde(default)]
    pub(crate) turning_cycles: TurningWords,
    /// Whether a cutting load is measured, so that G82 Q1 and G75 Q1 may find their passes themselves; false where it is not
    /// given.
    #[serde(default)]
    pub(crate) load_channel: bool,
}

/// How the control loop runs on this computer.
#[derive(Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct RealtimeFile {
    /// SCHED_FIFO priority of the cycle, 2 to 98; 80 where it is not given.
    #[schemars(range(min = 2, max = 98))]
    pub(crate) priority: Option<i64>,
    /// Processor core to which the cycle is pinned; none where it is not given.
    #[schemars(range(min = 0, max = 4095))]
    pub(crate) core: Option<i64>,
    /// Lock all memory; true where it is not given.
    pub(crate) lock_memory: Option<bool>,
    /// Stop after this many late setpoints in a row, 0 for never; those of one second, at least 1000, where it is not
    /// given.
    #[schemars(range(min = 0, max = 1000000))]
    pub(crate) max_late_cycles: Option<i64>,
}

/// The recorder.
#[derive(Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct TraceFile {
    /// When the disk is full: "continue" without a trace, or "stop" the machine on the path.
    #[serde(default)]
    pub(crate) on_full: OnFull,
    /// How the cycles are held: "messages", one a cycle, or "columns", exact in a quarter of the room, with messages at most
    /// 2000 times a second for viewers. "messages" where it is not given.
    #[serde(default)]
    pub(crate) cycles: CycleRecording,
}

/// How the drives are watched.
#[derive(Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct DrivesFile {
    /// "if_present": a bridge that has answered once must go on answering while power is on; "required": no power without
    /// a bridge; "ignore": what comes back is not looked at. "if_present" where it is not given.
    #[serde(default)]
    pub(crate) feedback: FeedbackWish,
    /// Stop when the newest feedback is older than this, ms; 20 where it is not given.
    #[schemars(range(min = 1, max = 1000))]
    pub(crate) feedback_timeout_ms: Option<f64>,
    /// How long the drives may take to come into operation, ms; 2000 where it is not given.
    #[schemars(range(min = 10, max = 60000))]
    pub(crate) enable_timeout_ms: Option<f64>,
    /// Whether the cycle follows the clock of the drives, by at most 0.1 % of its period; true where it is not given.
    pub(crate) follow_clock: Option<bool>,
}

/// `"rational"` or a number of Hz.
#[derive(Debug, Default)]
pub(crate) struct RateWord(pub(crate) ControlRate);

impl<'de> Deserialize<'de> for RateWord {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Word;
        impl Visitor<'_> for Word {
            type Value = RateWord;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("\"rational\" or a number of Hz")
            }
            fn visit_str<E: Error>(self, word: &str) -> Result<RateWord, E> {
                if word == "rational" {
                    Ok(RateWord(ControlRate::Rational))
                } else {
                    Err(E::invalid_value(serde::de::Unexpected::Str(word), &self))
                }
            }
            fn visit_f64<E: Error>(self, hz: f64) -> Result<RateWord, E> {
                Ok(RateWord(ControlRate::Hz(hz)))
            }
            fn visit_i64<E: Error>(self, hz: i64) -> Result<RateWord, E> {
                Ok(RateWord(ControlRate::Hz(hz as f64)))
            }
            fn visit_u64<E: Error>(self, hz: u64) -> Result<RateWord, E> {
                Ok(RateWord(ControlRate::Hz(hz as f64)))
            }
        }
        deserializer.deserialize_any(Word)
    }
}

impl JsonSchema for RateWord {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "Rate".into()
    }
    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "anyOf": [
                { "const": "rational" },
                { "type": "number", "minimum": MIN_RATE_HZ, "maximum": MAX_RATE_HZ },
            ]
        })
    }
}

/// The JSON schema of the machine file, as `config/machine.schema.json` ships it: editors complete and check with it.
#[must_use]
pub fn machine_schema() -> serde_json::Value {
    schemars::schema_for!(MachineFile).to_value()
}
