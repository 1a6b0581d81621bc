//! Settings of a run.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use evolvent_config::ConfigDocument;
use evolvent_gcode as gcode;
use evolvent_machine::{
    ControlRate, LengthUnit, Machine, MachineKind, Magazine, PathMode, PeriodError, RotaryDirection,
    StartPlane, StartX, ToolChange, TurningWords, WithoutToolTable,
};
use evolvent_path::{AXES, Axes, AxisMask, Plane};
use evolvent_planner::{PathLimits, PathRules};
use evolvent_turning::TurningJob;

use crate::check::Warning;
use crate::input_script::InputScript;
use crate::memory::ProgramMemory;
use crate::rt::RealtimeRequest;

/// Which clock drives the cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Clock {
    /// Absolute deadlines of `CLOCK_MONOTONIC`.
    Realtime,
    /// As fast as the host computes: the same code, the same bits.
    Virtual,
}

impl Clock {
    /// The name on the command line and in traces.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Realtime => "realtime",
            Self::Virtual => "virtual",
        }
    }
}

/// A machine at a control rate, with everything that programs on it depend on.
#[derive(Clone, Debug)]
pub struct Setup {
    /// The machine.
    pub machine: Machine,
    /// Path of its file, and its text.
    pub machine_file: PathBuf,
    /// The file's text, attached to traces.
    pub machine_text: String,
    /// The control period.
    pub period_ns: u64,
    /// Tools, parameters and subroutines that programs use.
    pub memory: ProgramMemory,
    /// The line at which programs begin, if not the first.
    pub start_line: Option<u32>,
    /// Position of the machine in machine coordinates; home if `None`.
    pub position: Option<Axes>,
    /// Axes that are not homed, whose position above is meaningless. A program can then only be checked, not
    /// started.
    pub unhomed: AxisMask,
    /// The tool in the spindle; 0 for none.
    pub tool: u32,
    /// Tool that T has selected for the next M6, by MDI or in an earlier program.
    pub selected_tool: Option<u32>,
    /// Folder for the files that programs write; `None` if they write none.
    pub log_folder: Option<PathBuf>,
    /// Why no tool can be changed: an earlier change was interrupted, and the tool in the spindle was not
    /// declared.
    pub tool_unknown: Option<String>,
    /// Present state of spindle and coolant.
    pub outputs: gcode::Outputs,
    /// The program is a block of MDI, which leaves spindle and coolant unchanged at its end.
    pub is_mdi: bool,
    /// The state with which a block of MDI begins.
    pub restored: gcode::MdiPreamble,
    /// Whether lines that begin with `/` are skipped.
    pub block_delete: bool,
    /// Fraction of the axes' speed that rapids may use, 0 to 1.
    pub rapid_override: f64,
    /// Tool, force law, load and feeds of load-adaptive turning cycles; `None` without a process file.
    pub process: Option<Arc<TurningJob>>,
}

impl Setup {
    /// The real-time request of a thread of this machine: the cycle itself, or one `below` priorities lower.
    pub(crate) fn realtime_request(&self, below: u8) -> RealtimeRequest {
        let settings = &self.machine.realtime;
        RealtimeRequest {
            priority: Some(settings.priority.saturating_sub(below).max(1)),
            core: if below == 0 { settings.core } else { None },
            lock_memory: settings.lock_memory && below == 0,
        }
    }

    /// Combines a machine with a rate, or with the rate in its file.
    ///
    /// # Errors
    /// The rate is outside the range of the loop.
    pub fn new(
        machine: Machine,
        machine_file: PathBuf,
        machine_text: String,
        rate: Option<ControlRate>,
    ) -> Result<Self, PeriodError> {
        let period_ns = machine.period_ns(rate.unwrap_or(machine.rate))?;
        Ok(Self {
            machine,
            machine_file,
            machine_text,
            period_ns,
            memory: ProgramMemory::default(),
            start_line: None,
            position: None,
            unhomed: AxisMask::NONE,
            tool: 0,
            selected_tool: None,
            log_folder: None,
            tool_unknown: None,
            outputs: gcode::Outputs::default(),
            is_mdi: false,
            restored: gcode::MdiPreamble::default(),
            block_delete: false,
            rapid_override: 1.0,
            process: None,
        })
    }

