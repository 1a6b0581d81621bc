//! What the interpreter has to know of the machine and the set-up before the first line.

use evolvent_path::{AXES, Axes};

use crate::{Outputs, PathMode, ToolTable};

/// Set-up at the start of a program. [`Settings::default`] is a machine of nine axes standing at zero.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Where the machine stands, machine coordinates (mm, degrees).
    pub start: Axes,
    /// Which axes exist. A word for any other is an error.
    pub axes: [bool; AXES],
    /// Work offsets G54 to G59.3: work zero in machine coordinates (mm, degrees).
    pub work_offsets: [Axes; WORK_OFFSETS],
    /// Which of them is active, 0 for G54.
    pub active_offset: usize,
    /// The offset of G92 that earlier programs left, applied from the start (mm, degrees).
    pub g92_offset: Axes,
    /// Path control before the first G61 or G64.
    pub path_mode: PathMode,
    /// Whether the program starts in inches (G20) rather than mm (G21).
    pub inches: bool,
    /// Whether lines that begin with `/` are left out.
    pub block_delete: bool,
    /// #5399 of a wait (M66) that nobody answers is what was waited for; otherwise -1, as after a timeout.
    pub waits_succeed: bool,
    /// By how much an arc's radius at the end may differ from that at the start.
    pub arc: ArcTolerance,
    /// By how much an involute's programmed end may be off the involute, in mm: one increment, at least 1 um.
    pub involute_tolerance_mm: f64,
    /// Longest line that is accepted, in bytes.
    pub max_line_bytes: usize,
    /// Tool in the spindle at the start; 0 for none.
    pub tool: u32,
    /// Tool that a T word before has selected for the next M6.
    pub selected_tool: Option<u32>,
    /// Spindle and coolant at the start.
    pub outputs: Outputs,
    /// The text is a block of MDI: where it ends without M2 or M30, spindle and coolant stay as they are.
    pub is_block: bool,
    /// How M6 is carried out by a subroutine; otherwise it is handed on ([`crate::Action::ChangeTool`]).
    pub tool_change: Option<ToolChanger>,
    /// The tool table. Without one, an offset or diameter of any tool but 0 is an error ([`crate::Code::UnknownTool`]).
    pub tools: Option<ToolTable>,
    /// Without a tool table, offsets and diameters of all tools are 0, and the program says so in a message.
    pub tools_without_table: bool,
    /// Values of numbered parameters that earlier runs left. Those that the fields above tell (offsets, tool) are
    /// overwritten by them.
    pub parameters: Vec<(u32, f64)>,
    /// Which of M100 to M199 exist: the machine's own commands, handed on with their words P and Q.
    pub user_codes: Vec<u32>,
    /// The machine is a lathe: G82 and G75 are its turning cycles.
    pub lathe: bool,
    /// What X, R and U of the turning cycles are.
    pub turning_words: TurningWords,
    /// A cutting load is measured, so that G82 Q1 and G75 Q1 may find their passes themselves.
    pub load_channel: bool,
    /// Axes can follow the angle of the spindle, so that G84 and G74 tap rigidly ([`crate::Action::RigidTap`]).
    pub rigid_tapping: bool,
    /// The spindle turns no faster (G96 at small radii), rpm; infinite where nothing is known of it.
    pub spindle_max_rpm: f64,
    /// Where files of subroutines are looked for, in this order: `NAME.ngc` for `O<NAME> call`.
    pub subroutine_folders: Vec<std::path::PathBuf>,
    /// Most memory for the bodies of loops and subroutines, in bytes.
    pub max_body_bytes: usize,
    /// How deep subroutines may be nested.
    pub max_call_depth: usize,
    /// How many lines may be executed without anything to do for the machine: beyond that it is an endless loop.
    pub max_silent_lines: u64,
    /// How many lines may be executed before the line at which a program begins: beyond that they go round for ever.
    pub max_lines_before_start: u64,
}

/// A tool changer that a subroutine operates. Its arguments: #1 the new tool (0 empties the spindle), #2 the present one, #3
/// the pocket of the new tool, #4 the pocket for the present one (0 for nowhere).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ToolChanger {
    /// Its name: `O<name> sub` in a file `name.ngc`, or the whole file.
    pub subroutine: String,
    /// A tool goes back into the pocket of the one that is taken; otherwise into its own.
    pub is_random: bool,
}

/// What X, R and U of a lathe's cycles G82 and G75 are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TurningWords {
    /// Diameters.
    #[default]
    Diameter,
    /// Radii.
    Radius,
    /// Diameters in G7, radii in G8, as all other X words.
    Mode,
}

/// How many work offsets there are: G54 to G59, G59.1 to G59.3.
pub const WORK_OFFSETS: usize = 9;

/// When an arc in centre format is refused. With `d` the difference of the radii at start and end, that is
/// when `d > 100 * absolute`, or when `d > absolute` and `d > relative * (greater radius)`: LinuxCNC's rule.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArcTolerance {
    /// Absolute tolerance while G21 is active, in mm.
    pub metric_mm: f64,
    /// Absolute tolerance while G20 is active, in mm (not inches).
    pub inch_mm: f64,
    /// Share of the radius.
    pub relative: f64,
    /// Radii below this are no arc, and R may be too short by as much; in mm.
    pub radius_mm: f64,
}

impl Default for ArcTolerance {
    /// LinuxCNC's figures: end and centre rounded to 0.01 mm, or 0.001 inch, always pass.
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
            work_offsets: [Axes::zeros(); WORK_OFFSETS],
            active_offset: 0,
            g92_offset: Axes::zeros(),
            path_mode: PathMode::Blend {
                tolerance_mm: None,
                merge_mm: None,
            },
            inches: false,
            block_delete: true,
            waits_succeed: false,
            arc: ArcTolerance::default(),
            involute_tolerance_mm: 0.001,
            spindle_max_rpm: f64::INFINITY,
            max_line_bytes: 64 * 1024,
            tool: 0,
            selected_tool: None,
            outputs: Outputs::default(),
            is_block: false,
            tool_change: None,
            tools: None,
            tools_without_table: false,
            parameters: Vec::new(),
            user_codes: Vec::new(),
            lathe: false,
            turning_words: TurningWords::default(),
            load_channel: false,
            rigid_tapping: false,
            subroutine_folders: Vec::new(),
            max_body_bytes: 256 * 1024 * 1024,
            max_call_depth: 100,
            max_silent_lines: 10_000_000,
            max_lines_before_start: 100_000_000,
        }
    }
}

impl Settings {
    /// The pocket of a tool.
    pub(crate) fn pocket(&self, tool: u32) -> Option<u32> {
        self.tools.as_ref()?.get(tool).map(|tool| tool.pocket)
    }
}
