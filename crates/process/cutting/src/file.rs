//! The law file: a law as data.
//!
//! The JSON schema is made from these types, so their doc comments are what an editor shows to the person who writes a
//! law file.

use evolvent_config::{ConfigDocument, ConfigError};
use schemars::JsonSchema;
use serde::Deserialize;

use crate::error::LawError;
use crate::force::ToolAngles;
use crate::law::{Covered, ForceLaw};
use crate::power::PowerLaw;
use crate::rational::{RationalCoefficients, RationalLaw};
use crate::table::ForceTable;

/// Built-in laws: text of each file.
const BUILT_IN: [&str; 1] = [include_str!("../../../../config/laws/40x-r1.toml")];

/// A law as a file gives it, before the angles of a tool are known.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(title = "Evolvent force law file")]
pub struct LawDefinition {
    /// Name in case files and reports.
    pub name: String,
    /// One line for people: where the law is from.
    #[serde(default)]
    pub description: String,
    /// Which of the tables below there is.
    kind: KindWord,
    /// Radial over tangential force, Py / Pz; 0.4 is assumed if left out.
    #[schemars(range(min = 0.0, max = 10.0))]
    radial_ratio: Option<f64>,
    /// Where the data are from; beyond, the law is extrapolated, and that is said.
    #[serde(default)]
    covered: CoveredFile,
    /// `kind = "power"`.
    power: Option<PowerFile>,
    /// `kind = "rational"`.
    rational: Option<RationalFile>,
    /// `kind = "table"`.
    table: Option<TableFile>,
}

/// Kinds of laws.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
enum KindWord {
    /// The power law that handbooks print.
    Power,
    /// A rational function of the speed with a falling section.
    Rational,
    /// Measured forces.
    Table,
}

/// Where the data are from: lowest and highest.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct CoveredFile {
    /// Cutting speeds.
    speed_m_min: Option<[f64; 2]>,
    /// Depths of cut.
    depth_mm: Option<[f64; 2]>,
    /// Feeds.
    feed_mm_rev: Option<[f64; 2]>,
}

/// `Pz = coefficient_n factor V^speed_exponent t^depth_exponent S^feed_exponent`, V in m/min, t in mm, S in mm/rev.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct PowerFile {
    /// Force at 1 m/min, 1 mm and 1 mm/rev, N.
    #[schemars(range(min = 1e-9, max = 1e9))]
    coefficient_n: f64,
    /// Further factor (tool, material); 1 if left out.
    #[schemars(range(min = 1e-9, max = 1e9))]
    factor: Option<f64>,
    /// Exponent of the cutting speed.
    #[schemars(range(min = -10.0, max = 10.0))]
    speed_exponent: f64,
    /// Exponent of the depth.
    #[schemars(range(min = 0.0, max = 10.0))]
    depth_exponent: f64,
    /// Exponent of the feed.
    #[schemars(range(min = 0.0, max = 10.0))]
    feed_exponent: f64,
}

