//! The modal state.

use evolvent_path::{AXES, Axes, AxisLetter, Plane, SurfaceSpeed, angle_within_turn};

use crate::codes::modal_groups::{Compensation, FeedMode, Motion, PlaneCode};
use crate::execution::compensation::CutterState;
use crate::execution::cycles::fanuc_threads::FanucThread;
use crate::parameters::system::System;
use crate::parameters::values::{G92, G92_ACTIVE, Parameters, WORK_OFFSET, WORK_OFFSET_1};
use crate::state::rotation::{Rotation, rotate, rotate_back, rotation_of};
use crate::state::tool_pockets::ToolPockets;
use crate::{Action, PathMode, SPINDLES, Settings, SpindleDirection, SpindleOutput};

/// Millimetres per inch.
pub(crate) const INCH_MM: f64 = 25.4;

/// The active F word as a feed, which a later G20 or G21 does not change. Its unit depends on the feed mode
/// in which it was read, so it can only be read with its unit.
#[derive(Clone, Copy, Debug)]
pub(crate) enum ProgrammedFeed {
    /// G94.
    PerMinute {
        /// As written.
        word: f64,
        /// For motion of linear axes.
        linear_mm_s: f64,
    },
    /// G95.
    PerRevolution {
        /// As written; for motion of rotary axes only, degrees per revolution.
        word: f64,
        /// For motion of linear axes.
        linear_mm_rev: f64,
    },
}

impl ProgrammedFeed {
    /// As written.
    pub(crate) fn word(&self) -> f64 {
        match *self {
            Self::PerMinute { word, .. } | Self::PerRevolution { word, .. } => word,
        }
    }

    pub(crate) fn is_zero(&self) -> bool {
        match *self {
            Self::PerMinute {
                linear_mm_s: linear, ..
            }
            | Self::PerRevolution {
                linear_mm_rev: linear,
                ..
            } => linear <= 0.0,
        }
    }

    /// Whether the word was in mm, not in inches.
    pub(crate) fn is_metric(&self) -> bool {
        let (linear, rotary) = match *self {
            Self::PerMinute { word, linear_mm_s } => (linear_mm_s, word / 60.0),
            Self::PerRevolution { word, linear_mm_rev } => (linear_mm_rev, word),
        };
        (linear - rotary).abs() <= 1e-9 * rotary.abs()
    }

    /// mm/s, or degrees/s for motion of rotary axes only, with the spindle at `rpm`.
    pub(crate) fn per_second(&self, rotary: bool, rpm: impl FnOnce() -> f64) -> f64 {
        match *self {
            Self::PerMinute { word, .. } if rotary => word / 60.0,
            Self::PerMinute { linear_mm_s, .. } => linear_mm_s,
            Self::PerRevolution { .. } => self.per_revolution(rotary).unwrap_or(0.0) * rpm() / 60.0,
        }
    }

    /// In G95: mm, or degrees for motion of rotary axes only, per revolution.
    pub(crate) fn per_revolution(&self, rotary: bool) -> Option<f64> {
        match *self {
            Self::PerMinute { .. } => None,
            Self::PerRevolution { word, .. } if rotary => Some(word),
            Self::PerRevolution { linear_mm_rev, .. } => Some(linear_mm_rev),
        }
    }
}

/// The active S word.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum ProgrammedSpeed {
    /// G97.
    Rpm(f64),
    /// G96.
    Surface {
        speed_m_min: f64,
        /// Maximum spindle speed.
        max_rpm: f64,
    },
}

impl ProgrammedSpeed {
    /// Revolutions or metres per minute.
    pub(crate) fn word(self) -> f64 {
        match self {
            Self::Rpm(word)
            | Self::Surface {
                speed_m_min: word, ..
            } => word,
        }
    }

    pub(crate) fn is_surface(self) -> bool {
        matches!(self, Self::Surface { .. })
    }
}

/// The settings of one spindle by the program.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SpindleModes {
    pub(crate) direction: SpindleDirection,
    pub(crate) speed: ProgrammedSpeed,
    /// X of the spindle centre that was output last, machine coordinates.
    pub(crate) output_centre_mm: f64,
    /// The angle at which M19 holds it until its next command.
    pub(crate) orientation: Option<SpindleAngle>,
}

/// The words of M19.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SpindleAngle {
    pub(crate) degrees: f64,
    /// `None` for the shorter direction.
    pub(crate) direction: Option<SpindleDirection>,
    /// 0 for none.
    pub(crate) timeout_s: f64,
}

