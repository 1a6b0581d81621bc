//! A case, read from a file and checked.

use evolvent_config::{ConfigDocument, ConfigError};
use evolvent_cutting::{LawDefinition, ToolAngles};

use crate::case_file::{
    AxisFile, CaseFile, DirectionWord, ForceFile, LobesFile, MapFile, MillingFile, ModeFile, SweepFile,
    TurningFile,
};
use crate::lobe::{Milling, MillingCut, Mode, Turning, TurningMode};
use crate::model::{CuttingTool, PrincipalAxis};

/// Maximum ratio of the frequencies of both axes: disturbances are followed for 1000 periods of the slower
/// axis in steps of the faster one.
const MAX_FREQUENCY_RATIO: f64 = 100.0;

/// Source of the force law.
#[derive(Clone, Debug, PartialEq)]
pub enum LawSource {
    /// A built-in law.
    BuiltIn(Box<LawDefinition>),
    /// A file, relative to the case file.
    File(String),
}

/// A case of self-oscillation, of stability lobes, or of both.
#[derive(Clone, Debug, PartialEq)]
pub struct Case {
    /// Name in headings.
    pub name: String,
    /// One line for people.
    pub description: String,
    /// Self-oscillation of a tool.
    pub oscillation: Option<OscillationCase>,
    /// Regenerative chatter in turning.
    pub turning: Option<Turning>,
    /// Regenerative chatter in milling.
    pub milling: Option<Milling>,
    /// The diagram of stability lobes.
    pub lobes: LobeRange,
}

/// A tool in a cut, and what to compute.
#[derive(Clone, Debug, PartialEq)]
pub struct OscillationCase {
    /// The tool in the cut. Its radial ratio is that of the law if the file gives none: see `radial_ratio`.
    pub tool: CuttingTool,
    /// Source of the force law.
    pub law: LawSource,
    /// The tool's angles.
    pub angles: ToolAngles,
    /// Py / Pz, if the file gives it.
    pub radial_ratio: Option<f64>,
    /// Source of the law of the radial force, if it has its own.
    pub radial_law: Option<LawSource>,
    /// Diameter of the workpiece, mm, to report speeds in rpm.
    pub diameter_mm: Option<f64>,
    /// Number of harmonics.
    pub harmonics: usize,
    /// The range of speeds for amplitudes over speed.
    pub sweep: SweepRange,
    /// The ranges of the map.
    pub map: MapRange,
}

/// Speeds of a sweep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SweepRange {
    /// From and to, m/min.
    pub speed_m_min: [f64; 2],
    /// Number of speeds.
    pub points: usize,
}

/// Cells of a map.
#[derive(Clone, Debug, PartialEq)]
pub struct MapRange {
    /// From and to, m/min.
    pub speed_m_min: [f64; 2],
    /// From and to, mm.
    pub depth_mm: [f64; 2],
    /// Feeds, mm/rev, with one map each.
    pub feed_mm_rev: Vec<f64>,
    /// Number of speeds.
    pub columns: usize,
    /// Number of depths.
    pub rows: usize,
}

/// The diagram of stability lobes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LobeRange {
    /// From and to, rpm.
    pub speed_rpm: [f64; 2],
    /// Number of speeds.
    pub points: usize,
    /// Maximum depth of the diagram, mm; of the order of the lobes if the file gives none.
    pub max_depth_mm: Option<f64>,
    /// Whether to compute the limit of the delay equation too.
    pub exact: bool,
}

impl Case {
    /// Reads a case file; `file` names it in errors, and the ending .json selects JSON.
    ///
    /// # Errors
    /// Text that is neither TOML nor JSON, and keys that are unknown, missing or invalid, with file, line and
    /// key.
    pub fn parse(text: &str, file: &str) -> Result<Self, ConfigError> {
        let sheet = ConfigDocument::parse(text, file)?;
        let raw: CaseFile = sheet.read()?;
        Reader { sheet: &sheet }.case(raw)
    }
}

struct Reader<'a> {
    sheet: &'a ConfigDocument<'a>,
}