/// `Pz = unit_n Kt Klead ((a V k1 + b k2) / (V^2 + f V k5 + g k6) + c k3 / V + d k4)`, V in m/min. Each of a to g: the value at
/// a feed of 1 mm/rev, and the exponent of the feed. Each of k1 to k6: the value at a rake angle of 0 degrees, and the
/// exponent of e per degree.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct RationalFile {
    /// What makes newtons of the law's unit: 9.80665 for kgf.
    #[schemars(range(min = 1e-6, max = 1e6))]
    unit_n: f64,
    /// `Kt = depth_factor t^depth_exponent`, t in mm.
    #[schemars(range(min = 1e-9, max = 1e9))]
    depth_factor: f64,
    /// Exponent of the depth.
    #[schemars(range(min = 0.01, max = 10.0))]
    depth_exponent: f64,
    /// `Klead = lead_factor_at_0_deg + lead_factor_per_deg (lead angle)`.
    #[schemars(range(min = -1e3, max = 1e3))]
    lead_factor_at_0_deg: f64,
    /// How that changes with a degree.
    #[schemars(range(min = -1e3, max = 1e3))]
    lead_factor_per_deg: f64,
    /// Value at 1 mm/rev, exponent of the feed.
    a: [f64; 2],
    /// Value at 1 mm/rev, exponent of the feed.
    b: [f64; 2],
    /// Value at 1 mm/rev, exponent of the feed.
    c: [f64; 2],
    /// Value at 1 mm/rev, exponent of the feed.
    d: [f64; 2],
    /// Value at 1 mm/rev, exponent of the feed.
    f: [f64; 2],
    /// Value at 1 mm/rev, exponent of the feed.
    g: [f64; 2],
    /// Value at a rake angle of 0 degrees, exponent of e per degree.
    k1: [f64; 2],
    /// Value at a rake angle of 0 degrees, exponent of e per degree.
    k2: [f64; 2],
    /// Value at a rake angle of 0 degrees, exponent of e per degree.
    k3: [f64; 2],
    /// Value at a rake angle of 0 degrees, exponent of e per degree.
    k4: [f64; 2],
    /// Value at a rake angle of 0 degrees, exponent of e per degree.
    k5: [f64; 2],
    /// Value at a rake angle of 0 degrees, exponent of e per degree.
    k6: [f64; 2],
}

/// Measured forces over speed, depth and feed.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct TableFile {
    /// Cutting speeds, rising.
    #[schemars(length(min = 1, max = 200))]
    speed_m_min: Vec<f64>,
    /// Depths of cut, rising.
    #[schemars(length(min = 1, max = 200))]
    depth_mm: Vec<f64>,
    /// Feeds, rising.
    #[schemars(length(min = 1, max = 200))]
    feed_mm_rev: Vec<f64>,
    /// A list for each feed, of lists for each depth, of forces for each speed.
    force_n: Vec<Vec<Vec<f64>>>,
    /// Exponent of the speed, where one speed is given.
    speed_exponent: Option<f64>,
    /// Exponent of the depth, where one depth is given.
    depth_exponent: Option<f64>,
    /// Exponent of the feed, where one feed is given.
    feed_exponent: Option<f64>,
}

impl LawDefinition {
    /// Names of the built-in laws.
    #[must_use]
    pub fn built_in_names() -> Vec<String> {
        let laws = BUILT_IN.iter().filter_map(|text| Self::parse(text, "").ok());
        laws.map(|law| law.name).collect()
    }

    /// The built-in law of that name in either case, if there is one.
    #[must_use]
    pub fn built_in(name: &str) -> Option<Self> {
        let mut laws = BUILT_IN.iter().filter_map(|text| Self::parse(text, "").ok());
        laws.find(|law| law.name.eq_ignore_ascii_case(name))
    }

    /// Reads the text of a law file; `file` names it in errors.
    ///
    /// # Errors
    /// Text that is not TOML (or JSON, if the name ends in .json), and keys that are unknown, missing or
    /// invalid.
    pub fn parse(text: &str, file: &str) -> Result<Self, ConfigError> {
        let sheet = ConfigDocument::parse(text, file)?;
        let law: Self = sheet.read()?;
        law.check(&sheet)?;
        Ok(law)
    }