impl SpindleAngle {
    pub(crate) fn action(self, spindle: usize) -> Action {
        Action::OrientSpindle {
            spindle: spindle as u32,
            degrees: self.degrees,
            direction: self.direction,
            timeout_s: self.timeout_s,
        }
    }
}

impl SpindleModes {
    /// At the start of a program, or of an MDI block.
    fn new(output: &SpindleOutput, is_mdi: bool) -> Self {
        // A program starts in G97, where metres per minute are not a speed; an MDI block continues in the
        // active mode.
        let surface = output.surface.filter(|_| is_mdi);
        Self {
            direction: output.direction,
            speed: match (surface, output.surface) {
                (Some(surface), _) => ProgrammedSpeed::Surface {
                    speed_m_min: surface.speed_m_min,
                    max_rpm: surface.max_rpm,
                },
                (None, Some(_)) => ProgrammedSpeed::Rpm(0.0),
                (None, None) => ProgrammedSpeed::Rpm(output.speed_rpm),
            },
            output_centre_mm: surface.map_or(0.0, |surface| surface.centre_mm),
            orientation: None,
        }
    }

    pub(crate) fn is_rotating(&self) -> bool {
        self.direction != SpindleDirection::Stopped
    }

    /// As an output, with the centre of the radius of G96 at this X in machine coordinates, mm.
    fn output(&self, centre_mm: f64) -> SpindleOutput {
        let (speed_rpm, surface) = match self.speed {
            ProgrammedSpeed::Rpm(speed_rpm) => (speed_rpm, None),
            ProgrammedSpeed::Surface { speed_m_min, max_rpm } => {
                let surface = SurfaceSpeed {
                    speed_m_min,
                    max_rpm,
                    centre_mm,
                };
                (0.0, Some(surface))
            }
        };
        SpindleOutput {
            direction: self.direction,
            speed_rpm,
            surface,
        }
    }
}

/// The modes saved by M70 and restored by M72.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Modes {
    pub(crate) plane: PlaneCode,
    pub(crate) inches: bool,
    pub(crate) incremental: bool,
    pub(crate) arc_centre_absolute: bool,
    pub(crate) feed_mode: FeedMode,
    pub(crate) feed: Option<ProgrammedFeed>,
    pub(crate) path_mode: PathMode,
    pub(crate) work_index: usize,
    pub(crate) retract_to_initial: bool,
    pub(crate) diameter: bool,
    pub(crate) spindles: [SpindleModes; SPINDLES],
    /// The spindle that G95 refers to.
    pub(crate) feed_spindle: usize,
    /// The spindle of threads and cycles: of the last `$` with one of them, and of the last G93 to G97.
    pub(crate) active_spindle: usize,
    pub(crate) mist: bool,
    pub(crate) flood: bool,
    pub(crate) feed_override: bool,
    pub(crate) spindle_override: [bool; SPINDLES],
    pub(crate) adaptive: Option<bool>,
    pub(crate) feed_stop: bool,
}

/// Words of a canned cycle that stay active over consecutive lines of the cycle; mm in program coordinates
/// along the axis of the cycle.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct CycleModal {
    pub(crate) r: Option<f64>,
    pub(crate) depth: Option<f64>,
    pub(crate) q: Option<f64>,
    pub(crate) p: Option<f64>,
    /// Height of the tool before the first line of this and other cycles without another motion between them.
    pub(crate) initial_height: f64,
    /// Index of the axis of the holes.
    pub(crate) drill_axis: usize,
    /// The active cycle.
    pub(crate) active: Option<Motion>,
}

