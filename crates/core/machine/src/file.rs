//! The machine file as written: keys with their units, before the numbers are checked.
//!
//! The JSON schema is generated from these types. Their doc comments are what an editor shows to the author of a machine
//! file.

use std::fmt;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::{Error, Visitor};
use serde::{Deserialize, Deserializer};
use serde_json::json;

use crate::corrections::{SquarenessFile, TableFormat, TableUnit};
use crate::handwheel::HandwheelFile;
use crate::homing::HomingFile;
use crate::machine::{
    ControlRate, CycleRecording, FeedbackMode, Kinematics, LengthUnit, MAX_RATE_HZ, MIN_RATE_HZ, MachineKind,
    Magazine, OnFull, PathMode, PlannerKind, RotaryDirection, StartPlane, StartX, ToolChange, TurningWords,
    WithoutToolTable,
};
use crate::signals::{EstopFile, InputFile, OutputFile, ProbeFile, SignalsFile, SpindleFile};

/// A machine: its axes, its limits, and how the control loop runs.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(title = "Evolvent machine file")]
pub(crate) struct MachineFile {
    /// Name in services and file names: letters, digits, - and _, at most 64.
    #[schemars(length(min = 1, max = 64), regex(pattern = "^[A-Za-z0-9][A-Za-z0-9_-]*$"))]
    pub(crate) name: String,
    /// Description, one line.
    #[serde(default)]
    pub(crate) description: String,
    /// "mill" or "lathe".
    pub(crate) kind: MachineKind,
    /// "trivial": each letter of the program drives the axis with that letter.
    #[serde(default)]
    pub(crate) kinematics: Kinematics,
    /// Position increments per millimetre of a linear axis; 1000 is a grid of 1 um.
    #[schemars(range(min = 0.001, max = 1e9))]
    pub(crate) increments_per_mm: f64,
    /// Position increments per degree of a rotary axis; required if there is one.
    #[schemars(range(min = 0.001, max = 1e9))]
    pub(crate) increments_per_degree: Option<f64>,
    /// Control rate: "rational" (the rate that the machine's limits require) or a number in Hz, 250 to 35000.
    #[serde(default)]
    pub(crate) rate: RateWord,
    /// Number of cycles between the computation of a setpoint and its due time, 1 to 1000. Excludes lead_ms. Default: 2 ms in
    /// whole cycles, at least 2 cycles.
    #[schemars(range(min = 1, max = 1000))]
    pub(crate) lead_cycles: Option<i64>,
    /// Time between the computation of a setpoint and its due time, ms: 0.03 to 28, rounded up to whole cycles.
    #[schemars(range(min = 0.03, max = 28.0))]
    pub(crate) lead_ms: Option<f64>,
    /// One entry per axis, in the order in which positions are reported.
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
    /// Trace recording.
    #[serde(default)]
    pub(crate) trace: TraceFile,
    /// Monitoring of the drives.
    #[serde(default)]
    pub(crate) drives: DrivesFile,
    /// Resources for programs on this machine.
    #[serde(default)]
    pub(crate) program: ProgramFile,
    /// Axes that are homed to a switch.
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
    /// The emergency-stop chain, if an input reads it.
    pub(crate) estop: Option<EstopFile>,
    /// The probe, if there is one.
    pub(crate) probe: Option<ProbeFile>,
    /// The handwheel, if there is one.
    pub(crate) handwheel: Option<HandwheelFile>,
    /// Monitoring of the inputs.
    #[serde(default)]
    pub(crate) signals: SignalsFile,
    /// Squareness errors of X, Y and Z.
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
    /// "linear" or "rotary". Default: determined by the letter.
    pub(crate) kind: Option<AxisKind>,
    /// Minimum position of a linear axis, mm.
    pub(crate) travel_min_mm: Option<f64>,
    /// Maximum position of a linear axis, mm.
    pub(crate) travel_max_mm: Option<f64>,
    /// An unlimited rotary axis, instead of a travel: how G90 goes to an angle on it, "shorter" or "sign".
    pub(crate) unlimited: Option<RotaryDirection>,
    /// Minimum position of a rotary axis, degrees.
    pub(crate) travel_min_deg: Option<f64>,
    /// Maximum position of a rotary axis, degrees.
    pub(crate) travel_max_deg: Option<f64>,
    /// Maximum velocity, mm/min.
    pub(crate) max_velocity_mm_min: Option<f64>,
    /// Maximum velocity, mm/s.
    pub(crate) max_velocity_mm_s: Option<f64>,
    /// Maximum velocity, degrees/min.
    pub(crate) max_velocity_deg_min: Option<f64>,
    /// Maximum velocity, degrees/s.
    pub(crate) max_velocity_deg_s: Option<f64>,
    /// Maximum acceleration, mm/s2.
    pub(crate) max_acceleration_mm_s2: Option<f64>,
    /// Maximum acceleration, m/s2.
    pub(crate) max_acceleration_m_s2: Option<f64>,
    /// Maximum acceleration in multiples of 9.81 m/s2.
    pub(crate) max_acceleration_g: Option<f64>,
    /// Maximum acceleration, degrees/s2.
    pub(crate) max_acceleration_deg_s2: Option<f64>,
    /// Maximum jerk, mm/s3.
    pub(crate) max_jerk_mm_s3: Option<f64>,
    /// Maximum jerk, m/s3.
    pub(crate) max_jerk_m_s3: Option<f64>,
    /// Maximum jerk, degrees/s3.
    pub(crate) max_jerk_deg_s3: Option<f64>,
    /// Position of a linear axis after homing, mm. Default: 0.
    pub(crate) home_mm: Option<f64>,
    /// Position of a rotary axis after homing, degrees. Default: 0.
    pub(crate) home_deg: Option<f64>,
    /// Permitted following error at rest, mm. Default: 0.5.
    pub(crate) following_error_mm: Option<f64>,
    /// Permitted following error at rest, degrees. Default: 0.5.
    pub(crate) following_error_deg: Option<f64>,
    /// Permitted following error in motion, as the time in which the axis travels it, ms. Default: 20.
    pub(crate) following_time_ms: Option<f64>,
    /// Backlash (lost motion at reversal) of a linear axis, mm. Default: 0.
    #[schemars(range(min = 0, max = 10))]
    pub(crate) backlash_mm: Option<f64>,
    /// Backlash (lost motion at reversal) of a rotary axis, degrees. Default: 0.
    #[schemars(range(min = 0, max = 10))]
    pub(crate) backlash_deg: Option<f64>,
    /// File of the screw errors, relative to the folder of the machine file.
    pub(crate) screw_table: Option<String>,
    /// Format of that file. Default: determined by the ending .csv or .json.
    pub(crate) screw_table_format: Option<TableFormat>,
    /// Unit of the numbers in a LinuxCNC file. Default: "mm".
    pub(crate) screw_table_unit: Option<TableUnit>,
    /// Name of the analog input that supplies the thermal offset of a linear axis, mm.
    pub(crate) thermal_input: Option<String>,
    /// Maximum thermal offset, mm. Default: 0.1.
    #[schemars(range(min = 0, max = 10))]
    pub(crate) thermal_max_mm: Option<f64>,
    /// Maximum rate of change of the thermal offset, um/s. Default: 1.
    #[schemars(range(min = 0.001, max = 1000))]
    pub(crate) thermal_rate_um_s: Option<f64>,
}