impl Reader<'_> {
    fn case(&self, raw: CaseFile) -> Result<Case, ConfigError> {
        let parts = [raw.cut.is_some(), raw.force.is_some(), raw.tool.is_some()];
        let oscillation = if parts.contains(&true) {
            Some(self.oscillation(&raw)?)
        } else {
            None
        };
        if oscillation.is_none() && raw.turning.is_none() && raw.milling.is_none() {
            return Err(self.sheet.error(
                "tool",
                "nothing to compute".to_owned(),
                "add [cut], [force] and [tool] for self-oscillation, or [turning] or [milling] for \
                 stability lobes",
            ));
        }
        for (key, there) in [("sweep", raw.sweep.is_some()), ("map", raw.map.is_some())] {
            if there && oscillation.is_none() {
                return Err(self.sheet.error(
                    key,
                    "belongs to self-oscillation".to_owned(),
                    "add [cut], [force] and [tool], or remove it",
                ));
            }
        }
        let turning = raw.turning.as_ref().map(|file| self.turning(file)).transpose()?;
        let milling = raw.milling.as_ref().map(|file| self.milling(file)).transpose()?;
        Ok(Case {
            name: raw.name,
            description: raw.description,
            oscillation,
            turning,
            milling,
            lobes: self.lobes(raw.lobes.as_ref())?,
        })
    }

    fn missing(&self, table: &str) -> ConfigError {
        self.sheet.error(
            table,
            "missing".to_owned(),
            "self-oscillation needs the tables [cut], [force] and [tool]",
        )
    }

    fn oscillation(&self, raw: &CaseFile) -> Result<OscillationCase, ConfigError> {
        let cut = raw.cut.as_ref().ok_or_else(|| self.missing("cut"))?;
        let force = raw.force.as_ref().ok_or_else(|| self.missing("force"))?;
        let tool = raw.tool.as_ref().ok_or_else(|| self.missing("tool"))?;
        self.sheet.number("cut.speed_m_min", cut.speed_m_min, 0.1, 1e4)?;
        self.sheet.number("cut.depth_mm", cut.depth_mm, 1e-4, 1e3)?;
        self.sheet
            .number("cut.feed_mm_rev", cut.feed_mm_rev, 1e-4, 100.0)?;
        if let Some(diameter) = cut.diameter_mm {
            self.sheet.number("cut.diameter_mm", diameter, 0.1, 1e5)?;
        }
        self.sheet.number("tool.beta_deg", tool.beta_deg, -360.0, 360.0)?;
        let [first, second] = tool.axis.as_slice() else {
            return Err(self.sheet.error(
                "tool.axis",
                format!("{} axes", tool.axis.len()),
                "give two [[tool.axis]], the principal axes of the tool's stiffness",
            ));
        };
        let axes = [
            self.axis("tool.axis[0]", first)?,
            self.axis("tool.axis[1]", second)?,
        ];
        let [a, b] = axes.map(|axis| axis.frequency_hz());
        if a.max(b) > MAX_FREQUENCY_RATIO * a.min(b) {
            return Err(self.sheet.error(
                "tool.axis",
                format!("frequencies of {a:.4} and {b:.4} Hz"),
                "correct mass, stiffness or frequency: those of the axes may differ by a factor of 100 at \
                 most",
            ));
        }
        let (law, floor_m_min) = self.force(force)?;
        if cut.speed_m_min <= floor_m_min {
            return Err(self.sheet.error(
                "cut.speed_m_min",
                format!(
                    "{} m/min is not above the floor of {floor_m_min} m/min",
                    cut.speed_m_min
                ),
                "raise the speed, or lower force.floor_m_min if the law holds there",
            ));
        }
        let harmonics = raw.solver.harmonics.unwrap_or(5);
        let tool = CuttingTool {
            axes,
            beta_deg: tool.beta_deg,
            speed_m_min: cut.speed_m_min,
            depth_mm: cut.depth_mm,
            feed_mm_rev: cut.feed_mm_rev,
            radial_ratio: force
                .radial_ratio
                .unwrap_or(evolvent_cutting::ForceLaw::ASSUMED_RADIAL_RATIO),
            floor_m_min,
        };
        Ok(OscillationCase {
            law,
            angles: ToolAngles {
                rake_deg: force.rake_deg,
                lead_deg: force.lead_deg,
            },
            radial_ratio: force.radial_ratio,
            radial_law: match &force.radial_law {
                Some(_) if force.radial_ratio.is_some() => {
                    return Err(self.sheet.error(
                        "force.radial_law",
                        "given beside radial_ratio".to_owned(),
                        "give one of radial_ratio and radial_law",
                    ));
                }
                Some(name) => Some(self.law_source("force.radial_law", name)?),
                None => None,
            },
            diameter_mm: cut.diameter_mm,
            harmonics: self.count("solver.harmonics", harmonics, 1, 32)?,
            sweep: self.sweep(raw.sweep.as_ref(), &tool)?,
            map: self.map(raw.map.as_ref(), &tool)?,
            tool,
        })
    }

    fn axis(&self, at: &str, axis: &AxisFile) -> Result<PrincipalAxis, ConfigError> {
        let key = |name: &str| format!("{at}.{name}");
        let number = |name: &str, value: f64, min: f64, max: f64| {
            self.sheet.number(&key(name), value, min, max).map(|()| value)
        };
        let stiffness_n_m = number("stiffness_n_m", axis.stiffness_n_m, 1e3, 1e13)?;
        let mass_kg = match (axis.mass_kg, axis.frequency_hz) {
            (Some(mass), None) => number("mass_kg", mass, 1e-6, 1e6)?,
            (None, Some(frequency)) => {
                let omega = std::f64::consts::TAU * number("frequency_hz", frequency, 0.1, 1e5)?;
                stiffness_n_m / (omega * omega)
            }
            (both, _) => {
                let what = if both.is_some() {
                    "given beside frequency_hz"
                } else {
                    "missing"
                };
                return Err(self.sheet.error(
                    &key("mass_kg"),
                    what.to_owned(),
                    "give exactly one of mass_kg and frequency_hz",
                ));
            }
        };
        let result = match (axis.damping_ratio, axis.damping_ns_m) {
            (Some(ratio), None) => {
                number("damping_ratio", ratio, 0.0, 0.9)?;
                PrincipalAxis::with_ratio(mass_kg, stiffness_n_m, ratio)
            }
            (None, Some(damping)) => PrincipalAxis {
                mass_kg,
                damping_ns_m: number("damping_ns_m", damping, 0.0, 1e9)?,
                stiffness_n_m,
            },
            (both, _) => {
                let what = if both.is_some() {
                    "given beside damping_ns_m"
                } else {
                    "missing"
                };
                return Err(self.sheet.error(
                    &key("damping_ratio"),
                    what.to_owned(),
                    "give exactly one of damping_ratio and damping_ns_m",
                ));
            }
        };
        if !(0.1..=1e5).contains(&result.frequency_hz()) {
            return Err(self.sheet.error(
                &key("stiffness_n_m"),
                format!("mass and stiffness give {} Hz", result.frequency_hz()),
                "correct one of them: 0.1 to 100000 Hz",
            ));
        }
        Ok(result)
    }

    fn force(&self, force: &ForceFile) -> Result<(LawSource, f64), ConfigError> {
        self.sheet.number("force.rake_deg", force.rake_deg, -45.0, 45.0)?;
        self.sheet.number("force.lead_deg", force.lead_deg, 1.0, 120.0)?;
        if let Some(ratio) = force.radial_ratio {
            self.sheet.number("force.radial_ratio", ratio, 0.0, 10.0)?;
        }
        let floor = force.floor_m_min.unwrap_or(2.0);
        self.sheet.number("force.floor_m_min", floor, 1e-3, 1e4)?;
        Ok((self.law_source("force.law", &force.law)?, floor))
    }

    /// A built-in law, or a file.
    fn law_source(&self, key: &str, name: &str) -> Result<LawSource, ConfigError> {
        let names_a_file = [".toml", ".json"]
            .iter()
            .any(|end| name.to_lowercase().ends_with(end));
        match LawDefinition::built_in(name) {
            Some(law) => Ok(LawSource::BuiltIn(Box::new(law))),
            None if names_a_file && name.len() <= 4096 => Ok(LawSource::File(name.to_owned())),
            None => {
                let names = LawDefinition::built_in_names().join(", ");
                let shown: String = name.chars().take(60).collect();
                Err(self.sheet.error(
                    key,
                    format!("there is no law {shown:?}"),
                    format!("use {names}, or the name of a law file that ends in .toml"),
                ))
            }
        }
    }

    fn range(&self, key: &str, range: [f64; 2], min: f64, max: f64) -> Result<[f64; 2], ConfigError> {
        let [from, to] = range;
        if from >= min && to <= max && from < to {
            return Ok(range);
        }
        let advice = format!("give two rising numbers from {min} to {max}");
        Err(self.sheet.error(key, format!("from {from} to {to}"), advice))
    }

    fn count(&self, key: &str, value: i64, min: i64, max: i64) -> Result<usize, ConfigError> {
        if (min..=max).contains(&value)
            && let Ok(value) = usize::try_from(value)
        {
            return Ok(value);
        }
        let advice = format!("give a whole number from {min} to {max}");
        Err(self.sheet.error(key, format!("{value} is out of range"), advice))
    }

    fn sweep(&self, sweep: Option<&SweepFile>, tool: &CuttingTool) -> Result<SweepRange, ConfigError> {
        let Some(sweep) = sweep else {
            return Ok(SweepRange {
                speed_m_min: around(tool),
                points: 101,
            });
        };
        Ok(SweepRange {
            speed_m_min: self.range(
                "sweep.speed_m_min",
                sweep.speed_m_min,
                1.01 * tool.floor_m_min,
                1e4,
            )?,
            points: self.count("sweep.points", sweep.points.unwrap_or(101), 2, 2000)?,
        })
    }

    fn map(&self, map: Option<&MapFile>, tool: &CuttingTool) -> Result<MapRange, ConfigError> {
        let Some(map) = map else {
            return Ok(MapRange {
                speed_m_min: around(tool),
                depth_mm: [0.05 * tool.depth_mm, 1.5 * tool.depth_mm],
                feed_mm_rev: vec![tool.feed_mm_rev],
                columns: 100,
                rows: 100,
            });
        };
        let feeds = map.feed_mm_rev.clone().unwrap_or_else(|| vec![tool.feed_mm_rev]);
        self.count("map.feed_mm_rev", feeds.len() as i64, 1, 9)?;
        for feed in &feeds {
            self.sheet.number("map.feed_mm_rev", *feed, 1e-4, 100.0)?;
        }
        Ok(MapRange {
            speed_m_min: self.range("map.speed_m_min", map.speed_m_min, 1.01 * tool.floor_m_min, 1e4)?,
            depth_mm: self.range("map.depth_mm", map.depth_mm, 1e-3, 1e3)?,
            feed_mm_rev: feeds,
            columns: self.count("map.columns", map.columns.unwrap_or(100), 2, 500)?,
            rows: self.count("map.rows", map.rows.unwrap_or(100), 2, 500)?,
        })
    }

    fn turning(&self, file: &TurningFile) -> Result<Turning, ConfigError> {
        self.sheet
            .number("turning.coefficient_n_mm2", file.coefficient_n_mm2, 1.0, 1e6)?;
        let force = file.force_deg.unwrap_or(0.0);
        self.sheet.number("turning.force_deg", force, -360.0, 360.0)?;
        self.count("turning.mode", file.mode.len() as i64, 1, 50)?;
        let mut modes = Vec::new();
        for (k, mode) in file.mode.iter().enumerate() {
            let at = format!("turning.mode[{k}]");
            self.sheet
                .number(&format!("{at}.direction_deg"), mode.direction_deg, -360.0, 360.0)?;
            let of = self.mode(&at, mode.frequency_hz, mode.damping_ratio, mode.stiffness_n_m)?;
            modes.push(TurningMode {
                mode: of,
                direction_deg: mode.direction_deg,
            });
        }
        Turning::new(&modes, force, 1e6 * file.coefficient_n_mm2).map_err(|error| {
            self.sheet
                .error("turning", error.to_string(), "correct this table")
        })
    }

    fn mode(&self, at: &str, frequency: f64, ratio: f64, stiffness: f64) -> Result<Mode, ConfigError> {
        self.sheet
            .number(&format!("{at}.frequency_hz"), frequency, 0.1, 1e5)?;
        self.sheet
            .number(&format!("{at}.damping_ratio"), ratio, 1e-5, 0.9)?;
        self.sheet
            .number(&format!("{at}.stiffness_n_m"), stiffness, 1e3, 1e13)?;
        Ok(Mode {
            frequency_hz: frequency,
            damping_ratio: ratio,
            stiffness_n_m: stiffness,
        })
    }

    fn milling(&self, file: &MillingFile) -> Result<Milling, ConfigError> {
        let teeth = self.count("milling.teeth", file.teeth, 1, 100)?;
        self.sheet
            .number("milling.tangential_n_mm2", file.tangential_n_mm2, 1.0, 1e6)?;
        self.sheet
            .number("milling.radial_n_mm2", file.radial_n_mm2, -1e6, 1e6)?;
        let cut = MillingCut {
            teeth: u32::try_from(teeth).unwrap_or(1),
            entry_deg: 0.0,
            exit_deg: 180.0,
            tangential_n_m2: 1e6 * file.tangential_n_mm2,
            radial_n_m2: 1e6 * file.radial_n_mm2,
        };
        let cut = match (
            file.entry_deg,
            file.exit_deg,
            file.immersion_ratio,
            file.direction,
        ) {
            (Some(entry), Some(exit), None, None) => {
                let [entry_deg, exit_deg] = self.range("milling.entry_deg", [entry, exit], 0.0, 180.0)?;
                MillingCut {
                    entry_deg,
                    exit_deg,
                    ..cut
                }
            }
            (None, None, Some(part), Some(direction)) => {
                self.sheet.number("milling.immersion_ratio", part, 1e-3, 1.0)?;
                cut.with_immersion(part, direction == DirectionWord::Down)
            }
            _ => {
                return Err(self.sheet.error(
                    "milling.entry_deg",
                    "the engagement is not clear".to_owned(),
                    "give entry_deg and exit_deg, or immersion_ratio and direction (\"up\" or \"down\")",
                ));
            }
        };
        self.count("milling.x", (file.x.len() + file.y.len()) as i64, 1, 20)?;
        let modes = |name: &str, files: &[ModeFile]| {
            let each = files.iter().enumerate().map(|(k, mode)| {
                let at = format!("milling.{name}[{k}]");
                self.mode(&at, mode.frequency_hz, mode.damping_ratio, mode.stiffness_n_m)
            });
            each.collect::<Result<Vec<_>, _>>()
        };
        Milling::new(cut, &modes("x", &file.x)?, &modes("y", &file.y)?).map_err(|error| {
            self.sheet
                .error("milling", error.to_string(), "correct this table")
        })
    }

    fn lobes(&self, file: Option<&LobesFile>) -> Result<LobeRange, ConfigError> {
        let Some(file) = file else {
            return Ok(LobeRange {
                speed_rpm: [1000.0, 20_000.0],
                points: 400,
                max_depth_mm: None,
                exact: true,
            });
        };
        if let Some(depth) = file.max_depth_mm {
            self.sheet.number("lobes.max_depth_mm", depth, 1e-3, 1e3)?;
        }
        Ok(LobeRange {
            speed_rpm: self.range("lobes.speed_rpm", file.speed_rpm, 1.0, 1e6)?,
            points: self.count("lobes.points", file.points.unwrap_or(400), 2, 5000)?,
            max_depth_mm: file.max_depth_mm,
            exact: file.exact.unwrap_or(true),
        })
    }
}

/// A range of speeds around that of the cut.
fn around(tool: &CuttingTool) -> [f64; 2] {
    [
        (0.3 * tool.speed_m_min).max(1.5 * tool.floor_m_min),
        2.0 * tool.speed_m_min.max(tool.floor_m_min),
    ]
}
