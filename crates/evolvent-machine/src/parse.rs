//! From text to a checked machine, with the place of everything that is wrong.
//!
//! The text is parsed once into a table that knows the place of every key. Serde reads that table into the types of
//! `file.rs` (unknown keys, missing keys, wrong kinds); then the numbers are checked here, and a bad one is looked up in
//! the table by its dotted key.

use std::ops::Range;
use std::path::PathBuf;

use evolvent_path::AxisLetter;
use toml::de::{DeTable, DeValue};

use crate::error::MachineError;
use crate::file::{AxisFile, AxisKind, DrivesFile, MachineFile};
use crate::homing::{EndFile, HomingFile, HomingSettings};
use crate::machine::{
    Axis, ControlRate, DriveSettings, MAX_RATE_HZ, MIN_RATE_HZ, Machine, MachineKind, PathMode, PathSettings,
    ProgramSettings, RealtimeSettings, TraceSettings,
};
use crate::rate::{DEFAULT_MIN_RADIUS_MM, GRAVITY_MM_S2};

/// No machine has a number beyond this, in mm, degrees and seconds; positions in increments fit into 63 bits.
const ABSURD: f64 = 1e9;
/// No limit or grid is finer than this, in mm, degrees and seconds.
const TINY: f64 = 1e-6;

pub(crate) fn machine(text: &str, file: &str) -> Result<Machine, MachineError> {
    let table = DeTable::parse(text).map_err(|error| {
        let (line, column) = line_and_column(text, error.span().map_or(0, |span| span.start));
        MachineError::Syntax {
            file: file.to_owned(),
            line,
            column,
            what: one_line(error.message()),
        }
    })?;
    let check = Check {
        file,
        text,
        table: table.get_ref(),
        whole: table.span(),
    };
    let deserializer = toml::Deserializer::from(table.clone());
    let raw: MachineFile = serde_path_to_error::deserialize(deserializer).map_err(|error| {
        let mut key = error.path().to_string();
        let inner = error.into_inner();
        let what = in_plain_words(inner.message());
        let advice = advice_for(&key, &what);
        // Serde names the table that lacks a key; people look for the key.
        if let Some(missing) = what
            .strip_prefix("missing field `")
            .and_then(|rest| rest.strip_suffix('`'))
        {
            key = if key == "." {
                missing.to_owned()
            } else {
                format!("{key}.{missing}")
            };
        }
        check.error_at(&key, inner.span(), what, advice)
    })?;
    check.machine(raw)
}

struct Check<'a> {
    file: &'a str,
    text: &'a str,
    table: &'a DeTable<'a>,
    whole: Range<usize>,
}

