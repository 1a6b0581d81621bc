//! A machine as described by its file, checked and in one system of units.

use std::fmt::Write as _;
use std::io;
use std::path::{Path, PathBuf};

use evolvent_path::{Axes, AxisLetter, AxisMask};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::corrections::CorrectionSettings;
use crate::error::{MachineError, PeriodError};
use crate::handwheel::HandwheelSettings;
use crate::homing::HomingSettings;
use crate::limits::Limits;
use crate::parse;
use crate::rate::{RateError, RateInput, RationalRate, period_ns_of, rational_rate};
use crate::screw_file::MAX_TABLE_BYTES;
use crate::signals::SignalSettings;

/// Minimum control rate, Hz.
pub const MIN_RATE_HZ: f64 = 250.0;
/// Maximum control rate, Hz.
pub const MAX_RATE_HZ: f64 = 35_000.0;
/// Maximum distance that a program may turn an unlimited rotary axis, degrees in either direction. Measured:
/// the planner plans single moves of 3e6 degrees and fails at 1e7. `serve` removes whole turns while the axis
/// is at rest.
pub const UNLIMITED_DEG: f64 = 1e6;
/// Maximum length of a machine file, bytes.
pub const MAX_FILE_BYTES: u64 = 1 << 20;

/// Mill or lathe.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum MachineKind {
    /// Milling: the tool rotates.
    Mill,
    /// Turning: the workpiece rotates.
    Lathe,
}

/// Mapping from program coordinates to axes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Kinematics {
    /// Each letter of the program drives the axis with that letter.
    #[default]
    Trivial,
}

/// Default lead, ns: the wake-up latency to expect of an ordinary kernel. At 1 kHz it is two cycles, the
/// minimum.
const DEFAULT_LEAD_NS: u64 = 2_000_000;
/// Minimum and maximum lead in cycles. The lead includes the cycle that computes the setpoint.
const LEAD_CYCLES: (u64, u64) = (1, 1000);

/// The time between the computation of a setpoint and its due time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Lead {
    /// 2 ms in whole cycles, at least 2 cycles.
    #[default]
    ByRate,
    /// 1 to 1000 cycles at any rate.
    Cycles(u32),
    /// A time, rounded up to whole cycles.
    Time {
        /// In s.
        s: f64,
    },
}

/// The control rate, as requested by the machine file or the command line.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum ControlRate {
    /// The rate that the limits of the machine require: see [`rational_rate`].
    #[default]
    Rational,
    /// A rate in Hz.
    Hz(f64),
}

/// Path control mode at the start of a program.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum PathMode {
    /// As G61: the exact programmed path.
    Exact,
    /// As G64 P: within the blend tolerance.
    #[default]
    Blend,
}

/// The planner that computes the motion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum PlannerKind {
    /// Smooth path within the tolerance, as fast as the limits of the axes allow.
    #[default]
    Optimal,
    /// Blends at corners, and look-ahead over limits that are constant along the path: simple, slower.
    Classic,
}

impl PlannerKind {
    /// Its name in machine files, on the command line and in traces.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Optimal => "optimal",
            Self::Classic => "classic",
        }
    }

    /// Fraction of the permitted chord error that this planner uses where it bends the path. The time-optimal
    /// planner keeps a reserve: it derives the speed from the curvature at its stations, and the curvature
    /// changes within a period.
    #[must_use]
    pub const fn chord_fraction(self) -> f64 {
        match self {
            Self::Optimal => 0.94,
            Self::Classic => 1.0,
        }
    }

    /// The planner with this name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        [Self::Optimal, Self::Classic]
            .into_iter()
            .find(|kind| kind.name() == name)
    }
}

/// Reaction to a trace that can no longer be written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum OnFull {
    /// The program continues without a trace; the run ends with a warning.
    #[default]
    Continue,
    /// The machine stops on the path within its limits.
    Stop,
}

/// How a trace stores the cycles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum CycleRecording {
    /// One message per cycle with plain numbers, readable by any MCAP tool.
    #[default]
    Messages,
    /// Lossless columns in a quarter of the space, and up to 2000 messages per second for viewers.
    Columns,
}

