//! Settings of the interpreter: machine and set-up before the first line.

use evolvent_path::{AXES, Axes, Plane};

use crate::parameters::values::Parameters;
use crate::state::machine_state::INCH_MM;
use crate::{Outputs, PathMode, SPINDLES, ToolTable};

/// Set-up at the start of a program. [`Settings::default`] is a machine of nine axes at zero.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Position of the machine, machine coordinates (mm, degrees).
    pub start: Axes,
    /// The existing axes. A word for any other axis is an error.
    pub axes: [bool; AXES],
    /// Axes whose position in `start` is undefined because they are not homed
    /// ([`crate::Interpreter::uncertain_axes`]).
    pub unhomed: [bool; AXES],
    /// Offsets at the start.
    pub offsets: StartOffsets,
    /// Path control mode before the first G61 or G64.
    pub path_mode: PathMode,
    /// Whether the program starts in inches (G20) instead of mm (G21).
    pub inches: bool,
    /// The plane before the first G17, G18 or G19.
    pub plane: Plane,
    /// Whether X is a diameter (G7) instead of a radius (G8) at the start of the program.
    pub diameter: bool,
    /// Whether programs read and write the lengths of offsets, of G28 and G30 and of the tool (#5161 to
    /// #5410) in inches, independent of the active unit, as on a LinuxCNC machine in inches.
    /// [`Settings::parameters`] are in mm in any case.
    pub parameters_in_inches: bool,
    /// Whether lines that start with `/` are skipped.
    pub block_delete: bool,
    /// Whether #5399 of a wait (M66) without a reply is the awaited value; otherwise it is -1, as after a
    /// timeout.
    pub waits_succeed: bool,
    /// Whether a probing move without a reply counts as one with contact at its end. Errors that depend on it
    /// are then warnings, and one warning states this assumption.
    pub probes_succeed: bool,
    /// Permitted difference of an arc's radii at start and end.
    pub arc: ArcTolerance,
    /// Permitted distance of an involute's programmed end from the involute, in mm: one increment, at least 1
    /// um.
    pub involute_tolerance_mm: f64,
    /// Bounds of memory and time.
    pub limits: ProgramLimits,
    /// Tool in the spindle at the start; 0 for none.
    pub tool: u32,
    /// Tool that an earlier T word has selected for the next M6.
    pub selected_tool: Option<u32>,
    /// Spindle and coolant at the start.
    pub outputs: Outputs,
    /// Whether the text is an MDI block: without M2 or M30 spindle and coolant keep their state at its end.
    pub is_mdi: bool,
    /// The state with which an MDI block starts.
    pub preamble: MdiPreamble,
    /// Features of the machine.
    pub features: MachineFeatures,
    /// The tool table. Without one, an offset or diameter of any tool but 0 is an error
    /// ([`crate::Code::UnknownTool`]).
    pub tools: Option<ToolTable>,
    /// Whether a missing tool table means offsets and diameters of 0, with a warning.
    pub tools_without_table: bool,
    /// Values of numbered parameters from earlier runs. The fields above (offsets, tool) overwrite theirs.
    pub parameters: Vec<(u32, f64)>,
    /// Folders in which subroutine files are searched, in this order: `NAME.ngc` for `O<NAME> call`.
    pub subroutine_folders: Vec<std::path::PathBuf>,
}

/// The first lines of an MDI block, which restore the modes of earlier blocks, and the state that no line can
/// restore.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MdiPreamble {
    /// Number of lines. They do not change `active_spindle`.
    pub lines: u32,
    /// The spindle of threads and cycles without `$`.
    pub active_spindle: u32,
}

/// Offsets at the start of a program.
#[derive(Clone, Debug, PartialEq)]
pub struct StartOffsets {
    /// Work offsets G54 to G59.3: work zero in machine coordinates (mm, degrees).
    pub work: [Axes; WORK_OFFSETS],
    /// The active work offset, 0 for G54.
    pub active: usize,
    /// The offset of G92 from earlier programs, active from the start (mm, degrees).
    pub g92: Axes,
}

/// Features of the machine on which programs depend.
#[derive(Clone, Debug, PartialEq)]
pub struct MachineFeatures {
    /// Whether the machine is a lathe: G82 and G75 are its turning cycles.
    pub lathe: bool,
    /// Meaning of X, R and U in the turning cycles.
    pub turning_words: TurningWords,
    /// Whether G32 and G92 are Fanuc's threads; otherwise G32 is unknown, and G92 sets an offset.
    pub fanuc_threads: bool,
    /// Whether a cutting load is measured, which the load-adaptive passes of G82 Q1 and G75 Q1 need.
    pub load_channel: bool,
    /// The spindles that `$` can name, by number.
    pub spindles: [bool; SPINDLES],
    /// By spindle: whether axes can follow its angle, so that G84 and G74 tap rigidly
    /// ([`crate::Action::RigidTap`]).
    pub rigid_tapping: [bool; SPINDLES],
    /// The direction of G90 on each unlimited rotary axis; their coordinates count modulo 360 degrees.
    pub unlimited: [Option<RotaryDirection>; AXES],
    /// The user-defined M codes from M100 to M199, which are output with their words P and Q.
    pub user_codes: Vec<u32>,
    /// Maximum speed of each spindle (G96 at small radii), rpm; infinite if unknown.
    pub spindle_max_rpm: [f64; SPINDLES],
    /// The subroutine that executes M6; without one, M6 is output as [`crate::Action::ChangeTool`].
    pub tool_change: Option<ToolChanger>,
}

