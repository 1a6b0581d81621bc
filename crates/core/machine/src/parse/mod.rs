//! From text to a checked machine, with the position of every error.
//!
//! The text is parsed once into a table that keeps the position of every key. Serde reads that table into the
//! types of `file.rs` (unknown keys, missing keys, wrong types). Then the numbers are checked here; an
//! invalid one is located in the table by its dotted key.

mod axes;
mod corrections;
mod handwheel;
mod homing;
mod numbers;
mod plausible;
mod signals;

use std::path::PathBuf;

use evolvent_config::{ConfigDocument, shortened};

use self::corrections::ReadFile;
use crate::error::MachineError;
use crate::file::{DrivesFile, MachineFile, ProgramFile};
use crate::machine::{
    ControlRate, DEFAULT_TOOL_CHANGE_SUBROUTINE, DriveSettings, Lead, MAX_RATE_HZ, MIN_RATE_HZ, Machine,
    Magazine, PathMode, PathSettings, ProgramSettings, RealtimeSettings, ToolChange, TraceSettings,
};
use crate::rate::DEFAULT_MIN_RADIUS_MM;

/// Maximum of any number, in mm, degrees and seconds; positions in increments then fit into 63 bits.
const MAX_NUMBER: f64 = 1e9;
/// Minimum of any limit or grid, in mm, degrees and seconds.
const MIN_NUMBER: f64 = 1e-6;

/// Maximum length of the name of the tool-change subroutine, bytes.
const MAX_SUBROUTINE_NAME_BYTES: usize = 60;

pub(crate) fn machine(text: &str, file: &str, read_file: ReadFile<'_>) -> Result<Machine, MachineError> {
    let document = ConfigDocument::toml(text, file)?;
    let raw: MachineFile = document.read_advised(|key| Some(advice_on_unknown_key(key)))?;
    Check { document }.machine(raw, read_file)
}

struct Check<'a> {
    document: ConfigDocument<'a>,
}

