//! A machine as the file describes it, checked and in one system of units.

use std::fmt::Write as _;
use std::io;
use std::path::{Path, PathBuf};

use evolvent_path::{Axes, AxisLetter};
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

/// The lowest control rate that the loop runs, Hz.
pub const MIN_RATE_HZ: f64 = 250.0;
/// The highest control rate that the loop runs, Hz.
pub const MAX_RATE_HZ: f64 = 35_000.0;
/// A machine file may be this long, bytes.
pub const MAX_FILE_BYTES: u64 = 1 << 20;

/// What the machine does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum MachineKind {
    /// Milling: the tool turns.
    Mill,
    /// Turning: the workpiece turns.
    Lathe,
}

/// How axis coordinates follow from the program's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Kinematics {
    /// Each letter of the program drives the axis of that letter.
    #[default]
    Trivial,
}

/// The lead of a machine file without one, ns: a wake-up may be this late on an ordinary kernel. At 1 kHz and below it
/// is two cycles.
const DEFAULT_LEAD_NS: u64 = 2_000_000;
/// Cycles of the shortest and of the longest lead. The first cycle's time is the cycle's own.
const LEAD_CYCLES: (u64, u64) = (1, 1000);

/// How long ahead of its due time a setpoint is computed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Lead {
    /// 2 ms in whole cycles, at least 2 cycles.
    #[default]
    ByRate,
    /// 1 to 1000 cycles, whatever the rate.
    Cycles(u32),
    /// A time, rounded up to whole cycles.
    Time {
        /// In s.
        s: f64,
    },
}

/// The control rate that the machine file or the command line asks for.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum ControlRate {
    /// The rate that the machine's own limits need: see [`rational_rate`].
    #[default]
    Rational,
    /// A rate in Hz.
    Hz(f64),
}

/// How joints between blocks are taken until the program says otherwise.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum PathMode {
    /// As G61: the programmed path exactly.
    Exact,
    /// As G64 P: within the blend tolerance.
    #[default]
    Blend,
}

/// Which planner computes the motion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum PlannerKind {
    /// Smooth path within the tolerance, as fast as the limits of the axes allow.
    #[default]
    Optimal,
    /// Blends at corners and look-ahead over constant limits along the path: simple, slower.
    Classic,
}

impl PlannerKind {
    /// The name in machine files, on the command line and in traces.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Optimal => "optimal",
            Self::Classic => "classic",
        }
    }

    /// Back from the name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        [Self::Optimal, Self::Classic]
            .into_iter()
            .find(|kind| kind.name() == name)
    }
}

/// What happens when the trace can no longer be written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum OnFull {
    /// The program goes on without a trace; the run ends with a warning.
    #[default]
    Continue,
    /// The machine stops within its limits, on the path.
    Stop,
}

/// How a trace holds the cycles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum CycleRecording {
    /// One message a cycle with plain numbers, for whoever reads MCAP.
    #[default]
    Messages,
    /// Exact columns in a quarter of the room, and messages at most 2000 times a second for viewers.
    Columns,
}

/// One axis. Linear axes are in millimetres, rotary ones in degrees, both with seconds.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    /// The letter by which programs name it.
    pub letter: AxisLetter,
    /// Lowest position, mm or degrees.
    pub travel_min: f64,
    /// Highest position, mm or degrees.
    pub travel_max: f64,
    /// Largest velocity, mm/s or degrees/s.
    pub max_velocity: f64,
    /// Largest acceleration, mm/s2 or degrees/s2.
    pub max_acceleration: f64,
    /// Largest jerk, mm/s3 or degrees/s3.
    pub max_jerk: f64,
    /// Position after homing, within the travel, mm or degrees.
    pub home: f64,
    /// Following error that is allowed at rest, mm or degrees.
    pub following_error: f64,
    /// Following error that is allowed in motion: so many seconds of way at the velocity of the moment.
    pub following_time_s: f64,
}

/// How the path is followed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathSettings {
    /// Which planner.
    pub planner: PlannerKind,
    /// Mode until the program says G61 or G64.
    pub mode: PathMode,
    /// How far a blend may leave the programmed path, mm, until the program says G64 P.
    pub blend_tolerance_mm: f64,
    /// In exact-path mode a step of curvature may step the acceleration by jerk times this time, s.
    pub joint_time_s: f64,
    /// Permitted chord error between two setpoints, in increments.
    pub chord_error_increments: f64,
    /// Smallest radius of curvature that the rational control rate allows for, mm.
    pub min_radius_mm: f64,
    /// An arc whose radii at start and end differ by more than this may be wrong, mm (LinuxCNC: 0.0283 mm).
    pub arc_radius_tolerance_mm: f64,
    /// ... and is wrong if they also differ by more than this part of the radius (LinuxCNC: 0.001).
    pub arc_radius_tolerance_ratio: f64,
    /// How far the end point of an involute may lie off the curve, mm.
    pub involute_end_tolerance_mm: f64,
}