impl Check<'_> {
    fn machine(&self, raw: MachineFile) -> Result<Machine, MachineError> {
        self.name(&raw.name)?;
        self.number("increments_per_mm", raw.increments_per_mm, 1e-3, ABSURD)?;
        if let Some(increments) = raw.increments_per_degree {
            self.number("increments_per_degree", increments, 1e-3, ABSURD)?;
        }
        if let ControlRate::Hz(hz) = raw.rate.0 {
            self.number("rate", hz, MIN_RATE_HZ, MAX_RATE_HZ)?;
        }
        let lead_cycles = self.whole_number("lead_cycles", raw.lead_cycles, 1, 1000)?;
        let axes = self.axes(&raw)?;
        let max_feed_mm_s = self.at_most_one_of(
            "limits",
            "max_feed",
            &[
                ("mm_min", raw.limits.max_feed_mm_min, 1.0 / 60.0),
                ("mm_s", raw.limits.max_feed_mm_s, 1.0),
            ],
        )?;
        let machine = Machine {
            homing: self.homing(&raw.homing, &axes)?,
            path: self.path(&raw)?,
            realtime: self.realtime(&raw)?,
            program: self.program(&raw)?,
            name: raw.name,
            description: raw.description,
            kind: raw.kind,
            kinematics: raw.kinematics,
            increments_per_mm: raw.increments_per_mm,
            increments_per_degree: raw.increments_per_degree,
            rate: raw.rate.0,
            lead_cycles,
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

    fn homing(&self, raw: &[HomingFile], axes: &[Axis]) -> Result<Vec<HomingSettings>, MachineError> {
        let mut homing: Vec<HomingSettings> = Vec::new();
        for (index, one) in raw.iter().enumerate() {
            let at = format!("homing[{index}]");
            let mut letters = one.axis.chars();
            let letter = letters.next().and_then(AxisLetter::from_letter);
            let axis = axes
                .iter()
                .find(|axis| Some(axis.letter) == letter && letters.as_str().is_empty());
            let Some(axis) = axis else {
                return Err(self.error(
                    &format!("{at}.axis"),
                    format!("{:?} is no axis of this machine", shortened(&one.axis)),
                    "name an axis that has an [[axis]] table",
                ));
            };
            if homing.iter().any(|known| known.axis == axis.letter) {
                return Err(self.error(
                    &format!("{at}.axis"),
                    format!("axis {} is homed twice", axis.letter.letter()),
                    "keep one of the tables",
                ));
            }
            let rotary = axis.letter.is_rotary();
            let unit = if rotary { "deg" } else { "mm" };
            let value = |key: &str, mm: Option<f64>, deg: Option<f64>, suffix: &str| {
                let (mine, other) = if rotary { (deg, mm) } else { (mm, deg) };
                let name = format!("{key}_{unit}{suffix}");
                if other.is_some() {
                    return Err(self.error(
                        &at,
                        format!("axis {} takes {key} in {unit}", axis.letter.letter()),
                        format!("write {name}"),
                    ));
                }
                let value = self.required(&at, &name, mine)?;
                Ok((format!("{at}.{name}"), value))
            };
            let (search_key, search_speed) = value("search", one.search_mm_s, one.search_deg_s, "_s")?;
            let (latch_key, latch_speed) = value("latch", one.latch_mm_s, one.latch_deg_s, "_s")?;
            let (switch_key, switch_position) = value("switch", one.switch_mm, one.switch_deg, "")?;
            self.number(&search_key, search_speed, 1e-6, axis.max_velocity)?;
            self.number(&latch_key, latch_speed, 1e-6, search_speed)?;
            self.number(&switch_key, switch_position, -ABSURD, ABSURD)?;
            let order = self.whole_number(&format!("{at}.order"), one.order, 0, 100)?;
            homing.push(HomingSettings {
                axis: axis.letter,
                order,
                negative: matches!(one.towards, EndFile::Negative),
                search_speed,
                latch_speed,
                switch_position,
            });
        }
        Ok(homing)
    }

    fn name(&self, name: &str) -> Result<(), MachineError> {
        let good = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        let starts = name.starts_with(|c: char| c.is_ascii_alphanumeric());
        if starts && name.len() <= 64 && name.chars().all(good) {
            return Ok(());
        }
        Err(self.error(
            "name",
            format!("{:?} cannot be used in service and file names", shortened(name)),
            "use 1 to 64 letters, digits, '-' and '_', beginning with a letter or digit",
        ))
    }

    fn axes(&self, raw: &MachineFile) -> Result<Vec<Axis>, MachineError> {
        let mut axes: Vec<Axis> = Vec::new();
        for (index, axis) in raw.axis.iter().enumerate() {
            let axis = self.axis(&format!("axis[{index}]"), axis)?;
            let letter = axis.letter.letter();
            if let Some(first) = axes.iter().position(|other| other.letter == axis.letter) {
                return Err(self.error(
                    &format!("axis[{index}].letter"),
                    format!("axis {letter} is there twice: axis[{first}] has that letter already"),
                    "give each axis a letter of its own",
                ));
            }
            if axis.letter.is_rotary() && raw.increments_per_degree.is_none() {
                return Err(self.error(
                    "increments_per_degree",
                    format!("missing, but axis {letter} is rotary"),
                    "add increments_per_degree at the top of the file, for example 1000",
                ));
            }
            axes.push(axis);
        }
        if !axes.iter().any(|axis| !axis.letter.is_rotary()) {
            return Err(self.error(
                "axis",
                format!("{} axes, none of them linear", axes.len()),
                "add an [[axis]] with letter \"X\", \"Y\", \"Z\", \"U\", \"V\" or \"W\"",
            ));
        }
        for letter in [AxisLetter::X, AxisLetter::Z] {
            if raw.kind == MachineKind::Lathe && !axes.iter().any(|axis| axis.letter == letter) {
                return Err(self.error(
                    "axis",
                    format!(
                        "a lathe needs the axes X and Z, but {} is missing",
                        letter.letter()
                    ),
                    "add that axis, or write kind = \"mill\"",
                ));
            }
        }
        Ok(axes)
    }

    fn axis(&self, at: &str, raw: &AxisFile) -> Result<Axis, MachineError> {
        let mut letters = raw.letter.chars();
        let letter = match (letters.next().and_then(AxisLetter::from_letter), letters.next()) {
            (Some(letter), None) => letter,
            _ => {
                return Err(self.error(
                    &format!("{at}.letter"),
                    format!("{:?} is no axis", shortened(&raw.letter)),
                    "use one of X, Y, Z, A, B, C, U, V, W",
                ));
            }
        };
        let rotary = letter.is_rotary();
        if let Some(kind) = raw.kind
            && (kind == AxisKind::Rotary) != rotary
        {
            let is = if rotary { "rotary" } else { "linear" };
            return Err(self.error(
                &format!("{at}.kind"),
                format!("axis {} is {is}", letter.letter()),
                format!(
                    "write kind = \"{is}\", or use another letter: A, B, C are rotary, the others linear"
                ),
            ));
        }
        self.refuse_other_unit(at, letter, raw)?;
        let (travel_min, travel_max, home) = if rotary {
            (
                self.required(at, "travel_min_deg", raw.travel_min_deg)?,
                self.required(at, "travel_max_deg", raw.travel_max_deg)?,
                ("home_deg", raw.home_deg),
            )
        } else {
            (
                self.required(at, "travel_min_mm", raw.travel_min_mm)?,
                self.required(at, "travel_max_mm", raw.travel_max_mm)?,
                ("home_mm", raw.home_mm),
            )
        };
        let unit = if rotary { "deg" } else { "mm" };
        if travel_min >= travel_max {
            return Err(self.error(
                &format!("{at}.travel_min_{unit}"),
                format!("the travel begins at {travel_min} {unit} and ends at {travel_max} {unit}"),
                "let the minimum be below the maximum",
            ));
        }
        let home_key = format!("{at}.{}", home.0);
        let home = home.1.unwrap_or(0.0);
        if !(travel_min..=travel_max).contains(&home) {
            return Err(self.error(
                &home_key,
                format!("home is {home} {unit}, outside the travel of {travel_min} to {travel_max} {unit}"),
                "let home lie within the travel (it is 0 where it is not given)",
            ));
        }
        let (velocity, acceleration, jerk) = if rotary {
            (
                vec![
                    ("deg_min", raw.max_velocity_deg_min, 1.0 / 60.0),
                    ("deg_s", raw.max_velocity_deg_s, 1.0),
                ],
                vec![("deg_s2", raw.max_acceleration_deg_s2, 1.0)],
                vec![("deg_s3", raw.max_jerk_deg_s3, 1.0)],
            )
        } else {
            (
                vec![
                    ("mm_min", raw.max_velocity_mm_min, 1.0 / 60.0),
                    ("mm_s", raw.max_velocity_mm_s, 1.0),
                ],
                vec![
                    ("mm_s2", raw.max_acceleration_mm_s2, 1.0),
                    ("m_s2", raw.max_acceleration_m_s2, 1000.0),
                    ("g", raw.max_acceleration_g, GRAVITY_MM_S2),
                ],
                vec![
                    ("mm_s3", raw.max_jerk_mm_s3, 1.0),
                    ("m_s3", raw.max_jerk_m_s3, 1000.0),
                ],
            )
        };
        Ok(Axis {
            letter,
            travel_min,
            travel_max,
            max_velocity: self.exactly_one_of(at, "max_velocity", &velocity)?,
            max_acceleration: self.exactly_one_of(at, "max_acceleration", &acceleration)?,
            max_jerk: self.exactly_one_of(at, "max_jerk", &jerk)?,
            home,
            following_error: self
                .at_most_one_of(
                    at,
                    "following_error",
                    &[
                        ("mm", raw.following_error_mm, 1.0),
                        ("deg", raw.following_error_deg, 1.0),
                    ],
                )?
                .unwrap_or(0.5),
            following_time_s: self.or_default(
                &format!("{at}.following_time_ms"),
                raw.following_time_ms,
                20.0,
                [0.0, 10_000.0],
            )? / 1000.0,
        })
    }

    /// A linear axis with keys in degrees, or a rotary one with keys in millimetres.
    fn refuse_other_unit(&self, at: &str, letter: AxisLetter, raw: &AxisFile) -> Result<(), MachineError> {
        let linear = [
            ("travel_min_mm", raw.travel_min_mm),
            ("travel_max_mm", raw.travel_max_mm),
            ("home_mm", raw.home_mm),
            ("following_error_mm", raw.following_error_mm),
            ("max_velocity_mm_min", raw.max_velocity_mm_min),
            ("max_velocity_mm_s", raw.max_velocity_mm_s),
            ("max_acceleration_mm_s2", raw.max_acceleration_mm_s2),
            ("max_acceleration_m_s2", raw.max_acceleration_m_s2),
            ("max_acceleration_g", raw.max_acceleration_g),
            ("max_jerk_mm_s3", raw.max_jerk_mm_s3),
            ("max_jerk_m_s3", raw.max_jerk_m_s3),
        ];
        let rotary = [
            ("travel_min_deg", raw.travel_min_deg),
            ("travel_max_deg", raw.travel_max_deg),
            ("home_deg", raw.home_deg),
            ("following_error_deg", raw.following_error_deg),
            ("max_velocity_deg_min", raw.max_velocity_deg_min),
            ("max_velocity_deg_s", raw.max_velocity_deg_s),
            ("max_acceleration_deg_s2", raw.max_acceleration_deg_s2),
            ("max_jerk_deg_s3", raw.max_jerk_deg_s3),
        ];
        let (wrong, is, unit) = if letter.is_rotary() {
            (
                &linear[..],
                "rotary",
                "degrees (_deg, _deg_min or _deg_s, _deg_s2, _deg_s3)",
            )
        } else {
            (
                &rotary[..],
                "linear",
                "millimetres (_mm, _mm_min or _mm_s, _mm_s2, _mm_s3)",
            )
        };
        match wrong.iter().find(|(_, value)| value.is_some()) {
            None => Ok(()),
            Some((key, _)) => Err(self.error(
                &format!("{at}.{key}"),
                format!("axis {} is {is} and has no such key", letter.letter()),
                format!("give its travel and limits in {unit}"),
            )),
        }
    }

    fn path(&self, raw: &MachineFile) -> Result<PathSettings, MachineError> {
        let path = &raw.path;
        let number = |key: &str, value: Option<f64>, default: f64, least: f64, most: f64| {
            let value = value.unwrap_or(default);
            self.number(&format!("path.{key}"), value, least, most)
                .map(|()| value)
        };
        let blend_tolerance_mm = number("blend_tolerance_mm", path.blend_tolerance_mm, 0.01, 0.0, 100.0)?;
        if path.mode == PathMode::Blend && blend_tolerance_mm < TINY {
            return Err(self.error(
                "path.blend_tolerance_mm",
                format!("{blend_tolerance_mm} mm leaves no room for a blend"),
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
                TINY,
                1e6,
            )?,
            arc_radius_tolerance_mm: number(
                "arc_radius_tolerance_mm",
                path.arc_radius_tolerance_mm,
                // Both ends and the centre rounded to 0.01 mm, as LinuxCNC allows.
                0.02 * std::f64::consts::SQRT_2,
                TINY,
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
                TINY,
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
            max_late_cycles: self.whole_number(
                "realtime.max_late_cycles",
                realtime.max_late_cycles.unwrap_or(1000),
                0,
                1_000_000,
            )?,
        })
    }

    fn program(&self, raw: &MachineFile) -> Result<ProgramSettings, MachineError> {
        let program = &raw.program;
        let path = |key: &str, text: &str| {
            if text.is_empty() || text.contains('\0') {
                let advice = "name a file or folder, or leave the key out";
                return Err(self.error(&format!("program.{key}"), "this is no path".to_owned(), advice));
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
            parameters: optional("parameters", &program.parameters)?,
            subroutines: folders
                .map(|(index, text)| path(&format!("subroutines[{index}]"), text))
                .collect::<Result<_, _>>()?,
            user_codes,
            user_code_folder: optional("user_code_folder", &program.user_code_folder)?,
            user_code_timeout_s,
            turning_cycles: program.turning_cycles,
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

    /// A number in a range, or its default.
    fn or_default(
        &self,
        key: &str,
        value: Option<f64>,
        default: f64,
        [least, most]: [f64; 2],
    ) -> Result<f64, MachineError> {
        let value = value.unwrap_or(default);
        self.number(key, value, least, most).map(|()| value)
    }

    fn required(&self, at: &str, key: &str, value: Option<f64>) -> Result<f64, MachineError> {
        let key = format!("{at}.{key}");
        let Some(value) = value else {
            return Err(self.error(&key, "missing".to_owned(), "add this key to the axis"));
        };
        self.number(&key, value, -ABSURD, ABSURD)?;
        Ok(value)
    }

    /// Exactly one of the keys `QUANTITY_UNIT`, as a positive limit in mm or degrees and seconds.
    fn exactly_one_of(
        &self,
        at: &str,
        quantity: &str,
        units: &[(&str, Option<f64>, f64)],
    ) -> Result<f64, MachineError> {
        if let Some(value) = self.at_most_one_of(at, quantity, units)? {
            return Ok(value);
        }
        Err(self.error(
            &format!("{at}.{quantity}_{}", units.first().map_or("", |unit| unit.0)),
            "missing".to_owned(),
            format!("add {} to the axis", alternatives(quantity, units)),
        ))
    }

    fn at_most_one_of(
        &self,
        at: &str,
        quantity: &str,
        units: &[(&str, Option<f64>, f64)],
    ) -> Result<Option<f64>, MachineError> {
        let mut found: Option<(f64, &str)> = None;
        for &(unit, value, factor) in units {
            let Some(value) = value else { continue };
            let key = format!("{at}.{quantity}_{unit}");
            if let Some((_, first)) = found {
                return Err(self.error(
                    &key,
                    format!("given a second time: {quantity}_{first} is there already"),
                    format!("keep one of {}", alternatives(quantity, units)),
                ));
            }
            self.number(&key, value, TINY / factor, ABSURD / factor)?;
            found = Some((value * factor, unit));
        }
        Ok(found.map(|(value, _)| value))
    }

    fn number(&self, key: &str, value: f64, least: f64, most: f64) -> Result<(), MachineError> {
        // A NaN is in no range.
        if (least..=most).contains(&value) {
            return Ok(());
        }
        let range = format!("give a number from {} to {}", plain(least), plain(most));
        Err(self.error(key, format!("{} is out of range", plain(value)), range))
    }

    fn whole_number<T: TryFrom<i64>>(
        &self,
        key: &str,
        value: i64,
        least: i64,
        most: i64,
    ) -> Result<T, MachineError> {
        if (least..=most).contains(&value)
            && let Ok(value) = T::try_from(value)
        {
            return Ok(value);
        }
        let range = format!("give a whole number from {least} to {most}");
        Err(self.error(key, format!("{value} is out of range"), range))
    }

    fn error(&self, key: &str, what: String, advice: impl Into<String>) -> MachineError {
        self.error_at(key, None, what, advice.into())
    }

    /// `span` is used where the key itself is not in the file.
    fn error_at(&self, key: &str, span: Option<Range<usize>>, what: String, advice: String) -> MachineError {
        let found = self.find(key);
        let span = match (found, span) {
            (Found::Key(span), _) => span,
            (_, Some(span)) => span,
            (Found::Parent(span), None) => span,
        };
        let (line, column) = line_and_column(self.text, span.start);
        let key = if key.is_empty() || key == "." {
            "the file".to_owned()
        } else {
            shortened(key)
        };
        MachineError::Key {
            file: self.file.to_owned(),
            line,
            column,
            key,
            what,
            advice,
        }
    }

    /// The place of a dotted key, or of the innermost table that is there.
    fn find(&self, key: &str) -> Found {
        let mut parent = self.whole.clone();
        let mut table = Some(self.table);
        let mut last = None;
        for part in key.split('.') {
            let (word, index) = match part.split_once('[') {
                Some((word, rest)) => (word, rest.trim_end_matches(']').parse::<usize>().ok()),
                None => (part, None),
            };
            let Some((name, value)) = table.and_then(|table| table.get_key_value(word)) else {
                return Found::Parent(parent);
            };
            let mut value = value;
            let mut place = name.span();
            if let (Some(index), DeValue::Array(array)) = (index, value.get_ref()) {
                let Some(element) = array.get(index) else {
                    return Found::Parent(place);
                };
                value = element;
                place = element.span();
            }
            table = value.get_ref().as_table();
            parent = place.clone();
            last = Some(place);
        }
        last.map_or(Found::Parent(parent), Found::Key)
    }
}

enum Found {
    Key(Range<usize>),
    Parent(Range<usize>),
}

fn alternatives(quantity: &str, units: &[(&str, Option<f64>, f64)]) -> String {
    let keys: Vec<_> = units
        .iter()
        .map(|(unit, _, _)| format!("{quantity}_{unit}"))
        .collect();
    keys.join(" or ")
}

/// What to do about something that serde refused.
fn advice_for(key: &str, what: &str) -> String {
    let last = key.rsplit('.').next().unwrap_or(key);
    if what.starts_with("unknown field") {
        let unit = match last {
            "max_velocity" => "max_velocity_mm_min or max_velocity_mm_s (rotary: _deg_min or _deg_s)",
            "max_acceleration" => {
                "max_acceleration_mm_s2, max_acceleration_m_s2 or max_acceleration_g (rotary: _deg_s2)"
            }
            "max_jerk" => "max_jerk_mm_s3 or max_jerk_m_s3 (rotary: _deg_s3)",
            "travel_min" => "travel_min_mm (rotary: travel_min_deg)",
            "travel_max" => "travel_max_mm (rotary: travel_max_deg)",
            "home" => "home_mm (rotary: home_deg)",
            "following_error" => "following_error_mm (rotary: following_error_deg)",
            "following_time" => "following_time_ms",
            "feedback_timeout" => "feedback_timeout_ms",
            "enable_timeout" => "enable_timeout_ms",
            "blend_tolerance" => "blend_tolerance_mm",
            "joint_time" => "joint_time_ms",
            "max_feed" => "max_feed_mm_min or max_feed_mm_s",
            _ => return "correct the spelling, or remove the key".to_owned(),
        };
        return format!("the unit is missing: write {unit}");
    }
    if what.starts_with("missing field") {
        return "add this key".to_owned();
    }
    "correct the value".to_owned()
}

fn line_and_column(text: &str, byte: usize) -> (usize, usize) {
    let before: String = text
        .char_indices()
        .take_while(|(at, _)| *at < byte)
        .map(|(_, c)| c)
        .collect();
    let line = before.matches('\n').count() + 1;
    let column = before.rsplit('\n').next().unwrap_or("").chars().count() + 1;
    (line, column)
}

/// Serde speaks of Rust's types.
fn in_plain_words(message: &str) -> String {
    let plain = message
        .replace("expected f64", "expected a number")
        .replace("expected i64", "expected a whole number")
        .replace(" as i128", "")
        .replace(" as u128", "");
    one_line(&plain)
}

fn one_line(message: &str) -> String {
    let words: Vec<_> = message.split_whitespace().collect();
    shortened_to(&words.join(" "), 600)
}

/// Long text from the file does not belong into a message.
fn shortened(text: &str) -> String {
    shortened_to(text, 80)
}

fn shortened_to(text: &str, most_chars: usize) -> String {
    match text.char_indices().nth(most_chars) {
        None => text.to_owned(),
        Some((end, _)) => format!("{}...", &text[..end]),
    }
}

/// A number as people write it: 1e308 stays short.
fn plain(value: f64) -> String {
    let size = value.abs();
    if size != 0.0 && !(1e-4..1e7).contains(&size) && value.is_finite() {
        format!("{value:e}")
    } else {
        format!("{value}")
    }
}