/// One axis. Linear axes are in millimetres, rotary ones in degrees; time is in seconds.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    /// The letter used by programs.
    pub letter: AxisLetter,
    /// Minimum position, mm or degrees.
    pub travel_min: f64,
    /// Maximum position, mm or degrees.
    pub travel_max: f64,
    /// Maximum velocity, mm/s or degrees/s.
    pub max_velocity: f64,
    /// Maximum acceleration, mm/s2 or degrees/s2.
    pub max_acceleration: f64,
    /// Maximum jerk, mm/s3 or degrees/s3.
    pub max_jerk: f64,
    /// Position after homing, within the travel, mm or degrees.
    pub home: f64,
    /// Permitted following error at rest, mm or degrees.
    pub following_error: f64,
    /// Permitted following error in motion, as the travel in this time at the present velocity, s.
    pub following_time_s: f64,
    /// The direction of G90 on an unlimited rotary axis, whose travel is [`UNLIMITED_DEG`] in either
    /// direction.
    pub unlimited: Option<RotaryDirection>,
}

/// The direction in which G90 turns an unlimited rotary axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
#[schemars(rename = "RotaryWay")]
pub enum RotaryDirection {
    /// The shorter way; half a turn in the positive direction.
    Shorter,
    /// The sign of the word: without one in the positive direction, with a minus to the absolute value in the negative direction.
    Sign,
}

/// Path control.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathSettings {
    /// The planner.
    pub planner: PlannerKind,
    /// Mode until the program says G61 or G64.
    pub mode: PathMode,
    /// Maximum distance of a blend from the programmed path, mm, until the program says G64 P.
    pub blend_tolerance_mm: f64,
    /// In exact-path mode a step of curvature may change the acceleration by jerk times this time, s.
    pub joint_time_s: f64,
    /// Permitted chord error between two setpoints, in increments.
    pub chord_error_increments: f64,
    /// Minimum radius of curvature considered by the rational control rate, mm.
    pub min_radius_mm: f64,
    /// An arc is rejected if its radii at start and end differ by more than this, mm (LinuxCNC: 0.0283 mm),
    /// ...
    pub arc_radius_tolerance_mm: f64,
    /// ... and also by more than this fraction of the radius (LinuxCNC: 0.001).
    pub arc_radius_tolerance_ratio: f64,
    /// Permitted distance of an involute's end point from the curve, mm.
    pub involute_end_tolerance_mm: f64,
}

/// How the cycle runs on this host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RealtimeSettings {
    /// `SCHED_FIFO` priority of the cycle, 2 to 98; the publisher runs one below.
    pub priority: u8,
    /// Processor core to which the cycle is pinned, if any.
    pub core: Option<usize>,
    /// Whether all memory is locked.
    pub lock_memory: bool,
    /// Consecutive late setpoints after which the machine stops; 0 for never. `None`:
    /// [`Machine::max_late_cycles`] derives it from the period.
    pub max_late_cycles: Option<u32>,
}

/// Whether a drive bridge must respond.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum FeedbackMode {
    /// Feedback is ignored.
    Ignore,
    /// A bridge that has responded once must keep responding while power is on.
    #[default]
    IfPresent,
    /// No power without a bridge.
    Required,
}

/// Monitoring of the drives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriveSettings {
    /// Whether a drive bridge must respond.
    pub feedback: FeedbackMode,
    /// Maximum age of feedback under power, s.
    pub feedback_timeout_s: f64,
    /// Time limit for the drives to become operational, s.
    pub enable_timeout_s: f64,
    /// Whether the cycle follows the clock of the drives.
    pub follow_clock: bool,
}

/// Trace recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TraceSettings {
    /// Reaction to a full disk.
    pub on_full: OnFull,
    /// How cycles are stored.
    pub cycles: CycleRecording,
}

/// Meaning of X, R and U in a lathe's turning cycles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum TurningWords {
    /// Diameters.
    #[default]
    Diameter,
    /// Radii.
    Radius,
    /// Diameters in G7, radii in G8.
    Mode,
}

/// A unit of length of programs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum LengthUnit {
    /// Millimetres, G21.
    #[default]
    Mm,
    /// Inches, G20.
    Inch,
}

/// The plane of arcs and cycles at the start of programs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum StartPlane {
    /// XY, G17.
    #[default]
    Xy,
    /// ZX, G18.
    Zx,
    /// YZ, G19.
    Yz,
}

/// Meaning of X at the start of programs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum StartX {
    /// Radii, G8.
    #[default]
    Radius,
    /// Diameters, G7.
    Diameter,
}

/// Default name of the tool-change subroutine.
pub(crate) const DEFAULT_TOOL_CHANGE_SUBROUTINE: &str = "toolchange";

/// How M6 changes the tool.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum ToolChange {
    /// The program stops and prompts the operator, who confirms the change.
    #[default]
    Operator,
    /// An automatic tool changer: the executable M6 in the folder of user-defined M codes.
    Program,
    /// An automatic tool changer: a subroutine with moves, outputs and inputs.
    Subroutine,
    /// Nothing changes: a bench or simulation without a spindle.
    None,
}