/// How the cycle runs on this host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RealtimeSettings {
    /// `SCHED_FIFO` priority of the cycle, 2 to 98; the publisher runs one below.
    pub priority: u8,
    /// Processor core to which the cycle is pinned.
    pub core: Option<usize>,
    /// Whether all memory is locked.
    pub lock_memory: bool,
    /// Stop after this many late setpoints in a row; 0 for never. None: [`Machine::max_late_cycles`] decides by the period.
    pub max_late_cycles: Option<u32>,
}

/// Whether a drive bridge is expected to answer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum FeedbackWish {
    /// What comes back is not looked at.
    Ignore,
    /// A bridge that has answered once must go on answering while power is on.
    #[default]
    IfPresent,
    /// No power without a bridge.
    Required,
}

/// How the drives are watched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriveSettings {
    /// Whether a drive bridge is expected to answer.
    pub feedback: FeedbackWish,
    /// The oldest feedback that is allowed under power, s.
    pub feedback_timeout_s: f64,
    /// How long the drives may take to come into operation, s.
    pub enable_timeout_s: f64,
    /// Whether the cycle follows the clock of the drives.
    pub follow_clock: bool,
}

/// The recorder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TraceSettings {
    /// What happens when the disk is full.
    pub on_full: OnFull,
    /// How the cycles are held.
    pub cycles: CycleRecording,
}

/// What X, R and U of a lathe's turning cycles are.
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

/// Name of the subroutine that changes tools, where the machine file names none.
pub(crate) const DEFAULT_CHANGER: &str = "toolchange";

/// How M6 puts another tool into the spindle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum ToolChange {
    /// The program stops and asks the operator, who confirms the change.
    #[default]
    Operator,
    /// An automatic changer: the executable M6 of the folder of user-defined M codes changes the tool.
    Program,
    /// An automatic changer: a subroutine with moves, outputs and inputs changes the tool.
    Subroutine,
    /// Nothing is changed: a bench or simulation without a spindle.
    None,
}

/// Where a changer puts the tool that it takes out of the spindle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Magazine {
    /// Into its own pocket.
    #[default]
    Fixed,
    /// Into the pocket of the tool that it fetches.
    Random,
}

/// What offsets and diameters of tools are where there is no tool table.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum WithoutToolTable {
    /// A program that uses them has an error.
    #[default]
    Error,
    /// 0, with a message of the program.
    Zero,
}

/// What programs find on the machine.
#[derive(Clone, Debug, PartialEq)]
pub struct ProgramSettings {
    /// Tool table, as written in the file: relative to its folder.
    pub tool_table: Option<PathBuf>,
    /// What offsets and diameters of tools are without one.
    pub without_tool_table: WithoutToolTable,
    /// How M6 puts another tool into the spindle.
    pub tool_change: ToolChange,
    /// Name of the subroutine that changes tools.
    pub tool_change_subroutine: String,
    /// Where its changer puts tools.
    pub magazine: Magazine,
    /// File of the kept parameters, likewise.
    pub parameters: Option<PathBuf>,
    /// Folder of the files that programs write (LOGOPEN, PROBEOPEN), likewise.
    pub log_folder: Option<PathBuf>,
    /// Folders of subroutines, likewise.
    pub subroutines: Vec<PathBuf>,
    /// Which of M100 to M199 there are.
    pub user_codes: Vec<u32>,
    /// Folder of their programs, as written in the file: relative to its folder.
    pub user_code_folder: Option<PathBuf>,
    /// How long one of them may take, s.
    pub user_code_timeout_s: f64,
    /// Words of the turning cycles.
    pub turning_cycles: TurningWords,
    /// Whether a cutting load is measured.
    pub load_channel: bool,
}

impl Default for ProgramSettings {
    fn default() -> Self {
        Self {
            tool_table: None,
            without_tool_table: WithoutToolTable::default(),
            tool_change: ToolChange::default(),
            tool_change_subroutine: DEFAULT_CHANGER.to_owned(),
            magazine: Magazine::default(),
            parameters: None,
            log_folder: None,
            subroutines: Vec::new(),
            user_codes: Vec::new(),
            user_code_folder: None,
            user_code_timeout_s: 10.0,
            turning_cycles: TurningWords::default(),
            load_channel: false,
        }
    }
}

/// A machine, checked: every number is finite and within a machine's range.
///
/// The cycle may read it; loading it is for start-up.
#[derive(Clone, Debug, PartialEq)]
pub struct Machine {
    /// Name in services and file names: letters, digits, `-` and `_`.
    pub name: String,
    /// One line for people.
    pub description: String,
    /// Mill or lathe.
    pub kind: MachineKind,
    /// How axis coordinates follow from the program's.
    pub kinematics: Kinematics,
    /// Position increments per millimetre of a linear axis.
    pub increments_per_mm: f64,
    /// Position increments per degree of a rotary axis; present where there is one.
    pub increments_per_degree: Option<f64>,
    /// The control rate.
    pub rate: ControlRate,
    /// How long ahead of its due time a setpoint is computed; [`lead_cycles`](Self::lead_cycles) at a period.
    pub lead: Lead,
    /// Axes in the order of the file.
    pub axes: Vec<Axis>,
    /// Largest contour feed, mm/s, where it is below what the axes allow.
    pub max_feed_mm_s: Option<f64>,
    /// How the path is followed.
    pub path: PathSettings,
    /// How the cycle runs on this host.
    pub realtime: RealtimeSettings,
    /// The recorder.
    pub trace: TraceSettings,
    /// How the drives are watched.
    pub drives: DriveSettings,
    /// What programs find on the machine.
    pub program: ProgramSettings,
    /// Axes that are homed by a switch, in the order of the file. The others stand at their home position from the
    /// start, or where their drives say.
    pub homing: Vec<HomingSettings>,
    /// Inputs, outputs, spindles and the emergency-stop chain.
    pub signals: SignalSettings,
    /// The handwheel, where there is one.
    pub handwheel: Option<HandwheelSettings>,
    /// Backlash, screw error, squareness and thermal offset.
    pub corrections: CorrectionSettings,
}