/// All state between lines. `Copy`: a line works on a copy, which replaces the original only if the whole
/// line is valid.
#[derive(Clone, Copy, Debug)]
pub(crate) struct State {
    /// Machine coordinates, mm and degrees.
    pub(crate) position: Axes,
    pub(crate) motion: Motion,
    pub(crate) modes: Modes,
    /// Work zero of the active offset, machine coordinates.
    pub(crate) work: Axes,
    /// Rotation of the work's XY about its zero: degrees, cosine, sine.
    pub(crate) rotation: Rotation,
    /// Active offset of G92 and G52; rotated with the work.
    pub(crate) g92: Axes,
    pub(crate) tool_offset: Axes,
    pub(crate) tool: u32,
    pub(crate) selected_tool: Option<u32>,
    /// Pockets of the tool in the spindle and of the selected one by the tool table in force; -1 for none.
    pub(crate) pockets: ToolPockets,
    /// The tool-change subroutine is active.
    pub(crate) is_changing_tool: bool,
    pub(crate) cycle: CycleModal,
    /// P and Q of the last G5, mm; the next one may continue its tangent.
    pub(crate) spline_end: Option<[f64; 2]>,
    /// Modal words of Fanuc's threads.
    pub(crate) fanuc_thread: FanucThread,
    /// The order of the NURBS that G5.2 defines.
    pub(crate) nurbs_order: Option<usize>,
    pub(crate) cutter: CutterState,
    /// The last motion was a probing move whose result has not been reported.
    pub(crate) is_probed: bool,
    /// G99 was used without a cycle, as lathes of other dialects do for feed per revolution.
    pub(crate) is_g99_alone: bool,
    /// Whether M2 or M30 has been executed.
    pub(crate) ended: bool,
    /// Unlimited rotary axes.
    pub(crate) unlimited: [bool; AXES],
}

/// The part of the state that a plain move changes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PlainMoveState {
    position: Axes,
    motion: Motion,
    feed: Option<ProgrammedFeed>,
    active_cycle: Option<Motion>,
    spline_end: Option<[f64; 2]>,
}

impl State {
    pub(crate) fn new(settings: &Settings) -> Self {
        let outputs = &settings.outputs;
        let mut state = Self {
            position: settings.start,
            motion: Motion::None,
            modes: Modes {
                plane: PlaneCode::Main(settings.plane),
                inches: settings.inches,
                incremental: false,
                arc_centre_absolute: false,
                feed_mode: FeedMode::PerMinute,
                feed: None,
                path_mode: settings.path_mode,
                work_index: settings.offsets.active.min(settings.offsets.work.len() - 1),
                retract_to_initial: false,
                diameter: settings.diameter,
                spindles: outputs
                    .spindles
                    .map(|output| SpindleModes::new(&output, settings.is_mdi)),
                feed_spindle: 0,
                active_spindle: (settings.preamble.active_spindle as usize).min(SPINDLES - 1),
                mist: outputs.mist,
                flood: outputs.flood,
                feed_override: true,
                spindle_override: [true; SPINDLES],
                adaptive: None,
                feed_stop: true,
            },
            work: Axes::zeros(),
            rotation: [0.0, 1.0, 0.0],
            g92: settings.offsets.g92,
            tool_offset: Axes::zeros(),
            tool: settings.tool,
            selected_tool: settings.selected_tool,
            pockets: ToolPockets::of(settings.tool, settings.selected_tool, settings.tools.as_ref()),
            is_changing_tool: false,
            cycle: CycleModal::default(),
            spline_end: None,
            fanuc_thread: FanucThread::default(),
            nurbs_order: None,
            cutter: CutterState::default(),
            is_probed: false,
            is_g99_alone: false,
            ended: false,
            unlimited: settings.features.unlimited.map(|direction| direction.is_some()),
        };
        state.work = settings.offsets.work[state.modes.work_index];
        state
    }

    /// Whether a straight move changes only [`State::plain_move_state`].
    #[inline]
    pub(crate) fn is_plain(&self) -> bool {
        !self.cutter.is_on() && self.cutter.programmed.is_none() && self.cutter.held.is_none()
    }

    /// The state that a plain move changes before it may fail.
    #[inline]
    pub(crate) fn plain_move_state(&self) -> PlainMoveState {
        PlainMoveState {
            position: self.position,
            motion: self.motion,
            feed: self.modes.feed,
            active_cycle: self.cycle.active,
            spline_end: self.spline_end,
        }
    }

    pub(crate) fn restore_plain_move_state(&mut self, plain_move_state: PlainMoveState) {
        self.position = plain_move_state.position;
        self.motion = plain_move_state.motion;
        self.modes.feed = plain_move_state.feed;
        self.cycle.active = plain_move_state.active_cycle;
        self.spline_end = plain_move_state.spline_end;
    }