    /// Warnings for subroutine folders in the machine file that do not exist. This is no error, because a
    /// disk may be mounted later.
    #[must_use]
    pub fn missing_folders(&self) -> Vec<Warning> {
        let beside = self.machine_file.parent().unwrap_or(Path::new(""));
        let file = self.machine_file.display().to_string();
        let document = ConfigDocument::toml(&self.machine_text, &file).ok();
        let folders = self.machine.program.subroutines.iter().enumerate();
        let missing = folders
            .map(|(index, folder)| (index, beside.join(folder)))
            .filter(|(_, folder)| !folder.is_dir());
        missing
            .map(|(index, folder)| {
                let key = format!("program.subroutines[{index}]");
                let line = document.as_ref().map_or(1, |document| document.line(&key));
                Warning {
                    file: Some(file.clone()),
                    line,
                    message: format!(
                        "{key}: there is no folder {}, so no subroutine is found there: create it, or \
                         correct the path",
                        folder.display()
                    ),
                }
            })
            .collect()
    }

    /// Sets the folder for files that programs write: that of the machine file, or else `logs` in the state
    /// folder.
    #[must_use]
    pub fn logging(mut self, state_folder: &Path) -> Self {
        let beside = self.machine_file.parent().unwrap_or(Path::new(""));
        self.log_folder = Some(match &self.machine.program.log_folder {
            Some(folder) => beside.join(folder),
            None => state_folder.join("logs"),
        });
        self
    }

    /// Position at which programs begin.
    #[must_use]
    pub fn start(&self) -> Axes {
        self.position.unwrap_or(self.machine.limits().home)
    }

    /// The control rate.
    #[must_use]
    pub fn rate_hz(&self) -> f64 {
        1e9 / self.period_ns as f64
    }

    /// Limits along the path.
    #[must_use]
    pub fn path_limits(&self) -> PathLimits {
        PathLimits::new(self.machine.limits(), self.rate_hz(), self.chord_error_mm())
    }

    /// Permitted distance between the chord of two setpoints and the path, mm.
    pub(crate) fn chord_error_mm(&self) -> f64 {
        self.machine.path.chord_error_increments / self.machine.increments_per_mm
    }

    /// Rules for following the path, initially planned for this feed override.
    #[must_use]
    pub fn path_rules(&self, feed_override: f64) -> PathRules {
        PathRules {
            blend_tolerance_mm: self.machine.path.blend_tolerance_mm,
            joint_time_s: self.machine.path.joint_time_s,
            planner: self.machine.path.planner,
            feed_override,
        }
    }

    /// Like [`Setup::interpreter_settings`] for a program in a file: its folder is searched for subroutines.
    #[must_use]
    pub fn interpreter_settings_for(&self, program: &Path) -> gcode::Settings {
        let folder = program.parent().map(Path::to_path_buf);
        gcode::Settings {
            subroutine_folders: folder
                .into_iter()
                .chain(self.memory.folders.iter().cloned())
                .collect(),
            ..self.interpreter_settings()
        }
    }

    fn features(&self) -> gcode::MachineFeatures {
        let mut unlimited = [None; AXES];
        for axis in &self.machine.axes {
            unlimited[axis.letter.index()] = axis.unlimited.map(|direction| match direction {
                RotaryDirection::Shorter => gcode::RotaryDirection::Shorter,
                RotaryDirection::Sign => gcode::RotaryDirection::Sign,
            });
        }
        let program = &self.machine.program;
        gcode::MachineFeatures {
            tool_change: (program.tool_change == ToolChange::Subroutine).then(|| gcode::ToolChanger {
                subroutine: program.tool_change_subroutine.clone(),
                is_random: program.magazine == Magazine::Random,
            }),
            unlimited,
            user_codes: program.user_codes.clone(),
            lathe: self.machine.kind == MachineKind::Lathe,
            fanuc_threads: program.fanuc_threads,
            turning_words: match program.turning_cycles {
                TurningWords::Diameter => gcode::TurningWords::Diameter,
                TurningWords::Radius => gcode::TurningWords::Radius,
                TurningWords::Mode => gcode::TurningWords::Mode,
            },
            load_channel: program.load_channel,
            spindles: self.spindles(),
            spindle_max_rpm: self.machine.signals.max_rpm(),
            rigid_tapping: std::array::from_fn(|number| {
                let spindle = self.machine.signals.spindle(number as u32);
                spindle.is_some_and(|spindle| spindle.has_feedback())
            }),
        }
    }