/// Where the tool changer stores the tool from the spindle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Magazine {
    /// In its own pocket.
    #[default]
    Fixed,
    /// In the pocket of the new tool.
    Random,
}

/// Tool offsets and diameters without a tool table.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum WithoutToolTable {
    /// Programs that use them are rejected.
    #[default]
    Error,
    /// 0, with a warning.
    Zero,
}

/// Resources for programs on the machine.
#[derive(Clone, Debug, PartialEq)]
pub struct ProgramSettings {
    /// Tool table, relative to the folder of the machine file.
    pub tool_table: Option<PathBuf>,
    /// Tool offsets and diameters without a tool table.
    pub without_tool_table: WithoutToolTable,
    /// How M6 changes the tool.
    pub tool_change: ToolChange,
    /// Name of the tool-change subroutine.
    pub tool_change_subroutine: String,
    /// Where the tool changer stores tools.
    pub magazine: Magazine,
    /// Unit of length at the start of a program and of MDI.
    pub start_unit: LengthUnit,
    /// Plane of arcs and cycles at the start of a program and of MDI.
    pub start_plane: StartPlane,
    /// Meaning of X at the start of a program and of MDI.
    pub start_x: StartX,
    /// Unit in which programs read and write the lengths of offsets and of the tool in numbered parameters.
    pub parameter_unit: LengthUnit,
    /// File of the persistent parameters, likewise relative.
    pub parameters: Option<PathBuf>,
    /// Folder of the files that programs write (LOGOPEN, PROBEOPEN), likewise relative.
    pub log_folder: Option<PathBuf>,
    /// Folders of subroutines, likewise relative.
    pub subroutines: Vec<PathBuf>,
    /// User-defined M codes of the machine, from M100 to M199.
    pub user_codes: Vec<u32>,
    /// Folder of their executables, relative to the folder of the machine file.
    pub user_code_folder: Option<PathBuf>,
    /// Time limit of a user-defined M code, s.
    pub user_code_timeout_s: f64,
    /// Meaning of X, R and U in turning cycles.
    pub turning_cycles: TurningWords,
    /// G32 and G92 are the threads of Fanuc's lathes.
    pub fanuc_threads: bool,
    /// Whether a cutting load is measured.
    pub load_channel: bool,
}

impl Default for ProgramSettings {
    fn default() -> Self {
        Self {
            tool_table: None,
            without_tool_table: WithoutToolTable::default(),
            tool_change: ToolChange::default(),
            tool_change_subroutine: DEFAULT_TOOL_CHANGE_SUBROUTINE.to_owned(),
            magazine: Magazine::default(),
            start_unit: LengthUnit::default(),
            start_plane: StartPlane::default(),
            start_x: StartX::default(),
            parameter_unit: LengthUnit::default(),
            parameters: None,
            log_folder: None,
            subroutines: Vec::new(),
            user_codes: Vec::new(),
            user_code_folder: None,
            user_code_timeout_s: 10.0,
            turning_cycles: TurningWords::default(),
            fanuc_threads: false,
            load_channel: false,
        }
    }
}

/// A checked machine: every number is finite and possible.
///
/// The cycle may read it; loading is for start-up.
#[derive(Clone, Debug, PartialEq)]
pub struct Machine {
    /// Name in services and file names: letters, digits, `-` and `_`.
    pub name: String,
    /// Description, one line.
    pub description: String,
    /// Mill or lathe.
    pub kind: MachineKind,
    /// Mapping from program coordinates to axes.
    pub kinematics: Kinematics,
    /// Position increments per millimetre of a linear axis.
    pub increments_per_mm: f64,
    /// Position increments per degree of a rotary axis; present if there is one.
    pub increments_per_degree: Option<f64>,
    /// The control rate.
    pub rate: ControlRate,
    /// Time between the computation of a setpoint and its due time; [`lead_cycles`](Self::lead_cycles) gives
    /// it in cycles.
    pub lead: Lead,
    /// The axes in the order of the file.
    pub axes: Vec<Axis>,
    /// Maximum contour feed, mm/s, if it is below what the axes permit.
    pub max_feed_mm_s: Option<f64>,
    /// Path control.
    pub path: PathSettings,
    /// How the cycle runs on this host.
    pub realtime: RealtimeSettings,
    /// Trace recording.
    pub trace: TraceSettings,
    /// Monitoring of the drives.
    pub drives: DriveSettings,
    /// Resources for programs.
    pub program: ProgramSettings,
    /// Axes that are homed, in the order of the file. The others are at their home position from the start,
    /// or at the position that their drives report.
    pub homing: Vec<HomingSettings>,
    /// Inputs, outputs, spindles and the emergency-stop chain.
    pub signals: SignalSettings,
    /// The handwheel, if there is one.
    pub handwheel: Option<HandwheelSettings>,
    /// Backlash, screw error, squareness and thermal offset.
    pub corrections: CorrectionSettings,
    /// Possible but implausible values: each with file, line, column, key and what to do.
    pub warnings: Vec<String>,
}