    /// Writes the offsets and the tool of the settings to the parameters.
    pub(crate) fn publish(&self, settings: &Settings, parameters: &mut Parameters) {
        for (index, offset) in settings.offsets.work.iter().enumerate() {
            parameters.set_axes(WORK_OFFSET_1 + 20 * index, offset);
        }
        parameters.set_numbered(WORK_OFFSET, (self.modes.work_index + 1) as f64);
        let active = self.g92 != Axes::zeros();
        parameters.set_numbered(G92_ACTIVE, f64::from(u8::from(active)));
        if active {
            // Otherwise the parameters hold a suspended offset, which G92.3 restores.
            parameters.set_axes(G92, &self.g92);
        }
        parameters.set_numbered(crate::parameters::values::TOOL, f64::from(self.tool));
        parameters.set_numbered(crate::parameters::values::DEBUG, 1.0);
    }

    /// Reads the active work offset from the parameters.
    pub(crate) fn load_work(&mut self, parameters: &Parameters) {
        let first = WORK_OFFSET_1 + 20 * self.modes.work_index;
        self.work = parameters.axes(first);
        self.rotation = rotation_of(parameters.numbered(first + AXES));
    }

    /// The plane for arcs; `None` for G17.1 and similar.
    pub(crate) fn plane(&self) -> Option<Plane> {
        match self.modes.plane {
            PlaneCode::Main(plane) => Some(plane),
            PlaneCode::Secondary(_) => None,
        }
    }

    /// Millimetres per unit of length.
    pub(crate) fn unit_mm(&self) -> f64 {
        if self.modes.inches { INCH_MM } else { 1.0 }
    }

    /// Millimetres or degrees per program unit of an axis.
    pub(crate) fn axis_unit(&self, index: usize) -> f64 {
        if AxisLetter::ALL[index].is_rotary() {
            1.0
        } else {
            self.unit_mm()
        }
    }

    /// The same for a word: in G7 X is a diameter.
    pub(crate) fn word_unit(&self, index: usize) -> f64 {
        if index == 0 && self.modes.diameter {
            0.5 * self.unit_mm()
        } else {
            self.axis_unit(index)
        }
    }

    fn is_rotated(&self) -> bool {
        self.rotation[0] != 0.0
    }

    /// Converts a vector from program to machine coordinates.
    pub(crate) fn rotate(&self, vector: Axes) -> Axes {
        rotate(self.rotation, vector)
    }

    /// Converts a vector from machine to program coordinates.
    pub(crate) fn rotate_back(&self, vector: Axes) -> Axes {
        rotate_back(self.rotation, vector)
    }

    /// Converts a point from program coordinates (mm, degrees) to machine coordinates.
    pub(crate) fn program_to_machine(&self, program: Axes) -> Axes {
        if self.is_rotated() {
            return self.rotate(program + self.g92) + self.work + self.tool_offset;
        }
        // This order gives the same bits as sums without tool length.
        self.work + self.g92 + self.tool_offset + program
    }

    /// The command for a spindle.
    pub(crate) fn spindle_action(&self, spindle: usize) -> Action {
        self.spindle_output(spindle).action(spindle as u32)
    }

    fn spindle_output(&self, spindle: usize) -> SpindleOutput {
        self.modes.spindles[spindle].output(self.centre_mm())
    }

    /// X of the program zero in machine coordinates: the centre of the spindle.
    pub(crate) fn centre_mm(&self) -> f64 {
        self.program_to_machine(Axes::zeros())[0]
    }

    /// Speed of a spindle while it rotates, at the position of the tool.
    pub(crate) fn rpm(&self, spindle: usize) -> f64 {
        self.spindle_output(spindle).speed().rpm_at(self.position[0])
    }

    /// Speed of the spindle that G95 refers to.
    pub(crate) fn feed_rpm(&self) -> f64 {
        self.rpm(self.modes.feed_spindle)
    }

    /// Converts a point from machine coordinates to program coordinates (mm, degrees).
    pub(crate) fn machine_to_program(&self, machine: Axes) -> Axes {
        if self.is_rotated() {
            return self.rotate_back(machine - self.work - self.tool_offset) - self.g92;
        }
        machine - (self.work + self.g92 + self.tool_offset)
    }

    /// Indices of the axes of the plane.
    pub(crate) fn plane_axes(&self) -> [usize; 2] {
        match self.modes.plane {
            PlaneCode::Main(plane) => {
                let (first, second, _) = plane.axes();
                [first, second]
            }
            PlaneCode::Secondary(Plane::Xy) => [6, 7],
            PlaneCode::Secondary(Plane::Zx) => [6, 8],
            PlaneCode::Secondary(Plane::Yz) => [7, 8],
        }
    }