    /// The spindles that a program can use: those of the machine file, or spindle 0 if it has none.
    fn spindles(&self) -> [bool; gcode::SPINDLES] {
        let signals = &self.machine.signals;
        std::array::from_fn(|number| match signals.spindles.is_empty() {
            true => number == 0,
            false => signals.spindle(number as u32).is_some(),
        })
    }

    /// Everything that the interpreter needs before the first line.
    #[must_use]
    pub fn interpreter_settings(&self) -> gcode::Settings {
        let limits = self.machine.limits();
        let path = &self.machine.path;
        let mut axes = [false; AXES];
        axes.copy_from_slice(&limits.present);
        let program = &self.machine.program;
        let mut settings = gcode::Settings {
            tools: self.memory.tools.clone(),
            features: self.features(),
            subroutine_folders: self.memory.folders.clone(),
            start: self.start(),
            unhomed: std::array::from_fn(|axis| self.unhomed.contains(axis)),
            tool: self.tool,
            selected_tool: self.selected_tool,
            outputs: self.outputs,
            is_mdi: self.is_mdi,
            preamble: self.restored,
            inches: program.start_unit == LengthUnit::Inch,
            plane: match program.start_plane {
                StartPlane::Xy => Plane::Xy,
                StartPlane::Zx => Plane::Zx,
                StartPlane::Yz => Plane::Yz,
            },
            diameter: program.start_x == StartX::Diameter,
            parameters_in_inches: program.parameter_unit == LengthUnit::Inch,
            tools_without_table: program.without_tool_table == WithoutToolTable::Zero,
            block_delete: self.block_delete,
            axes,
            path_mode: match path.mode {
                PathMode::Exact => gcode::PathMode::ExactPath,
                PathMode::Blend => gcode::PathMode::Blend {
                    tolerance_mm: None,
                    merge_mm: None,
                },
            },
            arc: gcode::ArcTolerance {
                metric_mm: path.arc_radius_tolerance_mm,
                // An inch program is rounded to a thousandth of an inch instead of a hundredth of a
                // millimetre.
                inch_mm: 2.54 * path.arc_radius_tolerance_mm,
                relative: path.arc_radius_tolerance_ratio,
                ..gcode::ArcTolerance::default()
            },
            involute_tolerance_mm: path.involute_end_tolerance_mm,
            ..gcode::Settings::default()
        };
        if let Some(kept) = &self.memory.kept {
            kept.apply(&mut settings);
        }
        settings
    }
}

/// One run of one program.
#[derive(Clone, Debug)]
pub struct Job {
    /// The program's file.
    pub program: PathBuf,
    /// The machine with its rate.
    pub setup: Setup,
    /// The clock that drives the cycle.
    pub clock: Clock,
    /// Feed override at the start; 1 is 100 %.
    pub feed_override: f64,
    /// File for the trace; `None` for no trace.
    pub trace: Option<PathBuf>,
    /// Whether setpoints are published on the bus.
    pub bus: bool,
    /// Prefix of iceoryx2; `None` for iceoryx2's default.
    pub bus_prefix: Option<String>,
    /// Number of setpoint subscribers to wait for before the start, for at most 10 s.
    pub wait_for_subscribers: usize,
    /// Number of setpoint subscribers of this process itself, such as the screen: they are neither waited for
    /// nor counted as listeners.
    pub own_subscribers: usize,
    /// Inputs over the course of a run with the virtual clock; if `None`, all are unknown except a closed
    /// emergency-stop chain.
    pub inputs: Option<InputScript>,
    /// Stop at M1.
    pub optional_stop: bool,
    /// Wait at M0, M1 and M60 until resumed; otherwise continue at once.
    pub stop_at_program_stops: bool,
}

impl Job {
    /// A job with the virtual clock, without trace, bus or stops, at 100 %.
    #[must_use]
    pub fn new(program: PathBuf, setup: Setup) -> Self {
        Self {
            program,
            setup,
            clock: Clock::Virtual,
            feed_override: 1.0,
            trace: None,
            bus: false,
            bus_prefix: None,
            wait_for_subscribers: 0,
            own_subscribers: 0,
            inputs: None,
            optional_stop: false,
            stop_at_program_stops: false,
        }
    }

    /// Whether the clock is real.
    pub(crate) fn is_realtime(&self) -> bool {
        self.clock == Clock::Realtime
    }
}