impl Machine {
    /// Reads and checks a machine file (TOML, at most 1 MiB).
    ///
    /// # Errors
    /// [`MachineError`] with file, line, column and key of the first problem, and what to do about it.
    pub fn load(path: &Path) -> Result<Self, MachineError> {
        let file = path.display().to_string();
        let read_error = |source| MachineError::Read {
            file: file.clone(),
            source,
        };
        let bytes = evolvent_config::read_regular(path, MAX_FILE_BYTES).map_err(read_error)?;
        if bytes.len() as u64 > MAX_FILE_BYTES {
            return Err(MachineError::TooLong {
                file,
                limit_bytes: MAX_FILE_BYTES,
            });
        }
        match String::from_utf8(bytes) {
            Ok(text) => {
                let folder = path.parent().unwrap_or(Path::new(""));
                Self::parse_with(&text, &file, |name| {
                    let bytes = evolvent_config::read_regular(&folder.join(name), MAX_TABLE_BYTES)?;
                    if bytes.len() as u64 > MAX_TABLE_BYTES {
                        return Err(io::Error::other(format!("longer than {MAX_TABLE_BYTES} bytes")));
                    }
                    Ok(bytes)
                })
            }
            Err(error) => Err(MachineError::NotText {
                file,
                byte: error.utf8_error().valid_up_to(),
            }),
        }
    }

    /// Checks the text of a machine file; `file_name` is for error messages.
    ///
    /// # Errors
    /// As [`Machine::load`]; also if the text names another file, such as a table of screw errors.
    pub fn parse(text: &str, file_name: &str) -> Result<Self, MachineError> {
        Self::parse_with(text, file_name, |_| {
            Err(io::Error::other(
                "only the text of the machine file is known here",
            ))
        })
    }

    /// As [`parse`](Self::parse); `read_file` returns the content of a file, given the name in the machine
    /// file.
    ///
    /// # Errors
    /// As [`Machine::load`].
    pub fn parse_with(
        text: &str,
        file_name: &str,
        mut read_file: impl FnMut(&Path) -> io::Result<Vec<u8>>,
    ) -> Result<Self, MachineError> {
        if text.len() as u64 > MAX_FILE_BYTES {
            return Err(MachineError::TooLong {
                file: file_name.to_owned(),
                limit_bytes: MAX_FILE_BYTES,
            });
        }
        parse::machine(text, file_name, &mut read_file)
    }

    /// The limits of ideal motion for all nine axes, for the planner and the cycle's guard. They leave a
    /// reserve so that the corrected setpoints keep [`drive_limits`](Self::drive_limits). Without corrections
    /// both are equal.
    #[must_use]
    pub fn limits(&self) -> Limits {
        let mut limits = self.drive_limits();
        if self.corrections.is_none() {
            return limits;
        }
        for (i, [velocity, acceleration, jerk]) in self.corrections.planned.into_iter().enumerate() {
            limits.velocity[i] *= velocity;
            limits.acceleration[i] *= acceleration;
            limits.jerk[i] *= jerk;
        }
        limits
    }

    /// The limits of the setpoints for the drives, as in the machine file.
    #[must_use]
    pub fn drive_limits(&self) -> Limits {
        Limits::of(&self.axes)
    }

    /// The unlimited rotary axes.
    #[must_use]
    pub fn unlimited(&self) -> AxisMask {
        let axes = self.axes.iter().filter(|axis| axis.unlimited.is_some());
        axes.map(|axis| axis.letter.index()).collect()
    }

    /// The axis with this letter, if the machine has it.
    #[must_use]
    pub fn axis(&self, letter: AxisLetter) -> Option<&Axis> {
        self.axes.iter().find(|axis| axis.letter == letter)
    }

    /// The axis letters in the order of the file: `"XYZ"`.
    #[must_use]
    pub fn axis_letters(&self) -> String {
        let mut letters = String::with_capacity(self.axes.len());
        for axis in &self.axes {
            // Writing to a string cannot fail.
            let _ = letters.write_char(axis.letter.letter());
        }
        letters
    }