impl Machine {
    /// Reads a machine file (TOML, at most 1 MiB) and checks it.
    ///
    /// # Errors
    /// File, line, column and key of the first thing that is wrong, and what to do about it.
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

    /// Checks the text of a machine file; `file_name` is for the messages.
    ///
    /// # Errors
    /// As [`Machine::load`]; and where the text names another file, as a table of screw errors.
    pub fn parse(text: &str, file_name: &str) -> Result<Self, MachineError> {
        Self::parse_with(text, file_name, |_| {
            Err(io::Error::other(
                "only the text of the machine file is known here",
            ))
        })
    }

    /// The same; `read_file` gives the content of a file by the name that the machine file gives it.
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

    /// Limits of all nine axes, for the planner and the cycle's guard: of ideal motion, so that what the drives are sent keeps
    /// [`drive_limits`](Self::drive_limits). Where nothing is corrected they are the same.
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

    /// Limits of what the drives are sent, as the machine file says.
    #[must_use]
    pub fn drive_limits(&self) -> Limits {
        Limits::of(&self.axes)
    }

    /// The axis of a letter, where the machine has it.
    #[must_use]
    pub fn axis(&self, letter: AxisLetter) -> Option<&Axis> {
        self.axes.iter().find(|axis| axis.letter == letter)
    }

    /// The letters in the order of the file: `"XYZ"`.
    #[must_use]
    pub fn axis_letters(&self) -> String {
        let mut letters = String::with_capacity(self.axes.len());
        for axis in &self.axes {
            // Writing to a string cannot fail.
            let _ = letters.write_char(axis.letter.letter());
        }
        letters
    }

    /// Position increments per millimetre or degree of every axis; 0 for an axis that the machine has not.
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

    /// What the rational control rate follows from: the largest limits over the linear axes, which is the paper's choice,
    /// and the largest feed.
    ///
    /// Several axes together can exceed what one of them can (by `sqrt(3)` at most for three equal axes); there the
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

    /// The rational control rate of this machine, not yet fitted into what the loop runs: see [`Machine::period_ns`].
    ///
    /// # Errors
    /// Only for a machine that was built by hand; those from a file are checked.
    pub fn rational_rate(&self) -> Result<RationalRate, RateError> {
        rational_rate(&self.rate_input())
    }

    /// The period of a control rate in whole nanoseconds, rounded down: the rate is never below what was asked for.
    ///
    /// A rate in Hz must lie between [`MIN_RATE_HZ`] and [`MAX_RATE_HZ`] (28 571 ns). The rational rate is fitted into
    /// the same bounds: raised where it is lower, which only lowers the chord error; cut where it is higher, which costs
    /// time, not accuracy, because the planner keeps the chord error at the running rate by limiting the feed.
    ///
    /// # Errors
    /// [`PeriodError`] for a rate out of bounds.
    pub fn period_ns(&self, rate: ControlRate) -> Result<u64, PeriodError> {
        let rate_hz = match rate {
            ControlRate::Hz(hz) if (MIN_RATE_HZ..=MAX_RATE_HZ).contains(&hz) => hz,
            ControlRate::Hz(rate_hz) => return Err(PeriodError::OutOfBounds { rate_hz }),
            ControlRate::Rational => self.rational_rate()?.rate_hz.clamp(MIN_RATE_HZ, MAX_RATE_HZ),
        };
        Ok(period_ns_of(rate_hz))
    }

    /// Late setpoints in a row after which the core stops; 0 for never. Where the machine file does not say: those of one
    /// second, at least 1000, so that a host that stands still for a moment is forgiven at every rate alike.
    #[must_use]
    pub fn max_late_cycles(&self, period_ns: u64) -> u32 {
        let in_a_second = (1_000_000_000 / period_ns.max(1)).clamp(1000, 1_000_000);
        self.realtime.max_late_cycles.unwrap_or(in_a_second as u32)
    }

    /// How many cycles ahead of its due time a setpoint is computed, 1 to 1000.
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
            // Values are checked when the file is read; a cast saturates.
            Lead::Time { s } => ((s * 1e9) as u64).div_ceil(period_ns),
        };
        cycles.clamp(LEAD_CYCLES.0, LEAD_CYCLES.1) as u32
    }
}