    /// The reference of a program's words: the programmed point, not the centre of a compensated tool.
    pub(crate) fn programmed(&self) -> Axes {
        self.cutter.programmed.unwrap_or(self.position)
    }

    /// Position of an axis in program coordinates and units.
    pub(crate) fn program_position(&self, axis: usize) -> f64 {
        let position = self.machine_to_program(self.programmed())[axis] / self.axis_unit(axis);
        self.within_turn(axis, position)
    }

    /// Position of an axis in machine coordinates, in program units.
    pub(crate) fn machine_position(&self, axis: usize) -> f64 {
        self.within_turn(axis, self.position[axis] / self.axis_unit(axis))
    }

    /// A coordinate as programs read it: 0 to below 360 degrees for an unlimited rotary axis.
    fn within_turn(&self, axis: usize, position: f64) -> f64 {
        if self.unlimited[axis] {
            angle_within_turn(position)
        } else {
            position
        }
    }

    /// A predefined parameter.
    pub(crate) fn system(&self, system: System) -> f64 {
        let flag = |yes: bool| f64::from(u8::from(yes));
        let modes = &self.modes;
        // The spindle that a thread without `$` follows. LinuxCNC uses spindle 0.
        let spindle = &modes.spindles[modes.active_spindle];
        match system {
            System::Absolute => flag(!modes.incremental),
            System::Incremental => flag(modes.incremental),
            System::AdaptiveFeed => flag(modes.adaptive == Some(true)),
            System::CutterCompensation => match self.cutter.code {
                Compensation::Off => 400.0,
                Compensation::On { left, dynamic } => {
                    let side = if left { 410.0 } else { 420.0 };
                    side + flag(dynamic)
                }
            },
            System::Coordinates => match modes.work_index {
                index @ 0..=5 => 540.0 + 10.0 * index as f64,
                index => 591.0 + (index - 6) as f64,
            },
            System::CurrentTool => f64::from(self.tool),
            System::SelectedTool => self.selected_tool.map_or(-1.0, f64::from),
            System::CurrentPocket => self.pockets.current,
            System::SelectedPocket => self.pockets.selected,
            System::Feed => modes.feed.map_or(0.0, |feed| feed.word()),
            System::FeedHold => flag(modes.feed_stop),
            System::FeedOverride => flag(modes.feed_override),
            System::SpeedOverride => flag(modes.spindle_override[modes.active_spindle]),
            System::Flood => flag(modes.flood),
            System::Mist => flag(modes.mist),
            System::CentreAbsolute => flag(modes.arc_centre_absolute),
            System::Imperial => flag(modes.inches),
            System::Metric => flag(!modes.inches),
            System::InverseTime => flag(modes.feed_mode == FeedMode::InverseTime),
            System::UnitsPerMinute => flag(modes.feed_mode == FeedMode::PerMinute),
            System::UnitsPerRevolution => flag(modes.feed_mode == FeedMode::PerRevolution),
            System::LatheDiameter => flag(modes.diameter),
            System::LatheRadius => flag(!modes.diameter),
            System::MotionMode => match self.motion {
                Motion::None => 800.0,
                motion => motion.tenths(),
            },
            System::Plane => match modes.plane {
                PlaneCode::Main(plane) => plane_number(plane),
                PlaneCode::Secondary(plane) => plane_number(plane) + 1.0,
            },
            System::RetractOldZ => flag(modes.retract_to_initial),
            System::RetractRPlane => flag(!modes.retract_to_initial),
            System::Rpm => spindle.speed.word(),
            System::SpindleConstantSurface => flag(spindle.speed.is_surface()),
            System::SpindleRpmMode => flag(!spindle.speed.is_surface()),
            System::SpindleClockwise => flag(spindle.direction == SpindleDirection::Clockwise),
            System::SpindleOn => flag(spindle.is_rotating()),
            System::ToolOffset => flag(self.tool_offset != Axes::zeros()),
            // The version of LinuxCNC whose language this is.
            System::VersionMajor => 2.9,
            // M6 by a subroutine is the only code that can be replaced.
            System::RemapLevel => flag(self.is_changing_tool),
            // The executing task: not applicable.
            _ => 0.0,
        }
    }
}

fn plane_number(plane: Plane) -> f64 {
    match plane {
        Plane::Xy => 170.0,
        Plane::Zx => 180.0,
        Plane::Yz => 190.0,
    }
}