/// Limits of memory and time of a program.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ProgramLimits {
    /// Maximum length of a line, in bytes.
    pub max_line_bytes: usize,
    /// Maximum memory for the bodies of loops and subroutines, in bytes.
    pub max_body_bytes: usize,
    /// Maximum nesting depth of subroutines.
    pub max_call_depth: usize,
    /// Maximum number of lines executed without a command for the machine; more are an endless loop.
    pub max_silent_lines: u64,
    /// Maximum number of lines executed before the start line of a restart; more are an endless loop.
    pub max_lines_before_start: u64,
}

/// A tool changer operated by a subroutine. Its arguments: #1 the new tool (0 empties the spindle), #2 the
/// present one, #3 the pocket of the new tool, #4 the pocket for the present one (0 for none).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ToolChanger {
    /// Its name: `O<name> sub` in a file `name.ngc`, or the whole file.
    pub subroutine: String,
    /// Whether a tool is stored in the pocket of the tool that replaces it; otherwise in its own.
    pub is_random: bool,
}

/// The direction in which G90 turns an unlimited rotary axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RotaryDirection {
    /// The shorter direction; half a turn in the positive direction.
    Shorter,
    /// The sign of the word: without one in the positive direction, with a minus to the absolute value in the
    /// negative direction.
    Sign,
}

/// Meaning of X, R and U in a lathe's cycles G82 and G75.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TurningWords {
    /// Diameters.
    #[default]
    Diameter,
    /// Radii.
    Radius,
    /// Diameters in G7, radii in G8, as for all other X words.
    Mode,
}

/// Number of work offsets: G54 to G59, G59.1 to G59.3.
pub const WORK_OFFSETS: usize = 9;

/// When an arc in centre format is rejected. With `d` the difference of the radii at start and end: if
/// `d > 100 * absolute`, or if `d > absolute` and `d > relative * (larger radius)`. This is LinuxCNC's rule.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArcTolerance {
    /// Absolute tolerance while G21 is active, in mm.
    pub metric_mm: f64,
    /// Absolute tolerance while G20 is active, in mm (not inches).
    pub inch_mm: f64,
    /// Fraction of the radius.
    pub relative: f64,
    /// Minimum radius, and tolerance for an R that is too small; in mm.
    pub radius_mm: f64,
}

impl Default for ArcTolerance {
    /// LinuxCNC's values: end and centre rounded to 0.01 mm, or 0.001 inch, are always accepted.
    fn default() -> Self {
        Self {
            metric_mm: 2.0 * 0.01 * std::f64::consts::SQRT_2,
            inch_mm: 2.0 * 0.001 * std::f64::consts::SQRT_2 * 25.4,
            relative: 0.001,
            radius_mm: 0.00005 * 25.4,
        }
    }
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            start: Axes::zeros(),
            axes: [true; AXES],
            unhomed: [false; AXES],
            offsets: StartOffsets::default(),
            features: MachineFeatures::default(),
            limits: ProgramLimits::default(),
            path_mode: PathMode::Blend {
                tolerance_mm: None,
                merge_mm: None,
            },
            inches: false,
            plane: Plane::Xy,
            diameter: false,
            parameters_in_inches: false,
            block_delete: true,
            waits_succeed: false,
            probes_succeed: false,
            arc: ArcTolerance::default(),
            involute_tolerance_mm: 0.001,
            tool: 0,
            selected_tool: None,
            outputs: Outputs::default(),
            is_mdi: false,
            preamble: MdiPreamble::default(),
            tools: None,
            tools_without_table: false,
            parameters: Vec::new(),
            subroutine_folders: Vec::new(),
        }
    }
}

impl Default for StartOffsets {
    /// No offsets.
    fn default() -> Self {
        Self {
            work: [Axes::zeros(); WORK_OFFSETS],
            active: 0,
            g92: Axes::zeros(),
        }
    }
}

impl Default for MachineFeatures {
    /// A mill without any of them.
    fn default() -> Self {
        Self {
            lathe: false,
            turning_words: TurningWords::default(),
            fanuc_threads: false,
            load_channel: false,
            spindles: [true, false, false, false],
            rigid_tapping: [false; SPINDLES],
            unlimited: [None; AXES],
            user_codes: Vec::new(),
            spindle_max_rpm: [f64::INFINITY; SPINDLES],
            tool_change: None,
        }
    }
}

impl Default for ProgramLimits {
    /// Far beyond what programs need.
    fn default() -> Self {
        Self {
            max_line_bytes: 64 * 1024,
            max_body_bytes: 256 * 1024 * 1024,
            max_call_depth: 100,
            max_silent_lines: 10_000_000,
            max_lines_before_start: 100_000_000,
        }
    }
}

impl Settings {
    /// Factor that converts the program's value of a numbered parameter to the stored one.
    #[inline]
    pub(crate) fn parameter_mm(&self, index: usize) -> f64 {
        if self.parameters_in_inches && Parameters::is_stored_length(index) {
            INCH_MM
        } else {
            1.0
        }
    }
}