/// Either the linear keys, each limit in exactly one unit, or the rotary ones.
fn axis_alternatives() -> serde_json::Value {
    let exactly_one = |keys: &[&str]| {
        let one: Vec<_> = keys.iter().map(|key| json!({ "required": [key] })).collect();
        json!({ "oneOf": one })
    };
    let rotary_limits = |keys: &[&str]| {
        let mut required = vec!["max_acceleration_deg_s2", "max_jerk_deg_s3"];
        required.extend(keys);
        json!(required)
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
                    "backlash_deg", "unlimited",
                ]),
            ],
        },
        {
            "title": "rotary axis",
            "properties": {
                "letter": { "pattern": "^[ABCabc]$" },
                "kind": { "enum": ["rotary"] },
            },
            "required": rotary_limits(&["travel_min_deg", "travel_max_deg"]),
            "allOf": [
                exactly_one(&["max_velocity_deg_min", "max_velocity_deg_s"]),
                none_of(&[
                    "unlimited", "travel_min_mm", "travel_max_mm", "max_velocity_mm_min", "max_velocity_mm_s",
                    "max_acceleration_mm_s2", "max_acceleration_m_s2", "max_acceleration_g",
                    "max_jerk_mm_s3", "max_jerk_m_s3", "home_mm", "following_error_mm", "backlash_mm",
                    "screw_table_unit", "thermal_input", "thermal_max_mm", "thermal_rate_um_s",
                ]),
            ],
        },
        {
            "title": "unlimited rotary axis",
            "properties": {
                "letter": { "pattern": "^[ABCabc]$" },
                "kind": { "enum": ["rotary"] },
            },
            "required": rotary_limits(&["unlimited"]),
            "allOf": [
                exactly_one(&["max_velocity_deg_min", "max_velocity_deg_s"]),
                none_of(&[
                    "travel_min_deg", "travel_max_deg", "screw_table", "screw_table_format",
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
    /// Translates; mm.
    Linear,
    /// Rotates; degrees.
    Rotary,
}

/// Limits of the machine as a whole.
#[derive(Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct LimitsFile {
    /// Maximum contour feed, mm/min, if it is below what the axes permit.
    pub(crate) max_feed_mm_min: Option<f64>,
    /// Maximum contour feed, mm/s; alternative to max_feed_mm_min.
    pub(crate) max_feed_mm_s: Option<f64>,
}

/// Path control.
#[derive(Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct PathFile {
    /// Path control mode at the start of a program: "blend" (as G64) or "exact" (as G61). Default: "blend".
    #[serde(default)]
    pub(crate) mode: PathMode,
    /// "optimal" (smooth and as fast as the axes permit) or "classic" (corner blends and look-ahead). Default: "optimal".
    #[serde(default)]
    pub(crate) planner: PlannerKind,
    /// Maximum distance of a blend from the programmed path, mm. Default: 0.01.
    #[schemars(range(min = 0, max = 100))]
    pub(crate) blend_tolerance_mm: Option<f64>,
    /// In exact-path mode a step of curvature may change the acceleration by jerk times this time, ms. Default: 1.
    pub(crate) joint_time_ms: Option<f64>,
    /// Permitted chord error between two setpoints, increments. Default: 1.
    pub(crate) chord_error_increments: Option<f64>,
    /// Minimum radius of curvature considered by the rational control rate, mm. Default: 0.25.
    pub(crate) min_radius_mm: Option<f64>,
    /// An arc is rejected if its radii at start and end differ by more than this, mm, ... Default: 0.0283.
    pub(crate) arc_radius_tolerance_mm: Option<f64>,
    /// ... and also by more than this fraction of the radius. Default: 0.001.
    pub(crate) arc_radius_tolerance_ratio: Option<f64>,
    /// Permitted distance of an involute's end point from the curve, mm. Default: one increment, at least 0.001.
    pub(crate) involute_end_tolerance_mm: Option<f64>,
}

/// Resources for programs on this machine. Paths are relative to the folder of the machine file.
#[derive(Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct ProgramFile {
    /// Tool table in LinuxCNC's format, lengths in mm. Default: none.
    pub(crate) tool_table: Option<String>,
    /// What G43 H, G41 and G42 do without a tool table: "error", or "zero" for offsets and diameters of 0. Default: "error".
    #[serde(default)]
    pub(crate) without_tool_table: WithoutToolTable,
    /// How M6 changes the tool: "operator" stops and prompts, "program" runs the executable M6 in user_code_folder, "subroutine"
    /// calls tool_change_subroutine, "none" changes nothing and continues. Default: "operator".
    #[serde(default)]
    pub(crate) tool_change: ToolChange,
    /// Name of the tool-change subroutine, NAME.ngc in a subroutine folder. Default: "toolchange".
    pub(crate) tool_change_subroutine: Option<String>,
    /// Where the tool changer stores the tool from the spindle: "fixed" in its own pocket, "random" in the pocket of the new tool.
    /// Default: "fixed".
    #[serde(default)]
    pub(crate) magazine: Magazine,
    /// Unit of length at the start of a program and of MDI: "mm" for G21, "inch" for G20. Default: "mm".
    #[serde(default)]
    pub(crate) start_unit: LengthUnit,
    /// Plane of arcs and cycles at the start of a program and of MDI: "xy" for G17, "zx" for G18, "yz" for G19. Default: "xy".
    #[serde(default)]
    pub(crate) start_plane: StartPlane,
    /// Meaning of X at the start of a program and of MDI: "radius" for G8, "diameter" for G7. Default: "radius".
    #[serde(default)]
    pub(crate) start_x: StartX,
    /// Unit in which programs read and write the lengths of offsets, of G28 and G30 and of the tool, #5161 to #5410: "mm" or
    /// "inch". Files are in mm in any case. Default: "mm".
    #[serde(default)]
    pub(crate) parameter_unit: LengthUnit,
    /// File of the persistent parameters, in LinuxCNC's format. Default: none, nothing is kept.
    pub(crate) parameters: Option<String>,
    /// Folder of the files that programs write with LOGOPEN, LOGAPPEND and PROBEOPEN. Default: "logs" in the state folder.
    pub(crate) log_folder: Option<String>,
    /// Folders in which subroutines NAME.ngc are searched, after the folder of the program.
    #[serde(default)]
    pub(crate) subroutines: Vec<String>,
    /// The user-defined M codes of this machine, from M100 to M199, for example [101, 150]. Default: none.
    #[serde(default)]
    pub(crate) user_codes: Vec<i64>,
    /// Folder of the executables M100 to M199 and M6. Default: the folder of the machine file.
    pub(crate) user_code_folder: Option<String>,
    /// Time limit of a user-defined M code, s. Default: 10.
    #[schemars(range(min = 0.1, max = 86400))]
    pub(crate) user_code_timeout_s: Option<f64>,
    /// Meaning of X, R and U in the turning cycles G82 and G75 of a lathe: "diameter", "radius", or "mode" for the mode of G7 and
    /// G8. Default: "diameter".
    #[serde(default)]
    pub(crate) turning_cycles: TurningWords,
    /// Whether G32 and G92 are the threads of Fanuc's lathes; otherwise G32 is unknown and G92 sets an offset. Default: false.
    #[serde(default)]
    pub(crate) fanuc_threads: bool,
    /// Whether a cutting load is measured, which the load-adaptive passes of G82 Q1 and G75 Q1 need. Default: false.
    #[serde(default)]
    pub(crate) load_channel: bool,
}