impl Check<'_> {
    fn error(&self, key: &str, what: String, advice: impl Into<String>) -> MachineError {
        self.document.error(key, what, advice).into()
    }

    fn machine(&self, raw: MachineFile, read_file: ReadFile<'_>) -> Result<Machine, MachineError> {
        self.name(&raw.name)?;
        self.number("increments_per_mm", raw.increments_per_mm, 1e-3, MAX_NUMBER)?;
        if let Some(increments) = raw.increments_per_degree {
            self.number("increments_per_degree", increments, 1e-3, MAX_NUMBER)?;
        }
        if let ControlRate::Hz(hz) = raw.rate.0 {
            self.number("rate", hz, MIN_RATE_HZ, MAX_RATE_HZ)?;
        }
        let lead = self.lead(raw.lead_cycles, raw.lead_ms)?;
        let axes = self.axes(&raw)?;
        let max_feed_mm_s = self.at_most_one_of(
            "limits",
            "max_feed",
            &[
                ("mm_min", raw.limits.max_feed_mm_min, 1.0 / 60.0),
                ("mm_s", raw.limits.max_feed_mm_s, 1.0),
            ],
        )?;
        let signals = self.signals(&raw)?;
        let corrections = self.corrections(&raw, &axes, &signals, read_file)?;
        let homing = self.homing(&raw.homing, &axes)?;
        let machine = Machine {
            warnings: self.warnings(&raw, &axes, &homing),
            handwheel: self.handwheel(&raw, &axes, &signals.inputs)?,
            homing,
            path: self.path(&raw)?,
            realtime: self.realtime(&raw)?,
            program: self.program(&raw)?,
            signals,
            corrections,
            name: raw.name,
            description: raw.description,
            kind: raw.kind,
            kinematics: raw.kinematics,
            increments_per_mm: raw.increments_per_mm,
            increments_per_degree: raw.increments_per_degree,
            rate: raw.rate.0,
            lead,
            axes,
            max_feed_mm_s,
            trace: TraceSettings {
                on_full: raw.trace.on_full,
                cycles: raw.trace.cycles,
            },
            drives: self.drives(&raw.drives)?,
        };
        if let Err(error) = machine.rate_input().check() {
            return Err(self.error(
                "path.min_radius_mm",
                error.to_string(),
                "a larger radius, or more increments per mm",
            ));
        }
        Ok(machine)
    }

    fn lead(&self, cycles: Option<i64>, ms: Option<f64>) -> Result<Lead, MachineError> {
        match (cycles, ms) {
            (None, None) => Ok(Lead::ByRate),
            (Some(cycles), None) => Ok(Lead::Cycles(self.whole_number("lead_cycles", cycles, 1, 1000)?)),
            (None, Some(ms)) => {
                self.number("lead_ms", ms, 0.03, 28.0)?;
                Ok(Lead::Time { s: ms / 1000.0 })
            }
            (Some(_), Some(_)) => Err(self.error(
                "lead_ms",
                "the lead is given twice: lead_cycles is already present".to_owned(),
                "keep one of lead_cycles and lead_ms",
            )),
        }
    }

    fn name(&self, name: &str) -> Result<(), MachineError> {
        let good = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        let starts = name.starts_with(|c: char| c.is_ascii_alphanumeric());
        if starts && name.len() <= 64 && name.chars().all(good) {
            return Ok(());
        }
        Err(self.error(
            "name",
            format!("{:?} is not valid in service and file names", shortened(name)),
            "use 1 to 64 letters, digits, '-' and '_', starting with a letter or digit",
        ))
    }

    fn path(&self, raw: &MachineFile) -> Result<PathSettings, MachineError> {
        let path = &raw.path;
        let number = |key: &str, value: Option<f64>, default: f64, min: f64, max: f64| {
            let value = value.unwrap_or(default);
            self.number(&format!("path.{key}"), value, min, max)
                .map(|()| value)
        };
        let blend_tolerance_mm = number("blend_tolerance_mm", path.blend_tolerance_mm, 0.01, 0.0, 100.0)?;
        if path.mode == PathMode::Blend && blend_tolerance_mm < MIN_NUMBER {
            return Err(self.error(
                "path.blend_tolerance_mm",
                format!("{blend_tolerance_mm} mm is too small for a blend"),
                "give a tolerance of at least 0.000001 mm, or write mode = \"exact\"",
            ));
        }
        let one_increment_mm = (1.0 / raw.increments_per_mm).max(1e-3);
        Ok(PathSettings {
            planner: path.planner,
            mode: path.mode,
            blend_tolerance_mm,
            joint_time_s: number("joint_time_ms", path.joint_time_ms, 1.0, 1e-3, 1000.0)? / 1000.0,
            chord_error_increments: number(
                "chord_error_increments",
                path.chord_error_increments,
                1.0,
                1e-3,
                1e6,
            )?,
            min_radius_mm: number(
                "min_radius_mm",
                path.min_radius_mm,
                DEFAULT_MIN_RADIUS_MM,
                MIN_NUMBER,
                1e6,
            )?,
            arc_radius_tolerance_mm: number(
                "arc_radius_tolerance_mm",
                path.arc_radius_tolerance_mm,
                // Both ends and the centre rounded to 0.01 mm, as LinuxCNC permits.
                0.02 * std::f64::consts::SQRT_2,
                MIN_NUMBER,
                100.0,
            )?,
            arc_radius_tolerance_ratio: number(
                "arc_radius_tolerance_ratio",
                path.arc_radius_tolerance_ratio,
                0.001,
                0.0,
                1.0,
            )?,
            involute_end_tolerance_mm: number(
                "involute_end_tolerance_mm",
                path.involute_end_tolerance_mm,
                one_increment_mm,
                MIN_NUMBER,
                1000.0,
            )?,
        })
    }

    fn realtime(&self, raw: &MachineFile) -> Result<RealtimeSettings, MachineError> {
        let realtime = &raw.realtime;
        let core = match realtime.core {
            Some(core) => Some(self.whole_number::<usize>("realtime.core", core, 0, 4095)?),
            None => None,
        };
        Ok(RealtimeSettings {
            priority: self.whole_number("realtime.priority", realtime.priority.unwrap_or(80), 2, 98)?,
            core,
            lock_memory: realtime.lock_memory.unwrap_or(true),
            max_late_cycles: realtime
                .max_late_cycles
                .map(|cycles| self.whole_number("realtime.max_late_cycles", cycles, 0, 1_000_000))
                .transpose()?,
        })
    }

    /// The name of the tool-change subroutine.
    fn tool_change_subroutine(&self, program: &ProgramFile) -> Result<String, MachineError> {
        let by_subroutine = program.tool_change == ToolChange::Subroutine;
        let name = program.tool_change_subroutine.as_deref();
        if let Some(name) = name {
            let is_name = name
                .bytes()
                .all(|byte| byte.is_ascii_alphanumeric() || byte == b'_' || byte == b'-');
            if !is_name || name.is_empty() || name.len() > MAX_SUBROUTINE_NAME_BYTES {
                let problem = format!("\"{name}\" is not a valid subroutine name");
                let advice = "use letters, digits, - and _, for example \"toolchange\" for toolchange.ngc";
                return Err(self.error("program.tool_change_subroutine", problem, advice));
            }
        }
        for (key, is_given) in [
            ("program.tool_change_subroutine", name.is_some()),
            ("program.magazine", program.magazine == Magazine::Random),
        ] {
            if is_given && !by_subroutine {
                let problem = "this machine does not change tools by a subroutine".to_owned();
                return Err(self.error(
                    key,
                    problem,
                    "add tool_change = \"subroutine\", or remove the key",
                ));
            }
        }
        Ok(name.unwrap_or(DEFAULT_TOOL_CHANGE_SUBROUTINE).to_owned())
    }

    fn program(&self, raw: &MachineFile) -> Result<ProgramSettings, MachineError> {
        let program = &raw.program;
        let path = |key: &str, text: &str| {
            if text.is_empty() || text.contains('\0') {
                let advice = "name a file or folder, or remove the key";
                return Err(self.error(
                    &format!("program.{key}"),
                    "this is not a valid path".to_owned(),
                    advice,
                ));
            }
            Ok(PathBuf::from(text))
        };
        let optional =
            |key: &str, text: &Option<String>| text.as_deref().map(|text| path(key, text)).transpose();
        let mut user_codes = Vec::new();
        for (index, code) in program.user_codes.iter().enumerate() {
            user_codes.push(self.whole_number(&format!("program.user_codes[{index}]"), *code, 100, 199)?);
        }
        let user_code_timeout_s = program.user_code_timeout_s.unwrap_or(10.0);
        self.number("program.user_code_timeout_s", user_code_timeout_s, 0.1, 86_400.0)?;
        let folders = program.subroutines.iter().enumerate();
        Ok(ProgramSettings {
            tool_table: optional("tool_table", &program.tool_table)?,
            without_tool_table: program.without_tool_table,
            tool_change: program.tool_change,
            tool_change_subroutine: self.tool_change_subroutine(program)?,
            magazine: program.magazine,
            start_unit: program.start_unit,
            start_plane: program.start_plane,
            start_x: program.start_x,
            parameter_unit: program.parameter_unit,
            parameters: optional("parameters", &program.parameters)?,
            log_folder: optional("log_folder", &program.log_folder)?,
            subroutines: folders
                .map(|(index, text)| path(&format!("subroutines[{index}]"), text))
                .collect::<Result<_, _>>()?,
            user_codes,
            user_code_folder: optional("user_code_folder", &program.user_code_folder)?,
            user_code_timeout_s,
            turning_cycles: program.turning_cycles,
            fanuc_threads: program.fanuc_threads,
            load_channel: program.load_channel,
        })
    }

    fn drives(&self, raw: &DrivesFile) -> Result<DriveSettings, MachineError> {
        let timeout = raw.feedback_timeout_ms;
        let timeout_ms = self.or_default("drives.feedback_timeout_ms", timeout, 20.0, [1.0, 1000.0])?;
        let enable = raw.enable_timeout_ms;
        let enable_ms = self.or_default("drives.enable_timeout_ms", enable, 2000.0, [10.0, 60_000.0])?;
        Ok(DriveSettings {
            feedback: raw.feedback,
            feedback_timeout_s: timeout_ms / 1000.0,
            enable_timeout_s: enable_ms / 1000.0,
            follow_clock: raw.follow_clock.unwrap_or(true),
        })
    }
}