    /// Position increments per millimetre or degree of every axis; 0 for an absent axis.
    #[must_use]
    pub fn increments(&self) -> Axes {
        let mut increments = Axes::zeros();
        for axis in &self.axes {
            let per_degree = self.increments_per_degree.unwrap_or(0.0);
            increments[axis.letter.index()] = if axis.letter.is_rotary() {
                per_degree
            } else {
                self.increments_per_mm
            };
        }
        increments
    }

    /// The input of the rational control rate: the maximum limits over the linear axes, the paper's choice,
    /// and the maximum feed.
    ///
    /// Several axes together can exceed one of them (by at most `sqrt(3)` for three equal axes). There the
    /// planner's feed limit keeps the chord error.
    #[must_use]
    pub fn rate_input(&self) -> RateInput {
        let linear = self.axes.iter().filter(|axis| !axis.letter.is_rotary());
        let mut input = RateInput {
            max_feed_mm_s: 0.0,
            acceleration_mm_s2: 0.0,
            jerk_mm_s3: 0.0,
            increments_per_mm: self.increments_per_mm,
            permitted_error_increments: self.path.chord_error_increments,
            min_radius_mm: self.path.min_radius_mm,
        };
        for axis in linear {
            input.max_feed_mm_s = input.max_feed_mm_s.max(axis.max_velocity);
            input.acceleration_mm_s2 = input.acceleration_mm_s2.max(axis.max_acceleration);
            input.jerk_mm_s3 = input.jerk_mm_s3.max(axis.max_jerk);
        }
        if let Some(max_feed_mm_s) = self.max_feed_mm_s {
            input.max_feed_mm_s = input.max_feed_mm_s.min(max_feed_mm_s);
        }
        input
    }

    /// The rational control rate of this machine before clamping to the range of the loop, see
    /// [`Machine::period_ns`].
    ///
    /// # Errors
    /// Only for a machine constructed in code; machine files are checked for it.
    pub fn rational_rate(&self) -> Result<RationalRate, RateError> {
        rational_rate(&self.rate_input())
    }

    /// The period of a control rate in whole nanoseconds, rounded down: the rate is never below the requested
    /// one.
    ///
    /// A rate in Hz must be between [`MIN_RATE_HZ`] and [`MAX_RATE_HZ`] (28 571 ns). The rational rate is
    /// clamped to the same range: raising it only lowers the chord error; lowering it costs time, not
    /// accuracy, because the planner keeps the chord error at the actual rate by limiting the feed.
    ///
    /// # Errors
    /// [`PeriodError`] for a rate out of range.
    pub fn period_ns(&self, rate: ControlRate) -> Result<u64, PeriodError> {
        let rate_hz = match rate {
            ControlRate::Hz(hz) if (MIN_RATE_HZ..=MAX_RATE_HZ).contains(&hz) => hz,
            ControlRate::Hz(rate_hz) => return Err(PeriodError::OutOfBounds { rate_hz }),
            ControlRate::Rational => self.rational_rate()?.rate_hz.clamp(MIN_RATE_HZ, MAX_RATE_HZ),
        };
        Ok(period_ns_of(rate_hz))
    }

    /// Consecutive late setpoints after which the machine stops; 0 for never. Default: those of one second,
    /// at least 1000, so that a short pause of the host is tolerated at every rate alike.
    #[must_use]
    pub fn max_late_cycles(&self, period_ns: u64) -> u32 {
        let in_a_second = (1_000_000_000 / period_ns.max(1)).clamp(1000, 1_000_000);
        self.realtime.max_late_cycles.unwrap_or(in_a_second as u32)
    }

    /// Number of cycles between the computation of a setpoint and its due time, 1 to 1000.
    ///
    /// ```
    /// use evolvent_machine::Lead;
    /// # let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../config/machines/mill-3axis.toml");
    /// # let mut machine = evolvent_machine::Machine::load(std::path::Path::new(file))?;
    /// machine.lead = Lead::ByRate;
    /// assert_eq!(machine.lead_cycles(1_000_000), 2);
    /// assert_eq!(machine.lead_cycles(28_571), 70);
    /// # Ok::<(), evolvent_machine::MachineError>(())
    /// ```
    #[must_use]
    pub fn lead_cycles(&self, period_ns: u64) -> u32 {
        let period_ns = period_ns.max(1);
        let cycles = match self.lead {
            Lead::ByRate => (DEFAULT_LEAD_NS / period_ns).max(2),
            Lead::Cycles(cycles) => cycles.into(),
            // Checked when the file is read; the cast saturates.
            Lead::Time { s } => ((s * 1e9) as u64).div_ceil(period_ns),
        };
        cycles.clamp(LEAD_CYCLES.0, LEAD_CYCLES.1) as u32
    }
}