/// How the control loop runs on this computer.
#[derive(Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct RealtimeFile {
    /// SCHED_FIFO priority of the cycle, 2 to 98. Default: 80.
    #[schemars(range(min = 2, max = 98))]
    pub(crate) priority: Option<i64>,
    /// Processor core to which the cycle is pinned. Default: none.
    #[schemars(range(min = 0, max = 4095))]
    pub(crate) core: Option<i64>,
    /// Whether all memory is locked. Default: true.
    pub(crate) lock_memory: Option<bool>,
    /// Number of consecutive late setpoints after which the machine stops, 0 for never. Default: those of one second, at least
    /// 1000.
    #[schemars(range(min = 0, max = 1000000))]
    pub(crate) max_late_cycles: Option<i64>,
}

/// Trace recording.
#[derive(Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct TraceFile {
    /// What happens when the disk is full: "continue" without a trace, or "stop" the machine on the path.
    #[serde(default)]
    pub(crate) on_full: OnFull,
    /// How cycles are stored: "messages", one per cycle, or "columns", lossless in a quarter of the space, with up to 2000 messages
    /// per second for viewers. Default: "messages".
    #[serde(default)]
    pub(crate) cycles: CycleRecording,
}

/// Monitoring of the drives.
#[derive(Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct DrivesFile {
    /// "if_present": a bridge that has responded once must keep responding while power is on; "required": no power without a
    /// bridge; "ignore": feedback is ignored. Default: "if_present".
    #[serde(default)]
    pub(crate) feedback: FeedbackMode,
    /// Maximum age of the newest feedback before the machine stops, ms. Default: 20.
    #[schemars(range(min = 1, max = 1000))]
    pub(crate) feedback_timeout_ms: Option<f64>,
    /// Time limit for the drives to become operational, ms. Default: 2000.
    #[schemars(range(min = 10, max = 60000))]
    pub(crate) enable_timeout_ms: Option<f64>,
    /// Whether the cycle follows the drives' clock, by at most 0.1 % of its period. Default: true.
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

/// The JSON schema of the machine file, shipped as `config/machine.schema.json`, for completion and checks in editors.
#[must_use]
pub fn machine_schema() -> serde_json::Value {
    schemars::schema_for!(MachineFile).to_value()
}