/// Advice on an unknown key; most often its unit is missing.
fn advice_on_unknown_key(key: &str) -> String {
    let unit = match key {
        "max_velocity" => "max_velocity_mm_min or max_velocity_mm_s (rotary: _deg_min or _deg_s)",
        "max_acceleration" => {
            "max_acceleration_mm_s2, max_acceleration_m_s2 or max_acceleration_g (rotary: _deg_s2)"
        }
        "max_jerk" => "max_jerk_mm_s3 or max_jerk_m_s3 (rotary: _deg_s3)",
        "travel_min" => "travel_min_mm (rotary: travel_min_deg)",
        "travel_max" => "travel_max_mm (rotary: travel_max_deg)",
        "home" => "home_mm (rotary: home_deg)",
        "following_error" => "following_error_mm (rotary: following_error_deg)",
        "backlash" => "backlash_mm (rotary: backlash_deg)",
        "following_time" => "following_time_ms",
        "feedback_timeout" => "feedback_timeout_ms",
        "enable_timeout" => "enable_timeout_ms",
        "blend_tolerance" => "blend_tolerance_mm",
        "joint_time" => "joint_time_ms",
        "max_feed" => "max_feed_mm_min or max_feed_mm_s",
        "input_timeout" => "input_timeout_ms",
        _ => return "correct the spelling, or remove the key".to_owned(),
    };
    format!("the unit is missing: write {unit}")
}