    fn check(&self, sheet: &ConfigDocument<'_>) -> Result<(), ConfigError> {
        if let Some(ratio) = self.radial_ratio {
            sheet.number("radial_ratio", ratio, 0.0, 10.0)?;
        }
        let ranges = [
            ("speed_m_min", self.covered.speed_m_min),
            ("depth_mm", self.covered.depth_mm),
            ("feed_mm_rev", self.covered.feed_mm_rev),
        ];
        for (key, range) in ranges {
            let Some([low, high]) = range else { continue };
            if !(low >= 0.0 && low < high && high <= 1e6) {
                return Err(sheet.error(
                    &format!("covered.{key}"),
                    format!("from {low} to {high}"),
                    "give two rising numbers, neither negative",
                ));
            }
        }
        let there = [
            (KindWord::Power, "power", self.power.is_some()),
            (KindWord::Rational, "rational", self.rational.is_some()),
            (KindWord::Table, "table", self.table.is_some()),
        ];
        for (kind, key, there) in there {
            let wanted = kind == self.kind;
            if wanted && !there {
                return Err(sheet.error(
                    "kind",
                    format!("is \"{key}\", but there is no [{key}]"),
                    format!("add the table [{key}] with its coefficients"),
                ));
            }
            if !wanted && there {
                return Err(sheet.error(
                    key,
                    "belongs to another kind of law".to_owned(),
                    "remove it, or change the kind",
                ));
            }
        }
        // Checks the numbers with a tool that every law accepts; the actual angles are known later.
        let tool = ToolAngles {
            rake_deg: 0.0,
            lead_deg: 45.0,
        };
        match self.law(tool) {
            Ok(_) | Err(LawError::Pole { .. } | LawError::Lead { .. }) => Ok(()),
            Err(error) => {
                let key = there.iter().find(|(kind, ..)| *kind == self.kind);
                let (what, advice) = (error.to_string(), "correct the numbers of this table");
                Err(sheet.error(key.map_or("kind", |key| key.1), what, advice))
            }
        }
    }

    /// The law for a tool. Kinds without angles accept any tool.
    ///
    /// # Errors
    /// Invalid coefficients: see [`LawError`].
    pub fn law(&self, tool: ToolAngles) -> Result<ForceLaw, LawError> {
        let law: ForceLaw = match (&self.power, &self.rational, &self.table) {
            (Some(power), ..) if self.kind == KindWord::Power => PowerLaw {
                coefficient_n: power.coefficient_n,
                factor: power.factor.unwrap_or(1.0),
                speed_exponent: power.speed_exponent,
                depth_exponent: power.depth_exponent,
                feed_exponent: power.feed_exponent,
            }
            .checked()?
            .into(),
            (_, Some(file), _) if self.kind == KindWord::Rational => {
                RationalLaw::new(&file.coefficients(), tool)?.into()
            }
            (_, _, Some(table)) => ForceTable::new(
                &table.speed_m_min,
                &table.depth_mm,
                &table.feed_mm_rev,
                &table.force_n,
                [table.speed_exponent, table.depth_exponent, table.feed_exponent],
            )?
            .into(),
            // A parsed definition has the table of its kind.
            _ => {
                return Err(LawError::Shape {
                    feeds: 0,
                    depths: 0,
                    speeds: 0,
                });
            }
        };
        let all = Covered::default();
        Ok(law.with(
            self.radial_ratio.unwrap_or(ForceLaw::ASSUMED_RADIAL_RATIO),
            Covered {
                speed_m_min: self.covered.speed_m_min.unwrap_or(all.speed_m_min),
                depth_mm: self.covered.depth_mm.unwrap_or(all.depth_mm),
                feed_mm_rev: self.covered.feed_mm_rev.unwrap_or(all.feed_mm_rev),
            },
        ))
    }
}

/// The JSON schema of the law file, shipped as `config/law.schema.json` for completion and checks in editors.
#[must_use]
pub fn law_schema() -> serde_json::Value {
    schemars::schema_for!(LawDefinition).to_value()
}

impl RationalFile {
    fn coefficients(&self) -> RationalCoefficients {
        RationalCoefficients {
            unit_n: self.unit_n,
            depth_factor: self.depth_factor,
            depth_exponent: self.depth_exponent,
            lead_factor_at_0_deg: self.lead_factor_at_0_deg,
            lead_factor_per_deg: self.lead_factor_per_deg,
            a: self.a,
            b: self.b,
            c: self.c,
            d: self.d,
            f: self.f,
            g: self.g,
            k: [self.k1, self.k2, self.k3, self.k4, self.k5, self.k6],
        }
    }
}
